"""Every variant in two checkouts that are built, an old one and this one, frame by frame in turns.

A process for each checkout, and a second one for the old: the ratio of the two old ones is what a ratio of 1 looks like on the
machine. One process draws a frame after the other, so that whatever else runs slows all of them. What they draw this checkout
makes. On CUDA a frame is the replay of a graph, and its time is the device's: the median of a few, after one that is not timed,
for what another process has left in the caches is of no use to it. A million small triangles take up to a tenth longer then.

    git worktree add ../before COMMIT && (cd ../before && python setup.py build_ext --inplace)
    python bench/before_after.py ../before --csv bench/results/setup_cpu.csv
    python bench/before_after.py --rows bench/results/setup_cpu.csv --docs docs/variants.md --name set-up      # the table alone
    python bench/before_after.py ../before --device cuda --size 256x256,1080p --seconds 0.2 --csv build/setup_cuda.csv
    python bench/before_after.py ../before --device cuda --model duck.glb --setting bin_owned --setting bin_owned:few=0,share=32
"""

from __future__ import annotations

import argparse
import csv
import itertools
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import cuda_cases
import cuda_clock
import markdown
import numpy as np
import torch
from cuda_cases import Way

from bigtri import native
from bigtri.app import arguments as option_types
from bigtri.precision import DEFAULT
from bigtri.study import provenance, scenes

ROOT = Path(__file__).resolve().parents[1]
SCENES = "R16k,S6-200k,R100k,R1M"
# Draws what a line of its input names, and answers in ms. It asks little of its checkout, which may be an old one.
WORKER = """
import contextlib, functools, json, statistics, sys, numpy, torch
from bigtri import native, rasterize
from bigtri.study import clock
device, threads = sys.argv[1], int(sys.argv[2])
torch.set_num_threads(threads)
mesh = frame = ""
for line in sys.stdin:
    file, variant, width, height, parameters = json.loads(line)
    if file != mesh:
        mesh, arrays = file, numpy.load(file)
        given = [torch.from_numpy(arrays[name]).to(device) for name in ("positions", "triangles")]
    with native.using_parameters(**parameters) if parameters else contextlib.nullcontext():
        if line != frame:
            frame, size = line, (height, width)
            out, depth = torch.empty(size, dtype=torch.int64, device=device), torch.empty(size, device=device)
            draw = functools.partial(rasterize, *given, size, variant=variant, backend="native", out=out, depth_out=depth)
            if device == "cuda":
                draw = clock.captured(draw, 1).replay
        if device == "cuda":
            ms = [clock.device_ms(draw) for _ in range(6)][1:]
        else:
            ms = [clock.wall_ms(draw)]
    print(statistics.median(ms), flush=True)
"""


class Drawing:
    """A process that draws with a checkout's extension."""

    def __init__(self, checkout: Path, device: str, threads: int) -> None:
        command = [sys.executable, "-c", WORKER, device, str(threads)]
        found_first = os.pathsep.join(filter(None, [str(checkout), os.environ.get("PYTHONPATH")]))
        given = {"cwd": checkout, "env": {**os.environ, "PYTHONPATH": found_first}, "text": True}
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, **given)  # type: ignore[call-overload]

    def begin(self, frame: str) -> None:
        """frame: a file of positions and triangles, variant, width, height and parameters, as JSON."""
        print(frame, file=self.process.stdin, flush=True)

    def ms(self) -> float:
        """The time of the frame that was begun.

        Raises:
            SystemExit: the process has ended; what it said is on the screen.
        """
        answer = self.process.stdout.readline()
        if not answer:
            raise SystemExit(f"a process of {self.process.args[0]} has ended with {self.process.wait()}")
        return float(answer)

    def end(self) -> None:
        """Lets the process end."""
        self.process.communicate()


def in_turns(drawings: Sequence[Drawing], frame: str, seconds: float) -> list[list[float]]:
    """The times of rounds [N][3], ms: each draws once, in another order each time."""
    for drawing in drawings:  # all at once: the first frame takes longest
        drawing.begin(frame)
    for drawing in drawings:
        drawing.ms()
    rounds: list[list[float]] = []
    end = time.perf_counter() + seconds
    while time.perf_counter() < end or len(rounds) < 5:
        first = len(rounds) % len(drawings)
        order = [*range(first, len(drawings)), *range(first)]
        found = {}
        for k in order:
            drawings[k].begin(frame)
            found[k] = drawings[k].ms()
        rounds.append([found[k] for k in range(len(drawings))])
    return rounds


def commit_of(checkout: Path) -> str:
    describe = ["git", "describe", "--always", "--dirty", "--exclude=*"]
    return subprocess.run(describe, cwd=checkout, capture_output=True, text=True, check=True).stdout.strip()


def measured(arguments: argparse.Namespace) -> list[dict[str, object]]:
    maker = cuda_cases.maker_for(arguments)
    names = cuda_clock.listed(arguments.scenes or ",".join(maker.models) or SCENES, "scene", maker.names())
    variants = native.REGISTRY[arguments.device][DEFAULT]
    try:
        ways = [cuda_cases.cut(way, variants) for way in arguments.setting] or [Way(variant, "", {}) for variant in variants]
    except ValueError as error:
        raise SystemExit(f"--setting {error}") from None
    checkouts = (arguments.before, arguments.before, ROOT)
    drawings = [Drawing(path, arguments.device, arguments.threads) for path in checkouts]
    commits = arguments.commits or [commit_of(path) for path in (arguments.before, ROOT)]
    rows: list[dict[str, object]] = []
    with tempfile.TemporaryDirectory() as folder:
        for number, (scene, (width, height)) in enumerate(itertools.product(names, arguments.size)):
            given = maker.make(cuda_clock.Job(scene, width, height, scenes.SEED))
            file = Path(folder) / f"{number}.npz"
            np.savez(file, positions=given.positions, triangles=given.triangles)
            for way in ways:
                frame = json.dumps([str(file), way.variant, width, height, way.parameters])
                before, control, after = zip(*in_turns(drawings, frame, arguments.seconds), strict=True)
                rows.append(
                    {
                        "scene": scene,
                        "size": f"{width}x{height}",
                        "variant": way.name,
                        "threads": arguments.threads if arguments.device == "cpu" else "",
                        "before_ms": f"{statistics.median(before):.5f}",
                        "after_ms": f"{statistics.median(after):.5f}",
                        "ratio": f"{ratio(after, before):.3f}",
                        "control": f"{ratio(control, before):.3f}",
                        "rounds": len(before),
                        "before": commits[0],
                        "after": commits[1],
                        "device": provenance.device(arguments.device),
                        "torch": torch.__version__,
                    }
                )
                print(*list(rows[-1].values())[:9], flush=True)
            file.unlink()
    for drawing in drawings:
        drawing.end()
    return rows


def ratio(above: Sequence[float], below: Sequence[float]) -> float:
    """The median of the rounds' ratios."""
    return statistics.median(a / b for a, b in zip(above, below, strict=True))


def table(rows: Sequence[dict[str, object]]) -> str:
    """Ratios, by case and variant; a case is a scene, or if there are several sizes, a scene of a size."""
    sizes = {row["size"] for row in rows}

    def case(row: dict[str, object]) -> str:
        return f"{row['scene']}, {row['size']}" if len(sizes) > 1 else str(row["scene"])

    ratios = {(case(row), row["variant"]): f"{float(str(row['ratio'])):.2f}" for row in rows}
    variants, cases = list(dict.fromkeys(row["variant"] for row in rows)), list(dict.fromkeys(map(case, rows)))
    return markdown.table(
        ["after / before", *cases], [[variant, *(ratios[each, variant] for each in cases)] for variant in variants]
    )


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("before", nargs="?", type=Path, help="the old checkout, built")
    parser.add_argument("--scenes", help=f"default {SCENES}, with --model the models")
    parser.add_argument("--model", type=Path, nargs="+", default=[], metavar="FILE", help="a scene of the file's name")
    cuda_cases.add_setting(parser, "a variant, and parameters of it; may be repeated; default every variant")
    sizes = option_types.listed(option_types.size)
    parser.add_argument("--size", type=sizes, default="1080p", help="sizes separated by commas; default %(default)s")
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="default %(default)s")
    parser.add_argument("--threads", type=option_types.count, default=1, help="default %(default)s")
    parser.add_argument(
        "--seconds", type=option_types.seconds, default=3, help="for each variant on each scene; default %(default)s"
    )
    parser.add_argument("--commits", nargs=2, metavar=("BEFORE", "AFTER"), help="of checkouts that are copies without .git")
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--rows", type=Path, help="take the rows from here")
    parser.add_argument("--docs", type=Path, help="put the table into this page")
    parser.add_argument("--name", default="before and after", help="of the table's markers in it")
    arguments = parser.parse_args(argv)
    if (arguments.before is None) == (arguments.rows is None):
        parser.error("name an old checkout, or --rows")
    if arguments.rows:
        rows: list[dict[str, object]] = [*csv.DictReader(arguments.rows.open())]
    else:
        arguments.before = arguments.before.resolve()
        rows = measured(arguments)
    if arguments.csv:
        with arguments.csv.open("w", newline="") as file:
            writer = csv.DictWriter(file, rows[0])
            writer.writeheader()
            writer.writerows(rows)
    if arguments.docs:
        markdown.paste(arguments.docs, arguments.name, table(rows))
    print(table(rows))


if __name__ == "__main__":
    main()

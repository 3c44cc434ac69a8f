"""Every variant of the CPU in two checkouts that are built, an old one and this one, frame by frame in turns.

A process for each checkout, and a second one for the old: the ratio of the two old ones is what a ratio of 1 looks like on the
machine. One process draws a frame after the other, so that whatever else runs slows all of them.

    git worktree add ../before COMMIT && (cd ../before && python setup.py build_ext --inplace)
    python bench/before_after.py ../before --csv bench/results/setup_cpu.csv
    python bench/before_after.py --rows bench/results/setup_cpu.csv --docs docs/variants.md --name set-up      # the table alone
"""

from __future__ import annotations

import argparse
import csv
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import markdown
import torch

from bigtri import native
from bigtri.app import arguments as option_types
from bigtri.study import provenance

ROOT = Path(__file__).resolve().parents[1]
# Draws what a line of its input names, and answers in ms.
WORKER = """
import sys, time, torch
from bigtri import rasterize
from bigtri.study import scenes
height, width, threads = map(int, sys.argv[1:])
torch.set_num_threads(threads)
out = torch.empty((height, width), dtype=torch.int64)
depth = torch.empty((height, width))
mesh = ()
for line in sys.stdin:
    scene, variant = line.split()
    if (scene, height) != mesh[:2]:
        mesh = scene, height, *map(torch.from_numpy, scenes.make(scene, width, height))
    start = time.perf_counter()
    rasterize(*mesh[2:], (height, width), variant=variant, backend="native", out=out, depth_out=depth)
    print(1e3 * (time.perf_counter() - start), flush=True)
"""


class Drawing:
    """A process that draws with a checkout's extension."""

    def __init__(self, checkout: Path, resolution: tuple[int, int], threads: int) -> None:
        command = [sys.executable, "-c", WORKER, *map(str, (*resolution, threads))]
        given = {"cwd": checkout, "env": {**os.environ, "PYTHONPATH": str(checkout)}, "text": True}
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, **given)  # type: ignore[call-overload]

    def ms(self, scene: str, variant: str) -> float:
        """The time of a frame."""
        print(scene, variant, file=self.process.stdin, flush=True)
        return float(self.process.stdout.readline())


def in_turns(drawings: Sequence[Drawing], scene: str, variant: str, seconds: float) -> list[list[float]]:
    """The times of rounds [N][3], ms: each draws once, in another order each time."""
    for drawing in drawings:
        drawing.ms(scene, variant)
    rounds: list[list[float]] = []
    end = time.perf_counter() + seconds
    while time.perf_counter() < end or len(rounds) < 5:
        first = len(rounds) % len(drawings)
        order = [*range(first, len(drawings)), *range(first)]
        found = {k: drawings[k].ms(scene, variant) for k in order}
        rounds.append([found[k] for k in range(len(drawings))])
    return rounds


def commit_of(checkout: Path) -> str:
    describe = ["git", "describe", "--always", "--dirty", "--exclude=*"]
    return subprocess.run(describe, cwd=checkout, capture_output=True, text=True, check=True).stdout.strip()


def measured(arguments: argparse.Namespace) -> list[dict[str, object]]:
    width, height = arguments.size
    drawings = [Drawing(path, (height, width), arguments.threads) for path in (arguments.before, arguments.before, ROOT)]
    rows: list[dict[str, object]] = []
    for scene in arguments.scenes.split(","):
        for variant in native.VARIANTS["cpu"]:
            rounds = in_turns(drawings, scene, variant, arguments.seconds)
            before, _, after = (statistics.median(times) for times in zip(*rounds, strict=True))
            rows.append(
                {
                    "scene": scene,
                    "size": f"{width}x{height}",
                    "variant": variant,
                    "threads": arguments.threads,
                    "before_ms": f"{before:.4f}",
                    "after_ms": f"{after:.4f}",
                    "ratio": f"{statistics.median(one[2] / one[0] for one in rounds):.3f}",
                    "control": f"{statistics.median(one[1] / one[0] for one in rounds):.3f}",
                    "rounds": len(rounds),
                    "before": commit_of(arguments.before),
                    "after": commit_of(ROOT),
                    "device": provenance.device(),
                    "torch": torch.__version__,
                }
            )
            print(*list(rows[-1].values())[:9], flush=True)
    return rows


def table(rows: Sequence[dict[str, object]]) -> str:
    """Ratios, by scene and variant."""
    ratios = {(row["scene"], row["variant"]): f"{float(str(row['ratio'])):.2f}" for row in rows}
    variants = list(dict.fromkeys(row["variant"] for row in rows))
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    return markdown.table(
        ["after / before", *map(str, scenes)], [[variant, *(ratios[scene, variant] for scene in scenes)] for variant in variants]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("before", nargs="?", type=Path, help="the old checkout, built")
    parser.add_argument("--scenes", default="R16k,S6-200k,R100k,R1M", help="default %(default)s")
    parser.add_argument("--size", type=option_types.size, default="1080p", help="default %(default)s")
    parser.add_argument("--threads", type=option_types.count, default=1, help="default %(default)s")
    parser.add_argument(
        "--seconds", type=option_types.seconds, default=3, help="for each variant on each scene; default %(default)s"
    )
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--rows", type=Path, help="take the rows from here")
    parser.add_argument("--docs", type=Path, help="put the table into this page")
    parser.add_argument("--name", default="before and after", help="of the table's markers in it")
    arguments = parser.parse_args()
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

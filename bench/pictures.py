"""Whole pictures: `render` and llvmpipe on the same scenes, in the same run, taking turns; and what else a picture costs.

Rounds, turns and ratios are those of run.py. "again" is bigtri once more: its ratio is the noise. Both draw the same triangles,
textures, lights and camera, and their pictures are compared: `apart` counts the pixels with a channel that differs by more than
2 of 255 codes. Beside that: the memory of a 4K picture, a batch against a loop, `sample_texture` against torch's `grid_sample`,
and a small picture while another process has one of the cores.

    python bench/pictures.py --csv bench/results/pictures_cpu.csv --docs docs/performance.md
    python bench/pictures.py --quick
    python bench/pictures.py --scenes Duck.glb,R16k-lit --size 1080p --threads 2
"""

from __future__ import annotations

import argparse
import ctypes
import dataclasses
import itertools
import math
import os
import signal
import statistics
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import markdown
import numpy as np
import peer_llvmpipe
import peer_picture
import picture_scenes
import torch
from numpy.typing import NDArray
from picture_scenes import Pictured
from run import take_turns

import bigtri
from bigtri import Camera, ModelWarning, native, render
from bigtri.app import arguments as option_types
from bigtri.study import benchmark, provenance
from bigtri.study.clock import clock, interleaved, peak_mib, setting, summary

SIZES = ("640x480", "1080p", "4k")
QUICK = ("R16k-textured", "Rcourtyard")
APART = 2  # codes: what rounding may do at a texel's edge and no one sees


@dataclasses.dataclass
class Row:
    """One measurement; the fields are the CSV's columns."""

    what: str  # "picture", "memory", "batch", "texture" or "busy"
    renderer: str
    variant: str
    scene: str
    triangles: int | None
    width: int  # px
    height: int  # px
    threads: int
    isa: str
    ms_median: float = math.nan
    ms_min: float = math.nan
    ms_p25: float = math.nan
    ms_p75: float = math.nan
    repeats: int = 0
    ratio: float | None = None  # this time over that of the first row of its kind, median of the rounds
    ratio_p25: float | None = None
    ratio_p75: float | None = None
    apart_px: int | None = None  # pixels whose codes differ from bigtri's by more than APART
    most_apart: int | None = None  # codes
    peak_mib: float | None = None  # resident memory above the scene's
    device: str = dataclasses.field(default_factory=provenance.device)
    versions: str = dataclasses.field(default_factory=provenance.versions)
    commit: str = dataclasses.field(default_factory=provenance.commit)
    command: str = dataclasses.field(default_factory=provenance.command)

    def timed(self, ms: list[float]) -> Row:
        """This row with a clock's reading."""
        median, minimum, p25, p75, repeats = summary(ms)
        return dataclasses.replace(self, ms_median=median, ms_min=minimum, ms_p25=p25, ms_p75=p75, repeats=repeats)

    def beside(self, mine: NDArray[np.float64], first: NDArray[np.float64]) -> Row:
        """This row with its ratio; of times [rounds]."""
        low, middle, high = np.percentile(mine / first, [25, 50, 75])
        return dataclasses.replace(self, ratio=float(middle), ratio_p25=float(low), ratio_p75=float(high))


# --- pictures


class Bigtri:
    """bigtri in this process: the whole call, from a scene that is uploaded to a picture in memory of its own."""

    def __init__(self, threads: int, name: str = "bigtri") -> None:
        self.name, self.variant, self.threads = name, "auto", threads

    def load(self, pictured: Pictured, width: int, height: int) -> None:
        self.scene = pictured.scene.on("cpu")
        self.camera, self.size = pictured.camera(width / height), (height, width)

    def draw(self) -> torch.Tensor:
        return render(self.scene, self.camera, self.size, backend="native")

    def frames(self, count: int) -> list[float]:
        with setting(self.threads):
            return clock(self.draw, 0, warm=0, at_least=count)

    def picture(self) -> NDArray[np.uint8]:
        return self.draw().numpy()

    def close(self) -> None:
        pass


class Llvmpipe:
    """llvmpipe; for one thread with a worker or without, whichever is faster on the scene."""

    name = "llvmpipe"

    def __init__(self, threads: int) -> None:
        self.processes = {n: peer_picture.LlvmpipePictures(n) for n in ([0, 1] if threads == 1 else [threads])}
        self.renderer = next(iter(self.processes.values())).renderer
        self.variant = ""

    def load(self, pictured: Pictured, width: int, height: int) -> None:
        found = []
        for count, process in self.processes.items():
            process.load(pictured.scene, pictured.camera(width / height), width, height)
            found.append((statistics.median(peer_llvmpipe.budgeted(process, 0.1)), count))
        _, count = min(found)
        self.variant, self.active = f"LP_NUM_THREADS={count}", self.processes[count]

    def frames(self, count: int) -> list[float]:
        return self.active.frames(count)

    def picture(self) -> NDArray[np.uint8]:
        return self.active.picture()

    def close(self) -> None:
        for process in self.processes.values():
            process.close()


def case(
    everyone: list[Bigtri | Llvmpipe], threads: int, pictured: Pictured, width: int, height: int, seconds: float
) -> list[Row]:
    """Runs one case, bigtri first of all, and prints a line for each."""
    for one in everyone:
        one.load(pictured, width, height)
    times = take_turns(everyone, seconds)
    medians = np.array([[statistics.median(frames) for frames in rounds] for rounds in times])  # [who, round]
    expected = everyone[0].picture().astype(int)
    rows = []
    for who, one in enumerate(everyone):
        isa = native.isa() if isinstance(one, Bigtri) else ""
        row = Row("picture", one.name, one.variant, pictured.name, len(pictured.scene.triangles), width, height, threads, isa)
        row = row.timed([ms for frames in times[who] for ms in frames])
        line = f"{pictured.name:18} {f'{width}x{height}':>10} {threads:7} {one.name:>9} {row.ms_median:10.3f} {row.ms_min:9.3f}"
        if who > 0:
            row = row.beside(medians[who], medians[0])
            apart = np.abs(one.picture() - expected).max(axis=2)
            row.apart_px, row.most_apart = int((apart > APART).sum()), int(apart.max())
            line += f" {row.ratio:7.2f} ({row.ratio_p25:.2f} to {row.ratio_p75:.2f})  {row.apart_px} px, at most {row.most_apart}"
        print(line, flush=True)
        rows.append(row)
    return rows


# --- what else a picture costs


def memory(pictured: Pictured, threads: int) -> Row:
    """The first 4K picture: the picture itself is part of what it takes."""
    mine = Bigtri(threads)
    mine.load(pictured, 3840, 2160)
    bigtri.memory.release()
    if hasattr(libc := ctypes.CDLL(None), "malloc_trim"):
        libc.malloc_trim(0)  # what making the scene has left does not count as there already
    with setting(threads):
        peak = peak_mib(mine.draw)
    row = Row("memory", "bigtri", "auto", pictured.name, len(pictured.scene.triangles), 3840, 2160, threads, native.isa())
    own = 2160 * 3840 * 3 / 2**20
    print(f"{pictured.name}: the first 4K picture takes {peak or math.nan:.0f} MiB, {own:.0f} of them its own")
    return dataclasses.replace(row, peak_mib=peak)


def batch(pictured: Pictured, threads: int, seconds: float, views: int = 36, side: int = 256) -> list[Row]:
    """Views from all around: in one call, and one after the other."""
    scene, size = pictured.scene.on("cpu"), (side, side)
    cameras = [Camera.framing(pictured.scene.bounds, azimuth=360 * i / views, elevation=20, aspect=1) for i in range(views)]
    calls = {
        "batch": lambda: render(scene, cameras, size, backend="native"),
        "loop": lambda: [render(scene, camera, size, backend="native") for camera in cameras],
    }
    return compared("batch", calls, pictured.name, len(pictured.scene.triangles), (side, side), threads, seconds)


def texture(threads: int, seconds: float) -> list[Row]:
    """A turned and enlarged texture over 1080p; torch takes channels first and coordinates of its own, made beforehand."""
    height, width = 1080, 1920
    coded = torch.from_numpy(picture_scenes.painted(1024))
    linear = bigtri.decode_srgb(coded)
    y, x = np.mgrid[0:height, 0:width] / width
    uv = torch.from_numpy(np.stack([0.1 + 0.8 * x + 0.2 * y, 0.05 + 1.1 * y + 0.2 * x], axis=2).astype(np.float32))
    first = linear.permute(2, 0, 1)[None].contiguous()
    last = first.contiguous(memory_format=torch.channels_last)
    grid = (torch.stack([uv[..., 0], 1 - uv[..., 1]], dim=2) * 2 - 1)[None]

    def grid_sample(image: torch.Tensor) -> torch.Tensor:
        return torch.nn.functional.grid_sample(image, grid, "bilinear", "border", align_corners=False)

    mine = bigtri.sample_texture(linear, uv, filter="bilinear", wrap="clamp", backend="native")
    off = float((mine - grid_sample(first)[0].permute(1, 2, 0)).abs().max())
    print(f"sample_texture and grid_sample differ by at most {off:.2g}")
    calls = {
        "sample_texture": lambda: bigtri.sample_texture(linear, uv, filter="bilinear", wrap="clamp", backend="native"),
        "sample_texture, uint8": lambda: bigtri.sample_texture(coded, uv, filter="bilinear", wrap="clamp", backend="native"),
        "grid_sample": lambda: grid_sample(first),
        "grid_sample, channels_last": lambda: grid_sample(last),
    }
    return compared("texture", calls, "1024x1024", None, (width, height), threads, seconds)


def compared(
    what: str,
    calls: Mapping[str, Callable[[], object]],
    scene: str,
    triangles: int | None,
    size: tuple[int, int],
    threads: int,
    seconds: float,
) -> list[Row]:
    """Rows of calls that take turns, with their ratios to the first."""
    with setting(threads):
        times = {name: np.array(ms) for name, ms in interleaved(calls, seconds).items()}
    first = next(iter(times.values()))
    rows = []
    for name, ms in times.items():
        row = Row(what, name, "auto", scene, triangles, *size, threads, native.isa()).timed(ms.tolist()).beside(ms, first)
        print(f"{name:28} {f'{size[0]}x{size[1]}':>10} {threads:7} {row.ms_median:10.3f} {row.ms_min:9.3f} {row.ratio:7.2f}")
        rows.append(row)
    return rows


@contextmanager
def neighbour() -> Iterator[subprocess.Popen[bytes]]:
    """A process that never rests, on one of the cores; asleep until it is sent SIGCONT."""
    process = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(process.pid, {min(os.sched_getaffinity(0))})
    process.send_signal(signal.SIGSTOP)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def busy(pictured: Pictured, threads: int, rounds: int, side: int = 256) -> list[Row]:
    """A small picture, in turns while a neighbour sleeps and while it works."""
    mine = Bigtri(threads)
    mine.load(pictured, side, side)
    times: dict[str, list[list[float]]] = {"quiet": [], "one core taken": []}
    with neighbour() as process:
        for _ in range(rounds):
            times["quiet"].append(mine.frames(20)[1:])
            process.send_signal(signal.SIGCONT)
            times["one core taken"].append(mine.frames(20)[1:])
            process.send_signal(signal.SIGSTOP)
    medians = {name: np.array([statistics.median(frames) for frames in of]) for name, of in times.items()}
    rows = []
    for name, frames in times.items():
        row = Row("busy", name, "auto", pictured.name, len(pictured.scene.triangles), side, side, threads, native.isa())
        row = row.timed([ms for some in frames for ms in some]).beside(medians[name], medians["quiet"])
        print(f"{name:28} {f'{side}x{side}':>10} {threads:7} {row.ms_median:10.3f} {row.ms_min:9.3f} {row.ratio:7.2f}")
        rows.append(row)
    return rows


# --- the whole


def tables(rows: list[Row]) -> str:
    """What the documentation shows: llvmpipe's time over bigtri's, 1 and 2 threads; and what else was measured."""
    pictures = [row for row in rows if row.what == "picture"]
    sizes = list(dict.fromkeys((row.width, row.height) for row in pictures))
    lines = []
    for name in dict.fromkeys(row.scene for row in pictures):
        cells = []
        for size in sizes:
            of = [row for row in pictures if row.scene == name and (row.width, row.height) == size]
            mine = ", ".join(f"{row.ms_median:.3g}" for row in of if row.renderer == "bigtri")
            ratios = ", ".join(f"{row.ratio:.1f}" for row in of if row.renderer == "llvmpipe")
            noise = ", ".join(f"{row.ratio:.2f}" for row in of if row.renderer == "again")
            cells += [mine, ratios, noise]
        apart = max((row.apart_px or 0 for row in pictures if row.scene == name and row.renderer == "llvmpipe"), default=0)
        lines.append([name, *cells, apart])
    head = ["", *itertools.chain(*([f"{w}x{h}, ms", "llvmpipe", "A/A"] for w, h in sizes)), f"px apart by > {APART} codes"]
    text = markdown.table(head, lines)
    others = [row for row in rows if row.what in ("batch", "texture", "busy")]
    if others:
        more = [[row.what, row.renderer, row.threads, f"{row.ms_median:.3g}", f"{row.ratio:.2f}"] for row in others]
        text += "\n\n" + markdown.table(["what", "how", "threads", "ms", "times the first"], more)
    return text


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--quick", action="store_true", help="two scenes, small sizes: half a minute")
    parser.add_argument("--scenes", help=f"names and model files (default {','.join(picture_scenes.DEFAULT)})")
    parser.add_argument("--size", type=option_types.listed(option_types.size), help=f"default {','.join(SIZES)}")
    parser.add_argument("--threads", type=option_types.listed(option_types.count), default="1,2", help="default 1,2")
    parser.add_argument("--no-peer", action="store_true", help="without llvmpipe")
    parser.add_argument("--seconds", type=option_types.seconds, help="time for each case, all together (default 4; quick 1)")
    parser.add_argument("--csv", metavar="FILE", type=option_types.csv_file, help="write the rows there")
    parser.add_argument("--docs", metavar="PAGE", type=Path, help="put the tables between the markers 'pictures' of this page")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore", ModelWarning)
    names = arguments.scenes.split(",") if arguments.scenes else list(QUICK if arguments.quick else picture_scenes.DEFAULT)
    sizes = arguments.size or [option_types.size(size) for size in (SIZES[:2] if arguments.quick else SIZES)]
    seconds = arguments.seconds or (1.0 if arguments.quick else 4.0)
    try:
        everything = [picture_scenes.make(name) for name in names]
    except ValueError as error:
        parser.error(str(error))

    print(f"{provenance.device()}; {provenance.versions()}; {provenance.commit()}; {native.isa()}")
    most = max(arguments.threads)
    rows = [memory(everything[0], most)]  # before anything else leaves memory to be used again
    print(f"{'scene':18} {'size':>10} {'threads':>7} {'renderer':>9} {'median ms':>10} {'min':>9}  their time / ours (quartiles)")
    for threads in arguments.threads:
        torch.set_num_threads(threads)
        everyone: list[Bigtri | Llvmpipe] = [Bigtri(threads), Bigtri(threads, "again")]
        if not arguments.no_peer:
            try:
                everyone.append(Llvmpipe(threads))
            except RuntimeError as error:
                print(error)
        for (width, height), pictured in itertools.product(sizes, everything):
            rows += case(everyone, threads, pictured, width, height, seconds)
            if arguments.csv:
                benchmark.write_csv(arguments.csv, rows)  # after each case: an interrupted run keeps what it has
        for one in everyone:
            one.close()
        rows += batch(everything[0], threads, seconds)
        rows += texture(threads, seconds)
    rows += busy(everything[0], most, rounds=5 if arguments.quick else 20)
    if arguments.csv:
        benchmark.write_csv(arguments.csv, rows)
    text = tables(rows)
    print(f"\n{text}")
    if arguments.docs:
        markdown.paste(arguments.docs, "pictures", text)


if __name__ == "__main__":
    main()

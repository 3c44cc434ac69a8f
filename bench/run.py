"""The comparison: bigtri and its peers on the same scenes, in the same run, taking turns.

Each case (scene, resolution, threads) runs in rounds. In a round everyone draws frames for about a twentieth of a second, one
after the other, in an order that reverses every round, so that a neighbour's load or a clock's drift meets all of them. A
round gives one ratio, the peer's median over bigtri's; the table and the CSV carry the median of the rounds and their
quartiles. A peer's image is compared with bigtri's, so that it is known to do the same work. Filling the image and nothing
else takes turns too: the floor under any of them.

    python bench/run.py --real --csv bench/results/cpu_real.csv
    python bench/run.py --csv bench/results/cpu.csv
    python bench/run.py --scenes S1,S3 --size 1080p --threads 2 --peers llvmpipe --seconds 3
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import statistics
import time
from collections.abc import Sequence
from typing import Protocol

import memory_floor
import numpy as np
import peer_llvmpipe
import peer_python
import torch
from numpy.typing import NDArray

from bigtri import native
from bigtri.app import arguments as option_types
from bigtri.ops.rasterize import Visibility, rasterize
from bigtri.study import benchmark, provenance, scenes
from bigtri.study.clock import clock, peak_mib, setting, summary

PEERS = ("plain", "llvmpipe", *peer_python.WAYS)
TURN = 0.05  # s: how long a turn lasts, at least one frame
SIZES = ("1080p", "4k")
REAL_SIZES = ("256x256", "640x480", *SIZES)
REST = 0.02  # s: between turns, for the threads that waited by spinning to go to sleep


class Timed(Protocol):
    """What can take turns."""

    def frames(self, count: int) -> list[float]:
        """Draws `count` frames: milliseconds of each."""


class Peer(Timed, Protocol):
    """A rasterizer that can take turns."""

    name: str
    variant: str  # what a row's `variant` column says

    def load(self, name: str, width: int, height: int) -> None:
        """Takes a scene by name and allocates an image."""

    def ids(self) -> NDArray[np.int32]:
        """The last frame's triangle indices, int32 [H, W], -1 where there is none."""

    def close(self) -> None: ...


class Bigtri:
    """bigtri in this process."""

    name = "bigtri"

    def __init__(self, threads: int, variant: str) -> None:
        self.threads, self.variant = threads, variant

    def load(self, name: str, width: int, height: int) -> None:
        self.job = benchmark.Job(name, width, height, scenes.make(name, width, height), self.variant)

    def frames(self, count: int) -> list[float]:
        with setting(self.threads):
            return clock(self.job.draw, 0, warm=0, at_least=count)

    def ids(self) -> NDArray[np.int32]:
        return benchmark.ids(self.job.packed.numpy())

    def close(self) -> None:
        pass


class Plain:
    """bigtri as README calls it: with a depth image, and results in memory of their own that are let go before the next."""

    name = "plain"

    def __init__(self, threads: int, variant: str) -> None:
        self.threads, self.variant = threads, variant
        self.seen: Visibility | None = None

    def load(self, name: str, width: int, height: int) -> None:
        scene = scenes.make(name, width, height)
        self.inputs = torch.from_numpy(scene.positions), torch.from_numpy(scene.triangles), (height, width)

    def draw(self) -> None:
        self.seen = None
        self.seen = rasterize(*self.inputs, variant=self.variant, backend="native")

    def frames(self, count: int) -> list[float]:
        with setting(self.threads):
            return clock(self.draw, 0, warm=0, at_least=count)

    def ids(self) -> NDArray[np.int32]:
        assert self.seen, "nothing is drawn"
        return np.asarray(self.seen.triangle)

    def close(self) -> None:
        pass


class LlvmpipePeer:
    """llvmpipe with what is fastest on the scene: the way it learns the index and, for one thread, with a worker or without."""

    name = "llvmpipe"

    def __init__(self, threads: int) -> None:
        self.processes = {count: peer_llvmpipe.Llvmpipe(count) for count in ([0, 1] if threads == 1 else [threads])}
        self.variant = ""
        self.renderer = next(iter(self.processes.values())).renderer

    def load(self, name: str, width: int, height: int) -> None:
        scene = scenes.make(name, width, height)
        found = []
        for (count, process), way in itertools.product(self.processes.items(), ("primitive", "attribute")):
            process.load(scene, width, height, way)
            found.append((statistics.median(peer_llvmpipe.budgeted(process, 0.2)), count, way))
        _, count, way = min(found, key=lambda each: each[0])
        self.variant = f"ids {way}, LP_NUM_THREADS={count}"
        self.active = self.processes[count]
        self.active.load(scene, width, height, way)

    def frames(self, count: int) -> list[float]:
        return self.active.frames(count)

    def ids(self) -> NDArray[np.int32]:
        return self.active.ids()

    def close(self) -> None:
        for process in self.processes.values():
            process.close()


def take_turns(everyone: Sequence[Timed], seconds: float) -> list[list[list[float]]]:
    """Milliseconds [peer][round][frame] of as many rounds as fit in `seconds`, at least 3."""
    first = [peer.frames(2)[1] / 1e3 for peer in everyone]  # s
    frames = [max(1, int(TURN / each)) for each in first]
    lengths = [count * each + REST for count, each in zip(frames, first, strict=True)]
    rounds = max(3, min(100, int(seconds / sum(lengths))))
    times: list[list[list[float]]] = [[] for _ in everyone]
    for number in range(rounds):
        order = range(len(everyone))
        for who in order if number % 2 == 0 else reversed(order):
            time.sleep(REST)
            warm = 1 if frames[who] > 1 else 0  # the frame that finds another peer's data in the caches does not count
            times[who].append(everyone[who].frames(frames[who] + warm)[warm:])
    return times


def rows_of(everyone: Sequence[Peer], times: list[list[list[float]]], base: benchmark.Row) -> list[benchmark.Row]:
    """A row for each peer; base: what their rows share."""
    medians = np.array([[statistics.median(frames) for frames in rounds] for rounds in times])  # [peer, round]
    rows = []
    for who, peer in enumerate(everyone):
        timing = summary([ms for frames in times[who] for ms in frames])
        low, middle, high = np.percentile(medians[who] / medians[0], [25, 50, 75])
        row = dataclasses.replace(base, renderer=peer.name, variant=peer.variant).timed(timing)
        if who > 0:
            row.peak_mib = None
            if peer.name != "plain":
                row.isa, row.precision = "", ""
            row.ratio, row.ratio_p25, row.ratio_p75 = float(middle), float(low), float(high)
        rows.append(row)
    return rows


def start(name: str, threads: int, variant: str) -> Peer | None:
    """A peer by name, or None (and why, on the screen) where it is not installed. variant: bigtri's."""
    if name == "plain":
        return Plain(threads, variant)
    if name == "llvmpipe":
        try:
            peer = LlvmpipePeer(threads)
        except RuntimeError as error:
            print(error)
            return None
        print(f"# {peer.renderer}, {threads} threads")
        return peer
    if not peer_python.available(name):
        print(f"{name}: not installed")
        return None
    return peer_python.PythonPeer(name)


def case(
    mine: Bigtri, others: Sequence[Peer], floor: memory_floor.Floor, name: str, width: int, height: int, seconds: float
) -> list[benchmark.Row]:
    """Runs one case and prints a line for each peer."""
    everyone: list[Peer] = [mine, *others]
    threads = mine.threads
    for peer in everyone:
        peer.load(name, width, height)
    job = mine.job
    with setting(threads):
        peak = peak_mib(job.draw)
        base = dataclasses.replace(
            job.row(threads, native.isa()), fragments=job.fragments(), covered_px=job.covered_px(), peak_mib=peak
        )
    floor.load(width, height)
    *times, filling = take_turns([*everyone, floor], seconds)
    base.floor_ms = statistics.median(min(frames) for frames in filling)
    rows = rows_of(everyone, times, base)
    expected = mine.ids()
    for peer, row in zip(everyone, rows, strict=True):
        line = f"{name:14} {f'{width}x{height}':>10} {threads:7} {peer.name:>9} {row.ms_median:10.3f} {row.ms_min:9.3f}"
        line += f" {base.floor_ms:9.3f}"
        if row.ratio is not None:
            other = peer.ids()
            row.uncovered_px = int(((other >= 0) != (expected >= 0)).sum())
            line += f" {row.ratio:7.2f} ({row.ratio_p25:.2f} to {row.ratio_p75:.2f})"
            line += f"  {row.uncovered_px}/{int((other != expected).sum())}  {row.variant}"
        print(line, flush=True)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--real", action="store_true", help="by default the real scenes, also at 256x256 and 640x480")
    parser.add_argument("--scenes", help=f"default {scenes.DEFAULT}, or {','.join(scenes.REAL)}")
    parser.add_argument("--size", type=option_types.listed(option_types.size), help="default 1080p,4k")
    parser.add_argument("--threads", type=option_types.listed(option_types.count), default="1,2", help="default 1,2")
    parser.add_argument("--variant", default="auto", help="bigtri's variant (default auto)")
    parser.add_argument("--peers", help=f"of {', '.join(PEERS)} (default llvmpipe, with --real also plain; Python's S1 to S3)")
    parser.add_argument(
        "--seconds", type=option_types.seconds, default=3.0, help="time for each case, all peers together (default 3)"
    )
    parser.add_argument("--csv", metavar="FILE", type=option_types.csv_file, help="write the rows there")
    arguments = parser.parse_args()
    peer_names = "plain,llvmpipe" if arguments.real else "llvmpipe"
    names = [name for name in (peer_names if arguments.peers is None else arguments.peers).split(",") if name]
    if unknown := [name for name in names if name not in PEERS]:
        parser.error(f"no peer {', '.join(unknown)}; there are {', '.join(PEERS)}")

    try:
        scene_names = arguments.scenes or (",".join(scenes.REAL) if arguments.real else scenes.DEFAULT)
        chosen = option_types.chosen("scene", scene_names, list(scenes.SCENES))
    except ValueError as error:
        parser.error(str(error))
    sizes = arguments.size or [option_types.size(size) for size in (REAL_SIZES if arguments.real else SIZES)]

    print(f"{provenance.device()}; {provenance.versions()}; {provenance.commit()}; {native.isa()}")
    rows: list[benchmark.Row] = []
    for threads in arguments.threads:
        torch.set_num_threads(threads)
        peers = [peer for name in names if (peer := start(name, threads, arguments.variant))]
        floor = memory_floor.Floor(threads)
        print(f"{'scene':14} {'size':>10} {'threads':>7} {'renderer':>9} {'median ms':>10} {'min':>9} {'floor':>9} ", end="")
        print("their time / bigtri's (quartiles)  px: coverage/id differs")
        for (width, height), name in itertools.product(sizes, chosen):
            able = [peer for peer in peers if not isinstance(peer, peer_python.PythonPeer) or name in peer_python.SCENES]
            rows += case(Bigtri(threads, arguments.variant), able, floor, name, width, height, arguments.seconds)
            if arguments.csv:
                benchmark.write_csv(arguments.csv, rows)  # after each case: an interrupted run keeps what it has
        floor.close()
        for peer in peers:
            peer.close()


if __name__ == "__main__":
    main()

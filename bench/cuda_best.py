"""What "auto" chooses against the best of all variants and settings, for every scene, size and batch.

A fixed way is a variant, or one with parameters: those of `cuda_cases.SETTINGS` that the extension has, and those of
`--setting`. Each way draws a few frames; what takes more than twice as long as the fastest has lost, and the others and
auto take turns by graph replay (cuda_clock.py), so that their times can be compared. Images are compared with the CPU's,
bit for bit. A case is marked where auto takes more than 1.1 times as long as the best way, and more than 1 us longer.

    python bench/cuda_best.py --csv build/gpu/cuda_best.csv
    python bench/cuda_best.py --scenes R4k --batches none --setting two_stage:widest=64 --setting bin_owned:few=0,share=16
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from functools import partial
from typing import NamedTuple

import cuda_cases
import cuda_clock
import cuda_floor
import numpy as np
import torch
from cuda_cases import AUTO, Case, Way
from cuda_clock import Call, Clock, Job, Machine, Row, text_of

from bigtri import native
from bigtri.app import arguments as option_types
from bigtri.precision import DEFAULT
from bigtri.study import benchmark

MEMSET = "memset"
LIMIT = 100_000  # us: what takes longer is not tried again
LOST = 2  # times the fastest fixed way: what takes longer does not take turns
ALLOWED = (1.1, 1.0)  # times, and us above, the best way's time that auto may take


class Verdict(NamedTuple):
    """One case: auto and the best of the fixed ways, us."""

    job: Job
    auto: float
    best: float
    name: str
    ratio: float  # auto over the best way in the same rounds: the median of the rounds
    low: float  # its quartiles
    high: float
    memset: float | None

    @property
    def marked(self) -> bool:
        times, above = ALLOWED
        return self.ratio > times and (self.ratio - 1) * self.best > above

    def line(self) -> str:
        text = (
            f"{self.job.scene:14} {self.job.size:>11} {text_of(self.memset):>7} {text_of(self.auto):>8} {text_of(self.best):>8} "
        )
        text += f"{self.ratio:6.3f} ({self.low:.3f} to {self.high:.3f})  {self.name}"
        if self.job.views > 1:
            text += f"  {self.job.views / self.auto * 1e6:,.0f} images/s"
        return text + ("  <-- NOT THE BEST" if self.marked else "")


HEADER = (
    f"{'scene':14} {'size':>11} {MEMSET:>7} {'auto us':>8} {'best us':>8} {'auto/best (quartiles)':>23}  best of the fixed ways"
)


def verdict(job: Job, times: dict[str, list[list[float]]]) -> Verdict | None:
    """times: us [way][round][repeat]; None without auto or without another way."""
    medians = {name: np.array([statistics.median(each) for each in rounds]) for name, rounds in times.items()}  # [round]
    us = {name: statistics.median(sum(rounds, [])) for name, rounds in times.items()}
    fixed = [name for name in us if name not in (AUTO.name, MEMSET)]
    if AUTO.name not in us or not fixed:
        return None
    best = min(fixed, key=us.__getitem__)
    low, middle, high = np.percentile(medians[AUTO.name] / medians[best], [25, 50, 75])
    return Verdict(job, us[AUTO.name], us[best], best, float(middle), float(low), float(high), us.get(MEMSET))


class Contest:
    """Measures cases and keeps rows and verdicts."""

    def __init__(self, clock: Clock, floor: cuda_floor.Floor | None, where: Machine, ways: list[Way], seconds: float) -> None:
        self.clock, self.floor, self.where, self.ways, self.seconds = clock, floor, where, ways, seconds
        self.rows: list[Row] = []
        self.verdicts: list[Verdict] = []
        self.failures: list[str] = []

    def case(self, case: Case) -> None:
        replays, first = self.heats(case)
        if AUTO.name not in first:
            return  # a failure says why
        fastest = min((us for name, us in first.items() if name != AUTO.name), default=0.0)
        running = {name: replay for name, replay in replays.items() if name == AUTO.name or first[name] <= LOST * fastest}
        if self.floor:
            running[MEMSET] = self.clock.replay(partial(self.floor.memset, case.packed))
        times = cuda_clock.take_turns(self.clock, running, self.seconds)
        wrong = {name: case.wrong_pixels(replay) for name, replay in replays.items()}
        for name in replays | running:
            us = sum(times[name], []) if name in times else [first[name]]
            self.rows.append(cuda_clock.row_of(case.job, name, len(case.triangles), "graph", us, wrong.get(name), self.where))
        if found := verdict(case.job, times):
            self.verdicts.append(found)

    def heats(self, case: Case) -> tuple[dict[str, Call], dict[str, float]]:
        """A replay of each way, and about how many us it takes."""
        replays: dict[str, Call] = {}
        first: dict[str, float] = {}
        for way in self.ways:
            if len(case.triangles) > way.most:
                continue
            call = partial(case.draw, way.variant)
            try:
                with way.setting():
                    call()
                    if self.clock.once(call) > LIMIT and way != AUTO:
                        continue
                    replays[way.name] = self.clock.replay(call)
                first[way.name] = statistics.median(self.clock.times(replays[way.name], 3))
            except RuntimeError as error:
                replays.pop(way.name, None)
                self.failures.append(f"{case.job} {way.name}: {str(error).splitlines()[0]}")
                if torch.cuda.is_available():
                    torch.cuda.synchronize()  # raises again if the device is lost
        return replays, first

    def wrong(self) -> int:
        return sum(row.wrong_pixels or 0 for row in self.rows)


def all_ways(kind: str, more: list[Way]) -> list[Way]:
    """auto, the variants that it is not, and settings; on a kind of device."""
    variants = native.REGISTRY[kind][DEFAULT]
    _, *others = variants  # auto is the first one under another name
    return [AUTO, *(Way(name, "", {}) for name in others), *cuda_cases.ways((*cuda_cases.SETTINGS, *more), variants)]


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    cuda_cases.add_cases(parser)
    parser.add_argument(
        "--setting",
        type=cuda_cases.way,
        action="append",
        default=[],
        metavar="VARIANT:NAME=VALUE,...",
        help="one more way; may be repeated",
    )
    parser.add_argument("--seconds", type=option_types.seconds, default=0.15, help="turns of each case (default 0.15)")
    parser.add_argument("--total", type=option_types.seconds, default=200, help="s for all (default 200)")
    parser.add_argument("--csv", metavar="FILE", type=option_types.csv_file, help="write the rows there")
    parser.add_argument("--dry-run", action="store_true", help="on the CPU by the host's clock: does it run?")
    arguments = parser.parse_args(argv)
    end = time.perf_counter() + arguments.total
    device = cuda_cases.device_for(arguments.dry_run)
    maker = cuda_cases.maker_for(arguments)
    jobs = cuda_cases.jobs(arguments, maker)
    where = cuda_clock.machine()
    print(cuda_clock.headline(where))
    ways = all_ways(device.type, arguments.setting)
    contest = Contest(cuda_clock.clock_for(device), cuda_cases.start_floor(device), where, ways, arguments.seconds)

    print(HEADER, flush=True)
    for job, given in cuda_cases.made(jobs, maker, end):
        before = len(contest.verdicts)
        try:
            contest.case(Case(job, given, device))
        except RuntimeError as error:
            contest.failures.append(f"{job}: {str(error).splitlines()[0]}; nothing after it was measured")
            break
        for found in contest.verdicts[before:]:
            print(found.line(), flush=True)
        if arguments.csv:
            benchmark.write_csv(arguments.csv, contest.rows, cuda_clock.DIGITS)
        if device.type == "cuda":
            torch.cuda.empty_cache()
    for failure in contest.failures:
        print("FAILED", failure)
    marked = [found for found in contest.verdicts if found.marked]
    print(f"{len(contest.verdicts)} cases; {contest.wrong()} wrong pixels; {len(contest.failures)} failures; ", end="")
    print(f"auto is behind the best by more than 10 % and 1 us in {len(marked)}", end="")
    print(":" + "".join(f"\n  {found.line()}" for found in marked) if marked else "")
    return 1 if contest.wrong() or contest.failures or not contest.verdicts else 0


if __name__ == "__main__":
    sys.exit(main())

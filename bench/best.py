"""What "auto" chooses against the best of all variants and settings, for every scene, size and batch.

A fixed way is a variant, or one with parameters: on CUDA those of `cuda_cases.SETTINGS` that the extension has, on the CPU
every parameter at a quarter and at four times its standard value, and those of `--setting`. Each way draws a few frames; what
takes more than twice as long as the fastest has lost, and the others and auto take turns (cuda_clock.py; on CUDA by graph
replay), so that their times can be compared. Images are compared with the CPU's, bit for bit. A case is marked where auto
takes more than 1.1 times as long as the best way, and more than 1 us longer. Of many ways that are alike one is always ahead
by chance: auto and all that are ahead by 10 % then take turns once more, four times as long, and only these second turns count.

    python bench/best.py --csv build/gpu/cuda_best.csv
    python bench/best.py --unchosen 100 --total 300       # meshes, cameras, sizes and batches at random (unchosen.py)
    python bench/best.py --scenes R4k --batches none --setting two_stage:widest=64 --setting bin_owned:few=0,share=16
    python bench/best.py --device cpu --batches none --csv bench/results/best_cpu.csv
    python bench/best.py --device cpu --batches none --model duck.glb bunny.ply --csv bench/results/best_models_cpu.csv
    python bench/best.py --device cpu --rows bench/results/best*_cpu.csv --docs docs/variants.md      # tables alone
    python bench/best.py --device cpu --batches none --tuning tuning.json
"""

from __future__ import annotations

import argparse
import dataclasses
import statistics
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cuda_cases
import cuda_clock
import cuda_floor
import markdown
import numpy as np
import torch
import unchosen
from cuda_cases import AUTO, Case, Way
from cuda_clock import Call, Clock, Job, Machine, text_of

import bigtri
from bigtri import native
from bigtri.app import arguments as option_types
from bigtri.precision import DEFAULT
from bigtri.study import benchmark, tune

MEMSET = "memset"
LIMIT = 100_000  # us: what takes longer is not tried again
LOST = 2  # times the fastest fixed way: what takes longer does not take turns
HOPELESS = 5  # times the fastest way before: of a variant that takes longer no parameters are tried
ALLOWED = (1.1, 1.0)  # times, and us above, the best way's time that auto may take
AGAIN = 4  # times the rounds, of the ways that are further ahead


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
            f"{self.job.scene:20} {self.job.size:>13} {text_of(self.memset):>7} {text_of(self.auto):>8} {text_of(self.best):>8} "
        )
        text += f"{self.ratio:6.3f} ({self.low:.3f} to {self.high:.3f})  {self.name}"
        if self.job.views > 1:
            text += f"  {self.job.views / self.auto * 1e6:,.0f} images/s"
        return text + ("  <-- NOT THE BEST" if self.marked else "")


HEADER = (
    f"{'scene':20} {'size':>13} {MEMSET:>7} {'auto us':>8} {'best us':>8} {'auto/best (quartiles)':>23}  best of the fixed ways"
)


Times = dict[str, list[list[float]]]  # us [way][round][repeat]
Ratio = tuple[float, float, float]  # auto's time over a way's in the same rounds: the lower quartile, the median, the upper one


@dataclasses.dataclass
class Row(cuda_clock.Row):
    """A way in a case, and auto's time over this one's in the same rounds: the median of the rounds, and its quartiles."""

    ratio: float | None = None  # None for auto, and for what took no turns
    ratio_p25: float | None = None
    ratio_p75: float | None = None
    turns: int | None = None  # which ones these times are of: 1, or 2; None: none


def ratios(times: Times) -> dict[str, Ratio]:
    """Of all ways but auto; none without auto."""
    per_round = {name: np.array([statistics.median(each) for each in rounds]) for name, rounds in times.items()}
    auto = per_round.pop(AUTO.name, None)
    if auto is None:
        return {}
    found = {name: np.percentile(auto / way, [25, 50, 75]) for name, way in per_round.items()}
    return {name: (float(low), float(middle), float(high)) for name, (low, middle, high) in found.items()}


def verdict(job: Job, times: Times, memset: list[list[float]] | None = None) -> Verdict | None:
    """None without auto or without another way. memset: its times, if they are of other turns."""
    us = {name: statistics.median(sum(rounds, [])) for name, rounds in times.items()}
    over = ratios(times)
    best = min((name for name in over if name != MEMSET), key=us.__getitem__, default=None)
    if best is None:
        return None
    low, middle, high = over[best]
    floor = statistics.median(sum(memset, [])) if memset else us.get(MEMSET)
    return Verdict(job, us[AUTO.name], us[best], best, middle, low, high, floor)


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
        first_turns = cuda_clock.take_turns(self.clock, running, self.seconds)
        second = self.second_turns(case.job, running, first_turns)
        times, over = first_turns | second, ratios(first_turns) | ratios(second)
        wrong = {name: case.wrong_pixels(replay) for name, replay in replays.items()}
        for name in replays | running:
            us = sum(times[name], []) if name in times else [first[name]]
            method = "graph" if case.packed.is_cuda else "wall"
            row = cuda_clock.row_of(case.job, name, len(case.triangles), method, us, wrong.get(name), self.where)
            low, middle, high = over.get(name, (None, None, None))
            turns = 2 if name in second else 1 if name in times else None
            self.rows.append(Row(**vars(row), ratio=middle, ratio_p25=low, ratio_p75=high, turns=turns))
        if found := verdict(case.job, second or first_turns, first_turns.get(MEMSET)):
            self.verdicts.append(found)

    def second_turns(self, job: Job, running: Mapping[str, Call], first: Times) -> Times:
        """Of auto and the ways that are ahead of it, where it is behind by more than it may; else empty."""
        found = verdict(job, first)
        if not found or not found.marked:
            return {}
        ahead = [name for name, (_, middle, _) in ratios(first).items() if middle > ALLOWED[0] and name != MEMSET]
        again = {name: running[name] for name in (AUTO.name, *ahead)}
        return cuda_clock.take_turns(self.clock, again, AGAIN * self.seconds, AGAIN * cuda_clock.ROUNDS)

    def heats(self, case: Case) -> tuple[dict[str, Call], dict[str, float]]:
        """A replay of each way, and about how many us it takes."""
        replays: dict[str, Call] = {}
        too_slow: set[str] = set()
        first: dict[str, float] = {}
        for way in self.ways:
            hopeless = first.get(way.variant, 0) > HOPELESS * min(first.values(), default=0) or way.variant in too_slow
            if len(case.triangles) > way.most or (way.parameters and hopeless):
                continue
            call = partial(case.draw, way.variant)
            try:
                with way.setting():
                    call()
                    if self.clock.once(call) > LIMIT and way != AUTO and first:
                        too_slow.add(way.name)
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


def all_ways(kind: str, more: list[Way], tuned: bool = False) -> list[Way]:
    """auto, the variants that it is not, and settings; on a kind of device. tuned: auto goes by a file of `bigtri tune`."""
    variants = native.REGISTRY[kind][DEFAULT]
    others = list(variants)[0 if tuned else 1 :]  # auto is the first one under another name
    settings = cuda_cases.SETTINGS if kind == "cuda" else steps(variants)
    return [AUTO, *(Way(name, "", {}) for name in others), *cuda_cases.ways((*settings, *more), variants)]


def steps(variants: Mapping[str, native.Variant]) -> tuple[Way, ...]:
    """One step from the standard in one parameter: the values that it allows, or four times as much and a quarter."""
    found = []
    for variant in variants.values():
        for parameter in variant.parameters.values():
            for values in tune.lines(parameter, parameter.standard):
                found += [Way(variant.name, f"{parameter.name}={value}", {parameter.name: value}) for value in values[:1]]
    return tuple(found)


# --- a page's tables, from the rows


def from_rows(rows: Iterable[Mapping[str, str]]) -> list[Verdict]:
    """Verdicts of a CSV's rows: of the last turns that auto took. Files that have no ratios give those of the medians.

    Raises:
        SystemExit: the rows are another script's.
    """
    cases: dict[Job, dict[str, Mapping[str, str]]] = {}
    found = []
    try:
        for row in rows:
            job = Job(row["scene"], *(int(row[name]) for name in ("width", "height", "seed", "views")))
            cases.setdefault(job, {})[row["variant"]] = row
        for job, ways in cases.items():
            us = {name: float(row["us_median"]) for name, row in ways.items()}
            last = ways.get(AUTO.name, {}).get("turns")
            rivals = [name for name, row in ways.items() if name not in (AUTO.name, MEMSET) and row.get("turns") == last]
            best = min(rivals, key=us.__getitem__, default="")
            if not best or AUTO.name not in us:
                continue
            plain = us[AUTO.name] / us[best]
            ratio, low, high = (float(ways[best].get(name) or plain) for name in ("ratio", "ratio_p25", "ratio_p75"))
            found.append(Verdict(job, us[AUTO.name], us[best], best, ratio, low, high, us.get(MEMSET)))
    except (KeyError, ValueError) as error:
        raise SystemExit(f"--rows: no rows of this script: {error!r}") from None
    return found


def page(verdicts: Sequence[Verdict], rows: Sequence[Mapping[str, str]]) -> str:
    """auto's us and its ratio to the best fixed way: a scene a line, a size or a batch a column."""
    times, above = ALLOWED
    whence = ("{device}; torch {torch}; commit {commit}: `{command}`.".format(**row) for row in rows)
    behind = [found for found in verdicts if found.marked]
    named = "; ".join(f"{v.job}: {text_of(v.auto)} against {text_of(v.best)} ({v.name}, {v.ratio:.2f})" for v in behind)
    text = f"Within {(times - 1) * 100:.0f} % or {above:g} us of the best fixed way in {len(verdicts) - len(behind)} of "
    text += f"{len(verdicts)} cases." + (f" The others, us: {named}." if behind else "")
    parts = [*(markdown.wrapped(each) for each in dict.fromkeys(whence)), markdown.wrapped(text)]
    for some in ([v for v in verdicts if v.job.views == 1], [v for v in verdicts if v.job.views > 1]):
        sizes = list(dict.fromkeys(v.job.size for v in some))
        cells = {(v.job.scene, v.job.size): f"{text_of(v.auto)} ({v.ratio:.2f})" for v in some}
        lines = [[s, *(cells.get((s, size), "-") for size in sizes)] for s in dict.fromkeys(v.job.scene for v in some)]
        parts += [markdown.table(["auto, us (over the best)", *sizes], lines)] if some else []
    return "\n\n".join(parts)


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    cuda_cases.add_cases(parser)
    parser.add_argument(
        "--unchosen", type=option_types.whole(1), metavar="COUNT", help="so many cases at random of each seed, instead of scenes"
    )
    cuda_cases.add_setting(parser, "one more way; may be repeated")
    parser.add_argument("--seconds", type=option_types.seconds, default=0.15, help="turns of each case (default 0.15)")
    parser.add_argument("--total", type=option_types.seconds, default=200, help="s for all (default 200)")
    parser.add_argument("--csv", metavar="FILE", type=option_types.csv_file, help="write the rows there")
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cuda", help="where to draw (default %(default)s)")
    parser.add_argument("--tuning", type=Path, metavar="FILE", help="let auto go by what bigtri tune has written there")
    parser.add_argument("--rows", type=Path, nargs="+", metavar="FILE", help="take the rows from there and measure nothing")
    parser.add_argument("--docs", type=Path, metavar="PAGE", help="put the tables there, between their markers")
    arguments = parser.parse_args(argv)
    if arguments.rows:
        return from_files(arguments)
    end = time.perf_counter() + arguments.total
    device = cuda_cases.device_for(arguments.device == "cpu")
    if arguments.tuning:
        print(f"{bigtri.use_tuning(arguments.tuning)} classes of calls in {arguments.tuning}")
    maker = cuda_cases.maker_for(arguments)
    if arguments.unchosen:
        cases = unchosen.made(arguments.unchosen, arguments.seeds, maker, end)
    else:
        cases = cuda_cases.made(cuda_cases.jobs(arguments, maker), maker, end)
    where = cuda_clock.machine(device.type)
    print(cuda_clock.headline(where))
    ways = all_ways(device.type, arguments.setting, tuned=arguments.tuning is not None)
    contest = Contest(cuda_clock.clock_for(device), cuda_cases.start_floor(device), where, ways, arguments.seconds)

    print(HEADER, flush=True)
    for job, given in cases:
        before = len(contest.verdicts)
        try:
            contest.case(Case(job, given, device))
        except RuntimeError as error:
            contest.failures.append(f"{job}: {str(error).splitlines()[0]}; nothing after it was measured")
            break
        for found in contest.verdicts[before:]:
            print(found.line(), flush=True)
        if arguments.csv:
            benchmark.write_csv(arguments.csv, contest.rows)
        if device.type == "cuda":
            torch.cuda.empty_cache()
    if arguments.docs:
        as_text = [{field.name: str(getattr(row, field.name)) for field in dataclasses.fields(row)} for row in contest.rows]
        markdown.paste(arguments.docs, f"best {arguments.device}", page(contest.verdicts, as_text))
    for failure in contest.failures:
        print("FAILED", failure)
    marked = [found for found in contest.verdicts if found.marked]
    print(f"{len(contest.verdicts)} cases; {contest.wrong()} wrong pixels; {len(contest.failures)} failures; ", end="")
    print(f"auto is behind the best by more than 10 % and 1 us in {len(marked)}", end="")
    print(":" + "".join(f"\n  {found.line()}" for found in marked) if marked else "")
    return 1 if contest.wrong() or contest.failures or not contest.verdicts else 0


def from_files(arguments: argparse.Namespace) -> int:
    """Verdicts of CSVs, on the screen and on a page."""
    rows = [row for path in arguments.rows for row in benchmark.read_csv(path)]
    verdicts = from_rows(rows)
    print(HEADER, *(found.line() for found in verdicts), sep="\n")
    if arguments.docs:
        markdown.paste(arguments.docs, f"best {arguments.device}", page(verdicts, rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())

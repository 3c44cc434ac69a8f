"""Every variant on every scene at every size: time, work, and what a unit of work costs. Makes the tables of docs/variants.md.

Variants and their parameters are those of the registry. In each case (scene and size) they take turns, in every round in an
order of its own; what takes longer than `SLOW` draws twice, and its time is that of the second frame. All images are
compared in bits. On the CPU the build that counts says how much work each does (docs/variants.md).

From times and counters follows what each variant pays for a unit of work: the non-negative costs, the same in all cases, that
come nearest to its times in proportion. The fit is tried on each scene with the costs of all other scenes. `--predict`
says with them which variant wins on a scene that is not in the report, and measures it only then.

    python bench/variants.py --csv bench/results/variants_cpu.csv --docs docs/variants.md
    python bench/variants.py --rows bench/results/variants_cpu.csv --docs docs/variants.md      # tables alone
    python bench/variants.py --rows bench/results/variants_cpu.csv --predict Rroom --size 1080p
    python bench/variants.py --device cuda --csv build/gpu/variants.csv
"""

from __future__ import annotations

import argparse
import csv
import itertools
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import markdown
import numpy as np
import scipy.optimize
import torch
from numpy.typing import NDArray

from bigtri import native
from bigtri.app import arguments as option_types
from bigtri.check import counters
from bigtri.ops.rasterize import rasterize
from bigtri.precision import DEFAULT
from bigtri.study import clock, provenance, scenes, tune

# Rroom and R16k are left for predictions.
SCENES = "R4k,R16k-close,R16k-far,R100k,R100k-shuffled,R1M,Rcourtyard,Rterrain,S1,S2,S3,S4f,S4b,S5,S6-200k,S7"
SIZES = "256x256,640x480,1080p,4k"
SHOWN = "R16k-close,R100k,S2,S3,S4b,S5"  # scenes whose work is shown
SWEPT = "R100k,S2,S5"  # scenes on which parameters are swept
SIZE = (1920, 1080)  # of both
SLOW = 0.25  # s
STANDARD = "standard"
WORK = ("entries", "bytes", "tiles_tested", "tiles_empty", "edges_64", "edges_32", "rows", "fragments", "passed", "atomics")
# What a variant may have to pay for; pixels and triangles are not counted, but known.
PAID = (
    "pixels",
    "triangles",
    "records",
    "entries",
    "tiles_tested",
    "edges_64",
    "edges_32",
    "rows",
    "fragments",
    "passed",
    "atomics",
)


class Key(NamedTuple):
    scene: str
    width: int  # px
    height: int  # px

    @property
    def size(self) -> str:
        return f"{self.width}x{self.height}"


class Row(NamedTuple):
    """One way in one case."""

    key: Key
    triangles: int
    variant: str
    parameters: str  # "share=64", or "standard" where others were tried in turn with it; else empty
    timing: clock.Timing
    equal: bool  # to the first variant's image, in bits
    counters: Mapping[str, int]  # none where nothing was counted
    where: Mapping[str, str]

    @property
    def us(self) -> float:
        return self.timing.median * 1e3

    def paid(self) -> list[int]:
        known = {"pixels": self.key.width * self.key.height, "triangles": self.triangles}
        return [(known | dict(self.counters)).get(name, 0) for name in PAID]


# --- measuring


class Case:
    """A scene on a device, and an image."""

    def __init__(self, key: Key, device: str) -> None:
        self.key, self.device = key, device
        self.scene = scenes.make(*key)
        self.positions, self.triangles = (torch.from_numpy(array).to(device) for array in self.scene)
        self.size = key.height, key.width
        self.packed = torch.empty(self.size, dtype=torch.int64, device=device)

    def draw(self, setting: tune.Setting) -> None:
        rasterize(
            self.positions,
            self.triangles,
            self.size,
            backend="native",
            variant=setting.variant,
            parameters=dict(setting.parameters),
            depth=False,
            out=self.packed,
        )

    def measure(
        self, settings: Sequence[tune.Setting], seconds: float, where: Mapping[str, str], count: bool, standard: str = ""
    ) -> list[Row]:
        """seconds: of the clock, for each setting; standard: what the rows call the parameters of a setting without any."""
        expected = None
        equal: dict[tune.Setting, bool] = {}
        slow: dict[tune.Setting, clock.Timing] = {}
        for setting in settings:
            self.packed.fill_(-1)
            self.draw(setting)
            expected = self.packed.clone() if expected is None else expected
            equal[setting] = torch.equal(self.packed, expected)
            self.finish()
            start = time.perf_counter()
            self.draw(setting)
            self.finish()
            if (once := time.perf_counter() - start) > SLOW:
                slow[setting] = clock.summary([once * 1e3])
        quick = [setting for setting in settings if setting not in slow]
        calls = {str(number): partial(self.draw, setting) for number, setting in enumerate(quick)}
        ms = clock.interleaved(calls, seconds * len(quick), 7, device=self.device)
        timings = slow | {setting: clock.summary(ms[str(number)]) for number, setting in enumerate(quick)}
        return [
            Row(
                self.key,
                len(self.scene.triangles),
                setting.variant,
                " ".join(f"{name}={value}" for name, value in setting.parameters) or standard,
                timings[setting],
                equal[setting],
                self.counted(setting) if count else {},
                where,
            )
            for setting in settings
        ]

    def counted(self, setting: tune.Setting) -> dict[str, int]:
        parameters = dict(setting.parameters)
        return counters.count(*self.scene, self.size, variant=setting.variant, backend="native", parameters=parameters)

    def finish(self) -> None:
        if self.device == "cuda":
            torch.cuda.synchronize()


def steps(parameter: native.Parameter) -> list[int]:
    """Values to sweep: those allowed, or up to two steps of a factor of four to either side of the standard one."""
    up_and_down = tune.lines(parameter, parameter.standard)
    return sorted({parameter.standard, *itertools.chain(*(values[:2] for values in up_and_down))})


def sweep(variants: Mapping[str, native.Variant]) -> list[tune.Setting]:
    """The standard settings, and each parameter's other values."""
    found = []
    for name, variant in variants.items():
        start = tune.Setting(name)
        found.append(start)
        for parameter in variant.parameters.values():
            found += [start.changed(parameter, value) for value in steps(parameter) if value != parameter.standard]
    return found


# --- rows in a file


def write(path: Path, rows: Sequence[Row]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        timing = [f"ms_{name}" if name != "repeats" else name for name in clock.Timing._fields]
        writer.writerow([*Key._fields, "triangles", "variant", "parameters", *timing, "equal", *native.COUNTERS, *rows[0].where])
        for row in rows:
            *ms, repeats = row.timing
            times = [*(f"{value:.4f}" for value in ms), repeats, int(row.equal)]
            counts = [row.counters.get(name, "") for name in native.COUNTERS]
            writer.writerow([*row.key, row.triangles, row.variant, row.parameters, *times, *counts, *row.where.values()])


def read(path: Path) -> list[Row]:
    """
    Raises:
        SystemExit: the file is another one's.
    """
    rows = []
    with path.open(newline="") as file:
        for one in csv.DictReader(file):
            try:
                key = Key(one["scene"], int(one["width"]), int(one["height"]))
                median, minimum, p25, p75 = (float(one[f"ms_{name}"]) for name in clock.Timing._fields[:-1])
                timing = clock.Timing(median, minimum, p25, p75, int(one["repeats"]))
                counts = {name: int(one[name]) for name in native.COUNTERS if one.get(name)}
                where = {name: one[name] for name in ("device", "how", "versions", "commit", "command")}
                shared = int(one["triangles"]), one["variant"], one["parameters"], timing, one["equal"] == "1", counts, where
            except (KeyError, TypeError, ValueError) as error:
                raise SystemExit(f"{path}: no rows of this script: {error!r}") from None
            rows.append(Row(key, *shared))
    return rows


# --- what a unit of work costs


class Costs(NamedTuple):
    """Of one variant, ns for each of `PAID`."""

    ns: NDArray[np.float64]

    def us(self, row: Row) -> float:
        return float(self.ns @ np.array(row.paid(), float)) / 1e3


def fit(rows: Iterable[Row]) -> Costs:
    """The costs that come nearest to the rows' times, each error in proportion to the time."""
    counts = np.array([row.paid() for row in rows], float)
    us = np.array([row.us for row in rows])
    found, _ = scipy.optimize.nnls(counts / (us * 1e3)[:, None], np.ones(len(us)))
    return Costs(found)


class Check(NamedTuple):
    """How good the costs are on scenes that they were not fitted to."""

    errors: dict[str, float]  # of each variant: the median of the factors by which a time is off
    winners: int  # cases whose fastest variant is named
    cases: int
    ordered: int  # pairs of variants, a case each, that are named in the order of their times
    pairs: int  # of which one takes more than 1.1 times as long as the other


def check(rows: Sequence[Row]) -> Check:
    factors: dict[str, list[float]] = {}
    winners = ordered = pairs = 0
    cases = by_case(rows)
    for left_out in dict.fromkeys(row.key.scene for row in rows):
        rest = by_variant(row for row in rows if row.key.scene != left_out)
        costs = {variant: fit(of_it) for variant, of_it in rest.items()}
        for key, of_case in cases.items():
            if key.scene != left_out:
                continue
            said = {row.variant: costs[row.variant].us(row) for row in of_case}
            was = {row.variant: row.us for row in of_case}
            for variant in said:
                factors.setdefault(variant, []).append(max(said[variant] / was[variant], was[variant] / said[variant]))
            winners += min(said, key=said.__getitem__) == min(was, key=was.__getitem__)
            for a, b in itertools.permutations(was, 2):
                if was[b] > 1.1 * was[a]:
                    pairs += 1
                    ordered += said[b] > said[a]
    errors = {variant: float(np.median(values)) for variant, values in factors.items()}
    return Check(errors, winners, len(cases), ordered, pairs)


def by_case(rows: Iterable[Row]) -> dict[Key, list[Row]]:
    found: dict[Key, list[Row]] = {}
    for row in rows:
        found.setdefault(row.key, []).append(row)
    return found


def by_variant(rows: Iterable[Row]) -> dict[str, list[Row]]:
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(row.variant, []).append(row)
    return found


# --- tables


def text_of(value: float) -> str:
    """Three digits."""
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"


def many(count: int) -> str:
    """A count to three digits, in thousands or millions."""
    for unit, name in ((1e9, " G"), (1e6, " M"), (1e3, " k")):
        if count >= unit:
            return f"{count / unit:.3g}{name}"
    return str(count)


def times_table(rows: Sequence[Row], width: int, height: int) -> str:
    """The fastest variant's ms, and how many times as long each takes."""
    cases = [of_case for key, of_case in by_case(rows).items() if (key.width, key.height) == (width, height)]
    variants = list(by_variant(rows))
    lines = []
    for of_case in cases:
        ms = {row.variant: row.timing.median for row in of_case}
        best = min(ms.values())
        cells = (f"{text_of(ms[v] / best)}" if ms[v] > best else "**1**" for v in variants)
        lines.append([of_case[0].key.scene, text_of(best), *cells])
    return markdown.table([f"{width}x{height}", "fastest, ms", *variants], lines)


def work_table(of_case: Sequence[Row]) -> str:
    """A variant a line."""
    lines = []
    for row in of_case:
        load = counters.load(row.counters) if row.counters.get("tasks") else None
        counts = (many(row.counters.get(name, 0)) for name in WORK)
        lines.append([row.variant, text_of(row.timing.median), *counts, "" if load is None else text_of(load)])
    key = of_case[0].key
    return markdown.table([f"{key.scene}, {key.size}", "ms", *(f"`{name}`" for name in WORK), "load"], lines)


def costs_table(rows: Sequence[Row]) -> str:
    """ns for a unit of work, and how far off the costs of the other scenes are."""
    tried = check(rows)
    lines = []
    for variant, of_it in by_variant(rows).items():
        lines.append([variant, *(text_of(ns) if ns else "" for ns in fit(of_it).ns), f"{tried.errors[variant]:.2f}"])
    text = markdown.table(["ns for each", *PAID, "off by"], lines)
    return (
        f"{text}\n\nOn scenes that they were not fitted to, these costs name the fastest variant in {tried.winners} of "
        f"{tried.cases} cases, and the faster one of two variants that are more than 10 % apart in {tried.ordered} of "
        f'{tried.pairs} pairs. "Off by" is the median factor between a time and what the costs of the other scenes say.'
    )


def sweep_table(rows: Sequence[Row]) -> str:
    """Parameters: times the standard value's time, of each scene."""
    cases = by_case(rows)
    standard = {(row.key, row.variant): row.us for row in rows if row.parameters == STANDARD}
    settings: dict[tuple[str, str, int], list[str]] = {}
    for row in rows:
        if row.parameters != STANDARD:
            name, _, value = row.parameters.partition("=")
            ratio = row.us / standard[row.key, row.variant]
            settings.setdefault((row.variant, name, int(value)), []).append(text_of(ratio))
    lines = [[variant, f"`{name}`", value, *settings[variant, name, value]] for variant, name, value in sorted(settings)]
    return markdown.table(["variant", "parameter", "value", *(key.scene for key in cases)], lines)


def page(rows: Sequence[Row]) -> str:
    """The tables of docs/variants.md."""
    where = rows[0].where
    swept = [row for row in rows if row.parameters]
    standard = [row for row in rows if not row.parameters]
    parts = [f"{where['device']}; {where['how']}; {where['versions']}; commit {where['commit']}. `{where['command']}`"]
    parts += [f"### Time: the fastest variant, and how many times as long each takes{NOTE}"]
    sizes = dict.fromkeys((row.key.width, row.key.height) for row in standard)
    parts += [times_table(standard, *size) for size in sizes]
    if any(row.counters for row in standard):
        parts += ["### Work"]
        cases = by_case(standard)
        parts += [work_table(cases[key]) for key in cases if key[1:] == SIZE and key.scene in SHOWN.split(",")]
        parts += ["### What a unit of work costs", costs_table([row for row in standard if row.counters])]
    if swept:
        parts += ["### Parameters: times the time of the standard value", sweep_table(swept)]
    return "\n\n".join(parts)


NOTE = "\n\nMedians of rounds in which all take turns; what takes more than 0.25 s drew twice."


# --- predicting


def predict(rows: Sequence[Row], key: Key, seconds: float, where: Mapping[str, str]) -> str:
    """Says from the counters which variant wins, then measures."""
    if key.scene in {row.key.scene for row in rows}:
        raise SystemExit(f"--predict: {key.scene} is in the report, so nothing would be predicted")
    costs = {v: fit(of_it) for v, of_it in by_variant(r for r in rows if r.counters and not r.parameters).items()}
    variants = [variant for variant in native.VARIANTS["cpu"] if variant in costs]
    case = Case(key, "cpu")
    none = clock.Timing(0, 0, 0, 0, 0)
    blank = [
        Row(key, len(case.scene.triangles), variant, "", none, True, case.counted(tune.Setting(variant)), where)
        for variant in variants
    ]
    said = {row.variant: costs[row.variant].us(row) / 1e3 for row in blank}
    order = sorted(said, key=said.__getitem__)
    lines = [f"{key.scene} {key.size}, predicted: " + ", ".join(f"{variant} {text_of(said[variant])} ms" for variant in order)]
    print(lines[0], flush=True)
    found = {row.variant: row.timing.median for row in case.measure([tune.Setting(v) for v in variants], seconds, where, False)}
    order = sorted(found, key=found.__getitem__)
    lines.append(
        f"{key.scene} {key.size}, measured:  " + ", ".join(f"{variant} {text_of(found[variant])} ms" for variant in order)
    )
    print(lines[1], flush=True)
    return "\n".join(lines)


# --- the command


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--scenes", default=SCENES, help="names separated by commas, or all (default %(default)s)")
    parser.add_argument("--size", type=option_types.listed(option_types.size), default=SIZES, help="default %(default)s")
    parser.add_argument("--sweep", default=SWEPT, help="scenes on which parameters are swept, or none (default %(default)s)")
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="default %(default)s")
    parser.add_argument("--seconds", type=option_types.seconds, default=0.15, help="each variant, each case (default 0.15)")
    parser.add_argument("--no-counters", action="store_true", help="times alone")
    parser.add_argument("--csv", type=option_types.csv_file, metavar="FILE", help="write the rows there")
    parser.add_argument("--rows", type=Path, nargs="+", metavar="FILE", help="take the rows from there and measure nothing")
    parser.add_argument("--predict", metavar="SCENE", help="with --rows: say from the counters which variant wins, then measure")
    parser.add_argument("--docs", type=Path, metavar="PAGE", help="put the tables there, between their markers")
    options = parser.parse_args(argv)
    if options.predict and not options.rows:
        parser.error("--predict needs --rows")
    if options.device not in native.devices():
        parser.error(f"--device must be one of {', '.join(native.devices())}, as bigtri is built here, got {options.device}")
    try:
        names = option_types.chosen("scene", options.scenes, list(scenes.SCENES))
        swept = [] if options.sweep == "none" else option_types.chosen("scene", options.sweep, list(scenes.SCENES))
        predicted = option_types.chosen("scene", options.predict, list(scenes.SCENES)) if options.predict else []
    except ValueError as error:
        parser.error(str(error))
    how = f"{torch.get_num_threads()} threads, {native.isa()}" if options.device == "cpu" else "graph replay"
    where = {
        "device": provenance.device(options.device),
        "how": how,
        "versions": provenance.versions(),
        "commit": provenance.commit(),
        "command": provenance.command(),
    }
    if options.rows:
        rows = [row for path in options.rows for row in read(path)]
        if options.csv:
            write(options.csv, rows)
        for scene in predicted:
            for width, height in options.size:
                predict(rows, Key(scene, width, height), options.seconds, where)
    else:
        rows = measured(names, options.size, swept, options, where)
    if options.docs:
        markdown.paste(options.docs, f"variants {options.device}", page(rows))
    wrong = [row for row in rows if not row.equal]
    for row in wrong:
        print(f"NOT EQUAL: {row.key} {row.variant} {row.parameters}")
    return 1 if wrong else 0


def measured(
    names: Sequence[str], sizes: Sequence[tuple[int, int]], swept: Sequence[str], options: Any, where: Mapping[str, str]
) -> list[Row]:
    variants = native.REGISTRY[options.device][DEFAULT]
    standard = [tune.Setting(name) for name in variants]
    count = options.device == "cpu" and not options.no_counters
    todo = [(Key(name, *size), standard, count, "") for size in sizes for name in names]
    todo += [(Key(name, *SIZE), sweep(variants), False, STANDARD) for name in swept]
    rows: list[Row] = []
    for key, settings, counted, base in todo:
        try:
            case = Case(key, options.device)
        except ValueError as error:  # the image is too small for it
            print(f"{key.scene}: {error}")
            continue
        found = case.measure(settings, options.seconds, where, counted, base)
        rows += found
        fastest = sorted(found, key=lambda row: row.us)
        shown = ", ".join(f"{row.variant} {row.parameters}".strip() + f" {text_of(row.timing.median)}" for row in fastest[:12])
        print(f"{key.scene:14} {key.size:>9}, ms: {shown}", flush=True)
        if options.csv:
            write(options.csv, rows)
    return rows


if __name__ == "__main__":
    sys.exit(main())

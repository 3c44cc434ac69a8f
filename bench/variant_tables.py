"""The tables of docs/variants.md, from the rows of variants.py."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import markdown
import numpy as np
from numpy.typing import NDArray
from variant_cases import STANDARD
from variant_costs import PAID, check, fit, in_order, paid, winner
from variant_rows import PREDICTION, Key, Row, by_case, by_variant, many, text_of

from bigtri.check import counters
from bigtri.reference.variants import MODELS

SIZE = (1920, 1080)  # of what is not shown at every size
SHOWN = "R16k-close,R100k,S2,S3,S4b,S5"  # scenes whose work is shown
WORK = ("entries", "bytes", "tiles_tested", "tiles_empty", "edges_64", "edges_32", "rows", "fragments", "passed", "atomics")
APART = 1.1  # times another's time: what is nearer than that has no order
LEAST = 5  # percent of a time that a kind of work has to take to be named
MATTERS = 1.25  # times the time that another value takes: all values of such a parameter are shown
SWEPT = (
    "One parameter at a time, the others at their standard values: all values that it may have if they are few, else up to two "
    "steps of a factor of four to either side of the standard one."
)
IN_IMAGE = ("persistent", "patch=0")  # variant and setting
MEMORIES = (
    "`persistent` with a bin's pixels in the shared memory of the block that owns it, which stores them in the end, and with "
    "them in the image, in global memory. Queues, order of work and tests are the same; either way a pixel is read first and "
    "lowered by an atomic minimum."
)
MOTION = (
    "A camera goes around what it looks at, 3 degrees a frame, and draws every frame twice. The first time another camera's "
    "frame was drawn before (moving), so that queues, caches and branches have seen other triangles at other places; the second "
    "time the same one (still). The positions are written anew before either."
)
NOTE = "Medians of rounds in which all take turns; what takes more than {} s drew twice."


def page(rows: Sequence[Row], slow: float) -> str:
    """All tables. slow: s, beyond which something drew twice."""
    tables = {
        "scenes": scenes,
        "parameters": parameters,
        "distance": distance,
        "motion": motion,
        "stages": stages,
        PREDICTION: prediction,
    }
    text = []
    for part in tables:
        if of_part := [row for row in rows if row.part == part]:
            text += [tables[part](of_part)]
    whence = ("{device}; {how}; {versions}; commit {commit}: `{command}`.".format(**row.where) for row in rows)
    head = NOTE.format(slow)
    paragraphs = "\n\n".join([*dict.fromkeys(whence), head, *text]).split("\n\n")
    return "\n\n".join(p if p.startswith(("|", "#")) else markdown.wrapped(p) for p in paragraphs)


def scenes(rows: Sequence[Row]) -> str:
    parts = ["### Time: the fastest variant, and how many times as long each takes"]
    sizes = sorted({(row.key.width, row.key.height) for row in rows})
    parts += [times_table(rows, *size) for size in sizes]
    parts += ["### `persistent` against `two_stage`, own pixels against atomics", versus(rows)]
    cases = by_case(rows)
    if any(row.counters or row.scratch is not None for row in rows):
        parts += ["### Memory of queues, lists and levels", memory_table(rows)]
    if any(row.counters for row in rows):
        parts += ["### Work"]
        parts += [work_table(of_case) for key, of_case in cases.items() if key[1:] == SIZE and key.scene in SHOWN.split(",")]
        counted = [row for row in rows if row.counters]
        parts += ["### What a unit of work costs", costs_table(counted), shares_table(counted)]
    return "\n\n".join(parts)


def times_table(rows: Sequence[Row], width: int, height: int) -> str:
    """The fastest variant's ms, and how many times as long each takes."""
    cases = [of_case for key, of_case in by_case(rows).items() if (key.width, key.height) == (width, height)]
    variants = list(by_variant(rows))
    return markdown.table([f"{width}x{height}", "fastest, ms", *variants], [ratios(of_case, variants) for of_case in cases])


def ratios(of_case: Sequence[Row], variants: Sequence[str]) -> list[str]:
    """The scene, the fastest variant's ms, and how many times as long each takes."""
    ms = {row.variant: row.timing.median for row in of_case}
    best = min(ms.values())
    cells = ("-" if v not in ms else text_of(ms[v] / best) if ms[v] > best else "**1**" for v in variants)
    return [of_case[0].key.scene, text_of(best), *cells]


def versus(rows: Sequence[Row]) -> str:
    """Two designs, and two kinds of designs, that others have compared; a scene a line."""
    standard = rows[0].variant
    sizes = sorted({(row.key.width, row.key.height) for row in rows})
    cases = by_case(rows)
    lines = []
    for scene in dict.fromkeys(row.key.scene for row in rows):
        cells = []
        for size in sizes:
            us = {row.variant: row.us for row in cases.get(Key(scene, *size), []) if row.variant != standard}
            own = [us[v] for v in us if MODELS[v].OWNS_PIXELS]
            anyone = [us[v] for v in us if not MODELS[v].OWNS_PIXELS]
            both = us.get("persistent"), us.get("two_stage")
            cells.append(text_of(both[0] / both[1]) if both[0] and both[1] else "-")
            cells.append(text_of(min(own) / min(anyone)) if own and anyone else "-")
        lines.append([scene, *cells])
    head = ["", *itertools.chain(*((f"{w}x{h}: A", "B") for w, h in sizes))]
    return (
        "A: `persistent` over `two_stage`. B: the fastest variant whose tasks own pixels, which they draw in memory of their own "
        f"and write once, over the fastest that lowers pixels of the image by atomic operations, `{standard}` left out. Below 1 "
        "the first one is ahead.\n\n" + markdown.table(head, lines)
    )


def memory_table(rows: Sequence[Row]) -> str:
    """Bytes of each variant: on CUDA what a call takes, on the CPU what it stores for a later stage."""
    variants = list(by_variant(rows))
    largest = max((row.key.width, row.key.height) for row in rows)
    lines = []
    for key, of_case in by_case(row for row in rows if row.counters or row.scratch is not None).items():
        if key[1:] in (SIZE, largest) and key.scene in SHOWN.split(","):
            taken = {row.variant: row.counters.get("bytes", 0) if row.scratch is None else row.scratch for row in of_case}
            lines.append([f"{key.scene}, {key.size}", *(many(taken[v]) if v in taken else "-" for v in variants)])
    what = (
        "What a call takes from the device's allocator"
        if on_device(rows)
        else "Records and elements of queues that a call stores"
    )
    return f"{what}, bytes; the image, 8 bytes a pixel, is not among them.\n\n" + markdown.table(["bytes", *variants], lines)


def work_table(of_case: Sequence[Row]) -> str:
    """A variant a line. On a GPU a variant counts some kinds of work alone: the others are empty, or left out."""
    counted = [name for name in WORK if not on_device(of_case) or any(row.counters.get(name) for row in of_case)]
    loads = [text_of(counters.load(row.counters)) if row.counters.get("tasks") else "" for row in of_case]
    lines = []
    for row, load in zip(of_case, loads, strict=True):
        amounts = {name: row.counters.get(name, 0) for name in counted}
        cells = ["" if on_device(of_case) and not n else many(n) for n in amounts.values()]
        lines.append([row.variant, text_of(row.timing.median), *cells, *([load] if any(loads) or not on_device(of_case) else [])])
    key = of_case[0].key
    head = [
        f"{key.scene}, {key.size}",
        "ms",
        *(f"`{name}`" for name in counted),
        *(["load"] if any(loads) or not on_device(of_case) else []),
    ]
    return markdown.table(head, lines)


def on_device(rows: Sequence[Row]) -> bool:
    """Whether a GPU drew."""
    return any(row.scratch is not None for row in rows)


def costs_table(rows: Sequence[Row]) -> str:
    """ns for a unit of work, and how far off the costs of the other scenes are."""
    tried = check(rows)
    lines = []
    for variant, of_it in by_variant(rows).items():
        off = f"{tried.errors[variant]:.2f}" if variant in tried.errors else ""
        lines.append([variant, *(text_of(ns) if ns else "" for ns in fit(of_it).ns), off])
    text = markdown.table(["ns for each", *PAID, "off by"], lines)
    return (
        f"{text}\n\nOn scenes that they were not fitted to, these costs name the fastest variant in {tried.winners} of "
        f"{tried.cases} cases, and the faster one of two variants that are more than 10 % apart in {tried.ordered} of "
        f'{tried.pairs} pairs. "Off by" is the median factor between a time and what the costs of the other scenes say.'
    )


class Tried(NamedTuple):
    """A value of a parameter on one scene."""

    value: int
    ratio: float  # of the time to that with the standard value
    stored: str  # bytes, where they are others than with the standard value


def parameters(rows: Sequence[Row]) -> str:
    """How much each parameter matters, and all values of those that do."""
    scenes_of = list(by_case(rows))
    curves: dict[tuple[str, str], dict[Key, list[Tried]]] = {}
    standard = {(row.key, row.variant): row for row in rows if row.setting == STANDARD}
    for row in rows:
        if row.setting != STANDARD:
            name, _, value = row.setting.partition("=")
            tried = tried_of(int(value), row, standard[row.key, row.variant])
            curves.setdefault((row.variant, name), {}).setdefault(row.key, []).append(tried)
    most: list[list[object]] = []
    every: list[list[object]] = []
    for (variant, name), curve in sorted(curves.items()):
        ends = {key: ends_of(each) for key, each in curve.items()}
        cells = (", ".join(f"{t.value}: {text_of(t.ratio)}" for t in ends.get(key, [])) or "-" for key in scenes_of)
        most.append([variant, f"`{name}`", *cells])
        if max(max(each[-1].ratio, 1) / min(each[0].ratio, 1) for each in ends.values()) >= MATTERS:
            cells_of = {(key, t.value): text_of(t.ratio) + t.stored for key, each in curve.items() for t in each}
            for one in sorted({number for _, number in cells_of}):
                every.append([variant, f"`{name}`", one, *(cells_of.get((key, one), "-") for key in scenes_of)])
    names = [key.scene for key in scenes_of]
    parts = ["### Parameters: times the time of the standard value", SWEPT, "The value with the least and with the most time:"]
    parts += [markdown.table([f"variant, {scenes_of[0].size}", "parameter", *names], most)]
    if every:
        parts += [f"All values of those that change a time by a factor of {MATTERS}, and bytes where they are others:"]
        parts += [markdown.table(["variant", "parameter", "value", *names], every)]
    if in_image := [row for row in rows if (row.variant, row.setting) == IN_IMAGE]:
        parts += ["### Global memory against shared", MEMORIES]
        in_shared = [standard[row.key, row.variant] for row in in_image]
        both = {"in shared memory, us": in_shared, "in the image, us": in_image}
        lines: list[list[object]] = [[name, *(text_of(row.us) for row in of_it)] for name, of_it in both.items()]
        lines += [["ratio", *(text_of(b.us / a.us) for a, b in zip(in_shared, in_image, strict=True))]]
        parts += [markdown.table(["a bin's pixels", *(row.key.scene for row in in_image)], lines)]
    return "\n\n".join(parts)


def shares_table(rows: Sequence[Row]) -> str:
    """The kinds of work that a variant spends most of its time on, by its costs: why it is where it is."""
    cases = {key: of_case for key, of_case in by_case(rows).items() if key[1:] == SIZE and key.scene in SHOWN.split(",")}
    lines = []
    for variant, of_it in by_variant(rows).items():
        ns = fit(of_it).ns
        cells = []
        for of_case in cases.values():
            found = [ns * paid(row) for row in of_case if row.variant == variant]
            cells.append(largest(found[0]) if found and found[0].any() else "-")
        lines.append([variant, *cells])
    head = [f"{SIZE[0]}x{SIZE[1]}", *(key.scene for key in cases)]
    return "The kinds of work that take most of a variant's time by these costs, in percent:\n\n" + markdown.table(head, lines)


def largest(ns: NDArray[np.float64]) -> str:
    """The two largest parts of a time by `PAID`, in percent of it."""
    percent = 100 * ns / ns.sum()
    first = [k for k in np.argsort(-percent, kind="stable")[:2] if percent[k] >= LEAST]
    return ", ".join(f"{PAID[k]} {percent[k]:.0f}" for k in first)


def ends_of(curve: Sequence[Tried]) -> list[Tried]:
    """The values with the least and with the most time, one where there are no others."""
    in_order = sorted(curve, key=lambda tried: tried.ratio)
    return [in_order[0], *in_order[1:][-1:]]


def tried_of(value: int, row: Row, standard: Row) -> Tried:
    stored, before = (one.counters.get("bytes", 0) if one.scratch is None else one.scratch for one in (row, standard))
    text = f" ({many(stored)}B)" if stored >= 1000 else f" ({stored} B)"
    return Tried(value, row.us / standard.us, text if stored != before else "")


def distance(rows: Sequence[Row]) -> str:
    """Each scene from near to far, with what a triangle covers; then which variants change places."""
    parts = ["### Camera distance"]
    for name in dict.fromkeys(row.key.scene.partition("@")[0] for row in rows):
        cases = [c for c in by_case(rows).values() if c[0].key.scene.partition("@")[0] == name]
        cases.sort(key=distance_of)
        variants = list(by_variant(itertools.chain(*cases)))
        lines = [[f"{distance_of(c):g}", px(c), *ratios(c, variants)[1:]] for c in cases]
        parts += [markdown.table([f"{name}, {cases[0][0].key.size}, distance", "px a triangle", "fastest, ms", *variants], lines)]
        fallen = changes(cases, variants) or "none"
        parts += [f"What is more than 10 % ahead of another nearer by falls as much behind it farther away: {fallen}."]
    return "\n\n".join(parts)


def distance_of(of_case: Sequence[Row]) -> float:
    return float(of_case[0].key.scene.partition("@")[2])


def px(of_case: Sequence[Row]) -> str:
    """How many pixels a triangle covers, the mean of all; "-" where nobody has counted."""
    found = [row.counters["fragments"] for row in of_case if row.counters.get("fragments")]
    return text_of(max(found) / of_case[0].triangles) if found else "-"


def changes(cases: Sequence[Sequence[Row]], variants: Sequence[str]) -> str:
    """Which variants fall behind which others as the camera goes away, and from what distance on."""
    ms = [{row.variant: row.us for row in of_case} for of_case in cases]
    behind: dict[str, dict[float, list[str]]] = {}
    for a, b in itertools.permutations(variants, 2):
        both = [(distance_of(case), us[a], us[b]) for case, us in zip(cases, ms, strict=True) if a in us and b in us]
        first = [at for at, us_a, us_b in both if us_b > APART * us_a]
        then = [at for at, us_a, us_b in both if us_a > APART * us_b]
        if first and then and max(first) < min(then):
            behind.setdefault(a, {}).setdefault(min(then), []).append(b)
    lines = []
    for a, others in behind.items():
        lines.append(f"`{a}` behind " + ", ".join(f"{' and '.join(others[at])} from {at:g} on" for at in sorted(others)))
    return "; ".join(lines)


def motion(rows: Sequence[Row]) -> str:
    """Each variant's ms for a frame after its like, and how many times as long one takes after another camera's."""
    cases = by_case(rows)
    ms = {(row.key, row.variant, row.setting): row.timing.median for row in rows}
    lines = []
    for variant in by_variant(rows):
        cells = []
        for key in cases:
            still, moving = ms.get((key, variant, "still")), ms.get((key, variant, "moving"))
            cells += ["-", "-"] if still is None or moving is None else [text_of(still), f"{moving / still:.3f}"]
        lines.append([variant, *cells])
    size = next(iter(cases)).size
    head = [f"frame, {size}", *itertools.chain(*((f"{key.scene}, ms, still", "moving, times") for key in cases))]
    return f"### A camera that stands, and one that moves\n\n{MOTION}\n\n" + markdown.table(head, lines)


def stages(rows: Sequence[Row]) -> str:
    """A stage a line."""
    cases = by_case(rows)
    ms = {(row.key, row.variant, *row.setting.split(" ", 1)): row.timing.median for row in rows}
    lines = []
    variants = list(by_variant(rows))
    found_stages = dict.fromkeys((row.variant, row.setting.split(" ", 1)[1]) for row in rows)
    for variant, stage in sorted(found_stages, key=lambda one: variants.index(one[0])):
        cells = []
        for key in cases:
            found = [ms.get((key, variant, each, stage)) for each in ("still", "moving")]
            cells += ["-" if one is None else text_of(one * 1e3) for one in found]
        lines.append([f"{variant}: {stage}" if variant != "stages" else stage, *cells])
    size = next(iter(cases)).size
    head = [f"us, {size}", *itertools.chain(*((f"{key.scene}, still", "moving") for key in cases))]
    what = "Each variant's kernels, by CUDA's profiler; those of one frame may overlap."
    if any(row.variant == "stages" for row in rows):
        what = "The stages one by one as operators, on one thread, each with what the one before has written to memory."
    return f"### Time in each stage\n\n{what}\n\n" + markdown.table(head, lines)


def prediction(rows: Sequence[Row]) -> str:
    """What the costs of the report said of scenes that are not in it, and what was measured then."""
    variants = list(by_variant(rows))
    lines = []
    winners = ordered = pairs = 0
    for key, of_case in by_case(rows).items():
        said, was = ({row.variant: row.timing.median for row in of_case if row.setting == w} for w in ("predicted", "measured"))
        winners += winner(said) == winner(was)
        right, of = in_order(said, was)
        ordered, pairs = ordered + right, pairs + of
        for what, ms in (("predicted", said), ("measured", was)):
            cells = (text_of(ms[v]) if v in ms else "-" for v in variants)
            lines.append([f"{key.scene}, {key.size}, {what}", *cells])
    text = (
        "From the costs above and from the work counted on scenes that are not in the report, said before anything was drawn "
        f"with a clock. The fastest variant was named in {winners} of {len(lines) // 2} cases, the faster one of two variants "
        f"that are more than 10 % apart in {ordered} of {pairs} pairs."
    )
    return f"### Predictions\n\n{text}\n\n" + markdown.table(["ms", *variants], lines)

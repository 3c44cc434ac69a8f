"""The tables of docs/variants.md, from the rows of variants.py."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import markdown
from variant_cases import STANDARD
from variant_costs import PAID, check, fit
from variant_rows import PARTS, Key, Row, by_case, by_variant, many, text_of

from bigtri.check import counters

SIZE = (1920, 1080)  # of what is not shown at every size
SHOWN = "R16k-close,R100k,S2,S3,S4b,S5"  # scenes whose work is shown
WORK = ("entries", "bytes", "tiles_tested", "tiles_empty", "edges_64", "edges_32", "rows", "fragments", "passed", "atomics")
APART = 1.1  # times another's time: what is nearer than that has no order
NOTE = "Medians of rounds in which all take turns; what takes more than {} s drew twice."


def page(rows: Sequence[Row], slow: float) -> str:
    """All tables. slow: s, beyond which something drew twice."""
    tables = {"scenes": scenes, "parameters": parameters, "distance": distance, "motion": motion, "stages": stages}
    text = []
    for part in PARTS:
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
    cases = by_case(rows)
    if any(row.counters or row.scratch is not None for row in rows):
        parts += ["### Memory of queues, lists and levels", memory_table(rows)]
    if any(row.counters for row in rows):
        parts += ["### Work"]
        parts += [work_table(of_case) for key, of_case in cases.items() if key[1:] == SIZE and key.scene in SHOWN.split(",")]
        parts += ["### What a unit of work costs", costs_table([row for row in rows if row.counters])]
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


def memory_table(rows: Sequence[Row]) -> str:
    """Bytes of each variant: on CUDA what a call takes, on the CPU what it stores for a later stage."""
    variants = list(by_variant(rows))
    largest = max((row.key.width, row.key.height) for row in rows)
    lines = []
    for key, of_case in by_case(row for row in rows if row.counters or row.scratch is not None).items():
        if key[1:] in (SIZE, largest) and key.scene in SHOWN.split(","):
            taken = {row.variant: row.counters.get("bytes", 0) if row.scratch is None else row.scratch for row in of_case}
            lines.append([f"{key.scene}, {key.size}", *(many(taken[v]) if v in taken else "-" for v in variants)])
    on_device = any(row.scratch is not None for row in rows)
    what = "What a call takes from the device's allocator" if on_device else "Records and elements of queues that a call stores"
    return f"{what}, bytes; the image, 8 bytes a pixel, is not among them.\n\n" + markdown.table(["bytes", *variants], lines)


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
        off = f"{tried.errors[variant]:.2f}" if variant in tried.errors else ""
        lines.append([variant, *(text_of(ns) if ns else "" for ns in fit(of_it).ns), off])
    text = markdown.table(["ns for each", *PAID, "off by"], lines)
    return (
        f"{text}\n\nOn scenes that they were not fitted to, these costs name the fastest variant in {tried.winners} of "
        f"{tried.cases} cases, and the faster one of two variants that are more than 10 % apart in {tried.ordered} of "
        f'{tried.pairs} pairs. "Off by" is the median factor between a time and what the costs of the other scenes say.'
    )


def parameters(rows: Sequence[Row]) -> str:
    """Times of the standard value's time, of each scene; and with it bytes, where they depend on the value."""
    cases = by_case(rows)
    standard = {(row.key, row.variant): row for row in rows if row.setting == STANDARD}
    settings: dict[tuple[str, str, int], dict[Key, str]] = {}
    for row in rows:
        if row.setting != STANDARD:
            name, _, value = row.setting.partition("=")
            first = standard[row.key, row.variant]
            cell = text_of(row.us / first.us)
            stored, before = (one.counters.get("bytes", 0) if one.scratch is None else one.scratch for one in (row, first))
            if stored != before:
                cell += f" ({many(stored)}B)" if stored >= 1000 else f" ({stored} B)"
            settings.setdefault((row.variant, name, int(value)), {})[row.key] = cell
    lines = [
        [variant, f"`{name}`", value, *(settings[variant, name, value].get(key, "-") for key in cases)]
        for variant, name, value in sorted(settings)
    ]
    size = next(iter(cases)).size
    head = "### Parameters: times the time of the standard value, and bytes where they are others than with that"
    return f"{head}\n\n" + markdown.table([f"variant, {size}", "parameter", "value", *(key.scene for key in cases)], lines)


def distance(rows: Sequence[Row]) -> str:
    """Each scene from near to far, with what a triangle covers; then which variants change places."""
    parts = ["### Camera distance"]
    for name in dict.fromkeys(row.key.scene.partition("@")[0] for row in rows):
        cases = [c for c in by_case(rows).values() if c[0].key.scene.partition("@")[0] == name]
        cases.sort(key=distance_of)
        variants = list(by_variant(itertools.chain(*cases)))
        lines = [[f"{distance_of(c):g}", px(c), *ratios(c, variants)[1:]] for c in cases]
        parts += [markdown.table([f"{name}, {cases[0][0].key.size}, distance", "px a triangle", "fastest, ms", *variants], lines)]
        parts += [f"Changes of places, of variants more than 10 % apart: {changes(cases, variants) or 'none'}."]
    return "\n\n".join(parts)


def distance_of(of_case: Sequence[Row]) -> float:
    return float(of_case[0].key.scene.partition("@")[2])


def px(of_case: Sequence[Row]) -> str:
    """How many pixels a triangle covers, the mean of all; "-" where nobody has counted."""
    found = [row.counters["fragments"] for row in of_case if row.counters.get("fragments")]
    return text_of(max(found) / of_case[0].triangles) if found else "-"


def changes(cases: Sequence[Sequence[Row]], variants: Sequence[str]) -> str:
    """Of which two variants one is ahead near by and the other far away."""
    ms = [{row.variant: row.us for row in of_case} for of_case in cases]
    found = []
    for a, b in itertools.permutations(variants, 2):
        both = [(distance_of(case), us[a], us[b]) for case, us in zip(cases, ms, strict=True) if a in us and b in us]
        first = [at for at, us_a, us_b in both if us_b > APART * us_a]
        then = [at for at, us_a, us_b in both if us_a > APART * us_b]
        if first and then and max(first) < min(then):
            found.append(f"{a} is ahead of {b} up to {max(first):g}, behind from {min(then):g} on")
    return "; ".join(found)


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
    return "### A camera that stands, and one that moves\n\n" + markdown.table(head, lines)


def stages(rows: Sequence[Row]) -> str:
    """A stage a line."""
    cases = by_case(rows)
    ms = {(row.key, row.variant, *row.setting.split(" ", 1)): row.timing.median for row in rows}
    lines = []
    for variant, stage in dict.fromkeys((row.variant, row.setting.split(" ", 1)[1]) for row in rows):
        cells = []
        for key in cases:
            found = [ms.get((key, variant, each, stage)) for each in ("still", "moving")]
            cells += ["-" if one is None else text_of(one * 1e3) for one in found]
        lines.append([f"{variant}: {stage}" if variant != "stages" else stage, *cells])
    size = next(iter(cases)).size
    head = [f"us, {size}", *itertools.chain(*((f"{key.scene}, still", "moving") for key in cases))]
    return "### Time in each stage\n\n" + markdown.table(head, lines)

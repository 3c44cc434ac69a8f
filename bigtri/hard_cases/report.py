"""The table of the hard cases for this build: ``bigtri hard-cases``."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple

from .. import native
from . import depths
from .constructions import MESHES
from .mesh import Backend, Case, Mesh
from .reports import REPORTS
from .rules import RULES
from .structure import STRUCTURE

HEADER = ("case", "construction", "must hold", "unit", "float32", "with FMA", "worst float32", "int32", "4 bits", "bigtri")


class Row(NamedTuple):
    """What one case came to; counts are of ``case.unit``, None where the column has no meaning."""

    case: Case
    careful: int | None  # float32 with the top-left rule, or the best form of a depth
    fused: int | None  # the same source, contracted to fused multiply-adds by the compiler
    worst: int | None  # of the forms in float32, and its name
    worst_variant: str
    int32: int | None  # the exact method with int32 products
    fixed4: int | None  # vertices on a grid of 1/16 px, otherwise exact
    bigtri: dict[str, int]  # by backend


def cases() -> dict[str, Case]:
    """All cases by name, H01 to H46 first."""
    numbered = sorted([*MESHES, *RULES, *depths.DEPTHS, *STRUCTURE], key=lambda case: case.name)
    return {case.name: case for case in [*numbered, *REPORTS]}


def meshes() -> Iterator[tuple[str, Mesh]]:
    """The meshes of the cases that are about meshes, each with its case's name: for a rasterizer of one's own."""
    for case in cases().values():
        for mesh in case.build() if case.build else ():
            yield case.name, mesh


def choose(names: Sequence[str]) -> list[Case]:
    """The cases of these names or families; all without names.

    Raises:
        ValueError: an unknown name.
    """
    every = cases()
    families = {case.family for case in every.values()}
    unknown = [name for name in names if name not in every and name not in families]
    if unknown:
        raise ValueError(
            f"--only must name cases or families, got {', '.join(unknown)}; "
            f"families: {', '.join(sorted(families))}; cases: {', '.join(every)}"
        )
    return [case for case in every.values() if not names or case.name in names or case.family in names]


def backends() -> list[Backend]:
    """The reference, and the extension where it is built."""
    return [Backend("reference")] + [Backend("native")] * native.available()


def measure(case: Case) -> Row:
    """Build the case and count what is wrong, by every way to draw it."""
    plain = dict(case.naive()) if case.naive else {}
    fixed4, int32 = plain.pop("fixed4", None), plain.pop("i32", None)
    careful = plain.get("tl", min(plain.values()) if plain else None)
    worst = max(plain, key=lambda name: plain[name], default="")
    bigtri = {backend.name: case.wrong(backend) for backend in backends()}
    return Row(case, careful, plain.get("fma"), plain.get(worst), worst, int32, fixed4, bigtri)


def measure_all(chosen: Iterable[Case], progress: Callable[[str], None] = lambda line: None) -> list[Row]:
    """``measure`` one by one; ``progress`` gets a line before each."""
    rows = []
    for case in chosen:
        progress(f"{case.name}: {case.title}")
        rows.append(measure(case))
    return rows


def failures(rows: Iterable[Row]) -> int:
    """How much this build gets wrong, all in all: 0, or there is a defect."""
    return sum(count for row in rows for count in row.bigtri.values())


def table(rows: Sequence[Row]) -> str:
    """As text, in columns."""
    lines = [HEADER, *(_cells(row) for row in rows)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(HEADER))]
    padded = [
        [cell.rjust(w) if i >= 4 else cell.ljust(w) for i, (cell, w) in enumerate(zip(line, widths, strict=True))]
        for line in lines
    ]
    return "\n".join("  ".join(line).rstrip() for line in padded)


def markdown(rows: Sequence[Row]) -> str:
    """As a table for docs/hard_cases.md, with the reasons."""
    head = ("case", "construction", "why it is hard", *HEADER[2:])
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * 5 + "---:|" * 6]
    for row in rows:
        name, title, invariant, *numbers = _cells(row)
        lines.append("| " + " | ".join((name, title, row.case.reason, invariant, *numbers)) + " |")
    return "\n".join(lines)


def as_csv(rows: Sequence[Row]) -> str:
    """One line a case; the naive variants and the backends that were measured in columns of their own."""
    text = io.StringIO()
    out = csv.writer(text, lineterminator="\n")
    names = ["float32", "fma", "worst", "variant", "int32", "fixed4"]
    out.writerow(["case", "family", "construction", "must hold", "unit", *names, "backend", "wrong"])
    for row in rows:
        c = row.case
        counts = [row.careful, row.fused, row.worst, row.worst_variant, row.int32, row.fixed4]
        for backend, wrong in row.bigtri.items():
            known = ["" if n is None else n for n in counts]
            out.writerow([c.name, c.family, c.title, c.invariant, c.unit, *known, backend, wrong])
    return text.getvalue()


def _cells(row: Row) -> tuple[str, ...]:
    case = row.case
    plain = ["-" if n is None else f"{n:,}" for n in (row.careful, row.fused, row.worst, row.int32, row.fixed4)]
    if row.worst:
        plain[2] += f" {row.worst_variant}"
    counted = set(row.bigtri.values())
    bigtri = f"{counted.pop():,}" if len(counted) == 1 else ", ".join(f"{name} {n:,}" for name, n in row.bigtri.items())
    return (case.name, case.title, case.invariant, case.unit, *plain, bigtri)

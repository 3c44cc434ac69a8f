"""The rows of the report about variants, and their file. variants.py and its neighbours share them."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from bigtri import native
from bigtri.study import clock

PARTS = ("scenes", "parameters", "distance", "motion", "stages")  # of the report, which are measured
PREDICTION = "prediction"  # one more, which is said before it is measured


class Key(NamedTuple):
    scene: str  # of bigtri.study.scenes; "R16k@4": seen from 4 times as far
    width: int  # px
    height: int  # px

    @property
    def size(self) -> str:
        return f"{self.width}x{self.height}"


class Row(NamedTuple):
    """One way in one case."""

    part: str  # one of `PARTS`, or `PREDICTION`
    key: Key
    triangles: int
    variant: str
    setting: str  # of "parameters": "share=64", or "standard"; of "motion": "still" or "moving"; of "stages": "still setup"
    # ... of `PREDICTION`: "predicted" or "measured"
    timing: clock.Timing
    equal: bool  # to the first variant's image, in bits
    counters: Mapping[str, int]  # none where nothing was counted
    scratch: int | None  # bytes that a call takes from the device's allocator; None on the CPU
    where: Mapping[str, str]

    @property
    def us(self) -> float:
        return self.timing.median * 1e3


_TIMES = [f"ms_{name}" for name in clock.Timing._fields[:-1]]
_WHERE = ("device", "how", "versions", "commit", "command")


def write(path: Path, rows: Sequence[Row]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        shared = ["triangles", "variant", "setting", *_TIMES, "repeats", "equal", "scratch"]
        writer.writerow(["part", *Key._fields, *shared, *native.COUNTERS, *_WHERE])
        for row in rows:
            *ms, repeats = row.timing
            times = [*(f"{value:.4f}" for value in ms), repeats, int(row.equal), "" if row.scratch is None else row.scratch]
            counts = [row.counters.get(name, "") for name in native.COUNTERS]
            where = [row.where[name] for name in _WHERE]
            writer.writerow([row.part, *row.key, row.triangles, row.variant, row.setting, *times, *counts, *where])


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
                median, minimum, p25, p75 = (float(one[name]) for name in _TIMES)
                timing = clock.Timing(median, minimum, p25, p75, int(one["repeats"]))
                counts = {name: int(one[name]) for name in native.COUNTERS if one.get(name)}
                scratch = int(one["scratch"]) if one["scratch"] else None
                where = {name: one[name] for name in _WHERE}
                shared = (
                    int(one["triangles"]),
                    one["variant"],
                    one["setting"],
                    timing,
                    one["equal"] == "1",
                    counts,
                    scratch,
                    where,
                )
                rows.append(Row(one["part"], key, *shared))
            except (KeyError, TypeError, ValueError) as error:
                raise SystemExit(f"{path}: no rows of this script: {error!r}") from None
    return rows


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


# --- numbers as text


def text_of(value: float) -> str:
    """Three digits."""
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"


def many(count: int) -> str:
    """A count to three digits, in thousands or millions."""
    for unit, name in ((1e9, " G"), (1e6, " M"), (1e3, " k")):
        if count >= unit:
            return f"{count / unit:.3g}{name}"
    return str(count)

"""What a unit of work costs each variant: fitted to times and counters, and tried on scenes that the fit has not seen."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import scipy.optimize
from numpy.typing import NDArray
from variant_rows import Row, by_case, by_variant

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


def paid(row: Row) -> list[int]:
    known = {"pixels": row.key.width * row.key.height, "triangles": row.triangles}
    return [(known | dict(row.counters)).get(name, 0) for name in PAID]


class Costs(NamedTuple):
    """Of one variant, ns for each of `PAID`."""

    ns: NDArray[np.float64]

    def us(self, row: Row) -> float:
        return float(self.ns @ np.array(paid(row), float)) / 1e3


def fit(rows: Iterable[Row]) -> Costs:
    """The costs that come nearest to the rows' times, each error in proportion to the time."""
    rows = list(rows)
    counts = np.array([paid(row) for row in rows], float)
    us = np.array([row.us for row in rows])
    found, _ = scipy.optimize.nnls(counts / (us * 1e3)[:, None], np.ones(len(us)))
    return Costs(found)


def winner(times: Mapping[str, float]) -> str:
    return min(times, key=times.__getitem__)


def in_order(said: Mapping[str, float], was: Mapping[str, float]) -> tuple[int, int]:
    """How many pairs of variants are named in the order of their times, and of how many that are more than 10 % apart."""
    pairs = [(a, b) for a, b in itertools.permutations(was, 2) if was[b] > 1.1 * was[a]]
    return sum(said[b] > said[a] for a, b in pairs), len(pairs)


class Check(NamedTuple):
    """How good the costs are on scenes that they were not fitted to."""

    errors: dict[str, float]  # of each variant: the median of the factors by which a time is off
    winners: int  # cases whose fastest variant is named
    cases: int
    ordered: int  # pairs of variants, a case each, that are named in the order of their times
    pairs: int  # of which one takes more than 1.1 times as long as the other


def check(rows: Sequence[Row]) -> Check:
    factors: dict[str, list[float]] = {}
    winners = tried = ordered = pairs = 0
    cases = by_case(rows)
    for left_out in dict.fromkeys(row.key.scene for row in rows):
        rest = by_variant(row for row in rows if row.key.scene != left_out)
        costs = {variant: fit(of_it) for variant, of_it in rest.items()}
        for key, of_case in cases.items():
            if key.scene != left_out:
                continue
            said = {row.variant: costs[row.variant].us(row) for row in of_case if row.variant in costs}
            was = {row.variant: row.us for row in of_case if row.variant in costs}
            for variant in said:
                factors.setdefault(variant, []).append(max(said[variant] / was[variant], was[variant] / said[variant]))
            tried += bool(said)
            winners += bool(said) and winner(said) == winner(was)
            right, of = in_order(said, was)
            ordered += right
            pairs += of
    errors = {variant: float(np.median(values)) for variant, values in factors.items()}
    return Check(errors, winners, tried, ordered, pairs)

"""The truth (``truth.py``) of some of the pixels of a scene, which may be too large for all of them.

A box around each triangle, wider than any rounding, names the pixels at which it may show, and float64 leaves out those that
lie outside by more than it can be wrong. Whether a triangle does show there, and before which others, is decided in integers.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..precision import EXACT, Arithmetic
from ..reference import brute_force
from . import truth

_ROWS = 1 << 20  # rows of boxes that are looked up at a time


def pixels(height: int, width: int, count: int, seed: int) -> NDArray[np.int64]:
    """int64 [N]: ``count`` pixels of an image, or all if it has no more, as row * width + column, in rising order."""
    if count >= height * width:
        return np.arange(height * width)
    return np.sort(np.random.default_rng(seed).choice(height * width, count, replace=False))


def nearest(
    positions: NDArray[np.float32],
    triangles: NDArray[np.int32],
    height: int,
    width: int,
    at: NDArray[np.int64],
    cull: str = "none",
) -> NDArray[np.int32]:
    """int32 [N]: the ``triangle`` that ``truth.seen`` has at the pixels ``at`` [N], row * width + column, in rising order.

    A triangle with a coordinate that is not finite does not show; nor does a face that ``cull`` names, as in ``rasterize``.
    """
    found = np.full(len(at), truth.BACKGROUND, np.int32)
    before: list[tuple[int, int] | None] = [None] * len(at)  # z and w of what was found, on any scale
    rows, columns = np.divmod(at, width)
    for index, samples in _candidates(positions, triangles, height, width, at):
        corners = positions[triangles[index]]
        if cull != "none" and _is_back(corners) == (cull == "back"):
            continue
        forms = truth._forms(corners.tolist(), height, width)
        if forms is None:
            continue
        samples = samples[_may_cover(forms, columns[samples], rows[samples])]
        for sample, px, py in zip(samples.tolist(), columns[samples].tolist(), rows[samples].tolist(), strict=True):
            u = [a * px + b * py + c for a, b, c in zip(forms.a, forms.b, forms.c, strict=True)]
            if any(v < 0 or (v == 0 and (a, b) < (0, 0)) for v, a, b in zip(u, forms.a, forms.b, strict=True)):
                continue
            z, w = sum(map(int.__mul__, u, forms.z)), sum(map(int.__mul__, u, forms.w))
            if not -w <= z <= w:
                continue
            other = before[sample]
            if other is None or z * other[1] < other[0] * w:
                found[sample], before[sample] = index, (z, w)
    return found


def values(
    positions: NDArray[np.float32],
    triangles: NDArray[np.int32],
    height: int,
    width: int,
    at: NDArray[np.int64],
    shown: NDArray[np.int32],
    arithmetic: Arithmetic = EXACT,
) -> truth.Seen:
    """The depth and the weights of the triangles ``shown`` [N] at the pixels ``at`` [N]: a ``Seen`` of [N] instead of [H, W].

    ``depth`` is that of ``truth.planes`` and ``weights`` those of ``truth.seen``. ``triangle`` is -1 where none is shown, or
    snapping moved it away from the pixel's centre, so that no record has a depth there.
    """
    depth, weights = np.full(len(at), None, object), np.full((len(at), 3), None, object)
    found = np.full(len(at), truth.BACKGROUND, np.int32)
    for index in np.unique(shown[shown != truth.BACKGROUND]).tolist():
        records, _ = brute_force.records(positions, triangles[index : index + 1], height, width, arithmetic=arithmetic)
        forms = truth._forms(positions[triangles[index]].tolist(), height, width)
        for sample in np.flatnonzero(shown == index).tolist():
            py, px = divmod(int(at[sample]), width)
            record = next((one for one in records if brute_force.covers(one, px, py, arithmetic)), None)
            if record is None or forms is None:
                continue
            here = brute_force.exact_depth(record, px, py, arithmetic)
            u = [a * px + b * py + c for a, b, c in zip(forms.a, forms.b, forms.c, strict=True)]
            found[sample] = index
            depth[sample] = min(max(here, Fraction(min(record.z))), Fraction(max(record.z)))
            weights[sample] = [Fraction(one, sum(u)) for one in u]
    return truth.Seen(found, depth, weights, (found != truth.BACKGROUND).astype(np.int64))


def _is_back(corners: NDArray[np.float32]) -> bool:
    """Whether corners [3, 4] run clockwise on the screen: by the sign of the determinant of (x, y, w), in fractions."""
    (a, b, c), (d, e, f), (g, h, i) = [[Fraction(v) for v in corner] for corner in corners[:, [0, 1, 3]].tolist()]
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) < 0


def _candidates(
    positions: NDArray[np.float32], triangles: NDArray[np.int32], height: int, width: int, at: NDArray[np.int64]
) -> Iterator[tuple[int, NDArray[np.int64]]]:
    """Triangles in order, each with those of the pixels ``at`` that its box holds, as indices into them; none without any."""
    corners = positions[triangles].astype(np.float64)
    w = corners[..., 3]
    # A triangle shows nothing if it lies behind the eye, or all of it beyond one plane of the view volume.
    shown = np.isfinite(corners).all(axis=(1, 2)) & (w > 0).any(axis=1)
    for axis in range(3):
        shown &= (corners[..., axis] <= w).any(axis=1) & (corners[..., axis] >= -w).any(axis=1)
    # One that reaches behind the eye may show anywhere.
    crosses = (w <= 0).any(axis=1)
    with np.errstate(all="ignore"):
        x, y = (corners[..., 0] / w * 0.5 + 0.5) * width, (0.5 - corners[..., 1] / w * 0.5) * height
    (left, right), (top, bottom) = (
        # A pixel more to either side than exact quotients would give.
        (
            np.where(crosses, 0, np.clip(np.floor(np.nan_to_num(v.min(axis=1))) - 1, 0, size)).astype(np.int64),
            np.where(crosses, size, np.clip(np.ceil(np.nan_to_num(v.max(axis=1))) + 1, 0, size)).astype(np.int64),
        )
        for v, size in ((x, width), (y, height))
    )
    kept = np.flatnonzero(shown)
    lines = np.cumsum(bottom[kept] - top[kept])
    for some in np.split(kept, np.flatnonzero(np.diff(lines // _ROWS)) + 1):
        triangle = np.repeat(some, bottom[some] - top[some])
        row = np.concatenate([np.empty(0, np.int64), *(np.arange(top[t], bottom[t]) for t in some)])
        first = np.searchsorted(at, row * width + left[triangle])
        last = np.searchsorted(at, row * width + right[triangle])
        there = first < last
        triangle, first, last = triangle[there], first[there], last[there]
        bounds = [*np.flatnonzero(np.diff(triangle, prepend=-1)).tolist(), len(triangle)]
        for start, stop in itertools.pairwise(bounds):
            runs = [np.arange(a, b) for a, b in zip(first[start:stop].tolist(), last[start:stop].tolist(), strict=True)]
            yield int(triangle[start]), np.concatenate(runs)


def _may_cover(forms: truth._Forms, px: NDArray[np.int64], py: NDArray[np.int64]) -> NDArray[np.bool_]:
    """bool [N]: False where float64 is sure that a weight is negative at a pixel."""
    left: NDArray[Any] = np.ones(len(px), np.bool_)
    for a, b, c in zip(forms.a, forms.b, forms.c, strict=True):
        beyond = max(abs(a), abs(b), abs(c)).bit_length()  # the integers may be larger than any float
        x, y, one = (float(Fraction(v, 1 << beyond)) for v in (a, b, c))
        # Each factor, product and sum is rounded by 2^-53 of itself: 2^-48 of all together is more than they add up to.
        left &= (x * px + y * py) + one >= -(2.0**-48) * ((abs(x) * px + abs(y) * py) + abs(one))
    return left

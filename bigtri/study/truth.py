"""What is truly seen, in exact rational arithmetic: the measure of every rung, and computed by none of them.

Nothing here is clipped, snapped or rounded, and no formula is shared with the stages. Clip-space positions become integers,
scaled by a power of two, which changes no direction; whatever follows is a ratio of integers. That is slow: it is for scenes of
some ten thousand fragments.

* ``seen`` is the truth of coverage, depth and weights: that of the triangles as they were given.
* ``planes`` is the truth of depth alone: of the planes through the vertices that a rung has snapped, so that what snapping moved
  is not counted as an error of depth.
* ``in_rows``, ``nearest_at`` and ``at`` are the same for large scenes: whole rows of the image, and single pixels. Which triangle
  shows is first computed in float64 with a bound of its error. What that does not decide is computed in rational arithmetic, so
  what comes out is exact.

The truth of an image is the picture of many samples a pixel: ``render(..., supersample=8)``.
"""

from __future__ import annotations

from fractions import Fraction
from math import lcm
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..precision import EXACT, Arithmetic
from ..reference import brute_force

Exact = NDArray[Any]  # of Python's integers or fractions
BACKGROUND = -1


class Seen(NamedTuple):
    """What each pixel's centre shows; None where no triangle does."""

    triangle: NDArray[np.int32]  # [H, W], the nearest one, the lower index of equally near ones; -1 on the background
    depth: Exact  # Fraction [H, W], its window depth
    weights: Exact  # Fraction [H, W, 3], of its corners, perspective-correct; their sum is 1
    times: NDArray[np.int64]  # [H, W], how many triangles show there, before one hides another


class Rows(NamedTuple):
    """What the pixel centres of some rows show."""

    rows: NDArray[np.int64]  # [R], in order
    triangle: NDArray[np.int32]  # [R, W], as in ``Seen``
    times: NDArray[np.int64]  # [R, W]
    pairs: NDArray[np.int64]  # in order: (r * W + x) * T + t for each triangle t that shows at pixel x of the r-th of the rows


class _Forms(NamedTuple):
    """A triangle's homogeneous weights over its corners: ``a * px + b * py + c`` for each, at the centre of pixel (px, py)."""

    a: tuple[int, ...]  # [3]
    b: tuple[int, ...]
    c: tuple[int, ...]
    z: tuple[int, ...]  # [3], of the corners, in the unit of w
    w: tuple[int, ...]


def seen(positions: NDArray[np.float32], triangles: NDArray[np.int32], height: int, width: int) -> Seen:
    """The truth of ``positions`` [V, 4], finite, and ``triangles`` [T, 3], both faces, in an image of height x width px.

    A centre on an edge belongs to the triangle that it enters if it moves right by an infinitesimal step, and down by a still
    smaller one: what the top-left rule says. Visible is -w <= z <= w, w > 0.
    """
    nearest = np.full((height, width), BACKGROUND, np.int32)
    depth, weights = np.full((height, width), None, object), np.full((height, width, 3), None, object)
    times = np.zeros((height, width), np.int64)
    for index, corners in enumerate(positions[triangles].tolist()):
        forms = _forms(corners, height, width)
        if forms is None:
            continue
        for py, px in np.argwhere(_covered(forms, height, width)).tolist():
            u = _values(forms, px, py)
            z = sum(map(int.__mul__, u, forms.z))
            w = sum(map(int.__mul__, u, forms.w))  # positive: the solution of Cramer's rule has the w of the view ray
            if not -w <= z <= w:
                continue
            times[py, px] += 1
            here = (Fraction(z, w) + 1) / 2
            if nearest[py, px] == BACKGROUND or here < depth[py, px]:
                nearest[py, px], depth[py, px] = index, here
                weights[py, px] = [Fraction(one, sum(u)) for one in u]
    return Seen(nearest, depth, weights, times)


def _forms(corners: list[list[float]], height: int, width: int) -> _Forms | None:
    """None if the triangle is seen edge-on, and shows nothing.

    A point ``sum u_m * corner_m`` appears in the direction n = (nx, ny, 1) of its (x, y, w): by Cramer's rule u_m is the
    determinant of n and the two corners after m, over that of all three. Both are scaled to integers here, and the second is
    replaced by its sign, which leaves the ratios of the weights, and where they are positive.
    """
    exact = [[Fraction(c) for c in corner] for corner in corners]
    unit = lcm(*(c.denominator for corner in exact for c in corner))
    x, y, z, w = zip(*([int(c * unit) for c in corner] for corner in exact), strict=True)
    normal = [
        (
            y[m - 2] * w[m - 1] - w[m - 2] * y[m - 1],
            w[m - 2] * x[m - 1] - x[m - 2] * w[m - 1],
            x[m - 2] * y[m - 1] - y[m - 2] * x[m - 1],
        )
        for m in range(3)
    ]
    determinant = normal[0][0] * x[0] + normal[0][1] * y[0] + normal[0][2] * w[0]
    if determinant == 0:
        return None
    sign = 1 if determinant > 0 else -1
    # n = ((2 px + 1) / W - 1, 1 - (2 py + 1) / H, 1), times W * H.
    return _Forms(
        a=tuple(sign * 2 * height * n[0] for n in normal),
        b=tuple(-sign * 2 * width * n[1] for n in normal),
        c=tuple(sign * (height * (1 - width) * n[0] + width * (height - 1) * n[1] + width * height * n[2]) for n in normal),
        z=z,
        w=w,
    )


def _values(forms: _Forms, px: int, py: int) -> list[int]:
    """The three weights at the centre of a pixel, before they are divided by their sum."""
    return [a * px + b * py + c for a, b, c in zip(forms.a, forms.b, forms.c, strict=True)]


def _covered(forms: _Forms, height: int, width: int) -> NDArray[np.bool_]:
    """bool [H, W]: whether all weights are positive, or would be after the infinitesimal step."""
    px, py = np.arange(width).astype(object)[None, :], np.arange(height).astype(object)[:, None]
    inside = np.ones((height, width), np.bool_)
    for a, b, c in zip(forms.a, forms.b, forms.c, strict=True):
        value = a * px + b * py + c
        inside &= np.asarray((value > 0) | ((value == 0) & ((a, b) > (0, 0))), np.bool_)
    return inside


def planes(
    positions: NDArray[np.float32], triangles: NDArray[np.int32], height: int, width: int, arithmetic: Arithmetic = EXACT
) -> Seen:
    """The truth of the records that a rung with fixed-point coverage makes, which are what its arithmetic of depth begins with.

    As ``seen``, but ``depth`` is that of the plane through the snapped vertices, clamped to theirs as every rung does, and
    ``weights`` are None. Visible is what covers the centre, up to a depth of 1.
    """
    nearest = np.full((height, width), BACKGROUND, np.int32)
    depth, weights = np.full((height, width), None, object), np.full((height, width, 3), None, object)
    times = np.zeros((height, width), np.int64)
    records, _ = brute_force.records(positions, triangles, height, width, arithmetic=arithmetic)
    for record in records:
        for py, px in np.argwhere(brute_force.coverage(record, height, width, arithmetic)).tolist():
            here = brute_force.exact_depth(record, px, py, arithmetic)
            here = _clamped_depth(record, px, py, arithmetic)
            if not 0 <= here <= 1:
                continue
            times[py, px] += 1
            if nearest[py, px] == BACKGROUND or (here > depth[py, px] if arithmetic.reversed else here < depth[py, px]):
                nearest[py, px], depth[py, px] = record.triangle, here
    return Seen(nearest, depth, weights, times)


def _clamped_depth(record: brute_force.Record, px: int, py: int, arithmetic: Arithmetic) -> Fraction:
    """Of the plane through a record's snapped vertices, clamped to theirs."""
    here = brute_force.exact_depth(record, px, py, arithmetic)
    return min(max(here, Fraction(min(record.z))), Fraction(max(record.z)))


def at(
    positions: NDArray[np.float32],
    triangles: NDArray[np.int32],
    height: int,
    width: int,
    pixels: NDArray[np.int64],
    shown: NDArray[np.int32],
    arithmetic: Arithmetic = EXACT,
) -> Seen:
    """The depth and weights of the triangles ``shown`` [P] at ``pixels`` [P, 2] (column, row): a ``Seen`` of [P], not [H, W].

    ``depth`` is as in ``planes``, ``weights`` as in ``seen``. Where ``shown`` is -1, or no record of the rung covers the pixel,
    ``triangle`` is -1.
    """
    count = len(pixels)
    depth, weights = np.full(count, None, object), np.full((count, 3), None, object)
    found = np.full(count, BACKGROUND, np.int32)
    for index in np.unique(shown[shown != BACKGROUND]).tolist():
        one = triangles[index : index + 1]
        records, _ = brute_force.records(positions, one, height, width, arithmetic=arithmetic)
        forms = _forms(positions[one[0]].tolist(), height, width)
        for k in np.flatnonzero(shown == index).tolist():
            px, py = pixels[k].tolist()
            record = next((r for r in records if brute_force.covers(r, px, py, arithmetic)), None)
            if record is None or forms is None:
                continue
            u = _values(forms, px, py)
            found[k], depth[k] = index, _clamped_depth(record, px, py, arithmetic)
            weights[k] = [Fraction(value, sum(u)) for value in u]
    return Seen(found, depth, weights, (found != BACKGROUND).astype(np.int64))


# --- whole rows of large scenes

_CHUNK = 1 << 20  # pairs of a pixel and a triangle at a time
_ROUNDINGS = 32 * 2.0**-53  # more than all roundings of a sum of products below add up to, of the sum of its terms' sizes


def boxes(positions: NDArray[np.floating[Any]], triangles: NDArray[np.int32], height: int, width: int) -> NDArray[np.int64]:
    """int64 [T, 4]: first column, first row, and the two after the last ones, of a box with all pixels that a triangle may show.

    All of the image where a corner has w <= 0; empty where all corners lie beyond one plane of the view volume.
    """
    corners = positions[triangles].astype(np.float64)
    w = corners[..., 3]
    beyond = [(sign * corners[..., axis] > w).all(axis=1) for axis in range(3) for sign in (-1, 1)]
    hidden = np.any(beyond, axis=0) | (w <= 0).all(axis=1)
    whole = (w <= 0).any(axis=1)
    with np.errstate(all="ignore"):
        x, y = (corners[..., 0] / w * 0.5 + 0.5) * width, (0.5 - corners[..., 1] / w * 0.5) * height
    found = np.empty((len(triangles), 4), np.int64)
    for axis, (values, size) in enumerate(((x, width), (y, height))):
        # A pixel more to each side than rounding could ever ask for.
        low, high = np.floor(np.nan_to_num(values.min(axis=1))) - 1, np.ceil(np.nan_to_num(values.max(axis=1))) + 1
        found[:, axis] = np.where(whole, 0, np.clip(low, 0, size))
        found[:, 2 + axis] = np.where(whole, size, np.clip(high, 0, size))
    found[hidden] = 0
    return found


def in_rows(
    positions: NDArray[np.floating[Any]], triangles: NDArray[np.int32], height: int, width: int, rows: NDArray[np.int64]
) -> Rows:
    """What ``seen`` says of ``rows`` [R], in order; float32 or float64 ``positions``."""
    exact = _Exactly(positions, triangles, height, width)
    filtered = _Filter.of(positions[triangles].astype(np.float64))
    box = boxes(positions, triangles, height, width)
    first, last = np.searchsorted(rows, box[:, 1]), np.searchsorted(rows, box[:, 3])
    across = box[:, 2] - box[:, 0]
    areas = across * (last - first)
    parts: list[_Shown] = [_Shown(np.empty(0, np.int64), np.empty(0), np.empty(0))]
    ends = np.cumsum(areas)
    start = 0
    while start < len(triangles):
        stop = max(start + 1, int(np.searchsorted(ends, (ends[start - 1] if start else 0) + _CHUNK, side="right")))
        chunk = np.arange(start, stop)
        of = np.repeat(chunk, areas[chunk])
        place = np.arange(len(of)) - np.repeat(ends[chunk] - areas[chunk], areas[chunk]) + (ends[start - 1] if start else 0)
        row, column = first[of] + place // across[of], box[of, 0] + place % across[of]
        parts += _shown(filtered, exact, of, row, column, rows, height, width)
        start = stop
    key, low, high = (np.concatenate(values) for values in zip(*parts, strict=True))
    order = np.argsort(key)
    key, low, high = key[order], low[order], high[order]
    shape = (len(rows), width)
    return Rows(
        rows,
        _nearest(key, low, high, exact, rows, shape).reshape(shape),
        np.bincount(key // max(1, len(triangles)), minlength=shape[0] * shape[1]).reshape(shape),
        key,
    )


def nearest_at(
    positions: NDArray[np.float32],
    triangles: NDArray[np.int32],
    height: int,
    width: int,
    pixels: NDArray[np.int64],
    cull: str = "none",
) -> NDArray[np.int32]:
    """int32 [P]: the ``triangle`` that ``seen`` has at ``pixels`` [P, 2] (column, row), in order of rows, then of columns.

    A triangle with a coordinate that is not finite does not show; nor does a face that ``cull`` names, as in ``rasterize``.
    """
    kept = np.flatnonzero(_drawn(positions, triangles, cull))
    triangles = triangles[kept]
    exact = _Exactly(positions, triangles, height, width)
    filtered = _Filter.of(positions[triangles].astype(np.float64))
    left, top, right, bottom = boxes(positions, triangles, height, width).T
    place = pixels[:, 1] * width + pixels[:, 0]
    every_row = np.arange(height)
    parts: list[_Shown] = [_Shown(np.empty(0, np.int64), np.empty(0), np.empty(0))]
    for some in _chunks(np.arange(len(triangles)), bottom - top):
        of = np.repeat(some, (bottom - top)[some])
        row = _ranges(top[some], (bottom - top)[some])
        first, last = (np.searchsorted(place, row * width + side[of]) for side in (left, right))
        for runs in _chunks(np.arange(len(of)), last - first):
            length = (last - first)[runs]
            found = _ranges(first[runs], length)
            parts += _shown(
                filtered, exact, np.repeat(of[runs], length), pixels[found, 1], pixels[found, 0], every_row, height, width
            )
    key, low, high = (np.concatenate(values) for values in zip(*parts, strict=True))
    order = np.argsort(key)
    nearest = _nearest(key[order], low[order], high[order], exact, every_row, (height, width))[place]
    shown = nearest != BACKGROUND
    nearest[shown] = kept[nearest[shown]]
    return nearest


def _drawn(positions: NDArray[np.float32], triangles: NDArray[np.int32], cull: str) -> NDArray[np.bool_]:
    """bool [T]: which triangles are finite and not culled."""
    drawn = np.asarray(np.isfinite(positions[triangles]).all(axis=(1, 2)))
    if cull == "none":
        return drawn
    sign = np.zeros(len(triangles))  # of the determinant of the corners' (x, y, w), which is positive for a front face
    sign[drawn] = _Filter.of(positions[triangles[drawn]].astype(np.float64)).sign
    for index in np.flatnonzero(drawn & (sign == 0)).tolist():
        corners = positions[triangles[index]][:, [0, 1, 3]].tolist()
        (a, b, c), (d, e, f), (g, h, i) = [[Fraction(v) for v in corner] for corner in corners]
        determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
        sign[index] = (determinant > 0) - (determinant < 0)
    return np.asarray(sign > 0 if cull == "back" else sign < 0)


def _chunks(values: NDArray[np.int64], sizes: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """``values`` in pieces, each of which has about _CHUNK together of its ``sizes``."""
    return np.split(values, np.flatnonzero(np.diff(np.cumsum(sizes) // _CHUNK)) + 1)


def _ranges(first: NDArray[np.int64], length: NDArray[np.int64]) -> NDArray[np.int64]:
    """The integers from each ``first`` on, ``length`` of them, one range after the other."""
    return np.arange(int(length.sum())) + np.repeat(first - (np.cumsum(length) - length), length)


class _Filter(NamedTuple):
    """Homogeneous weights in float64, as in ``_Forms`` but without its integers, and how far they may be off."""

    normal: NDArray[np.float64]  # [T, 3, 3]: of each weight the factors of X, Y and 1, in (-1, 1) over the image
    error: NDArray[np.float64]  # [T, 3], of each weight
    sign: NDArray[np.float64]  # [T], of the determinant; 0 where float64 does not tell
    z: NDArray[np.float64]  # [T, 3]
    w: NDArray[np.float64]

    @staticmethod
    def of(corners: NDArray[np.float64]) -> _Filter:
        """corners: [T, 3, 4]."""
        view = corners[..., [0, 1, 3]]
        after, before = np.roll(view, -1, axis=1), np.roll(view, -2, axis=1)
        terms = [(after[..., i] * before[..., j], after[..., j] * before[..., i]) for i, j in ((1, 2), (2, 0), (0, 1))]
        normal = np.stack([a - b for a, b in terms], axis=2)
        sizes = np.stack([np.abs(a) + np.abs(b) for a, b in terms], axis=2)
        determinant = (normal[:, 0] * view[:, 0]).sum(axis=1)
        unsure = np.abs(determinant) <= _ROUNDINGS * (sizes[:, 0] * np.abs(view[:, 0])).sum(axis=1) + 1e-300
        return _Filter(
            normal,
            _ROUNDINGS * sizes.sum(axis=2) + 1e-300,
            np.where(unsure, 0, np.sign(determinant)),
            corners[..., 2],
            corners[..., 3],
        )


class _Shown(NamedTuple):
    """Pairs of a triangle and a pixel at which it shows."""

    key: NDArray[np.int64]  # as ``Rows.pairs``
    low: NDArray[np.float64]  # bounds of z/w
    high: NDArray[np.float64]


class _Exactly:
    """Pairs of a triangle and a pixel in rational arithmetic, each triangle's forms made once."""

    def __init__(self, positions: NDArray[np.floating[Any]], triangles: NDArray[np.int32], height: int, width: int) -> None:
        self.positions, self.triangles, self.height, self.width = positions, triangles, height, width
        self._forms: dict[int, _Forms | None] = {}

    def depth(self, index: int, px: int, py: int) -> Fraction | None:
        """z/w of a triangle at a pixel's centre; None where it does not show there."""
        if index not in self._forms:
            self._forms[index] = _forms(self.positions[self.triangles[index]].tolist(), self.height, self.width)
        forms = self._forms[index]
        if forms is None:
            return None
        u = _values(forms, px, py)
        if not all(v > 0 or (v == 0 and (a, b) > (0, 0)) for v, a, b in zip(u, forms.a, forms.b, strict=True)):
            return None
        z, w = sum(map(int.__mul__, u, forms.z)), sum(map(int.__mul__, u, forms.w))
        return Fraction(z, w) if -w <= z <= w else None


def _shown(
    filtered: _Filter,
    exact: _Exactly,
    of: NDArray[np.int64],
    row: NDArray[np.int64],
    column: NDArray[np.int64],
    rows: NDArray[np.int64],
    height: int,
    width: int,
) -> list[_Shown]:
    """Of pairs of triangle, place in ``rows``, and column, those those that show."""
    x, y = (2 * column + 1) / width - 1, 1 - (2 * rows[row] + 1) / height
    sign, u = filtered.sign[of], []
    left = np.ones(len(of), np.bool_)
    for k in range(3):
        n = filtered.normal[:, k]
        u.append(sign * ((n[of, 0] * x + n[of, 1] * y) + n[of, 2]))
        left &= (u[k] >= -filtered.error[of, k]) | (sign == 0)
    of, row, column, sign = of[left], row[left], column[left], sign[left]
    weights, error = np.stack(u, axis=1)[left], filtered.error[of]
    z, w = ((weights * values[of]).sum(axis=1) for values in (filtered.z, filtered.w))
    off_z, off_w = (
        ((error + _ROUNDINGS * np.abs(weights)) * np.abs(values[of])).sum(axis=1) + 1e-300 for values in (filtered.z, filtered.w)
    )
    inside = (weights > error).all(axis=1) & (sign != 0) & (w > 2 * off_w)
    margin = w - np.abs(z)
    sure = inside & (margin > off_z + off_w)
    unsure = ~sure & ~(inside & (margin < -(off_z + off_w)))
    key = (row * width + column) * len(exact.triangles) + of
    depth, off = z[sure] / w[sure], 2 * (off_z[sure] + off_w[sure]) / w[sure] + _ROUNDINGS
    found = [
        (int(k), exact.depth(int(t), int(c), int(rows[r])))
        for k, t, c, r in zip(key[unsure], of[unsure], column[unsure], row[unsure], strict=True)
    ]
    there = [(k, float(d)) for k, d in found if d is not None]
    more = np.array([d for _, d in there], np.float64)
    keys = np.array([k for k, _ in there], np.int64)
    return [_Shown(key[sure], depth - off, depth + off), _Shown(keys, more - _ROUNDINGS, more + _ROUNDINGS)]


def _nearest(
    key: NDArray[np.int64],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    exact: _Exactly,
    rows: NDArray[np.int64],
    shape: tuple[int, int],
) -> NDArray[np.int32]:
    """int32 [R * W]: the nearest triangle of pairs in order; float64 decides where no other one's bounds reach it."""
    nearest = np.full(shape[0] * shape[1], BACKGROUND, np.int32)
    if not len(key):
        return nearest
    pixel, triangle = np.divmod(key, len(exact.triangles))
    best = np.full(len(nearest), np.inf)
    np.minimum.at(best, pixel, high)
    close = low <= best[pixel]
    pixel, triangle = pixel[close], triangle[close]
    alone = np.bincount(pixel, minlength=len(nearest)) == 1
    nearest[pixel[alone[pixel]]] = triangle[alone[pixel]]
    of_pixel: dict[int, list[int]] = {}
    for place, index in zip(pixel[~alone[pixel]].tolist(), triangle[~alone[pixel]].tolist(), strict=True):
        of_pixel.setdefault(place, []).append(index)
    for place, several in of_pixel.items():
        row, px = divmod(place, shape[1])
        depths = [exact.depth(index, px, int(rows[row])) for index in several]
        nearest[place] = min((depth, index) for depth, index in zip(depths, several, strict=True) if depth is not None)[1]
    return nearest

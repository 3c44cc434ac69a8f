"""What is truly seen, in exact rational arithmetic: the measure of every rung, and computed by none of them.

Nothing here is clipped, snapped or rounded, and no formula is shared with the stages. Clip-space positions become integers,
scaled by a power of two, which changes no direction; whatever follows is a ratio of integers. That is slow: it is for scenes of
some ten thousand fragments.

* ``seen`` is the truth of coverage, depth and weights: that of the triangles as they were given.
* ``planes`` is the truth of depth alone: of the planes through the vertices that a rung has snapped, so that what snapping moved
  is not counted as an error of depth.

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
            u = [a * px + b * py + c for a, b, c in zip(forms.a, forms.b, forms.c, strict=True)]
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
            here = min(max(here, Fraction(min(record.z))), Fraction(max(record.z)))
            if here > 1:
                continue
            times[py, px] += 1
            if nearest[py, px] == BACKGROUND or here < depth[py, px]:
                nearest[py, px], depth[py, px] = record.triangle, here
    return Seen(nearest, depth, weights, times)

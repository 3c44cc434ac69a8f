"""The usual ways to test a pixel's centre against a triangle, in float32, as found in public code. None of them is exact.

Every variant gets the triangle that bigtri gets: snapped to 1/256 px, positively oriented, so that what differs is the
arithmetic alone. Products with a row or a column of samples are computed once per row or column; the roundings are those of
the code in question.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]
Box = tuple[int, int, int, int]
Float = NDArray[np.float32]
Corners = NDArray[np.int64]  # [3, 2], subpx
_F = np.float32


def coverage(variant: str, corners: Corners, box: Box) -> Mask:
    """bool [y1 - y0, x1 - x0]: what the variant draws of the pixels of ``box``; ``corners`` with a positive area, subpx."""
    with np.errstate(all="ignore"):
        return _VARIANTS[variant](corners, box)


def fixed4(xy: NDArray[np.int64]) -> NDArray[np.int64]:
    """Vertices [..., 2] moved to a grid of 1/16 px, in subpx: fixed point with four sub-pixel bits, otherwise exact."""
    return 16 * np.rint(xy / 16).astype(np.int64)


def _samples(box: Box) -> tuple[Float, Float]:
    """Pixel centres: x of the columns, y of the rows, px."""
    x0, y0, x1, y1 = box
    return np.arange(x0, x1, dtype=_F) + _F(0.5), np.arange(y0, y1, dtype=_F) + _F(0.5)


def _edges(corners: Corners) -> list[tuple[Float, Float]]:
    """First point and direction of each edge, px, float32; the edge opposite vertex 0 first."""
    v = (corners / 256).astype(_F)
    return [(v[(k + 1) % 3], v[(k + 2) % 3] - v[(k + 1) % 3]) for k in range(3)]


def _difference(corners: Corners, box: Box) -> list[Float]:
    """dx * (sy - py) - dy * (sx - px) of the three edges, every operation rounded."""
    sx, sy = _samples(box)
    return [(d[0] * (sy - p[1]))[:, None] - (d[1] * (sx - p[0]))[None, :] for p, d in _edges(corners)]


def _top_left(corners: Corners, values: list[Float]) -> Mask:
    inside = np.ones(values[0].shape, np.bool_)
    for (_, d), value in zip(_edges(corners), values, strict=True):
        inside &= value >= 0 if d[1] < 0 or (d[1] == 0 and d[0] > 0) else value > 0
    return inside


def _all(values: list[Float], test: Callable[[Float], Mask]) -> Mask:
    return test(values[0]) & test(values[1]) & test(values[2])


def _area(corners: Corners) -> np.float32:
    v = (corners / 256).astype(_F)
    return (v[1, 0] - v[0, 0]) * (v[2, 1] - v[0, 1]) - (v[1, 1] - v[0, 1]) * (v[2, 0] - v[0, 0])


def _incl(corners: Corners, box: Box) -> Mask:
    """All three edge functions >= 0: no fill rule."""
    return _all(_difference(corners, box), lambda e: e >= 0)


def _strict(corners: Corners, box: Box) -> Mask:
    """All three barycentric coordinates > 0."""
    area = _area(corners)
    return _all([e / area for e in _difference(corners, box)], lambda e: e > 0)


def _tl(corners: Corners, box: Box) -> Mask:
    """Difference form and top-left rule: float32 done with care."""
    return _top_left(corners, _difference(corners, box))


def _fma(corners: Corners, box: Box) -> Mask:
    """The same source, contracted by the compiler: one of the two products is not rounded. float64 holds it exactly."""
    sx, sy = _samples(box)
    values = []
    for p, d in _edges(corners):
        exact = np.float64(d[0]) * (sy - p[1]).astype(np.float64)
        values.append((exact[:, None] - (d[1] * (sx - p[0])).astype(np.float64)[None, :]).astype(_F))
    return _top_left(corners, values)


def _plane(corners: Corners, box: Box) -> Mask:
    """A * x + B * y + C and the top-left rule."""
    sx, sy = _samples(box)
    values = []
    for p, d in _edges(corners):
        c = d[1] * p[0] - d[0] * p[1]
        values.append(((-d[1] * sx)[None, :] + (d[0] * sy)[:, None]) + c)
    return _top_left(corners, values)


def _third(corners: Corners, box: Box) -> Mask:
    """Two barycentric coordinates, and the third as one minus the others; all >= 0."""
    area = _area(corners)
    u, v, _ = (e / area for e in _difference(corners, box))
    return (u >= 0) & (v >= 0) & ((_F(1) - u) - v >= 0)


def _step(corners: Corners, box: Box) -> Mask:
    """The value at the first pixel by the difference form, the others by adding steps, row by row; top-left rule."""
    x0, y0, x1, y1 = box
    if x0 >= x1 or y0 >= y1:
        return np.zeros((y1 - y0, x1 - x0), np.bool_)
    firsts = _difference(corners, (x0, y0, x0 + 1, y0 + 1))
    values = []
    for (_, d), first in zip(_edges(corners), firsts, strict=True):
        column = np.add.accumulate(np.concatenate([first[0], np.full(y1 - y0 - 1, d[0], _F)]), dtype=_F)
        steps = np.full((y1 - y0, x1 - x0), -d[1], _F)
        steps[:, 0] = column
        values.append(np.add.accumulate(steps, axis=1, dtype=_F))
    return _top_left(corners, values)


def _i32(corners: Corners, box: Box) -> Mask:
    """The exact method with int32 products, which wrap."""
    x0, y0, x1, y1 = box
    v = corners.astype(np.int32)
    sx, sy = (256 * np.arange(a, b, dtype=np.int32) + np.int32(128) for a, b in ((x0, x1), (y0, y1)))
    inside = np.ones((y1 - y0, x1 - x0), np.bool_)
    for k in range(3):
        p, d = v[(k + 1) % 3], v[(k + 2) % 3] - v[(k + 1) % 3]
        value = (d[0] * (sy - p[1]))[:, None] - (d[1] * (sx - p[0]))[None, :]
        inside &= value >= 0 if d[1] < 0 or (d[1] == 0 and d[0] > 0) else value > 0
    return inside


_VARIANTS: dict[str, Callable[[Corners, Box], Mask]] = {
    "incl": _incl,
    "strict": _strict,
    "tl": _tl,
    "fma": _fma,
    "plane": _plane,
    "third": _third,
    "step": _step,
    "i32": _i32,
}
VARIANTS = tuple(_VARIANTS)

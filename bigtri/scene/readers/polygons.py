"""Polygons to triangles: a fan where they are convex, ears clipped where not."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .model import Model, ModelError

# Time and memory of clipping ears grow with the square of the corners; no polygon of a model that was meant has as many.
MAX_CORNERS = 1 << 12
# Corners times corners of polygons whose ears are clipped at a time.
_BLOCK = 1 << 18


def triangulate(
    model: Model, positions: NDArray[Any], corners: NDArray[np.int32], count: NDArray[np.integer]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Cuts polygons into triangles of the same corners: n - 2 of n corners, also where some have no area.

    A polygon that crosses itself, or is far from flat, has no right triangulation; it gets some.

    Args:
        model: gets as findings what cannot be drawn.
        positions: float32 or float64 [V, 3].
        corners: int32 [C], the vertex of each corner, those of a polygon after each other, counter-clockwise from the front.
        count: integers [F], how many corners each polygon has; C in all. Those of less than three have no triangles.

    Returns:
        corner: int64 [T, 3], indices into ``corners``, in the order of the polygons, turned as their polygon is;
        polygon: int64 [T], of which each triangle is a part.
    """
    count = count.astype(np.int64)
    first = np.cumsum(count) - count
    parts = np.maximum(count - 2, 0)
    begin = np.cumsum(parts) - parts
    triangles = np.empty((int(parts.sum()), 3), np.int64)
    skipped = 0
    for n in np.unique(count[count > 2]).tolist():
        which = np.flatnonzero(count == n)
        rows = begin[which, None] + np.arange(n - 2)
        triangles[rows] = first[which, None, None] + _fan(n)
        if n == 3:
            continue
        step = max(_BLOCK // (n * n), 1)
        for some in (slice(i, i + step) for i in range(0, len(which), step)):
            points = positions[corners[first[which[some], None] + np.arange(n)]].astype(np.float64)
            flat, concave = _flattened(points)
            if not concave.any():
                continue
            if n > MAX_CORNERS:
                skipped += int(concave.sum())
                continue
            triangles[rows[some][concave]] = first[which[some][concave], None, None] + _ears(flat[concave])
    if skipped:
        model.found(
            "large concave polygons",
            f"{skipped} concave polygons have more than {MAX_CORNERS} corners: they are drawn as if they were convex",
        )
    if (count < 3).any():
        model.found(
            "faces of one or two corners", f"{int((count < 3).sum())} faces have fewer than 3 corners: they are not drawn"
        )
    return triangles, np.repeat(np.arange(len(count)), parts)


def indices_of(what: str, values: NDArray[Any], size: int) -> NDArray[np.int32]:
    """``values`` of any type as int32.

    Raises:
        ModelError: one is not a whole number, or not that of one of ``size`` vertices.
    """
    if len(values) and not (values.min() >= 0 and values.max() < size):
        got = f"indices from {values.min():.0f} to {values.max():.0f}"
        raise ModelError(f"{what} must index the {size} vertices, got {got}")
    indices = values.astype(np.int32)
    if values.dtype.kind == "f" and not np.array_equal(indices, values):
        raise ModelError(f"{what} must index the vertices by whole numbers, got {values[indices != values][0]}")
    return indices


def _fan(n: int) -> NDArray[np.int64]:
    """[n - 2, 3]: (0, 1, 2), then (2, 3, 0), (3, 4, 0) and so on."""
    i = np.arange(1, n - 1)
    fan = np.stack([i, i + 1, np.zeros_like(i)], axis=1)
    fan[0] = (0, 1, 2)
    return fan


def _flattened(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Polygons [P, n, 3] in a plane, float64 [P, n, 2], counter-clockwise; and whether they may be concave, bool [P].

    The coordinate is dropped in which the polygon turns its front, or its back, most. The others keep their bits.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is no concave polygon
        from_first = points - points[:, :1]
        normal = np.cross(from_first[:, 1:-1], from_first[:, 2:]).sum(axis=1)
        after = np.roll(points, -1, axis=1) - points
        turns = np.cross(np.roll(after, 1, axis=1), after)
        concave = ((turns * normal[:, None]).sum(axis=2) < 0).any(axis=1)
        # A corner that is there twice shows no turn, whichever way the polygon turns in it.
        concave |= (after == 0).all(axis=2).any(axis=1)
    drop = np.argmax(np.abs(normal), axis=1)
    kept = (drop[:, None] + (1, 2)) % 3
    backward = np.take_along_axis(normal, drop[:, None], axis=1)[:, 0] < 0
    kept[backward] = kept[backward, ::-1]
    return np.take_along_axis(points, kept[:, None], axis=2), concave


def _ears(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Triangles [P, n - 2, 3] of polygons [P, n, 2] that are counter-clockwise.

    An ear is a corner at which the polygon turns left and whose triangle, the edges included, holds no other corner; those in the
    same place as one of its own do not count, since a polygon with a hole goes to it and back by the same edge. All polygons are
    walked round in step.
    """
    polygons, n = points.shape[:2]
    triangles = np.empty((polygons, n - 2, 3), np.int64)
    before, after = np.tile(np.arange(n) - 1, (polygons, 1)) % n, np.tile(np.arange(n) + 1, (polygons, 1)) % n
    present = np.ones((polygons, n), bool)
    corner, cut, passed = (np.zeros(polygons, np.int64) for _ in range(3))
    active = np.arange(polygons)
    while len(active):
        at = corner[active]
        ear = np.stack([before[active, at], at, after[active, at]], axis=1)
        triangle = points[active[:, None], ear]
        area = _side(triangle[:, :1], triangle[:, 1:2], triangle[:, 2:])[:, 0]
        left = n - cut[active]
        # Where no corner of a whole round was an ear: one that is straight or a spike, then any one.
        clipped = (area > 0) & ~_holds_any(triangle, points[active], present[active])
        clipped |= (passed[active] >= left) & (area == 0)
        clipped |= (passed[active] >= 2 * left) | (left == 3)
        passed[active] += 1
        corner[active] = ear[:, 2]

        done, ear = active[clipped], ear[clipped]
        triangles[done, cut[done]] = ear
        after[done, ear[:, 0]], before[done, ear[:, 2]] = ear[:, 2], ear[:, 0]
        present[done, ear[:, 1]] = False
        # Going on behind the next corner makes fewer thin triangles than clipping the same side again.
        corner[done] = after[done, ear[:, 2]]
        passed[done] = 0
        cut[done] += 1
        active = active[cut[active] < n - 2]
    return triangles


def _holds_any(triangle: NDArray[np.float64], points: NDArray[np.float64], present: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """bool [P]: whether a triangle [P, 3, 2] has one of the points [P, n, 2] that are present within it or on its edges."""
    a, b, c = (triangle[:, i : i + 1] for i in range(3))
    inside: NDArray[np.bool_] = present & (_side(a, b, points) >= 0) & (_side(b, c, points) >= 0) & (_side(c, a, points) >= 0)
    for own in (a, b, c):
        inside &= (points != own).any(axis=2)
    return np.logical_or.reduce(inside, axis=1)


def _side(a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64]) -> NDArray[np.float64]:
    """Positive where c is left of the way from a to b; twice the area of the triangle."""
    return (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0])

"""Setup: from clip-space triangles to oriented, snapped records; docs/numerics.md section 2."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..precision import EXACT, Arithmetic
from .clip import NEAR, X_HIGH, X_LOW, Y_HIGH, Y_LOW, Polygons, W, X, Y, Z, clip, clip_planes
from .float_mode import default_float_mode
from .numerics import ramp
from .records import Records

Scissor = tuple[int, int, int, int]  # x0, y0, x1, y1, px, half-open


class _Snapped(NamedTuple):
    """Triangles on the sub-pixel grid, not yet oriented: whole triangles and the sub-triangles of clipped ones."""

    triangle: NDArray[np.int64]  # [N]
    xy: NDArray[np.int64]  # [N, 3, 2], subpx
    z: NDArray[np.float32]  # [N, 3]
    w: NDArray[np.float64]  # [N, 3]
    corner: NDArray[np.int64]  # [N, 3]
    weights: NDArray[np.float64]  # [N, 3, 3]
    clipped: NDArray[np.bool_]  # [N]
    place: NDArray[np.float32]  # [N, 3 or 0, 2], px


@default_float_mode
def setup(
    positions: NDArray[np.float32],
    triangles: NDArray[np.int32],
    height: int,
    width: int,
    cull: str = "none",
    scissor: Scissor | None = None,
    arithmetic: Arithmetic = EXACT,
) -> tuple[Records, int]:
    """Clips, projects, snaps, orients and culls triangles.

    Args:
        positions: float32 [V, 4], clip space.
        triangles: int32 [T, 3], valid indices into ``positions``.
        height, width: the image's size, px.
        cull: "none", "back" or "front": the faces that are not drawn.
        scissor: x0, y0, x1, y1, px, half-open: the part of the image that is drawn to.
        arithmetic: the rung of the precision ladder.

    Returns:
        The records in the order of (triangle, fan position), and the number of triangles dropped for a NaN or an infinity.
    """
    corners = positions[triangles]  # f32 [T, 3, 4]
    finite: NDArray[np.bool_] = np.all(np.isfinite(corners), axis=(1, 2))
    planes = clip_planes(height, width, arithmetic)
    with np.errstate(invalid="ignore"):  # of triangles that are dropped
        inside = np.stack([plane.distance(corners.astype(np.float64)) >= 0 for plane in planes], axis=-1)  # [T, 3, 6]
    candidate = finite & np.all(np.any(inside, axis=1), axis=1)  # not wholly outside one plane
    uncut = np.all(inside, axis=(1, 2))

    # Inside all planes w >= 0, and w = 0 only at the origin of clip space, which is nowhere on the screen.
    whole = np.flatnonzero(candidate & uncut & (corners[:, :, W] > 0).all(axis=1))
    parts = [_snap_whole(whole, corners[whole], height, width, arithmetic)]
    cut = np.flatnonzero(candidate & ~uncut & (arithmetic.precision.clip != "none"))
    if cut.size:
        polygons, corner = clip(corners[cut].astype(np.float64), planes, arithmetic)
        parts.append(_snap_polygons(cut, polygons, corner, height, width, arithmetic))
    fields: list[Any] = [np.concatenate(field) for field in zip(*parts, strict=True)]
    order = np.argsort(fields[0], kind="stable")  # by triangle; stable: sub-triangles stay in fan order
    snapped = _Snapped(*(field[order] for field in fields))
    return _records(snapped, height, width, cull, scissor, arithmetic), int(len(finite) - finite.sum())


def _snap_whole(
    triangle: NDArray[np.int64], corners: NDArray[np.float32], height: int, width: int, arithmetic: Arithmetic
) -> _Snapped:
    """Triangles ``corners`` [N, 3, 4] that no plane cuts."""
    count = len(triangle)
    return _Snapped(
        triangle,
        _snap(corners.astype(np.float64), height, width, arithmetic),
        _vertex_depth(corners[..., Z], corners[..., W], arithmetic),  # float32 throughout
        corners[..., W].astype(np.float64),
        corner=np.tile(np.arange(3), (count, 1)),
        weights=np.tile(np.eye(3), (count, 1, 1)),
        clipped=np.zeros(count, np.bool_),
        place=_place(corners, height, width, arithmetic),
    )


def _place(position: NDArray[np.floating], height: int, width: int, arithmetic: Arithmetic) -> NDArray[np.floating]:
    """[N, 3, 2] of ``position`` [N, 3, 4]: vertices in px, y down, in its precision; [N, 0, 2] if the rung needs none."""
    if not arithmetic.is_unsnapped:
        return np.zeros((len(position), 0, 2), position.dtype)
    x, y, w = position[..., X], position[..., Y], position[..., W]
    size_x, size_y = position.dtype.type(width), position.dtype.type(height)
    with np.errstate(over="ignore", under="ignore"):
        return np.stack([((x / w) * 0.5 + 0.5) * size_x, (0.5 - (y / w) * 0.5) * size_y], axis=-1)


def _snap(position: NDArray[np.float64], height: int, width: int, arithmetic: Arithmetic) -> NDArray[np.int64]:
    """int64 [..., 2]: clip-space ``position`` [..., 4], w > 0, on the sub-pixel grid, y down, within the guard band."""
    half_w, half_h = arithmetic.half * width, arithmetic.half * height  # the viewport's centre, subpx
    guard = arithmetic.guard
    with np.errstate(over="ignore"):  # infinity is clamped too
        x = np.rint(position[..., X] / position[..., W] * half_w)
        y = np.rint(position[..., Y] / position[..., W] * half_h)
    x = np.clip(x, -guard - half_w, guard - 1 - half_w).astype(np.int64)
    y = np.clip(y, half_h - guard + 1, half_h + guard).astype(np.int64)
    return np.stack([half_w + x, half_h - y], axis=-1)


def _snap_polygons(
    triangle: NDArray[np.int64],
    polygons: Polygons,
    corner: NDArray[np.int64],
    height: int,
    width: int,
    arithmetic: Arithmetic,
) -> _Snapped:
    """The fans of clipped ``polygons``; ``triangle`` [C] and ``corner`` [C, 3] are by owner."""
    xy = _snap_clipped(polygons, height, width, arithmetic)  # [M, 2]
    z = _clipped_depth(polygons, arithmetic)  # [M]
    w = polygons.position[:, W]
    fan = _fans(polygons.owner, xy, z, w)  # [N, 3]
    owner = polygons.owner[fan[:, 0]]
    return _Snapped(
        triangle[owner],
        xy[fan],
        z[fan],
        w[fan],
        corner[owner],
        polygons.weights[fan],
        clipped=np.ones(len(fan), np.bool_),
        place=_clipped_place(polygons, fan, height, width, arithmetic),
    )


def _clipped_place(
    polygons: Polygons, fan: NDArray[np.int64], height: int, width: int, arithmetic: Arithmetic
) -> NDArray[np.float32]:
    """float32 [N, 3 or 0, 2]: of an original vertex as an unclipped triangle has it, of a new one in float64, rounded once."""
    position = polygons.position[fan]  # [N, 3, 4]
    made = _place(position, height, width, arithmetic).astype(np.float32)
    if not arithmetic.is_unsnapped:
        return made
    original = _place(position.astype(np.float32), height, width, arithmetic)
    return np.where(polygons.made[fan][..., None] == 0, original, made)


def _snap_clipped(polygons: Polygons, height: int, width: int, arithmetic: Arithmetic) -> NDArray[np.int64]:
    """int64 [M, 2]: ``_snap``, but a vertex that a guard plane made lies on that plane exactly."""
    xy = _snap(polygons.position, height, width, arithmetic)
    low, high = -arithmetic.guard, arithmetic.guard - 1
    for plane, axis, value in ((X_LOW, 0, low), (X_HIGH, 0, high), (Y_LOW, 1, low), (Y_HIGH, 1, high)):
        xy[_made_by(polygons, plane), axis] = value
    return xy


def _clipped_depth(polygons: Polygons, arithmetic: Arithmetic) -> NDArray[np.float32]:
    """float32 [M]: depth, not nearer than the near plane; of an original vertex as an unclipped triangle has it."""
    z, w = polygons.position[:, Z], polygons.position[:, W]
    depth = _vertex_depth(z, w, arithmetic).astype(np.float32)
    depth = np.minimum(depth, np.float32(1)) if arithmetic.reversed else np.maximum(depth, np.float32(0))
    original = polygons.made == 0
    depth[original] = _vertex_depth(z[original].astype(np.float32), w[original].astype(np.float32), arithmetic)
    depth[_made_by(polygons, NEAR)] = 1 if arithmetic.reversed else 0
    return depth


def _vertex_depth(z: NDArray[np.floating], w: NDArray[np.floating], arithmetic: Arithmetic) -> NDArray[np.floating]:
    """Window depth, 0 at the near plane and 1 at the far one, or reversed depth, 1 at the near plane and 0 at the far one.

    In the precision of its arguments, each operation rounded to it.
    """
    with np.errstate(over="ignore", under="ignore"):
        return z / w if arithmetic.reversed else (z / w) * 0.5 + 0.5


def _made_by(polygons: Polygons, plane: int) -> NDArray[np.bool_]:
    """bool [M]: whether the plane is in the set of planes that made the vertex."""
    return (polygons.made >> plane) & 1 == 1


def _fans(owner: NDArray[np.int64], xy: NDArray[np.int64], z: NDArray[np.float32], w: NDArray[np.float64]) -> NDArray[np.int64]:
    """int64 [N, 3]: the vertices of each sub-triangle, fanned out from each polygon's smallest (X, Y, z, w).

    The first vertex depends on the polygon alone, not on where the clipper began, so neither does the cut into triangles.
    """
    _, start, size = np.unique(owner, return_index=True, return_counts=True)
    # A stable sort by owner first, so that every polygon's vertices keep their places and the smallest one comes first.
    first = np.lexsort((w, z, xy[:, 1], xy[:, 0], owner))[start] - start
    k = ramp(size - 2)
    start, size, first = (np.repeat(v, size - 2) for v in (start, size, first))
    return np.stack([start + (first + offset) % size for offset in (0 * k, k + 1, k + 2)], axis=1)


def _records(snapped: _Snapped, height: int, width: int, cull: str, scissor: Scissor | None, arithmetic: Arithmetic) -> Records:
    """Orients the triangles, and leaves out those that are culled, have no area, or whose bbox holds no pixel."""
    area = _twice_area(snapped.xy)
    bbox = _bbox(snapped.xy, height, width, scissor, arithmetic)
    drawn = (area != 0) & (bbox[:, 0] < bbox[:, 2]) & (bbox[:, 1] < bbox[:, 3])
    if cull == "back":
        drawn &= area < 0  # y points down: clockwise is positive
    elif cull == "front":
        drawn &= area > 0
    area, bbox = area[drawn], bbox[drawn]
    snapped = _Snapped(*(field[drawn] for field in snapped))

    vertex = _vertex_order(snapped.xy, area)  # [N, 3]
    row = np.arange(len(area))[:, None]
    clipped = snapped.clipped[:, None]
    return Records(
        triangle=snapped.triangle.astype(np.int32),
        xy=snapped.xy[row, vertex].astype(np.int32),
        z=snapped.z[row, vertex],
        area=np.abs(area),
        bbox=bbox.astype(np.int32),
        w=snapped.w[row, vertex],
        corner=np.where(clipped, snapped.corner, snapped.corner[row, vertex]).astype(np.int32),
        weights=np.where(clipped[:, :, None], snapped.weights[row, vertex], snapped.weights),
        clipped=snapped.clipped,
        place=np.take_along_axis(snapped.place, vertex[:, :, None], axis=1) if arithmetic.is_unsnapped else snapped.place,
    )


def _twice_area(xy: NDArray[np.int64]) -> NDArray[np.int64]:
    """int64 [N]: twice the signed area of ``xy`` [N, 3, 2], subpx^2; > 0 is clockwise on the screen. 49 bits and a sign."""
    ab, ac = xy[:, 1] - xy[:, 0], xy[:, 2] - xy[:, 0]
    return ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]


def _bbox(xy: NDArray[np.int64], height: int, width: int, scissor: Scissor | None, arithmetic: Arithmetic) -> NDArray[np.int64]:
    """int64 [N, 4]: x0, y0, x1, y1 of the pixels whose centres lie within the bounds of ``xy``, cut to screen and scissor."""
    x0, y0, x1, y1 = (0, 0, width, height) if scissor is None else scissor
    half, bits = arithmetic.half, arithmetic.subpixel_bits
    first = (xy.min(axis=1) - half + arithmetic.subpixel - 1) >> bits  # ceil
    end = ((xy.max(axis=1) - half) >> bits) + 1  # floor
    first = np.maximum(first, [max(x0, 0), max(y0, 0)])
    end = np.minimum(end, [min(x1, width), min(y1, height)])
    return np.concatenate([first, end], axis=1)


def _vertex_order(xy: NDArray[np.int64], area: NDArray[np.int64]) -> NDArray[np.int64]:
    """int64 [N, 3]: the vertices in the order that makes the area positive and puts the smallest (X, Y) first."""
    order = np.where(area[:, None] < 0, [0, 2, 1], [0, 1, 2])
    key = (xy[..., 0] << 32) + xy[..., 1]  # |Y| <= 2^30 < 2^31, so X decides first; no two vertices are equal
    first = np.argmin(np.take_along_axis(key, order, axis=1), axis=1)
    return np.take_along_axis(order, (first[:, None] + np.arange(3)) % 3, axis=1)

"""Face normals, vertex normals and closedness of a mesh. float64 in a fixed order, so that every machine gets the same bits."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

# Around a vertex with more corners than this, all of them share one normal: the pairs that a crease needs grow with the square.
_MANY_CORNERS = 64


def face_normals(positions: NDArray[np.float32], triangles: NDArray[np.int32]) -> NDArray[np.float32]:
    """Unit normals float32 [T, 3] of positions [V, 3], triangles [T, 3]; (0, 0, 0) for a triangle without an area."""
    return _unit(_area_vectors(positions, triangles)).astype(np.float32)


def split_normals(
    positions: NDArray[np.float32], triangles: NDArray[np.int32], crease: float = 50.0
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float32]]:
    """Vertex normals that keep sharp edges sharp.

    At each corner the area-weighted normals of the faces around that point of space are added up, those that turn away from the
    corner's own face by more than ``crease`` degrees left out. Vertices in the same place count as one, whatever their texture
    coordinates, so that a seam of the texture is none of the surface.

    Args:
        positions: float32 [V, 3].
        triangles: int32 [T, 3].
        crease: degrees.

    Returns:
        source: int64 [N], the vertex that new vertex n is a copy of; triangles: int32 [T, 3] over the new vertices;
        normals: float32 [N, 3].
    """
    area = _area_vectors(positions, triangles)
    unit = _unit(area)
    place = weld(positions)[triangles].reshape(-1)  # [3T], the point of space of every corner; corner c is of face c // 3
    total = np.zeros((len(place), 3))

    order = np.argsort(place, kind="stable")
    sorted_place = place[order]
    first = np.searchsorted(sorted_place, sorted_place, side="left")
    count = np.searchsorted(sorted_place, sorted_place, side="right") - first

    many = count > _MANY_CORNERS
    if many.any():
        summed = np.stack([np.bincount(place, area[np.arange(len(place)) // 3, i], len(place)) for i in range(3)], axis=1)
        total[order[many]] = summed[sorted_place[many]]

    few = np.flatnonzero(~many)
    corner = np.repeat(order[few], count[few])
    within = np.arange(len(corner)) - np.repeat(np.cumsum(count[few]) - count[few], count[few])
    other = order[np.repeat(first[few], count[few]) + within] // 3
    own = corner // 3
    smooth = _dot(unit[own], unit[other]) >= math.cos(math.radians(crease))
    corner, other = corner[smooth], other[smooth]
    for i in range(3):
        total[:, i] += np.bincount(corner, area[other, i], len(place))

    # A face without an area agrees with no neighbour: it takes what its vertex has elsewhere, which cannot be seen anyway.
    normals = _unit(total).astype(np.float32) + np.float32(0)
    key = np.concatenate([triangles.reshape(-1, 1), normals.view(np.int32)], axis=1)
    unique, inverse = np.unique(key, axis=0, return_inverse=True)
    return unique[:, 0].astype(np.int64), inverse.reshape(-1, 3).astype(np.int32), unique[:, 1:].copy().view(np.float32)


def is_closed(positions: NDArray[np.float32], triangles: NDArray[np.int32]) -> bool:
    """Whether the mesh is the closed surface of a solid, its front faces outside.

    Every directed edge must come with as many of its reverse, vertices in the same place counting as one, and the volume must be
    positive.
    """
    place = weld(positions)[triangles].astype(np.int64)
    solid = (place[:, 0] != place[:, 1]) & (place[:, 1] != place[:, 2]) & (place[:, 2] != place[:, 0])
    place, corners = place[solid], positions[triangles[solid]].astype(np.float64)
    if len(place) == 0:
        return False
    tail, head = place.reshape(-1), place[:, (1, 2, 0)].reshape(-1)
    size = len(positions)
    if not np.array_equal(np.sort(tail * size + head), np.sort(head * size + tail)):
        return False
    corners = corners - corners[0, 0]
    return bool(np.sum(_dot(corners[:, 0], _cross(corners[:, 1], corners[:, 2]))) > 0)


def weld(positions: NDArray[np.float32]) -> NDArray[np.int64]:
    """int64 [V]: the same number for vertices in exactly the same place."""
    if len(positions) == 0:
        return np.zeros(0, np.int64)
    return np.unique(positions + np.float32(0), axis=0, return_inverse=True)[1].reshape(-1)


def _area_vectors(positions: NDArray[np.float32], triangles: NDArray[np.int32]) -> NDArray[np.float64]:
    corners = positions[triangles].astype(np.float64)
    return _cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack(
        [
            a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1],
            a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2],
            a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0],
        ],
        axis=1,
    )


def _dot(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return (a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1]) + a[:, 2] * b[:, 2]


def _unit(v: NDArray[np.float64]) -> NDArray[np.float64]:
    length = np.sqrt(_dot(v, v))[:, None]
    return np.divide(v, length, out=np.zeros_like(v), where=(length > 0) & np.isfinite(length))

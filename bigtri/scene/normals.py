"""Face normals, vertex normals and closedness of a mesh. float64 in a fixed order, so that every machine gets the same bits.

Vectors are arrays [3, ...], one row a component. What is long is worked on in chunks, so that the memory needed is about that of
the result.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from .rows import changes, sorted_rows, unify

# Around a vertex with more corners than this, all of them share one normal: the pairs that a crease needs grow with the square.
_MANY_CORNERS = 64

# Triangles, or corners, that are worked on at a time: their temporaries stay in the cache.
_CHUNK = 1 << 16
# Corners that are split at a time: temporaries small beside a large mesh, few calls for a small one.
_BLOCK = 1 << 19


def face_normals(positions: NDArray[np.float32], triangles: NDArray[np.int32]) -> NDArray[np.float32]:
    """Unit normals float32 [T, 3] of positions [V, 3], triangles [T, 3]; (0, 0, 0) for a triangle without an area."""
    normals = np.empty((len(triangles), 3), np.float32)
    for chunk in _chunks(len(triangles)):
        normals[chunk] = _unit(_area_vectors(positions, triangles[chunk])).T
    return normals


def split_normals(
    positions: NDArray[np.float32],
    triangles: NDArray[np.int32],
    crease: float = 50.0,
    place: NDArray[np.int32] | None = None,
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float32]]:
    """Vertex normals that keep sharp edges sharp.

    At each corner the area-weighted normals of the faces around that point of space are added up, in the order of the faces.
    Those that turn away from the corner's own face by more than ``crease`` degrees are left out. Vertices in the same place
    count as one, whatever their texture coordinates, so that a seam of the texture is none of the surface.

    Args:
        positions: float32 [V, 3].
        triangles: int32 [T, 3].
        crease: degrees, in [0, 180].
        place: ``weld(positions)``, where it is known.

    Returns:
        source: int64 [N], the vertex that new vertex n is a copy of; triangles: int32 [T, 3] over the new vertices;
        normals: float32 [N, 3]. New vertices are ordered by source, then by the bits of the normal.
    """
    if place is None:
        place = weld(positions)
    middle = _unit(_sums(positions, triangles, place))
    creased = _creased(positions, triangles, place, middle, crease)
    uncreased_normals = _rounded(middle)
    del middle

    # Where there is no crease, a vertex has one normal and stays one vertex. Elsewhere it has a copy for each normal.
    corner_vertex = triangles.reshape(-1)
    copies = np.zeros(len(positions), np.int64)
    copies[corner_vertex] = 1
    copy = np.zeros_like(triangles)  # of its vertex that a corner has
    split = []
    for corner, its_place in _blocks_of_corners(triangles, place, creased):
        vertex = corner_vertex[corner]
        normals = _creased_normals(positions, triangles, corner, its_place, crease)
        order, is_first = sorted_rows([vertex, *normals.T.copy().view(np.int32)])
        first = order[is_first]
        made_of = vertex[first]
        number = (np.arange(len(first)) - np.searchsorted(made_of, made_of)).astype(np.int32)
        copies[made_of] = number + 1  # the last one stays
        copy.reshape(-1)[corner[order]] = number[np.cumsum(is_first) - 1]
        split.append((made_of, number, normals[first]))

    begin = np.cumsum(copies) - copies
    source = np.repeat(np.arange(len(positions)), copies)
    normals = uncreased_normals[place[source]]
    for made_of, number, their_normals in split:
        normals[begin[made_of] + number] = their_normals
    for chunk in _chunks(len(triangles)):
        copy[chunk] += begin[triangles[chunk]]
    return source, copy, normals


def smooth_normals(positions: NDArray[np.float32], triangles: NDArray[np.int32], place: NDArray[np.int32]) -> NDArray[np.float32]:
    """Normals float32 [V, 3] as ``split_normals`` has them without any crease; (0, 0, 0) where no triangle has an area."""
    return _rounded(_unit(_sums(positions, triangles, place)))[place]


def is_closed(positions: NDArray[np.float32], triangles: NDArray[np.int32], place: NDArray[np.int32] | None = None) -> bool:
    """Whether the mesh is the closed surface of a solid, its front faces outside.

    Every directed edge must come with as many of its reverse, vertices in the same place counting as one, and the volume must be
    positive. ``place`` is ``weld(positions)``, where it is known.
    """
    if place is None:
        place = weld(positions)
    return _edges_cancel(place, triangles) and _volume(positions, place, triangles) > 0


def weld(positions: NDArray[np.float32]) -> NDArray[np.int32]:
    """int32 [V]: the same number, below V, for vertices in exactly the same place."""
    return unify(list(np.add(positions.T, np.float32(0), order="C").view(np.int32)))[1]  # -0 is 0


def _sums(positions: NDArray[np.float32], triangles: NDArray[np.int32], place: NDArray[np.int32]) -> NDArray[np.float64]:
    """float64 [3, V]: the area vectors around each place, added up in the order of the faces."""
    total = np.zeros((3, len(positions)))
    for chunk in _chunks(len(triangles)):
        corners = place[triangles[chunk]].reshape(-1)
        for component, area in zip(total, _area_vectors(positions, triangles[chunk]), strict=True):
            np.add.at(component, corners, np.repeat(area, 3))
    return total


def _creased(
    positions: NDArray[np.float32],
    triangles: NDArray[np.int32],
    place: NDArray[np.int32],
    middle: NDArray[np.float64],
    crease: float,
) -> NDArray[np.bool_]:
    """bool [V]: whether faces around a place may be more than ``crease`` degrees apart.

    No two are where each is within half of that of their middle, float64 [3, V]. What rounding may do to that is far below the
    1e-6 added here.
    """
    nearest = math.cos(math.radians(crease / 2)) + 1e-6
    creased = np.zeros(len(positions), bool)
    for chunk in _chunks(len(triangles)):
        unit = _unit(_area_vectors(positions, triangles[chunk]))
        for corner in place[triangles[chunk]].T:
            creased[corner[_dot(unit, middle.take(corner, axis=1)) < nearest]] = True
    if creased.any():
        count = np.zeros(len(positions), np.int64)
        for chunk in _chunks(len(triangles)):
            np.add.at(count, place[triangles[chunk]].reshape(-1), 1)
        creased &= count <= _MANY_CORNERS
    return creased


def _blocks_of_corners(
    triangles: NDArray[np.int32], place: NDArray[np.int32], creased: NDArray[np.bool_]
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """The corners [N] of creased places and their places [N]: sorted by place, then rising; all of a place together."""
    # Place and corner in one number sort without an order beside them.
    corners_of_chunk = (3 * chunk.start + np.flatnonzero(creased[place[triangles[chunk]]]) for chunk in _chunks(len(triangles)))
    corners = np.concatenate([*corners_of_chunk, np.zeros(0, np.int64)])
    corners |= place[triangles.reshape(-1)[corners]].astype(np.int64) << 32
    corners.sort()
    begin = 0
    while begin < len(corners):
        end = begin + _BLOCK
        if end < len(corners):
            end = int(np.searchsorted(corners, ((corners[end] >> 32) + 1) << 32))
        yield corners[begin:end] & 0xFFFFFFFF, corners[begin:end] >> 32
        begin = end


def _creased_normals(
    positions: NDArray[np.float32],
    triangles: NDArray[np.int32],
    corner: NDArray[np.int64],
    place: NDArray[np.int64],
    crease: float,
) -> NDArray[np.float32]:
    """float32 [N, 3]: the normal of each corner [N] of places [N], as ``_blocks_of_corners`` has them."""
    cosine = math.cos(math.radians(crease))
    normals = np.empty((len(corner), 3), np.float32)
    begin = np.flatnonzero(changes(place))
    count = np.diff(begin, append=len(place))
    for size in np.unique(count).tolist():
        begin_of_size = begin[count == size]
        for chunk in _chunks(len(begin_of_size), size):
            around = begin_of_size[chunk] + np.arange(size)[:, None]  # [size, places]
            area = _area_vectors(positions, triangles[(corner[around] // 3).reshape(-1)]).reshape(3, *around.shape)
            unit = _unit(area)
            total = np.zeros_like(area)
            for other in range(size):
                smooth = _dot(unit, unit[:, other, None]) >= cosine
                total += np.where(smooth, area[:, other, None], 0)
            # A face without an area agrees with no neighbour: its normal is 0, which cannot be seen.
            normals[around] = _rounded(_unit(total))
    return normals


def _edges_cancel(place: NDArray[np.int32], triangles: NDArray[np.int32]) -> bool:
    """Whether every directed edge between places [V] comes with as many of its reverse."""
    count = [0, 0]
    for tail, head in _edges(place, triangles):
        count[0] += int(np.count_nonzero(tail < head))
        count[1] += int(np.count_nonzero(tail > head))
    if count[0] != count[1]:
        return False
    keys, filled, hashed = np.empty((2, count[0]), np.int64), [0, 0], [0, 0]
    for tail, head in _edges(place, triangles):
        for way, (low, high) in enumerate(((tail, head), (head, tail))):
            edges = (low * len(place) + high)[low < high]
            keys[way, filled[way] : filled[way] + len(edges)] = edges
            filled[way] += len(edges)
            hashed[way] += _hashed(edges)
    # Sorting is needed only to be certain that they do.
    if hashed[0] % 2**64 != hashed[1] % 2**64:
        return False
    if count[0] > _CHUNK:
        with ThreadPoolExecutor(2) as pool:
            list(pool.map(np.ndarray.sort, keys))
    else:  # starting threads takes longer
        keys.sort(axis=1)
    return np.array_equal(keys[0], keys[1])


def _hashed(values: NDArray[np.int64]) -> int:
    """The sum of a number for each value that says nothing about the numbers of others."""
    mixed = values.view(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    mixed ^= mixed >> np.uint64(32)
    mixed *= np.uint64(0xD6E8FEB86659FD93)
    mixed ^= mixed >> np.uint64(32)
    return int(mixed.sum())


def _edges(place: NDArray[np.int32], triangles: NDArray[np.int32]) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """The places that edges lead from and to."""
    for chunk in _chunks(len(triangles)):
        a, b, c = place[triangles[chunk]].T.astype(np.int64)
        yield from ((a, b), (b, c), (c, a))


def _volume(positions: NDArray[np.float32], place: NDArray[np.int32], triangles: NDArray[np.int32]) -> float:
    """Six times the volume within a closed surface."""
    parts, origin = [], None
    for chunk in _chunks(len(triangles)):
        a, b, c = place[triangles[chunk]].T
        corners = _corners(positions, triangles[chunk][(a != b) & (b != c) & (c != a)])
        if origin is None and corners.size:
            origin = corners[:, 0, 0].copy()
        if origin is not None:
            corners = corners - origin[:, None, None]
            parts.append(_dot(corners[:, 0], _cross(corners[:, 1], corners[:, 2])))
    return float(np.sum(np.concatenate(parts))) if parts else 0.0


def _chunks(count: int, size: int = 1) -> Iterator[slice]:
    """Slices of ``count`` elements, each of which stands for ``size``, that are worked on at a time."""
    step = max(_CHUNK // size, 1)
    return (slice(i, i + step) for i in range(0, count, step))


def _corners(positions: NDArray[np.float32], triangles: NDArray[np.int32]) -> NDArray[np.float64]:
    """float64 [3, 3, T]: components of the corners of triangles."""
    return np.ascontiguousarray(positions.take(triangles, axis=0).transpose(2, 1, 0), dtype=np.float64)


def _area_vectors(positions: NDArray[np.float32], triangles: NDArray[np.int32]) -> NDArray[np.float64]:
    """float64 [3, T]: across each triangle, twice as long as its area."""
    corners = _corners(positions, triangles)
    return _cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _dot(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return (a[0] * b[0] + a[1] * b[1]) + a[2] * b[2]


def _unit(v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vectors [3, ...] of length 1; 0 where there is no length, or none that is finite."""
    length = np.sqrt(_dot(v, v))
    return np.divide(v, length, out=np.zeros_like(v), where=(length > 0) & np.isfinite(length))


def _rounded(units: NDArray[np.float64]) -> NDArray[np.float32]:
    """float32 [..., 3], -0 as 0, of vectors [3, ...]."""
    return np.moveaxis(units, 0, -1).astype(np.float32, order="C") + np.float32(0)

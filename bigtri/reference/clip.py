"""Homogeneous clipping against the near plane, the guard band and the depth limit; docs/numerics.md 2.1.

All polygons are cut at once. Their vertices lie one after the other in flat arrays of M vertices, each with the number of its
polygon, so that a polygon may have as many vertices as it happens to get.

A cut through an original edge is always computed from the ends of that original edge, never from an already cut piece. Two
triangles that share the edge thus get the same new vertex, bit for bit, and no gap opens between them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..precision import EXACT, Arithmetic
from .exact import rounded_sum, two_product, two_sum

X, Y, Z, W = range(4)
NEAR, X_LOW, X_HIGH, Y_LOW, Y_HIGH, DEPTH = range(6)

# Slot k begins edge k and ends edge (k + 2) mod 3; sets of edges and of planes are bit masks.
_EDGES_OF_SLOT = np.array([0b101, 0b011, 0b110], np.uint8)
_LOWEST_EDGE = np.array([0, 0, 1, 0, 2, 0, 1, 0])  # of a set of edges; that of the empty set is not used


class Plane(NamedTuple):
    """The half-space ``a * position[p] + b * position[q] >= 0``."""

    p: int
    a: float
    q: int
    b: float

    def distance(self, position: NDArray[np.float64]) -> NDArray[np.float64]:
        """[...] of ``position`` [..., 4]; exact in sign for float32 positions, whose products have at most 48 bits."""
        return self.a * position[..., self.p] + self.b * position[..., self.q]


class Polygons(NamedTuple):
    """The vertices of all polygons, polygon after polygon, each in order."""

    owner: NDArray[np.int64]  # [M], the polygon, ascending
    position: NDArray[np.float64]  # [M, 4], clip space
    weights: NDArray[np.float64]  # [M, 3], >= 0, homogeneous: position = sum of weights[m] * slot m up to rounding
    edges: NDArray[np.uint8]  # [M], set of the original edges that the vertex lies on
    made: NDArray[np.uint8]  # [M], set of the planes that made it; 0 for an original vertex


def clip_planes(height: int, width: int, arithmetic: Arithmetic = EXACT) -> tuple[Plane, ...]:
    """The six planes in the order of the specification.

    The guard planes say that half * W * (x/w + 1), the snapped X, lies in [-guard, guard - 1], and the same for Y, which points
    down; half and guard are those of the rung.
    """
    if arithmetic.reversed:
        near, depth = Plane(W, 1.0, Z, -1.0), Plane(W, 4.0, Z, 1.0)
    else:
        near, depth = Plane(Z, 1.0, W, 1.0), Plane(W, 4.0, Z, -1.0)
    half_w, half_h = float(arithmetic.half * width), float(arithmetic.half * height)
    guard = arithmetic.guard
    return (
        near,
        Plane(X, half_w, W, half_w + guard),
        Plane(W, guard - 1 - half_w, X, -half_w),
        Plane(W, half_h + guard, Y, -half_h),
        Plane(W, guard - 1 - half_h, Y, half_h),
        depth,  # keeps z/w finite
    )


def clip(
    corners: NDArray[np.float64], planes: tuple[Plane, ...], arithmetic: Arithmetic = EXACT
) -> tuple[Polygons, NDArray[np.int64]]:
    """Clips the triangles ``corners`` [C, 3, 4] that some plane cuts.

    Returns:
        The polygons, of at least 3 vertices with w > 0 each; a triangle of which nothing is left has none.
        int64 [C, 3], the corner of the triangle that slot m is.
    """
    corner = (_smallest_corner(corners)[:, None] + np.arange(3)) % 3  # [C, 3]
    slots = np.take_along_axis(corners, corner[:, :, None], axis=1)  # [C, 3, 4]
    count = len(corners)
    polygons = Polygons(
        owner=np.repeat(np.arange(count), 3),
        position=slots.reshape(-1, 4),
        weights=np.tile(np.eye(3), (count, 1)),
        edges=np.tile(_EDGES_OF_SLOT, count),
        made=np.zeros(3 * count, np.uint8),
    )
    cut = _cut_in_float32 if arithmetic.precision.clip == "float32" else _cut
    for number, plane in enumerate(planes):
        polygons = cut(polygons, slots, plane, number)
    return _drawable(polygons, count), corner


def _smallest_corner(corners: NDArray[np.float64]) -> NDArray[np.int64]:
    """int64 [C]: the corner of ``corners`` [C, 3, 4] with the lexicographically smallest position, the first one on a tie."""
    smallest = np.zeros(len(corners), np.int64)
    for k in (1, 2):
        so_far = corners[np.arange(len(corners)), smallest]
        smallest[_precedes(corners[:, k], so_far)] = k
    return smallest


def _precedes(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.bool_]:
    """bool [M]: whether row ``a`` [M, 4] is lexicographically smaller than row ``b`` [M, 4]."""
    row = np.arange(len(a))
    decisive = np.argmax(a != b, axis=1)  # 0 where the rows are equal, and then not smaller
    return a[row, decisive] < b[row, decisive]


def _cut(polygons: Polygons, slots: NDArray[np.float64], plane: Plane, number: int) -> Polygons:
    """Cuts all polygons with one plane; those of triangles wholly inside it stay as they are."""
    crosses = np.any(plane.distance(slots) < 0, axis=1)  # [C]
    inside = (plane.distance(polygons.position) >= 0) | ~crosses[polygons.owner]  # [M]
    following = _following(polygons.owner)
    a = np.flatnonzero(inside != inside[following])  # the polygon edges a -> b that the plane crosses
    return _with_new(polygons, inside, a, _crossing_vertices(polygons, a, following[a], slots, plane, number))


def _with_new(polygons: Polygons, inside: NDArray[np.bool_], a: NDArray[np.int64], made: Polygons) -> Polygons:
    """The vertices that are ``inside`` [M], and behind each vertex a[i] the vertex made[i]."""
    # The vertex made on the edge that begins at vertex i comes right behind it, so they get the sort keys 2i + 1 and 2i.
    order = np.argsort(np.concatenate([2 * np.flatnonzero(inside), 2 * a + 1]))
    fields: zip[tuple[NDArray[Any], NDArray[Any]]] = zip(polygons, made, strict=True)
    return Polygons(*(np.concatenate([old[inside], new])[order] for old, new in fields))


def _cut_in_float32(polygons: Polygons, slots: NDArray[np.float64], plane: Plane, number: int) -> Polygons:
    """The same as published code does it: ``a + (b - a) * (da / (da - db))`` on the polygon edge from a to b, in float32.

    Positions and weights are float32 values all along. What leaves float32's range leaves a polygon that is not drawn.
    """
    crosses = np.any(plane.distance(slots) < 0, axis=1)  # [C]; exact in sign, of the original vertices
    position = polygons.position.astype(np.float32)
    with np.errstate(all="ignore"):
        distance = np.float32(plane.a) * position[:, plane.p] + np.float32(plane.b) * position[:, plane.q]
        inside = (distance >= 0) | ~crosses[polygons.owner]
        following = _following(polygons.owner)
        a = np.flatnonzero(inside != inside[following])
        b = following[a]
        share = (distance[a] / (distance[a] - distance[b]))[:, None]
        weights = polygons.weights.astype(np.float32)
        made = Polygons(
            polygons.owner[a],
            (position[a] + (position[b] - position[a]) * share).astype(np.float64),
            (weights[a] + (weights[b] - weights[a]) * share).astype(np.float64),
            polygons.edges[a] & polygons.edges[b],
            (polygons.made[a] & polygons.made[b]) | np.uint8(1 << number),
        )
    return _with_new(polygons, inside, a, made)


def _following(owner: NDArray[np.int64]) -> NDArray[np.int64]:
    """int64 [M]: the next vertex of the same polygon, round and round."""
    following = np.arange(1, len(owner) + 1)
    start, end = _extent(owner)
    following[end - 1] = start
    return following


def _extent(owner: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Begin and end of each run of equal ``owner`` [M]: of each polygon's vertices."""
    change = np.flatnonzero(owner[1:] != owner[:-1]) + 1
    bounds = np.concatenate([[0], change, [len(owner)]]) if len(owner) else np.zeros(1, np.int64)
    return bounds[:-1], bounds[1:]


def _crossing_vertices(
    polygons: Polygons, a: NDArray[np.int64], b: NDArray[np.int64], slots: NDArray[np.float64], plane: Plane, number: int
) -> Polygons:
    """The vertices on the polygon edges from vertex a[i] to vertex b[i], exactly one of which is inside the plane."""
    owner = polygons.owner[a]
    edges = polygons.edges[a] & polygons.edges[b]
    j = _LOWEST_EDGE[edges]
    k = (j + 1) % 3
    begin, end = slots[owner, j], slots[owner, k]
    # Rounding of an earlier cut can leave a and b on different sides while their original edge is on one.
    original = ((edges != 0) & ((plane.distance(begin) >= 0) != (plane.distance(end) >= 0)))[:, None]
    unit = np.eye(3)
    p, weights_p = np.where(original, begin, polygons.position[a]), np.where(original, unit[j], polygons.weights[a])
    q, weights_q = np.where(original, end, polygons.position[b]), np.where(original, unit[k], polygons.weights[b])
    position, weights = _meet(plane, p, q, weights_p, weights_q)
    made = (polygons.made[a] & polygons.made[b]) | np.uint8(1 << number)
    return Polygons(owner, position, weights, edges, made)


def _meet(
    plane: Plane,
    p: NDArray[np.float64],
    q: NDArray[np.float64],
    weights_p: NDArray[np.float64],
    weights_q: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Position [M, 4] and weights [M, 3] of the points where the plane cuts the lines from p to q [M, 4].

    The point is |dq| * p + |dp| * q with the distances dp and dq written out: a sum of four products that may cancel completely,
    so it is rounded once, at the end. Swapping p and q negates it exactly, so the point is the same for either direction.
    """
    across_p, across_q = (two_sum(q * p[:, [k]], -(q[:, [k]] * p)) for k in (plane.p, plane.q))  # products of float32 are exact
    coefficients = [np.full_like(q, plane.a)] * 2 + [np.full_like(q, plane.b)] * 2
    products = [two_product(c, part) for c, part in zip(coefficients, across_p + across_q, strict=True)]
    position = rounded_sum([term for product in products for term in product])
    dp, dq = plane.distance(p)[:, None], plane.distance(q)[:, None]
    position = np.where(dp < 0, -position, position)
    weights = np.abs(dq) * weights_p + np.abs(dp) * weights_q
    # A power of two changes no mantissa; it keeps later products far from overflow.
    exponent = -np.frexp(np.abs(dp) + np.abs(dq))[1]
    return np.ldexp(position, exponent), np.ldexp(weights, exponent)


def _drawable(polygons: Polygons, count: int) -> Polygons:
    """Without the polygons of fewer than 3 vertices, and those with a vertex at w <= 0 or, of float32, one that is not finite."""
    sizes = np.bincount(polygons.owner, minlength=count)
    lost = (polygons.position[:, W] <= 0) | ~np.isfinite(polygons.position).all(axis=1)
    behind = np.bincount(polygons.owner[lost], minlength=count)
    keep = ((sizes >= 3) & (behind == 0))[polygons.owner]
    return Polygons(*(field[keep] for field in polygons))

"""The oracle's oracle: one triangle and one pixel at a time, in Python's own integers, fractions and floats.

It shares no formula with the other stages, on purpose, and goes another way wherever the specification allows one:

* ``records`` follows docs/numerics.md section 2 step by step. Snapping and clipping are *defined* by their float64 operations,
  so an exact rational result would be a wrong one; Python's floats are float64 and round every operation once.
* ``covers`` decides coverage with integers, by the signs of edge functions at a sample that is moved by an infinitesimal step.
* ``exact_depth`` is the true depth of the snapped plane, a fraction: what ``depth`` approximates.
* ``outline`` and ``true_side`` are the true projection of the triangle, neither clipped nor snapped, in fractions: where the
  clipper's result should be.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from fractions import Fraction
from functools import lru_cache
from math import frexp, inf, isfinite, lcm, ldexp
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..precision import EXACT, Arithmetic
from .float_mode import default_float_mode

Vector = tuple[float, ...]
Point = tuple[int, int]
Corners = tuple[Point, Point, Point]
Plane = tuple[tuple[int, float], tuple[int, float]]  # two (component of a position, coefficient)
NOTHING = 0x7FFF_FFFF_FFFF_FFFF  # the packed value of the background


class Record(NamedTuple):
    """One oriented (sub)triangle; the fields are those of ``Records``."""

    triangle: int
    xy: Corners  # subpx, the rung's sub-pixel unit
    z: Vector  # 3 window depths, float32 values
    area: int
    bbox: tuple[int, int, int, int]  # px
    w: Vector
    corner: tuple[int, int, int]
    weights: tuple[Vector, Vector, Vector]
    clipped: bool
    place: tuple[Vector, ...] = ()  # px, float32 values, not snapped; empty unless the rung needs them


class _Vertex(NamedTuple):
    position: Vector
    weights: Vector = (0.0, 0.0, 0.0)
    edges: frozenset[int] = frozenset()
    made: frozenset[str] = frozenset()


# --- Setup -------------------------------------------------------------------------------------------------------------------


@default_float_mode
def records(
    positions: NDArray[np.float32],
    triangles: NDArray[np.int32],
    height: int,
    width: int,
    cull: str = "none",
    scissor: tuple[int, int, int, int] | None = None,
    arithmetic: Arithmetic = EXACT,
) -> tuple[list[Record], int]:
    """The records of ``triangles`` [T, 3] in order, and the number of triangles dropped for a NaN or an infinity."""
    result: list[Record] = []
    dropped = 0
    for index, triangle in enumerate(triangles.tolist()):
        corners = [tuple(positions[v].tolist()) for v in triangle]
        if not all(isfinite(c) for corner in corners for c in corner):
            dropped += 1
            continue
        for sub in _sub_triangles(corners, height, width, arithmetic):
            xy, z, w, corner, weights, clipped, place = sub
            window = _window(height, width, scissor)
            record = _oriented(index, xy, z, w, corner, weights, clipped, place, window, cull, arithmetic)
            if record is not None:
                result.append(record)
    return result, dropped


def _sub_triangles(corners: list[Vector], height: int, width: int, arithmetic: Arithmetic) -> list[tuple[Any, ...]]:
    """Lists (snapped vertices, depths, w, corner, weights, clipped, places), not yet oriented."""
    planes = _planes(height, width, arithmetic)
    outside = {name: [_distance(plane, c) < 0 for c in corners] for name, plane in planes.items()}
    if any(all(flags) for flags in outside.values()):
        return []
    unit = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    if not any(any(flags) for flags in outside.values()):
        if min(c[3] for c in corners) <= 0:
            return []
        xy = [_snap(c, height, width, arithmetic) for c in corners]
        place = [_place32(c, height, width) for c in corners]
        return [(xy, [_depth32(c, arithmetic) for c in corners], [c[3] for c in corners], (0, 1, 2), unit, False, place)]

    if arithmetic.precision.clip == "none":
        return []
    first = corners.index(min(corners))
    corner = (first, (first + 1) % 3, (first + 2) % 3)
    slots = [_Vertex(corners[c], unit[m], frozenset({m, (m + 2) % 3})) for m, c in enumerate(corner)]
    polygon = slots
    for name, plane in planes.items():
        if any(outside[name]):
            in_float32 = arithmetic.precision.clip == "float32"
            polygon = _cut_in_float32(polygon, name, plane) if in_float32 else _cut(polygon, slots, name, plane)
    if len(polygon) < 3 or not all(v.position[3] > 0 and all(map(isfinite, v.position)) for v in polygon):
        return []

    snapped = [
        (*_snap_made(v, height, width, arithmetic), _depth_made(v, arithmetic), v.position[3]) for v in polygon
    ]  # X, Y, z, w
    start = snapped.index(min(snapped))
    fan = []
    for k in range(1, len(polygon) - 1):
        corner_of = [start, (start + k) % len(polygon), (start + k + 1) % len(polygon)]
        x_y_z_w = [snapped[i] for i in corner_of]
        weights = tuple(polygon[i].weights for i in corner_of)
        place = [_place_made(polygon[i], height, width) for i in corner_of]
        fan.append(([v[:2] for v in x_y_z_w], [v[2] for v in x_y_z_w], [v[3] for v in x_y_z_w], corner, weights, True, place))
    return fan


def _planes(height: int, width: int, arithmetic: Arithmetic) -> dict[str, Plane]:
    """By name, the two (component, coefficient) of each plane, in their order."""
    w, h, guard = float(arithmetic.half * width), float(arithmetic.half * height), float(arithmetic.guard)
    return {
        "near": ((3, 1.0), (2, -1.0)) if arithmetic.reversed else ((2, 1.0), (3, 1.0)),
        "x-": ((0, w), (3, w + guard)),
        "x+": ((3, guard - 1 - w), (0, -w)),
        "y-": ((3, h + guard), (1, -h)),
        "y+": ((3, guard - 1 - h), (1, h)),
        "depth": ((3, 4.0), (2, 1.0 if arithmetic.reversed else -1.0)),
    }


def _distance(plane: Plane, v: Vector) -> float:
    (p, a), (q, b) = plane
    return a * v[p] + b * v[q]


def _cut(polygon: list[_Vertex], slots: list[_Vertex], name: str, plane: Plane) -> list[_Vertex]:
    result = []
    for a, b in zip(polygon, polygon[1:] + polygon[:1], strict=True):
        a_inside = _distance(plane, a.position) >= 0
        b_inside = _distance(plane, b.position) >= 0
        if a_inside:
            result.append(a)
        if a_inside != b_inside:
            edges = a.edges & b.edges
            p, q = a, b
            if edges:
                begin, end = slots[min(edges)], slots[(min(edges) + 1) % 3]
                if (_distance(plane, begin.position) >= 0) != (_distance(plane, end.position) >= 0):
                    p, q = begin, end
            position, weights = _meet(p, q, plane)
            result.append(_Vertex(position, weights, edges, frozenset({name}) | (a.made & b.made)))
    return result


def _cut_in_float32(polygon: list[_Vertex], name: str, plane: Plane) -> list[_Vertex]:
    """Every operation is one of float64 on float32 values, rounded again: the same as in float32 (``_round32``)."""
    (i, c), (j, d) = plane
    distance = [_round32(_round32(c * v.position[i]) + _round32(d * v.position[j])) for v in polygon]
    result = []
    for k, a in enumerate(polygon):
        b, da, db = polygon[(k + 1) % len(polygon)], distance[k], distance[(k + 1) % len(polygon)]
        if da >= 0:
            result.append(a)
        if (da >= 0) != (db >= 0):
            share = _round32(da / _round32(da - db))
            position, weights = (
                tuple(_round32(x + _round32(_round32(y - x) * share)) for x, y in zip(p, q, strict=True))
                for p, q in ((a.position, b.position), (a.weights, b.weights))
            )
            result.append(_Vertex(position, weights, a.edges & b.edges, frozenset({name}) | (a.made & b.made)))
    return result


def _meet(p: _Vertex, q: _Vertex, plane: Plane) -> tuple[Vector, Vector]:
    """Position and weights where the plane cuts the line from p to q, one of which is inside."""
    (i, a), (j, b) = plane
    dp, dq = _distance(plane, p.position), _distance(plane, q.position)
    _, exponent = frexp(abs(dp) + abs(dq))
    v, u = p.position, q.position
    # The products are rounded (of float32 components they are exact), their sum is exact, and rounded once.
    position = [
        float(
            Fraction(a) * (Fraction(u[k] * v[i]) - Fraction(u[i] * v[k]))
            + Fraction(b) * (Fraction(u[k] * v[j]) - Fraction(u[j] * v[k]))
        )
        for k in range(4)
    ]
    weights = [abs(dq) * x + abs(dp) * y for x, y in zip(p.weights, q.weights, strict=True)]
    return tuple(ldexp(c if dp >= 0 else -c, -exponent) for c in position), tuple(ldexp(c, -exponent) for c in weights)


def _snap(position: Vector, height: int, width: int, arithmetic: Arithmetic) -> Point:
    x, y, _, w = position
    cx, cy, guard = arithmetic.half * width, arithmetic.half * height, arithmetic.guard
    return (
        min(max(cx + _nearest(x / w * cx), -guard), guard - 1),
        min(max(cy - _nearest(y / w * cy), -guard), guard - 1),
    )


def _nearest(value: float) -> int:
    """The nearest integer, the even one of two; infinities become something far outside any guard band."""
    return round(min(max(value, -1e30), 1e30))


def _snap_made(vertex: _Vertex, height: int, width: int, arithmetic: Arithmetic) -> Point:
    x, y = _snap(vertex.position, height, width, arithmetic)
    low, high = -arithmetic.guard, arithmetic.guard - 1
    x = low if "x-" in vertex.made else high if "x+" in vertex.made else x
    y = low if "y-" in vertex.made else high if "y+" in vertex.made else y
    return x, y


def _round32(value: float) -> float:
    """The nearest float32. Of a float64 result it is what float32 arithmetic gives: 53 bits are 2 * 24 and 2 to spare."""
    try:
        return struct.unpack("<f", struct.pack("<f", value))[0]
    except OverflowError:
        return inf if value > 0 else -inf


def _depth32(position: Vector, arithmetic: Arithmetic) -> float:
    quotient = _round32(position[2] / position[3])
    return quotient if arithmetic.reversed else _round32(_round32(quotient * 0.5) + 0.5)


def _depth_made(vertex: _Vertex, arithmetic: Arithmetic) -> float:
    if "near" in vertex.made:
        return 1.0 if arithmetic.reversed else 0.0
    if not vertex.made:
        return _depth32(vertex.position, arithmetic)
    quotient = vertex.position[2] / vertex.position[3]
    return min(_round32(quotient), 1.0) if arithmetic.reversed else max(_round32(quotient * 0.5 + 0.5), 0.0)


def _place32(position: Vector, height: int, width: int) -> Vector:
    x, y, _, w = position
    across, down = _round32(_round32(_round32(x / w) * 0.5) + 0.5), _round32(0.5 - _round32(_round32(y / w) * 0.5))
    return _round32(across * width), _round32(down * height)


def _place_made(vertex: _Vertex, height: int, width: int) -> Vector:
    if not vertex.made:
        return _place32(vertex.position, height, width)
    x, y, _, w = vertex.position
    return _round32((x / w * 0.5 + 0.5) * width), _round32((0.5 - y / w * 0.5) * height)


def _window(height: int, width: int, scissor: tuple[int, int, int, int] | None) -> tuple[int, int, int, int]:
    x0, y0, x1, y1 = scissor or (0, 0, width, height)
    return max(x0, 0), max(y0, 0), min(x1, width), min(y1, height)


def _oriented(
    triangle: int,
    xy: list[Point],
    z: list[float],
    w: list[float],
    corner: tuple[int, int, int],
    weights: tuple[Vector, Vector, Vector],
    clipped: bool,
    place: list[Vector],
    window: tuple[int, int, int, int],
    cull: str,
    arithmetic: Arithmetic,
) -> Record | None:
    area = _determinant(xy[0], xy[1], xy[2])
    if area == 0 or (cull == "back" and area > 0) or (cull == "front" and area < 0):
        return None
    bbox = (
        max(_pixels_before(min(x for x, _ in xy), arithmetic), window[0]),
        max(_pixels_before(min(y for _, y in xy), arithmetic), window[1]),
        min(_pixels_before(max(x for x, _ in xy) + 1, arithmetic), window[2]),
        min(_pixels_before(max(y for _, y in xy) + 1, arithmetic), window[3]),
    )
    if bbox[0] >= bbox[2] or bbox[1] >= bbox[3]:
        return None
    first = xy.index(min(xy))
    step = 1 if area > 0 else 2  # 2 is one backwards
    a, b, c = first, (first + step) % 3, (first + 2 * step) % 3
    identity = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    return Record(
        triangle,
        (xy[a], xy[b], xy[c]),
        (z[a], z[b], z[c]),
        abs(area),
        bbox,
        (w[a], w[b], w[c]),
        corner if clipped else (a, b, c),
        (weights[a], weights[b], weights[c]) if clipped else identity,
        clipped,
        (place[a], place[b], place[c]) if arithmetic.is_unsnapped else (),
    )


def _pixels_before(coordinate: int, arithmetic: Arithmetic) -> int:
    """The first pixel whose centre is not before ``coordinate``, subpx: ceil((coordinate - half) / subpixel)."""
    return -((arithmetic.half - coordinate) // arithmetic.subpixel)


def _centre(px: int, py: int, arithmetic: Arithmetic) -> Point:
    """The centre of pixel (px, py), subpx."""
    return arithmetic.subpixel * px + arithmetic.half, arithmetic.subpixel * py + arithmetic.half


def _determinant(a: Point, b: Point, c: Point) -> int:
    """Twice the signed area of (a, b, c), written out term by term."""
    return a[0] * b[1] - b[0] * a[1] + b[0] * c[1] - c[0] * b[1] + c[0] * a[1] - a[0] * c[1]


# --- Coverage ----------------------------------------------------------------------------------------------------------------


def covers(record: Record, px: int, py: int, arithmetic: Arithmetic = EXACT) -> bool:
    """Whether the centre of pixel (px, py) is inside, decided in integers.

    The top-left rule says: move the sample to the right by an infinitesimal step, and down by a still smaller one; then it lies
    on no edge. The sign of an edge function there is that of the first of (value, x derivative, y derivative) that is not 0.

    Where the rung's coverage is in float32, or wraps around, decided by its edge functions.
    """
    if arithmetic.has_float_coverage:
        return all(_covers_in_float32(record, k, px, py, arithmetic) for k in range(3))
    if arithmetic.wraps:
        return all(_covers_in_int32(record, k, px, py, arithmetic) for k in range(3))
    sample = _centre(px, py, arithmetic)
    for k in range(3):
        p, q = record.xy[(k + 1) % 3], record.xy[(k + 2) % 3]
        if (_determinant(p, q, sample), p[1] - q[1], q[0] - p[0]) < (0, 0, 0):
            return False
    return True


def _covers_in_int32(record: Record, k: int, px: int, py: int, arithmetic: Arithmetic) -> bool:
    (ax, ay), (bx, by) = record.xy[(k + 1) % 3], record.xy[(k + 2) % 3]
    bias = 0 if (ay - by, bx - ax) > (0, 0) else -1
    left, top = px - px % 64, py - py % 64
    value = _determinant((ax, ay), (bx, by), _centre(left, top, arithmetic)) + bias
    wrapped = (value + 2**31) % 2**32 - 2**31
    return wrapped // arithmetic.subpixel + (bx - ax) * (py - top) - (by - ay) * (px - left) >= 0


def _covers_in_float32(record: Record, k: int, px: int, py: int, arithmetic: Arithmetic) -> bool:
    """Every operation is one of float64 on float32 values, rounded again: the same as in float32 (``_round32``)."""
    rule = arithmetic.precision.coverage
    (ax, ay), (bx, by) = (record.xy[(k + 1) % 3], record.xy[(k + 2) % 3])
    owns = by < ay or (by == ay and bx > ax)
    vertices = record.place or [(x / arithmetic.subpixel, y / arithmetic.subpixel) for x, y in record.xy]
    p, q = vertices[(k + 1) % 3], vertices[(k + 2) % 3]
    turned = rule == "float32_canonical" and p > q
    if turned:
        p, q = q, p
    dx, dy = _round32(q[0] - p[0]), _round32(q[1] - p[1])
    right, down = _round32(px + 0.5 - p[0]), _round32(py + 0.5 - p[1])
    second = _round32(dy * right)
    if rule == "float32_fused":
        value = _fraction_to_float32(Fraction(dx) * Fraction(down) - Fraction(second))
    else:
        value = _round32(_round32(dx * down) - second)
    value = -value if turned else value
    if rule == "float32_inclusive" or (rule != "float32_strict" and owns):
        return value >= 0
    return value > 0


def coverage(record: Record, height: int, width: int, arithmetic: Arithmetic = EXACT) -> NDArray[np.bool_]:
    """bool [H, W]: ``covers`` at every pixel of the bbox, all at once in int64 (62 bits and a sign); False elsewhere."""
    x0, y0, x1, y1 = record.bbox
    if arithmetic.has_float_coverage or arithmetic.wraps:
        one_by_one = np.zeros((height, width), np.bool_)
        for y, x in np.ndindex(y1 - y0, x1 - x0):
            one_by_one[y0 + y, x0 + x] = covers(record, x0 + x, y0 + y, arithmetic)
        return one_by_one
    subpixel, half = arithmetic.subpixel, arithmetic.half
    sx = (subpixel * np.arange(x0, x1, dtype=np.int64) + half)[None, :]
    sy = (subpixel * np.arange(y0, y1, dtype=np.int64) + half)[:, None]
    inside = np.ones((y1 - y0, x1 - x0), np.bool_)
    for k in range(3):
        (ax, ay), (bx, by) = record.xy[(k + 1) % 3], record.xy[(k + 2) % 3]
        value = (ay - by) * sx + (bx - ax) * sy + (ax * by - bx * ay)
        inside &= (value > 0) | ((value == 0) & ((ay - by, bx - ax) > (0, 0)))
    result = np.zeros((height, width), np.bool_)
    result[y0:y1, x0:x1] = inside
    return result


# --- Depth -------------------------------------------------------------------------------------------------------------------


def exact_depth(record: Record, px: int, py: int, arithmetic: Arithmetic = EXACT) -> Fraction:
    """The depth of the plane through the snapped vertices at the centre of pixel (px, py)."""
    values = _edge_values(record.xy, px, py, arithmetic)
    return Fraction(sum(e * Fraction(z) for e, z in zip(values, record.z, strict=True))) / record.area


@default_float_mode
def depth(record: Record, px: int, py: int, arithmetic: Arithmetic = EXACT) -> float:
    """The float32 that docs/numerics.md sections 7 and 13 store for pixel (px, py), one operation after the other."""
    return _depth(record, px, py, arithmetic)


def _depth(record: Record, px: int, py: int, arithmetic: Arithmetic) -> float:
    rule = arithmetic.precision.depth
    if rule.startswith("float32"):
        z = _depth_in_float32(record, px, py, rule, arithmetic)
    else:
        z = _depth_in_float64(record, px, py, rule, arithmetic)
    z = min(max(_round32(z), min(record.z)), max(record.z)) + 0.0
    if rule.startswith("stored") and z <= 1:
        levels = 2 ** int(rule.removeprefix("stored")) - 1
        return _round32(round(z * levels) / levels)
    if rule == "reversed":
        return _float_of(_bits_of(1.0) - _bits_of(z)) if z >= 0 else 2.0
    return z


def _depth_in_float64(record: Record, px: int, py: int, rule: str, arithmetic: Arithmetic) -> float:
    plane = _plane(record.xy, record.z, record.area, px - px % 64, py - py % 64, arithmetic)
    if plane is None:
        return _weighted(record.z, record.area, _edge_values(record.xy, px, py, arithmetic))
    corner, dx, dy = plane
    if rule == "fixed_cell":
        corner, dx, dy = (int(value * 2**48) for value in (corner, dx, dy))
        return _int_to_float32(corner + dy * (py % 64) + dx * (px % 64)) / 2**48
    return (corner + dy * (py % 64)) + dx * (px % 64)


@lru_cache(maxsize=256)  # the pixels of a cell follow one another
def _plane(xy: Corners, z: Vector, area: int, left: int, top: int, arithmetic: Arithmetic) -> tuple[float, float, float] | None:
    """Depth at a cell's first pixel, and by how much it changes to the right and downwards; None if the triangle is thin."""
    perimeter = sum(abs(x - u) + abs(y - v) for (x, y), (u, v) in zip(xy, xy[1:] + xy[:1], strict=True))
    if arithmetic.subpixel * perimeter > 32 * area:
        return None
    corner, dx, dy = (_weighted(z, area, g) for g in _cell(xy, left, top, arithmetic))
    return corner, dx, dy


def _depth_in_float32(record: Record, px: int, py: int, rule: str, arithmetic: Arithmetic) -> float:
    """Every operation is one of float64 on float32 values, rounded again: the same as in float32 (``_round32``)."""
    if rule == "float32_vertex":
        (x0, y0), z = record.xy[0], record.z
        (x1, y1), (x2, y2) = ((_int_to_float32(x - x0), _int_to_float32(y - y0)) for x, y in record.xy[1:])
        z1, z2 = _round32(z[1] - z[0]), _round32(z[2] - z[0])
        area = _int_to_float32(record.area)
        dx = _round32(_round32(_round32(z1 * y2) - _round32(z2 * y1)) / area)
        dy = _round32(_round32(_round32(z2 * x1) - _round32(z1 * x2)) / area)
        x, y = _centre(px, py, arithmetic)
        z_right = _round32(z[0] + _round32(dx * _int_to_float32(x - x0)))
        return _round32(z_right + _round32(dy * _int_to_float32(y - y0)))
    if rule == "float32_barycentric":
        return _weighted_in_float32(record, _edge_values(record.xy, px, py, arithmetic))
    corner, dx, dy = (_weighted_in_float32(record, g) for g in _cell(record.xy, px - px % 64, py - py % 64, arithmetic))
    return _round32(_round32(corner + _round32(dy * (py % 64))) + _round32(dx * (px % 64)))


@lru_cache(maxsize=256)
def _cell(xy: Corners, left: int, top: int, arithmetic: Arithmetic) -> tuple[list[int], list[int], list[int]]:
    """The edge values at a cell's first pixel, and by how much they change to the right and downwards."""
    at_corner = _edge_values(xy, left, top, arithmetic)
    to_the_right = _edge_values(xy, left + 1, top, arithmetic)
    below = _edge_values(xy, left, top + 1, arithmetic)
    right, down = ([b - a for a, b in zip(at_corner, there, strict=True)] for there in (to_the_right, below))
    return at_corner, right, down


def _edge_values(xy: Corners, px: int, py: int, arithmetic: Arithmetic) -> list[int]:
    sample = _centre(px, py, arithmetic)
    return [_determinant(xy[(k + 1) % 3], xy[(k + 2) % 3], sample) for k in range(3)]


def _weighted(z: Vector, area: int, g: Sequence[int]) -> float:
    return ((float(g[0]) * z[0] + float(g[1]) * z[1]) + float(g[2]) * z[2]) / float(area)


def _weighted_in_float32(record: Record, g: Sequence[int]) -> float:
    terms = [_round32(_int_to_float32(value) * z) for value, z in zip(g, record.z, strict=True)]
    return _round32(_round32(_round32(terms[0] + terms[1]) + terms[2]) / _int_to_float32(record.area))


def _int_to_float32(value: int) -> float:
    """The nearest float32, half to even, rounded once: what lies below 25 bits only has to tell whether there is anything."""
    below = max(abs(value).bit_length() - 26, 0)
    magnitude = (abs(value) >> below) | (abs(value) & ((1 << below) - 1) != 0)
    return _round32(ldexp(magnitude if value >= 0 else -magnitude, below))


def _fraction_to_float32(value: Fraction) -> float:
    """The same of a fraction whose denominator is a power of two, as the products and sums of floats are."""
    return _int_to_float32(value.numerator) / value.denominator


def _bits_of(value: float) -> int:
    return struct.unpack("<i", struct.pack("<f", value))[0]


def _float_of(bits: int) -> float:
    return struct.unpack("<f", struct.pack("<i", bits))[0]


# --- Attributes --------------------------------------------------------------------------------------------------------------


@default_float_mode
def weights(
    record: Record, px: int, py: int, arithmetic: Arithmetic = EXACT, corners: Sequence[Vector] = (), shape: Point = (0, 0)
) -> Vector:
    """The float32 weights of the record's slots that docs/numerics.md sections 9 and 17 give pixel (px, py).

    Where vertices are not snapped, those of the parent's ``corners`` [3] of (x, y, z, w), in an image of ``shape`` (H, W).
    """
    rule = arithmetic.precision.attributes
    if rule == "unsnapped":
        return _unsnapped_weights([corners[c] for c in record.corner], px, py, *shape)
    in_float32 = rule in ("float32", "reciprocal")
    rounded = _round32 if in_float32 else float
    whole = _int_to_float32 if in_float32 else float

    def over(value: float, by: float) -> float:
        if rule != "reciprocal":
            return rounded(value / by)
        once = _newton(_float_of(0x7EF311C7 - _bits_of(by)), by)
        return _round32(value * _newton(once, by))

    def summed(terms: Sequence[float]) -> float:
        return rounded(rounded(terms[0] + terms[1]) + terms[2])

    screen = [over(whole(e), whole(record.area)) for e in _edge_values(record.xy, px, py, arithmetic)]
    rows = [[rounded(t) for t in row] for row in record.weights]
    if rule == "affine":
        rows = [[t / ((row[0] + row[1]) + row[2]) for t in row] for row in rows]
        u = screen
    elif not record.clipped and len(set(record.w)) == 1:
        return tuple(_round32(b) for b in screen)
    else:
        u = [over(one, rounded(w)) for one, w in zip(screen, record.w, strict=True)]
    if record.clipped:
        u = [summed([rounded(u[k] * rows[k][m]) for k in range(3)]) for m in range(3)]
    if rule == "affine":
        return tuple(_round32(b) for b in u)
    total = summed(u)
    return tuple(_round32(over(one, total)) for one in u)


def _unsnapped_weights(corners: Sequence[Vector], px: int, py: int, height: int, width: int) -> Vector:
    nx, ny = (2 * px + 1 - width) / width, (height - 2 * py - 1) / height
    (a0, b0), (a1, b1), (a2, b2) = ((x - nx * w, y - ny * w) for x, y, _, w in corners)
    u = a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
    turned = (u[0] + u[1]) + u[2] < 0
    v = [max(-one if turned else one, 0.0) for one in u]
    total = (v[0] + v[1]) + v[2]
    return tuple(_round32(one / total) if total else 0.0 for one in v)


def _newton(reciprocal: float, of: float) -> float:
    return _round32(reciprocal * _round32(2 - _round32(of * reciprocal)))


# --- The visibility buffer ---------------------------------------------------------------------------------------------------


@default_float_mode
def rasterize(
    positions: NDArray[np.float32],
    triangles: NDArray[np.int32],
    height: int,
    width: int,
    cull: str = "none",
    scissor: tuple[int, int, int, int] | None = None,
    arithmetic: Arithmetic = EXACT,
) -> tuple[NDArray[np.int64], int]:
    """int64 [H, W], the packed depth and triangle of every pixel, and the number of dropped triangles.

    Fragments are compared as pairs of numbers (depth, triangle); their bits are packed only at the end.
    """
    drawn, dropped = records(positions, triangles, height, width, cull, scissor, arithmetic)
    nearest: dict[Point, tuple[float, int]] = {}
    for record in drawn:
        for py, px in np.argwhere(coverage(record, height, width, arithmetic)).tolist():
            z = _depth(record, px, py, arithmetic)
            if z <= 1:
                nearest[px, py] = min(nearest.get((px, py), (inf, 0)), (z, record.triangle))
    packed = np.full((height, width), NOTHING, np.int64)
    for (px, py), (z, triangle) in nearest.items():
        packed[py, px] = struct.unpack("<q", struct.pack("<If", triangle, z))[0]
    return packed, dropped


# --- The true projection -----------------------------------------------------------------------------------------------------


class HalfPlane(NamedTuple):
    """a * x + b * y + c >= 0 for a point (x, y) of the image, px from the upper left corner; integers, up to a common factor."""

    a: int
    b: int
    c: int


def outline(corners: Sequence[Vector], height: int, width: int, arithmetic: Arithmetic = EXACT) -> list[HalfPlane]:
    """The half-planes whose intersection is what a clip-space triangle [3] of (x, y, z, w) shows behind the near plane, at w > 0.

    A point of the triangle is ``sum u_m * corner_m``, u >= 0. It appears at normalized device coordinates (nx, ny) where its
    (x, y, w) is a positive multiple of n = (nx, ny, 1), which Cramer's rule solves: u_m = det(n, next, one after) / det(all),
    linear in nx and ny. So is the distance from the near plane at that point. An empty list: the triangle is seen edge-on and
    shows nothing.
    """
    exact = [[Fraction(c) for c in corner] for corner in corners]
    x_y_w = [(x, y, w) for x, y, _, w in exact]
    normals = [_cross(x_y_w[1], x_y_w[2]), _cross(x_y_w[2], x_y_w[0]), _cross(x_y_w[0], x_y_w[1])]
    det = sum(a * b for a, b in zip(normals[0], x_y_w[0], strict=True))
    if det == 0:
        return []
    lines = [[c / det for c in normal] for normal in normals]
    distances = [w - z if arithmetic.reversed else z + w for _, _, z, w in exact]
    near = list(zip(distances, lines, strict=True))
    lines.append([sum((distance * line[k] for distance, line in near), Fraction(0)) for k in range(3)])
    # nx = 2x / W - 1, ny = 1 - 2y / H
    return [_integral(2 * a / width, -2 * b / height, c - a + b) for a, b, c in lines]


def _integral(a: Fraction, b: Fraction, c: Fraction) -> HalfPlane:
    scale = lcm(a.denominator, b.denominator, c.denominator)
    return HalfPlane(int(a * scale), int(b * scale), int(c * scale))


def true_side(half_planes: list[HalfPlane], px: int, py: int, arithmetic: Arithmetic = EXACT) -> int:
    """1: the pixel's centre is inside of every border by more than 1 subpx; -1: outside of one by more; else 0."""
    return min((_side(half_plane, px, py, arithmetic.half) for half_plane in half_planes), default=-1)


def _side(half_plane: HalfPlane, px: int, py: int, half: int) -> int:
    a, b, c = half_plane
    twice = a * (2 * px + 1) + b * (2 * py + 1) + 2 * c
    # The distance is |twice| / 2 / sqrt(a^2 + b^2) px, and a subpx is 1 / (2 * half) px.
    if (twice * half) ** 2 <= a * a + b * b:
        return 0
    return 1 if twice > 0 else -1


def _cross(a: Sequence[Fraction], b: Sequence[Fraction]) -> tuple[Fraction, Fraction, Fraction]:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]

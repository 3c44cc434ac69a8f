"""Coverage: on which side of an edge a pixel's centre lies, by the rung's rule; docs/numerics.md sections 3 and 14.

By every rule the value of an edge function is monotone along a row and along a column, rounded or not; where it wraps around,
within a 64x64 px cell. So the highest value over a rectangle of centres is that at one of its corners, as computed, and so is the
lowest: what a corner tells of a bin or of a tile holds for all of its pixels, and a row of a cell has its covered pixels side by
side.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..precision import Arithmetic
from .numerics import Edges, edges_of, stepped_values, stepped_values_of_each
from .records import Records

Pixels = NDArray[np.int64]


class _Lines(NamedTuple):
    """Edges in px, float32, for the rules that compute in it."""

    x: NDArray[np.float32]  # [..., 3], a point of the edge
    y: NDArray[np.float32]
    dx: NDArray[np.float32]  # [..., 3], its direction
    dy: NDArray[np.float32]
    turned: NDArray[np.bool_]  # [..., 3], whether the direction is against the edge's own


class Sides(NamedTuple):
    """The edges of records, ready to be asked; arrays [..., 3]."""

    edges: Edges  # snapped
    lines: _Lines | None  # where the rule computes in float32
    rises_x: NDArray[np.bool_]  # whether the values rise, or else fall or stay, to the right
    rises_y: NDArray[np.bool_]  # and downwards
    arithmetic: Arithmetic


def sides_of(records: Records, record: NDArray[np.integer], arithmetic: Arithmetic) -> Sides:
    """The edges of the records whose numbers are given, [...]."""
    edges = edges_of(records.xy[record])
    rule = arithmetic.precision.coverage
    if not arithmetic.has_float_coverage:
        return Sides(edges, None, edges.dy < 0, edges.dx > 0, arithmetic)
    if arithmetic.is_unsnapped:
        vertices = records.place[record]
    else:
        vertices = records.xy[record].astype(np.float32) / np.float32(arithmetic.subpixel)  # exact: 24 bits
    begin, end = vertices[..., [1, 2, 0], :], vertices[..., [2, 0, 1], :]
    turned = np.zeros(begin.shape[:-1], np.bool_)
    if rule == "float32_canonical":
        turned = (begin[..., 0] > end[..., 0]) | ((begin[..., 0] == end[..., 0]) & (begin[..., 1] > end[..., 1]))
        begin, end = np.where(turned[..., None], end, begin), np.where(turned[..., None], begin, end)
    direction = end - begin
    lines = _Lines(begin[..., 0], begin[..., 1], direction[..., 0], direction[..., 1], turned)
    return Sides(edges, lines, (lines.dy < 0) ^ turned, (lines.dx > 0) ^ turned, arithmetic)


def is_inside(sides: Sides, px: Pixels, py: Pixels) -> NDArray[np.bool_]:
    """bool [..., 3]: whether the centre of each pixel (px, py) [...] lies inside each edge. It is covered if inside of all."""
    return _inside(sides, np.asarray(px)[..., None], np.asarray(py)[..., None])


def is_inside_each(sides: Sides, px: Pixels, py: Pixels) -> NDArray[np.bool_]:
    """bool [..., 3] of a pixel (px, py) [..., 3] for each edge."""
    return _inside(sides, px, py)


def touches(sides: Sides, left: Pixels, top: Pixels, size: int) -> NDArray[np.bool_]:
    """bool [...]: whether no edge rejects the size x size px square from pixel (left, top) [...] on, by the rung's rule of masks.

    `corners`: an edge rejects it that has all of its pixels' centres outside.
    """
    mask, last = sides.arithmetic.precision.mask, size - 1
    if mask in ("bounds", "none"):
        return np.ones(np.broadcast_shapes(np.shape(left), np.shape(top), sides.rises_x.shape[:-1]), np.bool_)
    if mask == "half_tile":
        middle, reach = _middle_and_reach(sides, left, top, size)
        return np.all(middle + reach >= 0, axis=-1)
    highest_x, highest_y = last * sides.rises_x, last * sides.rises_y
    return np.all(_inside(sides, np.asarray(left)[..., None] + highest_x, np.asarray(top)[..., None] + highest_y), axis=-1)


def fills(sides: Sides, left: Pixels, top: Pixels, size: int) -> NDArray[np.bool_]:
    """bool [...]: whether every edge is known to have all of them inside, by the rung's rule of masks."""
    mask, last = sides.arithmetic.precision.mask, size - 1
    if mask in ("bounds", "none"):
        return np.zeros(np.broadcast_shapes(np.shape(left), np.shape(top), sides.rises_x.shape[:-1]), np.bool_)
    if mask == "half_tile":
        middle, reach = _middle_and_reach(sides, left, top, size)
        return np.all(middle - reach >= 0, axis=-1)
    lowest_x, lowest_y = last * ~sides.rises_x, last * ~sides.rises_y
    return np.all(_inside(sides, np.asarray(left)[..., None] + lowest_x, np.asarray(top)[..., None] + lowest_y), axis=-1)


def _middle_and_reach(sides: Sides, left: Pixels, top: Pixels, size: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Twice f at the middle of a square, and twice how far it rises or falls from there to the square's border; [..., 3]."""
    edges = sides.edges
    first = stepped_values(edges, left, top, sides.arithmetic)
    return 2 * first + (size - 1) * (edges.dx - edges.dy), size * (np.abs(edges.dx) + np.abs(edges.dy))


def _inside(sides: Sides, px: Pixels, py: Pixels) -> NDArray[np.bool_]:
    if sides.lines is None:
        return stepped_values_of_each(sides.edges, px, py, sides.arithmetic) >= 0
    values = _float_values(sides.lines, px, py, fused=sides.arithmetic.precision.coverage == "float32_fused")
    rule = sides.arithmetic.precision.coverage
    if rule == "float32_inclusive":
        return values >= 0
    if rule == "float32_strict":
        return values > 0
    return np.where(sides.edges.bias == 0, values >= 0, values > 0)


def _float_values(lines: _Lines, px: Pixels, py: Pixels, fused: bool) -> NDArray[np.float32]:
    """dx * (sy - y) - dy * (sx - x), float32 [..., 3], every operation rounded; fused: all but the first product."""
    half = np.float32(0.5)
    right = (px.astype(np.float32) + half) - lines.x  # the centre is exact
    down = (py.astype(np.float32) + half) - lines.y
    second = lines.dy * right
    values = _fused(lines.dx, down, -second) if fused else lines.dx * down - second
    return np.where(lines.turned, -values, values)


def _fused(a: NDArray[np.float32], b: NDArray[np.float32], c: NDArray[np.float32]) -> NDArray[np.float32]:
    """a * b + c, rounded once.

    float64 holds the product exactly, but not always the sum. Rounded to odd (where it is not exact, the last bit is set), the
    sum's 53 bits, more than two beyond 24, have what it takes to be rounded to float32 as the exact sum would be. S. Boldo and
    G. Melquiond, "Emulation of a FMA and correctly rounded sums: proved algorithms using rounding to odd", 2008.
    """
    product, addend = np.broadcast_arrays(a.astype(np.float64) * b.astype(np.float64), c.astype(np.float64))
    total = product + addend
    shadow = total - product
    error = (product - (total - shadow)) + (addend - shadow)
    bits = total.view(np.int64)
    towards = np.where(
        (error > 0) == (total > 0), 1, -1
    )  # away from 0, or towards it: bits of floats ascend with their magnitude
    odd = np.where((error != 0) & (bits & 1 == 0), bits + towards, bits)
    return odd.view(np.float64).astype(np.float32)

"""Depth: a float32 per covered pixel, by the rung's rule; docs/numerics.md sections 7 and 13."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..precision import EXACT, Arithmetic
from .float_mode import default_float_mode
from .numerics import BIN, THIN_RATIO, edge_values, edges_of, ramp
from .records import Records

CELL = BIN  # px; cells are squares of the image, whatever bins a variant uses, so that all variants round alike
FIXED_ONE = 2.0**48  # of the depth plane in int64; docs/numerics.md 13 has the bounds that make it fit
DROPPED = np.float32(2)  # a depth beyond 1, for what lies beyond the far plane where depth is reversed

Number = type[np.float32] | type[np.float64]


class _Pieces(NamedTuple):
    """Spans cut at the borders of cells."""

    record: NDArray[np.int64]  # [P]
    y: NDArray[np.int64]  # [P], px
    lower: NDArray[np.int64]  # [P], px
    length: NDArray[np.int64]  # [P], px, 1 to 64


class _Planes(NamedTuple):
    """Depth over cells: ``(corner + dy * j) + dx * i`` at pixel (i, j) of the cell."""

    corner: NDArray[np.floating]  # [C], at the cell's first pixel centre
    dx: NDArray[np.floating]  # [C], per px
    dy: NDArray[np.floating]  # [C], per px


@default_float_mode
def depth(records: Records, spans: NDArray[np.int32], arithmetic: Arithmetic = EXACT) -> NDArray[np.float32]:
    """Depth of every covered pixel, as it is stored: the smaller one is nearer.

    Args:
        records: N records.
        spans: int32 [S, 4], (record, y, lower, upper), px.
        arithmetic: the rung of the precision ladder.

    Returns:
        float32 [F], a value per pixel in the order of the spans; of `exact` correctly rounded but for 2^-39.
    """
    pieces = _pieces(spans.astype(np.int64))
    z = _unclamped_depth(records, pieces, arithmetic)
    corners = records.z[pieces.record]
    lowest, highest = (np.repeat(limit, pieces.length) for limit in (corners.min(axis=1), corners.max(axis=1)))
    rounded = np.minimum(np.maximum(z.astype(np.float32), lowest), highest)
    # Adding 0 makes +0 of -0, whose bits would compare as the farthest depth.
    return _stored(rounded + np.float32(0), arithmetic)


def _unclamped_depth(records: Records, pieces: _Pieces, arithmetic: Arithmetic) -> NDArray[np.floating]:
    """[F], in float32 where the rung computes in that, else in float64."""
    rule = arithmetic.precision.depth
    if rule == "float32_cell":
        return _plane_depth(records, pieces, np.float32, arithmetic)
    if rule == "float32_barycentric":
        return _weighted_depth(records, pieces, np.float32, arithmetic)
    if rule == "float32_vertex":
        return _vertex_plane_depth(records, pieces, arithmetic)
    thin = _is_thin(records, pieces.record, arithmetic)
    plane = _fixed_depth if rule == "fixed_cell" else _float64_depth
    z: NDArray[np.floating] = np.empty(int(pieces.length.sum()), np.float32 if rule == "fixed_cell" else np.float64)
    of_thin = np.repeat(thin, pieces.length)  # [F]
    z[~of_thin] = plane(records, _Pieces(*(field[~thin] for field in pieces)), arithmetic)
    z[of_thin] = _weighted_depth(records, _Pieces(*(field[thin] for field in pieces)), np.float64, arithmetic)
    return z


@default_float_mode
def bound_depth(
    records: Records, place: NDArray[np.int64], size: int, farthest: bool, arithmetic: Arithmetic = EXACT
) -> NDArray[np.float32]:
    """float32 [N]: a depth that no pixel of a square is nearer than; or farther, if ``farthest``.

    A plane's extremes over a rectangle of a cell lie at its corners, exactly as computed (numerics.md 7). A record that is thin
    has no plane; its vertices bound it. Only for planes of cells that are stored as they are.

    Args:
        records: N records.
        place: int64 [N, 3], (record, x, y): the square's first pixel, px. The square lies in one cell.
        size: px.
        farthest: which of both.
        arithmetic: the rung of the precision ladder.
    """
    record, x, y = place.T
    number: Number = np.float32 if arithmetic.precision.depth == "float32_cell" else np.float64
    planes = _planes(records, np.stack([record, x // CELL, y // CELL], axis=1), number, arithmetic)
    i = x % CELL + np.where((planes.dx < 0) != farthest, size - 1, 0)
    j = y % CELL + np.where((planes.dy < 0) != farthest, size - 1, 0)
    z = ((planes.corner + planes.dy * j.astype(number)) + planes.dx * i.astype(number)).astype(np.float32)
    lowest, highest = records.z[record].min(axis=1), records.z[record].max(axis=1)
    z = np.minimum(np.maximum(z, lowest), highest)
    if arithmetic.precision.depth != "float32_cell":
        z = np.where(_is_thin(records, record, arithmetic), highest if farthest else lowest, z)
    return z + np.float32(0)


def _stored(z: NDArray[np.float32], arithmetic: Arithmetic) -> NDArray[np.float32]:
    """Depths ``z`` >= +0 as they are stored; one beyond 1, which is dropped, stays beyond 1."""
    rule = arithmetic.precision.depth
    if rule in ("stored24", "stored16"):
        levels = np.float64(2 ** (24 if rule == "stored24" else 16) - 1)
        level = np.rint(z.astype(np.float64) * levels)
        return np.where(z <= 1, (level / levels).astype(np.float32), z)
    if rule == "reversed":
        # The bits of floats from +0 to 1 ascend with them, so their distance from those of 1 descends: nearer is smaller again.
        one = np.float32(1).view(np.int32)
        return np.where(z >= 0, (one - z.view(np.int32)).view(np.float32), DROPPED)
    return z


def _pieces(spans: NDArray[np.int64]) -> _Pieces:
    record, y, lower, upper = spans.T
    first_cell = lower // CELL
    count = (upper - 1) // CELL + 1 - first_cell
    cell_left = CELL * (np.repeat(first_cell, count) + ramp(count))
    lower = np.maximum(np.repeat(lower, count), cell_left)
    upper = np.minimum(np.repeat(upper, count), cell_left + CELL)
    return _Pieces(np.repeat(record, count), np.repeat(y, count), lower, upper - lower)


def _is_thin(records: Records, record: NDArray[np.int64], arithmetic: Arithmetic) -> NDArray[np.bool_]:
    """bool [P]: whether the record is so thin that its plane's slopes would cancel badly; at most 36 bits on the left."""
    edges = edges_of(records.xy[record])
    girth = (np.abs(edges.dx) + np.abs(edges.dy)).sum(axis=1)  # subpx
    # s * girth > 32 * A, with room for areas of 62 bits
    return (arithmetic.subpixel * girth - 1) // THIN_RATIO >= records.area[record]


def _float64_depth(records: Records, pieces: _Pieces, arithmetic: Arithmetic) -> NDArray[np.floating]:
    """float64 [F] of the pixels of pieces of records that are not thin."""
    return _plane_depth(records, pieces, np.float64, arithmetic)


def _plane_depth(records: Records, pieces: _Pieces, number: Number, arithmetic: Arithmetic) -> NDArray[np.floating]:
    """[F] of the pixels of pieces, by planes computed in ``number``."""
    planes, run, i, j = _cell_planes(records, pieces, number, arithmetic)
    left = planes.corner[run] + planes.dy[run] * j.astype(number)
    return np.repeat(left, pieces.length) + np.repeat(planes.dx[run], pieces.length) * i.astype(number)


def _fixed_depth(records: Records, pieces: _Pieces, arithmetic: Arithmetic) -> NDArray[np.float32]:
    """float32 [F] of the pixels of pieces of records that are not thin, by planes in int64."""
    planes, run, i, j = _cell_planes(records, pieces, np.float64, arithmetic)
    corner, dx, dy = ((value * FIXED_ONE).astype(np.int64)[run] for value in planes)  # what is beyond the point's last bit is cut
    fixed = np.repeat(corner + dy * j, pieces.length) + np.repeat(dx, pieces.length) * i
    return fixed.astype(np.float32) * np.float32(1 / FIXED_ONE)


def _cell_planes(
    records: Records, pieces: _Pieces, number: Number, arithmetic: Arithmetic
) -> tuple[_Planes, NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Planes, which of them each piece has [P], and the pixels' columns [F] and the pieces' rows [P] within their cells."""
    column, row = pieces.lower // CELL, pieces.y // CELL
    # Pieces of one record in one cell mostly come one after the other; each such run shares a plane.
    key = np.stack([pieces.record, column, row], axis=1)
    starts = np.ones(len(key), np.bool_)
    starts[1:] = (key[1:] != key[:-1]).any(axis=1)
    planes = _planes(records, key[starts], number, arithmetic)
    i = np.repeat(pieces.lower - CELL * column, pieces.length) + ramp(pieces.length)
    return planes, np.cumsum(starts) - 1, i, pieces.y - CELL * row


def _planes(records: Records, places: NDArray[np.int64], number: Number, arithmetic: Arithmetic) -> _Planes:
    """The planes at ``places`` [C, 3] of (record, cell column, cell row)."""
    record, column, row = places.T
    edges = edges_of(records.xy[record])
    corner = _mean_depth(records, record, edge_values(edges, CELL * column, CELL * row, arithmetic), number)
    dx = _mean_depth(records, record, -arithmetic.subpixel * edges.dy, number)
    dy = _mean_depth(records, record, arithmetic.subpixel * edges.dx, number)
    return _Planes(corner, dx, dy)


def _mean_depth(
    records: Records, record: NDArray[np.int64], g: NDArray[np.int64], number: Number = np.float64
) -> NDArray[np.floating]:
    """((g0 z0 + g1 z1) + g2 z2) / A, [P] in ``number``, of the edge values or slopes ``g`` [P, 3]."""
    weighted = g.astype(number) * records.z[record].astype(number)
    return ((weighted[:, 0] + weighted[:, 1]) + weighted[:, 2]) / records.area[record].astype(number)


def _weighted_depth(records: Records, pieces: _Pieces, number: Number, arithmetic: Arithmetic) -> NDArray[np.floating]:
    """[F] of the pixels of pieces, without a plane: inside, all edge values are >= 0 and nothing cancels."""
    record, x, y = _pixels(pieces)
    return _mean_depth(records, record, edge_values(edges_of(records.xy[record]), x, y, arithmetic), number)


def _vertex_plane_depth(records: Records, pieces: _Pieces, arithmetic: Arithmetic) -> NDArray[np.float32]:
    """float32 [F] of the pixels of pieces, by a plane from the record's first vertex, as published code has it."""
    record, x, y = _pixels(pieces)
    xy, z = records.xy[record].astype(np.int64), records.z[record]
    (x1, y1), (x2, y2) = ((xy[:, k] - xy[:, 0]).T.astype(np.float32) for k in (1, 2))  # subpx
    z1, z2 = z[:, 1] - z[:, 0], z[:, 2] - z[:, 0]
    area = records.area[record].astype(np.float32)
    dx, dy = (z1 * y2 - z2 * y1) / area, (z2 * x1 - z1 * x2) / area  # per subpx
    right = (arithmetic.subpixel * x + arithmetic.half - xy[:, 0, 0]).astype(np.float32)
    down = (arithmetic.subpixel * y + arithmetic.half - xy[:, 0, 1]).astype(np.float32)
    return (z[:, 0] + dx * right) + dy * down


def _pixels(pieces: _Pieces) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Record, x and y of every pixel, int64 [F] each, px."""
    x = np.repeat(pieces.lower, pieces.length) + ramp(pieces.length)
    return np.repeat(pieces.record, pieces.length), x, np.repeat(pieces.y, pieces.length)

"""Depth: a float32 per covered pixel, from a float64 plane per record and cell; docs/numerics.md section 7."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..precision import EXACT, Arithmetic
from .float_mode import default_float_mode
from .numerics import BIN, THIN_RATIO, Edges, edge_values, edges_of, ramp
from .records import Records

CELL = BIN  # px; cells are squares of the image, whatever bins a variant uses, so that all variants round alike


class _Pieces(NamedTuple):
    """Spans cut at the borders of cells."""

    record: NDArray[np.int64]  # [P]
    y: NDArray[np.int64]  # [P], px
    lower: NDArray[np.int64]  # [P], px
    length: NDArray[np.int64]  # [P], px, 1 to 64


class _Planes(NamedTuple):
    """Depth over cells: ``(corner + dy * j) + dx * i`` at pixel (i, j) of the cell."""

    corner: NDArray[np.float64]  # [C], at the cell's first pixel centre
    dx: NDArray[np.float64]  # [C], per px
    dy: NDArray[np.float64]  # [C], per px


@default_float_mode
def depth(records: Records, spans: NDArray[np.int32], arithmetic: Arithmetic = EXACT) -> NDArray[np.float32]:
    """Window depth of every covered pixel.

    Args:
        records: N records.
        spans: int32 [S, 4], (record, y, lower, upper), px.
        arithmetic: the rung of the precision ladder.

    Returns:
        float32 [F], a value per pixel in the order of the spans; correctly rounded but for 2^-39.
    """
    pieces = _pieces(spans.astype(np.int64))
    thin = _is_thin(records, pieces.record, arithmetic)
    z = np.empty(int(pieces.length.sum()))
    of_thin = np.repeat(thin, pieces.length)  # [F]
    z[~of_thin] = _plane_depth(records, _Pieces(*(field[~thin] for field in pieces)), arithmetic)
    z[of_thin] = _thin_depth(records, _Pieces(*(field[thin] for field in pieces)), arithmetic)

    corners = records.z[pieces.record]
    lowest, highest = (np.repeat(limit, pieces.length) for limit in (corners.min(axis=1), corners.max(axis=1)))
    rounded = np.minimum(np.maximum(z.astype(np.float32), lowest), highest)
    return rounded + np.float32(0)  # makes +0 of -0, whose bits would compare as the farthest depth


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
    return arithmetic.subpixel * girth > THIN_RATIO * records.area[record]


def _plane_depth(records: Records, pieces: _Pieces, arithmetic: Arithmetic) -> NDArray[np.float64]:
    """float64 [F] of the pixels of pieces of records that are not thin."""
    column, row = pieces.lower // CELL, pieces.y // CELL
    # Pieces of one record in one cell mostly come one after the other; each such run shares a plane.
    key = np.stack([pieces.record, column, row], axis=1)
    starts = np.ones(len(key), np.bool_)
    starts[1:] = (key[1:] != key[:-1]).any(axis=1)
    planes = _planes(records, key[starts], arithmetic)
    run = np.cumsum(starts) - 1

    left = planes.corner[run] + planes.dy[run] * (pieces.y - CELL * row)
    i = np.repeat(pieces.lower - CELL * column, pieces.length) + ramp(pieces.length)
    return np.repeat(left, pieces.length) + np.repeat(planes.dx[run], pieces.length) * i


def _planes(records: Records, places: NDArray[np.int64], arithmetic: Arithmetic) -> _Planes:
    """The planes at ``places`` [C, 3] of (record, cell column, cell row)."""
    record, column, row = places.T
    edges = edges_of(records.xy[record])
    corner = _mean_depth(records, record, edge_values(edges, CELL * column, CELL * row, arithmetic))
    subpixel = arithmetic.subpixel
    return _Planes(
        corner, dx=_mean_depth(records, record, -subpixel * edges.dy), dy=_mean_depth(records, record, subpixel * edges.dx)
    )


def _mean_depth(records: Records, record: NDArray[np.int64], g: NDArray[np.int64]) -> NDArray[np.float64]:
    """((g0 z0 + g1 z1) + g2 z2) / A, float64 [P], of the edge values or slopes ``g`` [P, 3]."""
    weighted = g.astype(np.float64) * records.z[record].astype(np.float64)
    return ((weighted[:, 0] + weighted[:, 1]) + weighted[:, 2]) / records.area[record].astype(np.float64)


def _thin_depth(records: Records, pieces: _Pieces, arithmetic: Arithmetic) -> NDArray[np.float64]:
    """float64 [F] of the pixels of pieces of thin records: inside, all edge values are >= 0 and nothing cancels."""
    record = np.repeat(pieces.record, pieces.length)
    x = np.repeat(pieces.lower, pieces.length) + ramp(pieces.length)
    edges: Edges = edges_of(records.xy[record])
    return _mean_depth(records, record, edge_values(edges, x, np.repeat(pieces.y, pieces.length), arithmetic))

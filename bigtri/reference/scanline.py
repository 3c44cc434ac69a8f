"""Scanline: the exact span of covered pixels of each row; docs/numerics.md section 6."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..precision import EXACT, Arithmetic
from .coverage import is_inside_each, sides_of
from .float_mode import default_float_mode
from .numerics import BIN, TILE, TILES, edges_of, ramp, stepped_values
from .records import Records


@default_float_mode
def scanline(
    records: Records,
    queue: NDArray[np.int32],
    touched: NDArray[np.int64],
    small: NDArray[np.int32],
    arithmetic: Arithmetic = EXACT,
) -> NDArray[np.int32]:
    """Finds where each row of pixels enters and leaves each record, by division: no pixel is tested by itself.

    Args:
        records: N records.
        queue: int32 [Q, 3], (record, bin column, bin row).
        touched: int64 [Q], bit ``8 * row + column`` for each tile to look at.
        small: int32 [M], records that are looked at row by row of their bbox.
        arithmetic: the rung of the precision ladder.

    Returns:
        int32 [S, 4]: nonempty spans (record, y, lower, upper), px, half-open; first those of the queue by (entry, tile bit,
        row), then those of the small records by (record, row).
    """
    of_queue, of_small = _queue_spans(records, queue, touched, arithmetic), _small_spans(records, small, arithmetic)
    return np.concatenate([of_queue, of_small]).astype(np.int32)


def _queue_spans(
    records: Records, queue: NDArray[np.int32], touched: NDArray[np.int64], arithmetic: Arithmetic
) -> NDArray[np.int64]:
    """int64 [S, 4]: a span of each row of a bin, cut up into tiles."""
    record, column, row = queue.astype(np.int64).T  # [Q]
    y = BIN * row[:, None] + np.arange(BIN)  # [Q, 64]
    cells = np.repeat(column, BIN) if arithmetic.wraps else None
    lower, upper = _row_spans(records, np.repeat(record, BIN), y.reshape(-1), cells, arithmetic)  # [Q * 64]

    shape = (len(queue), TILES, TILES, TILE)  # entry, tile row, tile column, row in the tile: the order of the output
    by_row = (len(queue), TILES, 1, TILE)
    left = (BIN * column[:, None] + TILE * np.arange(TILES))[:, None, :, None]  # [Q, 1, tile column, 1]
    lower = np.maximum(lower.reshape(by_row), left)
    upper = np.minimum(upper.reshape(by_row), left + TILE)
    bit = (touched[:, None] >> np.arange(TILES * TILES)) & 1  # [Q, 64]
    covered = (lower < upper) & (bit == 1).reshape(len(queue), TILES, TILES, 1)
    record, y = record[:, None, None, None], y.reshape(by_row)
    return np.stack([np.broadcast_to(v, shape)[covered] for v in (record, y, lower, upper)], axis=1)


def _small_spans(records: Records, small: NDArray[np.int32], arithmetic: Arithmetic) -> NDArray[np.int64]:
    """int64 [S, 4]: a span per row of each record's bbox, and per cell where values wrap around."""
    y0, y1 = records.bbox[small, 1].astype(np.int64), records.bbox[small, 3].astype(np.int64)
    record = np.repeat(small, y1 - y0).astype(np.int64)
    y = np.repeat(y0, y1 - y0) + ramp(y1 - y0)
    cells = None
    if arithmetic.wraps:  # a span in each cell of the row
        first, last = records.bbox[record, 0] // BIN, (records.bbox[record, 2] - 1) // BIN
        count = (last - first + 1).astype(np.int64)
        record, y = np.repeat(record, count), np.repeat(y, count)
        cells = np.repeat(first, count) + ramp(count)
    lower, upper = _row_spans(records, record, y, cells, arithmetic)
    covered = lower < upper
    return np.stack([record[covered], y[covered], lower[covered], upper[covered]], axis=1)


def _row_spans(
    records: Records,
    record: NDArray[np.int64],
    y: NDArray[np.int64],
    cells: NDArray[np.int64] | None,
    arithmetic: Arithmetic,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """[lower, upper) int64 [R], px: record[i]'s covered pixels on row y[i], in its bbox; lower >= upper where there are none.

    With ``cells`` [R], only those in this column of 64x64 px cells.
    """
    left, top, right, bottom = records.bbox[record].astype(np.int64).T[..., None]  # [R, 1] each
    if cells is not None:
        left, right = np.maximum(left, BIN * cells[:, None]), np.minimum(right, BIN * (cells[:, None] + 1))
    cut = _bisected if arithmetic.has_float_coverage else _divided
    lower, upper = cut(records, record, y, left, right, arithmetic)
    missed = (y < top[:, 0]) | (y >= bottom[:, 0])
    lower = np.maximum(lower, left[:, 0])
    return lower, np.where(missed, lower, np.minimum(upper, right[:, 0]))


def _divided(
    records: Records,
    record: NDArray[np.int64],
    y: NDArray[np.int64],
    left: NDArray[np.int64],
    right: NDArray[np.int64],
    arithmetic: Arithmetic,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """[lower, upper) [R] of rows y, by division, within the columns [left, right) [R, 1].

    A pixel x is covered where f - dy * (x - left) >= 0 for all three edges, f being the value at pixel left of the row. Hence
    dy < 0: x - left >= -f / |dy|, so x - left >= ceil(-f / |dy|) = -floor(f / |dy|);
    dy > 0: x - left <= f / dy, so x - left < floor(f / dy) + 1;
    dy = 0: the edge takes all of the row or nothing.
    """
    edges = edges_of(records.xy[record])
    f = stepped_values(edges, left[:, 0], y, arithmetic)  # [R, 3]
    quotient = f // np.maximum(np.abs(edges.dy), 1)  # floor, also of negative numbers
    lower = np.where(edges.dy < 0, left - quotient, left).max(axis=1)
    upper = np.where(edges.dy > 0, left + quotient + 1, right).min(axis=1)
    missed = ((edges.dy == 0) & (f < 0)).any(axis=1)
    return lower, np.where(missed, lower, upper)


def _bisected(
    records: Records,
    record: NDArray[np.int64],
    y: NDArray[np.int64],
    left: NDArray[np.int64],
    right: NDArray[np.int64],
    arithmetic: Arithmetic,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The same where values are rounded: each edge is monotone along a row, so halving finds its first pixel on the other side.

    An edge that rises to the right has its pixels on that side, any other one has them on the left, or has all or none.
    """
    sides = sides_of(records, record, arithmetic)
    low, high = (np.repeat(limit, 3, axis=1) for limit in (left, right))  # [R, 3]: the pixel sought lies in [low, high]
    while (low < high).any():
        middle = (low + high) // 2
        beyond = (is_inside_each(sides, middle, y[:, None]) == sides.rises_x) | (low == high)
        low, high = np.where(beyond, low, middle + 1), np.where(beyond, middle, high)
    return np.where(sides.rises_x, low, left).max(axis=1), np.where(sides.rises_x, right, low).min(axis=1)

"""Binning: which 64x64 px bins each large record may cover; docs/numerics.md section 4."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..precision import EXACT, Arithmetic
from .coverage import sides_of, touches
from .float_mode import default_float_mode
from .numerics import BIN, LARGE_THRESHOLD, ramp
from .records import Bins, Records


@default_float_mode
def binning(records: Records, threshold: int = LARGE_THRESHOLD, arithmetic: Arithmetic = EXACT) -> Bins:
    """Lists the bins of every large record's bbox and keeps those that no edge rejects.

    Args:
        records: N records.
        threshold: records with more pixels than this in their bbox are large, the others small.
        arithmetic: the rung of the precision ladder.

    Returns:
        ``candidates`` int32 [C, 3] of (record, bin column, bin row), sorted by (record, bin row, bin column), ``kept`` bool [C],
        and ``small`` int32 [M].
    """
    large = bbox_pixels(records) > threshold
    candidates = _candidates(np.flatnonzero(large), records.bbox[large].astype(np.int64))
    sides = sides_of(records, candidates[:, 0], arithmetic)
    kept = touches(sides, BIN * candidates[:, 1], BIN * candidates[:, 2], BIN)
    return Bins(candidates.astype(np.int32), kept, np.flatnonzero(~large).astype(np.int32))


def bbox_pixels(records: Records) -> NDArray[np.int64]:
    """int64 [N]: the number of pixels in each bbox."""
    x0, y0, x1, y1 = records.bbox.astype(np.int64).T
    return (x1 - x0) * (y1 - y0)


def bbox_bins(records: Records) -> NDArray[np.int64]:
    """int64 [N]: the number of bins that each bbox touches."""
    first, size = _bin_rectangles(records.bbox.astype(np.int64))
    return size[:, 0] * size[:, 1]


def _bin_rectangles(bbox: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First bin (column, row) and number of (columns, rows), int64 [N, 2] each, of ``bbox`` [N, 4]."""
    first = bbox[:, :2] // BIN
    return first, (bbox[:, 2:] - 1) // BIN + 1 - first


def _candidates(record: NDArray[np.int64], bbox: NDArray[np.int64]) -> NDArray[np.int64]:
    """int64 [C, 3]: the bins (record, column, row) of each record's bbox, row by row."""
    first, size = _bin_rectangles(bbox)
    count = size[:, 0] * size[:, 1]
    columns = np.repeat(size[:, 0], count)
    place = ramp(count)
    column, row = np.repeat(first, count, axis=0).T
    return np.stack([np.repeat(record, count), column + place % columns, row + place // columns], axis=1)

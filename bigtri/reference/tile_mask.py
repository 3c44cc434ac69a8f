"""Tile masks: which of a bin's 8x8 tiles a record may touch, and which it fills; docs/numerics.md section 5."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..precision import EXACT, Arithmetic
from .coverage import fills, sides_of, touches
from .float_mode import default_float_mode
from .numerics import BIN, TILE, TILES
from .records import Records


@default_float_mode
def tile_mask(
    records: Records, queue: NDArray[np.int32], arithmetic: Arithmetic = EXACT
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Tests the 8x8 tiles of 8x8 px of each queue entry's bin.

    Args:
        records: N records.
        queue: int32 [Q, 3], (record, bin column, bin row).
        arithmetic: the rung of the precision ladder.

    Returns:
        ``touched`` and ``full``, int64 [Q] each, 64-bit patterns with bit ``8 * row + column``: no edge has the whole tile
        outside and the tile meets the bbox; and: every edge has all of the tile's 64 pixel centres inside. An entry that touches
        no tile stays in the arrays, as 0.
    """
    record, column, row = queue.astype(np.int64).T[:, :, None, None]  # [Q, 1, 1] each
    sides = sides_of(records, record, arithmetic)
    tile = TILE * np.arange(TILES)  # px from the bin's first pixel
    left, top = BIN * column + tile, BIN * row + tile[:, None]  # [Q, 1, column], [Q, row, 1], px
    touched = touches(sides, left, top, TILE)
    if arithmetic.precision.mask != "none":
        touched &= _meets_bbox(records, queue)
    full = fills(sides, left, top, TILE) & touched
    return _as_bits(touched), _as_bits(full)


def _meets_bbox(records: Records, queue: NDArray[np.int32]) -> NDArray[np.bool_]:
    """bool [Q, row, column]: whether the tile has a pixel in common with the record's bbox."""
    bbox = records.bbox[queue[:, 0]]
    tile = TILE * np.arange(TILES)
    x = BIN * queue[:, 1, None] + tile  # [Q, column], px
    y = BIN * queue[:, 2, None] + tile  # [Q, row], px
    meets_x = (x < bbox[:, 2, None]) & (x + TILE > bbox[:, 0, None])
    meets_y = (y < bbox[:, 3, None]) & (y + TILE > bbox[:, 1, None])
    return meets_y[:, :, None] & meets_x[:, None, :]


def _as_bits(flags: NDArray[np.bool_]) -> NDArray[np.int64]:
    """int64 [Q] of bool [Q, row, column]; little-endian by construction, so that tile 0 is bit 0 on any machine."""
    octets = np.packbits(flags.reshape(-1, TILES * TILES), axis=1, bitorder="little")  # uint8 [Q, 8]
    return np.ascontiguousarray(octets).view("<i8").reshape(-1).astype(np.int64)

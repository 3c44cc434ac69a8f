"""The stages one after the other, in chunks that keep the memory bounded: the oracle of every other implementation."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ..precision import EXACT, Arithmetic
from .binning import bbox_bins, binning
from .depth import depth
from .float_mode import default_float_mode
from .numerics import BIN, LARGE_THRESHOLD
from .records import Records
from .scanline import scanline
from .setup import Scissor, setup
from .tile_mask import tile_mask
from .visibility import background, merge

# Sizes of chunks, for arrays that stay in a cache rather than for the least memory: at some 100 bytes of intermediate values a
# bin, row or fragment, tens of megabytes at a time.
BINS = 1 << 16
ROWS = 1 << 16
FRAGMENTS = 1 << 18


@default_float_mode
def rasterize(
    positions: NDArray[np.float32],
    triangles: NDArray[np.int32],
    height: int,
    width: int,
    cull: str = "none",
    scissor: Scissor | None = None,
    threshold: int = LARGE_THRESHOLD,
    arithmetic: Arithmetic = EXACT,
) -> tuple[NDArray[np.int64], int]:
    """Draws triangles into a visibility buffer.

    Args:
        positions: float32 [V, 4], clip space.
        triangles: int32 [T, 3], valid indices into ``positions``.
        height, width: the image's size, px.
        cull: "none", "back" or "front": the faces that are not drawn.
        scissor: x0, y0, x1, y1, px, half-open: the part of the image that is drawn to.
        threshold: records with more pixels than this in their bbox go through bins; it changes no bit of the result.
        arithmetic: the rung of the precision ladder.

    Returns:
        int64 [H, W]: ``(depth bits << 32) | triangle`` of the nearest fragment, 2^63 - 1 on the background.
        The number of triangles dropped for a NaN or an infinity.
    """
    all_records, dropped = setup(positions, triangles, height, width, cull, scissor, arithmetic)
    packed = background(height, width)
    for chunk in batches(bbox_bins(all_records), BINS):
        records = Records(*(field[chunk] for field in all_records))
        for spans in _spans(records, threshold, arithmetic):
            for part in batches(spans[:, 3] - spans[:, 2], FRAGMENTS):
                merge(packed, records, spans[part], depth(records, spans[part], arithmetic))
    return packed, dropped


def _spans(records: Records, threshold: int, arithmetic: Arithmetic) -> Iterator[NDArray[np.int32]]:
    """The spans of all records, int32 [S, 4] at a time."""
    bins = binning(records, threshold, arithmetic)
    queue = bins.candidates[bins.kept]
    none_queued, none_touched, none_small = queue[:0], np.zeros(0, np.int64), bins.small[:0]
    for part in batches(np.full(len(queue), BIN), ROWS):
        touched, _ = tile_mask(records, queue[part], arithmetic)
        yield scanline(records, queue[part], touched, none_small, arithmetic)
    rows = records.bbox[bins.small, 3] - records.bbox[bins.small, 1]
    for part in batches(rows, ROWS):
        yield scanline(records, none_queued, none_touched, bins.small[part], arithmetic)


def batches(cost: NDArray[np.int_], limit: int) -> Iterator[slice]:
    """Consecutive slices of elements that cost about ``limit`` together: less than that plus one element's cost."""
    batch = (np.cumsum(cost, dtype=np.int64) - cost) // limit  # that of the cost up to the element
    bounds = np.concatenate([[0], np.flatnonzero(np.diff(batch)) + 1, [len(cost)]])
    for begin, end in zip(bounds[:-1], bounds[1:], strict=True):
        if begin < end:
            yield slice(int(begin), int(end))

"""Visibility: the nearest fragment of every pixel, as one integer; docs/numerics.md section 8."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .float_mode import default_float_mode
from .numerics import BACKGROUND, ramp
from .records import Records


@default_float_mode
def visibility(
    records: Records, spans: NDArray[np.int32], depth: NDArray[np.float32], height: int, width: int
) -> NDArray[np.int64]:
    """Keeps the smallest ``(depth bits << 32) | triangle`` of each pixel.

    Args:
        records: N records.
        spans: int32 [S, 4], (record, y, lower, upper), px.
        depth: float32 [F], a value >= 0 per covered pixel in the order of the spans; fragments beyond 1 are dropped.
        height, width: the image's size, px.

    Returns:
        int64 [H, W]; BACKGROUND where nothing is drawn.
    """
    packed = background(height, width)
    merge(packed, records, spans, depth)
    return packed


def background(height: int, width: int) -> NDArray[np.int64]:
    """An empty visibility buffer, int64 [H, W]."""
    return np.full((height, width), BACKGROUND, np.int64)


def merge(packed: NDArray[np.int64], records: Records, spans: NDArray[np.int32], depth: NDArray[np.float32]) -> None:
    """Takes the fragments of ``spans`` into the visibility buffer ``packed`` [H, W]. The order of calls never matters."""
    record, y, lower, upper = spans.astype(np.int64).T
    length = upper - lower
    pixel = np.repeat(y * packed.shape[1] + lower, length) + ramp(length)
    # The bits of floats >= +0, read as integers, are in the order of the floats. They stay below 2^31, so the key is positive.
    bits = depth.view(np.uint32).astype(np.int64)
    key = (bits << 32) | np.repeat(records.triangle[record], length)
    np.minimum.at(packed.reshape(-1), pixel, np.where(depth <= 1, key, BACKGROUND))

"""Resolve: which record of a visible triangle covers a pixel; docs/numerics.md section 9."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..precision import EXACT, Arithmetic
from .coverage import is_inside, sides_of
from .float_mode import default_float_mode
from .numerics import BACKGROUND
from .records import Records
from .setup import setup

_CHUNK = 1 << 18  # px looked at in one go; bounds the memory to some 100 MB


@default_float_mode
def resolve(
    packed: NDArray[np.int64],
    positions: NDArray[np.float32],
    triangles: NDArray[np.int32],
    arithmetic: Arithmetic = EXACT,
) -> tuple[Records, NDArray[np.int64]]:
    """Sets the visible triangles up once more and finds the record of every pixel.

    Args:
        packed: int64 [H, W], as ``visibility`` leaves it.
        positions: float32 [V, 4], the clip-space positions that it was drawn from.
        triangles: int32 [T, 3].
        arithmetic: the rung of the precision ladder that it was drawn with.

    Returns:
        The records of the triangles visible in ``packed``, whatever was culled or cut off when it was drawn; ``triangle`` is the
        index into ``triangles``.
        int64 [H, W]: the index of the pixel's record, its parent's first in fan order that covers the pixel's centre; -1 on the
        background.
    """
    height, width = packed.shape
    pixel = np.flatnonzero(packed != BACKGROUND)
    parent = packed.reshape(-1)[pixel] & 0xFFFFFFFF
    is_visible = np.zeros(len(triangles), np.bool_)
    is_visible[parent] = True
    visible = np.flatnonzero(is_visible)
    records, _ = setup(positions, triangles[visible], height, width, arithmetic=arithmetic)
    records = records._replace(triangle=visible[records.triangle].astype(np.int32))

    index = np.full(height * width, -1, np.int64)
    for begin in range(0, len(pixel), _CHUNK):
        chunk = slice(begin, begin + _CHUNK)
        x, y = pixel[chunk] % width, pixel[chunk] // width
        index[pixel[chunk]] = _first_covering(records, parent[chunk], x, y, arithmetic)
    return records, index.reshape(height, width)


def _first_covering(
    records: Records, parent: NDArray[np.int64], x: NDArray[np.int64], y: NDArray[np.int64], arithmetic: Arithmetic
) -> NDArray[np.int64]:
    """int64 [P]: the first record of triangle parent[i] that covers pixel (x[i], y[i]), -1 if none does."""
    found = np.full(len(parent), -1, np.int64)
    candidate = np.searchsorted(records.triangle, parent, side="left")
    end = np.searchsorted(records.triangle, parent, side="right")
    open_ = np.flatnonzero(candidate < end)  # the pixels still to be decided
    while open_.size:
        covers = is_inside(sides_of(records, candidate[open_], arithmetic), x[open_], y[open_]).all(axis=1)
        found[open_[covers]] = candidate[open_[covers]]
        candidate[open_] += 1
        open_ = open_[~covers & (candidate[open_] < end[open_])]
    return found

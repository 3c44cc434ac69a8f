"""Barycentrics and interpolated vertex attributes of a visibility buffer; docs/numerics.md section 9."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..precision import EXACT, Arithmetic
from .float_mode import default_float_mode
from .numerics import BACKGROUND, edge_values, edges_of
from .records import Records
from .resolve import resolve


class _Covered(NamedTuple):
    """The covered pixels of one image, in row-major order."""

    pixel: NDArray[np.int64]  # [P], flat index into the image
    vertex: NDArray[np.int32]  # [P, 3], vertex of slot 0, 1, 2
    corner: NDArray[np.int32]  # [P, 3], corner of the parent that slot 0, 1, 2 is
    weight: NDArray[np.float32]  # [P, 3], perspective-correct weight of slot 0, 1, 2


@default_float_mode
def barycentrics(
    packed: NDArray[np.int64],
    positions: NDArray[np.float32],
    triangles: NDArray[np.int32],
    arithmetic: Arithmetic = EXACT,
) -> NDArray[np.float32]:
    """Weights of the visible triangle's corners 0, 1 and 2 at every pixel centre.

    Args:
        packed: int64 [H, W], as ``visibility`` leaves it.
        positions: float32 [V, 4], the clip-space positions that it was drawn from.
        triangles: int32 [T, 3].
        arithmetic: the rung of the precision ladder that it was drawn with.

    Returns:
        float32 [H, W, 3]; 0 on the background.
    """
    covered = _covered(packed, positions, triangles, arithmetic)
    result = np.zeros((packed.size, 3), np.float32)
    result[covered.pixel[:, None], covered.corner] = covered.weight
    return result.reshape(*packed.shape, 3)


@default_float_mode
def interpolate(
    packed: NDArray[np.int64],
    positions: NDArray[np.float32],
    triangles: NDArray[np.int32],
    attributes: NDArray[np.float32],
    arithmetic: Arithmetic = EXACT,
) -> NDArray[np.float32]:
    """Perspective-correct vertex attributes at every pixel centre.

    Args:
        packed: int64 [H, W], as ``visibility`` leaves it.
        positions: float32 [V, 4], the clip-space positions that it was drawn from.
        triangles: int32 [T, 3].
        attributes: float32 [V, C].
        arithmetic: the rung of the precision ladder that it was drawn with.

    Returns:
        float32 [H, W, C]; 0 on the background.
    """
    covered = _covered(packed, positions, triangles, arithmetic)
    channels = attributes.shape[1]
    result = np.zeros((packed.size, channels), np.float32)
    term = [covered.weight[:, m, None] * attributes[covered.vertex[:, m]] for m in range(3)]
    result[covered.pixel] = (term[0] + term[1]) + term[2]
    return result.reshape(*packed.shape, channels)


def _covered(
    packed: NDArray[np.int64], positions: NDArray[np.float32], triangles: NDArray[np.int32], arithmetic: Arithmetic
) -> _Covered:
    # What names none of these triangles was not drawn from them: it reads as background.
    known = (packed & 0xFFFFFFFF) < len(triangles)
    records, record_index = resolve(np.where(known, packed, BACKGROUND), positions, triangles, arithmetic)
    flat = record_index.reshape(-1)
    pixel = np.flatnonzero(flat >= 0)
    index = flat[pixel]
    weight = _slot_weights(records, index, pixel % packed.shape[1], pixel // packed.shape[1], arithmetic)
    corner = records.corner[index]
    vertex = np.take_along_axis(triangles[records.triangle[index]], corner, axis=1)
    return _Covered(pixel, vertex, corner, weight)


def _slot_weights(
    records: Records, index: NDArray[np.int64], x: NDArray[np.int64], y: NDArray[np.int64], arithmetic: Arithmetic
) -> NDArray[np.float32]:
    """float32 [P, 3]: the weights b of record ``index[p]``'s slots at the centre of pixel (x[p], y[p])."""
    area = records.area[index].astype(np.float64)
    edges = edge_values(edges_of(records.xy[index]), x, y, arithmetic).astype(np.float64)
    screen = [edges[:, k] / area for k in range(3)]
    w = records.w[index]
    clipped = records.clipped[index]
    constant_w = ~clipped & (w[:, 0] == w[:, 1]) & (w[:, 1] == w[:, 2])

    u = [screen[k] / w[:, k] for k in range(3)]
    # What a clipped record knows is its own corners; its weights lead from there to the parent's.
    rows = records.weights[index]
    v = [(u[0] * rows[:, 0, m] + u[1] * rows[:, 1, m]) + u[2] * rows[:, 2, m] for m in range(3)]
    slot = [np.where(clipped, v[m], u[m]) for m in range(3)]
    total = (slot[0] + slot[1]) + slot[2]
    weight = [np.where(constant_w, screen[m], slot[m] / total) for m in range(3)]
    return np.stack(weight, axis=1).astype(np.float32)

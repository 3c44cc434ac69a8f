"""Barycentrics and interpolated vertex attributes of a visibility buffer; docs/numerics.md section 9."""

from __future__ import annotations

from typing import Any, NamedTuple

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
    corner = records.corner[index]
    vertex = np.take_along_axis(triangles[records.triangle[index]], corner, axis=1)
    y, x = np.divmod(pixel, packed.shape[1])
    if arithmetic.precision.attributes == "unsnapped":
        weight = _unsnapped_weights(positions[vertex].astype(np.float64), x, y, *packed.shape)
    else:
        weight = _slot_weights(records, index, x, y, arithmetic)
    return _Covered(pixel, vertex, corner, weight)


def _slot_weights(
    records: Records, index: NDArray[np.int64], x: NDArray[np.int64], y: NDArray[np.int64], arithmetic: Arithmetic
) -> NDArray[np.float32]:
    """float32 [P, 3]: the weights b of record ``index[p]``'s slots at the centre of pixel (x[p], y[p])."""
    rule = arithmetic.precision.attributes
    number: Any = np.float32 if rule in ("float32", "reciprocal") else np.float64
    over = _times_reciprocal if rule == "reciprocal" else np.divide
    area = records.area[index].astype(number)
    edges = edge_values(edges_of(records.xy[index]), x, y, arithmetic).astype(number)
    screen = [over(edges[:, k], area) for k in range(3)]
    clipped = records.clipped[index]
    # What a clipped record knows is its own corners; its weights lead from there to the parent's.
    rows = records.weights[index].astype(number)
    if rule == "affine":
        rows = rows / ((rows[:, :, 0] + rows[:, :, 1]) + rows[:, :, 2])[:, :, None]
        slot = [np.where(clipped, _weighted(screen, rows[:, :, m]), screen[m]) for m in range(3)]
        return np.stack(slot, axis=1).astype(np.float32)
    w = records.w[index].astype(number)
    constant_w = ~clipped & (w[:, 0] == w[:, 1]) & (w[:, 1] == w[:, 2])
    u = [over(screen[k], w[:, k]) for k in range(3)]
    slot = [np.where(clipped, _weighted(u, rows[:, :, m]), u[m]) for m in range(3)]
    total = (slot[0] + slot[1]) + slot[2]
    weight = [np.where(constant_w, screen[m], over(slot[m], total)) for m in range(3)]
    return np.stack(weight, axis=1).astype(np.float32)


def _unsnapped_weights(
    corners: NDArray[np.float64], x: NDArray[np.int64], y: NDArray[np.int64], height: int, width: int
) -> NDArray[np.float32]:
    """float32 [P, 3]: the weights of ``corners`` [P, 3, 4], clip space, at the centre of pixel (x[p], y[p])."""
    right, up = (2 * x + 1 - width) / width, (height - 2 * y - 1) / height  # normalized device coordinates
    # Seen from there: a point (x, y, w) of the triangle is that pixel's if both of these are 0.
    a, b = (corners[:, :, axis] - at[:, None] * corners[:, :, 3] for axis, at in ((0, right), (1, up)))
    u = [a[:, k] * b[:, m] - a[:, m] * b[:, k] for k, m in ((1, 2), (2, 0), (0, 1))]
    turn = (u[0] + u[1]) + u[2]
    # A pixel that only the snapped triangle covers gets the weights of a point on the border.
    v = [np.maximum(np.where(turn < 0, -one, one), 0) for one in u]
    total = (v[0] + v[1]) + v[2]
    seen = total != 0  # 0: all vertices are seen on one line with the pixel's centre
    return np.stack([np.where(seen, one / np.where(seen, total, 1), 0) for one in v], axis=1).astype(np.float32)


def _weighted(values: list[NDArray[np.floating]], by: NDArray[np.floating]) -> NDArray[np.floating]:
    """(v0 t0 + v1 t1) + v2 t2, [P], of three values [P] and ``by`` [P, 3]."""
    return (values[0] * by[:, 0] + values[1] * by[:, 1]) + values[2] * by[:, 2]


def _times_reciprocal(value: NDArray[np.float32], by: NDArray[np.float32]) -> NDArray[np.float32]:
    """``value / by`` for positive ``by``, as a product with a reciprocal that is good for 17 bits, in float32."""
    two = np.float32(2)
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        start = (np.int32(0x7EF311C7) - by.view(np.int32)).view(np.float32)  # the exponent negated, and a line for the mantissa
        once = start * (two - by * start)
        return value * (once * (two - by * once))

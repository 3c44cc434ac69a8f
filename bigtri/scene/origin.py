"""Where a scene's positions are counted from: what lies far from (0, 0, 0) would lose its form in float32."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .vectors import Vector

WORLD_ORIGIN: Vector = (0.0, 0.0, 0.0)
# float32 rounds x by up to 2^-24 |x|. Of a model within 8 times its size that is at most 2^-21 (5e-7) of the size: 1/256 px, to
# which vertices are snapped anyway, in a picture where the model is 8192 px large.
_FARTHEST = 8.0


def origin_for(bounds: NDArray[np.float64]) -> Vector:
    """The origin for a model of these bounds: (0, 0, 0), unless float32 would round its coordinates too much.

    It would where a coordinate is more than 8 times the model's size, its largest extent. Then the origin is the centre, rounded
    to multiples of the largest power of two that is not above the size, in each of x, y and z: a short number, from which no
    position is farther than the size, and which map coordinates have exactly.

    Args:
        bounds: float64 [2, 3], the lowest and the highest corner.
    """
    with np.errstate(over="ignore"):
        size, farthest = float((bounds[1] - bounds[0]).max()), float(np.abs(bounds).max())
        if not 0 < _FARTHEST * size < farthest < math.inf:
            return WORLD_ORIGIN
        step = math.ldexp(0.5, math.frexp(size)[1])
        x, y, z = (np.rint((bounds[0] + bounds[1]) / 2 / step) * step + 0.0).tolist()  # + 0.0: none is -0
    # Near the end of float64's range the centre is beyond it, or its number of steps.
    return (x, y, z) if all(map(math.isfinite, (x, y, z))) else WORLD_ORIGIN


def relative(positions: Sequence[NDArray[np.float64]]) -> tuple[Vector, list[NDArray[np.float32]]]:
    """World-space positions of the parts of a model, counted from the origin that ``origin_for`` has for all of them.

    Args:
        positions: float64 [V, 3] each.

    Returns:
        The origin, and float32 [V, 3] each: (0, 0, 0) and the rounded positions, or position minus origin in float64, rounded.
    """
    bounds = joined([box for part in positions if (box := bounds_of(part)) is not None])
    origin = WORLD_ORIGIN if bounds is None else origin_for(bounds)
    # A point beyond float32's range becomes an infinity, and rasterize drops and counts its triangles.
    with np.errstate(over="ignore", invalid="ignore"):
        return origin, [(part - np.array(origin)).astype(np.float32) for part in positions]


def bounds_of(positions: NDArray[Any]) -> NDArray[np.float64] | None:
    """float64 [2, 3]: the lowest and the highest corner of positions [V, 3] that are finite; None where none is."""
    finite = positions[np.isfinite(positions).all(axis=1)]
    return np.stack([finite.min(axis=0), finite.max(axis=0)]).astype(np.float64) if len(finite) else None


def joined(boxes: list[NDArray[np.float64]]) -> NDArray[np.float64] | None:
    """float64 [2, 3]: what holds all boxes [2, 3]; None without any."""
    return np.stack([np.min(boxes, axis=0)[0], np.max(boxes, axis=0)[1]]) if boxes else None

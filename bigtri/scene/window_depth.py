"""From window depth, which rasterizers compare, to distance, which people measure, and back. All inside is float64."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from ..ops.arguments import ArrayT, described


def distance_from(op: str, depth: ArrayT, near: float, far: float, perspective: bool) -> ArrayT:
    """Distances of window depths; both are of the same kind, dtype, shape and device. What is +inf stays so.

    Args:
        op: for the error text.
        depth: float32 or float64 of any shape, 0 at ``near`` and 1 at ``far``.
        near, far: distances; far may be infinite where there is perspective.
        perspective: whether depth is linear in 1 / distance, instead of in distance.

    Raises:
        TypeError: depth is of another kind.
    """
    window, near_plane, far_plane = _wide(op, "depth", depth, near, far)
    with np.errstate(invalid="ignore", divide="ignore"):  # at the background's infinity
        if not perspective:
            distance = near_plane + window * (far_plane - near_plane)
        elif far == math.inf:
            distance = near_plane / (1 - window)
        else:
            distance = near_plane * far_plane / (far_plane - window * (far_plane - near_plane))
    return _like(depth, distance)


def depth_from(op: str, distance: ArrayT, near: float, far: float, perspective: bool) -> ArrayT:
    """The inverse of ``distance_from``; arguments and errors as there."""
    away, near_plane, far_plane = _wide(op, "distance", distance, near, far)
    with np.errstate(invalid="ignore", divide="ignore"):
        if not perspective:
            window = (away - near_plane) / (far_plane - near_plane)
        elif far == math.inf:
            window = (away - near_plane) / away
        else:
            window = far_plane * (away - near_plane) / (away * (far_plane - near_plane))
    return _like(distance, window)


def _wide(op: str, name: str, value: Any, *planes: float) -> tuple[Any, ...]:
    """``value`` and the planes in float64, all of one kind: a tensor divides a number by multiplying with its reciprocal."""
    if isinstance(value, torch.Tensor) and value.dtype in (torch.float32, torch.float64):
        wide = value.double()
        return wide, *(wide.new_full((), plane) for plane in planes)
    if isinstance(value, np.ndarray | np.floating) and value.dtype in (np.float32, np.float64):
        return value.astype(np.float64), *map(np.float64, planes)
    raise TypeError(f"bigtri.{op}: {name} must be a float32 or float64 array or tensor, got {described(value)}")


def _like(given: Any, result: Any) -> Any:
    """``result``, +inf where ``given`` is, in the dtype of ``given``."""
    if isinstance(given, torch.Tensor):
        return torch.where(given == math.inf, math.inf, result).to(given.dtype)
    kept: NDArray[Any] = np.where(given == math.inf, math.inf, result).astype(given.dtype)
    return kept

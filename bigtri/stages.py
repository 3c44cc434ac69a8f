"""The stages one at a time, on the reference or on the extension, with the same arguments and outputs; docs/architecture.md.

For tests, for pictures that explain, and for people who validate a variant of their own. Arrays are NumPy on both backends.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from . import arrays, reference
from .rasterize import check_indices
from .reference.numerics import LARGE_THRESHOLD
from .reference.records import Bins, Records

Scissor = tuple[int, int, int, int]


def setup(
    positions: NDArray[np.float32],
    triangles: NDArray[np.int32],
    height: int,
    width: int,
    cull: str = "none",
    scissor: Scissor | None = None,
    *,
    backend: str = "auto",
) -> tuple[Records, int]:
    """Clip, project, snap, orient and cull: positions float32 [V, 4], triangles int32 [T, 3] to records, and the number dropped.

    Raises:
        RuntimeError: an index in ``triangles`` is out of range.
    """
    if arrays.choose_backend("setup", backend) == "reference":
        check_indices("setup", torch.from_numpy(np.ascontiguousarray(triangles)), len(positions))
        return reference.setup(positions, triangles, height, width, cull, scissor)
    *fields, dropped = _native("setup", positions, triangles, height, width, cull, list(scissor or (0, 0, width, height)))
    return Records(*fields), int(dropped)


def binning(records: Records, threshold: int = LARGE_THRESHOLD, *, backend: str = "auto") -> Bins:
    """The bins of records with more than ``threshold`` px in their bbox, which of them no edge rejects, and the other records."""
    if arrays.choose_backend("binning", backend) == "reference":
        return reference.binning(records, threshold)
    return Bins(*_native("binning", records.xy, records.bbox, threshold))


def tile_mask(
    records: Records, queue: NDArray[np.int32], *, backend: str = "auto"
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """64-bit masks (touched, full), int64 [Q] each, of the queue's entries int32 [Q, 3] (record, bin column, bin row)."""
    if arrays.choose_backend("tile_mask", backend) == "reference":
        return reference.tile_mask(records, queue)
    touched, full = _native("tile_mask", records.xy, records.bbox, queue)
    return touched, full


def scanline(
    records: Records, queue: NDArray[np.int32], touched: NDArray[np.int64], small: NDArray[np.int32], *, backend: str = "auto"
) -> NDArray[np.int32]:
    """Spans int32 [S, 4] (record, y, lower, upper): of the queue's touched tiles, then of the small records, int32 [M]."""
    if arrays.choose_backend("scanline", backend) == "reference":
        return reference.scanline(records, queue, touched, small)
    return _native("scanline", records.xy, records.bbox, queue, touched, small)[0]


def depth(records: Records, spans: NDArray[np.int32], *, backend: str = "auto") -> NDArray[np.float32]:
    """Window depth float32 [F] of every pixel of the spans, in their order."""
    if arrays.choose_backend("depth", backend) == "reference":
        return reference.depth(records, spans)
    return _native("depth", records.xy, records.z, records.area, spans)[0]


def visibility(
    records: Records, spans: NDArray[np.int32], depth: NDArray[np.float32], height: int, width: int, *, backend: str = "auto"
) -> NDArray[np.int64]:
    """packed int64 [H, W]: the nearest fragment of every pixel."""
    if arrays.choose_backend("visibility", backend) == "reference":
        return reference.visibility(records, spans, depth, height, width)
    return _native("visibility", records.triangle, spans, depth, height, width)[0]


def _native(op: str, *arguments: Any) -> list[NDArray[Any]]:
    """Call torch.ops.bigtri.<op>, NumPy in and out."""
    tensors = (torch.from_numpy(np.ascontiguousarray(a)) if isinstance(a, np.ndarray) else a for a in arguments)
    result = getattr(torch.ops.bigtri, op)(*tensors)
    return [t.numpy() for t in (result if isinstance(result, tuple) else (result,))]

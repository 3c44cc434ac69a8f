"""The stages one at a time, on the reference or on the extension, with the same arguments and outputs; docs/architecture.md.

For tests, for pictures that explain, and for people who validate a variant of their own. Arrays are NumPy on both backends. Every
stage raises TypeError or ValueError for an argument of another type, shape or value; the text names it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from .. import reference
from ..choices import CULLS
from ..ops import arguments
from ..ops.rasterize import check_indices
from ..precision import DEFAULT, EXACT, Arithmetic, Precision
from ..reference.numerics import BIN, LARGE_THRESHOLD, MAX_SIZE
from ..reference.records import Bins, Records

Scissor = tuple[int, int, int, int]

_INFINITY = 0x7F800000  # as the bits of a float32; above it are NaN
# Of the records' fields that a stage reads: type, shape, the sizes behind N, and between what they must lie.
_FIELDS: dict[str, tuple[torch.dtype, str, tuple[int, ...], tuple[int, int] | None]] = {
    "triangle": (torch.int32, "[N]", (), (0, 2**31 - 1)),
    "xy": (torch.int32, "[N, 3, 2]", (3, 2), None),
    "z": (torch.float32, "[N, 3]", (3,), None),
    "area": (torch.int64, "[N]", (), (1, 2**63 - 1)),
    "bbox": (torch.int32, "[N, 4]", (4,), (0, MAX_SIZE)),
}


def setup(
    positions: NDArray[np.float32],
    triangles: NDArray[np.int32],
    height: int,
    width: int,
    cull: str = "none",
    scissor: Scissor | None = None,
    *,
    backend: str = "auto",
    precision: str | Precision = DEFAULT,
) -> tuple[Records, int]:
    """Clip, project, snap, orient and cull: positions float32 [V, 4], triangles int32 [T, 3] to records, and the number dropped.

    Raises:
        RuntimeError: an index in ``triangles`` is out of range.
    """
    op = "setup"
    chosen = arguments.choose_backend(op, backend)
    arithmetic = _arithmetic(op, precision, chosen)
    arguments.check_choice(op, "cull", cull, CULLS)
    height, width = arguments.check_image_size(op, "height and width", (height, width))
    box = arguments.check_scissor(op, scissor, height, width)
    positions = _array(op, "positions", positions, torch.float32, "[V, 4]", 4)
    triangles = _array(op, "triangles", triangles, torch.int32, "[T, 3]", 3)
    check_indices(op, torch.from_numpy(triangles), len(positions))
    if chosen == "reference":
        return reference.setup(positions, triangles, height, width, cull, box, arithmetic)
    *fields, dropped = _native(op, positions, triangles, height, width, cull=cull, scissor=list(box), precision=arithmetic.name)
    place = np.zeros((len(fields[0]), 0, 2), np.float32)
    return Records._make([*fields, place]), int(dropped)


def binning(
    records: Records, threshold: int = LARGE_THRESHOLD, *, backend: str = "auto", precision: str | Precision = DEFAULT
) -> Bins:
    """The bins of records with more than ``threshold`` px in their bbox, which of them no edge rejects, and the other records."""
    op = "binning"
    chosen = arguments.choose_backend(op, backend)
    arithmetic = _arithmetic(op, precision, chosen)
    records = _checked(op, arithmetic, records, "xy", "bbox")
    if chosen == "reference":
        return reference.binning(records, threshold, arithmetic)
    return Bins(*_native(op, records.xy, records.bbox, threshold, precision=arithmetic.name))


def tile_mask(
    records: Records, queue: NDArray[np.int32], *, backend: str = "auto", precision: str | Precision = DEFAULT
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """64-bit masks (touched, full), int64 [Q] each, of the queue's entries int32 [Q, 3] (record, bin column, bin row)."""
    op = "tile_mask"
    chosen = arguments.choose_backend(op, backend)
    arithmetic = _arithmetic(op, precision, chosen)
    records = _checked(op, arithmetic, records, "xy", "bbox")
    queue = _queue(op, queue, records)
    if chosen == "reference":
        return reference.tile_mask(records, queue, arithmetic)
    touched, full = _native(op, records.xy, records.bbox, queue, precision=arithmetic.name)
    return touched, full


def scanline(
    records: Records,
    queue: NDArray[np.int32],
    touched: NDArray[np.int64],
    small: NDArray[np.int32],
    *,
    backend: str = "auto",
    precision: str | Precision = DEFAULT,
) -> NDArray[np.int32]:
    """Spans int32 [S, 4] (record, y, lower, upper): of the queue's touched tiles, then of the small records, int32 [M]."""
    op = "scanline"
    chosen = arguments.choose_backend(op, backend)
    arithmetic = _arithmetic(op, precision, chosen)
    records = _checked(op, arithmetic, records, "xy", "bbox")
    queue = _queue(op, queue, records)
    touched = _array(op, "touched", touched, torch.int64, "[Q]", rows=len(queue))
    small = _array(op, "small", small, torch.int32, "[M]")
    _within(op, "small", small, 0, len(records.xy) - 1)
    if chosen == "reference":
        return reference.scanline(records, queue, touched, small, arithmetic)
    return _native(op, records.xy, records.bbox, queue, touched, small, precision=arithmetic.name)[0]


def depth(
    records: Records, spans: NDArray[np.int32], *, backend: str = "auto", precision: str | Precision = DEFAULT
) -> NDArray[np.float32]:
    """Window depth float32 [F] of every pixel of the spans, in their order."""
    op = "depth"
    chosen = arguments.choose_backend(op, backend)
    arithmetic = _arithmetic(op, precision, chosen)
    records = _checked(op, arithmetic, records, "xy", "z", "area")
    spans = _spans(op, spans, len(records.xy), MAX_SIZE, MAX_SIZE)
    if chosen == "reference":
        return reference.depth(records, spans, arithmetic)
    return _native(op, records.xy, records.z, records.area, spans, precision=arithmetic.name)[0]


def visibility(
    records: Records, spans: NDArray[np.int32], depth: NDArray[np.float32], height: int, width: int, *, backend: str = "auto"
) -> NDArray[np.int64]:
    """packed int64 [H, W]: the nearest fragment of every pixel; ``depth`` >= +0, as the stage before leaves it."""
    op = "visibility"
    chosen = arguments.choose_backend(op, backend)
    height, width = arguments.check_image_size(op, "height and width", (height, width))
    records = _checked(op, EXACT, records, "triangle")
    spans = _spans(op, spans, len(records.triangle), height, width)
    pixels = int((spans[:, 3] - spans[:, 2]).sum(dtype=np.int64))
    depth = _array(op, "depth", depth, torch.float32, "[F]", rows=pixels)
    # As bits, and as they are packed: a -0, like all that is negative, would be nearer than everything; NaN has no place.
    bits = depth.view(np.int32)
    if ((bits < 0) | (bits > _INFINITY)).any():
        raise ValueError("bigtri.visibility: depth must be +0 or more, got a value that is negative, -0 or NaN")
    if chosen == "reference":
        return reference.visibility(records, spans, depth, height, width)
    packed = np.empty((height, width), np.int64)
    _native(op, records.triangle, spans, depth, out=packed)
    return packed


def _array(
    op: str, name: str, value: NDArray[Any], dtype: torch.dtype, shape: str, *sizes: int, rows: int | None = None
) -> NDArray[Any]:
    """``value``, contiguous, of the shape [N, *sizes], where N is ``rows`` if that is given; ``shape`` is for the error text."""
    tensor = arguments.check_tensor(op, name, value, dtype, shape, 1 + len(sizes), "reference")
    for dim, size in enumerate(sizes, 1):
        arguments.check_size(op, name, tensor, dim, size, shape)
    if rows is not None:
        arguments.check_size(op, name, tensor, 0, rows, shape)
    return tensor.cpu().numpy()


def _within(op: str, name: str, values: NDArray[Any], low: int, high: int) -> None:
    """Raise ValueError unless all of ``values`` lie in [low, high]."""
    if values.size and (values.min() < low or values.max() > high):
        raise ValueError(f"bigtri.{op}: {name} must lie in {low} to {high}, got {values.min()} to {values.max()}")


def _arithmetic(op: str, precision: str | Precision, backend: str) -> Arithmetic:
    """That of the precision, which the chosen backend has."""
    arithmetic = arguments.check_precision(op, precision)
    if backend == "native":
        arguments.check_compiled(op, arithmetic, "cpu")
        if not arithmetic.has_stages:
            raise ValueError(
                f"bigtri.{op}: backend must be 'reference' with precision {arithmetic.name!r}, whose records or spans are more "
                f"than the extension's stages hand on, got {backend!r}"
            )
    return arithmetic


def _checked(op: str, arithmetic: Arithmetic, records: Records, *names: str) -> Records:
    """``records`` with the named fields checked, of which the first says how many there are."""
    guard = arithmetic.guard
    rows = None
    for name in names:
        dtype, shape, sizes, bounds = _FIELDS[name]
        values = _array(op, name, getattr(records, name), dtype, shape, *sizes, rows=rows)
        if name == "xy":
            bounds = -guard, guard - 1
        if bounds:
            _within(op, name, values, *bounds)
        rows = len(values)
        records = records._replace(**{name: values})
    return records


def _queue(op: str, queue: NDArray[np.int32], records: Records) -> NDArray[np.int32]:
    """int32 [Q, 3], checked."""
    queue = _array(op, "queue", queue, torch.int32, "[Q, 3]", 3)
    _within(op, "queue's records", queue[:, 0], 0, len(records.xy) - 1)
    _within(op, "queue's bins", queue[:, 1:], 0, MAX_SIZE // BIN - 1)
    return queue


def _spans(op: str, spans: NDArray[np.int32], records: int, height: int, width: int) -> NDArray[np.int32]:
    """int32 [S, 4], checked: inside an image of this size."""
    spans = _array(op, "spans", spans, torch.int32, "[S, 4]", 4)
    _within(op, "spans' records", spans[:, 0], 0, records - 1)
    _within(op, "spans' rows", spans[:, 1], 0, height - 1)
    _within(op, "spans' columns", spans[:, 2:], 0, width)
    turned = spans[spans[:, 2] > spans[:, 3]]
    if len(turned):
        raise ValueError(f"bigtri.{op}: spans must have lower <= upper, got {turned[0].tolist()}")
    return spans


def _native(op: str, *given: Any, **named: Any) -> list[NDArray[Any]]:
    """Call torch.ops.bigtri.<op>, NumPy in and out."""

    def tensor(value: Any) -> Any:
        return torch.from_numpy(value) if isinstance(value, np.ndarray) else value

    result = getattr(torch.ops.bigtri, op)(*map(tensor, given), **{name: tensor(value) for name, value in named.items()})
    if result is None:  # it wrote to an argument
        return []
    return [t.numpy() for t in (result if isinstance(result, tuple) else (result,))]

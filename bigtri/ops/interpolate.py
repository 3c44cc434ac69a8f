"""Vertex attributes at every pixel of a visibility buffer; the arithmetic is docs/numerics.md section 9."""

from __future__ import annotations

from typing import Any

import torch

from ..precision import DEFAULT, Precision
from ..reference import attributes as reference
from ..reference.numerics import MAX_SIZE
from . import arguments
from .arguments import Array
from .rasterize import Visibility, check_indices


def interpolate(
    attributes: Array,
    visibility: Visibility | Array,
    positions: Array,
    triangles: Array,
    *,
    backend: str = "auto",
    precision: str | Precision = DEFAULT,
    out: Array | None = None,
) -> Array:
    """Perspective-correct vertex attributes of the visible triangle at every pixel centre.

    Args:
        attributes: float32 [V, C], or [B, V, C] where every view has its own.
        visibility: what ``rasterize`` returned, or its ``packed``: int64 [H, W] or [B, H, W]. A pixel that names none of the
            triangles reads as background.
        positions: the clip-space positions it was drawn from, float32 [V, 4] or [B, V, 4]. All views of a batch may share
            [V, 4], as those drawn with ``ranges`` do.
        triangles: int32 [T, 3].
        backend: "auto", "reference" or "native"; the bits are the same.
        precision: the rung that the buffer was drawn with.
        out: float32, contiguous, of the result's shape, apart from the inputs: written instead of new memory.

    Returns:
        float32 [H, W, C] or [B, H, W, C], 0 on the background; NumPy if ``visibility`` is NumPy. Never requires grad.

    Raises:
        TypeError, ValueError: an argument of another dtype, shape or device; the text names it.
        RuntimeError: an index in ``triangles`` is out of range. Not from the native backend on CUDA, which waits for nothing:
            there the pixels of such a triangle read as background.
    """
    op = "interpolate"
    chosen = arguments.choose_backend(op, backend)
    arithmetic = arguments.check_precision(op, precision)
    if chosen == "native":
        drawn = _interpolate_as_is(op, visibility, positions, triangles, (attributes,), arithmetic.name, out)
        if drawn is not None:
            return drawn
    given, packed, clip, faces = _drawing(op, visibility, positions, triangles, chosen)
    values = arguments.check_tensor(op, "attributes", attributes, torch.float32, "[V, C] or [B, V, C]", (2, 3), chosen)
    values = values if values.ndim == 3 else values[None]
    arguments.check_size(op, "attributes", values, 1, clip.shape[-2], "V, one row per position")
    if values.shape[0] != 1:
        arguments.check_size(op, "attributes", values, 0, packed.shape[0], "B, as in visibility")
    arguments.check_same_device(op, chosen, visibility=packed, attributes=values)

    shape = (*given.shape, values.shape[2])
    inputs = {"visibility": packed, "positions": clip, "triangles": faces, "attributes": values}
    result = arguments.check_output(op, out, torch.float32, shape, packed.device, inputs)
    images = result.view(*packed.shape, values.shape[2])
    if chosen == "native":
        arguments.check_compiled(op, arithmetic, packed.device.type)
        torch.ops.bigtri.interpolate.default(packed, clip, faces, values, arithmetic.name, images)
    else:
        check_indices(op, faces, clip.shape[-2])
        clip, values = clip.expand(packed.shape[0], -1, -1), values.expand(packed.shape[0], -1, -1)
        for image, view, p, a in zip(images, packed, clip, values, strict=True):
            image.copy_(arguments.on_reference(reference.interpolate, view, p, faces, a, arithmetic))
    return arguments.like(result, given)


def barycentrics(
    visibility: Visibility | Array,
    positions: Array,
    triangles: Array,
    *,
    backend: str = "auto",
    precision: str | Precision = DEFAULT,
    out: Array | None = None,
) -> Array:
    """Perspective-correct weights of the visible triangle's corners 0, 1 and 2 at every pixel centre.

    Args:
        visibility: what ``rasterize`` returned, or its ``packed``: int64 [H, W] or [B, H, W]. A pixel that names none of the
            triangles reads as background.
        positions: the clip-space positions it was drawn from, float32 [V, 4] or [B, V, 4]. All views of a batch may share
            [V, 4], as those drawn with ``ranges`` do.
        triangles: int32 [T, 3].
        backend: "auto", "reference" or "native"; the bits are the same.
        precision: the rung that the buffer was drawn with.
        out: float32, contiguous, of the result's shape, apart from the inputs: written instead of new memory.

    Returns:
        float32 [H, W, 3] or [B, H, W, 3], 0 on the background; NumPy if ``visibility`` is NumPy. Never requires grad.

    Raises:
        TypeError, ValueError: an argument of another dtype, shape or device; the text names it.
        RuntimeError: an index in ``triangles`` is out of range. Not from the native backend on CUDA, which waits for nothing:
            there the pixels of such a triangle read as background.
    """
    op = "barycentrics"
    chosen = arguments.choose_backend(op, backend)
    arithmetic = arguments.check_precision(op, precision)
    if chosen == "native":
        drawn = _interpolate_as_is(op, visibility, positions, triangles, (), arithmetic.name, out)
        if drawn is not None:
            return drawn
    given, packed, clip, faces = _drawing(op, visibility, positions, triangles, chosen)
    inputs = {"visibility": packed, "positions": clip, "triangles": faces}
    result = arguments.check_output(op, out, torch.float32, (*given.shape, 3), packed.device, inputs)
    images = result.view(*packed.shape, 3)
    if chosen == "native":
        arguments.check_compiled(op, arithmetic, packed.device.type)
        torch.ops.bigtri.barycentrics.default(packed, clip, faces, arithmetic.name, images)
    else:
        check_indices(op, faces, clip.shape[-2])
        for image, view, p in zip(images, packed, clip.expand(packed.shape[0], -1, -1), strict=True):
            image.copy_(arguments.on_reference(reference.barycentrics, view, p, faces, arithmetic))
    return arguments.like(result, given)


def _interpolate_as_is(
    op: str,
    visibility: Visibility | Array,
    positions: Array,
    triangles: Array,
    attributes: tuple[Array, ...],
    precision: str,
    out: Array | None,
) -> Array | None:
    """The operator ``op`` on arguments as they came; None where the checks have to look at them. Without attributes: weights."""
    given: Any = getattr(visibility, "packed", visibility)
    floats = [(value, torch.float32) for value in (positions, *attributes)]
    inputs = arguments.all_as_is((given, torch.int64), (triangles, torch.int32), *floats)
    if not inputs:
        return None
    packed, faces, clip, *values = inputs
    shape = (*packed.shape, *(values[0].shape[-1:] if values else (3,)))
    operator = torch.ops.bigtri.interpolate.default if values else torch.ops.bigtri.barycentrics.default
    result = arguments.run_as_is(operator, (packed, clip, faces, *values, precision), out, torch.float32, shape)
    return None if result is None else arguments.like(result, given)


def _drawing(
    op: str, visibility: Visibility | Array, positions: Array, triangles: Array, chosen: str
) -> tuple[Array, torch.Tensor, torch.Tensor, torch.Tensor]:
    """The buffer as given, and packed [B, H, W], positions [B, V, 4] or [V, 4], triangles [T, 3] that belong together."""
    # Not isinstance: anything with a packed buffer will do.
    given: Any = getattr(visibility, "packed", visibility)
    packed = arguments.check_tensor(op, "visibility", given, torch.int64, "[H, W] or [B, H, W]", (2, 3), chosen)
    dimensions = 2 if packed.ndim == 2 else (2, 3)
    clip = arguments.check_tensor(op, "positions", positions, torch.float32, "[V, 4] or [B, V, 4]", dimensions, chosen)
    faces = arguments.check_tensor(op, "triangles", triangles, torch.int32, "[T, 3]", 2, chosen)
    height, width = packed.shape[-2:]
    if packed.numel() and (height > MAX_SIZE or width > MAX_SIZE):
        raise ValueError(f"bigtri.{op}: visibility must be at most {MAX_SIZE} px a side, got {list(packed.shape)}")
    if packed.ndim == 2:
        packed, clip = packed[None], clip[None]
    if clip.ndim == 3:
        arguments.check_size(op, "positions", clip, 0, packed.shape[0], "B, as in visibility")
    arguments.check_size(op, "positions", clip, clip.ndim - 1, 4, "x, y, z, w")
    arguments.check_size(op, "triangles", faces, 1, 3, "corners")
    arguments.check_same_device(op, chosen, visibility=packed, positions=clip, triangles=faces)
    return given, packed, clip, faces

"""The one call that everything else builds on: triangles in, visibility buffer out."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import torch

from .. import native
from ..choices import CULLS
from ..precision import DEFAULT, Arithmetic, Precision
from ..reference import pipeline
from ..reference.numerics import BACKGROUND
from . import arguments, memory, tuned
from .arguments import Array

# The operators that draw into new memory and into given memory. None where the extension is not built.
_rasterize_new = torch.ops.bigtri.rasterize_new.default if native.available() else None
_rasterize_into = torch.ops.bigtri.rasterize_into.default if native.available() else None
_AUTO, _NATIVE, _NONE, _EXACT = "auto", "native", "none", DEFAULT

# packed is (depth bits << 32) | triangle: the low half of each int64 is the triangle, and -1 on the background.
_LOW_HALF = 0 if sys.byteorder == "little" else 1


class Visibility(NamedTuple):
    """What is visible at each pixel centre; [H, W], or [B, H, W] for a batch. No field requires grad."""

    packed: Array  # int64, (depth bits << 32) | triangle; 2^63 - 1 on the background
    depth: Array | None  # float32, window depth in [0, 1], 0 = near; +inf on the background. None where depth=False was passed.
    dropped: Array  # int64 [] or [B], triangles not drawn: a coordinate is NaN or infinite, or (CUDA) an index out of range

    @property
    def triangle(self) -> Array:
        """int32, index of the nearest triangle; -1 on the background. A view of ``packed``, not a copy, made when asked for."""
        if isinstance(self.packed, np.ndarray):
            return self.packed.view(np.int32)[..., _LOW_HALF::2]
        return self.packed.view(torch.int32)[..., _LOW_HALF::2]


def rasterize(
    positions: Array,
    triangles: Array,
    resolution: tuple[int, int],
    *,
    backend: str = "auto",
    variant: str = "auto",
    precision: str | Precision = "exact",
    parameters: Mapping[str, int] | None = None,
    cull: str = "none",
    scissor: tuple[int, int, int, int] | None = None,
    ranges: Array | None = None,
    validate: bool | None = None,
    depth: bool = True,
    out: Array | None = None,
    depth_out: Array | None = None,
) -> Visibility:
    """Find the nearest triangle, and its depth, at every pixel centre. Exact: docs/numerics.md says what the bits are.

    Args:
        positions: float32 [V, 4] or [B, V, 4], clip space as in OpenGL (x right, y up, visible where -w <= x, y, z <= w).
        triangles: int32 [T, 3], indices into the V positions, shared by all views of a batch.
        resolution: (height, width) in px, 1 to 16384 each.
        backend: "reference" (the NumPy oracle), "native" (the extension), or "auto": native where it is built. Same bits.
        variant: how the native backend schedules the work, "auto" or one of ``bigtri.native.VARIANTS[device type]``. Same bits.
            "auto" is the first of these, or what ``use_tuning`` has read.
        precision: a preset or another rung by its name, or a ``Precision``. Presets: "exact"; "balanced", which draws the same
            and computes attributes in float32; "fast", which computes depth in float32 too. None gives up coverage. Rungs:
            "subpixel4", which snaps vertices to 1/16 instead of 1/256 px; "depth_reversed" for clip depth from w at the near
            plane to 0 at the far one (docs/numerics.md 13 says what its depth image holds); and those that show what accuracy
            costs, ``bigtri.precision.RUNGS``. Each has its own bits, the same on every backend that it is compiled for; the
            reference has all, and every mix of them. ``interpolate`` takes the same.
        parameters: numbers of the variant's, by name; ``bigtri.native.REGISTRY`` says which there are and what they may be. They
            change no bit. The reference has none.
        cull: "none", "back" or "front": faces not to draw. Front faces are counter-clockwise on the screen.
        scissor: (x0, y0, x1, y1) in px, half-open; nothing is drawn outside it.
        ranges: int32 [B, 2], on the CPU: the first triangle and the number of triangles of each view, for a batch of different
            meshes. ``positions`` is then [V, 4], shared by the views. A triangle keeps its id in the whole list. Ranges may
            overlap or be empty. ``interpolate`` takes ``positions.expand(B, -1, -1)`` with the result.
        validate: on the CPU indices are always checked. On CUDA a triangle with an index out of range is dropped and counted;
            True checks all of them first, which waits for the device.
        depth: whether to return the depth image. Without it, 4 bytes a pixel are not written.
        out: int64, contiguous, of ``packed``'s shape, apart from the inputs: written instead of new memory. Large images gain
            from that where earlier results are kept; else ``bigtri.memory`` hands out the memory of those let go.
        depth_out: float32, contiguous, of ``packed``'s shape, apart from the inputs and ``out``: the depth image is written
            there instead of to new memory.

    Returns:
        Visibility: torch tensors on the device of ``positions``, or NumPy arrays if ``positions`` is one.

    Raises:
        TypeError, ValueError: an argument of another dtype, shape, device or value; the text names it.
        RuntimeError: an index in ``triangles`` or a range is out of range (nothing is drawn; indices on CUDA only with
            ``validate=True``), or the backend is not built. Under torch.compile also where ``out`` shares memory with an input.

    torch.vmap has no rule for it, since it writes into memory: a batch of views is one call.
    """
    op = "rasterize"
    # Looked at once: both may be iterators, which have nothing left for a second look.
    height, width = arguments.check_image_size(op, "resolution", resolution)
    box = None if scissor is None else arguments.check_scissor(op, scissor, height, width)
    # `is`, since the texts and flags are what the caller's code says or the defaults: others are as right and take longer.
    if (
        (backend is _AUTO or backend is _NATIVE)
        and variant is _AUTO
        and parameters is None
        and ranges is None
        and (validate is None or validate is False)
        and (depth is True or depth is False)
        and (depth_out is None or (depth and out is not None))
    ):
        drawn = _draw_standard(op, positions, triangles, height, width, precision, cull, box, depth, out, depth_out)
        if drawn is not None:
            return drawn

    chosen = arguments.choose_backend(op, backend)
    arithmetic = arguments.check_precision(op, precision)
    arguments.check_choice(op, "cull", cull, CULLS)
    arguments.check_flag(op, "validate", validate, optional=True)
    arguments.check_flag(op, "depth", depth)
    if depth_out is not None and not depth:
        raise ValueError(f"bigtri.{op}: depth_out must be None where depth is False, got {arguments.described(depth_out)}")
    if box is None:
        box = 0, 0, width, height

    if chosen == "native" and variant == "auto" and parameters is None and ranges is None and not validate:
        drawn = _draw_as_is(op, positions, triangles, height, width, cull, box, arithmetic.name, depth, out, depth_out)
        if drawn is not None:
            return drawn

    clip = arguments.check_tensor(op, "positions", positions, torch.float32, "[V, 4] or [B, V, 4]", (2, 3), chosen)
    faces = arguments.check_tensor(op, "triangles", triangles, torch.int32, "[T, 3]", 2, chosen)
    arguments.check_size(op, "positions", clip, -1, 4, "x, y, z, w")
    arguments.check_size(op, "triangles", faces, 1, 3, "corners")
    arguments.check_same_device(op, "reference", positions=clip, triangles=faces)  # no backend draws on the meta device
    checked_ranges = None if ranges is None else _check_ranges(op, ranges, clip, faces, chosen)
    kind = clip.device.type
    rungs = native.REGISTRY.get(kind)
    if chosen == "native" and rungs is None:
        why = "as the extension is built here"
        if clip.is_cuda and native.is_broken("cuda"):
            why = f"as the extension's library for cuda does not load here ({native.load_error('cuda')})"
        built = " or ".join(native.REGISTRY)
        raise ValueError(f"bigtri.{op}: positions must be on {built}, {why}, got {clip.device}")
    if chosen == "native":
        arguments.check_compiled(op, arithmetic, clip.device.type)
    variants = rungs.get(arithmetic.name, {}) if rungs else {}
    if variant != "auto":
        arguments.check_choice(op, "variant", variant, ("auto", *variants))
    if parameters and chosen == "reference":
        raise ValueError(f"bigtri.{op}: parameters must be None with the reference, which has none, got {dict(parameters)}")

    shape = (*(clip.shape[:-2] if checked_ranges is None else checked_ranges.shape[:1]), height, width)
    inputs = {"positions": clip, "triangles": faces}
    if checked_ranges is not None:
        inputs["ranges"] = checked_ranges
    packed = arguments.check_output(op, out, torch.int64, shape, clip.device, inputs)
    dropped = clip.new_empty(shape[:-2], dtype=torch.int64)
    image = None
    if depth:
        apart = inputs if out is None else {**inputs, "out": packed}
        image = arguments.check_output(op, depth_out, torch.float32, shape, clip.device, apart, "depth_out")
    if chosen == "native":
        if validate:
            check_indices(op, faces, clip.shape[-2])
        picked = next(iter(variants.values())) if variant == "auto" else variants[variant]
        values = native.parameter_values(op, picked, parameters)
        if tuned.tables and variant == "auto" and parameters is None and not torch.compiler.is_compiling():
            picked, values = tuned.way_for(clip, faces, arithmetic.name, shape) or (picked, values)
        drawing = (clip, faces, height, width, cull, box, picked.name, arithmetic.name, 1, values, checked_ranges, None)
        torch.ops.bigtri.rasterize.default(*drawing, packed, image, dropped, None)
    else:
        _draw_reference(op, clip, faces, checked_ranges, box, cull, arithmetic, packed, image, dropped)

    return _result(positions, packed, image, dropped)


def _result(positions: Array, packed: torch.Tensor, image: torch.Tensor | None, dropped: torch.Tensor) -> Visibility:
    """As NumPy if ``positions`` is NumPy."""
    if isinstance(positions, np.ndarray):
        return Visibility(packed.numpy(), None if image is None else image.numpy(), dropped.numpy())
    return Visibility(packed, image, dropped)


def _draw_standard(
    op: str,
    positions: Array,
    triangles: Array,
    height: int,
    width: int,
    precision: str | Precision,
    cull: str,
    box: tuple[int, int, int, int] | None,
    depth: bool,
    out: Array | None,
    depth_out: Array | None,
) -> Visibility | None:
    """Draw with the standard variant of the native backend; None where that cannot be, and nothing is drawn.

    Most calls are like that, and all checks of ``rasterize`` take longer than drawing a small picture. The operator checks what
    they check. Only its texts are others, so they are not shown: the caller goes on to the checks.
    """
    if (
        _rasterize_new is None
        or _rasterize_into is None
        or tuned.tables
        or native.parameters_are_set()
        or torch.compiler.is_compiling()
    ):
        return None
    try:
        clip, faces = arguments.for_operator(positions, torch.float32), arguments.for_operator(triangles, torch.int32)
        if clip is None or faces is None:
            return None
        if out is not None:
            packed, image = arguments.as_is(out, torch.int64), None
            if depth_out is not None:
                image = arguments.as_is(depth_out, torch.float32)
            elif depth:
                image = memory.new(clip, (*clip.shape[:-2], height, width), torch.float32)
            if packed is None or (depth and image is None):
                return None
            if precision is _EXACT and cull is _NONE and box is None:
                dropped = _rasterize_into(clip, faces, height, width, packed, image)
            else:
                rung = arguments.check_precision(op, precision).name
                dropped = _rasterize_into(clip, faces, height, width, packed, image, cull, box, rung)
            return _result(positions, packed, image, dropped)
        if not clip.is_cuda:
            views = len(clip) if clip.ndim == 3 else 1
            if not clip.is_cpu or views * height * width * 8 >= memory.SMALLEST:  # of large ones the memory is not torch's
                return None
        if precision is _EXACT and cull is _NONE and box is None and depth:
            made = _rasterize_new(clip, faces, height, width)
        else:
            rung = arguments.check_precision(op, precision).name
            made = _rasterize_new(clip, faces, height, width, cull, box, rung, depth)
    except (RuntimeError, MemoryError):
        return None
    return Visibility(*made) if clip is positions else _result(positions, *made)


def _draw_as_is(
    op: str,
    positions: Array,
    triangles: Array,
    height: int,
    width: int,
    cull: str,
    box: tuple[int, int, int, int],
    precision: str,
    depth: bool,
    out: Array | None,
    depth_out: Array | None,
) -> Visibility | None:
    """Draw with the native backend where the operator takes everything as it came; else None, and nothing is written.

    As with ``_draw_standard`` the operator checks the tensors.
    """
    if torch.compiler.is_compiling():
        return None
    clip, faces = arguments.as_is(positions, torch.float32), arguments.as_is(triangles, torch.int32)
    if clip is None or faces is None or not 2 <= clip.ndim <= 3:
        return None
    variants = native.REGISTRY.get("cuda" if clip.is_cuda else "cpu", {}).get(precision)
    if not variants:
        return None
    views = clip.shape[:-2]
    shape = (*views, height, width)
    try:
        packed = memory.new(clip, shape, torch.int64) if out is None else arguments.as_is(out, torch.int64)
        image = None
        if depth_out is not None:
            image = arguments.as_is(depth_out, torch.float32)
        elif depth:
            image = memory.new(clip, shape, torch.float32)
        if packed is None or (depth and image is None):
            return None
        picked = next(iter(variants.values()))
        values = native.parameter_values(op, picked, None)
        if tuned.tables:
            picked, values = tuned.way_for(clip, faces, precision, shape) or (picked, values)
        dropped = memory.new(clip, views, torch.int64)
        drawing = (clip, faces, height, width, cull, box, picked.name, precision, 1, values, None, None)
        torch.ops.bigtri.rasterize.default(*drawing, packed, image, dropped, None)
    except (RuntimeError, MemoryError):
        return None
    return _result(positions, packed, image, dropped)


def check_indices(op: str, triangles: torch.Tensor, vertices: int) -> None:
    """Raise RuntimeError unless every index in ``triangles`` names one of the vertices; the extension checks by itself."""
    if triangles.numel():
        low, high = (int(v) for v in torch.aminmax(triangles))
        if vertices == 0:
            raise RuntimeError(f"bigtri.{op}: triangles must be empty where positions is, got {len(triangles)} triangles")
        if low < 0 or high >= vertices:
            raise RuntimeError(
                f"bigtri.{op}: triangles must index positions, 0 to {vertices - 1}, got indices from {low} to {high}"
            )


def _draw_reference(
    op: str,
    clip: torch.Tensor,
    faces: torch.Tensor,
    checked_ranges: torch.Tensor | None,
    box: tuple[int, int, int, int],
    cull: str,
    arithmetic: Arithmetic,
    packed: torch.Tensor,
    image: torch.Tensor | None,
    dropped: torch.Tensor,
) -> None:
    """Draw clip [V, 4] or [B, V, 4] with the reference into packed and depth [..., H, W] and dropped [...].

    checked_ranges: the view's ranges [B, 2], with clip [V, 4]; None: all triangles in every view.
    """
    check_indices(op, faces, clip.shape[-2])
    height, width = packed.shape[-2:]
    views = 1 if packed.ndim == 2 else len(packed)
    positions, triangles = clip.cpu().numpy(), faces.cpu().numpy()
    results, lost = packed.view(views, height, width), dropped.view(views)
    for b in range(views):
        first, count = (0, len(triangles)) if checked_ranges is None else checked_ranges[b].tolist()
        view = positions[b] if clip.ndim == 3 else positions
        result, missing = pipeline.rasterize(
            view, triangles[first : first + count], height, width, cull, box, arithmetic=arithmetic
        )
        result[result != BACKGROUND] += first  # the id within the whole list
        results[b] = torch.from_numpy(result)
        lost[b] = missing
    if image is not None:
        high = (packed >> 32).to(torch.int32)
        image.copy_(torch.where(packed == BACKGROUND, torch.inf, high.view(torch.float32)))


def _check_ranges(op: str, ranges: Array, clip: torch.Tensor, faces: torch.Tensor, backend: str) -> torch.Tensor:
    """``ranges`` as a tensor [B, 2] that goes with positions [V, 4] and with the triangles."""
    checked_ranges = arguments.check_tensor(op, "ranges", ranges, torch.int32, "[B, 2]", 2, backend)
    arguments.check_size(op, "ranges", checked_ranges, 1, 2, "first triangle, number of triangles")
    if not checked_ranges.is_cpu:
        raise ValueError(f"bigtri.{op}: ranges must be on the CPU, got {checked_ranges.device}")
    if clip.ndim != 2:
        raise ValueError(f"bigtri.{op}: positions must be [V, 4] where ranges says what each view draws, got {list(clip.shape)}")
    if backend == "reference":  # the operator checks by itself
        for b, (first, count) in enumerate(checked_ranges.tolist()):
            if first < 0 or count < 0 or first + count > len(faces):
                raise RuntimeError(
                    f"bigtri.{op}: ranges must be (first, count) within the {len(faces)} triangles, "
                    f"got ({first}, {count}) for view {b}"
                )
    return checked_ranges

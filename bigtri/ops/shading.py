"""Lambert shading and sRGB; the arithmetic is docs/numerics.md section 11."""

from __future__ import annotations

import numpy as np
import torch

from .. import torch_private
from ..reference import shading as reference
from . import arguments
from .arguments import Array, ArrayT

# Made here and not on demand, because torch.compile would trace through what makes them. Not by torch.tensor, which would put
# them on the default device.
THRESHOLDS = torch.from_numpy(np.array(reference.encode_thresholds()))  # float32 [255]
_DECODED = torch.from_numpy(np.array(reference.decode_table()))  # float32 [256]
_DECODED_16 = torch.from_numpy(np.array(reference.decode_table(16)))  # float32 [65536]


def lambert(
    normals: ArrayT,
    albedo: Array,
    ambient: Array,
    light_directions: Array,
    light_colors: Array,
    *,
    backend: str = "auto",
    out: Array | None = None,
) -> ArrayT:
    """Diffuse light: ``albedo * (ambient + sum of color * max(n . l, 0))``.

    Args:
        normals: float32 [..., 3], of any length; (0, 0, 0) gets the ambient light alone.
        albedo: float32 [..., 3], linear.
        ambient: float32 [3], linear.
        light_directions: float32 [L, 3], towards the light, used as given: of unit length, unless a length is to scale the light.
        light_colors: float32 [L, 3], linear.
        backend: "auto", "reference" or "native"; the bits are the same.
        out: float32 [..., 3], contiguous, apart from the inputs: written instead of new memory.

    Returns:
        float32 [..., 3], linear; NumPy if ``normals`` is NumPy. Never requires grad.

    Raises:
        TypeError, ValueError: an argument of another dtype, shape or device; the text names it.
    """
    op = "lambert"
    chosen = arguments.choose_backend(op, backend)
    if chosen == "native":
        given = (normals, albedo, ambient, light_directions, light_colors)
        inputs: list[torch.Tensor] = arguments.all_as_is(*((value, torch.float32) for value in given))
        if inputs:
            operator, shape = torch.ops.bigtri.lambert.default, inputs[0].shape
            lit = arguments.run_as_is(operator, tuple(inputs), out, torch.float32, shape)
            if lit is not None:
                return arguments.like(lit, normals)

    n = arguments.check_tensor(op, "normals", normals, torch.float32, "[..., 3]", None, chosen)
    arguments.check_size(op, "normals", n, -1, 3, "x, y, z")
    base = arguments.check_tensor(op, "albedo", albedo, torch.float32, "[..., 3]", None, chosen)
    if base.shape != n.shape:
        raise ValueError(f"bigtri.{op}: albedo must have normals' shape {list(n.shape)}, got {list(base.shape)}")
    around = arguments.check_tensor(op, "ambient", ambient, torch.float32, "[3]", 1, chosen)
    arguments.check_size(op, "ambient", around, 0, 3, "red, green, blue")
    directions = arguments.check_tensor(op, "light_directions", light_directions, torch.float32, "[L, 3]", 2, chosen)
    arguments.check_size(op, "light_directions", directions, 1, 3, "x, y, z")
    colors = arguments.check_tensor(op, "light_colors", light_colors, torch.float32, "[L, 3]", 2, chosen)
    arguments.check_size(op, "light_colors", colors, 1, 3, "red, green, blue")
    arguments.check_size(op, "light_colors", colors, 0, directions.shape[0], "L, as in light_directions")
    arguments.check_same_device(
        op, chosen, normals=n, albedo=base, ambient=around, light_directions=directions, light_colors=colors
    )

    checked = {"normals": n, "albedo": base, "ambient": around, "light_directions": directions, "light_colors": colors}
    result = arguments.check_output(op, out, torch.float32, tuple(n.shape), n.device, checked)
    if chosen == "native":
        torch.ops.bigtri.lambert.default(n, base, around, directions, colors, result)
    else:
        rows = n.reshape(-1, 3), base.reshape(-1, 3)
        result.copy_(arguments.on_reference(reference.lambert, *rows, around, directions, colors).view(n.shape))
    return arguments.like(result, normals)


def encode_srgb(linear: ArrayT, *, backend: str = "auto", out: Array | None = None) -> ArrayT:
    """Linear light (float32, any shape) to 8-bit sRGB (uint8, the same shape), rounded to the nearest code.

    Values outside [0, 1] saturate, NaN gives 0. NumPy if ``linear`` is NumPy. ``out``, uint8 and
    contiguous, is written instead of new memory.

    Raises:
        TypeError: not float32; the text says what came.
    """
    op = "encode_srgb"
    chosen = arguments.choose_backend(op, backend)
    if chosen == "native":
        inputs: list[torch.Tensor] = arguments.all_as_is((linear, torch.float32))
        if inputs:
            operator, shape = torch.ops.bigtri.encode_srgb.default, inputs[0].shape
            codes = arguments.run_as_is(operator, (*inputs, THRESHOLDS), out, torch.uint8, shape)
            if codes is not None:
                return arguments.like(codes, linear)

    values = arguments.check_tensor(op, "linear", linear, torch.float32, "[...]", None, chosen)
    arguments.check_same_device(op, chosen, linear=values)
    result = arguments.check_output(op, out, torch.uint8, tuple(values.shape), values.device, {"linear": values})
    if chosen == "native":
        thresholds = torch_private.beside(THRESHOLDS, values)  # on the CPU for a GPU too
        torch.ops.bigtri.encode_srgb.default(values, thresholds, result)
    else:
        result.copy_(arguments.on_reference(reference.encode_srgb, values))
    return arguments.like(result, linear)


def decode_srgb(encoded: ArrayT, *, backend: str = "auto") -> ArrayT:
    """sRGB of 8 or 16 bits (uint8 or uint16, any shape) to linear light (float32, the same shape, in [0, 1]).

    NumPy if ``encoded`` is NumPy. It is a lookup in a table of all codes, so that both backends do the same. Code 257 * c of
    16 bits is code c of 8.

    Raises:
        TypeError: neither uint8 nor uint16; the text says what came.
    """
    op = "decode_srgb"
    arguments.choose_backend(op, backend)
    codes = arguments.check_tensor(op, "encoded", encoded, (torch.uint8, torch.uint16), "[...]", None)
    table = _DECODED if codes.dtype == torch.uint8 else _DECODED_16
    return arguments.like(torch_private.beside(table, codes).to(codes.device)[codes.long()], encoded)

"""Texture lookups; the arithmetic is docs/numerics.md section 10."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from .. import warn
from ..reference import texture as reference
from ..reference.numerics import MAX_TEXTURE
from . import arguments
from .arguments import Array, ArrayT

FILTERS = ("bilinear", "nearest")
WRAPS = ("repeat", "clamp")
_CODES: dict[Any, torch.dtype] = {
    **{torch.uint8: torch.uint8, torch.uint16: torch.uint16},
    **{np.dtype(np.uint8): torch.uint8, np.dtype(np.uint16): torch.uint16},
}
# A texture with as many rows as a picture has channels, and at least so many columns and channels, looks like a picture
# with its channels first. A smaller one may as well be a table of features, which often has few rows.
_PICTURE_CHANNELS, _PICTURE_SIDE = (1, 3, 4), 16


def sample_texture(
    texture: Array,
    uv: ArrayT,
    *,
    filter: str = "bilinear",
    wrap: str = "repeat",
    backend: str = "auto",
    out: Array | None = None,
) -> ArrayT:
    """Look ``uv`` up in ``texture``, without mipmaps.

    Args:
        texture: [Ht, Wt, C], 1 to 65536 px a side, row 0 on top, channels last. float32, linear light if it is to be
            shaded; or uint8 or uint16, sRGB codes that are decoded as they are read, all channels alike: the bits are
            those of ``decode_srgb(texture)``. C may be any number, so [C, Ht, Wt], as torch's convolutions have it, is a
            texture of C rows too. Where that looks like a picture of 1, 3 or 4 channels there is a warning, once in the
            process; nothing else tells the two apart.
        uv: float32 [..., 2]; (0, 0) is the lower left corner of the image, (1, 1) the upper right one.
        filter: "bilinear" or "nearest".
        wrap: what lies beyond [0, 1]: "repeat" or "clamp".
        backend: "auto", "reference" or "native"; the bits are the same.
        out: float32 [..., C], contiguous, apart from the inputs: written instead of new memory.

    Returns:
        float32 [..., C]; NumPy if ``uv`` is NumPy. A uv pair with a NaN or an infinity reads as (0, 0). Never requires grad.

    Raises:
        TypeError, ValueError: an argument of another dtype, shape or device, or an unknown name; the text names it.
    """
    op = "sample_texture"
    chosen = arguments.choose_backend(op, backend)
    arguments.check_choice(op, "filter", filter, FILTERS)
    arguments.check_choice(op, "wrap", wrap, WRAPS)
    if chosen == "native":
        inputs: list[torch.Tensor] = arguments.all_as_is(
            (texture, _CODES.get(getattr(texture, "dtype", None), torch.float32)), (uv, torch.float32)
        )
        if inputs and not _has_channels_first(inputs[0].shape):
            operator, shape = torch.ops.bigtri.sample_texture.default, (*inputs[1].shape[:-1], *inputs[0].shape[2:])
            looked_up = arguments.run_as_is(operator, (*inputs, filter, wrap), out, torch.float32, shape)
            if looked_up is not None:
                return arguments.like(looked_up, uv)

    texels = arguments.check_tensor(op, "texture", texture, (torch.float32, torch.uint8, torch.uint16), "[Ht, Wt, C]", 3, chosen)
    height, width, channels = (int(n) for n in texels.shape)
    if height == 0 or width == 0:
        raise ValueError(f"bigtri.{op}: texture must have at least one texel, got {list(texels.shape)}")
    if height > MAX_TEXTURE or width > MAX_TEXTURE:
        raise ValueError(f"bigtri.{op}: texture must be at most {MAX_TEXTURE} px a side, got {list(texels.shape)}")
    if not torch.compiler.is_compiling() and _has_channels_first(texels.shape):
        what = f"texture {list(texels.shape)} is read as [Ht, Wt, C]: {height} px high, of {channels} channels"
        advice = "if it is [C, Ht, Wt], pass texture.permute(1, 2, 0)"
        warn.once("texture", f"bigtri.{op}: {what}; {advice}", UserWarning)
    coordinates: torch.Tensor = arguments.check_tensor(op, "uv", uv, torch.float32, "[..., 2]", None, chosen)
    arguments.check_size(op, "uv", coordinates, -1, 2, "u, v")
    arguments.check_same_device(op, chosen, uv=coordinates, texture=texels)

    shape = (*coordinates.shape[:-1], channels)
    given = {"texture": texels, "uv": coordinates}
    result = arguments.check_output(op, out, torch.float32, shape, texels.device, given)
    if chosen == "native":
        torch.ops.bigtri.sample_texture.default(texels, coordinates, filter, wrap, result)
    else:
        flat = coordinates.reshape(-1, 2)
        result.copy_(arguments.on_reference(reference.sample_texture, texels, flat, filter, wrap).view(shape))
    return arguments.like(result, uv)


def _has_channels_first(shape: torch.Size) -> bool:
    """Whether a texture looks like a picture [C, Ht, Wt]."""
    return len(shape) == 3 and shape[0] in _PICTURE_CHANNELS and min(shape[1:]) >= _PICTURE_SIDE

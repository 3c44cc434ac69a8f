"""The shading pass: from a visibility buffer to a picture; the arithmetic is docs/numerics.md section 16."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch

from .. import torch_private
from ..precision import Arithmetic
from ..reference import shade as reference
from ..reference.shade import Surface
from . import arguments, memory
from .shading import THRESHOLDS


class Made(NamedTuple):
    """What a picture is made from, float32 [B, samples * H, samples * W, 3]; written where not None."""

    albedo: torch.Tensor | None = None  # linear, 0 on the background
    normals: torch.Tensor | None = None  # as they are lit, of any length, 0 on the background
    linear: torch.Tensor | None = None  # lit, with the background


def shade(
    packed: torch.Tensor,
    positions: torch.Tensor,
    triangles: torch.Tensor,
    surface: Surface[torch.Tensor],
    image: torch.Tensor,
    made: Made,
    arithmetic: Arithmetic,
    backend: str,
) -> None:
    """Write the picture of a visibility buffer.

    Args:
        packed: int64 [B, samples * H, samples * W], drawn from these triangles.
        positions: float32 [B, V, 4].
        triangles: int32 [T, 3].
        surface: what they look like, on their device.
        image: uint8 [B, H, W, 3] in sRGB; or [B, H, W, 4] with alpha, the background transparent.
        made: what else to write.
        arithmetic: the rung that the buffer was drawn with.
        backend: "reference" or "native"; the bits are the same.
    """
    if backend == "native":
        arguments.check_compiled("shade", arithmetic, packed.device.type)
        thresholds = torch_private.beside(THRESHOLDS, packed)
        torch.ops.bigtri.shade.default(
            packed, positions, triangles, *surface, thresholds, arithmetic.name, image, made.albedo, made.normals, made.linear
        )
        return
    plain: Surface[Any] = Surface(*(_numpy(field) for field in surface))
    samples, transparent = packed.shape[1] // max(image.shape[1], 1), image.shape[3] == 4
    faces = triangles.cpu().numpy()
    for b in range(len(packed)):
        view, clip = packed[b].cpu().numpy(), positions[b].cpu().numpy()
        shaded = reference.shade(view, clip, faces, plain, samples, transparent, arithmetic)
        image[b].copy_(torch.from_numpy(shaded.image))
        for output, value in zip(made, shaded[1:], strict=True):
            if output is not None:
                output[b].copy_(torch.from_numpy(value))


def new_made(packed: torch.Tensor) -> Made:
    """Memory for all that a picture is made from."""
    return Made(*(memory.new(packed, (*packed.shape, 3), torch.float32) for _ in Made._fields))


def _numpy(value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(map(_numpy, value))
    return value.cpu().numpy() if isinstance(value, torch.Tensor) else value

"""Pictures: of a visibility buffer, or straight from triangles; the arithmetic is docs/numerics.md section 18."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch

from .. import torch_private
from ..precision import Arithmetic
from ..reference import shade as reference
from ..reference.shade import Surface
from . import arguments, memory
from .arguments import Array
from .rasterize import rasterize
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


def draw(
    positions: torch.Tensor,
    triangles: torch.Tensor,
    cull: str,
    surface: Surface[torch.Tensor],
    image: torch.Tensor,
    samples: int,
    made: Made,
    seen: tuple[torch.Tensor, torch.Tensor] | None,
    arithmetic: Arithmetic,
    backend: str,
    *,
    fills: bool = False,
) -> torch.Tensor:
    """Write the picture of triangles; where nobody asks for the visibility buffer, it may not exist.

    Args:
        positions: float32 [B, V, 4], clip space.
        triangles: int32 [T, 3].
        cull: "none", "back" or "front".
        surface: what they look like, on their device.
        image: uint8 [B, H, W, 3] in sRGB; or [B, H, W, 4] with alpha, the background transparent.
        samples: of a pixel along each axis.
        made: what else to write.
        seen: packed int64 and depth float32 [B, samples * H, samples * W] to write, or None.
        arithmetic: the rung to draw with.
        backend: "reference" or "native"; the bits are the same.
        fills: whether triangles probably touch most of the picture. On CUDA all of a large picture is then looked at, not only
            where triangles may be; the bits are the same.

    Returns:
        int64 [B]: triangles dropped.
    """
    height, width = (samples * size for size in image.shape[1:3])
    packed, depth = seen if seen is not None else (None, None)
    if backend == "native":
        arguments.check_compiled("render", arithmetic, positions.device.type)
        dropped = positions.new_empty(len(positions), dtype=torch.int64)
        thresholds = torch_private.beside(THRESHOLDS, positions)
        torch.ops.bigtri.draw.default(
            *(positions, triangles, height, width, cull, *surface, thresholds, arithmetic.name, []),
            *(image, made.albedo, made.normals, made.linear, packed, depth, dropped, fills),
        )
        return dropped
    drawn = rasterize(
        positions,
        triangles,
        (height, width),
        backend=backend,
        precision=arithmetic.precision,
        cull=cull,
        depth=depth is not None,
        out=packed,
        depth_out=depth,
    )
    shade(_tensor(drawn.packed), positions, triangles, surface, image, made, arithmetic, backend)
    return _tensor(drawn.dropped)


def new_made(like: torch.Tensor, shape: tuple[int, int, int]) -> Made:
    """Memory for all that pictures of [B, H, W] samples are made from, on the device of ``like``."""
    return Made(*(memory.new(like, (*shape, 3), torch.float32) for _ in Made._fields))


def _tensor(value: Array) -> torch.Tensor:
    """What ``rasterize`` returns for tensors, said to the type checker."""
    assert isinstance(value, torch.Tensor)
    return value


def _numpy(value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(map(_numpy, value))
    return value.cpu().numpy() if isinstance(value, torch.Tensor) else value

"""Texture lookups; docs/numerics.md section 10. Everything is float32 and each operation is rounded once."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .float_mode import default_float_mode
from .shading import decode_srgb


@default_float_mode
def sample_texture(
    texture: NDArray[Any], uv: NDArray[np.float32], filter: str = "bilinear", wrap: str = "repeat"
) -> NDArray[np.float32]:
    """Look ``uv`` up in ``texture``.

    Args:
        texture: float32 [Ht, Wt, C], row 0 on top; uint8 or uint16 of sRGB codes, which are decoded first.
        uv: float32 [..., 2]; (0, 0) is the lower left corner of the image, (1, 1) the upper right one.
        filter: "bilinear" or "nearest".
        wrap: what lies beyond [0, 1]: "repeat" or "clamp" (the border goes on for ever).

    Returns:
        float32 [..., C]. A uv pair with a NaN or an infinity reads as (0, 0).
    """
    if texture.dtype != np.float32:
        texture = decode_srgb(texture)
    height, width, channels = texture.shape
    flat = uv.reshape(-1, 2)
    flat = np.where(np.isfinite(flat).all(axis=1, keepdims=True), flat, np.float32(0))
    u, v = _wrap_coordinate(flat[:, 0], wrap), _wrap_coordinate(flat[:, 1], wrap)
    x, y = u * np.float32(width), (np.float32(1) - v) * np.float32(height)
    if filter == "nearest":
        column = np.minimum(np.floor(x).astype(np.int64), width - 1)
        row = np.minimum(np.floor(y).astype(np.int64), height - 1)
        result = texture[row, column]
    else:
        result = _bilinear(texture, x - np.float32(0.5), y - np.float32(0.5), wrap)
    return result.reshape(*uv.shape[:-1], channels)


def _bilinear(texture: NDArray[np.float32], x: NDArray[np.float32], y: NDArray[np.float32], wrap: str) -> NDArray[np.float32]:
    """float32 [N, C] at texel coordinates x, y float32 [N], where texel 0's centre is at 0."""
    height, width, _ = texture.shape
    floor_x, floor_y = np.floor(x), np.floor(y)
    tx, ty = (x - floor_x)[:, None], (y - floor_y)[:, None]
    left, upper = floor_x.astype(np.int64), floor_y.astype(np.int64)
    x0, x1 = _wrap_texel(left, width, wrap), _wrap_texel(left + 1, width, wrap)
    y0, y1 = _wrap_texel(upper, height, wrap), _wrap_texel(upper + 1, height, wrap)
    c00, c10, c01, c11 = texture[y0, x0], texture[y0, x1], texture[y1, x0], texture[y1, x1]
    top = c00 + (c10 - c00) * tx
    bottom = c01 + (c11 - c01) * tx
    return top + (bottom - top) * ty


def _wrap_coordinate(u: NDArray[np.float32], wrap: str) -> NDArray[np.float32]:
    """Into [0, 1]. Repeating can give 1 itself, for a tiny negative u; what follows copes with it."""
    if wrap == "repeat":
        return u - np.floor(u)
    return np.minimum(np.maximum(u, np.float32(0)), np.float32(1))


def _wrap_texel(index: NDArray[np.int64], size: int, wrap: str) -> NDArray[np.int64]:
    return index % size if wrap == "repeat" else np.clip(index, 0, size - 1)

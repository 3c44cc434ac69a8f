"""The shading pass: from a visibility buffer to a picture; docs/numerics.md section 18."""

from __future__ import annotations

from enum import IntFlag
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..precision import EXACT, Arithmetic
from .attributes import interpolate
from .float_mode import default_float_mode
from .shading import encode_srgb, lambert
from .texture import sample_texture

ArrayT = TypeVar("ArrayT")


class Look(IntFlag):
    """What a material asks for, where the surface has the data."""

    VERTEX_COLORS = 1
    SMOOTH = 2  # normals are interpolated from the vertices
    TWO_SIDED = 4  # normals of back faces are turned round
    NEAREST = 8  # of a texture the nearest texel, else bilinear
    CLAMP = 16  # a texture's border goes on for ever, else it repeats


class Surface(NamedTuple, Generic[ArrayT]):
    """What is shaded, beside its shape. An effect whose array is None is left out. Arrays are NumPy here, tensors in ``ops``."""

    uvs: ArrayT | None  # float32 [V, 2]
    colors: ArrayT | None  # float32 [V, 3], linear
    normals: ArrayT | None  # float32 [V, 3]
    face_normals: ArrayT | None  # float32 [T, 3]; without them everything is smooth
    material: ArrayT  # int32 [T], indices into looks and base_colors
    looks: ArrayT  # int32 [M, 2]: bits of Look; the texture, or -1
    base_colors: ArrayT  # float32 [M, 3], linear
    textures: tuple[ArrayT, ...]  # float32, uint8 or uint16 [Ht, Wt, 3], row 0 on top
    light_directions: ArrayT  # float32 [L, 3], towards the light
    light_colors: ArrayT  # float32 [L, 3], linear
    constants: ArrayT  # float32 [3, 3], linear: the ambient light; the background at the top; at the bottom
    two_sided: bool  # False: no normal is turned round


class Shaded(NamedTuple):
    """A picture and what it was made from."""

    image: NDArray[np.uint8]  # [H, W, 3 or 4], sRGB
    albedo: NDArray[np.float32]  # [samples * H, samples * W, 3], linear, 0 on the background
    normals: NDArray[np.float32]  # the same, as they were lit, of any length
    linear: NDArray[np.float32]  # the same, lit, with the background


@default_float_mode
def shade(
    packed: NDArray[np.int64],
    positions: NDArray[np.float32],
    triangles: NDArray[np.int32],
    surface: Surface[NDArray[Any]],
    samples: int = 1,
    transparent: bool = False,
    arithmetic: Arithmetic = EXACT,
) -> Shaded:
    """Finish every pixel: albedo, normal, light, background, mean of the samples, sRGB.

    Args:
        packed: int64 [samples * H, samples * W], as ``visibility`` leaves it.
        positions: float32 [V, 4], the clip-space positions that it was drawn from.
        triangles: int32 [T, 3].
        surface: what they look like.
        samples: of a pixel along each axis.
        transparent: the picture has alpha, 0 on the background, whose colour is black.
        arithmetic: the rung of the precision ladder that it was drawn with.
    """
    covered = (packed & 0xFFFFFFFF) < len(triangles)
    triangle = packed[covered] & 0xFFFFFFFF
    material = surface.material[triangle]
    bits = surface.looks[material, 0]

    def at_pixels(attribute: NDArray[np.float32]) -> NDArray[np.float32]:
        return interpolate(packed, positions, triangles, attribute, arithmetic)[covered]

    albedo = surface.base_colors[material]
    if surface.uvs is not None:
        uvs = at_pixels(surface.uvs)
        for index in np.unique(material):
            number = surface.looks[index, 1]
            if number >= 0:
                some = material == index
                albedo[some] = albedo[some] * _look_up(surface.textures[number], uvs[some], surface.looks[index, 0])
    if surface.colors is not None:
        albedo = np.where(_has(bits, Look.VERTEX_COLORS), albedo * at_pixels(surface.colors), albedo)
    normals = _normals(surface, triangle, bits, at_pixels)
    if surface.two_sided:
        turned = _has(bits, Look.TWO_SIDED) & is_back(positions, triangles[triangle])[:, None]
        normals = np.where(turned, -normals, normals)
    ambient, top, bottom = surface.constants
    lit = lambert(normals, albedo, ambient, surface.light_directions, surface.light_colors)

    linear = np.zeros((*packed.shape, 3), np.float32)
    if not transparent:
        linear[:] = background(top, bottom, len(packed))[:, None]
    linear[covered] = lit
    image = _image(linear, covered, samples, transparent)
    return Shaded(image, _spread(covered, albedo), _spread(covered, normals), linear)


def background(top: NDArray[np.float32], bottom: NDArray[np.float32], height: int) -> NDArray[np.float32]:
    """float32 [height, 3]: the background of every row."""
    down = (np.arange(height, dtype=np.float32) + np.float32(0.5)) / np.float32(height)
    return top + (bottom - top) * down[:, None]


def is_back(positions: NDArray[np.float32], triangles: NDArray[np.int32]) -> NDArray[np.bool_]:
    """bool [T], whether triangles [T, 3] show their backs: the sign of det(x, y, w) of the corners.

    Clipping does not change it, and no w needs to be positive.
    """
    x, y, w = (positions[:, i].astype(np.float64)[triangles].T for i in (0, 1, 3))
    with np.errstate(over="ignore", invalid="ignore"):
        determinant = (x[0] * (y[1] * w[2] - y[2] * w[1]) - y[0] * (x[1] * w[2] - x[2] * w[1])) + w[0] * (
            x[1] * y[2] - x[2] * y[1]
        )
        return determinant < 0


def _has(bits: NDArray[np.int32], bit: Look) -> NDArray[np.bool_]:
    return ((bits & int(bit)) != 0)[:, None]


def _look_up(texture: NDArray[Any], uvs: NDArray[np.float32], bits: int) -> NDArray[np.float32]:
    filter_, wrap = "nearest" if bits & Look.NEAREST else "bilinear", "clamp" if bits & Look.CLAMP else "repeat"
    return sample_texture(texture, uvs, filter_, wrap)


def _normals(
    surface: Surface[NDArray[Any]], triangle: NDArray[np.int64], bits: NDArray[np.int32], at_pixels: Any
) -> NDArray[np.float32]:
    """float32 [P, 3], before back faces are turned round."""
    if surface.normals is None:
        flat = surface.face_normals
        return np.zeros((len(triangle), 3), np.float32) if flat is None else flat[triangle]
    smooth: NDArray[np.float32] = at_pixels(surface.normals)
    if surface.face_normals is None:
        return smooth
    return np.where(_has(bits, Look.SMOOTH), smooth, surface.face_normals[triangle])


def _image(linear: NDArray[np.float32], covered: NDArray[np.bool_], samples: int, transparent: bool) -> NDArray[np.uint8]:
    """In sRGB, the mean of every samples x samples square, added up row by row; if transparent, of what is covered."""
    total = np.zeros_like(linear[::samples, ::samples])
    count = np.zeros(total.shape[:2], np.int64)
    with np.errstate(over="ignore", invalid="ignore"):  # beyond float32 are infinities, as of lambert
        for row in range(samples):
            for column in range(samples):
                total = total + linear[row::samples, column::samples]
                count += covered[row::samples, column::samples]
    every = samples * samples
    if not transparent:
        return encode_srgb(total / np.float32(every))
    image = np.empty((*count.shape, 4), np.uint8)
    image[..., :3] = encode_srgb(total / np.maximum(count, 1).astype(np.float32)[..., None])
    image[..., 3] = (2 * 255 * count + every) // (2 * every)
    return image


def _spread(covered: NDArray[np.bool_], values: NDArray[np.float32]) -> NDArray[np.float32]:
    """float32 [H, W, 3]: ``values`` [P, 3] where something is covered, else 0."""
    result = np.zeros((*covered.shape, 3), np.float32)
    result[covered] = values
    return result

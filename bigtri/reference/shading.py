"""Lambert shading and sRGB; docs/numerics.md section 11."""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal, localcontext
from fractions import Fraction
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from .float_mode import default_float_mode


@default_float_mode
def lambert(
    normals: NDArray[np.float32],
    albedo: NDArray[np.float32],
    ambient: NDArray[np.float32],
    light_directions: NDArray[np.float32],
    light_colors: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Diffuse light: ``albedo * (ambient + sum of color * max(n . l, 0))``.

    Args:
        normals: float32 [..., 3], of any length.
        albedo: float32 [..., 3], linear.
        ambient: float32 [3], linear.
        light_directions: float32 [L, 3], towards the light, used as given: of unit length, unless a length is to scale the light.
        light_colors: float32 [L, 3], linear.

    Returns:
        float32 [..., 3], linear.
    """
    x, y, z = _normalized(normals)
    color = np.broadcast_to(ambient, albedo.shape)
    zero = np.float32(0)
    # A product beyond float32 is an infinity by IEEE rules, and inf - inf a NaN: results, not accidents worth a warning.
    with np.errstate(over="ignore", invalid="ignore"):
        for direction, light in zip(light_directions, light_colors, strict=True):
            facing = (x * direction[0] + y * direction[1]) + z * direction[2]
            color = color + light * np.where(facing > zero, facing, zero)[..., None]
        return albedo * color


@default_float_mode
def encode_srgb(linear: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Linear light to 8-bit sRGB, rounded to the nearest code.

    Args:
        linear: float32, any shape. Values outside [0, 1] saturate, NaN gives 0.

    Returns:
        uint8, the same shape.
    """
    codes = np.searchsorted(encode_thresholds(), linear, side="right").astype(np.uint8)
    return np.where(np.isnan(linear), np.uint8(0), codes)


@default_float_mode
def decode_srgb(encoded: NDArray[np.uint8] | NDArray[np.uint16]) -> NDArray[np.float32]:
    """sRGB of 8 or 16 bits (any shape) to linear light (float32, the same shape, in [0, 1])."""
    return decode_table(8 * encoded.itemsize)[encoded]


@lru_cache(maxsize=2)
@default_float_mode
def decode_table(bits: int = 8) -> NDArray[np.float32]:
    """float32 [2**bits], read-only: the linear value of every code of 8 or 16 bits, correctly rounded."""
    return _rounded_table(256, lambda code: Fraction(code, 255)) if bits == 8 else _wide_decode_table()


@lru_cache(maxsize=1)
@default_float_mode
def encode_thresholds() -> NDArray[np.float32]:
    """float32 [255], read-only, rising: the linear values half-way (in code space) between code k and k + 1."""
    return _rounded_table(255, lambda code: Fraction(2 * code + 1, 510))


def _normalized(normals: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    x, y, z = normals[..., 0], normals[..., 1], normals[..., 2]
    with np.errstate(over="ignore", invalid="ignore", divide="ignore", under="ignore"):
        squared = (x * x + y * y) + z * z
        length = np.sqrt(squared)
        usable = np.isfinite(squared) & (squared != 0)
        zero = np.float32(0)
        return np.where(usable, x / length, zero), np.where(usable, y / length, zero), np.where(usable, z / length, zero)


def _wide_decode_table(doubt: float = 2.0**-45) -> NDArray[np.float32]:
    """The linear values of 16-bit codes, in less than the seconds that it takes to work all of them out exactly.

    float64 has each of them with a relative error below ``doubt``. Where that leaves two floats to choose from, the exact value
    decides.
    """
    encoded = np.arange(65536) / 65535
    near = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    table, other = ((near * factor).astype(np.float32) for factor in (1 - doubt, 1 + doubt))
    for code in np.flatnonzero(table != other).tolist():
        table[code] = _round_to_float32(_decode_exactly(Fraction(code, 65535)))
    table.setflags(write=False)
    return table


def _rounded_table(size: int, encoded: Callable[[int], Fraction]) -> NDArray[np.float32]:
    table = np.array([_round_to_float32(_decode_exactly(encoded(code))) for code in range(size)], np.float32)
    table.setflags(write=False)
    return table


def _decode_exactly(encoded: Fraction) -> Fraction:
    """The sRGB transfer function, to 50 digits: far more than it takes to round any of these values to float32."""
    if encoded <= Fraction("0.04045"):
        return encoded / Fraction("12.92")
    base = (encoded + Fraction("0.055")) / Fraction("1.055")
    with localcontext() as context:
        context.prec = 50
        return Fraction((Decimal(base.numerator) / Decimal(base.denominator)) ** Decimal("2.4"))


def _round_to_float32(value: Fraction) -> np.float32:
    """The nearest float32. Going through float64 rounds twice, so the two neighbours are compared with the exact value."""
    guess = np.float32(float(value))
    around = (np.nextafter(guess, np.float32(-1)), guess, np.nextafter(guess, np.float32(2)))
    return min(around, key=lambda candidate: abs(Fraction(float(candidate)) - value))

"""Colours as formats without a colour space of their own store them: sRGB."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...reference.shading import decode_srgb
from .model import Model, ModelError


def linear_colors(model: Model, values: NDArray[Any], kind: str) -> NDArray[np.float32]:
    """Linear light, float32 of the shape of ``values``.

    Args:
        model: gets a finding where values are cut.
        values: numbers of any type.
        kind: what the file declares them to be, as NumPy names types: floating point from 0 to 1, which is rounded to 16 bits;
            "u2" for 16 bits; else 8 bits.

    Raises:
        ModelError: integers that are beyond their bits, or are none.
    """
    if kind.startswith("f"):
        return decode_srgb(np.rint(within_0_to_1(model, values) * np.float64(65535)).astype(np.uint16))
    bits = 16 if kind == "u2" else 8
    if values.size and not (values.min() >= 0 and values.max() < 1 << bits):
        got = f"{values.min():.0f} to {values.max():.0f}"
        raise ModelError(f"colours of {bits} bits must be from 0 to {(1 << bits) - 1}, got {got}")
    codes = values.astype(f"u{bits // 8}")
    if values.dtype.kind == "f" and not np.array_equal(codes, values):
        raise ModelError(f"colours of {bits} bits must be whole numbers, got {values[codes != values][0]}")
    return decode_srgb(codes)


def within_0_to_1(model: Model, values: NDArray[Any]) -> NDArray[Any]:
    """Floating-point values, as they are; those that are not from 0 to 1 are cut, and noted. NaN is 0."""
    if ((values >= 0) & (values <= 1)).all():
        return values
    model.found("colors beyond 0 to 1", "there are colours that are not from 0 to 1: they are drawn as the nearest that is")
    return np.clip(np.nan_to_num(values), 0, 1)

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
        ModelError: integers that are beyond their bits.
    """
    if kind.startswith("f"):
        if not ((values >= 0) & (values <= 1)).all():  # NaN, too
            model.found(
                "colors beyond 0 to 1", "there are colours that are not from 0 to 1: they are drawn as the nearest that is"
            )
        return decode_srgb(np.rint(np.clip(np.nan_to_num(values), 0, 1) * np.float64(65535)).astype(np.uint16))
    bits = 16 if kind == "u2" else 8
    if values.size and not (values.min() >= 0 and values.max() < 1 << bits):
        got = f"{values.min():.0f} to {values.max():.0f}"
        raise ModelError(f"colours of {bits} bits must be from 0 to {(1 << bits) - 1}, got {got}")
    return decode_srgb(values.astype(f"u{bits // 8}"))

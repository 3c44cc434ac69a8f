"""How far a rung is from the truth (``truth.py``): in pixels, in units in the last place, in texels, in decibels."""

from __future__ import annotations

from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from .. import reference
from ..ops.rasterize import rasterize
from ..precision import DEFAULT, EXACT, Arithmetic, Precision
from ..reference.numerics import TILE
from .truth import BACKGROUND, Seen


class Coverage(NamedTuple):
    """Pixels along the edges that triangles share."""

    gaps: int  # that a triangle should show at, and none does
    overlaps: int  # at which more triangles show than should


def wrong_pixels(triangle: NDArray[np.int32], truth: Seen) -> int:
    """How many pixels of ``triangle`` int32 [H, W] show another triangle than they should, or one of either alone."""
    return int(np.count_nonzero(triangle != truth.triangle))


def coverage(
    positions: NDArray[np.float32],
    triangles: NDArray[np.int32],
    truth: Seen,
    precision: str | Precision = DEFAULT,
    backend: str = "auto",
) -> Coverage:
    """Gaps and overlaps of triangles drawn one by one, each of which shows its pixels whatever lies before it."""
    height, width = truth.times.shape
    times = np.zeros((height, width), np.int64)
    for one in triangles:
        drawn = rasterize(positions, one[None], (height, width), precision=precision, backend=backend)
        times += np.asarray(drawn.triangle) == 0
    return Coverage(int(np.count_nonzero((times == 0) & (truth.times > 0))), int(np.count_nonzero(times > truth.times)))


def depth_ulp(depth: NDArray[np.float32], triangle: NDArray[np.int32], truth: Seen) -> NDArray[np.float64]:
    """float64 [P]: by how many units in the last place of the true depth the depth is off, of pixels that show what they should.

    A correctly rounded one is off by half a unit at most. The unit at 0 is that of the smallest normal number.
    """
    same = (triangle == truth.triangle) & (triangle != BACKGROUND)
    units = [
        float(abs(Fraction(float(value)) - exact) / _ulp(exact))
        for value, exact in zip(depth[same].tolist(), truth.depth[same], strict=True)
    ]
    return np.array(units, np.float64)


def _ulp(value: Fraction) -> Fraction:
    """The distance of the float32 numbers around ``value`` >= 0."""
    unit = Fraction(1, 2**149)
    tiny = Fraction(1, 2**126)
    if value < 2 * tiny:
        return unit
    # The exponent of the power of two at or below the value, from the lengths of its terms; it may be one too high.
    exponent = value.numerator.bit_length() - value.denominator.bit_length()
    power = Fraction(2) ** exponent
    return (power if power <= value else power / 2) / 2**23


def flips(triangle: NDArray[np.int32], truth: Seen) -> int:
    """How many pixels show a triangle, but another one than the nearest: z-fighting, where ``truth`` is that of ``planes``."""
    return int(np.count_nonzero((triangle != truth.triangle) & (triangle != BACKGROUND) & (truth.triangle != BACKGROUND)))


def attribute_error(
    values: NDArray[np.float32],
    triangle: NDArray[np.int32],
    attributes: NDArray[np.float32],
    triangles: NDArray[np.int32],
    truth: Seen,
    scale: float = 1.0,
) -> NDArray[np.float64]:
    """float64 [P]: the largest error of a channel at each pixel that shows what it should, times ``scale``.

    Args:
        values: float32 [H, W, C], interpolated.
        triangle: int32 [H, W], what the pixels show.
        attributes: float32 [V, C], finite.
        triangles: int32 [T, 3].
        truth: of ``seen``, whose weights are exact.
        scale: the size of the texture, for errors of uv in texels.
    """
    same = (triangle == truth.triangle) & (triangle != BACKGROUND)
    errors = []
    for value, index, weights in zip(values[same].tolist(), triangle[same], truth.weights[same], strict=True):
        corners = attributes[triangles[index]].tolist()
        exact = [
            sum((b * Fraction(a) for b, a in zip(weights, channel, strict=True)), Fraction(0))
            for channel in zip(*corners, strict=True)
        ]
        errors.append(max(float(abs(Fraction(v) - e)) for v, e in zip(value, exact, strict=True)))
    return scale * np.array(errors, np.float64)


class Likeness(NamedTuple):
    """Of a picture and its truth."""

    psnr: float  # dB; infinity for equal ones
    ssim: float  # 1 for equal ones


def likeness(image: NDArray[np.uint8], truth: NDArray[np.uint8]) -> Likeness:
    """Of sRGB pictures uint8 [H, W, 3] of at least 7x7 px."""
    difference: Any = image.astype(np.int64) - truth
    psnr = float("inf") if not difference.any() else float(peak_signal_noise_ratio(truth, image, data_range=255))
    return Likeness(psnr, float(structural_similarity(truth, image, channel_axis=2, data_range=255)))


class Masks(NamedTuple):
    """Tiles of 8x8 px that a rung's masks name."""

    touched: int
    empty: int  # of these: without a pixel that is covered, which is what a better mask would spare
    full: int  # known to be covered completely, so that no pixel is tested


def masks(
    positions: NDArray[np.float32], triangles: NDArray[np.int32], height: int, width: int, arithmetic: Arithmetic = EXACT
) -> Masks:
    """The tiles of all triangles, drawn through bins whatever their size."""
    records, _ = reference.setup(positions, triangles, height, width, arithmetic=arithmetic)
    bins = reference.binning(records, 0, arithmetic)
    queue = bins.candidates[bins.kept]
    touched, full = reference.tile_mask(records, queue, arithmetic)
    spans = reference.scanline(records, queue, touched, bins.small[:0], arithmetic)
    tiles = np.unique(np.stack([spans[:, 0], spans[:, 1] // TILE, spans[:, 2] // TILE], axis=1), axis=0)
    count = [sum(int(mask).bit_count() for mask in of_all.view(np.uint64)) for of_all in (touched, full)]
    return Masks(touched=count[0], empty=count[0] - len(tiles), full=count[1])

"""How far a rung is from the truth (``truth.py``): in pixels, in units in the last place, in texels, in decibels."""

from __future__ import annotations

from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from .. import native, reference
from ..check import stages
from ..ops import arguments
from ..ops.rasterize import rasterize
from ..precision import DEFAULT, EXACT, Arithmetic, Precision
from ..reference.numerics import TILE
from .truth import BACKGROUND, Rows, Seen


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


# --- of rows of large scenes


class Shown(NamedTuple):
    """Pixels of the rows that ``truth.in_rows`` has, and how many of them a rung draws wrong."""

    pixels: int
    wrong: int  # show another triangle than they should, or one of either alone
    flips: int  # of these: show a triangle that is there, but not the nearest one


def in_rows(triangle: NDArray[np.int32], count: int, truth: Rows) -> Shown:
    """What is wrong with ``triangle`` int32 [H, W], drawn of so many triangles."""
    shown = triangle[truth.rows]
    wrong = shown != truth.triangle
    drawn = shown[wrong]
    keys = (np.flatnonzero(wrong) * count + drawn)[drawn != BACKGROUND]
    return Shown(shown.size, int(wrong.sum()), int(np.isin(keys, truth.pairs, assume_unique=True).sum()))


class Seams(NamedTuple):
    """Pixels of rows, along edges that two triangles share."""

    cracks: int  # neither is drawn
    overlaps: int  # both are


def seams(
    positions: NDArray[np.float32],
    triangles: NDArray[np.int32],
    resolution: tuple[int, int],
    truth: Rows,
    neighbours: Neighbours,
    precision: str | Precision = DEFAULT,
) -> Seams:
    """Of all triangles, hidden ones too, if none reaches beyond the far plane.

    They are counted where the nearest edge has a triangle on either side, both facing the same way, and an outline is more than
    1/8 px away: there each pixel must be drawn as often as it should, wherever the rung puts the edge.
    """
    height, width = resolution
    drawn = _drawn_pairs(positions, triangles, resolution, truth.rows, precision)
    apart = np.setxor1d(truth.pairs, drawn, assume_unique=True)
    place, index = np.divmod(apart, max(1, len(triangles)))
    row, column = np.divmod(place, width)
    between = np.unique(place[neighbours.between(index, column, truth.rows[row], height, width)])
    times = np.bincount(drawn // max(1, len(triangles)), minlength=truth.times.size)
    more = times[between] - truth.times.reshape(-1)[between]
    return Seams(int((more < 0).sum()), int((more > 0).sum()))


def _drawn_pairs(
    positions: NDArray[np.float32],
    triangles: NDArray[np.int32],
    resolution: tuple[int, int],
    rows: NDArray[np.int64],
    precision: str | Precision,
) -> NDArray[np.int64]:
    """int64, in order: the pairs of a rung as ``truth.Rows`` has them, every triangle drawn by itself."""
    arithmetic = arguments.check_precision("study.errors", precision)
    # The extension has no stages of some rungs, nor of a precision that has no name.
    native_too = native.available() and arithmetic.has_stages and arithmetic.name in native.REGISTRY["cpu"]
    backend = "native" if native_too else "reference"
    records, _ = stages.setup(positions, triangles, *resolution, backend=backend, precision=precision)
    every = np.arange(len(records.triangle), dtype=np.int32)
    no_queue, no_tiles = np.empty((0, 3), np.int32), np.empty(0, np.int64)
    spans = stages.scanline(records, no_queue, no_tiles, every, backend=backend, precision=precision).astype(np.int64)
    place = np.full(resolution[0], -1)
    place[rows] = np.arange(len(rows))
    spans = spans[place[spans[:, 1]] >= 0]
    length = spans[:, 3] - spans[:, 2]
    within = np.arange(int(length.sum())) - np.repeat(np.cumsum(length) - length, length)
    pixel = np.repeat(place[spans[:, 1]] * resolution[1] + spans[:, 2], length) + within
    # Records of one triangle may overlap where clipping is not exact: these pixels count once, as one triangle's.
    key = np.sort(pixel * len(triangles) + np.repeat(records.triangle[spans[:, 0]], length))
    return key[np.diff(key, prepend=-1) > 0]


class Neighbours:
    """Which edges of a mesh two triangles share that face the same way; vertices in the same place are one."""

    def __init__(self, positions: NDArray[np.float32], triangles: NDArray[np.int32]) -> None:
        _, vertex = np.unique(positions, axis=0, return_inverse=True)
        corners = vertex.reshape(-1)[triangles].astype(np.int64)  # [T, 3]
        clip = positions[triangles].astype(np.float64)
        view = clip[..., [0, 1, 3]]
        # Of each edge, opposite corner k, the factors of X, Y and 1 of the function that is 0 along it.
        self._normal = np.cross(np.roll(view, -1, axis=1), np.roll(view, -2, axis=1))
        with np.errstate(all="ignore"):
            self._corner = np.where(clip[..., 3:] > 0, clip[..., :2] / clip[..., 3:], np.inf)  # [T, 3, 2]
        facing = (self._normal[:, 0] * view[:, 0]).sum(axis=1) > 0
        a, b = np.roll(corners, -1, axis=1).reshape(-1), np.roll(corners, -2, axis=1).reshape(-1)
        edge = np.minimum(a, b) * (int(corners.max(initial=0)) + 1) + np.maximum(a, b)
        order = np.argsort(edge, kind="stable")
        _, first, count = np.unique(edge[order], return_index=True, return_counts=True)
        two = first[count == 2]
        one, other = order[two], order[two + 1]
        # Seen from the two sides, the edge runs in opposite directions if they face the same way; folds do not count.
        joined = (facing[one // 3] == facing[other // 3]) & (a[one] == b[other])
        shared = np.zeros(edge.size, np.bool_)
        shared[one[joined]] = shared[other[joined]] = True
        self._shared = shared.reshape(-1, 3)
        outline = np.zeros(int(corners.max(initial=0)) + 1, np.bool_)
        outline[a[~shared]] = outline[b[~shared]] = True
        self._outline = outline[corners]  # [T, 3], whether a corner lies on an edge that is not shared

    def between(
        self, index: NDArray[np.int64], column: NDArray[np.int64], row: NDArray[np.int64], height: int, width: int
    ) -> NDArray[np.bool_]:
        """Whether the nearest edge of triangles ``index`` is a shared one, and an outline more than 1/8 px from the pixel."""
        x, y = (2 * column + 1) / width - 1, 1 - (2 * row + 1) / height
        n = self._normal[index]
        with np.errstate(all="ignore"):
            away = np.abs(n[..., 0] * x[:, None] + n[..., 1] * y[:, None] + n[..., 2])
            away = away / np.hypot(n[..., 0] * 2 / width, n[..., 1] * 2 / height)  # px
            corner = self._corner[index]
            off = np.hypot((corner[..., 0] - x[:, None]) * width / 2, (corner[..., 1] - y[:, None]) * height / 2)
        shared = self._shared[index]
        nearest = shared[np.arange(len(index)), np.argmin(away, axis=1)]
        clear = np.where(shared, np.inf, away).min(axis=1, initial=np.inf) > 0.125
        return nearest & clear & (np.where(self._outline[index], off, np.inf).min(axis=1, initial=np.inf) > 0.125)

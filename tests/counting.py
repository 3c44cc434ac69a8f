"""What the tests of hard scenes share: how many fragments land on each pixel, and how large a run is."""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import NDArray

from bigtri.check import stages
from bigtri.reference.records import Records

SCALE = float(os.environ.get("BIGTRI_TEST_SCALE", "1"))  # multiplies the number of random triangles; 20 makes it millions

Resolution = tuple[int, int]  # height, width


def scaled(count: int) -> int:
    """``count``, by BIGTRI_TEST_SCALE more."""
    return max(1, round(count * SCALE))


def soup(corners: NDArray[np.floating]) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Positions and indices of unconnected triangles, from clip-space corners [T, 3, 4]."""
    positions = np.ascontiguousarray(corners, np.float32).reshape(-1, 4)
    return positions, np.arange(len(positions), dtype=np.int32).reshape(-1, 3)


def on_grid(xy: NDArray[np.integer], z: NDArray[np.floating], resolution: Resolution) -> NDArray[np.float64]:
    """Clip-space corners [T, 3, 4], w = 1, of the snapped vertices ``xy`` [T, 3, 2], subpx, and window depths ``z`` [T, 3].

    Exact in float32 where height and width are powers of two and |xy| stays below 2^23.
    """
    height, width = resolution
    half = np.array([128 * width, 128 * height])
    ndc = (xy - half) / half * [1, -1]
    return np.concatenate([ndc, 2 * z[..., None] - 1, np.ones_like(z)[..., None]], axis=-1)


def spans_of(records: Records, threshold: int = 4000) -> NDArray[np.int32]:
    """int32 [S, 4], (record, y, lower, upper): binning, tile masks and scanline one after the other."""
    bins = stages.binning(records, threshold)
    queue = bins.candidates[bins.kept]
    touched, _ = stages.tile_mask(records, queue)
    return stages.scanline(records, queue, touched, bins.small)


def fragments(positions: NDArray[np.float32], triangles: NDArray[np.int32], resolution: Resolution, cull: str = "none"):
    """int64 [H, W]: how many (sub)triangles cover each pixel."""
    records, _ = stages.setup(positions, triangles, *resolution, cull)
    spans = spans_of(records)
    return count_spans(np.zeros(len(spans), np.int64), spans, 1, resolution)[0]


def fragments_by_triangle(positions: NDArray[np.float32], triangles: NDArray[np.int32], resolution: Resolution):
    """int64 [T, H, W]: how many (sub)triangles of each triangle cover each pixel."""
    records, _ = stages.setup(positions, triangles, *resolution)
    spans = spans_of(records)
    return count_spans(records.triangle[spans[:, 0]], spans, len(triangles), resolution)


def count_spans(image: NDArray[np.integer], spans: NDArray[np.int32], images: int, resolution: Resolution) -> NDArray[np.int64]:
    """int64 [images, H, W]: how many ``spans`` cover each pixel of the image whose number is ``image`` [S]."""
    height, width = resolution
    row = (image.astype(np.int64) * height + spans[:, 1]) * (width + 1)
    size = images * height * (width + 1)
    steps = np.bincount(row + spans[:, 2], minlength=size) - np.bincount(row + spans[:, 3], minlength=size)
    return np.cumsum(steps.reshape(images, height, width + 1), axis=2)[..., :width]

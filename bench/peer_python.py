"""What a few lines of Python do, as peers: loops over triangles with a NumPy z-buffer. Single-threaded, S1 to S3 only.

* `numpy`: int64 edge functions over each triangle's bounding box, vectorised over its pixels; exact coverage, as bigtri.
* `skimage`: `skimage.draw.polygon2mask` gives the pixels, NumPy the depth. Its coverage is its own.
* `opencv`: `cv2.fillConvexPoly` gives a mask of the bounding box (16ths of a pixel, edges drawn too), NumPy the depth.

Each frame clears and writes packed depth and id, int64 [H, W], in pixel space: the projection is left out, in the peers' favour.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec

import numpy as np
from numpy.typing import NDArray

from bigtri.reference.numerics import BACKGROUND
from bigtri.study import benchmark, scenes
from bigtri.study.clock import clock

Box = tuple[int, int, int, int]  # x0, y0, x1, y1, px, half-open
Inside = Callable[[NDArray[np.float64], Box], NDArray[np.bool_]]  # corners [3, 2] px, box -> mask of the box's pixels
SCENES = ("S1", "S2", "S3")


def inside_numpy(corners: NDArray[np.float64], box: Box) -> NDArray[np.bool_]:
    """Exact coverage with the top-left rule on a grid of 1/256 px, for corners in clockwise order (y down)."""
    x0, y0, x1, y1 = box
    grid = np.rint(corners * 256).astype(np.int64).tolist()
    x, y = np.arange(x0, x1) * 256 + 128, np.arange(y0, y1) * 256 + 128
    mask = np.ones((y1 - y0, x1 - x0), dtype=bool)
    for k in range(3):
        (px, py), (qx, qy) = grid[k], grid[(k + 1) % 3]
        dx, dy = qx - px, qy - py
        owns = dy < 0 or (dy == 0 and dx > 0)
        mask &= (dx * (y - py))[:, None] - (dy * (x - px))[None, :] >= (0 if owns else 1)
    return mask


def inside_skimage(corners: NDArray[np.float64], box: Box) -> NDArray[np.bool_]:
    from skimage.draw import polygon2mask

    x0, y0, x1, y1 = box
    return polygon2mask((y1 - y0, x1 - x0), corners[:, ::-1] - [y0 + 0.5, x0 + 0.5])


def inside_opencv(corners: NDArray[np.float64], box: Box) -> NDArray[np.bool_]:
    import cv2

    x0, y0, x1, y1 = box
    mask = np.zeros((y1 - y0, x1 - x0), dtype=np.uint8)
    cv2.fillConvexPoly(mask, np.rint((corners - [x0 + 0.5, y0 + 0.5]) * 16).astype(np.int32), 1, shift=4)
    return mask.view(bool)


WAYS: dict[str, tuple[Inside, str]] = {
    "numpy": (inside_numpy, "numpy"),
    "skimage": (inside_skimage, "skimage"),
    "opencv": (inside_opencv, "cv2"),
}


def available(way: str) -> bool:
    return find_spec(WAYS[way][1]) is not None


def draw(pixels: NDArray[np.float64], packed: NDArray[np.int64], inside: Inside) -> None:
    """A frame: triangles [T, 3, 3] in pixel space into packed [H, W]."""
    height, width = packed.shape
    packed.fill(BACKGROUND)
    for index, triangle in enumerate(pixels):
        (x0, y0), (x1, y1) = np.floor(triangle[:, :2].min(axis=0)), np.ceil(triangle[:, :2].max(axis=0))
        box = max(int(x0), 0), max(int(y0), 0), min(int(x1), width), min(int(y1), height)
        if box[0] >= box[2] or box[1] >= box[3]:
            continue
        mask = inside(triangle[:, :2], box)
        # the plane z = a + b x + c y through the three vertices
        a, b, c = np.linalg.solve(np.column_stack([np.ones(3), triangle[:, :2]]), triangle[:, 2])
        x, y = np.arange(box[0], box[2]) + 0.5, np.arange(box[1], box[3]) + 0.5
        z = ((a + c * y)[:, None] + (b * x)[None, :]).astype(np.float32)
        value = (z.view(np.int32).astype(np.int64) << 32) | index
        part = packed[box[1] : box[3], box[0] : box[2]]
        np.minimum(part, value, out=part, where=mask)


class PythonPeer:
    """One of `WAYS` behind the driver's interface (see run.py)."""

    def __init__(self, way: str) -> None:
        self.name, self.variant, self.inside = way, "", WAYS[way][0]

    def load(self, name: str, width: int, height: int) -> None:
        self.pixels = scenes.pixels(name, width, height).astype(np.float64)
        self.packed = np.empty((height, width), np.int64)

    def frames(self, count: int) -> list[float]:
        return clock(lambda: draw(self.pixels, self.packed, self.inside), 0, warm=0, at_least=count)

    def ids(self) -> NDArray[np.int32]:
        """int32 [H, W], -1 where there is no triangle."""
        return benchmark.ids(self.packed)

    def close(self) -> None:
        pass

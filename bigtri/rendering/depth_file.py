"""Distances along the view direction as files that other programs read."""

from __future__ import annotations

import math
import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..ops.rasterize import rasterize
from ..scene.camera import Camera
from ..scene.scene import Scene

KINDS = (".npy", ".tif", ".tiff", ".png")
# Counts of a PNG per unit of the scene: millimetres, if that is a metre.
SCALE = 1000.0
_MOST = 2**16 - 1


def distances(scene: Scene, camera: Camera, resolution: tuple[int, int], *, backend: str = "auto") -> NDArray[np.float32]:
    """float32 [H, W]: how far away, along the view direction and in scene units, what each pixel's centre sees is; else +inf."""
    height, width = resolution
    positions = camera.transform(scene.positions, width / height, scene.origin)
    seen = rasterize(positions, scene.triangles, resolution, backend=backend, cull=scene.cull)
    assert isinstance(seen.depth, np.ndarray)  # positions are NumPy, and depth was not declined
    return camera.distance_from_depth(seen.depth)


def save(path: Path, distance: NDArray[np.float32], scale: float = SCALE) -> Path:
    """Writes distances float32 [H, W] and returns the path.

    .npy and .tif have them as they are, float32, +inf on the background. .png has 16-bit integers: the distance times ``scale``,
    rounded, 0 on the background. There is a warning of pixels that 1 to 65535 cannot hold; they are the nearest of these.

    Raises:
        OSError: the file cannot be written.
    """
    kind = path.suffix.lower()
    if kind == ".npy":
        np.save(path, distance)
        return path
    import PIL.Image

    if kind != ".png":
        PIL.Image.fromarray(distance).save(path)
        return path
    covered = distance != math.inf
    counts = np.rint(np.where(covered, distance, 0).astype(np.float64) * scale)
    outside = covered & ((counts < 1) | (counts > _MOST))
    if outside.any():
        low, high = float(distance[outside].min()), float(distance[outside].max())
        text = f"{path}: {np.count_nonzero(outside)} pixels are not from {1 / scale:.6g} to {_MOST / scale:.6g} units away"
        advice = "choose another --depth-scale, or .npy or .tif, which hold all"
        warnings.warn(f"{text}, but {low:.6g} to {high:.6g}: they are 1 or {_MOST}; {advice}", UserWarning, stacklevel=2)
    PIL.Image.fromarray(np.where(covered, np.clip(counts, 1, _MOST), 0).astype(np.uint16)).save(path)
    return path

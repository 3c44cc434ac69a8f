"""The calibrated camera, in OpenCV's conventions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..ops.arguments import check_image_size
from .camera import Camera
from .vectors import Vector, cross, dot, number, positive, vector

# A rotation that is written with 4 decimals passes, one that scales does not.
_ROTATION_ERROR = 1e-3


@dataclass(frozen=True)
class PinholeCamera(Camera, kind="pinhole"):
    """A camera by its intrinsics and its place. ``Camera.from_opencv`` makes one, and says what the attributes are.

    Raises:
        TypeError, ValueError: an attribute that is not as said there.
    """

    K: tuple[Vector, Vector, Vector]
    R: tuple[Vector, Vector, Vector]
    t: Vector
    resolution: tuple[int, int]
    near: float | None = None
    far: float | None = None
    pixel_centre: float = 0.0

    def __post_init__(self) -> None:
        op = "Camera.from_opencv"
        (fx, _, _), (below, fy, _), last = self.K
        if not (fx > 0 and fy > 0 and below == 0 and last == (0.0, 0.0, 1.0)):
            wanted = "[[fx, skew, cx], [0, fy, cy], [0, 0, 1]] with positive fx and fy"
            raise ValueError(f"bigtri.{op}: K must be {wanted}, got {self.K}")
        products = [dot(a, b) for a in self.R for b in self.R]
        off = max(abs(value - wanted) for value, wanted in zip(products, np.eye(3).ravel(), strict=True))
        if off > _ROTATION_ERROR or dot(cross(self.R[0], self.R[1]), self.R[2]) < 0:
            raise ValueError(f"bigtri.{op}: R must be a rotation, its rows perpendicular and of unit length, got {self.R}")
        height, width = check_image_size(op, "resolution", self.resolution)
        object.__setattr__(self, "resolution", (height, width))
        object.__setattr__(self, "pixel_centre", number(op, "pixel_centre", self.pixel_centre))
        if not 0 <= self.pixel_centre <= 1:
            raise ValueError(f"bigtri.{op}: pixel_centre must be in [0, 1], 0.0 or 0.5 as a rule, got {self.pixel_centre}")
        for name in ("near", "far"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, positive(op, name, getattr(self, name)))
        if self.near is not None and self.far is not None and not self.near < self.far:
            raise ValueError(f"bigtri.{op}: near and far must satisfy 0 < near < far < inf, got {self.near} and {self.far}")

    @property
    def eye(self) -> Vector:
        """Where it is, world space."""
        columns = zip(*self.R, strict=True)
        x, y, z = (-dot(column, self.t) for column in columns)
        return x, y, z

    @property
    def depth_range(self) -> tuple[float, float]:
        """(near, far).

        Raises:
            ValueError: it has none yet.
        """
        if self.near is None or self.far is None:
            raise ValueError(
                "bigtri.Camera.from_opencv: near and far must be given, or chosen from what is seen by "
                f"camera.fitted(scene.bounds), got {self.near} and {self.far}"
            )
        return self.near, self.far

    def matrix(self, aspect: float, origin: Sequence[float] = (0.0, 0.0, 0.0)) -> NDArray[np.float64]:
        aspect = positive("Camera", "aspect", aspect)
        height, width = self.resolution
        if aspect != width / height:
            raise ValueError(f"bigtri.Camera: aspect must be that of resolution, {width} / {height}, got {aspect}")
        place = vector("Camera", "origin", origin)
        # Map coordinates in the millions come to nothing here, before anything else is done.
        right, down, ahead = (np.array([*axis, dot(axis, place) + shift]) for axis, shift in zip(self.R, self.t, strict=True))
        near, far = self.depth_range
        (fx, skew, cx), (_, fy, cy), _ = self.K
        cx, cy = cx + (0.5 - self.pixel_centre), cy + (0.5 - self.pixel_centre)
        row_x = ((2 * fx / width) * right + (2 * skew / width) * down) + (2 * cx / width - 1) * ahead
        row_y = (-2 * fy / height) * down + (1 - 2 * cy / height) * ahead
        row_z = (far + near) / (far - near) * ahead
        row_z[3] = row_z[3] - 2 * far * near / (far - near)
        return np.stack([row_x, row_y, row_z, ahead])

    def _distance_row(self) -> NDArray[np.float64]:
        return np.array([*self.R[2], self.t[2]])

"""The camera that is a matrix from world to clip space."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .camera import Camera
from .vectors import corners, dot, length, positive, subtract, vector


@dataclass(frozen=True)
class MatrixCamera(Camera, kind="matrix"):
    """A camera that is a matrix. ``Camera.from_matrix`` makes one.

    Distances are counted from the plane w = 0, where the eye is; of a matrix without perspective from its near plane.

    Attributes:
        world_to_clip: [4, 4], as in ``Camera.from_matrix``.
    """

    world_to_clip: tuple[tuple[float, float, float, float], ...]

    @property
    def _has_perspective(self) -> bool:
        return any(self.world_to_clip[3][:3])

    @property
    def depth_range(self) -> tuple[float, float]:
        """(near, far); far may be infinite.

        Raises:
            ValueError: depth does not depend on distance alone.
        """
        (z0, z1, z2, z3), (w0, w1, w2, w3) = self.world_to_clip[2:]
        slope, forward = (z0, z1, z2), (w0, w1, w2)
        if not self._has_perspective:
            return 0.0, 2 * abs(w3) / (length(slope) or math.nan)
        size = length(forward)
        # z is scale * w + rest, and w is the distance times size.
        scale = dot(slope, forward) / (size * size)
        rest = z3 - scale * w3
        if length(subtract(slope, (scale * w0, scale * w1, scale * w2))) > 1e-6 * length(slope):
            raise ValueError("bigtri.Camera.from_matrix: matrix must have z depend on w alone for distances, got an oblique one")
        # A matrix in float32 has the 1 of an infinite far plane to 24 bits.
        far = math.inf if abs(1 - scale) < 2.0**-26 else rest / ((1 - scale) * size)
        return rest / ((-1 - scale) * size), far

    def matrix(self, aspect: float, origin: Sequence[float] = (0.0, 0.0, 0.0)) -> NDArray[np.float64]:
        """As in ``Camera``; the matrix has an aspect already, so that another means nothing."""
        positive("Camera", "aspect", aspect)
        x, y, z = vector("Camera", "origin", origin)
        rows = np.array(self.world_to_clip)
        rows[:, 3] = ((rows[:, 0] * x + rows[:, 1] * y) + rows[:, 2] * z) + rows[:, 3]
        return rows

    def with_depth_range(self, near: float | None, far: float | None) -> Camera:
        raise ValueError("bigtri.Camera.from_matrix: near and far must be those of the matrix")

    def fitted(self, bounds: ArrayLike) -> Camera:
        """The camera as it is: a matrix has near and far."""
        corners("Camera.fitted", "bounds", bounds)
        return self

    def _warn_of_depth_range(self) -> None:
        """Nothing is said: whoever made the matrix chose its depth."""

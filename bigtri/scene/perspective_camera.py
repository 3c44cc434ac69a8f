"""The camera with perspective."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from .angles import field_of_view
from .looking_at import LookingAt
from .vectors import Vector, affine_row, positive, subtract, vector


@dataclass(frozen=True)
class PerspectiveCamera(LookingAt, kind="perspective"):
    """Looks from ``eye`` at ``target``. ``Camera(eye, target, ...)`` makes one.

    Attributes:
        eye, target: world space, any unit of length; float64, so that map coordinates in the millions keep their nanometres.
        up: the direction that points up in the picture; need not be perpendicular to the view.
        fov_y: the vertical field of view, degrees, in (0, 180). Below pi, where any in radians is and few lenses are,
            there is a warning, once in the process.
        near, far: distances along the view direction, in world units; None: a hundredth of, and a hundred times, the distance
            from eye to target. What is nearer than near is clipped, what is farther than far is not drawn.
        fov_x, fov_diagonal: the horizontal field of view, or the one from corner to corner, in place of the vertical one,
            whatever the picture's aspect; at most one of them.

    Raises:
        TypeError: an attribute that is no number, or not three of them.
        ValueError: a camera that sees nothing; the text names the attribute.
    """

    eye: Vector
    target: Vector
    up: Vector = (0.0, 1.0, 0.0)
    fov_y: float = 45.0
    near: float | None = None
    far: float | None = None
    fov_x: float | None = None
    fov_diagonal: float | None = None
    _owner: ClassVar[str] = "Camera"

    def __post_init__(self) -> None:
        for name in ("fov_y", "fov_x", "fov_diagonal"):
            if name == "fov_y" or getattr(self, name) is not None:
                object.__setattr__(self, name, field_of_view("Camera", name, getattr(self, name)))
        if self.fov_x is not None and self.fov_diagonal is not None:
            raise ValueError(f"bigtri.Camera: fov_diagonal must be None where fov_x is given, got {self.fov_diagonal}")
        self._keep_pose()
        near, far = self.depth_range
        if not 0 < near < far < math.inf:
            raise ValueError(f"bigtri.Camera: near and far must satisfy 0 < near < far < inf, got {near} and {far}")
        self._check_up()

    def matrix(self, aspect: float, origin: Sequence[float] = (0.0, 0.0, 0.0)) -> NDArray[np.float64]:
        aspect = positive("Camera", "aspect", aspect)
        # The two are near each other where the scene is. Subtracted here, large coordinates are multiplied by nothing.
        eye = subtract(self.eye, vector("Camera", "origin", origin))
        right, upward, forward = self._axes()
        near, far = self.depth_range
        scale = self._scale(aspect)
        depth_scale, depth_offset = (far + near) / (far - near), -2 * far * near / (far - near)
        row_x = affine_row(right, eye, scale / aspect)
        row_y = affine_row(upward, eye, scale)
        row_z = affine_row(forward, eye, depth_scale)
        row_z[3] = row_z[3] + depth_offset
        return np.array([row_x, row_y, row_z, affine_row(forward, eye, 1.0)], np.float64)

    def _scale(self, aspect: float) -> float:
        """The cotangent of half the vertical field of view."""
        if self.fov_x is not None:
            return aspect / math.tan(math.radians(self.fov_x) / 2)
        if self.fov_diagonal is not None:
            return math.sqrt(1 + aspect * aspect) / math.tan(math.radians(self.fov_diagonal) / 2)
        return 1 / math.tan(math.radians(self.fov_y) / 2)

"""What cameras with an eye and a target have in common."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from .camera import Camera
from .vectors import Vector, affine_row, cross, length, number, subtract, unit, vector

# Where near and far are not given: this fraction, and this multiple, of the distance from eye to target. Window depth is rounded
# by up to 2^-25 near 1, which is then 3e-6 of that distance at the target.
_NEAR_FRACTION = 1e-2
_FAR_MULTIPLE = 1e2


class LookingAt(Camera):
    """A camera that looks from an eye at a target. ``_owner`` is what error messages name."""

    eye: Vector
    target: Vector
    up: Vector
    near: float | None
    far: float | None
    _owner: ClassVar[str]

    def _keep_pose(self) -> None:
        """Checks what is common, and keeps it as floats."""
        for name in ("eye", "target", "up"):
            object.__setattr__(self, name, vector(self._owner, name, getattr(self, name)))
        for name in ("near", "far"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, number(self._owner, name, getattr(self, name)))
        if self.distance == 0 or not math.isfinite(self.distance):
            raise ValueError(f"bigtri.{self._owner}: target must be a finite distance away from eye, got {self.target} for both")

    def _check_up(self) -> None:
        forward = self.forward
        side = cross(forward, self.up)
        # sin of the angle between up and the view direction; below 1e-7 its direction is rounding noise.
        if length(side) <= 1e-7 * length(self.up):
            raise ValueError(
                f"bigtri.{self._owner}: up must not be zero or parallel to the view direction {forward}, got {self.up}"
            )

    @property
    def distance(self) -> float:
        """From eye to target, world units."""
        return length(subtract(self.target, self.eye))

    @property
    def forward(self) -> Vector:
        """The view direction, of unit length."""
        return unit(subtract(self.target, self.eye))

    @property
    def depth_range(self) -> tuple[float, float]:
        """(near, far), the automatic ones filled in."""
        near = self.distance * _NEAR_FRACTION if self.near is None else self.near
        far = max(self.distance, near) * _FAR_MULTIPLE if self.far is None else self.far
        return near, far

    def _axes(self) -> tuple[Vector, Vector, Vector]:
        """(right, upward, forward), of unit length."""
        forward = self.forward
        right = unit(cross(forward, self.up))
        return right, cross(right, forward), forward

    def _distance_row(self) -> NDArray[np.float64]:
        return np.array(affine_row(self.forward, self.eye, 1.0))

"""The camera without perspective."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from .looking_at import LookingAt
from .vectors import Vector, affine_row, positive, subtract, vector


@dataclass(frozen=True)
class OrthographicCamera(LookingAt, kind="orthographic"):
    """Looks from ``eye`` towards ``target`` along parallel rays. ``Camera.orthographic(eye, target, ...)`` makes one.

    Attributes:
        eye, target, up: as in ``PerspectiveCamera``; the target is in the middle of the picture.
        height: of the picture, in world units.
        near, far: as in ``PerspectiveCamera``, but near may be 0 or negative: then what is behind the eye is drawn, too.

    Raises:
        TypeError, ValueError: as for ``PerspectiveCamera``.
    """

    eye: Vector
    target: Vector
    up: Vector = (0.0, 1.0, 0.0)
    height: float = 2.0
    near: float | None = None
    far: float | None = None
    _owner: ClassVar[str] = "Camera.orthographic"

    def __post_init__(self) -> None:
        object.__setattr__(self, "height", positive(self._owner, "height", self.height))
        self._keep_pose()
        near, far = self.depth_range
        if not near < far < math.inf:
            raise ValueError(f"bigtri.{self._owner}: near and far must satisfy near < far < inf, got {near} and {far}")
        self._check_up()

    def matrix(self, aspect: float, origin: Sequence[float] = (0.0, 0.0, 0.0)) -> NDArray[np.float64]:
        aspect = positive("Camera", "aspect", aspect)
        eye = subtract(self.eye, vector("Camera", "origin", origin))
        right, upward, forward = self._axes()
        near, far = self.depth_range
        scale = 2 / self.height
        row_x = affine_row(right, eye, scale / aspect)
        row_y = affine_row(upward, eye, scale)
        row_z = affine_row(forward, eye, 2 / (far - near))
        row_z[3] = row_z[3] - (far + near) / (far - near)
        return np.array([row_x, row_y, row_z, [0.0, 0.0, 0.0, 1.0]], np.float64)

    @property
    def _has_perspective(self) -> bool:
        return False

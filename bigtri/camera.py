"""A perspective camera: world space (right-handed) to clip space (OpenGL), in float64 in a fixed order of operations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Vector = tuple[float, float, float]

# Where near and far are not given: this fraction, and this multiple, of the distance from eye to target. Window depth is rounded
# by up to 2^-25 near 1, which is then 3e-6 of that distance at the target.
_NEAR_FRACTION = 1e-2
_FAR_MULTIPLE = 1e2


@dataclass(frozen=True)
class Camera:
    """Looks from ``eye`` at ``target``.

    Attributes:
        eye, target: world space, any unit of length.
        up: the direction that points up in the picture; need not be perpendicular to the view.
        fov_y: the vertical field of view, degrees, in (0, 180).
        near, far: distances along the view direction, in world units; None: a hundredth of, and a hundred times, the distance
            from eye to target. What is nearer than near is clipped, what is farther than far is not drawn.

    Raises:
        ValueError: a camera that sees nothing; the text names the attribute.
    """

    eye: Vector
    target: Vector
    up: Vector = (0.0, 1.0, 0.0)
    fov_y: float = 45.0
    near: float | None = None
    far: float | None = None

    def __post_init__(self) -> None:
        for name in ("eye", "target", "up"):
            object.__setattr__(self, name, _vector(name, getattr(self, name)))
        if self.distance == 0 or not math.isfinite(self.distance):
            raise ValueError(f"bigtri.Camera: target must be a finite distance away from eye, got {self.target} for both")
        if not 0 < self.fov_y < 180:
            raise ValueError(f"bigtri.Camera: fov_y must be in (0, 180) degrees, got {self.fov_y}")
        near, far = self.depth_range
        if not 0 < near < far < math.inf:
            raise ValueError(f"bigtri.Camera: near and far must satisfy 0 < near < far < inf, got {near} and {far}")
        forward = self.forward
        side = _cross(forward, self.up)
        # sin of the angle between up and the view direction; below 1e-7 its direction is rounding noise.
        if _length(side) <= 1e-7 * _length(self.up):
            raise ValueError(f"bigtri.Camera: up must not be zero or parallel to the view direction {forward}, got {self.up}")

    @classmethod
    def orbit(
        cls,
        center: Sequence[float],
        radius: float,
        azimuth: float = 0.0,
        elevation: float = 0.0,
        up_axis: str = "y",
        **settings: Any,
    ) -> Camera:
        """A camera on the sphere around ``center``.

        Args:
            center: what it looks at.
            radius: its distance from there, > 0.
            azimuth: degrees around the up axis, counter-clockwise as seen from above; 0 is in front of the model (+z, or -y where
                z is up).
            elevation: degrees above the horizon, in [-90, 90]; straight from above or below is allowed.
            up_axis: "y" or "z".
            **settings: fov_y, near, far.
        """
        if not (radius > 0 and math.isfinite(radius)):
            raise ValueError(f"bigtri.Camera.orbit: radius must be positive and finite, got {radius}")
        if not -90 <= elevation <= 90:
            raise ValueError(f"bigtri.Camera.orbit: elevation must be in [-90, 90] degrees, got {elevation}")
        if up_axis not in ("y", "z"):
            raise ValueError(f"bigtri.Camera.orbit: up_axis must be 'y' or 'z', got {up_axis!r}")
        center = _vector("center", center)
        turn, rise = math.radians(azimuth), math.radians(elevation)
        outward = (math.cos(rise) * math.sin(turn), math.sin(rise), math.cos(rise) * math.cos(turn))
        # The derivative of outward by the elevation: it stays perpendicular to the view, also at the poles.
        up = (-math.sin(rise) * math.sin(turn), math.cos(rise), -math.sin(rise) * math.cos(turn))
        if up_axis == "z":
            outward, up = _y_up_to_z_up(outward), _y_up_to_z_up(up)
        eye = (center[0] + radius * outward[0], center[1] + radius * outward[1], center[2] + radius * outward[2])
        return cls(eye, center, up, **settings)

    @classmethod
    def framing(
        cls,
        bounds: ArrayLike,
        azimuth: float = 30.0,
        elevation: float = 20.0,
        distance: float = 1.0,
        aspect: float = 1.0,
        fov_y: float = 45.0,
        up_axis: str = "y",
    ) -> Camera:
        """An orbit camera from where all of ``bounds`` is in the picture.

        Args:
            bounds: float [2, 3], the lowest and the highest corner.
            azimuth, elevation, up_axis: as in ``orbit``.
            distance: 1 fits the sphere around the bounds; 2 is twice as far.
            aspect: width / height of the picture.
            fov_y: degrees.
        """
        low, high = (_vector("bounds", corner) for corner in np.asarray(bounds, np.float64))
        if not (distance > 0 and math.isfinite(distance)):
            raise ValueError(f"bigtri.Camera.framing: distance must be positive and finite, got {distance}")
        radius = 0.5 * _length(_subtract(high, low)) or 1.0
        half_height = math.radians(_field_of_view(fov_y)) / 2
        half_angle = min(half_height, math.atan(math.tan(half_height) * _aspect(aspect)))
        away = radius / math.sin(half_angle) * distance
        center = (0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), 0.5 * (low[2] + high[2]))
        near = max((away - radius) * 0.5, away * 1e-3)
        return cls.orbit(center, away, azimuth, elevation, up_axis, fov_y=fov_y, near=near, far=2 * (away + radius))

    @property
    def distance(self) -> float:
        """From eye to target, world units."""
        return _length(_subtract(self.target, self.eye))

    @property
    def forward(self) -> Vector:
        """The view direction, of unit length."""
        return _unit(_subtract(self.target, self.eye))

    @property
    def depth_range(self) -> tuple[float, float]:
        """(near, far), the automatic ones filled in."""
        near = self.distance * _NEAR_FRACTION if self.near is None else self.near
        far = max(self.distance, near) * _FAR_MULTIPLE if self.far is None else self.far
        return near, far

    def matrix(self, aspect: float) -> NDArray[np.float64]:
        """World to clip space: float64 [4, 4], for column vectors; ``aspect`` is width / height."""
        forward = self.forward
        right = _unit(_cross(forward, self.up))
        upward = _cross(right, forward)
        near, far = self.depth_range
        scale = 1 / math.tan(math.radians(self.fov_y) / 2)
        depth_scale, depth_offset = (far + near) / (far - near), -2 * far * near / (far - near)
        row_x = _row(right, self.eye, scale / _aspect(aspect))
        row_y = _row(upward, self.eye, scale)
        row_z = _row(forward, self.eye, depth_scale)
        row_z[3] = row_z[3] + depth_offset
        return np.array([row_x, row_y, row_z, _row(forward, self.eye, 1.0)], np.float64)

    def transform(self, points: ArrayLike, aspect: float) -> NDArray[np.float32]:
        """World-space points [V, 3] to clip space, float32 [V, 4].

        Every component is ``((m0*x + m1*y) + m2*z) + m3`` in float64, rounded once to float32: no matrix product, whose order of
        summation a library would choose.
        """
        world = np.asarray(points, np.float64)
        if world.ndim != 2 or world.shape[1] != 3:
            raise ValueError(f"bigtri.Camera.transform: points must be [V, 3], got {list(world.shape)}")
        x, y, z = world[:, 0], world[:, 1], world[:, 2]
        clip = np.empty((len(world), 4), np.float32)
        # A point beyond float32's range becomes an infinity, and rasterize drops and counts its triangles.
        with np.errstate(over="ignore", invalid="ignore"):
            for i, row in enumerate(self.matrix(aspect)):
                clip[:, i] = ((row[0] * x + row[1] * y) + row[2] * z) + row[3]
        return clip


def _row(direction: Vector, eye: Vector, scale: float) -> list[float]:
    """The row that gives ``scale * dot(direction, point - eye)``."""
    return [scale * direction[0], scale * direction[1], scale * direction[2], -scale * _dot(direction, eye)]


def _vector(name: str, value: Sequence[float]) -> Vector:
    try:
        x, y, z = (float(component) for component in value)
    except (TypeError, ValueError):
        raise ValueError(f"bigtri.Camera: {name} must be three numbers, got {value!r}") from None
    if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
        raise ValueError(f"bigtri.Camera: {name} must be finite, got {value!r}")
    return x, y, z


def _aspect(aspect: float) -> float:
    if not (aspect > 0 and math.isfinite(aspect)):
        raise ValueError(f"bigtri.Camera: aspect must be positive and finite, got {aspect}")
    return aspect


def _field_of_view(fov_y: float) -> float:
    if not 0 < fov_y < 180:
        raise ValueError(f"bigtri.Camera: fov_y must be in (0, 180) degrees, got {fov_y}")
    return fov_y


def _y_up_to_z_up(v: Vector) -> Vector:
    return v[0], -v[2], v[1]


def _subtract(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _dot(a: Vector, b: Vector) -> float:
    return (a[0] * b[0] + a[1] * b[1]) + a[2] * b[2]


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _length(v: Vector) -> float:
    return math.sqrt(_dot(v, v))


def _unit(v: Vector) -> Vector:
    length = _length(v)
    return v[0] / length, v[1] / length, v[2] / length

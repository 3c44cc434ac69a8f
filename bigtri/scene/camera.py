"""A perspective camera: world space (right-handed) to clip space (OpenGL), in float64 in a fixed order of operations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import warn

Vector = tuple[float, float, float]

# Where near and far are not given: this fraction, and this multiple, of the distance from eye to target. Window depth is rounded
# by up to 2^-25 near 1, which is then 3e-6 of that distance at the target.
_NEAR_FRACTION = 1e-2
_FAR_MULTIPLE = 1e2


@dataclass(frozen=True)
class Camera:
    """Looks from ``eye`` at ``target``.

    Attributes:
        eye, target: world space, any unit of length; float64, so that map coordinates in the millions keep their nanometres.
        up: the direction that points up in the picture; need not be perpendicular to the view.
        fov_y: the vertical field of view, degrees, in (0, 180). Below pi, where any in radians is and few lenses are,
            there is a warning, once in the process.
        near, far: distances along the view direction, in world units; None: a hundredth of, and a hundred times, the distance
            from eye to target. What is nearer than near is clipped, what is farther than far is not drawn.

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

    def __post_init__(self) -> None:
        for name in ("eye", "target", "up"):
            object.__setattr__(self, name, vector("Camera", name, getattr(self, name)))
        object.__setattr__(self, "fov_y", _field_of_view("Camera", self.fov_y))
        for name in ("near", "far"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, number("Camera", name, getattr(self, name)))
        if self.distance == 0 or not math.isfinite(self.distance):
            raise ValueError(f"bigtri.Camera: target must be a finite distance away from eye, got {self.target} for both")
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
            elevation: degrees above the horizon, in [-90, 90]; straight from above or below is allowed. Either angle is
                warned of, once in the process, where it is a whole number of degrees in radians, such as pi / 6. Other
                radians cannot be told from small angles.
            up_axis: "y" or "z".
            **settings: fov_y, near, far.

        Raises:
            TypeError, ValueError: as for ``Camera``, and angles and a radius that are not as said above.
        """
        op = "Camera.orbit"
        center, radius = vector(op, "center", center), _positive(op, "radius", radius)
        azimuth, elevation = number(op, "azimuth", azimuth), number(op, "elevation", elevation)
        if not -90 <= elevation <= 90:
            raise ValueError(f"bigtri.Camera.orbit: elevation must be in [-90, 90] degrees, got {elevation}")
        for name, angle in (("azimuth", azimuth), ("elevation", elevation)):
            if _is_in_radians(angle):
                _warn_of_radians(op, name, angle)
        if up_axis not in ("y", "z"):
            raise ValueError(f"bigtri.Camera.orbit: up_axis must be 'y' or 'z', got {up_axis!r}")
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

        Raises:
            TypeError, ValueError: an argument that is not as said above; the text names it.
        """
        op = "Camera.framing"
        corners = _points(op, "bounds", bounds)
        if corners.shape != (2, 3):
            raise ValueError(f"bigtri.{op}: bounds must be [2, 3], got {list(corners.shape)}")
        low, high = (vector(op, "bounds", corner) for corner in corners.tolist())
        distance, fov_y = _positive(op, "distance", distance), _field_of_view(op, fov_y)
        radius = 0.5 * _length(_subtract(high, low)) or 1.0
        if not math.isfinite(radius):
            raise ValueError(f"bigtri.{op}: bounds must have a diagonal below 1e154, got {corners.tolist()}")
        half_height = math.radians(fov_y) / 2
        half_angle = min(half_height, math.atan(math.tan(half_height) * _positive(op, "aspect", aspect)))
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

    def matrix(self, aspect: float, origin: Sequence[float] = (0.0, 0.0, 0.0)) -> NDArray[np.float64]:
        """World to clip space: float64 [4, 4], for column vectors.

        Args:
            aspect: width / height.
            origin: what points are counted from, world space.

        Raises:
            TypeError, ValueError: an aspect that is no number, or not positive and finite; an origin that is not three numbers.
        """
        aspect = _positive("Camera", "aspect", aspect)
        # The two are near each other where the scene is. Subtracted here, large coordinates are multiplied by nothing.
        eye = _subtract(self.eye, vector("Camera", "origin", origin))
        forward = self.forward
        right = _unit(_cross(forward, self.up))
        upward = _cross(right, forward)
        near, far = self.depth_range
        scale = 1 / math.tan(math.radians(self.fov_y) / 2)
        depth_scale, depth_offset = (far + near) / (far - near), -2 * far * near / (far - near)
        row_x = _row(right, eye, scale / aspect)
        row_y = _row(upward, eye, scale)
        row_z = _row(forward, eye, depth_scale)
        row_z[3] = row_z[3] + depth_offset
        return np.array([row_x, row_y, row_z, _row(forward, eye, 1.0)], np.float64)

    def transform(self, points: ArrayLike, aspect: float, origin: Sequence[float] = (0.0, 0.0, 0.0)) -> NDArray[np.float32]:
        """Points [V, 3], counted from ``origin``, to clip space, float32 [V, 4].

        Every component is ``((m0*x + m1*y) + m2*z) + m3`` in float64, rounded once to float32: no matrix product, whose order of
        summation a library would choose. The matrix is ``matrix(aspect, origin)``.

        Raises:
            TypeError, ValueError: points, an aspect or an origin that are not as said above.
        """
        world = _points("Camera.transform", "points", points)
        if world.ndim != 2 or world.shape[1] != 3:
            raise ValueError(f"bigtri.Camera.transform: points must be [V, 3], got {list(world.shape)}")
        clip = np.empty((len(world), 4), np.float32)
        # A point beyond float32's range becomes an infinity, and rasterize drops and counts its triangles.
        with np.errstate(over="ignore", invalid="ignore"):
            for i, row in enumerate(self.matrix(aspect, origin)):
                clip[:, i] = affine(row, world)
        return clip


def affine(row: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """float64 [V]: one row [4] of an affine map at points [V, 3], in the order that ``Camera.transform`` says."""
    x, y, z = points[:, 0], points[:, 1], points[:, 2]
    return ((row[0] * x + row[1] * y) + row[2] * z) + row[3]


def number(owner: str, name: str, value: Any) -> float:
    """``value`` as a float.

    Args:
        owner, name: the function or class and its argument, for the error text.
        value: a number of Python, NumPy or torch; text that reads as one is none.

    Raises:
        TypeError: not a number.
        ValueError: a NaN or an infinity.
    """
    wanted = f"bigtri.{owner}: {name} must be a finite number"
    if not (hasattr(value, "__float__") or hasattr(value, "__index__")):
        raise TypeError(f"{wanted}, got {value!r}")
    try:
        result = float(value)
    except OverflowError:  # an integer beyond float64
        result = math.inf
    except (TypeError, ValueError, RuntimeError):  # an array of several
        raise TypeError(f"{wanted}, got {value!r}") from None
    if not math.isfinite(result):
        raise ValueError(f"{wanted}, got {value!r}")
    return result


def vector(owner: str, name: str, value: Any) -> Vector:
    """``value`` as three floats; arguments as for ``number``.

    Raises:
        TypeError: not a sequence, or not of numbers.
        ValueError: not three, or one is a NaN or an infinity.
    """
    wanted = f"bigtri.{owner}: {name} must be three finite numbers"
    try:
        x, y, z = (number(owner, name, component) for component in value)
    except TypeError:
        raise TypeError(f"{wanted}, got {value!r}") from None
    except ValueError:  # another number of them, too
        raise ValueError(f"{wanted}, got {value!r}") from None
    return x, y, z


def _row(direction: Vector, eye: Vector, scale: float) -> list[float]:
    """The row that gives ``scale * dot(direction, point - eye)``."""
    return [scale * direction[0], scale * direction[1], scale * direction[2], -scale * _dot(direction, eye)]


def _points(owner: str, name: str, value: ArrayLike) -> NDArray[np.float64]:
    """``value`` as float64 of any shape."""
    try:
        array = np.asarray(value)
        if array.dtype.kind in "biuf":
            return array.astype(np.float64, copy=False)
    except (TypeError, ValueError, RuntimeError):  # rows of different lengths, or a tensor that NumPy cannot see
        pass
    raise TypeError(f"bigtri.{owner}: {name} must be an array of numbers, got {value!r}")


def _positive(owner: str, name: str, value: float) -> float:
    result = number(owner, name, value)
    if not result > 0:
        raise ValueError(f"bigtri.{owner}: {name} must be positive and finite, got {value!r}")
    return result


def _field_of_view(owner: str, fov_y: float) -> float:
    result = number(owner, "fov_y", fov_y)
    # In radians the smallest of all floats is 0.
    if not (0 < result < 180 and math.radians(result) / 2 > 0):
        raise ValueError(f"bigtri.{owner}: fov_y must be in (0, 180) degrees, got {fov_y!r}")
    if result < math.pi:
        _warn_of_radians(owner, "fov_y", result)
    return result


def _is_in_radians(angle: float) -> bool:
    """Whether an angle up to a full turn is the radians of a whole number of degrees, as near as float32 has them.

    No such angle is a number of up to three decimals, so that nobody means it as degrees.
    """
    whole = math.radians(round(math.degrees(angle)))
    return 0 < abs(whole) <= 2 * math.pi and abs(angle - whole) < 1e-6


def _warn_of_radians(owner: str, name: str, angle: float) -> None:
    what = f"bigtri.{owner}: {name} is in degrees, got {angle:.6g}, which looks like radians"
    warn.once(name, f"{what}; {angle:.6g} radians are {math.degrees(angle):.6g} degrees", UserWarning)


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

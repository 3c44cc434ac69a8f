"""Cameras: world space (right-handed) to clip space (OpenGL), in float64 in a fixed order of operations.

What the kinds have in common is ``Camera``. One that is not here has a ``matrix`` and a ``depth_range`` of its own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import warn
from ..ops.arguments import ArrayT, check_image_size
from . import fit, window_depth
from .vectors import Vector, affine, affine_row, corners, cross, dot, length, number, numbers, positive, subtract, unit, vector

# Where near and far are not given: this fraction, and this multiple, of the distance from eye to target. Window depth is rounded
# by up to 2^-25 near 1, which is then 3e-6 of that distance at the target.
_NEAR_FRACTION = 1e-2
_FAR_MULTIPLE = 1e2

# Neighbouring float32 are 2^-24 apart just below 1. With perspective that is 2^-24 far / near of the distance at the far plane:
# beyond this ratio, more than 1/256 of it.
_MOST_FAR_OVER_NEAR = 2.0**16

# A rotation that is written with 4 decimals passes, one that scales does not.
_ROTATION_ERROR = 1e-3


class Camera:
    """What a scene is seen by. ``Camera(eye, target, ...)`` is a ``PerspectiveCamera``; its arguments are described there.

    Others are made by ``Camera.orthographic``, ``Camera.from_opencv`` and ``Camera.from_matrix``, and those that see all of
    something by ``Camera.framing`` and ``Camera.tight_framing``. All are frozen, compare equal by their values, and are cameras
    to ``isinstance``.
    """

    if TYPE_CHECKING:

        def __new__(
            cls,
            eye: Sequence[float],
            target: Sequence[float],
            up: Sequence[float] = (0.0, 1.0, 0.0),
            fov_y: float = 45.0,
            near: float | None = None,
            far: float | None = None,
            fov_x: float | None = None,
            fov_diagonal: float | None = None,
        ) -> PerspectiveCamera: ...
    else:

        def __new__(cls, *_: Any, **__: Any) -> Camera:
            return super().__new__(PerspectiveCamera if cls is Camera else cls)

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
            **settings: fov_y, near, far and what else the camera has; an ``OrthographicCamera`` has a height.

        Raises:
            TypeError, ValueError: as for ``Camera``, and angles and a radius that are not as said above.
        """
        op = "Camera.orbit"
        center, radius = vector(op, "center", center), positive(op, "radius", radius)
        outward, up = _outward_and_up(op, azimuth, elevation, up_axis)
        eye = (center[0] + radius * outward[0], center[1] + radius * outward[1], center[2] + radius * outward[2])
        return cls(eye, center, up, **settings)

    @staticmethod
    def framing(
        bounds: ArrayLike,
        azimuth: float = 30.0,
        elevation: float = 20.0,
        distance: float = 1.0,
        aspect: float = 1.0,
        fov_y: float = 45.0,
        up_axis: str = "y",
        orthographic: bool = False,
    ) -> Camera:
        """An orbit camera from where all of ``bounds`` is in the picture.

        Args:
            bounds: float [2, 3], the lowest and the highest corner.
            azimuth, elevation, up_axis: as in ``orbit``.
            distance: 1 fits the sphere around the bounds; 2 is twice as far, or without perspective twice as high a view.
            aspect: width / height of the picture.
            fov_y: degrees.
            orthographic: whether the camera is one without perspective, for which ``fov_y`` means nothing.

        Raises:
            TypeError, ValueError: an argument that is not as said above; the text names it.
        """
        op = "Camera.framing"
        low, high = corners(op, "bounds", bounds)
        distance, fov_y = positive(op, "distance", distance), _field_of_view(op, "fov_y", fov_y)
        radius = 0.5 * length(subtract(high, low)) or 1.0
        if not math.isfinite(radius):
            raise ValueError(f"bigtri.{op}: bounds must have a diagonal below 1e154, got {[list(low), list(high)]}")
        center = (0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), 0.5 * (low[2] + high[2]))
        aspect = positive(op, "aspect", aspect)
        if orthographic:
            away, height = 2 * radius, 2 * radius * distance * max(1.0, 1 / aspect)
            where = (center, away, azimuth, elevation, up_axis)
            return OrthographicCamera.orbit(*where, height=height, near=0.5 * radius, far=2 * (away + radius))
        half_height = math.radians(fov_y) / 2
        half_angle = min(half_height, math.atan(math.tan(half_height) * aspect))
        away = radius / math.sin(half_angle) * distance
        near = max((away - radius) * 0.5, away * 1e-3)
        return Camera.orbit(center, away, azimuth, elevation, up_axis, fov_y=fov_y, near=near, far=2 * (away + radius))

    @staticmethod
    def tight_framing(
        points: ArrayLike,
        azimuth: float = 30.0,
        elevation: float = 20.0,
        margin: float = 0.05,
        aspect: float = 1.0,
        fov_y: float = 45.0,
        up_axis: str = "y",
        orthographic: bool = False,
    ) -> Camera:
        """The nearest camera of this direction that has all points in the picture, as ``framing`` is for the sphere around them.

        The points reach the margin on two opposite sides at least, and are in the middle between the other two. ``near`` and
        ``far`` hold them.

        Args:
            points: float [N, 3], world space; ``Scene.points`` are a scene's. Those that are not finite are left out.
            azimuth, elevation, up_axis: as in ``orbit``.
            margin: what is kept free at each side, as a fraction of the width and the height; in [0, 0.5).
            aspect, fov_y, orthographic: as in ``framing``.

        Raises:
            TypeError, ValueError: an argument that is not as said above; the text names it.
        """
        op = "Camera.tight_framing"
        world = numbers(op, "points", points)
        if world.ndim != 2 or world.shape[1] != 3:
            raise ValueError(f"bigtri.{op}: points must be [N, 3], got {list(world.shape)}")
        world = world[np.isfinite(world).all(axis=1)]
        if len(world) == 0:
            raise ValueError(f"bigtri.{op}: points must hold at least one point that is finite, got none")
        margin, aspect = number(op, "margin", margin), positive(op, "aspect", aspect)
        if not 0 <= margin < 0.5:
            raise ValueError(f"bigtri.{op}: margin must be in [0, 0.5), got {margin}")
        fov_y = _field_of_view(op, "fov_y", fov_y)
        outward, up = _outward_and_up(op, azimuth, elevation, up_axis)
        ahead = (-outward[0], -outward[1], -outward[2])
        right = cross(ahead, up)
        # Counted from their middle, map coordinates keep their digits.
        low, high = world.min(axis=0), world.max(axis=0)
        center = vector(op, "points", 0.5 * (low + high))
        view = fit.View.of(world - np.array(center), right, up, ahead)
        free = 1 - 2 * margin
        if orthographic:
            x, y, height = view.box(aspect)
            z = float(view.ahead.min()) - view.size
        else:
            tangent = math.tan(math.radians(fov_y) / 2) * free
            x, y, z = view.eye((tangent * aspect, tangent))
        nearest, farthest = float(view.ahead.min()) - z, float(view.ahead.max()) - z
        near, far = fit.depth_range(nearest, farthest, not orthographic)
        eye = vector(op, "points", [c + ((x * r + y * u) + z * a) for c, r, u, a in zip(center, right, up, ahead, strict=True)])
        away = 0.5 * (nearest + farthest)
        target = (eye[0] + away * ahead[0], eye[1] + away * ahead[1], eye[2] + away * ahead[2])
        if orthographic:
            return OrthographicCamera(eye, target, up, height / free, near, far)
        return Camera(eye, target, up, fov_y, near, far)

    @staticmethod
    def orthographic(
        eye: Sequence[float],
        target: Sequence[float],
        up: Sequence[float] = (0.0, 1.0, 0.0),
        height: float = 2.0,
        near: float | None = None,
        far: float | None = None,
    ) -> OrthographicCamera:
        """A camera without perspective: what is far away is as large as what is near. See ``OrthographicCamera``."""
        return OrthographicCamera(eye, target, up, height, near, far)  # type: ignore[arg-type]

    @staticmethod
    def from_opencv(
        K: ArrayLike,
        R: ArrayLike,
        t: ArrayLike,
        resolution: tuple[int, int],
        near: float | None = None,
        far: float | None = None,
        pixel_centre: float = 0.0,
    ) -> PinholeCamera:
        """A calibrated camera in OpenCV's conventions: x right, y down, z forward. Lens distortion has to be removed before.

        Args:
            K: [3, 3], the intrinsics: focal lengths, skew and principal point in px.
            R, t: [3, 3] and [3] or [3, 1], from world space to the camera's: a point's place is R p + t. Of a rotation vector
                ``cv2.Rodrigues`` makes R.
            resolution: (height, width) in px, of the images that K is for. Pictures may have other sizes of the same aspect.
            near, far: distances along the view; without them ``fitted(bounds)`` chooses them from what is to be seen.
            pixel_centre: the coordinates that K has the centre of the upper left pixel at: 0.0 for OpenCV's calibration and
                whatever else counts pixels, 0.5 where (0, 0) is the corner of the image, as in bigtri itself.

        Raises:
            TypeError, ValueError: an argument that is not as said above; the text names it.
        """
        op = "Camera.from_opencv"
        intrinsics, rotation = _matrix(op, "K", K, 3), _matrix(op, "R", R, 3)
        shift = numbers(op, "t", t)
        if shift.shape not in ((3,), (3, 1)):
            raise ValueError(f"bigtri.{op}: t must be [3] or [3, 1], got {list(shift.shape)}")
        return PinholeCamera(intrinsics, rotation, vector(op, "t", shift.ravel()), resolution, near, far, pixel_centre)

    @staticmethod
    def from_matrix(matrix: ArrayLike) -> MatrixCamera:
        """The camera of a matrix [4, 4] from world space to clip space (OpenGL: -w <= x, y, z <= w), for column vectors.

        It has the aspect of the picture in it, and near and far. Of a view matrix V, from world space to a camera that looks
        along -z, and a projection P it is P @ V.

        Raises:
            TypeError, ValueError: something else.
        """
        return MatrixCamera(_matrix("Camera.from_matrix", "matrix", matrix, 4))

    @property
    def depth_range(self) -> tuple[float, float]:
        """(near, far): distances along the view direction, the automatic ones filled in."""
        raise NotImplementedError

    def matrix(self, aspect: float, origin: Sequence[float] = (0.0, 0.0, 0.0)) -> NDArray[np.float64]:
        """World to clip space: float64 [4, 4], for column vectors.

        Args:
            aspect: width / height.
            origin: what points are counted from, world space.

        Raises:
            TypeError, ValueError: an aspect that is no number, or not positive and finite, or not that of a ``PinholeCamera``; an
                origin that is not three numbers.
        """
        raise NotImplementedError

    def with_depth_range(self, near: float | None, far: float | None) -> Camera:
        """The same camera with other near and far planes; None: automatic.

        Raises:
            TypeError, ValueError: as for the camera.
        """
        return type(self)(**{**vars(self), "near": near, "far": far})

    def fitted(self, bounds: ArrayLike) -> Camera:
        """The same camera with near and far, where it has none, chosen so that they hold ``bounds``.

        Args:
            bounds: float [2, 3], the lowest and the highest corner; ``Scene.bounds`` are a scene's.

        Raises:
            TypeError, ValueError: bounds that are something else, or that are behind the camera or its near plane.
        """
        op = "Camera.fitted"
        low, high = corners(op, "bounds", bounds)
        given: tuple[float | None, float | None] = (self.near, self.far)  # type: ignore[attr-defined]
        if None not in given:
            return self
        distances = affine(self._distance_row(), fit.corners_of(low, high))
        nearest, farthest = float(distances.min()), float(distances.max())
        if self._has_perspective and farthest <= (given[0] or 0.0):
            raise ValueError(f"bigtri.{op}: bounds must be before the camera and its near plane, got {farthest:.6g} at most")
        fitted = fit.depth_range(nearest, farthest, self._has_perspective)
        near, far = (own if own is not None else new for own, new in zip(given, fitted, strict=True))
        return self.with_depth_range(near, far)

    def transform(self, points: ArrayLike, aspect: float, origin: Sequence[float] = (0.0, 0.0, 0.0)) -> NDArray[np.float32]:
        """Points [V, 3], counted from ``origin``, to clip space, float32 [V, 4].

        Every component is ``((m0*x + m1*y) + m2*z) + m3`` in float64, rounded once to float32: no matrix product, whose order of
        summation a library would choose. The matrix is ``matrix(aspect, origin)``. Where far / near is so large that float32
        tells little apart at the far plane, there is a warning, once in the process.

        Raises:
            TypeError, ValueError: points, an aspect or an origin that are not as said above.
        """
        world = numbers("Camera.transform", "points", points)
        if world.ndim != 2 or world.shape[1] != 3:
            raise ValueError(f"bigtri.Camera.transform: points must be [V, 3], got {list(world.shape)}")
        rows = self.matrix(aspect, origin)
        self._warn_of_depth_range()
        clip = np.empty((len(world), 4), np.float32)
        # A point beyond float32's range becomes an infinity, and rasterize drops and counts its triangles.
        with np.errstate(over="ignore", invalid="ignore"):
            for i, row in enumerate(rows):
                clip[:, i] = affine(row, world)
        return clip

    def distance_from_depth(self, depth: ArrayT) -> ArrayT:
        """Distances along the view direction, in world units, of window depths; +inf, the background, stays so.

        Args:
            depth: float32 or float64 of any shape, 0 at near and 1 at far, NumPy or torch.

        Returns:
            The same kind, dtype and shape; computed in float64.

        Raises:
            TypeError: depth is of another kind.
            ValueError: the camera is a matrix whose depth does not depend on distance alone.
        """
        near, far = self.depth_range
        return window_depth.distance_from("Camera.distance_from_depth", depth, near, far, self._has_perspective)

    def depth_from_distance(self, distance: ArrayT) -> ArrayT:
        """Window depths of distances along the view direction: the inverse of ``distance_from_depth``."""
        near, far = self.depth_range
        return window_depth.depth_from("Camera.depth_from_distance", distance, near, far, self._has_perspective)

    @property
    def _has_perspective(self) -> bool:
        return True

    def _distance_row(self) -> NDArray[np.float64]:
        """float64 [4]: the affine map from a point of the world to its distance along the view direction."""
        raise NotImplementedError

    def _warn_of_depth_range(self) -> None:
        if not self._has_perspective:
            return
        near, far = self.depth_range
        if far > _MOST_FAR_OVER_NEAR * near:
            steps = f"at far, steps of window depth are {100 * 2.0**-24 * far / near:.2g} % of the distance"
            advice = 'take nearer ones, or rasterize(precision="depth_reversed") with positions in reversed clip depth'
            text = f"near and far should be at most {_MOST_FAR_OVER_NEAR:.0f} times apart, got {near:.6g} and {far:.6g}: {steps}"
            warn.once("depth range", f"bigtri.Camera: {text}; {advice}", UserWarning)


class _LookingAt(Camera):
    """What cameras with an eye and a target have in common."""

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


@dataclass(frozen=True)
class PerspectiveCamera(_LookingAt):
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
                object.__setattr__(self, name, _field_of_view("Camera", name, getattr(self, name)))
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


@dataclass(frozen=True)
class OrthographicCamera(_LookingAt):
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


@dataclass(frozen=True)
class PinholeCamera(Camera):
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


@dataclass(frozen=True)
class MatrixCamera(Camera):
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


def _matrix(owner: str, name: str, value: ArrayLike, size: int) -> Any:
    """A matrix [size, size] of finite numbers, as tuples."""
    array = numbers(owner, name, value)
    if array.shape != (size, size):
        raise ValueError(f"bigtri.{owner}: {name} must be [{size}, {size}], got {list(array.shape)}")
    if not np.isfinite(array).all():
        raise ValueError(f"bigtri.{owner}: {name} must be finite, got {array.tolist()}")
    return tuple(map(tuple, array.tolist()))


def _outward_and_up(op: str, azimuth: Any, elevation: Any, up_axis: str) -> tuple[Vector, Vector]:
    """Of a camera on a sphere: from its centre to the eye, and up in the picture, both of unit length. As in ``Camera.orbit``."""
    azimuth, elevation = number(op, "azimuth", azimuth), number(op, "elevation", elevation)
    if not -90 <= elevation <= 90:
        raise ValueError(f"bigtri.{op}: elevation must be in [-90, 90] degrees, got {elevation}")
    for name, angle in (("azimuth", azimuth), ("elevation", elevation)):
        if _is_in_radians(angle):
            _warn_of_radians(op, name, angle)
    if up_axis not in ("y", "z"):
        raise ValueError(f"bigtri.{op}: up_axis must be 'y' or 'z', got {up_axis!r}")
    turn, rise = math.radians(azimuth), math.radians(elevation)
    outward = (math.cos(rise) * math.sin(turn), math.sin(rise), math.cos(rise) * math.cos(turn))
    # The derivative of outward by the elevation: it stays perpendicular to the view, also at the poles.
    up = (-math.sin(rise) * math.sin(turn), math.cos(rise), -math.sin(rise) * math.cos(turn))
    if up_axis == "z":
        outward, up = _y_up_to_z_up(outward), _y_up_to_z_up(up)
    return outward, up


def _field_of_view(owner: str, name: str, value: Any) -> float:
    result = number(owner, name, value)
    # In radians the smallest of all floats is 0.
    if not (0 < result < 180 and math.radians(result) / 2 > 0):
        raise ValueError(f"bigtri.{owner}: {name} must be in (0, 180) degrees, got {value!r}")
    if result < math.pi:
        _warn_of_radians(owner, name, result)
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

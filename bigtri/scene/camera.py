"""Cameras: world space (right-handed) to clip space (OpenGL), in float64 in a fixed order of operations.

What the kinds have in common is ``Camera``. Each kind has a ``matrix`` and a ``depth_range`` of its own, and a file:
``perspective_camera``, ``orthographic_camera``, ``pinhole_camera``, ``matrix_camera``.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, ParamSpec, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import warn
from ..ops.arguments import ArrayT
from . import fit, window_depth
from .angles import field_of_view, outward_and_up
from .vectors import affine, corners, cross, length, number, numbers, positive, square_matrix, subtract, vector

if TYPE_CHECKING:
    from .matrix_camera import MatrixCamera
    from .orthographic_camera import OrthographicCamera
    from .perspective_camera import PerspectiveCamera
    from .pinhole_camera import PinholeCamera

P = ParamSpec("P")
Made = TypeVar("Made")

# Neighbouring float32 are 2^-24 apart just below 1. With perspective that is 2^-24 far / near of the distance at the far plane:
# beyond this ratio, more than 1/256 of it.
_MOST_FAR_OVER_NEAR = 2.0**16


def _for_every_kind(new: Callable[P, Made]) -> Callable[P, Made]:
    """``Camera.__new__``, with the signature of ``new``: kinds have other arguments, which their ``__init__`` takes."""

    @functools.wraps(new)
    def made(cls: type[Camera], *_: Any, **__: Any) -> Any:
        return object.__new__(Camera._kinds["perspective"] if cls is Camera else cls)

    return made  # type: ignore[return-value]


class Camera:
    """What a scene is seen by. ``Camera(eye, target, ...)`` is a ``PerspectiveCamera``; its arguments are described there.

    Others are made by ``Camera.orthographic``, ``Camera.from_opencv`` and ``Camera.from_matrix``, and those that see all of
    something by ``Camera.framing`` and ``Camera.tight_framing``. All are frozen, compare equal by their values, and are cameras
    to ``isinstance``.
    """

    # Filled by the files of the kinds, which import this one; the package imports them all.
    _kinds: ClassVar[dict[str, Any]] = {}

    def __init_subclass__(cls, kind: str | None = None) -> None:
        if kind is not None:
            Camera._kinds[kind] = cls

    @_for_every_kind
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
    ) -> PerspectiveCamera:
        """The arguments are those of ``PerspectiveCamera``."""
        raise NotImplementedError

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
        outward, up = outward_and_up(op, azimuth, elevation, up_axis)
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
        distance, fov_y = positive(op, "distance", distance), field_of_view(op, "fov_y", fov_y)
        radius = 0.5 * length(subtract(high, low)) or 1.0
        if not math.isfinite(radius):
            raise ValueError(f"bigtri.{op}: bounds must have a diagonal below 1e154, got {[list(low), list(high)]}")
        center = (0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), 0.5 * (low[2] + high[2]))
        aspect = positive(op, "aspect", aspect)
        if orthographic:
            away, height = 2 * radius, 2 * radius * distance * max(1.0, 1 / aspect)
            where = (center, away, azimuth, elevation, up_axis)
            return Camera._kinds["orthographic"].orbit(*where, height=height, near=0.5 * radius, far=2 * (away + radius))
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
        fov_y = field_of_view(op, "fov_y", fov_y)
        outward, up = outward_and_up(op, azimuth, elevation, up_axis)
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
            return Camera._kinds["orthographic"](eye, target, up, height / free, near, far)
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
        return Camera._kinds["orthographic"](eye, target, up, height, near, far)

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
        intrinsics, rotation = square_matrix(op, "K", K, 3), square_matrix(op, "R", R, 3)
        shift = numbers(op, "t", t)
        if shift.shape not in ((3,), (3, 1)):
            raise ValueError(f"bigtri.{op}: t must be [3] or [3, 1], got {list(shift.shape)}")
        return Camera._kinds["pinhole"](intrinsics, rotation, vector(op, "t", shift.ravel()), resolution, near, far, pixel_centre)

    @staticmethod
    def from_matrix(matrix: ArrayLike) -> MatrixCamera:
        """The camera of a matrix [4, 4] from world space to clip space (OpenGL: -w <= x, y, z <= w), for column vectors.

        It has the aspect of the picture in it, and near and far. Of a view matrix V, from world space to a camera that looks
        along -z, and a projection P it is P @ V.

        Raises:
            TypeError, ValueError: something else.
        """
        return Camera._kinds["matrix"](square_matrix("Camera.from_matrix", "matrix", matrix, 4))

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

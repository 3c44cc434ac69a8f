"""How far away a camera has to be, and what its near and far planes have to hold, for all of something to be seen."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .vectors import Vector, affine

# Near and far keep this part of the farthest distance away from what they hold, so that no rounding clips it.
_SLACK = 2.0**-6
# Near is at least this part of far: below, window depth would tell little apart that is far away.
_NEAREST = 1e-4
# The eye keeps this part of the size of what it sees away from it.
_CLOSEST = 1e-2
# Whose bounds take at least this part of a picture probably touches more than half of it.
_FILLS = 0.85
# Of what turns, as many slices, and corners of the ring around each at least.
_SLICES, _CORNERS = 64, 48


class View(NamedTuple):
    """Points as a camera of known direction sees them, along its own axes: float64 [N] each."""

    right: NDArray[np.float64]
    up: NDArray[np.float64]
    ahead: NDArray[np.float64]

    @staticmethod
    def of(points: NDArray[np.float64], right: Vector, up: Vector, ahead: Vector) -> View:
        """Of points [N, 3]."""
        return View(*(affine(np.array([*axis, 0.0]), points) for axis in (right, up, ahead)))

    @property
    def size(self) -> float:
        """The largest extent along an axis; 1 where all points are one."""
        return max(float(np.ptp(axis)) for axis in self) or 1.0

    def eye(self, tangents: tuple[float, float]) -> Vector:
        """The nearest eye from which all points are in the picture, along the axes.

        Args:
            tangents: of half the fields of view, across and upwards.
        """
        bounds = []
        for side, tangent in zip((self.right, self.up), tangents, strict=True):
            # A point is inside of one border if side - eye <= tangent (ahead - eye's), and of the other if -side does the same:
            # two lines that cross where both are as near as they can be.
            low, high = float((side + tangent * self.ahead).min()), float((side - tangent * self.ahead).max())
            bounds.append((0.5 * (low + high), 0.5 * (low - high) / tangent))
        closest = float(self.ahead.min()) - _CLOSEST * self.size
        return bounds[0][0], bounds[1][0], min(bounds[0][1], bounds[1][1], closest)

    def box(self, aspect: float) -> tuple[float, float, float]:
        """(right, up) of the middle, and the height of the smallest picture of this aspect that shows all points."""
        left, right, bottom, top = (float(edge) for side in (self.right, self.up) for edge in (side.min(), side.max()))
        height = max(top - bottom, (right - left) / aspect) or 1.0
        return 0.5 * (left + right), 0.5 * (bottom + top), height


def corners_of(low: Vector, high: Vector) -> NDArray[np.float64]:
    """float64 [8, 3]: the corners of a box."""
    return np.array(list(itertools.product(*zip(low, high, strict=True))), np.float64)


def fills_picture(matrices: NDArray[np.float64], corners: NDArray[np.float64]) -> bool:
    """Whether what lies in a box probably touches most of the pictures that cameras take of it.

    Args:
        matrices: [B, 4, 4], to clip space.
        corners: [8, 3], of the box.
    """
    clip = corners @ matrices[:, :, :3].transpose(0, 2, 1) + matrices[:, None, :, 3]
    w = clip[..., 3:]
    behind = ~(w > 0)
    places = np.clip(clip[..., :2] / np.where(behind, 1.0, w), -1.0, 1.0)
    share = np.prod(places.max(axis=1) - places.min(axis=1), axis=-1) / 4
    # A camera that has a corner beside it or behind it is within the box, or close to it.
    share[behind.any(axis=(1, 2))] = 1.0
    return bool(np.mean(share) >= _FILLS)


def swept(points: NDArray[np.float64], up_axis: str, turns: int) -> NDArray[np.float64]:
    """Points around all that [N, 3] become when they are turned around the up axis through the middle of their bounds.

    Args:
        up_axis: "y" or "z".
        turns: turning the result by a whole number of 1 / turns of a circle makes the same points of it.

    Returns:
        float64 [M, 3], of few points: rings around slices of equal height.
    """
    points = points[np.isfinite(points).all(axis=1)]
    up = "xyz".index(up_axis)
    across = [axis for axis in range(3) if axis != up]
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    offset = points[:, across] - middle[across]
    radius, height = np.sqrt(offset[:, 0] * offset[:, 0] + offset[:, 1] * offset[:, 1]), points[:, up]
    low, high = height.min(), height.max()
    slices = np.minimum((_SLICES * (height - low) / ((high - low) or 1.0)).astype(np.int64), _SLICES - 1)
    widest, lowest, highest = np.zeros(_SLICES), np.full(_SLICES, np.inf), np.full(_SLICES, -np.inf)
    np.maximum.at(widest, slices, radius)
    np.minimum.at(lowest, slices, height)
    np.maximum.at(highest, slices, height)
    used = highest >= lowest
    corners = turns * -(-_CORNERS // turns)
    angle = 2 * np.pi / corners * np.arange(corners)
    # A ring's polygon goes around its circle.
    out = np.tile(widest[used], 2) / np.cos(np.pi / corners)
    rings = np.empty((len(out), corners, 3))
    rings[..., across[0]] = middle[across[0]] + out[:, None] * np.cos(angle)
    rings[..., across[1]] = middle[across[1]] + out[:, None] * np.sin(angle)
    rings[..., up] = np.concatenate([lowest[used], highest[used]])[:, None]
    return rings.reshape(-1, 3)


def depth_range(nearest: float, farthest: float, perspective: bool) -> tuple[float, float]:
    """(near, far) that hold everything between two distances along the view, of which with perspective the farther is > 0."""
    if not perspective:
        slack = _SLACK * (farthest - nearest) or _SLACK
        return nearest - slack, farthest + slack
    far = farthest * (1 + _SLACK)
    return max(nearest * (1 - _SLACK), far * _NEAREST), far

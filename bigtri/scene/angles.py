"""Angles as callers give them, in degrees: directions around something, and fields of view."""

from __future__ import annotations

import math
from typing import Any

from .. import warn
from .vectors import Vector, number


def outward_and_up(op: str, azimuth: Any, elevation: Any, up_axis: str) -> tuple[Vector, Vector]:
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


def field_of_view(owner: str, name: str, value: Any) -> float:
    """A field of view in degrees, checked."""
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

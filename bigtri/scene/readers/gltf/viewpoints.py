"""Cameras and lights of glTF, in world space. No picture has them of its own accord: they are carried."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ...camera import Camera, Vector
from ...carried import Lamp
from .document import Document
from .extensions import LIGHTS
from .json_values import JsonObject

# Where glTF has no farthest distance it means infinity: this multiple of the nearest one, then.
_FAR = 1e6


def add_camera(document: Document, node: JsonObject, matrix: NDArray[np.float64]) -> None:
    """Adds the camera of a node, if it has one, to the model.

    Args:
        matrix: float64 [4, 4], from the node's space to that of the world.
    """
    camera = document.follow(node, "camera", "cameras")
    if camera is None:
        return
    found = document.model.found
    if camera.text("type") != "perspective":
        found("orthographic cameras", "a camera without perspective is left out: bigtri has none")
        return
    settings = camera.object("perspective")
    angle, near = math.degrees(settings.number("yfov", 0.0)), settings.number("znear", 0.0)
    far = settings.number("zfar", near * _FAR)
    forward = -matrix[:3, 2]
    length = float(np.sqrt((forward * forward).sum())) or 1.0
    try:
        eye = _vector(matrix[:3, 3])
        seen = Camera(eye, _vector(matrix[:3, 3] + forward / length), _vector(matrix[:3, 1]), angle, near, far)
    except ValueError as error:
        found("cameras that see nothing", f"{camera.place} is left out: {error}")
        return
    document.model.cameras.append(seen)
    found("cameras", "a camera is in Scene.cameras, but not what the picture is seen from")


def add_lamp(document: Document, node: JsonObject, matrix: NDArray[np.float64]) -> None:
    """Adds the light of a node, if it has one, to the model; arguments as for ``add_camera``."""
    reference = node.extension(LIGHTS)
    if reference is None:
        return
    lights = (document.root.extension(LIGHTS) or JsonObject({}, f"extensions.{LIGHTS}")).objects("lights")
    light = lights[reference.index("light", len(lights), "lights")]
    spot = light.object("spot")
    cone = (spot.number("innerConeAngle", 0.0), spot.number("outerConeAngle", math.pi / 4))
    red, green, blue = light.numbers("color", (1.0, 1.0, 1.0))
    found = document.model.found
    try:
        lamp = Lamp(
            light.text("type"),
            _vector(matrix[:3, 3]),
            _vector(-matrix[:3, 2]),
            (red, green, blue),
            light.number("intensity", 1.0),
            light.number("range", 0.0) or None,
            (math.degrees(cone[0]), math.degrees(cone[1])),
        )
    except ValueError as error:
        found("lights that are none", f"{light.place} is left out: {error}")
        return
    document.model.lamps.append(lamp)
    found("lights", f"a light ({LIGHTS}) is in Scene.lamps, but the picture is lit by others")


def _vector(values: NDArray[np.float64]) -> Vector:
    x, y, z = values.tolist()
    return x, y, z

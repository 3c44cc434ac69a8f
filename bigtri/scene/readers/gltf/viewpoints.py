"""Cameras and lights of glTF, in world space. No picture has them of its own accord: they are carried."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ...camera import Camera
from ...carried import Lamp
from ...vectors import Vector
from ..model import ModelError
from .document import Document
from .extensions import LIGHTS
from .json_values import JsonObject


def add_camera(document: Document, node: JsonObject, matrix: NDArray[np.float64]) -> None:
    """Adds the camera of a node, if it has one, to the model.

    Args:
        matrix: float64 [4, 4], from the node's space to that of the world.
    """
    camera = document.follow(node, "camera", "cameras")
    if camera is None:
        return
    found = document.model.found
    forward = -matrix[:3, 2]
    length = float(np.sqrt((forward * forward).sum())) or 1.0
    try:
        eye = _vector(matrix[:3, 3])
        pose = (eye, _vector(matrix[:3, 3] + forward / length), _vector(matrix[:3, 1]))
        document.model.cameras.append(_of_kind(camera, pose))
    except ModelError:
        raise
    except ValueError as error:
        found("cameras that see nothing", f"{camera.place} is left out: {error}")
        return
    found("cameras", "a camera is in Scene.cameras: a picture is seen from it only if that is asked for")


def _of_kind(camera: JsonObject, pose: tuple[Vector, Vector, Vector]) -> Camera:
    """The camera at a pose: eye, target, up.

    The picture has an aspect of its own, so that the camera's width means nothing. Without a farthest distance, far is None.

    Raises:
        ValueError: it sees nothing.
    """
    if camera.text("type") == "orthographic":
        settings = camera.object("orthographic")
        height = 2 * abs(settings.number("ymag", 0.0))
        return Camera.orthographic(*pose, height, settings.number("znear", 0.0), settings.number("zfar", 0.0))
    settings = camera.object("perspective")
    angle, near = math.degrees(settings.number("yfov", 0.0)), settings.number("znear", 0.0)
    far = settings.number("zfar", 0.0) if "zfar" in settings else None
    return Camera(*pose, angle, near, far)


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

"""The work of ``bigtri render``: from its options to cameras, pictures and files."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..choices import VIEWS
from ..ops.shading import decode_srgb
from ..reference.numerics import MAX_SIZE
from ..rendering import depth_file, figure, views
from ..scene import load_scene
from ..scene.camera import Camera
from ..scene.fit import swept
from ..scene.scene import Scene
from ..scene.vectors import Vector

Progress = Callable[[str], None]
T = TypeVar("T")

_STILL = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
_ANIMATED = (".gif", ".webp", ".apng")
# Without an alpha channel.
_OPAQUE = (".jpg", ".jpeg", ".bmp")
# Options that do not go together: each with those that would mean nothing beside it.
_ALONE = {
    "camera": ("azimuth", "elevation", "distance", "tight", "fov", "orthographic", "up", "turntable"),
    "tight": ("distance",),
    "orthographic": ("fov",),
    "transparent": ("background",),
}
# Of a camera, as ``cameras_of`` takes them.
CAMERA = (*_ALONE["camera"], "camera", "near", "far")


def run(options: argparse.Namespace, say: Progress) -> list[Path]:
    """Draw what the options ask for.

    Args:
        options: as ``render_options`` has them.
        say: gets a line before each longer step.

    Returns:
        The files written.

    Raises:
        OSError, ValueError: an option or a file that is wrong; the text names it.
    """
    _check(options)
    started = time.perf_counter()
    width, height = options.size
    say(f"reading {options.model}")
    scene = load_scene(options.model, strict=options.strict).with_(cull=options.cull)
    say(f"{len(scene.triangles)} triangles, {len(scene.used_materials)} materials")
    cameras = cameras_of(options, scene, width / height)
    written = []
    for view in VIEWS if options.view == "all" else (options.view,):
        say(f"drawing {view}")
        drawn = (_picture(options, view, scene, camera) for camera in _said(cameras, say))
        written += _save(options, view, drawn, len(cameras))
    if options.depth is not None:
        say("drawing depths")
        scale = depth_file.SCALE if options.depth_scale is None else options.depth_scale
        for path, camera in zip(_numbered(options.depth, len(cameras)), _said(cameras, say), strict=True):
            distance = depth_file.distances(scene, camera, (height, width), backend=options.backend)
            written.append(depth_file.save(path, distance, scale))
    say(f"done in {time.perf_counter() - started:.1f} s")
    return written


def _check(options: argparse.Namespace) -> None:
    """Complain before the work is done, not after."""
    _check_path("--out", options.out, _STILL + _ANIMATED)
    width, height = options.size
    most = MAX_SIZE // max(width, height)
    if options.view in ("shaded", "all") and options.supersample > most:
        raise ValueError(f"--supersample must be at most {most} at {width}x{height} px, got {options.supersample}")
    for name in ("threshold", "triangle"):
        if getattr(options, name) is not None and options.view not in ("bins", "all"):
            raise ValueError(f"--{name} must be given with --view bins, got --view {options.view}")
    check_together(options)
    for name in ("background", "transparent"):
        if is_given(options, name) and options.view not in ("shaded", "all"):
            raise ValueError(f"--{name} must be given with --view shaded, got --view {options.view}")
    if options.background is not None and len(options.background) > 2:
        raise ValueError(f"--background must be one colour, or two, got {len(options.background)}")
    if options.transparent and options.out.suffix.lower() in _OPAQUE:
        raise ValueError(f"--out must not end in {', '.join(_OPAQUE)} with --transparent, got {options.out.name!r}")
    if options.depth is not None:
        _check_path("--depth", options.depth, depth_file.KINDS)
    if options.depth_scale is not None:
        if options.depth is None or options.depth.suffix.lower() != ".png":
            raise ValueError("--depth-scale must be given with --depth FILE.png: other files have the model's units")
        if not 0 < options.depth_scale < np.inf:
            raise ValueError(f"--depth-scale must be positive and finite, got {options.depth_scale}")


def check_together(options: argparse.Namespace) -> None:
    """Complain of options that do not go together."""
    for alone, others in _ALONE.items():
        for other in others:
            if is_given(options, alone) and is_given(options, other):
                raise ValueError(f"--{other} must not be given with --{alone}, beside which it means nothing")


def is_given(options: argparse.Namespace, name: str) -> bool:
    """Whether the command has the option, and it was given."""
    value = getattr(options, name, None)
    return value is not None and value is not False  # 0 is a camera


def _check_path(option: str, path: Path, kinds: tuple[str, ...]) -> None:
    if path.suffix.lower() not in kinds:
        raise ValueError(f"{option} must end in {', '.join(kinds)}, got {path.name!r}")
    if not path.parent.is_dir():
        raise ValueError(f"{option} must be in a folder that is there, got {path.parent}: make it first")
    if path.is_dir():
        raise ValueError(f"{option} must be a file, got the folder {path}")


def cameras_of(options: argparse.Namespace, scene: Scene, aspect: float) -> list[Camera]:
    """One for each picture; options: those of ``CAMERA``."""
    if options.camera is not None:
        if options.camera >= len(scene.cameras):
            raise ValueError(f"--camera must be one of the file's {len(scene.cameras)}, from 0, got {options.camera}")
        cameras = [scene.cameras[options.camera].fitted(scene.bounds)]
    else:
        azimuths = [30.0] if options.azimuth is None else options.azimuth
        frames = options.turntable or 1
        azimuths = [azimuth + 360 * frame / frames for azimuth in azimuths for frame in range(frames)]
        cameras = list(_around(options, scene, azimuths, aspect))
    if options.near is None and options.far is None:
        return cameras
    given = ((options.near, options.far, *camera.depth_range) for camera in cameras)
    planes = [(low if near is None else near, high if far is None else far) for near, far, low, high in given]
    return [camera.with_depth_range(*pair) for camera, pair in zip(cameras, planes, strict=True)]


def _around(options: argparse.Namespace, scene: Scene, azimuths: list[float], aspect: float) -> Iterator[Camera]:
    elevation = 20.0 if options.elevation is None else options.elevation
    distance = 1.0 if options.distance is None else options.distance
    up_axis = options.up or "y"
    lens: dict[str, Any] = {
        "aspect": aspect,
        "fov_y": 40.0 if options.fov is None else options.fov,
        "up_axis": up_axis,
        "orthographic": options.orthographic,
    }
    if not options.tight:
        for azimuth in azimuths:
            yield Camera.framing(scene.bounds, azimuth, elevation, distance, **lens)
        return
    # All that a turntable shows fits one picture, so that nothing grows and shrinks from one to the next.
    points = swept(scene.points, up_axis, options.turntable) if options.turntable else scene.points
    for azimuth in azimuths:
        yield Camera.tight_framing(points, azimuth, elevation, **lens)


def _picture(options: argparse.Namespace, view: str, scene: Scene, camera: Camera) -> NDArray[np.uint8]:
    width, height = options.size
    return views.picture(
        view,
        scene,
        camera,
        (height, width),
        backend=options.backend,
        supersample=options.supersample,
        triangle=options.triangle,
        threshold=options.threshold,
        transparent=options.transparent,
        background=None if options.background is None else _linear(options.background),
    )


def _linear(colors: list[tuple[int, int, int]]) -> tuple[Vector, Vector]:
    """The colours at the top and at the bottom, of one or two in sRGB codes."""
    top, bottom = (decode_srgb(np.array(codes, np.uint8)).tolist() for codes in (colors[0], colors[-1]))
    return (top[0], top[1], top[2]), (bottom[0], bottom[1], bottom[2])


def _save(options: argparse.Namespace, view: str, pictures: Iterable[NDArray[np.uint8]], count: int) -> list[Path]:
    """Writes the pictures of one view, as they come."""
    suffix = f"-{view}" if options.view == "all" else ""
    path = options.out.with_stem(options.out.stem + suffix)
    if path.suffix.lower() in _ANIMATED:
        return [figure.save_animation(path, list(pictures), 1 / options.fps)]
    paths = [one.with_stem(one.stem + suffix) for one in _numbered(options.out, count)]
    return [figure.save(one, picture) for one, picture in zip(paths, pictures, strict=True)]


def _numbered(path: Path, count: int) -> list[Path]:
    """The path, or where there are several, as many with a number each, from 0, all of the same length."""
    if count == 1:
        return [path]
    digits = len(str(count - 1))
    return [path.with_stem(f"{path.stem}-{number:0{digits}}") for number in range(count)]


def _said(items: list[T], say: Progress) -> Iterator[T]:
    """The items; whenever a second has gone by, how far it is."""
    last = time.perf_counter()
    for number, item in enumerate(items):
        now = time.perf_counter()
        if now - last >= 1:
            last = now
            say(f"  {number} of {len(items)}")
        yield item

"""From a scene and cameras to pictures, in one pass: transform, draw, and each pixel finished where it is drawn."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias, overload

import numpy as np
import torch
from numpy.typing import NDArray

from ..ops import arguments, memory
from ..ops.arguments import Array
from ..ops.rasterize import Visibility
from ..ops.shade import Made, draw, new_made
from ..ops.transform import transform
from ..precision import DEFAULT, Arithmetic, Precision
from ..reference.numerics import MAX_SIZE
from ..scene.camera import Camera
from ..scene.load import from_trimesh, load_scene
from ..scene.plan import Plan, RenderPlan, plan_for
from ..scene.scene import Scene, background_of
from ..scene.tensors import SceneTensors
from ..scene.vectors import Vector

# A model by its path, or a mesh or scene of trimesh's.
Drawable: TypeAlias = "SceneTensors | _Loaded | Any"

DEFAULT_RESOLUTION = (720, 1280)  # height, width


class Buffers(NamedTuple):
    """What a picture was made from, at the resolution times supersample. Without the [B] where one camera was given.

    NumPy; tensors on the scene's device where ``render`` was given ``SceneTensors``.
    """

    positions: Any  # float32 [B, V, 4], clip space
    visibility: Visibility  # [B, H, W]
    albedo: Any  # float32 [B, H, W, 3], linear, 0 on the background
    normals: Any  # float32 [B, H, W, 3], as they were lit, of any length, 0 on the background; None without lights
    linear: Any  # float32 [B, H, W, 3], lit, with the background
    seconds: dict[str, float]  # wall clock of each step; on CUDA, until its work was handed over


if TYPE_CHECKING:
    from typing_extensions import TypedDict, Unpack

    class _Options(TypedDict, total=False):
        """What has no say in the type of the result."""

        backend: str
        plan: RenderPlan | Plan | None
        supersample: int
        precision: str | Precision
        transparent: bool
        background: Vector | Sequence[Vector] | None


_Loaded: TypeAlias = "Scene | str | os.PathLike[str]"  # and trimesh's, which type checkers know nothing of
_Cameras: TypeAlias = "Camera | Sequence[Camera] | None"
_Size: TypeAlias = "tuple[int, int] | None"
_Pixels: TypeAlias = "NDArray[np.uint8]"


@overload
def render(
    scene: SceneTensors,
    camera: _Cameras = ...,
    resolution: _Size = ...,
    *,
    return_buffers: Literal[False] = ...,
    **options: Unpack[_Options],
) -> torch.Tensor: ...
@overload
def render(
    scene: SceneTensors,
    camera: _Cameras = ...,
    resolution: _Size = ...,
    *,
    return_buffers: Literal[True],
    **options: Unpack[_Options],
) -> tuple[torch.Tensor, Buffers]: ...
@overload
def render(
    scene: _Loaded,
    camera: _Cameras = ...,
    resolution: _Size = ...,
    *,
    return_buffers: Literal[False] = ...,
    **options: Unpack[_Options],
) -> _Pixels: ...
@overload
def render(
    scene: _Loaded,
    camera: _Cameras = ...,
    resolution: _Size = ...,
    *,
    return_buffers: Literal[True],
    **options: Unpack[_Options],
) -> tuple[_Pixels, Buffers]: ...
def render(
    scene: Drawable,
    camera: _Cameras = None,
    resolution: _Size = None,
    *,
    backend: str = "auto",
    plan: RenderPlan | Plan | None = None,
    supersample: int = 1,
    precision: str | Precision = DEFAULT,
    transparent: bool = False,
    background: Vector | Sequence[Vector] | None = None,
    return_buffers: bool = False,
) -> Any:
    """Draw a scene as ``camera`` sees it, or as each of several cameras does, in one call.

    Args:
        scene: a ``Scene``; the path of a model file, or a mesh or a scene of trimesh, which are made one as ``load_scene`` and
            ``from_trimesh`` do; or ``Scene.on(device)``, whose pictures are tensors on that device.
        camera: one, or a sequence of B cameras; None: one that has all of the scene in the picture (``Camera.framing``).
        resolution: (height, width), px; times ``supersample`` 1 to 16384 each. 720 x 1280 where it is left out.
        backend: "auto", "reference" or "native"; the bits are the same.
        plan: the effects to run; None: those that the scene calls for. One that leaves out what the scene calls for warns.
        supersample: N: samples per pixel along each axis, averaged in linear light.
        precision: what is drawn with, but for depth that is reversed, which a camera's is not.
        transparent: whether the picture has alpha: 0 where nothing is seen, and of the samples that are covered the mean colour,
            not multiplied by alpha.
        background: a linear colour, or two, at the top and at the bottom of the picture; None: the scene's.
        return_buffers: also return what the picture was made from.

    Returns:
        uint8 [H, W, 3], sRGB, row 0 on top, or [H, W, 4] with alpha; [B, ...] for a sequence of cameras. NumPy, but a tensor for
        ``SceneTensors``. With ``return_buffers`` a pair of it and ``Buffers``.

    Raises:
        TypeError: an argument of another type; the text names it.
        ValueError: no camera, a supersample below 1, a background beside ``transparent``, or what ``rasterize`` does not take.
    """
    op = "render"
    if camera is not None:
        _check_type("camera", camera, (Camera, Sequence), "a Camera or a sequence of them")
    if not (isinstance(supersample, int) and supersample >= 1):
        raise ValueError(f"bigtri.{op}: supersample must be a whole number of at least 1, got {supersample!r}")
    _check_type("plan", plan, (RenderPlan, Plan, type(None)), "a RenderPlan, what Scene.plan returns, or None")
    arithmetic = arguments.check_precision(op, precision)
    if arithmetic.reversed:
        raise ValueError(
            f"bigtri.{op}: precision must be one that takes window depth, which is what a Camera makes, got {precision!r}"
        )
    chosen = arguments.choose_backend(op, backend)
    arguments.check_flag(op, "return_buffers", return_buffers)
    arguments.check_flag(op, "transparent", transparent)
    if transparent and background is not None:
        raise ValueError(f"bigtri.{op}: background must be None where transparent is True, got {background!r}")
    size = DEFAULT_RESOLUTION if resolution is None else resolution
    rows, columns = arguments.check_image_size(op, "resolution", size)
    if max(rows, columns) * supersample > MAX_SIZE:
        raise ValueError(
            f"bigtri.{op}: supersample must be such that {(rows, columns)} times it is at most {MAX_SIZE}, got {supersample}"
        )
    tensors = _tensors_of(scene)
    switches = _switches_of(plan, tensors.scene)
    cameras = _cameras_of(camera, tensors.scene, columns / rows)
    colors = tensors.scene.background if background is None else background_of(op, background)
    picture = _Picture(rows, columns, supersample, 4 if transparent else 3)

    image, buffers = _draw(tensors, cameras, picture, switches, colors, arithmetic, chosen, return_buffers)
    view = 0 if isinstance(camera, Camera) or camera is None else slice(None)

    def finished(value: torch.Tensor) -> Array:
        return value[view] if isinstance(scene, SceneTensors) else value.numpy()[view]

    if buffers is None:
        return finished(image)
    positions, seen, made, seconds = buffers
    albedo, normals, linear = (None if one is None else finished(one) for one in made)
    assert albedo is not None and linear is not None
    visibility = Visibility(*map(finished, seen))
    return finished(image), Buffers(
        positions=finished(positions),
        visibility=visibility,
        albedo=albedo,
        normals=normals if switches.lights else None,
        linear=linear,
        seconds=seconds,
    )


class _Picture(NamedTuple):
    rows: int
    columns: int
    samples: int  # of a pixel along each axis
    channels: int


_Seen: TypeAlias = tuple[torch.Tensor, torch.Tensor, torch.Tensor]  # as Visibility


def _draw(
    tensors: SceneTensors,
    cameras: Sequence[Camera],
    picture: _Picture,
    plan: RenderPlan,
    background: Sequence[Vector],
    arithmetic: Arithmetic,
    backend: str,
    return_buffers: bool,
) -> tuple[torch.Tensor, tuple[torch.Tensor, _Seen, Made, dict[str, float]] | None]:
    """The picture uint8 [B, rows, columns, channels]; where wanted, positions, what is seen, the rest and the times."""
    seconds: dict[str, float] = {}
    with _timed(seconds, "transform"):
        matrices = np.stack([c.matrix(picture.columns / picture.rows, tensors.scene.origin) for c in cameras])
        positions = transform(tensors.positions, torch.from_numpy(matrices).to(tensors.device), backend=backend)
    with _timed(seconds, "draw"):
        views, samples = len(cameras), picture.samples
        image = memory.new(positions, (views, picture.rows, picture.columns, picture.channels), torch.uint8)
        made, seen = Made(), None
        if return_buffers:
            shape = (views, picture.rows * samples, picture.columns * samples)
            made = new_made(positions, shape)
            seen = memory.new(positions, shape, torch.int64), memory.new(positions, shape, torch.float32)
        surface, cull = tensors.surface(plan, background), tensors.scene.cull
        given = positions, tensors.triangles, cull, surface, image, samples, made, seen, arithmetic, backend
        dropped = draw(*given, fills=tensors.device.type == "cuda" and tensors.fills_picture(matrices))
    return image, None if seen is None else (positions, (*seen, dropped), made, seconds)


def _switches_of(plan: RenderPlan | Plan | None, scene: Scene) -> RenderPlan:
    if plan is None:
        return plan_for(scene)
    return plan.switches if isinstance(plan, Plan) else plan.checked(scene)


def _tensors_of(scene: Drawable) -> SceneTensors:
    if isinstance(scene, SceneTensors):
        return scene
    if isinstance(scene, str | os.PathLike):
        scene = load_scene(scene)
    elif not isinstance(scene, Scene) and type(scene).__module__.partition(".")[0] == "trimesh":
        scene = from_trimesh(scene)
    _check_type("scene", scene, Scene, "a Scene, what Scene.on returns, a path, or a mesh or scene of trimesh")
    return scene.on("cpu")


def _cameras_of(camera: Camera | Sequence[Camera] | None, scene: Scene, aspect: float) -> list[Camera]:
    if camera is None:
        return [Camera.framing(scene.bounds, aspect=aspect)]
    cameras = [camera] if isinstance(camera, Camera) else list(camera)
    for one in cameras:
        _check_type("camera", one, Camera, "a Camera or a sequence of them")
    if not cameras:
        raise ValueError("bigtri.render: camera must be a Camera or a sequence of at least one, got none")
    return cameras


def _check_type(name: str, value: object, allowed: type | tuple[type, ...], wanted: str) -> None:
    """Raise TypeError unless ``value`` is of an ``allowed`` type; ``wanted`` says which."""
    if not isinstance(value, allowed):
        raise TypeError(f"bigtri.render: {name} must be {wanted}, got {arguments.described(value)}")


def _tensor(value: Array | None) -> torch.Tensor:
    """What the operations return for tensors, said to the type checker."""
    assert isinstance(value, torch.Tensor)
    return value


@contextmanager
def _timed(seconds: dict[str, float], name: str) -> Iterator[None]:
    start = time.perf_counter()
    yield
    seconds[name] = time.perf_counter() - start

"""From a scene and cameras to pictures: rasterize, interpolate, sample_texture, lambert and encode_srgb put together."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Literal, NamedTuple, overload

import numpy as np
import torch
from numpy.typing import NDArray

from ..ops import arguments, memory
from ..ops.arguments import Array
from ..ops.rasterize import Visibility
from ..ops.shade import Made, draw, new_made
from ..precision import DEFAULT, Precision
from ..reference.numerics import MAX_SIZE
from ..scene.camera import Camera
from ..scene.plan import RenderPlan, plan_for
from ..scene.scene import Scene


class Buffers(NamedTuple):
    """What a picture was made from, at the resolution times supersample. Without the [B] where one camera was given."""

    positions: NDArray[np.float32]  # [B, V, 4], clip space
    visibility: Visibility  # NumPy arrays [B, H, W]
    albedo: NDArray[np.float32]  # [B, H, W, 3], linear, 0 on the background
    normals: NDArray[np.float32] | None  # [B, H, W, 3], as they were lit, of any length; None without lights
    linear: NDArray[np.float32]  # [B, H, W, 3], lit, with the background
    seconds: dict[str, float]  # wall clock of each step


@overload
def render(
    scene: Scene,
    camera: Camera | Sequence[Camera],
    resolution: tuple[int, int],
    *,
    backend: str = ...,
    plan: RenderPlan | None = ...,
    supersample: int = ...,
    precision: str | Precision = ...,
    return_buffers: Literal[False] = ...,
) -> NDArray[np.uint8]: ...


@overload
def render(
    scene: Scene,
    camera: Camera | Sequence[Camera],
    resolution: tuple[int, int],
    *,
    backend: str = ...,
    plan: RenderPlan | None = ...,
    supersample: int = ...,
    precision: str | Precision = ...,
    return_buffers: Literal[True],
) -> tuple[NDArray[np.uint8], Buffers]: ...


def render(
    scene: Scene,
    camera: Camera | Sequence[Camera],
    resolution: tuple[int, int],
    *,
    backend: str = "auto",
    plan: RenderPlan | None = None,
    supersample: int = 1,
    precision: str | Precision = DEFAULT,
    return_buffers: bool = False,
) -> NDArray[np.uint8] | tuple[NDArray[np.uint8], Buffers]:
    """Draw ``scene`` as ``camera`` sees it, or as each of several cameras does, in one call.

    Args:
        scene: what is drawn.
        camera: one, or a sequence of B cameras.
        resolution: (height, width), px; times ``supersample`` 1 to 16384 each.
        backend: "auto", "reference" or "native"; the bits are the same.
        plan: the effects to run; None: those that the scene calls for.
        supersample: N: samples per pixel along each axis, averaged in linear light.
        precision: what ``rasterize`` and ``interpolate`` draw with, but for depth that is reversed, which a camera's is not.
        return_buffers: also return what the picture was made from.

    Returns:
        uint8 [H, W, 3], sRGB, row 0 on top; [B, H, W, 3] for a sequence of cameras. With ``return_buffers`` a pair of it and
        ``Buffers``.

    Raises:
        TypeError: an argument of another type; the text names it.
        ValueError: no camera, a supersample below 1, or what ``rasterize`` does not take.
    """
    _check_type("scene", scene, Scene, "a Scene")
    _check_type("camera", camera, (Camera, Sequence), "a Camera or a sequence of them")
    cameras = [camera] if isinstance(camera, Camera) else list(camera)
    for one in cameras:
        _check_type("camera", one, Camera, "a Camera or a sequence of them")
    if not cameras:
        raise ValueError("bigtri.render: camera must be a Camera or a sequence of at least one, got none")
    if not (isinstance(supersample, int) and supersample >= 1):
        raise ValueError(f"bigtri.render: supersample must be a whole number of at least 1, got {supersample!r}")
    _check_type("plan", plan, (RenderPlan, type(None)), "a RenderPlan or None")
    if arguments.check_precision("render", precision).reversed:
        raise ValueError(
            f"bigtri.render: precision must be one that takes window depth, which is what a Camera makes, got {precision!r}"
        )
    arguments.check_flag("render", "return_buffers", return_buffers)
    rows, columns = arguments.check_image_size("render", "resolution", resolution)
    height, width = rows * supersample, columns * supersample
    if max(height, width) > MAX_SIZE:
        raise ValueError(
            f"bigtri.render: supersample must be such that {(rows, columns)} times it is at most {MAX_SIZE}, got {supersample}"
        )
    plan = plan_for(scene) if plan is None else plan
    tensors = scene.on("cpu")
    seconds: dict[str, float] = {}
    chosen = arguments.choose_backend("render", backend)
    arithmetic = arguments.check_precision("render", precision)

    with _timed(seconds, "transform"):
        clip = np.stack([c.transform(scene.positions, columns / rows, scene.origin) for c in cameras])
    positions = torch.from_numpy(clip)
    with _timed(seconds, "draw"):
        image = memory.new(positions, (len(cameras), rows, columns, 3), torch.uint8)
        made, seen = Made(), None
        if return_buffers:
            shape = (len(cameras), height, width)
            made = new_made(positions, shape)
            seen = memory.new(positions, shape, torch.int64), memory.new(positions, shape, torch.float32)
        surface = tensors.surface(plan, scene.background)
        dropped = draw(*(positions, tensors.triangles, scene.cull, surface, image, supersample, made, seen, arithmetic, chosen))

    view = 0 if isinstance(camera, Camera) else slice(None)
    if seen is None:
        return image.numpy()[view]
    albedo, normals, linear = (_tensor(one).numpy()[view] for one in made)
    return image.numpy()[view], Buffers(
        positions=clip[view],
        visibility=Visibility(*(field.numpy()[view] for field in (*seen, dropped))),
        albedo=albedo,
        normals=normals if plan.lights else None,
        linear=linear,
        seconds=seconds,
    )


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

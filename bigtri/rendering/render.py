"""From a scene and cameras to pictures: rasterize, interpolate, sample_texture, lambert and encode_srgb put together."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Literal, NamedTuple, overload

import numpy as np
import torch
from numpy.typing import NDArray

from ..ops import arguments
from ..ops.arguments import Array
from ..ops.interpolate import interpolate
from ..ops.rasterize import Visibility, rasterize
from ..ops.shading import encode_srgb, lambert
from ..ops.texture import sample_texture
from ..precision import DEFAULT, Precision
from ..reference.numerics import MAX_SIZE
from ..scene.camera import Camera
from ..scene.normals import face_normals
from ..scene.plan import RenderPlan, plan_for
from ..scene.scene import Material, Scene


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
    seconds: dict[str, float] = {}

    with _timed(seconds, "transform"):
        clip = np.stack([c.transform(scene.positions, columns / rows, scene.origin) for c in cameras])
    positions, triangles = torch.from_numpy(clip), torch.from_numpy(scene.triangles)
    with _timed(seconds, "rasterize"):
        seen = rasterize(
            positions,
            triangles,
            (height, width),
            backend=backend,
            precision=precision,
            cull=scene.cull,
            depth=return_buffers,
        )
    with _timed(seconds, "attributes"):
        attributes = _interpolated(scene, plan, seen, positions, triangles, backend, precision)
    surface = _Surface(scene, seen)
    with _timed(seconds, "texture"):
        albedo = _albedo(scene, plan, surface, attributes, backend)
    with _timed(seconds, "shading"):
        normals = _normals(scene, plan, surface, attributes, clip) if plan.lights else None
        linear = _lit(scene, plan, surface, albedo, normals, backend)
        image = encode_srgb(_averaged(linear, supersample), backend=backend).numpy()

    view = 0 if isinstance(camera, Camera) else slice(None)
    if not return_buffers:
        return image[view]
    return image[view], Buffers(
        positions=clip[view],
        visibility=Visibility(*(_tensor(field).numpy()[view] for field in seen)),
        albedo=albedo.numpy()[view],
        normals=None if normals is None else normals.numpy()[view],
        linear=linear.numpy()[view],
        seconds=seconds,
    )


class _Surface:
    """What is seen at every pixel: the triangle and the material, 0 on the background, and where that is."""

    def __init__(self, scene: Scene, seen: Visibility) -> None:
        triangle = _tensor(seen.triangle)
        self.covered = triangle >= 0  # bool [B, H, W]
        self.triangle = triangle.clamp(min=0).long()
        self.material = self._per_triangle(torch.from_numpy(scene.material)).long()

    def of_material(self, values: Sequence[Any], dtype: torch.dtype) -> torch.Tensor:
        """``values``, one per material (a number or a triple), at every pixel: [B, H, W] or [B, H, W, 3]."""
        return torch.tensor(values, dtype=dtype, device="cpu")[self.material]

    def sorted_by_material(self, materials: list[int], count: int) -> tuple[torch.Tensor, list[int]]:
        """The covered pixels of ``materials`` (of ``count``), one after the other: flat indices int64 [P]; how many each has."""
        others = len(materials)
        # The narrowest type: of 8 and 16 bits NumPy sorts by radix.
        place = np.full(count, others, np.min_scalar_type(others))
        place[materials] = np.arange(others)
        key = np.where(self.covered.numpy(), place[self.material.numpy()], place.dtype.type(others)).reshape(-1)
        counts = np.bincount(key, minlength=others + 1)[:others].tolist()
        order = np.argsort(key, kind="stable")[: sum(counts)]
        return torch.from_numpy(order), counts

    def _per_triangle(self, values: torch.Tensor) -> torch.Tensor:
        """``values`` [T, ...] at every pixel; the background reads triangle 0, and a scene without triangles zeros."""
        if len(values) == 0:
            return values.new_zeros(*self.triangle.shape, *values.shape[1:])
        return values[self.triangle]

    def of_triangle(self, values: NDArray[Any]) -> torch.Tensor:
        """``values`` [T, ...] at every pixel: [B, H, W, ...]."""
        return self._per_triangle(torch.from_numpy(values))

    def of_triangle_in_view(self, values: NDArray[np.bool_]) -> torch.Tensor:
        """``values`` [B, T], one row per view, at every pixel: [B, H, W]."""
        views = torch.from_numpy(values)
        if views.shape[1] == 0:
            return torch.zeros_like(self.covered)
        return views.gather(1, self.triangle.flatten(1)).reshape(self.triangle.shape)


def _interpolated(
    scene: Scene,
    plan: RenderPlan,
    seen: Visibility,
    positions: torch.Tensor,
    triangles: torch.Tensor,
    backend: str,
    precision: str | Precision,
) -> dict[str, torch.Tensor]:
    """The vertex attributes that the plan needs and the scene has, [B, H, W, C] each, in one pass over the buffer."""
    wanted = {"uvs": plan.textures, "colors": plan.vertex_colors, "normals": plan.smooth_normals and plan.lights}
    present = {name: getattr(scene, name) for name, on in wanted.items() if on and getattr(scene, name) is not None}
    if not present:
        return {}
    together = torch.from_numpy(np.concatenate(list(present.values()), axis=1))
    result = _tensor(interpolate(together, seen, positions, triangles, backend=backend, precision=precision))
    return dict(zip(present, result.split([a.shape[1] for a in present.values()], dim=-1), strict=True))


def _albedo(scene: Scene, plan: RenderPlan, surface: _Surface, attributes: dict[str, torch.Tensor], backend: str) -> torch.Tensor:
    """float32 [B, H, W, 3]: (base colour * texture) * vertex colour; 0 on the background."""
    albedo = surface.of_material([m.base_color for m in scene.materials], torch.float32)
    if "uvs" in attributes:
        textured = [i for i in scene.used_materials if scene.materials[i].texture is not None]
        pixels, counts = surface.sorted_by_material(textured, len(scene.materials))
        uvs = attributes["uvs"].reshape(-1, 2).index_select(0, pixels).split(counts)
        texels = [_looked_up(scene.materials[i], uv, backend) for i, uv in zip(textured, uvs, strict=True)]
        if texels:
            flat = albedo.view(-1, 3)
            flat.index_copy_(0, pixels, flat.index_select(0, pixels) * torch.cat(texels))
    if "colors" in attributes:
        applies = surface.of_material([m.vertex_colors for m in scene.materials], torch.bool)
        albedo = torch.where(applies[..., None], albedo * attributes["colors"], albedo)
    return torch.where(surface.covered[..., None], albedo, 0.0)


def _looked_up(material: Material, uv: torch.Tensor, backend: str) -> torch.Tensor:
    assert material.texture is not None
    return sample_texture(torch.from_numpy(material.texture), uv, filter=material.filter, wrap=material.wrap, backend=backend)


def _normals(
    scene: Scene, plan: RenderPlan, surface: _Surface, attributes: dict[str, torch.Tensor], clip: NDArray[np.float32]
) -> torch.Tensor:
    """float32 [B, H, W, 3], world space, of any length, towards the viewer where the material is two-sided."""
    smooth = attributes.get("normals")
    if plan.flat_normals:
        normals = surface.of_triangle(face_normals(scene.positions, scene.triangles))
        if smooth is not None:
            is_smooth = surface.of_material([m.smooth for m in scene.materials], torch.bool)
            normals = torch.where(is_smooth[..., None], smooth, normals)
    else:
        normals = torch.zeros(*surface.covered.shape, 3, dtype=torch.float32, device="cpu") if smooth is None else smooth
    if plan.two_sided:
        turned = surface.of_material([m.two_sided for m in scene.materials], torch.bool)
        turned = turned & surface.of_triangle_in_view(_back_facing(clip, scene.triangles))
        normals = torch.where(turned[..., None], -normals, normals)
    return normals


def _back_facing(clip: NDArray[np.float32], triangles: NDArray[np.int32]) -> NDArray[np.bool_]:
    """bool [B, T]: the sign of det(x, y, w) of the corners; clipping does not change it, and no w needs to be positive."""
    x, y, w = (clip[..., i].astype(np.float64)[:, triangles] for i in (0, 1, 3))  # [B, T, 3]
    with np.errstate(over="ignore", invalid="ignore"):
        determinant = (
            x[..., 0] * (y[..., 1] * w[..., 2] - y[..., 2] * w[..., 1])
            - y[..., 0] * (x[..., 1] * w[..., 2] - x[..., 2] * w[..., 1])
        ) + w[..., 0] * (x[..., 1] * y[..., 2] - x[..., 2] * y[..., 1])
        return determinant < 0


def _lit(
    scene: Scene, plan: RenderPlan, surface: _Surface, albedo: torch.Tensor, normals: torch.Tensor | None, backend: str
) -> torch.Tensor:
    """float32 [B, H, W, 3], linear, over the background."""
    ambient = torch.tensor(scene.ambient, dtype=torch.float32, device="cpu")
    if normals is None:
        linear = albedo * ambient
    else:
        vectors = ([light.direction for light in scene.lights], [light.color for light in scene.lights])
        directions, colors = (torch.tensor(v, dtype=torch.float32, device="cpu").reshape(-1, 3) for v in vectors)
        linear = lambert(normals, albedo, ambient, directions, colors, backend=backend)
    return torch.where(surface.covered[..., None], linear, _background(scene, linear.shape[1])[:, None, :])


def _background(scene: Scene, height: int) -> torch.Tensor:
    """float32 [H, 3]."""
    top, bottom = (torch.tensor(color, dtype=torch.float32, device="cpu") for color in scene.background)
    down = (torch.arange(height, dtype=torch.float32, device="cpu") + 0.5) / height
    return top + (bottom - top) * down[:, None]


def _averaged(linear: torch.Tensor, supersample: int) -> torch.Tensor:
    """The mean of every supersample x supersample square, added up row by row."""
    if supersample == 1:
        return linear
    total = torch.zeros_like(linear[:, ::supersample, ::supersample])
    for row in range(supersample):
        for column in range(supersample):
            total = total + linear[:, row::supersample, column::supersample]
    return total / (supersample * supersample)


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

"""Pictures for the tests that compare CUDA with the CPU in bits: what is drawn, how it looks, and what is asked for."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import torch
from cases import random_corners

from bigtri.ops.shade import Made, draw
from bigtri.precision import DEFAULT, RUNGS
from bigtri.reference.shade import Look, Surface


class Picture(NamedTuple):
    """Arguments of ``ops.shade.draw``, on the CPU."""

    positions: torch.Tensor  # float32 [B, V, 4]
    triangles: torch.Tensor  # int32 [T, 3]
    surface: Surface[torch.Tensor]
    resolution: tuple[int, int]  # of the image
    samples: int = 1
    channels: int = 3
    cull: str = "none"
    made: bool = True  # whether to write all that the picture is made from


class Drawn(NamedTuple):
    image: torch.Tensor
    made: Made
    packed: torch.Tensor
    depth: torch.Tensor
    dropped: torch.Tensor


def to_device(picture: Picture, device: str) -> Picture:
    """The same on a device; what the operators want on the CPU stays there."""

    def moved(value):
        if isinstance(value, tuple):
            return tuple(map(moved, value))
        return value.to(device) if isinstance(value, torch.Tensor) else value

    surface = Surface(*(v if name == "constants" else moved(v) for name, v in picture.surface._asdict().items()))
    return picture._replace(positions=moved(picture.positions), triangles=moved(picture.triangles), surface=surface)


def outputs(picture: Picture) -> Drawn:
    """Memory for what a picture gives, full of what it does not."""
    (height, width), n, views = picture.resolution, picture.samples, len(picture.positions)
    shape = views, height * n, width * n

    def full(shape: tuple[int, ...], value: float, dtype: type) -> torch.Tensor:
        # By NumPy: torch's threads do not outlive a fork.
        return torch.from_numpy(np.full(shape, value, dtype)).to(picture.positions.device)

    return Drawn(
        full((views, height, width, picture.channels), 77, np.uint8),
        Made(*(full((*shape, 3), -7, np.float32) for _ in Made._fields)) if picture.made else Made(),
        full(shape, -7, np.int64),
        full(shape, -7, np.float32),
        full((views,), -7, np.int64),
    )


def drawn(picture: Picture, rung: str = DEFAULT, backend: str = "native") -> Drawn:
    """The picture where its tensors are."""
    to = outputs(picture)
    seen = (to.packed, to.depth)
    given = picture.positions, picture.triangles, picture.cull, picture.surface, to.image, picture.samples
    return to._replace(dropped=draw(*given, to.made, seen, RUNGS[rung], backend))


def textures_of(rng: np.random.Generator) -> tuple[torch.Tensor, ...]:
    """Of every kind, in sizes down to a texel."""
    sizes = [(5, 7), (1, 1), (2, 1), (16, 9)]
    linear = [rng.uniform(-0.2, 1.2, (*size, 3)).astype(np.float32) for size in sizes[:2]]
    codes = [rng.integers(0, 256, (*size, 3)).astype(np.uint8) for size in sizes]
    wide = [rng.integers(0, 65536, (*size, 3)).astype(np.uint16) for size in sizes[1:]]
    return tuple(map(torch.from_numpy, [*linear, *codes, *wide]))


def surface_of(rng: np.random.Generator, vertices: int, triangles: int, lights: int = 2, more: int = 0) -> Surface[torch.Tensor]:
    """Every effect, in materials that each ask for something else; with awkward numbers. more: textures, of a texel."""

    def floats(*shape: int, special: tuple[float, ...] = ()) -> torch.Tensor:
        values = rng.normal(size=shape)
        if special:
            rows = rng.choice(shape[0], shape[0] // 8, replace=False)
            values[rows] = rng.choice(special, (len(rows), *shape[1:]))
        return torch.from_numpy(values.astype(np.float32))

    textures = (*textures_of(rng), *(torch.full((1, 1, 3), k / (more + 1)) for k in range(more)))
    materials = 3 * len(textures)
    looks = np.stack([rng.integers(0, 2 * Look.CLAMP, materials), rng.permutation(materials) - len(textures)], 1)
    looks[:, 1] = np.clip(looks[:, 1], -1, len(textures) - 1)
    return Surface(
        uvs=floats(vertices, 2, special=(0.0, 1.0, -0.0, 1e9, np.inf, np.nan)) * 2,
        colors=floats(vertices, 3, special=(0.0, np.inf)).abs(),
        normals=floats(vertices, 3, special=(0.0, 1e30, 1e-30, np.nan)),
        face_normals=floats(triangles, 3),
        material=torch.from_numpy(rng.integers(0, materials, triangles).astype(np.int32)),
        looks=torch.from_numpy(looks.astype(np.int32)),
        base_colors=floats(materials, 3).abs(),
        textures=textures,
        light_directions=floats(lights, 3),
        light_colors=floats(lights, 3),
        constants=floats(3, 3).abs(),
        two_sided=True,
    )


def mixed(seed: int, views: int = 1, count: int = 60) -> tuple[torch.Tensor, torch.Tensor]:
    """Positions [views, V, 4] and triangles: small, large, clipped and broken ones, in each view elsewhere."""
    rng = np.random.default_rng(seed)
    small = random_corners(rng, count, 0.9)
    small[:, 1:] = small[:, :1] + rng.normal(0, 0.06, (count, 2, 4)) * [1, 1, 0, 0]
    flat = random_corners(rng, 6, 1.0)
    flat[..., 3] = 1.0
    broken = random_corners(rng, 2, 1.0)
    broken[0, 1, 2] = np.nan
    corners = [small, random_corners(rng, 12, 1.2), flat, random_corners(rng, 12, 1.5, behind=True), broken]
    points = rng.permutation(np.concatenate(corners)).reshape(-1, 4)
    places = [points + np.array([0.1 * k, -0.05 * k, 0, 0]) for k in range(views)]
    triangles = np.arange(len(points), dtype=np.int32).reshape(-1, 3)
    return torch.from_numpy(np.stack(places).astype(np.float32)), torch.from_numpy(triangles)


def picture_of(seed: int, resolution: tuple[int, int], views: int = 1, count: int = 60, **options) -> Picture:
    positions, triangles = mixed(seed, views, count)
    rng = np.random.default_rng(seed + 1000)
    settings = {name: options.pop(name) for name in ("lights", "more") if name in options}
    return Picture(positions, triangles, surface_of(rng, positions.shape[1], len(triangles), **settings), resolution, **options)


def of_shared_vertices(seed: int, resolution: tuple[int, int], views: int) -> Picture:
    """Many triangles of few vertices, which are projected once; in each view others have to be clipped."""
    picture = picture_of(seed, resolution, views, count=20)
    corners = np.random.default_rng(seed).integers(0, 60, (len(picture.triangles), 3)).astype(np.int32)
    vertices = torch.stack([view[:60].roll(7 * k, 0) for k, view in enumerate(picture.positions)])
    of_vertices = {name: getattr(picture.surface, name)[:60].contiguous() for name in ("uvs", "colors", "normals")}
    triangles = torch.from_numpy(np.tile(corners, (3, 1)))
    material, face_normals = picture.surface.material.repeat(3), picture.surface.face_normals.repeat(3, 1)
    surface = picture.surface._replace(material=material, face_normals=face_normals, **of_vertices)
    return picture._replace(positions=vertices, triangles=triangles, surface=surface)


def of_parts() -> Iterator[Picture]:
    """Many triangles that lie in a part of the image, each view's elsewhere; and such of which some have to be clipped."""
    yield from _of_parts(70, [((90, 1050), 2, 3, 1), ((75, 131), 3, 4, 1), ((16, 64), 70, 3, 1), ((40, 2113), 1, 3, 1)])
    clipped = of_many_clipped(100)
    yield clipped._replace(positions=clipped.positions.repeat(2, 1, 1), resolution=(160, 400), made=False)


def of_parts_of_samples() -> Iterator[Picture]:
    """The same of several samples a pixel."""
    yield from _of_parts(90, [((45, 525), 2, 3, 2), ((37, 66), 3, 4, 2), ((25, 131), 2, 3, 3), ((16, 64), 5, 4, 3)])
    clipped = of_many_clipped(100)
    yield clipped._replace(positions=clipped.positions.repeat(2, 1, 1), resolution=(80, 201), samples=2, made=False)


def _of_parts(seed: int, shapes: list[tuple[tuple[int, int], int, int, int]]) -> Iterator[Picture]:
    rng = np.random.default_rng(seed)
    for k, (size, views, channels, samples) in enumerate(shapes):
        w = rng.uniform(1, 2, (views, 300, 1, 1))
        centre = rng.uniform(-0.3, 0.3, (views, 300, 1, 2)) + np.stack([np.linspace(-0.6, 0.6, views)] * 2, 1)[:, None, None]
        corners = centre + rng.normal(0, 0.02, (views, 300, 3, 2)) * [size[0] / size[1], 1]
        depths = rng.uniform(-0.9, 0.9, (views, 300, 3, 1))
        positions = np.concatenate([corners * w, depths * w, np.broadcast_to(w, depths.shape)], 3).reshape(views, -1, 4)
        triangles = torch.arange(900, dtype=torch.int32).view(-1, 3)
        surface = surface_of(rng, 900, 300)
        yield Picture(torch.from_numpy(positions.astype(np.float32)), triangles, surface, size, samples, channels, made=False)
        yield picture_of(seed + 1 + k, size, views, samples=samples, made=False, channels=channels, count=300)


def of_every_effect() -> Iterator[Picture]:
    """Each effect left out, and all; the sides, samples, channels and sizes are others every time."""
    whole = picture_of(0, (1, 1)).surface
    left_out = ["uvs", "colors", "normals", "face_normals", "two_sided", "lights", "all"]
    shapes = [(33, 47), (40, 64), (7, 3), (1, 150), (64, 50), (31, 17)]
    for k, effects in enumerate([(), *((e,) for e in left_out), ("normals", "face_normals"), ("uvs", "colors")]):
        views, samples = 1 + k % 3, 1 + k % 3 // 2 * (1 + k % 2)
        picture = picture_of(k, shapes[k % len(shapes)], views, samples=samples, channels=3 + k % 2, made=k % 4 != 3)
        surface = picture.surface
        for effect in effects:
            if effect in ("lights", "all"):
                surface = surface._replace(light_directions=surface.light_directions[:0], light_colors=surface.light_colors[:0])
            if effect in whole._fields:
                surface = surface._replace(**{effect: False if effect == "two_sided" else None})
            if effect == "all":
                surface = surface._replace(uvs=None, colors=None, normals=None, face_normals=None, textures=(), two_sided=False)
                surface = surface._replace(looks=torch.where(torch.tensor([False, True]), -1, surface.looks).contiguous())
        if surface.uvs is None and "all" not in effects:
            assert surface.textures
        yield picture._replace(surface=surface, cull=("none", "back", "front")[k % 3])


def of_samples() -> Iterator[Picture]:
    """Several samples a pixel, with and without alpha."""
    for n, (samples, channels) in enumerate(itertools.product((2, 3), (3, 4))):
        yield picture_of(20 + n, (13, 22), 1 + n % 2, samples=samples, channels=channels, made=n % 2 == 0)


def full_screen(resolution: tuple[int, int]) -> Picture:
    """One triangle at every pixel, of another distance at each corner."""
    corners = torch.tensor([[[-1.0, -1, 0.1, 1], [3, -1, 0.2, 1], [-1, 3, 0.3, 1]]]) * torch.tensor([1.0, 2, 3])[:, None]
    triangles = torch.tensor([[0, 1, 2]], dtype=torch.int32)
    return Picture(corners, triangles, surface_of(np.random.default_rng(5), 3, 1), resolution)


def of_edges_on_centres(clipped: bool) -> Picture:
    """Triangles with corners, and so with edges, in the centres of pixels: weights of 0, 1, and what lies in the middle of two
    numbers. clipped: one corner of each is behind the camera."""
    rng, (height, width) = np.random.default_rng(60), (64, 128)
    corners = np.zeros((40, 3, 4))
    place = rng.integers(0, [width, height], (40, 3, 2))
    w = 2.0 ** rng.integers(-1, 2, (40, 3))
    w[::2] = 1.0
    corners[..., 0], corners[..., 1] = (2 * place[..., 0] + 1) / width - 1, 1 - (2 * place[..., 1] + 1) / height
    corners[..., 2], corners[..., 3] = rng.uniform(-0.9, 0.9, (40, 3)), 1.0
    corners *= w[..., None]
    if clipped:
        corners[:, 2, 2] = -8
    positions = np.stack([corners, corners[::-1]]).reshape(2, -1, 4)
    triangles = torch.arange(120, dtype=torch.int32).view(-1, 3)
    return Picture(torch.from_numpy(positions.astype(np.float32)), triangles, surface_of(rng, 120, 40), (height, width))


def of_many_textures() -> Iterator[Picture]:
    """More than go with a launch, and more than go to memory at a time."""
    yield picture_of(40, (30, 40), more=12)
    yield picture_of(41, (30, 40), more=140, count=400)


def of_many_clipped(count: int, whole: int = 0) -> Picture:
    """More clipped triangles than are listed, and each of them to be seen. whole: among them every so many is not clipped."""
    rng = np.random.default_rng(50)
    side = int(np.ceil(np.sqrt(count)))
    cell = np.arange(count)
    x, y = (2 * (cell % side) + 1) / side - 1, (2 * (cell // side) + 1) / side - 1
    # Two corners at the cell's sides, and one far behind the camera in the direction in which it leaves the picture.
    corners = np.zeros((count, 3, 4))
    for k, (dx, dy) in enumerate(((-1, -1), (1, -1))):
        corners[:, k] = np.stack([x + dx / side, y + dy / side, rng.uniform(0.1, 0.8, count), np.ones(count)], 1)
    corners[:, 2] = np.stack([x * 0.9, y * 0.9 + 1.5 / side, np.full(count, -1.2), np.full(count, 1.0)], 1)
    if whole:
        corners[::whole, 2] = np.stack([x, y + 1 / side, np.full(count, 0.5), np.ones(count)], 1)[::whole]
    triangles = torch.arange(3 * count, dtype=torch.int32).view(-1, 3)
    positions = torch.from_numpy(corners.reshape(1, -1, 4).astype(np.float32))
    surface = surface_of(rng, 3 * count, count)
    return Picture(positions, triangles, surface, (96, 128))


def of_many_clipped_samples() -> Iterator[Picture]:
    """The same where pixels have several samples: of such triangles, of others and of the background."""
    for whole, samples, channels in ((0, 2, 3), (3, 2, 4), (2, 3, 3)):
        picture = of_many_clipped(900, whole)
        yield picture._replace(resolution=(47, 65), samples=samples, channels=channels, made=samples == 2)


def with_bad_indices(picture: Picture) -> tuple[Picture, torch.Tensor]:
    """A picture with indices that the CPU would refuse; and bool [T], which triangles are lost by them."""
    triangles, surface = picture.triangles.clone(), picture.surface
    material, looks = surface.material.clone(), surface.looks.clone()
    triangles[::9, 1] = picture.positions.shape[1]
    triangles[4::11, 0] = -1
    material[5::13] = len(looks)
    material[6::17] = -(2**31)
    lost = ((triangles < 0) | (triangles >= picture.positions.shape[1])).any(1) | (material < 0) | (material >= len(looks))
    return picture._replace(triangles=triangles, surface=surface._replace(material=material)), lost

"""The benchmark's real scenes: meshes of the nature of models and scans, and the cameras that see them.

A body stands for what a scanner or a sculpting program makes: one closed surface, triangles of all shapes that lie in memory
about as they lie in space, a tenth of a pixel to some hundred pixels each. It is the marching-cubes surface of a bumpy ball, so
it needs no file. The terrain has what is far and tiny and what is near and large in one picture, the room and the courtyard
have large triangles that cross the near plane beside small ones.

Meshes are in world space, y up; ``bigtri.study.scenes`` puts them before a camera.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..scene import Camera
from . import courtyard

if TYPE_CHECKING:
    from .scenes import Seen


class Mesh(NamedTuple):
    """Triangles in world space."""

    vertices: NDArray[np.float64]  # [V, 3]
    triangles: NDArray[np.int32]  # [T, 3]

    def bounds(self) -> NDArray[np.float64]:
        """[2, 3], the lowest and the highest corner."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])


@lru_cache(maxsize=2)
def body(cells: int, seed: int) -> Mesh:
    """A closed body, ``cells`` cells of marching cubes a side: some 4.6 * cells^2 triangles."""
    from skimage.measure import marching_cubes

    rng = np.random.default_rng(seed)
    side = np.linspace(-1.5, 1.5, cells + 1)
    # Where a bumpy ball is negative: |p| - 1, and waves sin(a x + b y + c z + d) of ever shorter length and less height. A
    # wave is the imaginary part of a product of three of one coordinate each, so all of them are one product of matrices.
    waves = 1.7 * 2.0 ** np.repeat(np.arange(4), 3)
    a, b, c = rng.normal(size=(3, len(waves))) * waves
    in_x = np.exp(1j * np.outer(a, side) + 1j * rng.uniform(0, 2 * np.pi, (len(waves), 1))) * (0.15 / waves)[:, None]
    in_xy = in_x[:, :, None] * np.exp(1j * np.outer(b, side))[:, None, :]
    in_z = np.exp(1j * np.outer(c, side))
    left = np.concatenate([in_xy.real, in_xy.imag]).reshape(2 * len(waves), -1).astype(np.float32)
    field = (left.T @ np.concatenate([in_z.imag, in_z.real]).astype(np.float32)).reshape(3 * (cells + 1,))
    squares = side.astype(np.float32) ** 2
    field += np.sqrt(squares[:, None, None] + squares[:, None] + squares) - np.float32(1)
    vertices, faces, _, _ = marching_cubes(field, 0.0, spacing=(3.0 / cells,) * 3)
    return Mesh(vertices.astype(np.float64) - 1.5, faces.astype(np.int32))


def shuffled(mesh: Mesh, seed: int) -> Mesh:
    """The same triangles in random order."""
    return Mesh(mesh.vertices, np.random.default_rng(seed).permutation(mesh.triangles))


def terrain(side: int, seed: int) -> Mesh:
    """Hills of 1 km x 1 km, 2 * side^2 triangles, row by row."""
    rng = np.random.default_rng(seed)
    along = np.linspace(-500, 500, side + 1)
    x, z = np.meshgrid(along, along)
    height = np.zeros_like(x)
    for octave in range(7):
        for _ in range(2):
            a, b = rng.normal(size=2) * 2**octave / 200
            height += 30 / 2.1**octave * np.sin(a * x + b * z + rng.uniform(0, 2 * np.pi))
    vertices = np.stack([x, height, z], axis=2).reshape(-1, 3)
    index = np.arange((side + 1) ** 2, dtype=np.int32).reshape(side + 1, side + 1)
    corner, beside, below, across = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    return Mesh(vertices, np.stack([corner, below, beside, beside, below, across], axis=2).reshape(-1, 3))


def along_the_ground(mesh: Mesh, aspect: float) -> Camera:
    """Eye height above the middle of a terrain's near edge, looking over it to the far one."""
    x, y, z = mesh.vertices.T
    near = (np.abs(x) < 20) & (z > 440)
    eye = (0.0, float(y[near].max()) + 2.0, 460.0)
    return Camera(eye, (0.0, eye[1] - 30.0, -500.0), fov_y=55.0, near=0.1, far=2000.0)


def room(pieces: int, seed: int) -> Mesh:
    """A room of 8 x 3 x 6 m, seen from inside: 12 large triangles, and ``pieces`` pieces of furniture on its floor."""
    from trimesh import creation, transformations, util

    rng = np.random.default_rng(seed)
    parts = [creation.box((8, 3, 6), transformations.translation_matrix((0, 1.5, 0)))]
    for piece in range(pieces):
        x, z = rng.uniform((-3.8, -2.8), (3.8, 2.2))
        size = rng.uniform(0.15, 0.6)
        kind = piece % 4
        if kind == 0:  # a table
            parts += [creation.box((2 * size, 0.04, size), transformations.translation_matrix((x, 0.75, z)))]
            parts += [
                creation.cylinder(0.025, 0.73, sections=16, transform=_standing(x + dx * 0.9 * size, 0.37, z + dz * 0.4 * size))
                for dx in (-1, 1)
                for dz in (-1, 1)
            ]
        elif kind == 1:  # a ball lamp
            ball = creation.icosphere(3, size / 2)
            parts += [ball.apply_transform(transformations.translation_matrix((x, 1 + size, z)))]
            parts += [creation.cylinder(0.02, 1.0, sections=12, transform=_standing(x, 0.5, z))]
        elif kind == 2:  # a vase
            turned = np.stack([size / 3 * (1 + 0.4 * np.sin(np.linspace(0, 5, 33))), np.linspace(0, 2 * size, 33)], axis=1)
            parts += [creation.revolve(turned, sections=32, transform=_standing(x, 0, z))]
        else:  # a stack of books
            for k in range(8):
                turned_by = transformations.rotation_matrix(rng.uniform(-0.4, 0.4), (0, 1, 0))
                place = transformations.translation_matrix((x, 0.02 + 0.04 * k, z)) @ turned_by
                parts += [creation.box((0.3, 0.035, 0.22), place)]
    whole: Any = util.concatenate(parts)
    return Mesh(np.asarray(whole.vertices, np.float64), np.asarray(whole.faces, np.int32))


def _standing(x: float, y: float, z: float) -> NDArray[np.float64]:
    """What trimesh makes along z, along y and there."""
    from trimesh import transformations

    return transformations.translation_matrix((x, y, z)) @ transformations.rotation_matrix(-np.pi / 2, (1, 0, 0))


def inside_the_room(mesh: Mesh, aspect: float) -> Camera:
    """From beside one wall to the opposite one; the floor goes on behind the eye."""
    return Camera((1.5, 1.6, 2.7), (-1.0, 0.9, -3.0), fov_y=65.0, near=0.05, far=50.0)


@lru_cache(maxsize=1)
def demo() -> Mesh:
    """The demo's courtyard."""
    scene = courtyard.courtyard()
    return Mesh(scene.positions.astype(np.float64), scene.triangles)


def whole(mesh: Mesh, aspect: float, distance: float = 1.0) -> Camera:
    """All of it in the picture, or seen from ``distance`` times as far."""
    return Camera.framing(mesh.bounds(), aspect=aspect, distance=distance)


MESHES: dict[str, Callable[[int, int], Mesh]] = {  # size, seed
    "body": body,
    "terrain": terrain,
    "room": room,
    "courtyard": lambda size, seed: demo(),
}

CAMERAS: dict[str, Callable[[Mesh, float], Camera]] = {  # mesh, width / height
    "whole": whole,
    "close": lambda mesh, aspect: whole(mesh, aspect, 0.45),
    "far": lambda mesh, aspect: whole(mesh, aspect, 10.0),
    "along the ground": along_the_ground,
    "inside": inside_the_room,
    "courtyard": lambda mesh, aspect: courtyard.camera(),
}


def of(recipe: Seen, seed: int) -> Mesh:
    """The mesh of a scene of ``bigtri.study.scenes.REAL``."""
    mesh = MESHES[recipe.mesh](recipe.size, seed)
    return shuffled(mesh, seed) if recipe.shuffled else mesh


# --- batches


class Batch(NamedTuple):
    """What ``bigtri.rasterize`` takes for a batch of views."""

    positions: NDArray[np.float32]  # [B, V, 4]; of different meshes [V, 4]
    triangles: NDArray[np.int32]  # [T, 3]
    ranges: NDArray[np.int32] | None  # of different meshes: [B, 2], the first triangle and the number of triangles of each view


def batch(kinds: Sequence[Mesh], views: int, aspect: float) -> Batch:
    """So many views from a circle around one mesh; of several meshes, a view each of one after the other, and again.

    aspect: width / height of a view.
    """
    bounds = [mesh.bounds() for mesh in kinds]
    cameras = [Camera.framing(bounds[b % len(kinds)], 30 + 360 * b / views, aspect=aspect) for b in range(views)]
    if len(kinds) == 1:
        (mesh,) = kinds
        return Batch(np.stack([camera.transform(mesh.vertices, aspect) for camera in cameras]), mesh.triangles, None)
    # A view has vertices of its own, since it has a camera of its own, and so it has triangles of its own.
    seen = [kinds[b % len(kinds)] for b in range(views)]
    positions = [camera.transform(mesh.vertices, aspect) for camera, mesh in zip(cameras, seen, strict=True)]
    before = np.cumsum([0] + [len(mesh.vertices) for mesh in seen])
    triangles = [mesh.triangles + np.int32(start) for mesh, start in zip(seen, before, strict=False)]
    counts = np.array([len(mesh.triangles) for mesh in seen])
    ranges = np.stack([np.cumsum(counts) - counts, counts], axis=1)
    return Batch(np.concatenate(positions), np.concatenate(triangles), ranges.astype(np.int32))

"""The demo's courtyard: large textured triangles, made of trimesh's primitives, scikit-image's pictures and NumPy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..ops.rasterize import rasterize
from ..reference.shading import decode_table
from ..scene import Light, Material, Scene, merge
from ..scene.camera import Camera
from ..scene.normals import split_normals
from ..scene.vectors import Vector

FloatImage = NDArray[np.float32]

_KEY = Light((0.60, 0.80, 0.30), (0.98, 0.90, 0.76))
_FILL = Light((-0.55, 0.35, 0.60), (0.13, 0.16, 0.22))
_AMBIENT: Vector = (0.20, 0.23, 0.29)
_SKY = ((0.11, 0.25, 0.56), (0.62, 0.74, 0.88))

# The courtyard, in metres: x from -12 to 12, z from -16 to 13, with the camera at z = 9: the floor goes on under and behind it.
_X, _FRONT, _BACK, _WALL = 12.0, 13.0, -16.0, 6.5


def camera() -> Camera:
    """Eye height, a wide lens, looking down the courtyard."""
    return Camera(eye=(2.3, 2.2, 9.5), target=(-0.9, 2.35, -4.0), fov_y=56.0, near=0.05, far=200.0)


def courtyard(backend: str = "auto") -> Scene:
    """The scene. The sun's shadows are drawn into the floor's and the walls' textures, by ``rasterize`` itself."""
    rng = np.random.default_rng(7)
    objects = merge([*_sails(), *_solids(rng), *_columns(rng), *_pictures()])
    surfaces = [_plane(surface, objects, backend) for surface in _planes(rng)]
    whole = merge([*surfaces, objects])
    return whole.with_(lights=(_KEY, _FILL), ambient=_AMBIENT, background=_SKY)


# --- floor and walls


@dataclass(frozen=True)
class _Plane:
    """A rectangle from ``origin`` along ``right`` and ``up``, world units; its front is right x up."""

    name: str
    origin: Vector
    right: Vector
    up: Vector
    texture: FloatImage


def _planes(rng: np.random.Generator) -> list[_Plane]:
    depth = _FRONT - _BACK
    return [
        _Plane("floor", (-_X, 0, _FRONT), (2 * _X, 0, 0), (0, 0, -depth), _paving(rng, 2048, 2048, 24, 29)),
        _Plane("back wall", (-_X, 0, _BACK), (2 * _X, 0, 0), (0, _WALL, 0), _bricks(rng, 48, 26, (0.50, 0.29, 0.21))),
        _Plane("left wall", (-_X, 0, _FRONT), (0, 0, -depth), (0, _WALL, 0), _bricks(rng, 58, 26, (0.56, 0.37, 0.26))),
        _Plane("right wall", (_X, 0, _BACK), (0, 0, depth), (0, _WALL, 0), _bricks(rng, 58, 26, (0.46, 0.31, 0.26))),
    ]


def _plane(plane: _Plane, casters: Scene, backend: str) -> Scene:
    origin, right, up = (np.array(v, np.float64) for v in (plane.origin, plane.right, plane.up))
    corners = np.stack([origin, origin + right, origin + right + up, origin + up]).astype(np.float32)
    normal = _normal(right, up)
    texture = plane.texture * _light_map(origin, right, up, normal, casters, plane.texture.shape[:2], backend)
    return Scene(
        positions=corners,
        triangles=np.array([(0, 1, 2), (0, 2, 3)], np.int32),
        normals=np.tile(normal.astype(np.float32), (4, 1)),
        uvs=np.array([(0, 0), (1, 0), (1, 1), (0, 1)], np.float32),
        materials=(Material(plane.name, texture=texture, wrap="clamp"),),
    )


def _light_map(
    origin: NDArray[Any],
    right: NDArray[Any],
    up: NDArray[Any],
    normal: NDArray[Any],
    casters: Scene,
    shape: tuple[int, int],
    backend: str,
) -> FloatImage:
    """float32 [H, W, 3]: what is left of the light on the plane where objects keep the sun away.

    The objects are slid along the sun's rays onto the plane and drawn in the plane's own coordinates. Their height above the
    plane is the clip-space z, so that the near plane cuts off what is behind it.
    """
    sun = np.array(_KEY.direction)
    facing = float(normal @ sun)
    if facing <= 0:
        return np.ones((*shape, 3), np.float32)
    above = casters.positions.astype(np.float64) - origin
    height = above @ normal
    landed = above - (height / facing)[:, None] * sun
    u, v = landed @ right / (right @ right), landed @ up / (up @ up)
    clip = np.stack([2 * u - 1, 2 * v - 1, 0.02 * height - 1, np.ones_like(u)], axis=1).astype(np.float32)
    shadow = np.asarray(rasterize(clip, casters.triangles, shape, backend=backend).triangle >= 0)

    direct = np.array(_KEY.color) * facing
    indirect = np.array(_AMBIENT) + np.array(_FILL.color) * max(float(normal @ np.array(_FILL.direction)), 0)
    soft = _blurred(shadow.astype(np.float32), 2)[..., None]
    return (1 - soft * (direct / (direct + indirect))).astype(np.float32)


def _normal(right: NDArray[Any], up: NDArray[Any]) -> NDArray[np.float64]:
    normal = np.cross(right, up)
    return normal / np.sqrt((normal * normal).sum())


# --- objects


def _sails() -> list[Scene]:
    """Sun sails: two of the largest triangles of the scene, with a colour per corner. One passes over the camera."""
    corners = np.array(
        [(-12, 6.4, 2), (1.5, 5.4, -15.5), (12, 6.4, -4), (-12, 6.2, -13), (-2.5, 7.2, 12), (-12, 6.0, 12)], np.float32
    )
    colors = np.array(
        [(0.83, 0.16, 0.07), (0.95, 0.55, 0.1), (0.8, 0.1, 0.12), (0.96, 0.8, 0.35), (0.93, 0.42, 0.1), (0.75, 0.1, 0.1)],
        np.float32,
    )
    # Brighter than white: cloth lets light through, and its underside is what is seen.
    material = Material("sail", (2.2, 2.2, 2.2), vertex_colors=True, smooth=False, two_sided=True)
    return [Scene(corners, np.arange(6, dtype=np.int32).reshape(2, 3), colors=colors, materials=(material,))]


def _solids(rng: np.random.Generator) -> list[Scene]:
    from trimesh import creation, transformations

    def turned(angle: float, axis: Vector, at: Vector) -> NDArray[Any]:
        matrix = transformations.rotation_matrix(np.radians(angle), axis)
        matrix[:3, 3] = at
        return matrix

    wood = _planks(rng)
    crates = [
        (3.2, turned(24, (0, 1, 0), (-6.3, 1.6, -4.6))),
        (2.1, turned(51, (0.3, 1, 0.15), (-4.4, 1.0, -2.6))),  # leans into the large one and into the floor
        (1.5, turned(-12, (0, 1, 0), (-6.6, 3.95, -4.8))),
    ]
    parts = [_boxed(creation.box((size, size, size), matrix), Material("crate", texture=wood), size) for size, matrix in crates]

    gem = creation.icosahedron()
    gem.apply_scale(2.3)
    gem.apply_transform(turned(18, (0.4, 1, 0.2), (5.3, 1.35, -3.2)))  # a third of it is in the floor
    parts.append(_plain(gem, Material("gem", (0.05, 0.42, 0.46), smooth=False)))

    ring = creation.torus(2.35, 0.62, major_sections=72, minor_sections=36)
    around = np.arctan2(ring.vertices[:, 1], ring.vertices[:, 0])
    ring.apply_transform(turned(32, (0, 1, 0), (0.6, 2.85, -8.6)))
    parts.append(_plain(ring, Material("ring", vertex_colors=True), _hues(around)))

    parts.append(_ball((0.6, 0.95, 1.2), 0.95))

    step = creation.box((7.5, 0.5, 5.0), turned(32, (0, 1, 0), (0.6, 0.25, -8.6)))
    parts.append(_boxed(step, Material("step", texture=_marble(rng)), 4.0))
    return parts


def _ball(center: Vector, radius: float) -> Scene:
    """A beach ball: eight texels, read without a filter."""
    from trimesh import creation, transformations

    sphere = creation.icosphere(subdivisions=4)
    corners = sphere.vertices[sphere.faces].astype(np.float64)
    longitude = np.arctan2(corners[..., 2], corners[..., 0]) / (2 * np.pi)
    # A triangle across the seam must not run backwards through the whole texture.
    longitude = np.where(longitude.max(axis=1, keepdims=True) - longitude > 0.5, longitude + 1, longitude)
    normals = corners.reshape(-1, 3) @ transformations.euler_matrix(0.5, 0.3, 0.35)[:3, :3].T
    panels = [(0.85, 0.06, 0.05), (0.9, 0.88, 0.82), (0.05, 0.22, 0.66), (0.9, 0.88, 0.82)]
    panels += [(0.93, 0.62, 0.04), (0.9, 0.88, 0.82), (0.04, 0.42, 0.16), (0.9, 0.88, 0.82)]
    return Scene(
        (normals * radius + np.array(center)).astype(np.float32),
        np.arange(len(normals), dtype=np.int32).reshape(-1, 3),
        normals.astype(np.float32),
        np.stack([longitude.reshape(-1), np.full(len(normals), 0.5)], axis=1).astype(np.float32),
        materials=(Material("ball", texture=np.array([panels], np.float32), filter="nearest"),),
    )


def _columns(rng: np.random.Generator) -> list[Scene]:
    from trimesh import creation, transformations

    marble = Material("column", texture=_marble(rng))
    upright = transformations.rotation_matrix(-np.pi / 2, (1, 0, 0))
    parts = []
    for x, z in [(-9.8, -11.0), (-9.8, -5.0), (-9.8, 1.0), (9.6, -12.0), (9.6, -7.0), (9.6, -2.0)]:
        shaft = creation.cylinder(0.55, 5.0, sections=40)
        angle = np.arctan2(shaft.vertices[:, 1], shaft.vertices[:, 0])
        uv = np.stack([angle / np.pi, shaft.vertices[:, 2] / 3.0], axis=1)
        shaft.apply_transform(upright)
        shaft.apply_translation((x, 3.0, z))
        parts.append(_plain(shaft, marble, uv=uv))
        for y, size in ((0.25, 1.7), (5.75, 1.6)):
            parts.append(_boxed(creation.box((size, 0.5, size), transformations.translation_matrix((x, y, z))), marble, 2.5))
    return parts


def _pictures() -> list[Scene]:
    """Posters on the back wall and on the left wall: scikit-image's own pictures, which come with it."""
    from trimesh import creation, transformations

    frame = Material("frame", (0.09, 0.06, 0.04))
    parts = []
    for name, center, width, across in (
        ("astronaut", (-6.3, 3.4, _BACK), 4.2, (1, 0, 0)),
        ("hubble_deep_field", (5.3, 3.5, _BACK), 5.2, (1, 0, 0)),
        ("coffee", (-_X, 3.3, -8.0), 4.2, (0, 0, -1)),
        ("rocket", (-_X, 3.3, -1.9), 4.2, (0, 0, -1)),
    ):
        texture = _photo(name)
        height = width * texture.shape[0] / texture.shape[1]
        right, up = np.array(across, np.float64) * width, np.array((0.0, height, 0.0))
        normal = _normal(right, up)
        origin = np.array(center) + 0.09 * normal - 0.5 * (right + up)
        corners = np.stack([origin, origin + right, origin + right + up, origin + up]).astype(np.float32)
        extents = np.abs(right) + up + 0.3 + (0.12 - 0.3) * np.abs(normal)
        box = creation.box(extents, transformations.translation_matrix(np.array(center)))
        parts.append(_plain(box, frame))
        parts.append(
            Scene(
                corners,
                np.array([(0, 1, 2), (0, 2, 3)], np.int32),
                np.tile(normal.astype(np.float32), (4, 1)),
                np.array([(0, 0), (1, 0), (1, 1), (0, 1)], np.float32),
                materials=(Material(name, texture=texture, wrap="clamp"),),
            )
        )
    return parts


def _plain(mesh: Any, material: Material, colors: Any = None, uv: Any = None) -> Scene:
    """A trimesh mesh with a colour [V, 3] or a uv [V, 2] per vertex."""
    source, triangles, normals = split_normals(mesh.vertices.astype(np.float32), mesh.faces.astype(np.int32))
    return Scene(
        mesh.vertices.astype(np.float32)[source],
        triangles,
        normals,
        None if uv is None else np.asarray(uv, np.float32)[source],
        None if colors is None else np.asarray(colors, np.float32)[source],
        materials=(material,),
    )


def _boxed(mesh: Any, material: Material, size: float) -> Scene:
    """A mesh of flat sides, its texture ``size`` world units wide and laid on each side by itself."""
    corners = mesh.vertices[mesh.faces].astype(np.float64)  # [T, 3, 3]
    normals = mesh.face_normals
    up = np.where(np.abs(normals[:, 1:2]) > 0.9, (0.0, 0.0, -1.0), (0.0, 1.0, 0.0))
    right = np.cross(up, normals)
    right = right / np.sqrt((right * right).sum(axis=1, keepdims=True))
    up = np.cross(normals, right)
    from_center = corners - mesh.vertices.mean(axis=0)
    uv = np.stack([(from_center * right[:, None]).sum(-1), (from_center * up[:, None]).sum(-1)], axis=-1) / size + 0.5
    return Scene(
        corners.reshape(-1, 3).astype(np.float32),
        np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3),
        np.repeat(normals.astype(np.float32), 3, axis=0),
        uv.reshape(-1, 2).astype(np.float32),
        materials=(material,),
    )


# --- textures, linear


def _photo(name: str) -> FloatImage:
    """A picture of scikit-image's, or a pattern where this release would have to download it."""
    from skimage import data

    try:
        image = np.asarray(getattr(data, name)())
    except Exception:  # which error depends on the release and on whether pooch is installed
        rows, columns = np.mgrid[0:400, 0:600]
        image = np.stack([(rows ^ columns) & 255, (rows * 2) & 255, (columns * 2) & 255], axis=-1).astype(np.uint8)
    image = image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=-1)
    return decode_table()[image[..., :3]]


def _paving(rng: np.random.Generator, height: int, width: int, columns: int, rows: int) -> FloatImage:
    """Large slabs in two colours of stone, every slab a little different."""
    y, x = np.mgrid[0:height, 0:width]
    u, v = x * columns / width, y * rows / height
    slab = (np.floor(u).astype(int) % columns, np.floor(v).astype(int) % rows)
    dark = ((slab[0] // 2 + slab[1] // 2) % 2).astype(bool)
    tone = np.where(dark[..., None], (0.24, 0.25, 0.28), (0.60, 0.56, 0.49))
    shade = rng.uniform(0.86, 1.12, (columns, rows))[slab] * (0.82 + 0.36 * _noise(rng, height, width, 5))
    joint = np.minimum(np.abs(u - np.rint(u)), np.abs(v - np.rint(v))) < 0.022
    return (tone * shade[..., None] * np.where(joint, 0.42, 1.0)[..., None]).astype(np.float32)


def _bricks(rng: np.random.Generator, columns: int, rows: int, tone: Vector) -> FloatImage:
    """A wall of bricks in running bond, 26 px a row."""
    height, width = rows * 26, columns * 38
    y, x = np.mgrid[0:height, 0:width]
    row = y * rows // height
    u, v = x * columns / width + 0.5 * (row % 2), y * rows / height
    shade = rng.uniform(0.66, 1.22, (columns + 1, rows))[np.floor(u).astype(int), row]
    warmth = rng.uniform(-0.06, 0.06, (columns + 1, rows))[np.floor(u).astype(int), row]
    color = np.array(tone) * (shade * (0.8 + 0.4 * _noise(rng, height, width, 4)))[..., None]
    color = color + warmth[..., None] * np.array((0.9, 0.4, 0.1))
    joint = (np.abs(v - np.rint(v)) < 0.075) | (np.abs(u - np.rint(u)) < 0.045)
    mortar = np.array((0.47, 0.43, 0.38)) * (0.85 + 0.3 * _noise(rng, height, width, 4))[..., None]
    return np.clip(np.where(joint[..., None], mortar, color), 0.01, 1).astype(np.float32)


def _planks(rng: np.random.Generator, size: int = 512) -> FloatImage:
    """The side of a crate: planks in a frame with nails."""
    y, x = np.mgrid[0:size, 0:size] / size
    grain = _noise(rng, 8, size, 3)[np.zeros(size, int)[:, None], np.arange(size)[None, :]]
    grain = 0.7 * grain + 0.3 * _noise(rng, size, size, 6)
    rail = np.maximum(np.abs(x - 0.5), np.abs(y - 0.5)) > 0.39
    plank = np.floor(x * 6).astype(int)
    shade = np.where(rail, 1.12, rng.uniform(0.75, 1.0, 7)[plank]) * (0.75 + 0.5 * grain)
    distance = np.abs(np.maximum(np.abs(x - 0.5), np.abs(y - 0.5)) - 0.39)
    gap = ((np.abs(x * 6 - np.rint(x * 6)) < 0.035) & ~rail) | (distance < 0.006)
    nail = np.hypot(np.abs(x - 0.5) - 0.445, np.abs(y - 0.5) - 0.445) < 0.013
    color = np.array((0.52, 0.32, 0.15)) * (shade * np.where(gap, 0.25, 1))[..., None]
    return np.where(nail[..., None], 0.04, np.clip(color, 0, 1)).astype(np.float32)


def _marble(rng: np.random.Generator, size: int = 512) -> FloatImage:
    """Pale stone with veins; it repeats without a seam."""
    y, x = np.mgrid[0:size, 0:size] / size
    vein = np.abs(np.sin(2 * np.pi * (x + 2 * y) + 7 * _noise(rng, size, size, 5)))
    lightness = 0.84 - 0.38 * np.exp(-7 * vein)
    return (lightness[..., None] * np.array((0.97, 0.94, 0.89))).astype(np.float32)


def _noise(rng: np.random.Generator, height: int, width: int, octaves: int) -> NDArray[np.float64]:
    """Value noise in [0, 1], [height, width], periodic both ways."""
    total, weight = np.zeros((height, width)), 0.0
    for octave in range(octaves):
        cells = 4 << octave
        lattice = rng.random((cells, cells))
        y, x = np.arange(height) * cells / height, np.arange(width) * cells / width
        row, column = y.astype(int), x.astype(int)
        ty, tx = _ease(y - row)[:, None], _ease(x - column)[None, :]
        upper = lattice[row][:, column] * (1 - tx) + lattice[row][:, (column + 1) % cells] * tx
        lower = lattice[(row + 1) % cells][:, column] * (1 - tx) + lattice[(row + 1) % cells][:, (column + 1) % cells] * tx
        total += (upper * (1 - ty) + lower * ty) / (1 << octave)
        weight += 1 / (1 << octave)
    return total / weight


def _ease(t: NDArray[np.float64]) -> NDArray[np.float64]:
    return t * t * (3 - 2 * t)


def _hues(angle: NDArray[Any]) -> NDArray[np.float64]:
    """Linear colours [V, 3] around the colour circle."""
    phases = np.array((0.0, 2.1, 4.2))
    return 0.08 + 0.72 * (0.5 + 0.5 * np.cos(angle[:, None] - phases)) ** 1.6


def _blurred(mask: FloatImage, radius: int) -> FloatImage:
    """The mean over squares of 2 * radius + 1 px, the border going on for ever."""
    for axis in (0, 1):
        pad = [(radius + 1, radius) if i == axis else (0, 0) for i in (0, 1)]
        total = np.cumsum(np.pad(mask, pad, mode="edge"), axis=axis, dtype=np.float64)
        size = 2 * radius + 1
        upper, lower = (np.take(total, range(first, total.shape[axis] - size + first), axis) for first in (size, 0))
        mask = ((upper - lower) / size).astype(np.float32)
    return mask

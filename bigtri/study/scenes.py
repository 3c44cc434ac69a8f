"""The benchmark's scenes: triangles from a seed.

Real ones are meshes of the nature of models and scans (``bigtri.study.meshes``), seen by a perspective camera. The last bit of
their vertices is what the machine's sine makes it.

| name              | what it holds                                                             |
|-------------------|---------------------------------------------------------------------------|
| `R4k` to `R1M`    | a closed body of 4,000, 16,000, 100,000 or 1,000,000 triangles, seen whole |
| `R16k-close`      | from so near that it fills the picture                                    |
| `R16k-far`        | from ten times as far                                                     |
| `R100k-shuffled`, `R1M-shuffled` | the same triangles in random order                         |
| `Rcourtyard`      | the demo's courtyard: huge and tiny triangles, some across the near plane |
| `Rterrain`        | hills of 100,000 triangles, seen along the ground                         |
| `Rroom`           | a furnished room, seen from inside                                        |

The others are the same on every machine, and each holds one kind of triangle:

| name      | what it holds                                                                     |
|-----------|-----------------------------------------------------------------------------------|
| `S1`      | few large: 8 triangles of 4,000 to 40,000 px                                       |
| `S2`      | many large: 64 triangles of 4,000 to 40,000 px                                     |
| `S3`      | very large: 32 triangles that each show more than a quarter of the screen          |
| `S4f`     | 200 triangles that each cover the whole screen, nearest first                      |
| `S4b`     | the same, farthest first                                                           |
| `S5`      | 1000 slivers, about 1500 px long and 1 to 2 px wide                                |
| `S6`      | small mesh: 1,000,000 triangles of about 10 px                                     |
| `S6-200k` | small mesh for CPUs: 200,000 triangles of about 20 px                              |
| `S7`      | mixed: S2, then S6                                                                 |
| `S8`      | middle-sized in random places: 2,000 triangles of 500 to 20,000 px                  |

They are made in pixel space, x to the right and y **down**, pixel (row i, column j) centred at (j + 0.5, i + 0.5), z in (0,
1) with the smaller z nearer and affine over the screen. x and y are `(k + 1/4) / 256` for an integer k: a quarter of a
sub-pixel away from the nearest tie, so that every rasterizer with a grid of 1/16 or 1/256 px snaps them the same way. `(b-a) x
(c-a)` is positive, which with y down means clockwise on the screen, back-facing: draw them with `cull="none"`.

`make` converts them to clip space (docs/numerics.md, section 1) in float64 and rounds once to float32. That error stays below a
quarter of a sub-pixel up to 7680 px a side, so the snapped vertices are the intended ones; above that, the far vertices of S4
may land one sub-pixel away.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..reference.numerics import MAX_SIZE

SEED = 1000
DEFAULT = "S1,S2,S3,S4f,S4b,S5,S6-200k"  # what benchmarks draw unless they are told: all that takes a CPU milliseconds
SUBPIXELS = 256
MESH_CELL = 4.5  # px: a cell is two triangles of 4.5^2 / 2 = 10 px
MESH_CELL_200K = 40.0**0.5  # px: two triangles of 20 px
MAX_DRAWS = 100_000  # rejection sampling gives up here: the screen is too small for the scene
MAX_LAYERS = 10_000  # of small_mesh: more is for screens of a few px, and takes minutes


class Triangles(NamedTuple):
    """Triangles in clip space; unpacks as `positions, triangles = make(...)`."""

    positions: NDArray[np.float32]  # [V, 4] x, y, z, w (OpenGL clip space)
    triangles: NDArray[np.int32]  # [T, 3] indices into positions


class Mesh(NamedTuple):
    """Triangles in pixel space."""

    vertices: NDArray[np.float64]  # [V, 3] x, y in px (y down), z in (0, 1)
    triangles: NDArray[np.int32]  # [T, 3]


def make(name: str, width: int, height: int, seed: int = SEED) -> Triangles:
    """The scene `name` (a key of `SCENES`) for a width x height px image, as clip-space positions and indices.

    Raises:
        TypeError: a size or a seed that is no integer.
        ValueError: no such scene, a size outside of 1 to 16384 px or too small for the scene, or a negative seed.
    """
    recipe = checked(name, SCENES, width, height, seed)
    if isinstance(recipe, Seen):
        from . import meshes  # only now: names and titles are there without torch

        mesh = meshes.of(recipe, seed)
        camera = meshes.CAMERAS[recipe.camera](mesh, width / height)
        return Triangles(camera.transform(mesh.vertices, width / height), mesh.triangles)
    return to_clip(pixel_mesh(name, width, height, seed), width, height)


def pixels(name: str, width: int, height: int, seed: int = SEED) -> NDArray[np.float32]:
    """The same triangles, of a scene that is made in pixel space: float32 [T, 3, 3], x and y in px (y down), z in (0, 1)."""
    mesh = pixel_mesh(name, width, height, seed)
    return np.ascontiguousarray(mesh.vertices.astype(np.float32)[mesh.triangles])


def pixel_mesh(name: str, width: int, height: int, seed: int = SEED) -> Mesh:
    """The same triangles, of a scene that is made in pixel space: an indexed mesh there, before rounding to float32."""
    recipe = checked(name, DRAWN, width, height, seed)
    # Above 2000 px a scene is another draw, not a magnified one: sizes in px mean the same at every resolution.
    return recipe.build(width, height, seed + (width > 2000))


def checked(name: str, recipes: Mapping[str, RecipeT], width: int, height: int, seed: int) -> RecipeT:
    """The recipe of that name, where all arguments are allowed; errors as ``make`` says."""
    if name not in recipes:
        raise ValueError(f"bigtri.study.scenes: name must be one of {', '.join(recipes)}, got {name!r}")
    for argument, value, low, high in (("width", width, 1, MAX_SIZE), ("height", height, 1, MAX_SIZE), ("seed", seed, 0, None)):
        allowed = f"an integer of at least {low}" if high is None else f"an integer from {low} to {high}"
        try:
            number = operator.index(value)
        except TypeError:
            raise TypeError(f"bigtri.study.scenes: {argument} must be {allowed}, got {value!r}") from None
        if number < low or (high is not None and number > high):
            raise ValueError(f"bigtri.study.scenes: {argument} must be {allowed}, got {value!r}")
    return recipes[name]


def to_clip(mesh: Mesh, width: int, height: int) -> Triangles:
    """Pixel space to clip space: x / (W/2) - 1, 1 - y / (H/2), 2z - 1, w = 1."""
    x, y, z = mesh.vertices.T
    clip = np.stack([x / (width / 2) - 1, 1 - y / (height / 2), 2 * z - 1, np.ones_like(x)], axis=1)
    return Triangles(clip.astype(np.float32), mesh.triangles)


# --- what the scenes share


def on_grid(xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Coordinates [..., 2] in px, moved to a quarter of a sub-pixel above a sub-pixel."""
    return (np.floor(xy * SUBPIXELS) + 0.25) / SUBPIXELS


def clockwise(vertices: NDArray[np.float64], triangles: NDArray[np.int32]) -> Mesh:
    """The mesh with vertices 1 and 2 swapped where `(b-a) x (c-a)` is negative."""
    if not (vertices[:, 2].min() > 0 and vertices[:, 2].max() < 1):
        raise AssertionError("a scene's depth leaves (0, 1)")
    a, b, c = (vertices[triangles[:, k], :2] for k in range(3))
    ab, ac = b - a, c - a
    flipped = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0] < 0
    triangles[flipped] = triangles[flipped][:, [0, 2, 1]]
    return Mesh(vertices, triangles)


def soup(xy: NDArray[np.float64], z: NDArray[np.float64]) -> Mesh:
    """Triangles that share no vertex: xy [T, 3, 2] px, z [T, 3]."""
    vertices = np.concatenate([on_grid(xy), z[..., None]], axis=2).reshape(-1, 3)
    return clockwise(vertices, np.arange(len(vertices), dtype=np.int32).reshape(-1, 3))


def tilted(rng: np.random.Generator, count: int, slope: float) -> NDArray[np.float64]:
    """Depths [count, 3]: a random distance for each triangle, its vertices within +-slope of it."""
    return rng.uniform(0.06, 0.94, (count, 1)) + rng.uniform(-slope, slope, (count, 3))


def too_small(what: str, width: int, height: int) -> ValueError:
    return ValueError(f"bigtri.study.scenes: size must have room for {what}, got {width}x{height} px, which is too small")


def visible_area(triangle: NDArray[np.float64], width: int, height: int) -> float:
    """Area in px of the part of a triangle [3, 2] that lies on the screen (Sutherland-Hodgman)."""
    polygon = [tuple(corner) for corner in triangle]
    for axis, sign, limit in ((0, 1, 0), (0, -1, -width), (1, 1, 0), (1, -1, -height)):
        kept = []
        for a, b in zip([polygon[-1], *polygon[:-1]], polygon, strict=True):
            inside_a, inside_b = sign * a[axis] - limit, sign * b[axis] - limit
            if (inside_a >= 0) != (inside_b >= 0):
                t = inside_a / (inside_a - inside_b)
                kept.append((a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])))
            if inside_b >= 0:
                kept.append(b)
        polygon = kept
        if len(polygon) < 3:
            return 0.0
    return abs(sum(polygon[i - 1][0] * polygon[i][1] - polygon[i - 1][1] * polygon[i][0] for i in range(len(polygon)))) / 2


# --- the scenes


def large(count: int, width: int, height: int, seed: int, area: tuple[float, float] = (4_000, 40_000)) -> Mesh:
    """Triangles wholly on the screen, no angle below 15 degrees, area log-uniform over `area` px."""
    if area[0] > width * height / 2:  # no triangle fits; said at once
        raise too_small(f"triangles of {area[0]} to {area[1]} px", width, height)
    rng = np.random.default_rng(seed)
    found: list[NDArray[np.float64]] = []
    # One triangle at a time: a normal variate takes a varying number of draws, so a batch would be another scene.
    for _ in range(MAX_DRAWS):
        triangle = rng.normal(size=(3, 2))
        side = np.roll(triangle, -1, axis=0) - triangle
        length = np.linalg.norm(side, axis=1)
        before = np.roll(side, 1, axis=0)
        cosine = -(before * side).sum(axis=1) / (np.roll(length, 1) * length)
        if np.arccos(np.clip(cosine, -1, 1)).min() < np.deg2rad(15):
            continue
        here = abs(side[0, 0] * side[1, 1] - side[0, 1] * side[1, 0]) / 2
        wanted = np.exp(rng.uniform(np.log(area[0]), np.log(area[1])))
        triangle = (triangle - triangle.mean(axis=0)) * np.sqrt(wanted / here) + rng.uniform([0, 0], [width, height])
        if (triangle >= 0).all() and (triangle <= [width, height]).all():
            found.append(triangle)
            if len(found) == count:
                return soup(np.array(found), tilted(rng, count, 0.03))
    raise too_small(f"triangles of {area[0]} to {area[1]} px", width, height)


def very_large(count: int, width: int, height: int, seed: int) -> Mesh:
    """Vertices up to half a screen outside; more than a quarter of the screen is inside each triangle."""
    rng = np.random.default_rng(seed)
    found: list[NDArray[np.float64]] = []
    for _ in range(MAX_DRAWS):
        triangle = rng.uniform([-0.5 * width, -0.5 * height], [1.5 * width, 1.5 * height], (3, 2))
        if visible_area(triangle, width, height) > 0.25 * width * height:
            found.append(triangle)
            if len(found) == count:
                return soup(np.array(found), tilted(rng, count, 0.05))
    raise too_small(f"{count} triangles that show a quarter of it", width, height)


def full_screen(count: int, width: int, height: int, seed: int, back_to_front: bool) -> Mesh:
    """Right triangles, each over the whole screen, the right angle a few px outside each screen corner in turn."""
    rng = np.random.default_rng(seed)
    margin = rng.uniform(4, 60, count)
    right, bottom = np.arange(count) & 1, np.arange(count) & 2
    corner_x, corner_y = np.where(right, width + margin, -margin), np.where(bottom, height + margin, -margin)
    reach_x = np.where(right, -1, 1) * (2 * width + 5 * margin)
    reach_y = np.where(bottom, -1, 1) * (2 * height + 5 * margin)
    xy = np.stack([corner_x, corner_y, corner_x + reach_x, corner_y, corner_x, corner_y + reach_y], axis=1).reshape(count, 3, 2)
    layer = 0.05 + 0.9 * np.arange(count) / count
    if back_to_front:
        layer = layer[::-1]
    return soup(xy, layer[:, None] + rng.uniform(-0.0005, 0.0005, (count, 3)))


def slivers(count: int, width: int, height: int, seed: int) -> Mesh:
    """Right triangles: a long side of 1400 to 1600 px in any direction, a short side of 1 to 2 px."""
    if min(width, height) < 4 or np.hypot(width - 4, height - 4) <= 1400:  # said at once
        raise too_small("slivers of 1500 px", width, height)
    rng = np.random.default_rng(seed)
    starts, ends, lengths = [], [], []
    found = 0
    for _ in range(100):  # one round is enough up to 8K; wider screens have fewer segments of this length
        a, b = (rng.uniform([2, 2], [width - 2, height - 2], (count * 60, 2)) for _ in range(2))
        length = np.linalg.norm(b - a, axis=1)
        fits = (length > 1400) & (length < 1600)
        starts.append(a[fits])
        ends.append(b[fits])
        lengths.append(length[fits])
        found += int(fits.sum())
        if found >= count:
            break
    else:
        raise too_small("slivers of 1500 px", width, height)
    a, b, length = (np.concatenate(parts)[:count] for parts in (starts, ends, lengths))
    normal = np.stack([-(b - a)[:, 1], (b - a)[:, 0]], axis=1) / length[:, None]
    c = b + normal * rng.uniform(1.0, 2.0, (count, 1))
    return soup(np.stack([a, b, c], axis=1), tilted(rng, count, 0.02))


def small_mesh(count: int, width: int, height: int, seed: int, cell: float = MESH_CELL) -> Mesh:
    """The first `count` triangles of as many wavy layers of jittered cells as they fill, one layer behind the other.

    cell: the side of a cell of two triangles, px. The triangles of a layer share vertices, row by row from the top.
    """
    rng = np.random.default_rng(seed)
    columns, rows = int(np.ceil(width / cell)), int(np.ceil(height / cell))
    if count > MAX_LAYERS * 2 * columns * rows:
        raise too_small(f"{count} triangles in {MAX_LAYERS} layers of cells of {cell:g} px", width, height)
    layers = int(np.ceil(count / (2 * columns * rows)))
    column_x, row_y = np.arange(columns + 1) * (width / columns), np.arange(rows + 1) * (height / rows)
    vertices, triangles, base, left = [], [], 0, count
    for layer in range(layers):
        used = min(rows, -(-left // (2 * columns)))  # rows of cells: the last layer may end early
        x, y = np.meshgrid(column_x, row_y[: used + 1])
        xy = np.stack([x, y], axis=2) + rng.uniform(-0.16, 0.16, (used + 1, columns + 1, 2)) * cell
        xy = on_grid(np.clip(xy, 0.5, [width - 0.5, height - 0.5]))
        wave = np.sin(x * (9 + layer) / width + layer) * np.cos(y * (7 + 2 * layer) / height)
        z = 0.1 + 0.8 * (layer + 0.5) / layers + 0.7 / layers * 0.5 * wave
        vertices.append(np.concatenate([xy, z[..., None]], axis=2).reshape(-1, 3))
        index = base + np.arange((used + 1) * (columns + 1), dtype=np.int32).reshape(used + 1, columns + 1)
        corner, beside, below, across = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
        pair = np.stack([corner, beside, below, beside, across, below], axis=2).reshape(-1, 3)
        triangles.append(pair[:left])
        base += index.size
        left -= len(triangles[-1])
    return clockwise(np.concatenate(vertices), np.concatenate(triangles).astype(np.int32, copy=False))


def layers_of(area: float, width: int, height: int, layers: int) -> Mesh:
    """Whole layers of `small_mesh`, triangles of about `area` px."""
    cell = (2 * area) ** 0.5  # px
    columns, rows = int(np.ceil(width / cell)), int(np.ceil(height / cell))
    return small_mesh(layers * 2 * columns * rows, width, height, SEED, cell)


def joined(first: Mesh, second: Mesh) -> Mesh:
    """Both meshes, the first's triangles before the second's."""
    shifted = second.triangles + np.int32(len(first.vertices))
    return Mesh(np.concatenate([first.vertices, second.vertices]), np.concatenate([first.triangles, shifted]))


class Drawn(NamedTuple):
    """A scene that is made in pixel space."""

    title: str
    build: Callable[[int, int, int], Mesh]  # width px, height px, seed


class Seen(NamedTuple):
    """A mesh before a camera: names in ``bigtri.study.meshes``."""

    title: str
    mesh: str
    size: int  # of the mesh, in its own unit
    camera: str
    shuffled: bool = False  # whether its triangles come in random order


RecipeT = TypeVar("RecipeT", Drawn, Seen, Drawn | Seen)

REAL: dict[str, Seen] = {
    "R4k": Seen("a body of 4k triangles", "body", 30, "whole"),
    "R16k": Seen("a body of 16k triangles", "body", 59, "whole"),
    "R16k-close": Seen("the same from near", "body", 59, "close"),
    "R16k-far": Seen("the same from far away", "body", 59, "far"),
    "R100k": Seen("a body of 100k triangles", "body", 148, "whole"),
    "R100k-shuffled": Seen("the same in random order", "body", 148, "whole", shuffled=True),
    "R1M": Seen("a body of 1M triangles", "body", 468, "whole"),
    "R1M-shuffled": Seen("the same in random order", "body", 468, "whole", shuffled=True),
    "Rcourtyard": Seen("the demo's courtyard", "courtyard", 1, "courtyard"),
    "Rterrain": Seen("100k triangles of hills along the ground", "terrain", 224, "along the ground"),
    "Rroom": Seen("a room from inside", "room", 40, "inside"),
}

DRAWN: dict[str, Drawn] = {
    "S1": Drawn("8 large triangles", lambda w, h, seed: large(8, w, h, seed + 10)),
    "S2": Drawn("64 large triangles", lambda w, h, seed: large(64, w, h, seed + 20)),
    "S3": Drawn("32 very large triangles", lambda w, h, seed: very_large(32, w, h, seed + 30)),
    "S4f": Drawn("200 full-screen triangles, front to back", lambda w, h, seed: full_screen(200, w, h, seed + 40, False)),
    "S4b": Drawn("200 full-screen triangles, back to front", lambda w, h, seed: full_screen(200, w, h, seed + 40, True)),
    "S5": Drawn("1000 slivers", lambda w, h, seed: slivers(1000, w, h, seed + 50)),
    "S6": Drawn("1M small triangles", lambda w, h, seed: small_mesh(1_000_000, w, h, seed + 60)),
    "S6-200k": Drawn("200k small triangles", lambda w, h, seed: small_mesh(200_000, w, h, seed + 60, MESH_CELL_200K)),
    "S7": Drawn("S2 and S6", lambda w, h, seed: joined(large(64, w, h, seed + 20), small_mesh(1_000_000, w, h, seed + 60))),
    "S8": Drawn("2000 middle-sized triangles", lambda w, h, seed: large(2000, w, h, seed + 80, (500, 20_000))),
}

SCENES: dict[str, Drawn | Seen] = {**REAL, **DRAWN}

"""Cases that others have reported of their rasterizers, as far as the report gives enough to build something like it."""

from __future__ import annotations

import time

import numpy as np

from ..ops.interpolate import barycentrics
from .constructions import HALF, quad, rectangle, slivers_one_subpixel
from .mesh import SUBPX, Backend, Case, Mesh, clip_space, coverage_by_triangle, f32, mesh_case
from .rules import Positions, projected_case, soup
from .structure import NOTHING

_FACES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])


def _room(backend: Backend) -> int:
    """Pixels of a closed box of 12 triangles, seen from inside, that are not covered exactly once; 40 cameras."""
    rng = np.random.default_rng(225)
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
    triangles = np.concatenate([_FACES[:, [0, 1, 2]], _FACES[:, [0, 2, 3]]]).astype(np.int32)
    wrong, (height, width) = 0, (64, 96)
    for _ in range(40):
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        eye = 1 - 10.0 ** rng.uniform(-3, 0, 3)  # often very close to a wall, an edge or a corner
        view = (corners - eye * rng.choice([-1, 1], 3)) @ turn.T
        near, far = 1e-4, 10.0
        z = -(view[:, 2] * (far + near) + 2 * far * near) / (far - near)
        positions = np.stack([view[:, 0], 1.5 * view[:, 1], z, -view[:, 2]], 1).astype(np.float32)
        records = backend.setup(positions, triangles, (height, width))
        drawn = coverage_by_triangle(records, backend.spans(records), len(triangles))
        parts = [drawn(t, (0, 0, width, height)) for t in range(len(triangles))]
        image = np.asarray(backend.draw(positions, triangles, (height, width)).triangle)
        wrong += int(np.count_nonzero(sum(mask.astype(int) for mask, _ in parts) != 1)) + sum(more for _, more in parts)
        wrong += int((image < 0).sum())
    return wrong


def large_image() -> list[Mesh]:
    """A quad over 16384 x 24 px, its diagonal through a centre every 683 px.
    The case reported as nvdiffrast issue 132: a limit of 2048 px, because 32 bits hold no more."""
    low, right, bottom = HALF, 16383 * SUBPX + HALF, 24 * SUBPX + HALF
    xy = quad(*np.array([[low, low], [right, low], [right, bottom], [low, bottom]]))
    return [Mesh(xy, (24, 16384), rectangle((24, 16384), 0, 0, 16383, 24))]


def _weights(backend: Backend) -> int:
    """Weights outside of [0, 1], NaN, or with a sum that is not 1, of slivers and of ordinary triangles."""
    rng = np.random.default_rng(229)
    resolution, wrong = (100, 120), 0
    xy = rng.uniform(-20 * SUBPX, 120 * SUBPX, (60, 3, 2))
    xy[::2, 2] = xy[::2, 1] + rng.uniform(-300, 300, (30, 2))
    w = f32(10.0 ** rng.uniform(-2, 2, (60, 3)))
    for t in range(60):
        positions = clip_space(xy[t], resolution, 0.0, w[t])
        drawn = backend.draw(positions, soup(1), resolution)
        b = np.asarray(barycentrics(drawn, positions, soup(1), backend=backend.name))[np.asarray(drawn.triangle) >= 0]
        with np.errstate(invalid="ignore"):
            wrong += int((~((b >= 0) & (b <= 1))).sum() + (~(np.abs(b.sum(axis=1, dtype=np.float64) - 1) <= 2.0**-23)).sum())
    return wrong


def _thin_weights(backend: Backend) -> int:
    """NaN, infinity or a number outside of [0, 1] in the weights and depths of slivers 1/256 px wide."""
    mesh = slivers_one_subpixel()[0]
    w = f32(np.random.default_rng(460).uniform(0.5, 2, mesh.xy.shape[:2]))
    positions = clip_space(mesh.xy, mesh.resolution, 0.5, w)
    drawn = backend.draw(positions, mesh.triangles, mesh.resolution)
    weights = np.asarray(barycentrics(drawn, positions, mesh.triangles, backend=backend.name))
    hit = np.asarray(drawn.triangle) >= 0
    wrong = (~((weights[hit] >= 0) & (weights[hit] <= 1))).sum() + (np.abs(weights[hit].sum(axis=1) - 1) > 2.0**-22).sum()
    return int(wrong + (np.asarray(drawn.depth)[hit] != 0.75).sum() + (hit.sum() < 100))


def floor_under_the_camera() -> tuple[Positions, tuple[int, int]]:
    """A floor and two walls of two triangles each, some vertices behind the camera.
    The case reported as pytorch3d issue 345: such triangles are not drawn, or drawn wrong; rooms have few triangles."""
    room = np.array([(x, y, z) for x in (-2, 2) for y in (-1, 1.5) for z in (-6, 3)], np.float64)  # the eye looks along -z
    faces = np.array([[0, 1, 5], [0, 5, 4], [0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6]])
    near, far = 0.01, 20.0
    z = -(room[:, 2] * (far + near) + 2 * far * near) / (far - near)
    clip = np.stack([room[:, 0], room[:, 1], z, -room[:, 2]], 1).astype(np.float32)
    return clip[faces.ravel()], (48, 64)


def _many_in_a_bin(backend: Backend) -> int:
    """A mesh of 2 * 150 * 150 triangles, far away: in 60 x 60 px. Pixels of the middle that are not covered once."""
    x, y = np.meshgrid(np.linspace(4, 60, 151), np.linspace(4, 60, 151))
    vertices = clip_space(np.rint(np.stack([x, y], -1) * SUBPX).astype(np.int64), (512, 512))
    index = np.arange(151 * 151, dtype=np.int32).reshape(151, 151)
    a, b, c, d = (index[s].ravel() for s in (np.s_[:-1, :-1], np.s_[:-1, 1:], np.s_[1:, :-1], np.s_[1:, 1:]))
    triangles = np.concatenate([np.stack([a, b, d], 1), np.stack([a, d, c], 1)])
    low, high = (np.asarray(backend.draw(vertices, t, (512, 512)).triangle) for t in (triangles, triangles[::-1]))
    expected = np.zeros((512, 512), np.bool_)
    expected[4:60, 4:60] = True
    mirrored = np.where(high < 0, -1, len(triangles) - 1 - high)
    return int(((low >= 0) != expected).sum() + (low != mirrored).sum())


def square_of_four() -> list[Mesh]:
    """A square cut into 8 x 8 cells of two triangles, every edge through pixel centres.
    The case reported as pytorch3d issue 439: pixels on inner edges show the background."""
    x, y = np.meshgrid(np.arange(9), np.arange(9))
    v = np.stack([x, y], -1) * 6 * SUBPX + HALF
    cells = [quad(v[i, j], v[i, j + 1], v[i + 1, j + 1], v[i + 1, j]) for i in range(8) for j in range(8)]
    return [Mesh(np.concatenate(cells), (64, 64), rectangle((64, 64), 0, 0, 48, 48))]


def _depth_image(backend: Backend) -> int:
    """A bumpy sheet of small triangles at 640 x 480: holes and NaN in depth and weights."""
    x, y = np.meshgrid(np.linspace(-0.8, 0.8, 80), np.linspace(-0.8, 0.8, 80))
    w = 2 + 0.5 * np.sin(9 * x) * np.cos(7 * y)
    positions = np.stack([x * w, y * w, 0.2 * w * w - 1, w], -1).reshape(-1, 4).astype(np.float32)
    index = np.arange(80 * 80, dtype=np.int32).reshape(80, 80)
    a, b, c, d = (index[s].ravel() for s in (np.s_[:-1, :-1], np.s_[:-1, 1:], np.s_[1:, :-1], np.s_[1:, 1:]))
    triangles = np.concatenate([np.stack([a, b, d], 1), np.stack([a, d, c], 1)])
    drawn = backend.draw(positions, triangles, (480, 640))
    weights = np.asarray(barycentrics(drawn, positions, triangles, backend=backend.name))
    inner, depth = np.s_[49:431, 65:575], np.asarray(drawn.depth)
    return int((np.asarray(drawn.triangle)[inner] < 0).sum() + (~np.isfinite(depth[inner])).sum() + (~np.isfinite(weights)).sum())


def _overflow(backend: Backend) -> int:
    """Coordinates beyond 32767 px at 2560 x 1440, where 16.16 fixed point wraps: guard words, and one pixel of truth."""
    resolution = (1440, 2560)
    rng = np.random.default_rng(4668)
    xy = rng.choice([-1, 1], (12, 3, 2)) * rng.uniform(20000, 90000, (12, 3, 2)) * SUBPX
    memory = np.full((3, *resolution), 0x5555, np.int64)
    backend.draw(clip_space(xy, resolution), soup(12), resolution, out=memory[1])
    wrong, first = int((memory[::2] != 0x5555).sum()), 2**32 - 1  # of the background's bits
    centre = np.array([1280 * SUBPX + HALF, 720 * SUBPX + HALF])
    for t in range(11, -1, -1):  # far from all edges, float64 is enough
        along, away = np.roll(xy[t], -1, axis=0) - xy[t], centre - xy[t]
        edges = along[:, 0] * away[:, 1] - along[:, 1] * away[:, 0]
        if (edges > 0).all() or (edges < 0).all():
            first = t
    return wrong + int((memory[1, 720, 1280] & 0xFFFFFFFF) != first)


def _not_a_number(backend: Backend) -> int:
    """Infinity times zero in every vertex: NaN, INT_MIN as an integer, and a walk of 2^31 px. Five seconds are allowed."""
    positions = np.full((300, 4), np.nan, np.float32)
    positions[:, 2:] = 0, 1
    started = time.perf_counter()
    drawn = backend.draw(positions, soup(100), (384, 496))
    slow = time.perf_counter() - started > 5
    return int((np.asarray(drawn.packed) != NOTHING).sum()) + int(drawn.dropped != 100) + slow


def two_diamonds() -> list[Mesh]:
    """Two diamonds that meet in a point on a line of pixel centres, 20 x 10 px.
    The case reported as datashader issue 1494: columns of centres on an edge stay empty."""
    middle, meshes = np.array([9, 5]) * SUBPX + HALF, []
    for reach in (4, 3):
        points = np.array([[0, 0], [reach, -reach], [2 * reach, 0], [reach, reach]]) * SUBPX
        right, left = middle + points, middle - points
        meshes.append(Mesh(np.concatenate([quad(*right), quad(*left)]), (11, 20)))
    return meshes


def _case(name: str, family: str, title: str, invariant: str, wrong: object, reason: str) -> Case:
    return Case(name, family, title, invariant, reason, wrong)  # type: ignore[arg-type]


REPORTS: list[Case] = [
    _case(
        "nvdiffrast-225",
        "clipping",
        "A box of 12 triangles from inside, 40 cameras close to its walls",
        "each pixel exactly once",
        _room,
        "The case reported as nvdiffrast issue 225: black dots at the seams of large, clipped triangles.",
    ),
    mesh_case("nvdiffrast-132", "far", large_image, "each pixel exactly once", "i32"),
    _case(
        "nvdiffrast-229",
        "attributes",
        "Weights of 60 triangles, every other one a sliver",
        "each in [0, 1], their sum within 1 ulp of 1",
        _weights,
        "The case reported as nvdiffrast issue 229: u + v > 1.",
    ),
    projected_case("pytorch3d-345", "clipping", floor_under_the_camera, "incl strict tl"),
    _case(
        "pytorch3d-348",
        "capacity",
        "45000 triangles in one bin",
        "each pixel exactly once",
        _many_in_a_bin,
        "The case reported as pytorch3d issue 348: more triangles in a bin than its list holds; the rest is lost.",
    ),
    mesh_case("pytorch3d-439", "ties", square_of_four, "each pixel exactly once", "incl strict third"),
    _case(
        "pytorch3d-448",
        "capacity",
        "A bumpy sheet of 12482 triangles, its depth image",
        "no hole, no NaN",
        _depth_image,
        "The case reported as pytorch3d issue 448: a depth image with holes.",
    ),
    _case(
        "pytorch3d-460",
        "attributes",
        "Weights and depths of 100 slivers 1/256 px wide",
        "finite, in [0, 1], constant depth exact",
        _thin_weights,
        "The case reported as pytorch3d issue 460: NaN in one pixel of a face that is nearly a line.",
    ),
    _case(
        "keeperfx-4668",
        "overflow",
        "12 triangles of up to 90000 px at 2560 x 1440",
        "guard words untouched, the middle right",
        _overflow,
        "The case reported as keeperfx pull request 4668: 16.16 fixed point wraps, and the write lands elsewhere.",
    ),
    _case(
        "mame-15712",
        "input",
        "100 triangles of NaN",
        "nothing drawn, all counted, within seconds",
        _not_a_number,
        "The case reported as mame pull request 15712: NaN becomes INT_MIN, and a line 2^31 px long.",
    ),
    mesh_case("datashader-1494", "ties", two_diamonds, "equals exact integer coverage", "incl strict third"),
]

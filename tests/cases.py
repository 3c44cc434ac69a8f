"""Meshes in clip space for the tests that compare backends: each is a construction with a reason."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray


class Case(NamedTuple):
    positions: NDArray[np.float32]  # [V, 4], clip space
    triangles: NDArray[np.int32]  # [T, 3]
    resolution: tuple[int, int]  # height, width


def soup(corners: NDArray[np.floating], resolution: tuple[int, int]) -> Case:
    """Unconnected triangles from clip-space corners [T, 3, 4]."""
    positions = np.ascontiguousarray(corners, np.float32).reshape(-1, 4)
    return Case(positions, np.arange(len(positions), dtype=np.int32).reshape(-1, 3), resolution)


def from_pixels(xy: NDArray[np.floating], z: NDArray[np.floating], resolution: tuple[int, int]) -> Case:
    """Triangles from pixel positions xy [T, 3, 2] (y down) and window depths z [T, 3]."""
    height, width = resolution
    x = xy[..., 0] / (width / 2) - 1
    y = 1 - xy[..., 1] / (height / 2)
    return soup(np.stack([x, y, 2 * z - 1, np.ones_like(x)], axis=-1), resolution)


def random_corners(rng: np.random.Generator, count: int, spread: float, behind: bool = False) -> NDArray[np.float64]:
    """[count, 3, 4] around the origin; w of either sign if ``behind``."""
    w = rng.normal(0.5, 1, (count, 3, 1)) if behind else rng.uniform(0.5, 2, (count, 3, 1))
    xy = rng.normal(0, spread, (count, 3, 2)) * w
    z = rng.uniform(-1.1, 1.2, (count, 3, 1)) * np.abs(w)
    return np.concatenate([xy, z, w], axis=-1)


def screen_size(rng: np.random.Generator) -> Case:
    return soup(random_corners(rng, 30, 1.2), (201, 333))


def many_small(rng: np.random.Generator) -> Case:
    corners = random_corners(rng, 800, 0.8)
    corners[:, 1:] = corners[:, :1] + rng.normal(0, 0.03, (800, 2, 4)) * [1, 1, 0, 0]
    return soup(corners, (190, 260))


def guard_band(rng: np.random.Generator) -> Case:
    """Clipped at the guard planes, on all sides."""
    return soup(random_corners(rng, 40, 300), (77, 129))


def huge(rng: np.random.Generator) -> Case:
    """As far out as float32 can hold, and everything between."""
    scale = 10.0 ** rng.uniform(-3, 30, (40, 3, 1))
    one = np.ones_like(scale)
    return soup(random_corners(rng, 40, 1) * np.concatenate([scale, scale, one, one], axis=-1), (64, 65))


def behind_camera(rng: np.random.Generator) -> Case:
    """w of either sign: the near plane cuts nearly all of them."""
    return soup(random_corners(rng, 60, 1.5, behind=True), (150, 151))


def far_depth(rng: np.random.Generator) -> Case:
    """Window depths beyond 1, dropped per fragment, and beyond 2.5, clipped."""
    corners = random_corners(rng, 40, 1.2)
    corners[..., 2] = rng.uniform(-1, 6, (40, 3)) * corners[..., 3]
    return soup(corners, (120, 200))


def slivers(rng: np.random.Generator) -> Case:
    """Needles of about 1/100 px to 1 px: the thin-triangle rule of depth on both of its sides."""
    height, width = 260, 300
    a, b = rng.uniform(-50, 350, (2, 80, 2))
    direction = (b - a) / np.linalg.norm(b - a, axis=1, keepdims=True)
    c = b + np.stack([-direction[:, 1], direction[:, 0]], 1) * 10.0 ** rng.uniform(-2, 0.3, (80, 1))
    return from_pixels(np.stack([a, b, c], 1), rng.uniform(0.1, 0.9, (80, 3)), (height, width))


def needles_on_centres(rng: np.random.Generator) -> Case:
    """Needles of the least area there is, pixel centres on an edge: a plane would lose their depth, the thin rule does not."""
    step = np.array([(m, n) for m in range(2, 40) for n in range(2, 40) if np.gcd(m, n) == 1])
    step = step[rng.integers(0, len(step), 120)]
    side = rng.choice([-1, 1], 120)
    y = np.array([pow(int(m), -1, int(n)) * int(s) % int(n) for (m, n), s in zip(step, side, strict=True)])
    x = (step[:, 0] * y - side) // step[:, 1]  # subpx; (x, y) is beside the edge by the least that a grid of subpx allows
    first = rng.integers(0, 90, (120, 2)) + 0.5
    last = first + step * rng.integers(2, 5, (120, 1))
    corner = first + np.stack([x, y], axis=1) / 256
    z = np.concatenate([rng.integers(1, 60, (120, 2)) * 2.0**-24, rng.uniform(0.5, 0.9, (120, 1))], axis=1)
    return from_pixels(np.stack([first, last, corner], axis=1), z, (256, 256))


def on_centres(rng: np.random.Generator) -> Case:
    """A mesh whose vertices and edges pass through pixel centres: every tie that there is."""
    n = 18
    gx, gy = np.meshgrid(np.arange(n) * 7 + 0.5, np.arange(n) * 5 + 0.5)
    v = np.stack([gx, gy], -1)
    a, b, c, d = v[:-1, :-1], v[:-1, 1:], v[1:, :-1], v[1:, 1:]
    diagonal = rng.integers(0, 2, a.shape[:2]).astype(bool)[..., None, None]
    first = np.where(diagonal, np.stack([a, b, d], 2), np.stack([a, b, c], 2))
    second = np.where(diagonal, np.stack([a, d, c], 2), np.stack([b, d, c], 2))
    xy = np.concatenate([first, second]).reshape(-1, 3, 2)
    return from_pixels(xy, rng.uniform(0.2, 0.8, xy.shape[:2]), (96, 128))


def on_bins(rng: np.random.Generator) -> Case:
    """Vertices at 8, 64 and 128 px, on them, beside them, and half a pixel away."""
    base = rng.choice([0, 8, 64, 72, 120, 128, 192], (120, 3, 2))
    xy = base + rng.choice([-0.5, -1 / 256, 0, 1 / 256, 0.5], base.shape)
    return from_pixels(xy, rng.uniform(0.1, 0.9, (120, 3)), (192, 256))


def equal_depth(rng: np.random.Generator) -> Case:
    """Coplanar triangles in every order, and the same triangle again with its vertices rotated: the lower index wins."""
    xy = np.tile(rng.uniform(0, 128, (10, 3, 2)), (3, 1, 1))
    xy[10:20] = xy[10:20][:, [1, 2, 0]]
    return from_pixels(xy, np.full(xy.shape[:2], 0.25), (128, 128))


def layers(rng: np.random.Generator) -> Case:
    """Screen-filling triangles from back to front: hidden-surface rejection has most to do."""
    xy = np.tile(np.array([[-20.0, -20.0], [900.0, -20.0], [-20.0, 700.0]]), (60, 1, 1)) + rng.uniform(0, 8, (60, 3, 2))
    z = np.linspace(0.9, 0.1, 60)[:, None] + rng.uniform(-0.02, 0.02, (60, 3))
    return from_pixels(xy, z, (210, 330))


def corner_of_huge(rng: np.random.Generator) -> Case:
    """A small bbox at the screen's corners, cut from triangles as large as the guard band: edge values beyond int32."""
    height, width = 100, 120
    near = rng.uniform(2, 12, (60, 1, 2))
    far = -(10.0 ** rng.uniform(3, 4.4, (60, 2, 2)))
    far[:20, 0, 0] = near[:20, 0, 0] + 1  # 20 triangles only beyond the upper or lower border
    xy = np.concatenate([near, far], axis=1)
    mirrored = rng.integers(0, 2, (60, 1, 2)).astype(bool)
    return from_pixels(np.where(mirrored, [width, height] - xy, xy), rng.uniform(0.1, 0.9, (60, 3)), (height, width))


def on_planes(rng: np.random.Generator) -> Case:
    """Vertices exactly on the clip planes beside others inside and outside, and the point without a place, (0, 0, 0, 0)."""
    low, high = -(2**23 + 2**14) / 2**14, (2**23 - 1 - 2**14) / 2**14  # guard planes of 128 px; -y is to Y what x is to X
    x, minus_y = rng.choice(
        [low, high, 2 * low, 2 * high, -1, -0.5, 0, 0.25, 1], (2, 160, 3), p=[0.08] * 2 + [0.02] * 2 + [0.16] * 5
    )
    z = rng.choice([-1, -1.5, -0.5, 0, 0.75, 1, 4, 5], (160, 3), p=[0.3, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1])
    corners = np.stack([x, -minus_y, z, np.ones_like(x)], axis=-1) * rng.choice([0.5, 1, 2], (160, 3, 1))
    corners[::9, 1] = 0
    return soup(corners, (128, 128))


def half_subpixels(rng: np.random.Generator) -> Case:
    """Vertices halfway between points of the sub-pixel grid: rounded half to even, on both sides of the screen's middle.

    Half of them are divided by a w whose reciprocal is inexact: only a true division finds the middle again.
    """
    case = from_pixels(
        rng.integers(-40, 300, (150, 3, 2)) / 2 + rng.choice([-1, 1, 3], (150, 3, 2)) / 512,
        rng.uniform(0.1, 0.9, (150, 3)),
        (128, 128),
    )
    return case._replace(
        positions=case.positions * rng.choice([1, 49, 103, 107], (450, 1), p=[0.5, 0.2, 0.2, 0.1]).astype(np.float32)
    )


def degenerate(rng: np.random.Generator) -> Case:
    """No area, by a vertex named twice or three on a line, between triangles that have some."""
    a, step = rng.integers(0, 60, (2, 90, 2))
    middle = np.where(rng.integers(0, 2, (90, 1)).astype(bool), a, a + step)
    c = np.where(np.arange(90)[:, None] % 3 == 0, rng.integers(0, 128, (90, 2)), a + 2 * step)
    return from_pixels(np.stack([a, middle, c], axis=1), rng.uniform(0.1, 0.9, (90, 3)), (128, 128))


def ties_at_bounds(rng: np.random.Generator) -> Case:
    """Flat triangles at few depths, 1 and the next float32 among them: what fills the screen comes last and hides no equal."""
    centre = rng.uniform(0, 192, (120, 1, 2))
    xy = centre + rng.normal(0, 1, (120, 3, 2)) * 10.0 ** rng.uniform(0.3, 2, (120, 1, 1))
    z = rng.choice([0.25, 0.5, 1, 1 + 2.0**-23], (120, 1))
    xy[100:] = [[-10, -10], [600, -10], [-10, 600]]
    z[100:] = rng.choice([0.5, 1], (20, 1))
    # The nearest depth is left to the left half, so that every other is seen somewhere.
    xy[(z < 0.5).all(axis=1), :, 0] *= 0.3
    xy[(z == 0.5).all(axis=1) & (np.arange(120) >= 100), 1, 0] = 130
    return from_pixels(xy, np.broadcast_to(z, (120, 3)), (192, 192))


def crossings(rng: np.random.Generator) -> Case:
    """Steep planes across the whole screen that cross: many tiles and bins in which a plane shows at one corner only."""
    xy = np.tile(np.array([[-40.0, -40.0], [1100.0, -40.0], [-40.0, 1100.0]]), (14, 1, 1)) + rng.uniform(0, 30, (14, 3, 2))
    slope = rng.uniform(-1, 1, (14, 1, 2)) / 1200
    z = 0.45 + (slope * (xy - rng.uniform(100, 400, (14, 1, 2)))).sum(axis=-1) + 0.03 * rng.uniform(0, 1, (14, 1))
    return from_pixels(xy, np.clip(z, 0.001, 0.999), (512, 512))


def crowded(rng: np.random.Generator) -> Case:
    """More large triangles in a bin than are drawn together, thin and far ones among them."""
    corners = random_corners(rng, 260, 1.5)
    corners[::4, 2, :2] = corners[::4, 1, :2] + rng.normal(0, 0.002, (65, 2))
    return soup(corners, (140, 150))


def small_on_cells(rng: np.random.Generator) -> Case:
    """Up to 17 px a side over the borders of cells, steep, some beyond z = 1: edges on pixel centres, level and upright ones."""
    count = 380
    side = rng.choice([1, 2, 3, 7, 8, 15, 16], (count, 1, 2))
    at_border = rng.choice([64, 128, 192], (count, 1, 2)) - rng.integers(0, side + 1)
    corner = np.where(rng.random((count, 1, 2)) < 0.6, at_border, rng.integers(0, 240, (count, 1, 2)))
    inside = rng.integers(0, side + 1, (count, 3, 2))
    inside[:, 0] *= rng.integers(0, 2, (count, 2))
    inside[:, 1] = np.where(rng.random((count, 2)) < 0.8, side[:, 0], inside[:, 1])
    level = rng.random((count, 2)) < 0.3
    inside[:, 2] = np.where(level, inside[:, 0], inside[:, 2])
    xy = corner + inside + rng.choice([0, 0.5, 0.5, 0.5 + 1 / 256, 0.5 - 1 / 256], (count, 1, 2))
    xy += rng.choice([0, 0, 0, 0, 1 / 256, -1 / 256], xy.shape)
    return from_pixels(xy, rng.uniform(0, 1, (count, 3)) * rng.choice([1, 1, 1, 1.2], (count, 1)), (256, 256))


def half_boxes(rng: np.random.Generator) -> Case:
    """Halves of 8x8 px with 36 pixels each: more than the GPU lists at once for 32 of them, so that it lists a quarter at a time.

    In front of them, one in eight: halves of 16x16 px, some of which go beyond z = 1.
    """
    count, size = 288, 160
    legs = np.tile(np.array([[-1, -1], [7 * 256 + 2, -1], [-1, 7 * 256 + 2]]) / 256, (count, 1, 1))
    z = rng.uniform(0.1, 0.95, (count, 3))
    legs[::8] = np.array([[-1, -1], [15 * 256 + 2, -1], [-1, 15 * 256 + 2]]) / 256
    z[::8] = rng.uniform(0.01, 0.1, (36, 3))
    z[::24] = rng.uniform(0.9, 1.2, (12, 3))
    corner = rng.integers(16, size - 16, (count, 1, 2)) + 0.5
    return from_pixels(corner + legs * rng.choice([1, -1], (count, 1, 2)), z, (size, size))


def mesh_of_small(rng: np.random.Generator) -> Case:
    """A mesh of 11 px triangles: vertices of several triangles each, with a w of their own, more than one block has threads."""
    n = 18
    gx, gy = np.meshgrid(np.arange(n), np.arange(n))
    xy = np.stack([gx, gy], axis=-1) * 11 + rng.integers(-3, 4, (n, n, 2)) + rng.choice([0, 0.5, 0.25], (n, n, 2))
    case = from_pixels(xy.reshape(-1, 1, 2), rng.uniform(0.01, 0.99, (n * n, 1)), (190, 189))
    k = (gy * n + gx).astype(np.int32)
    a, b, c, d = k[:-1, :-1], k[:-1, 1:], k[1:, :-1], k[1:, 1:]
    triangles = np.stack([np.stack([a, b, d], axis=-1), np.stack([a, d, c], axis=-1)]).reshape(-1, 3)
    w = rng.choice([1, 0.75, 49, 103], (n * n, 1)).astype(np.float32)
    return Case(case.positions * w, np.ascontiguousarray(rng.permutation(triangles)), case.resolution)


def small_by_the_screen(rng: np.random.Generator) -> Case:
    """Of triangles of about 32 px, and up to 1000, the screen leaves 16 px and less; their edges go through pixel centres."""
    count, size = 240, 128
    long = rng.choice([31, 32 - 1 / 256, 32, 32 + 1 / 256, 33, 48, 64, 256, 1000], (count, 1))
    slant = rng.choice([0, 0, 1, -1, 2, 8, -8], (count, 1))
    near = rng.integers(0, 12, (count, 2)) + 0.5 + np.where(rng.random((count, 1)) < 0.3, [0, 50], [0, 0])
    out = np.concatenate([-long, slant], axis=1)
    beside = near + rng.integers(-4, 11, (count, 2))
    beside += out * rng.choice([0, 0, 1], (count, 1))
    xy = np.stack([near, near + out, beside], axis=1)
    xy = np.where(rng.random((count, 1, 2)) < 0.5, xy, size - xy)
    xy = np.where(rng.random((count, 1, 1)) < 0.5, xy, xy[..., ::-1])
    return from_pixels(xy, rng.uniform(0.05, 0.95, (count, 3)), (size, size))


def beside_centres(rng: np.random.Generator) -> Case:
    """Corners of triangles of some 200 px, within 8x8 px; an edge passes a pixel centre by as little as the grid allows.

    In its row the edge crosses at most 2^-14 px beside the centre. The triangles that the centre is outside of are the nearest.
    """
    centre, found, depths = 1.5 * 256, [], []
    while len(found) < 96:
        across, down = int(rng.integers(-1700, -600)), int(rng.integers(48_000, 56_000))
        if math.gcd(across, down) != 1:
            continue
        # The first point at a distance of `beside` / |edge| from the centre, on either side of it, less than an edge away.
        beside = int(rng.choice([-2, -1, 1, 2]))
        above = beside * pow(-across, -1, down) % down
        left = (across * above + beside) // down
        top = np.array([centre - left, centre - above])
        bottom = top + [across, down]
        if 0 < bottom[1] < 7.9 * 256 and 0 < top[0] < 7.9 * 256:
            found.append(np.stack([top, bottom, [-40_000, -20_000]]) / 256)
            depths.append(rng.uniform(0.1, 0.3, 3) + (0.6 if beside < 0 else 0))
    return from_pixels(np.stack(found), np.stack(depths), (40, 50))


def long_slivers(rng: np.random.Generator) -> Case:
    """64 px and longer, about 4 px wide on average and narrower, edges through pixel centres, and ends cut nearly straight.

    Near the axes and on the diagonals, so that they cross cells at their borders; more than the size of the image, some of
    65,000 px, whose edges miss a pixel centre by the least there is; with their widest place in the middle; and thin ones.
    """
    count, size = 320, 256
    kind = np.arange(count) % 5
    first = rng.integers(-20, 200, (count, 2)) + 0.5
    length = rng.integers(64, 230, (count, 1))
    across = rng.choice([0, 1, -1, 3, -5], (count, 1))
    step = np.concatenate([length, np.where(rng.random((count, 1)) < 0.4, length + across, across)], axis=1)
    last = first + step
    # The ends of very long ones: from a pixel centre on the screen by the same step both ways, or by others.
    m = np.concatenate([rng.integers(150, 200, (count, 1)), rng.integers(-150, 150, (count, 1))], axis=1)
    centre = rng.integers(60, 200, (count, 2)) + 0.5
    far = (kind == 3)[:, None]
    first = np.where(far, centre - m * rng.integers(1, 150, (count, 1)), first)
    last = np.where(far, centre + m * rng.integers(100, 150, (count, 1)), last)
    width = rng.choice([1, 2, 4, 7, 8 - 1 / 256, 8, 8 + 1 / 256], (count, 1))
    upright = np.concatenate([rng.choice([0, 1, -2, 5], (count, 1)) / 256, width], axis=1)
    middle = (last - first) * (rng.integers(1, 8, (count, 1)) / 8) // 1
    third = np.where((kind == 1)[:, None], first + middle + [0, 1] * np.ceil(width), last + upright)
    third = np.where((kind == 2)[:, None], last + rng.integers(-7, 8, (count, 2)), third)
    third = np.where((kind == 4)[:, None], last + rng.integers(1, 16, (count, 1)) / 256 * [0, 1], third)
    xy = np.stack([first, last, third], axis=1)
    xy = np.where(rng.random((count, 1, 2)) < 0.5, xy, size - xy)
    xy = np.where(rng.random((count, 1, 1)) < 0.5, xy, xy[..., ::-1])
    return from_pixels(xy, rng.uniform(0.02, 1.05, (count, 3)), (size, size))


def slivers_across(rng: np.random.Generator) -> Case:
    """As long as the widest image there is, and shorter: in several parts, of which some are empty."""
    height, width, count = 5, 16384, 60
    length = 10 ** rng.uniform(2, 4.5, (count, 1))
    middle = rng.uniform([0, 0], [width, height], (count, 2))
    along = np.concatenate([length, rng.uniform(-9, 9, (count, 1))], axis=1)
    upright = np.concatenate([np.zeros((count, 1)), rng.uniform(1 / 256, 4, (count, 1))], axis=1)
    xy = np.stack([middle - along / 2, middle + along / 2, middle - along / 2 + upright], axis=1)
    return from_pixels(xy, rng.uniform(0.1, 0.9, (count, 3)), (height, width))


def steep_ends(rng: np.random.Generator) -> Case:
    """Slivers, none behind another, whose short edge passes pixel centres by less than a pixel in 256 lines.

    It bounds what is drawn, but where it crosses a line says little.
    """
    lean, width, mirrored = (v.ravel() for v in np.meshgrid([-2, -1, 0, 1, 2], [4, 8], [1, -1], indexing="ij"))
    count = len(lean)
    along = np.stack([np.zeros(count), np.full(count, 70.0), 70 + lean / 256], axis=1) * mirrored[:, None]
    across = np.stack([np.zeros(count), np.zeros(count), width], axis=1)
    start = np.stack([np.where(mirrored > 0, 10.5, 90.5), 10.5 + 10 * np.arange(count)], axis=1)
    flat = np.stack([start[:, :1] + along, start[:, 1:] + across], axis=2)
    upright = flat[:, :, ::-1] + [90, 0]
    return from_pixels(np.concatenate([flat, upright]), rng.uniform(0.1, 0.9, (2 * count, 3)), (220, 310))


def clipped_fans(rng: np.random.Generator) -> Case:
    """Wedges that open to the right from a point on the screen, cut by the near plane, the guard band and the depth plane.

    All parts of a fan share its leftmost vertex and so are seen: some three of a triangle, and few triangles.
    """
    count = 200
    x = np.sort(rng.uniform(-1, 1, count))
    tip = np.stack([x, rng.uniform(-0.9, 0.9, count), -0.8 * x + rng.uniform(-0.2, 0.1, count), np.ones(count)], axis=1)
    scale = 10.0 ** rng.uniform(2.3, 3.5, (count, 2))
    angle = rng.uniform(0.9, 1.5, (count, 2)) * [-1, 1]
    ends = np.zeros((count, 2, 4))
    ends[..., 0], ends[..., 1] = scale * np.cos(angle), scale * np.sin(angle)
    ends[..., 2] = rng.uniform(-1, 1, (count, 2)) * rng.choice([1, 50], (count, 1))
    ends[..., 3] = rng.choice([1, 1, 0.1, -0.5], (count, 2))
    return soup(np.concatenate([tip[:, None], ends], axis=1)[rng.permutation(count)], (120, 130))


def small_clipped(rng: np.random.Generator) -> Case:
    """Triangles of some 10 px that the near plane cuts, so that the parts are small too."""
    count = 150
    xy = rng.uniform(4, 140, (count, 1, 2)) + rng.uniform(-7, 7, (count, 3, 2))
    return from_pixels(xy, rng.uniform(-0.3, 0.5, (count, 3)), (140, 150))


def hundreds_in_a_bin(rng: np.random.Generator) -> Case:
    """In one bin more triangles than are drawn together, nearly all of them seen; few in others, so that the bounds are apart."""
    count = 460
    xy = rng.uniform(66, 126, (count, 1, 2)) + rng.uniform(-4, 4, (count, 3, 2))
    xy[::12] += rng.choice([-64, 0, 64], (len(xy[::12]), 1, 2))
    return from_pixels(xy, rng.uniform(0.1, 0.9, (count, 3)), (200, 194))


def hundreds_in_a_list(rng: np.random.Generator) -> Case:
    """The same with triangles of some 25 px, which the GPU keeps in lists for each bin; in some bins there is only one."""
    count = 420
    xy = rng.uniform(80, 112, (count, 1, 2)) + rng.uniform(-13, 13, (count, 3, 2))
    xy[::12] += rng.choice([-64, 0, 64], (len(xy[::12]), 1, 2))
    xy[0] += [[128, -64]]
    xy[1] += [[192, 128]]
    return from_pixels(xy, rng.uniform(0.1, 0.9, (count, 3)), (260, 330))


def steep_from_near(rng: np.random.Generator) -> Case:
    """An edge through pixel centres at the least depths there are, the far end of depth beside it: clamping decides its bits."""
    count = 90
    step = rng.choice([1, 2, 3, 5], (count, 2)) * rng.choice([1, -1], (count, 2)) * (rng.random((count, 2)) < 0.7)
    step[~step.any(axis=1)] = [1, 0]
    first = rng.integers(20, 180, (count, 2)) + 0.5
    last = first + step * rng.integers(4, 20, (count, 1))
    third = last + rng.choice([-1, 1], (count, 2)) * rng.integers(16, 200, (count, 2)) / 256
    near = np.repeat(rng.integers(0, 9, (count, 1)) * 2.0**-25, 2, axis=1)
    return from_pixels(
        np.stack([first, last, third], axis=1), np.concatenate([near, rng.uniform(0.5, 0.99, (count, 1))], axis=1), (256, 256)
    )


def not_finite(rng: np.random.Generator) -> Case:
    corners = random_corners(rng, 40, 1)
    corners[::5, 1, rng.integers(0, 4)] = np.nan
    corners[1::7, 2, rng.integers(0, 4)] = -np.inf
    return soup(corners, (50, 90))


def inside_sphere(rng: np.random.Generator) -> Case:
    """A closed mesh around the camera: cut by the near plane all around."""
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=3.0)
    view = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    p = mesh.vertices @ view.T + rng.uniform(-1, 1, 3)
    near, far = 0.5, 10.0
    z = -(p[:, 2] * (far + near) + 2 * far * near) / (far - near)
    return Case(np.stack([p[:, 0], 1.3 * p[:, 1], z, -p[:, 2]], 1).astype(np.float32), mesh.faces.astype(np.int32), (113, 171))


def sized(resolution: tuple[int, int]) -> Callable[[np.random.Generator], Case]:
    def make(rng: np.random.Generator) -> Case:
        corners = np.concatenate([random_corners(rng, 8, 1.2), random_corners(rng, 4, 30)])
        return soup(corners, resolution)

    return make


# Names are the tests' ids.
CASES: dict[str, Callable[[np.random.Generator], Case]] = {
    f.__name__: f
    for f in (
        screen_size,
        many_small,
        guard_band,
        huge,
        behind_camera,
        far_depth,
        slivers,
        needles_on_centres,
        on_centres,
        on_bins,
        equal_depth,
        layers,
        corner_of_huge,
        on_planes,
        half_subpixels,
        degenerate,
        ties_at_bounds,
        crossings,
        crowded,
        small_on_cells,
        half_boxes,
        mesh_of_small,
        small_by_the_screen,
        beside_centres,
        long_slivers,
        slivers_across,
        steep_ends,
        clipped_fans,
        hundreds_in_a_bin,
        hundreds_in_a_list,
        small_clipped,
        steep_from_near,
        not_finite,
        inside_sphere,
    )
}
for height, width in ((1, 1), (1, 65), (65, 1), (63, 63), (64, 64), (7, 16384), (16384, 3), (1079, 1919)):
    CASES[f"size_{width}x{height}"] = sized((height, width))

"""The meshes H01 to H20, on the sub-pixel grid unless it says otherwise. Some are smaller than the case in the literature.

Each builder's docstring is the case's title and, below it, the reason why it is hard. Every random number has a seed.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..study import scenes
from .mesh import SUBPX, Case, Mesh, f32, mesh_case

HALF = SUBPX // 2
Points = NDArray[np.int64]


def px(values: object) -> Points:
    """Coordinates in px as subpx, rounded half to even."""
    return np.rint(np.asarray(values, np.float64) * SUBPX).astype(np.int64)


def fan(centre: Points, rim: Points) -> Points:
    """[N, 3, 2]: the triangles of a closed fan of points ``rim`` [N, 2] around ``centre`` [2]."""
    return np.stack([np.broadcast_to(centre, rim.shape), rim, np.roll(rim, -1, axis=0)], axis=1)


def quad(a: Points, b: Points, c: Points, d: Points) -> Points:
    """[2, 3, 2]: a quadrilateral cut from a to c; the two use the diagonal in opposite directions."""
    return np.array([[a, b, c], [a, c, d]], np.int64)


def grid(vertices: Points, diagonal: NDArray[np.bool_] | bool = True) -> Points:
    """[T, 3, 2]: two triangles for each cell of vertices [R, C, 2]; ``diagonal`` [R - 1, C - 1] chooses which is cut."""
    a, b, c, d = vertices[:-1, :-1], vertices[:-1, 1:], vertices[1:, :-1], vertices[1:, 1:]
    choice = np.broadcast_to(diagonal, a.shape[:2])[..., None, None]
    first = np.where(choice, np.stack([a, b, d], 2), np.stack([a, b, c], 2))
    second = np.where(choice, np.stack([a, d, c], 2), np.stack([b, d, c], 2))
    return np.concatenate([first, second]).reshape(-1, 3, 2)


def rectangle(resolution: tuple[int, int], x0: int, y0: int, x1: int, y1: int) -> NDArray[np.bool_]:
    """bool [H, W], True in the half-open rectangle, px."""
    mask = np.zeros(resolution, np.bool_)
    mask[y0:y1, x0:x1] = True
    return mask


def quad_on_centres() -> list[Mesh]:
    """Quad (.5, .5) to (200.5, 200.5), its diagonal through pixel centres.
    Every border and the diagonal are ties, which only a fill rule decides."""
    low, high = HALF, 200 * SUBPX + HALF
    xy = quad(*np.array([[low, low], [high, low], [high, high], [low, high]]))
    return [Mesh(xy, (256, 256), rectangle((256, 256), 0, 0, 200, 200))]


def fan_through_centres() -> list[Mesh]:
    """24 spokes through pixel centres, around a centre.
    All triangles meet in one sample, and each spoke passes through many."""
    steps = [(p, q) for p in range(-3, 4) for q in range(-3, 4) if np.gcd(p, q) == 1 and {abs(p), abs(q)} != {2, 3}]
    steps.sort(key=lambda step: np.arctan2(step[1], step[0]))
    rim = np.array([[p * (100 // max(abs(p), abs(q))), q * (100 // max(abs(p), abs(q)))] for p, q in steps])
    centre = np.array([128, 128]) * SUBPX + HALF
    return [Mesh(fan(centre, centre + rim * SUBPX), (256, 256), rectangle((256, 256), 110, 110, 147, 147))]


def mesh_on_centres() -> list[Mesh]:
    """18 x 18 grid, all vertices on pixel centres, mixed diagonals.
    Ties at every vertex and on every horizontal and vertical edge."""
    x, y = np.meshgrid(np.arange(18) * 7, np.arange(18) * 5)
    diagonal = np.random.default_rng(3).integers(0, 2, (17, 17)).astype(bool)
    xy = grid(np.stack([x, y], -1) * SUBPX + HALF, diagonal)
    return [Mesh(xy, (96, 128), rectangle((96, 128), 0, 0, 119, 85))]


def drtk_9() -> list[Mesh]:
    """Quad (.5, .49994) to (6.50006, 6.5), given with a rounding error of 2^-14 px.
    The case reported as DRTK issue 9: ties along the diagonal, decided by unequal roundings."""
    x, y = [0.5, 0.5, 6.50006103515625, 6.50006103515625], [0.49993896484375, 6.5, 0.49993896484375, 6.5]
    raw = np.stack([x, y], -1)[[[0, 1, 2], [3, 2, 1]]] * SUBPX
    return [Mesh(np.rint(raw).astype(np.int64), (8, 8), rectangle((8, 8), 1, 1, 6, 6), raw)]


def shared_edges_through_centres() -> list[Mesh]:
    """12 pairs of large triangles, the shared edge through pixel centres, its ends at fractions of a pixel.
    Both products of the edge function are equal but too long for 24 bits; if one is left unrounded, the rounding error
    of the other decides."""
    rng = np.random.default_rng(5)
    height, width = 1080, 1920
    xy: list[list[Points]] = []
    while len(xy) < 24:
        p, q = (int(v) for v in rng.integers(-9, 10, 2))
        if np.gcd(p, q) != 1 or p == 0 or q == 0:
            continue
        centre = np.array([rng.integers(width // 3, 2 * width // 3), rng.integers(height // 3, 2 * height // 3)]) * SUBPX + HALF
        reach = min(width / abs(p), height / abs(q)) * SUBPX / 3
        k, m = (int(v) for v in rng.uniform(0.5, 1, 2) * reach)
        a, b = centre - k * np.array([p, q]), centre + m * np.array([p, q])
        aside = np.array([-q, p]) * int(reach / 2) + rng.integers(-SUBPX, SUBPX, 2)
        xy += [[a, b, centre + aside], [b, a, centre - aside]]
    return [Mesh(np.array(xy), (height, width))]


def fill_rule_quads() -> list[Mesh]:
    """Quads with rotated corners on pixel centres, both diagonals, both windings.
    After the fill rule tests of a graphics conformance suite: any pixel drawn twice shows."""
    meshes = []
    for p, q in ((10, 0), (7, 7), (6, 8), (12, 5), (3, 11), (-8, 6)):
        corners = np.array([[32, 32], [32, 32], [32, 32], [32, 32]]) + [[p, q], [-q, p], [-p, -q], [q, -p]]
        a, b, c, d = corners * SUBPX + HALF
        for xy in (quad(a, b, c, d), quad(b, c, d, a), quad(a, b, c, d)[:, ::-1]):
            meshes.append(Mesh(xy, (64, 64), rectangle((64, 64), 28, 28, 37, 37)))
    return meshes


def tiny_triangles() -> list[Mesh]:
    """All 76 triangles with corners at multiples of half a pixel in one pixel.
    A centre inside, on a corner, or on any edge; the bounding box ends on it."""
    lattice = np.array([(x, y) for x in range(3) for y in range(3)]) * HALF
    xy: list[Points] = []
    for i in range(9):
        for j in range(i):
            for k in range(j):
                corners = lattice[[i, j, k]]
                if np.linalg.det(np.stack([corners[1] - corners[0], corners[2] - corners[0]]).astype(float)) != 0:
                    xy.append(corners + np.array([2 * (len(xy) % 12) + 1, 2 * (len(xy) // 12) + 1]) * SUBPX)
    return [Mesh(np.array(xy), (16, 28))]


def perimeter_fan() -> list[Mesh]:
    """300 of the 4024 needles from the middle of 1000 x 1000 px to every pixel of the border.
    Thin triangles, all in one point; each pixel belongs to exactly one."""
    y = np.arange(-150, 151) * SUBPX + 500 * SUBPX
    rim = np.stack([np.full_like(y, 1000 * SUBPX), y], -1)
    xy = fan(np.array([500 * SUBPX, 500 * SUBPX]), rim)[:-1]
    return [Mesh(xy, (1000, 1000), rectangle((1000, 1000), 850, 400, 1000, 600))]


def far_fan() -> list[Mesh]:
    """48 triangles from an apex at (-30000, -20000) px, their edges across the screen.
    Differences of coordinates have more bits than a float32, before they are even multiplied."""
    apex = px([-30000, -20000])
    angle = np.linspace(np.arctan2(19990, 31000), np.arctan2(20500, 30010), 49)
    rim = px(np.stack([-30000 + 36800 * np.cos(angle), -20000 + 36800 * np.sin(angle)], -1))
    xy = np.stack([np.broadcast_to(apex, (48, 2)), rim[:-1], rim[1:]], axis=1)
    return [Mesh(xy, (540, 960))]


def needles() -> list[Mesh]:
    """400 needles around a pixel centre, 400 px long.
    Thin and long: the edge functions cancel nearly everywhere."""
    centre = np.array([400, 400]) * SUBPX + HALF
    angle = 2 * np.pi * np.arange(400) / 400
    rim = centre + px(400 * np.stack([np.cos(angle), np.sin(angle)], -1))
    return [Mesh(fan(centre, rim), (800, 800), rectangle((800, 800), 150, 150, 650, 650))]


def slivers_one_subpixel() -> list[Mesh]:
    """100 slivers 1/256 px wide across the screen.
    The edge function is smaller than the rounding error of its products; most pixels are missed, some are not."""
    rng = np.random.default_rng(11)
    a, b = (rng.integers(0, [1920 * SUBPX, 1080 * SUBPX], (100, 2)) for _ in range(2))
    flat = np.abs(b - a)[:, :1] > np.abs(b - a)[:, 1:]
    return [Mesh(np.stack([a, b, b + np.where(flat, [0, 1], [1, 0])], axis=1), (1080, 1920))]


def screen_filling() -> list[Mesh]:
    """16 random triangles that each show more than a quarter of the screen.
    Ordinary large triangles: what goes wrong here goes wrong anywhere."""
    mesh = scenes.pixel_mesh("S3", 960, 540)
    return [Mesh(np.floor(mesh.vertices[mesh.triangles[::2]][..., :2] * SUBPX).astype(np.int64), (540, 960))]


def beyond_the_guard_band() -> list[Mesh]:
    """40 triangles with vertices a million pixels out, an edge through the screen.
    They must be clipped; pixels within 1/256 px of an edge are not judged."""
    rng = np.random.default_rng(13)
    angle = rng.uniform(0, 2 * np.pi, 40)
    along, across = (np.stack([np.cos(a), np.sin(a)], -1) for a in (angle, angle + np.pi / 2))
    through = rng.uniform(60, 196, (40, 2))
    corners = [through + 1e6 * along, through - 1e6 * along, through + 1e6 * across]
    # A multiple of 64 subpx: float32 holds 2^24 of them, so the vertex that bigtri gets is the one that is meant.
    return [Mesh(64 * np.rint(np.stack(corners, axis=1) * 4).astype(np.int64), (256, 256), slack=1.0)]


def quads_at_the_origin() -> list[Mesh]:
    """Quads of 40000 px around the screen's middle, 12 rotations, vertices not rounded.
    After a conformance suite: both triangles are clipped, and their common edge must stay common."""
    meshes = []
    for angle in np.arange(12) * 0.19 + 0.1:
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        corners = 256 * turn[[0, 1, 0, 1]] * [[40000], [40000], [-40000], [-40000]] + 128 * SUBPX
        raw = f32(corners).astype(np.float64)[[[0, 1, 2], [0, 2, 3]]]
        meshes.append(Mesh(np.rint(raw).astype(np.int64), (256, 256), np.ones((256, 256), np.bool_), raw, slack=2.0))
    return meshes


def subpixel_mesh() -> list[Mesh]:
    """3200 triangles smaller than a pixel, a jittered grid of 0.4 px.
    Most cover no pixel; each pixel belongs to exactly one."""
    rng = np.random.default_rng(16)
    x, y = np.meshgrid(np.arange(41), np.arange(41))
    vertices = px(np.stack([x, y], -1) * 0.4 + rng.uniform(-0.16, 0.16, (41, 41, 2)) + 1)
    return [Mesh(grid(vertices), (32, 32), rectangle((32, 32), 2, 2, 16, 16))]


def on_bins() -> list[Mesh]:
    """Vertices at 8, 64 and 128 px, on them, beside them, and half a pixel away.
    The borders of tiles and bins: off by one, and a bin is lost."""
    rng = np.random.default_rng(17)
    base = rng.choice([0, 8, 64, 72, 120, 128, 192], (120, 3, 2)) * SUBPX
    return [Mesh(base + rng.choice([-HALF, -1, 0, 1, HALF], base.shape), (192, 256))]


def strips_beside_a_column() -> list[Mesh]:
    """Strips 1/256 px wide on and beside a column of pixel centres, 690 px high.
    Exactly one strip covers the column: the one whose left edge lies on it."""
    meshes = []
    for left in range(-3, 3):
        x = np.array([left, left + 1, left + 1, left]) + 8 * SUBPX + HALF
        y = np.array([5, 5, 695, 695]) * SUBPX
        xy = quad(*np.stack([x, y], -1))
        meshes.append(Mesh(xy, (700, 16), rectangle((700, 16), 8, 5, 9, 695) if left == 0 else None))
    return meshes


def raw_mesh() -> list[Mesh]:
    """13 x 13 x 2 mesh across the screen, vertices as float32 has them.
    Neighbours share vertices, not roundings: the common edge must be the same from both sides."""
    rng = np.random.default_rng(19)
    x, y = np.meshgrid(np.linspace(-40, 1960, 14), np.linspace(-30, 1110, 14))
    vertices = f32(np.stack([x, y], -1) + rng.uniform(-30, 30, (14, 14, 2))).astype(np.float64) * SUBPX
    raw: NDArray[Any] = grid(vertices)  # type: ignore[arg-type]
    # Halfway between two sub-pixels clip space would decide which one, not this construction.
    near_tie = np.abs(raw - np.floor(raw) - 0.5) < 0.2
    raw = np.where(near_tie, np.floor(raw), raw)
    inner = rectangle((1080, 1920), 60, 60, 1860, 1020)
    return [Mesh(np.rint(raw).astype(np.int64), (1080, 1920), inner, raw)]


def random_far() -> list[Mesh]:
    """300 random triangles with vertices up to 16384 px out.
    Large coordinates without any special position."""
    return [Mesh(np.random.default_rng(20).integers(-(2**22), 2**22, (300, 3, 2)), (192, 256))]


_ONCE, _EXACT = "each pixel exactly once", "equals exact integer coverage"
MESHES: list[Case] = [
    mesh_case("H01", "ties", quad_on_centres, _ONCE, "incl strict third i32"),
    mesh_case("H02", "ties", fan_through_centres, _ONCE, "incl strict third"),
    mesh_case("H03", "ties", mesh_on_centres, _ONCE, "incl strict third"),
    mesh_case("H04", "ties", drtk_9, _ONCE, "incl strict third"),
    mesh_case("H05", "ties", shared_edges_through_centres, "one owner of every centre on the edge", "incl fma plane third step"),
    mesh_case("H06", "ties", fill_rule_quads, "no pixel twice", "incl strict third"),
    mesh_case("H07", "ties", tiny_triangles, _EXACT, "incl strict third"),
    mesh_case("H08", "thin", perimeter_fan, _ONCE, "incl strict third i32"),
    mesh_case("H09", "far", far_fan, _EXACT, "tl fma plane third step i32"),
    mesh_case("H10", "thin", needles, _ONCE, "incl strict fma plane third step i32"),
    mesh_case("H11", "thin", slivers_one_subpixel, _EXACT, "tl plane step"),
    mesh_case("H12", "overflow", screen_filling, _EXACT, "step i32"),
    mesh_case("H13", "far", beyond_the_guard_band, _EXACT, "incl strict tl fma plane third step i32"),
    mesh_case("H15", "far", quads_at_the_origin, _ONCE, "incl strict tl plane third i32"),
    mesh_case("H16", "sub-pixel", subpixel_mesh, _ONCE, "fixed4"),
    mesh_case("H17", "ties", on_bins, _EXACT, "incl strict third fixed4"),
    mesh_case("H18", "ties", strips_beside_a_column, "exactly 690 px", "incl strict third fixed4"),
    mesh_case("H19", "sub-pixel", raw_mesh, "no gap and no overlap inside", "step"),
    mesh_case("H20", "far", random_far, _EXACT, "i32"),
]

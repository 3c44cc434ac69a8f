"""The reference from end to end against the oracle, and against what must hold whatever the scene."""

from fractions import Fraction

import numpy as np
import pytest
from exhaustive import some_of
from hypothesis import given, settings
from hypothesis import strategies as st

from bigtri.reference import brute_force, depth, rasterize, scanline, setup

BACKGROUND = 2**63 - 1
SIZE = 64  # px; a power of two, so that snapped coordinates can be chosen exactly


def soup(positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """float32 positions and int32 triangles of ``positions`` [T, 3, 4]."""
    return positions.astype(np.float32).reshape(-1, 4), np.arange(3 * len(positions), dtype=np.int32).reshape(-1, 3)


def on_grid(xy: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles with the snapped vertices ``xy`` [T, 3, 2], subpx, and window depths ``z`` [T, 3]."""
    ndc = (np.asarray(xy) / (128 * SIZE) - 1) * [1, -1]
    return soup(np.concatenate([ndc, 2 * z[..., None] - 1, np.ones_like(z)[..., None]], axis=-1))


def scenes() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Triangle soups, each a kind of trouble of its own; made for SIZE x SIZE px."""
    rng = np.random.default_rng(20)
    count = 60
    z = rng.uniform(0, 1, (count, 3))
    subpx = 256 * SIZE
    corners = rng.normal(size=(count, 3, 4))
    slivers = rng.integers(-subpx, 2 * subpx, (count, 3, 2))
    slivers[:, 2] = slivers[:, 0] + rng.integers(-40, 41, (count, 2))
    near = corners.copy()
    near[:, 0, 2] = -near[:, 0, 3] * rng.uniform(0.999, 1.001, count)  # a vertex next to the near plane
    huge = corners * [1, 1, 0.2, 1]
    huge[:, :, :2] *= 10.0 ** rng.uniform(0, 30, (count, 3, 1))
    guard = rng.integers(-(2**23), 2**23, (count, 3, 2))
    guard[:, 0] = rng.integers(0, subpx, (count, 2))
    result = {
        "anywhere": on_grid(rng.integers(-subpx // 2, 2 * subpx, (count, 3, 2)), z),
        "not on the grid": soup(
            np.concatenate([rng.uniform(-1.5, 1.5, (count, 3, 2)), z[..., None], np.ones((count, 3, 1))], -1)
        ),
        "on pixel centres": on_grid(256 * rng.integers(-2, SIZE + 2, (count, 3, 2)) + 128, z),
        "around pixel centres": on_grid(256 * rng.integers(0, SIZE, (count, 3, 2)) + rng.integers(127, 130, (count, 3, 2)), z),
        "slivers": on_grid(slivers, z),
        "within the guard band": on_grid(guard, z),
        "tiny": on_grid(rng.integers(0, subpx, (count, 1, 2)) + rng.integers(-300, 301, (count, 3, 2)), z),
        "no area": on_grid(rng.integers(0, 40, (count, 1, 2)) * 256 + rng.integers(-3, 9, (count, 3, 1)) * [512, -384], z),
        "perspective": soup(corners * [1, 1, 0.3, 0] + [0, 0, 0, 1] * rng.uniform(0.5, 4, (count, 3, 1))),
        "across the eye": soup(corners),
        "on the near plane": soup(near),
        "behind the eye": soup(corners * [1, 1, 1, 0] - np.abs(corners) * [0, 0, 0, 1]),
        "coordinates up to 1e30": soup(huge),
        "far beyond the far plane": soup(corners * [1, 1, 5, 0.5] + [0, 0, 0, 1]),
        "one depth": on_grid(rng.integers(-subpx // 2, 2 * subpx, (count, 3, 2)), np.full((count, 3), 0.375)),
        "the same triangle": on_grid(np.tile(rng.integers(0, subpx, (1, 3, 2)), (count, 1, 1)), np.tile(z[:1], (count, 1))),
    }
    broken = corners.copy()
    broken[np.arange(0, count, 3), rng.integers(0, 3, count // 3), rng.integers(0, 4, count // 3)] = np.nan
    broken[np.arange(1, count, 3), rng.integers(0, 3, count // 3), rng.integers(0, 4, count // 3)] = -np.inf
    return result | {"not finite": soup(broken)}


SCENES = scenes()


def coverage_count(positions: np.ndarray, triangles: np.ndarray, height: int, width: int) -> np.ndarray:
    """int64 [H, W]: how many triangles, or parts of clipped ones, the reference draws to each pixel."""
    records, _ = setup(positions, triangles, height, width)
    none = np.zeros((0, 3), np.int32)
    spans = scanline(records, none, np.zeros(0, np.int64), np.arange(len(records.triangle), dtype=np.int32))
    count = np.zeros((height, width), np.int64)
    for _, y, lower, upper in spans.tolist():
        count[y, lower:upper] += 1
    return count


# --- The oracle itself -------------------------------------------------------------------------------------------------------


def test_the_oracle_knows_the_top_left_rule() -> None:
    """A square of 2 x 2 px between pixel centres owns the centres on its left and upper borders, and each just once."""
    a, b, c, d = [128, 128], [640, 128], [640, 640], [128, 640]
    positions, triangles = on_grid(np.array([[a, b, c], [a, c, d]]), np.full((2, 3), 0.5))
    drawn, _ = brute_force.records(positions, triangles, SIZE, SIZE)
    covered = [{(x, y) for x in range(5) for y in range(5) if brute_force.covers(record, x, y)} for record in drawn]
    assert covered[0] == {(0, 0), (1, 0), (1, 1)} - covered[1]
    assert covered[0] | covered[1] == {(0, 0), (1, 0), (0, 1), (1, 1)} and not covered[0] & covered[1]


@pytest.mark.parametrize("name", SCENES)
def test_the_two_coverages_of_the_oracle_agree(name: str) -> None:
    drawn, _ = brute_force.records(*SCENES[name], 20, 30)
    for record in drawn[:20]:
        expected = [[brute_force.covers(record, x, y) for x in range(30)] for y in range(20)]
        np.testing.assert_array_equal(brute_force.coverage(record, 20, 30), expected)


def test_the_oracle_projects_truly() -> None:
    """A triangle with one vertex behind the eye: its edges go on through infinity, and the near plane z = -w cuts it off."""
    plain = brute_force.outline([(-1.0, -1.0, 0.0, 1.0), (3.0, -1.0, 0.0, 1.0), (-1.0, 3.0, 0.0, 1.0)], 10, 10)
    assert all(brute_force.true_side(plain, x, y) == 1 for x in range(10) for y in range(10))
    assert brute_force.true_side(plain, -1, 5) == brute_force.true_side(plain, 11, 11) == -1
    # A floor at y = -1 that reaches from w = 4 to behind the eye; z = -w at w = 1, where it appears at the lower border.
    floor = brute_force.outline([(-9.0, -1.0, 2.0, 4.0), (9.0, -1.0, 2.0, 4.0), (0.0, -1.0, -4.0, -2.0)], 80, 80)
    shown = [y for y in range(-20, 100) if brute_force.true_side(floor, 40, y) == 1]
    # z = w - 2, hence z = -w at w = 1: from ndc y = -1/4, row 50, down to ndc y = -1, row 80.
    assert shown == list(range(50, 80))
    assert brute_force.outline([(1.0, 0.0, 0.0, 1.0), (2.0, 0.0, 0.0, 2.0), (3.0, 0.0, 0.0, 4.0)], 10, 10) == []


# --- The same bits -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize(("height", "width"), [(64, 64), (37, 70), (1, 1)])
def test_every_bit_equals_the_oracle(name: str, height: int, width: int) -> None:
    packed, dropped = rasterize(*SCENES[name], height, width)
    expected, expected_dropped = brute_force.rasterize(*SCENES[name], height, width)
    np.testing.assert_array_equal(packed, expected)
    assert dropped == expected_dropped == (40 if name == "not finite" else 0)
    if height == 64:
        blank = ("no area", "behind the eye")
        assert (packed != BACKGROUND).any() == (name not in blank)


@pytest.mark.parametrize("cull", ["none", "back", "front"])
@pytest.mark.parametrize("name", ["anywhere", "across the eye"])
def test_culling_and_scissor(name: str, cull: str) -> None:
    whole, _ = rasterize(*SCENES[name], SIZE, SIZE, cull)
    np.testing.assert_array_equal(whole, brute_force.rasterize(*SCENES[name], SIZE, SIZE, cull)[0])
    cut, _ = rasterize(*SCENES[name], SIZE, SIZE, cull, scissor=(7, -3, 41, 30))
    expected = np.full_like(whole, BACKGROUND)
    expected[:30, 7:41] = whole[:30, 7:41]
    np.testing.assert_array_equal(cut, expected)


@settings(max_examples=150, deadline=None)
@given(st.lists(st.tuples(*[st.integers(-5, 12)] * 6), min_size=1, max_size=4), st.sampled_from([32, 64, 128, 256]))
def test_any_triangles_on_a_coarse_grid(corners: list[tuple[int, ...]], step: int) -> None:
    """Small integers make edges through pixel centres, shared vertices and no area the rule, not the exception."""
    xy = np.array(corners).reshape(-1, 3, 2) * step + 128
    z = (xy.sum(axis=2) % 7 + 1) / 8
    positions, triangles = on_grid(xy, z)
    packed, _ = rasterize(positions, triangles, SIZE, SIZE)
    np.testing.assert_array_equal(packed, brute_force.rasterize(positions, triangles, SIZE, SIZE)[0])


@settings(max_examples=150, deadline=None)
@given(st.lists(st.tuples(*[st.floats(width=32)] * 12), min_size=1, max_size=3))
def test_any_floats_at_all(corners: list[tuple[float, ...]]) -> None:
    positions, triangles = soup(np.array(corners).reshape(-1, 3, 4))
    packed, dropped = rasterize(positions, triangles, 9, 13)
    expected, expected_dropped = brute_force.rasterize(positions, triangles, 9, 13)
    np.testing.assert_array_equal(packed, expected)
    assert dropped == expected_dropped


# --- The true picture --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("decades", some_of([0.3, 3, 37], [0.3, 1, 3, 8, 20, 37]))
@pytest.mark.parametrize("plain_z_and_w", [True, False])
def test_clipping_moves_no_edge_by_more_than_a_subpixel(decades: float, plain_z_and_w: bool) -> None:
    """Triangle by triangle against its true projection; only centres within 1/256 px of its border may differ.

    Up to the ends of float32's range: there, a clipper that interpolates loses or gains half the screen.
    """
    rng = np.random.default_rng(21)
    height, width = 10, 14
    certain = clipped = 0
    for _ in range(400):
        corners = rng.normal(size=(3, 4))
        if plain_z_and_w:
            corners[:, :2] *= 10.0 ** rng.uniform(0, decades, (3, 1))
        else:
            corners *= 10.0 ** rng.uniform(-decades, decades, (3, 4))
        corners = corners.astype(np.float32)
        corners[:, 2] = np.minimum(corners[:, 2], corners[:, 3])  # the far plane is cut by depth, not here
        positions, triangles = soup(corners[None])
        records, _ = setup(positions, triangles, height, width)
        half_planes = brute_force.outline(corners.tolist(), height, width)
        side = np.array([[brute_force.true_side(half_planes, x, y) for x in range(width)] for y in range(height)])
        drawn = coverage_count(positions, triangles, height, width) > 0
        assert drawn[side == 1].all() and not drawn[side == -1].any()
        certain += (side == 1).sum()
        clipped += records.clipped.any()
    assert certain > 2000 and clipped > 25


@pytest.mark.parametrize("name", ["anywhere", "slivers", "within the guard band", "across the eye", "coordinates up to 1e30"])
def test_visible_depth_is_near_the_nearest_exact_one(name: str) -> None:
    """No fragment in front of the visible one by more than two depths' rounding: half a unit in the last place and 2^-39 each."""
    packed, _ = rasterize(*SCENES[name], SIZE, SIZE)
    drawn, _ = brute_force.records(*SCENES[name], SIZE, SIZE)
    for py in range(1, SIZE, 5):
        for px in range(2, SIZE, 5):
            exact = [brute_force.exact_depth(record, px, py) for record in drawn if brute_force.covers(record, px, py)]
            nearest = min(exact, default=Fraction(2))
            z = (packed[py, px] >> 32).astype(np.uint32).view(np.float32)
            if packed[py, px] == BACKGROUND:
                assert nearest > 1 - Fraction(1, 2**24)
            else:
                assert abs(Fraction(float(z)) - nearest) <= Fraction(float(np.spacing(z))) / 2 + Fraction(1, 2**39)


# --- Each pixel once ---------------------------------------------------------------------------------------------------------


def test_fans_cover_each_pixel_once() -> None:
    """Spokes through pixel centres, around a hub on a pixel centre, out beyond the screen."""
    hub = np.array([32 * 256 + 128, 30 * 256 + 128])
    for spokes, radius in ((24, 100 * 256), (1000, 2**22), (360, 2**20)):
        angle = np.arange(spokes) / spokes * 2 * np.pi
        rim = hub + 256 * np.rint(np.stack([np.cos(angle), np.sin(angle)], -1) * radius / 256).astype(np.int64)
        fan = np.stack([np.broadcast_to(hub, rim.shape), rim, np.roll(rim, -1, axis=0)], axis=1)
        assert (coverage_count(*on_grid(fan, np.full((spokes, 3), 0.5)), SIZE, SIZE) == 1).all()


def test_meshes_cover_each_pixel_once() -> None:
    """Grids whose inner vertices are moved about: on pixel centres, beside them, and by fractions of a pixel."""
    rng = np.random.default_rng(22)
    for step, jitter, grain in ((4, 1, 256), (4, 1, 1), (1, 0, 1), (8, 3, 256), (2, 0, 256)):
        grid = np.stack(np.meshgrid(np.arange(0, SIZE + 1, step), np.arange(0, SIZE + 1, step)), axis=-1) * 256 + 128
        grid[1:-1, 1:-1] += rng.integers(-jitter * 256 // grain, jitter * 256 // grain + 1, grid[1:-1, 1:-1].shape) * grain
        grid[0, :, 1] -= 256
        grid[:, 0, 0] -= 256
        a, b, c, d = (grid[i : i - 1 or None, j : j - 1 or None].reshape(-1, 2) for i, j in ((0, 0), (0, 1), (1, 1), (1, 0)))
        flip = rng.integers(0, 2, len(a))[:, None, None] == 1
        one = np.where(flip, np.stack([a, b, c], 1), np.stack([a, b, d], 1))
        two = np.where(flip, np.stack([a, c, d], 1), np.stack([b, c, d], 1))
        mesh = np.concatenate([one, two])
        assert (coverage_count(*on_grid(mesh, np.full((len(mesh), 3), 0.5)), SIZE, SIZE) == 1).all()


def test_clipped_neighbours_leave_no_gap_and_do_not_overlap() -> None:
    """A triangle cut into nine that share edges, with vertices behind the eye and far outside: inside it, each pixel just once.

    The parts' vertices lie within rounding of the whole's plane, so that their projections do not fold over.
    """
    rng = np.random.default_rng(23)
    weights = [(3, 0, 0), (2, 1, 0), (1, 2, 0), (0, 3, 0), (2, 0, 1), (1, 1, 1), (0, 2, 1), (1, 0, 2), (0, 1, 2), (0, 0, 3)]
    parts = [(0, 1, 4), (1, 5, 4), (1, 2, 5), (2, 6, 5), (2, 3, 6), (4, 5, 7), (5, 8, 7), (5, 6, 8), (7, 8, 9)]
    height, width = 30, 44
    inside = clipped = 0
    for _ in range(220):
        corners = rng.normal(size=(3, 4)) * 10.0 ** rng.uniform(-1, 2.5, (1, 4))
        corners[:, 2] = np.minimum(corners[:, 2], corners[:, 3])  # nothing beyond the far plane
        corners = corners.astype(np.float32)
        vertices = (np.array(weights) @ corners.astype(np.float64) / 3).astype(np.float32)
        whole = brute_force.outline(corners.tolist(), height, width)
        side = np.array([[brute_force.true_side(whole, x, y) for x in range(width)] for y in range(height)])
        triangles = np.array(parts, np.int32)
        count = coverage_count(vertices, triangles, height, width)
        assert (count[side == 1] == 1).all()
        assert (count[side == -1] == 0).all()
        inside += (side == 1).sum()
        clipped += setup(vertices, triangles, height, width)[0].clipped.any()
    assert inside > 6000 and clipped > 40


# --- What must not matter ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SCENES)
def test_the_order_of_vertices_does_not_matter(name: str) -> None:
    positions, triangles = SCENES[name]
    packed, _ = rasterize(positions, triangles, SIZE, SIZE)
    for shift in (1, 2):
        np.testing.assert_array_equal(packed, rasterize(positions, np.roll(triangles, shift, axis=1), SIZE, SIZE)[0])
    np.testing.assert_array_equal(packed, rasterize(positions, triangles[:, [0, 2, 1]], SIZE, SIZE)[0])


@pytest.mark.parametrize("name", SCENES)
def test_the_order_of_triangles_matters_only_at_equal_depth(name: str) -> None:
    positions, triangles = SCENES[name]
    packed, _ = rasterize(positions, triangles, SIZE, SIZE)
    backwards, _ = rasterize(positions, triangles[::-1], SIZE, SIZE)
    np.testing.assert_array_equal(packed >> 32, backwards >> 32)
    number = packed & 0xFFFFFFFF
    renumbered = np.where(packed == BACKGROUND, number, len(triangles) - 1 - (backwards & 0xFFFFFFFF))
    differs = renumbered != number
    assert (renumbered >= number).all()  # of several at one depth the first wins, and backwards it is the last
    if name in ("anywhere", "on pixel centres"):
        assert not differs.any()


def test_a_shift_by_whole_pixels_shifts_the_picture() -> None:
    rng = np.random.default_rng(24)
    xy = rng.integers(0, 64 * 20, (30, 3, 2))
    z = rng.uniform(0, 1, (30, 3))
    packed, _ = rasterize(*on_grid(xy, z), SIZE, SIZE)
    shifted, _ = rasterize(*on_grid(xy + 256 * np.array([11, 23]), z), SIZE, SIZE)
    assert (packed != BACKGROUND).any()
    np.testing.assert_array_equal(packed[:-23, :-11] & 0xFFFFFFFF, shifted[23:, 11:] & 0xFFFFFFFF)


def test_equal_depth_goes_to_the_lower_triangle() -> None:
    packed, _ = rasterize(*SCENES["the same triangle"], SIZE, SIZE)
    assert set((packed[packed != BACKGROUND] & 0xFFFFFFFF).tolist()) == {0}


def test_nothing_beyond_the_far_plane_is_drawn() -> None:
    positions = np.array([[-1, -1, 3, 1], [3, -1, 3, 1], [-1, 3, -5, 1]], np.float32)  # z falls from the bottom to the top
    triangles = np.array([[0, 1, 2]], np.int32)
    packed, _ = rasterize(positions, triangles, SIZE, SIZE)
    records, _ = setup(positions, triangles, SIZE, SIZE)
    spans = np.array([[0, y, 0, SIZE] for y in range(SIZE)], np.int32)
    z = depth(records, spans).reshape(SIZE, SIZE)
    np.testing.assert_array_equal(packed != BACKGROUND, z <= 1)
    assert (z > 1).any() and (z <= 1).any()
    at_one = positions * [1, 1, 0, 1] + np.array([0, 0, 1, 0])
    assert (rasterize(at_one.astype(np.float32), triangles, SIZE, SIZE)[0] >> 32 == 0x3F800000).all()


def test_minus_zero_depth_is_the_nearest() -> None:
    """z/w = -1 gives depth 0; whatever its sign on the way, its bits must be those of +0."""
    positions = np.array([[-1, -1, -1, 1], [3, -1, -1, 1], [-1, 3, -1, 1]], np.float32)
    packed, _ = rasterize(positions, np.array([[0, 1, 2]], np.int32), SIZE, SIZE)
    assert (packed == 0).all()
    behind = np.concatenate([positions, positions * [1, 1, 0, 1]]).astype(np.float32)
    packed, _ = rasterize(behind, np.array([[3, 4, 5], [0, 1, 2]], np.int32), SIZE, SIZE)
    assert (packed == 1).all()

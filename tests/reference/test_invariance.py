"""What must not matter: the order of vertices and triangles, winding, batch, threads, instruction set, scissor, place, scale."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from cases import CASES, Case
from counting import fragments, on_grid, scaled, soup
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import bigtri
from bigtri import native
from bigtri.check import stages

BACKGROUND = 2**63 - 1
ONE = np.array([[0, 1, 2]], np.int32)
SIZE = 128  # px; a power of two, so that snapped coordinates can be chosen exactly
SMALL_CASES = [name for name in CASES if not name.startswith("size_") or name in ("size_1x1", "size_63x63", "size_65x1")]
GUARD = 2**23


def make(name: str, seed: int = 0) -> Case:
    return CASES[name](np.random.default_rng([seed, 50, *name.encode()]))


def draw(case: Case, **options) -> NDArray[np.int64]:
    return bigtri.rasterize(*case, **options).packed


def alone(corners: NDArray[np.floating], resolution: tuple[int, int]) -> bigtri.Visibility:
    """Each triangle [T, 3, 4] as a view of its own."""
    return bigtri.rasterize(corners.astype(np.float32), ONE, resolution)


def ulps_apart(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.int64]:
    """How many steps of float32 lie between, for values >= 0."""
    return np.abs(a.view(np.int32).astype(np.int64) - b.view(np.int32))


def assert_near(a: NDArray[np.float32], b: NDArray[np.float32]) -> None:
    """Two roundings of one depth: 1 ulp apart at most; where an ulp is next to nothing, 2^-38."""
    assert ((ulps_apart(a, b) <= 1) | (np.abs(a.astype(np.float64) - b) <= 2.0**-38)).all()


# --- The order of things -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SMALL_CASES)
def test_rotating_the_vertices_of_any_triangle(name: str) -> None:
    """Each triangle by its own number of steps; clipped ones too. Weights follow their corners, in bits."""
    case = make(name)
    seen = draw(case)
    steps = np.random.default_rng(51).integers(0, 3, len(case.triangles))
    order = (np.arange(3) + steps[:, None]) % 3
    rotated = case._replace(triangles=np.take_along_axis(case.triangles, order, axis=1))
    assert np.array_equal(seen, draw(rotated))
    weights, again = (bigtri.barycentrics(seen, c.positions, c.triangles) for c in (case, rotated))
    place = order[np.where(seen == BACKGROUND, 0, seen & 0xFFFFFFFF)]
    assert again.tobytes() == np.take_along_axis(weights, place, axis=2).tobytes()


@pytest.mark.parametrize("name", SMALL_CASES)
def test_turning_triangles_over(name: str) -> None:
    """Without culling nothing changes; with it, front and back change places."""
    case = make(name)
    turned = case._replace(triangles=np.ascontiguousarray(case.triangles[:, [0, 2, 1]]))
    for cull, other in (("none", "none"), ("front", "back"), ("back", "front")):
        assert np.array_equal(draw(case, cull=cull), draw(turned, cull=other))


@pytest.mark.parametrize("name", [name for name in SMALL_CASES if name != "many_small"])
def test_any_order_gives_the_minimum_of_the_triangles_drawn_alone(name: str) -> None:
    """The nearest first, then the lower index: shuffling renumbers what is visible, and at equal depth chooses anew."""
    case = make(name)
    height, width = case.resolution
    rng = np.random.default_rng(52)
    orders = [np.arange(len(case.triangles)), np.arange(len(case.triangles))[::-1], rng.permutation(len(case.triangles))]
    expected = np.full((3, height, width), BACKGROUND)
    numbers = np.argsort(orders, axis=1)  # of each triangle, in each order
    for first in range(0, len(case.triangles), 50):
        views = bigtri.rasterize(case.positions[case.triangles[first : first + 50]], ONE, case.resolution).packed
        for index, view in enumerate(views, first):
            for image, number in zip(expected, numbers[:, index], strict=True):
                np.minimum(image, np.where(view == BACKGROUND, view, view | int(number)), out=image)
    for order, image in zip(orders, expected, strict=True):
        assert np.array_equal(draw(case._replace(triangles=np.ascontiguousarray(case.triangles[order]))), image)


def test_vertices_may_be_shared_or_repeated() -> None:
    """An indexed mesh, the same as a soup, and with vertices in another order: only positions count."""
    case = make("inside_sphere")
    expected = draw(case)
    assert np.array_equal(draw(Case(*soup(case.positions[case.triangles]), case.resolution)), expected)
    order = np.random.default_rng(53).permutation(len(case.positions))
    where = np.argsort(order).astype(np.int32)
    assert np.array_equal(draw(Case(case.positions[order], where[case.triangles], case.resolution)), expected)


# --- How it is run -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("options", [{}, {"cull": "back"}, {"scissor": (3, 5, 60, 50)}])
def test_a_batch_is_its_views(options: dict) -> None:
    """40 views of all kinds in one call, one of them wholly outside, one not finite: depth and counts too."""
    triangles = 40
    names = [name for name in SMALL_CASES if len(make(name).triangles) >= triangles]
    views = []
    for k in range(40):
        case = make(names[k % len(names)], seed=k)
        views.append(case.positions[case.triangles[:triangles]].reshape(-1, 4))
    views[7] = views[7] * np.float32([1, 1, 1, -1])
    views[8][5] = np.nan
    faces = np.arange(3 * triangles, dtype=np.int32).reshape(-1, 3)
    batch = bigtri.rasterize(np.stack(views), faces, (66, 70), **options)
    assert batch.dropped[8] > 0
    for k, view in enumerate(views):
        single = bigtri.rasterize(view, faces, (66, 70), **options)
        assert all(np.array_equal(a[k], b) for a, b in zip(batch, single, strict=True)), k


@pytest.mark.skipif(not native.available(), reason="the extension is not built")
@pytest.mark.parametrize("name", [name for name in CASES if name not in ("size_16384x7", "size_3x16384")])
def test_neither_threads_nor_instruction_sets_change_a_bit(name: str) -> None:
    """Pictures and weights; more threads than there are bins, or processors."""
    case = make(name)
    results = set()
    before = torch.get_num_threads()
    try:
        for threads in (1, 2, 3, 16):
            torch.set_num_threads(threads)
            for isa in native.isa_levels():
                with native.using_isa(isa):
                    seen = bigtri.rasterize(*case)
                    weights = bigtri.barycentrics(seen, case.positions, case.triangles)
                    results.add((seen.packed.tobytes(), seen.depth.tobytes(), weights.tobytes()))
    finally:
        torch.set_num_threads(before)
    assert len(results) == 1


@pytest.mark.parametrize("name", SMALL_CASES)
def test_a_scissor_is_a_crop(name: str) -> None:
    """Any box: empty, one pixel, across bins and tiles, beyond the image."""
    case = make(name)
    height, width = case.resolution
    whole = draw(case)
    rng = np.random.default_rng(54)
    for _ in range(12):
        (x0, x1), (y0, y1) = (np.sort(rng.integers(-3, size + 4, 2)).tolist() for size in (width, height))
        expected = np.full_like(whole, BACKGROUND)
        box = (slice(max(y0, 0), max(y1, 0)), slice(max(x0, 0), max(x1, 0)))
        expected[box] = whole[box]
        assert np.array_equal(draw(case, scissor=(x0, y0, x1, y1)), expected), (x0, y0, x1, y1)


# --- Place -------------------------------------------------------------------------------------------------------------------


def grid_triangles(rng: np.random.Generator, count: int, step: int = 1) -> NDArray[np.int64]:
    """[count, 3, 2], multiples of ``step`` subpx within 30,000 px: large, small, thin, with vertices on pixel centres."""
    around = rng.integers(0, 256 * SIZE, (count, 1, 2))
    xy = around + np.rint(rng.normal(size=(count, 3, 2)) * 2.0 ** rng.uniform(5, 21, (count, 1, 1))).astype(np.int64)
    thin = rng.random(count) < 0.3
    xy[thin, 2] = xy[thin, 0] + rng.integers(-40, 41, (thin.sum(), 2))
    centred = rng.random(count) < 0.3
    xy[centred] = xy[centred] // 256 * 256 + 128
    return np.clip(xy, -7_500_000, 7_500_000) // step * step


def grid_depths(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    return rng.integers(0, 2**20 + 1, (count, 3)) / 2**20


@pytest.mark.parametrize(("dx", "dy"), [(1, 0), (0, 1), (7, 8), (-9, 31), (63, 65), (64, 0), (0, -64), (128, 192), (-128, 64)])
def test_a_shift_by_whole_pixels_shifts_the_picture(dx: int, dy: int) -> None:
    """Coverage in bits and depth within 1 ulp; by multiples of 64 px, the cells of depth, all in bits."""
    rng = np.random.default_rng([55, dx + 1000, dy + 1000])
    count = scaled(1000)
    xy, z = grid_triangles(rng, count), grid_depths(rng, count)
    xy += np.array([max(0, -dx), max(0, -dy)]) * 256
    height, width = 256, 256
    window = (slice(max(0, -dy), max(0, -dy) + 64), slice(max(0, -dx), max(0, -dx) + 64))
    moved_window = (slice(max(0, dy), max(0, dy) + 64), slice(max(0, dx), max(0, dx) + 64))
    compared = 0
    for part in np.array_split(np.arange(count), max(1, count // 50)):
        views = []
        for shift, (rows, columns) in ((0, window), (1, moved_window)):
            corners = on_grid(xy[part] + 256 * shift * np.array([dx, dy]), z[part], (height, width))
            assert (corners == corners.astype(np.float32)).all()  # snapped to just these places
            views.append(alone(corners, (height, width)).packed[:, rows, columns])
        still, moved = views
        drawn = still != BACKGROUND
        assert np.array_equal(drawn, moved != BACKGROUND)
        if dx % 64 == 0 and dy % 64 == 0:
            assert np.array_equal(still, moved)
        a, b = ((v[drawn] >> 32).astype(np.int32).view(np.float32) for v in views)
        assert_near(a, b)
        compared += drawn.sum()
    assert compared > 50_000


@pytest.mark.parametrize("resolution", [(256, 128), (128, 512), (512, 256)])
def test_a_larger_image_shows_more_of_the_same(resolution: tuple[int, int]) -> None:
    """The same snapped triangles in a larger image: its upper left part is the smaller one, in bits."""
    rng = np.random.default_rng([56, *resolution])
    xy, z = grid_triangles(rng, 400), grid_depths(rng, 400)
    small = draw(Case(*soup(on_grid(xy, z, (SIZE, SIZE))), (SIZE, SIZE)))
    large = draw(Case(*soup(on_grid(xy, z, resolution)), resolution))
    assert np.array_equal(large[:SIZE, :SIZE], small) and (small != BACKGROUND).mean() > 0.5


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("name", ["screen_size", "many_small", "behind_camera", "slivers", "on_centres", "on_bins", "far_depth"])
def test_mirroring(name: str, axis: int) -> None:
    """Pixels whose centres are on no edge mirror exactly, depth within 1 ulp; who owns an edge is the fill rule's choice.

    Not of triangles that reach the guard planes, which are not symmetric. At depth 1 a rounding may drop a pixel. Depth is
    that of whole triangles: a clipped one is cut into a fan from another vertex, and its vertices have been snapped.
    """
    case = make(name)
    height, width = case.resolution
    corners = case.positions[case.triangles]
    other = corners * np.where(np.arange(4) == axis, -1, 1).astype(np.float32)
    records, _ = stages.setup(*soup(corners), height, width)
    near_guard = np.unique(records.triangle[(np.abs(records.xy) >= GUARD - 1).any(axis=(1, 2))])
    kept = np.setdiff1d(np.arange(len(corners)), near_guard)[:200]
    on_edge = pixels_on_edges(records, len(corners), height, width)[kept]
    one, two = (alone(c[kept], case.resolution) for c in (corners, other))
    flipped = tuple(np.flip(image, axis=2 - axis) for image in (two.triangle, two.depth))
    at_far = np.isclose(one.depth, 1, rtol=0, atol=2.0**-22) | np.isclose(flipped[1], 1, rtol=0, atol=2.0**-22)
    compared = ~(on_edge | at_far)
    assert np.array_equal(one.triangle[compared], flipped[0][compared])
    whole = np.isin(kept, records.triangle[~records.clipped])[:, None, None]
    both = compared & whole & (one.triangle == 0)
    assert_near(one.depth[both], flipped[1][both])
    assert both.sum() > 200


def pixels_on_edges(records, count: int, height: int, width: int) -> NDArray[np.bool_]:
    """bool [count, H, W]: centres exactly on an edge line of a record of the triangle."""
    result = np.zeros((count, height, width), np.bool_)
    sx, sy = 256 * np.arange(width) + 128, 256 * np.arange(height) + 128
    for triangle, xy in zip(records.triangle.tolist(), records.xy.astype(np.int64), strict=True):
        for k in range(3):
            (px, py), (qx, qy) = xy[k].tolist(), xy[(k + 1) % 3].tolist()
            result[triangle] |= ((qx - px) * (sy - py))[:, None] == ((qy - py) * (sx - px))[None, :]
    return result


# --- Scale and shape ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SMALL_CASES)
def test_a_power_of_two_on_all_coordinates_changes_no_bit(name: str) -> None:
    """Of each triangle its own; pictures and weights, clipped ones too: homogeneous coordinates have no scale."""
    case = make(name)
    corners = case.positions[case.triangles]
    corners = corners[np.isfinite(corners).all(axis=(1, 2))]
    power = np.random.default_rng(57).integers(-40, 20, (len(corners), 1, 1))
    with np.errstate(over="ignore"):
        is_exact = (np.ldexp(np.ldexp(corners, power), -power) == corners).all(axis=(1, 2), keepdims=True)
    power = np.where(is_exact, power, 0)  # neither beyond float32 nor among its denormals
    results = []
    for scaled_corners in (corners, np.ldexp(corners, power)):
        positions, triangles = soup(scaled_corners)
        seen = draw(Case(positions, triangles, case.resolution))
        results.append((seen.tobytes(), bigtri.barycentrics(seen, positions, triangles).tobytes()))
    assert results[0] == results[1]


def test_a_triangle_is_its_four_midpoint_triangles() -> None:
    """On the grid: each pixel of the whole in exactly one part, no other in any; depth within 1 ulp."""
    rng = np.random.default_rng(58)
    count = scaled(1500)
    xy, z = grid_triangles(rng, count, step=2), grid_depths(rng, count) // 2.0**-16 * 2.0**-16
    pixels = 0
    for index in range(count):
        a, b, c = np.concatenate([xy[index], z[index][:, None]], axis=1)
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        parts = np.array([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]])
        whole = alone(on_grid(xy[index : index + 1], z[index : index + 1], (SIZE, SIZE)), (SIZE, SIZE))
        case = Case(*soup(on_grid(parts[..., :2], parts[..., 2], (SIZE, SIZE))), (SIZE, SIZE))
        assert np.array_equal(fragments(*case), whole.triangle[0] == 0), xy[index].tolist()
        drawn = whole.triangle[0] == 0
        assert_near(whole.depth[0][drawn], bigtri.rasterize(*case).depth[drawn])
        pixels += drawn.sum()
    assert pixels > 100 * count


component = st.one_of(
    st.just(0.0),
    st.integers(-8, 8).map(float),
    st.floats(2.0**-50, 2.0**60, width=32),
    st.floats(-(2.0**60), -(2.0**-50), width=32),
)
vertex = st.tuples(component, component, component, component)


@settings(max_examples=scaled(250), deadline=None)
@given(st.tuples(vertex, vertex, vertex), st.integers(-40, 40))
@example(((0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0, 0.0), (1.0, 1.0, 0.0, 1.0)), 3)
def test_any_triangle_rotated_turned_over_and_scaled(corners: tuple[tuple[float, ...], ...], power: int) -> None:
    """A search with shrinking over triangles that clipping and snapping make something of."""
    corners = np.array([corners], np.float32)
    expected = alone(corners, (9, 13))
    for order in ([1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0]):
        assert np.array_equal(alone(corners[:, order], (9, 13)).packed, expected.packed), order
    assert np.array_equal(alone(np.ldexp(corners, power), (9, 13)).packed, expected.packed)

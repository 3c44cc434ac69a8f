"""Scissors and culling in every variant of the CPU, and what single variants promise beyond the bits."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import torch
from cases import CASES, Case, from_pixels

import bigtri
from bigtri import native
from bigtri.check import counters

VARIANTS = native.VARIANTS.get("cpu", ())
pytestmark = pytest.mark.skipif(not native.available(), reason="the extension is not built")


def make(name: str) -> Case:
    return CASES[name](np.random.default_rng([0, *name.encode()]))


@pytest.fixture
def one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def assert_same_with(case: Case, variant: str, **how: object) -> None:
    expected = bigtri.rasterize(*case, backend="reference", scissor=how.get("scissor"))
    for isa in native.isa_levels():
        with native.using_isa(isa):
            assert np.array_equal(bigtri.rasterize(*case, variant=variant, **how).packed, expected.packed), isa


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("name", ["screen_size", "many_small", "far_depth"])
def test_scissors_and_culling(name: str, variant: str) -> None:
    case = make(name)
    height, width = case.resolution
    for how in (
        {"scissor": (33, 17, width - 35, height - 9), "cull": "back"},
        {"scissor": (64, 64, 128, 128)},
        {"scissor": (50, 50, 51, 51), "cull": "front"},
    ):
        expected = bigtri.rasterize(*case, backend="reference", **how)
        assert np.array_equal(bigtri.rasterize(*case, variant=variant, **how).packed, expected.packed), how


# --- recursive_descent


def needles(count: int) -> Case:
    """Acute corners: beyond them lie squares that no single edge has outside."""
    rng = np.random.default_rng(3)
    tip, angle = rng.uniform(60, 260, (count, 1, 2)), rng.uniform(0, 2 * np.pi, (count, 1))
    corners = [np.zeros((count, 1))] + [np.full((count, 1), 150.0)] * 2
    spread = [0, -0.1, 0.1]
    xy = np.concatenate(
        [tip + r[..., None] * np.stack([np.cos(angle + d), np.sin(angle + d)], -1) for r, d in zip(corners, spread, strict=True)],
        axis=1,
    )
    return from_pixels(xy, rng.uniform(0.1, 0.9, (count, 3)), (320, 320))


def test_false_positives_beyond_corners_are_counted_and_removed() -> None:
    case = needles(30)
    count = {
        separate: counters.count(*case, variant="recursive_descent", parameters={"separate": separate, "early_z": 0})
        for separate in (0, 1)
    }
    assert count[0]["tiles_empty"] > 4 * count[1]["tiles_empty"]
    assert "separations" not in count[0] and count[1]["separations"] > count[1]["tiles_separated"] > 0
    assert count[1]["edges_32"] < count[0]["edges_32"]
    assert count[0]["fragments"] == count[1]["fragments"]
    for separate in (0, 1):
        assert_same_with(case, "recursive_descent", parameters={"separate": separate})


def test_what_lies_behind_is_left_out_by_depth(one_thread: None) -> None:
    back_to_front = make("layers")
    case = back_to_front._replace(triangles=np.ascontiguousarray(back_to_front.triangles[::-1]))
    count = {early_z: counters.count(*case, variant="recursive_descent", parameters={"early_z": early_z}) for early_z in (0, 1)}
    assert count[1]["fragments"] < count[0]["fragments"] / 4
    assert count[1]["bins_hidden"] > 0 and "bins_hidden" not in count[0]


@pytest.mark.parametrize("extent", [1984, 1985, 3900])
def test_edge_values_of_the_largest_records_that_take_32_bits(extent: int) -> None:
    """Corners of a box of that many px, seen in the bins around it, where edge values are largest."""
    low = np.array([33.25, 30.75])
    corner = low + np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]], [[0, 1], [1, 0], [1, 1]]]) * extent
    case = from_pixels(corner, np.full((3, 3), 0.5), (2048, 2048))
    for left in (0, 1984):
        for top in (0, 1984):
            assert_same_with(case, "recursive_descent", scissor=(left, top, left + 64, top + 64))
    counts = counters.count(*case, variant="recursive_descent", scissor=(0, 0, 64, 64))
    assert counts.get("wide", 0) == (3 if extent > 1984 else 0)


def test_small_records_take_paths_of_their_own() -> None:
    rng = np.random.default_rng(4)
    at = rng.uniform(20, 180, (400, 1, 2))
    for size, path in ((0.8, "within_4"), (6, "within_16")):
        case = from_pixels(at + rng.uniform(-size, size, (400, 3, 2)), rng.uniform(0, 1, (400, 3)), (200, 200))
        counts = counters.count(*case, variant="recursive_descent")
        assert counts[path] > counts["records"] / 2
        assert_same_with(case, "recursive_descent")


# --- hierarchical_tiles


def test_no_triangle_is_lost_where_lists_have_room_for_one() -> None:
    for name in ("layers", "mesh_of_small", "clipped_fans"):
        case = make(name)
        for parameters in ({"room": 1}, {"room": 1, "tile": 8}, {"room": 1, "tile": 64, "levels": 1}, {"room": 1, "meets": 1}):
            counts = counters.count(*case, variant="hierarchical_tiles", parameters=parameters)
            assert counts["overflows"] > counts["entries"] / 8, parameters
            assert_same_with(case, "hierarchical_tiles", parameters=parameters)


def test_a_triangle_is_stored_at_the_level_where_it_meets_few_tiles(one_thread: None) -> None:
    """Their boxes meet 3x3 tiles of 16 px, 2x2 of 32 px, and one of 64 px; edges reject some of the nine."""
    xy = np.array([[[20, 20], [60, 20], [20, 60]], [[70, 20], [110, 20], [70, 60]]], np.float64)
    case = from_pixels(xy, np.full((2, 3), 0.5), (256, 256))
    shape = {"tile": 16, "levels": 5, "room": 8}
    found = {
        meets: counters.count(*case, variant="hierarchical_tiles", parameters={**shape, "meets": meets}) for meets in (9, 4, 1)
    }
    assert [(c["candidates"], c["entries"]) for c in found.values()] == [(18, 6 + 8), (8, 8), (2, 2)]
    tested = [c["tiles_tested"] for c in found.values()]
    assert tested == [14, 18, 18], "each finest tile of the boxes tests again what a level above has stored"


def test_overdraw_with_and_without_early_rejection(one_thread: None) -> None:
    back_to_front = make("layers")
    case = back_to_front._replace(triangles=np.ascontiguousarray(back_to_front.triangles[::-1]))
    count = {early_z: counters.count(*case, variant="hierarchical_tiles", parameters={"early_z": early_z}) for early_z in (0, 1)}
    assert count[1]["fragments"] < count[0]["fragments"] / 4
    assert count[1]["tiles_hidden"] > 0 and "tiles_hidden" not in count[0]


def test_of_equal_depths_the_lower_index_is_drawn_over_a_bound() -> None:
    """The second triangle fills finest tiles and is stored below the first, so that it is drawn before it."""
    xy = np.array([[[-300, -300], [900, -300], [-300, 900]], [[0, 0], [100, 0], [0, 100]]], np.float64)
    case = from_pixels(xy, np.full((2, 3), 0.5), (256, 256))
    seen = bigtri.rasterize(*case, variant="hierarchical_tiles", parameters={"tile": 16, "levels": 5, "meets": 64})
    assert (seen.triangle == 0).all()

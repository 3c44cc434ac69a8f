"""The exact truth on scenes whose answer is known, and the measures of error on errors that are known."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from counting import soup

import bigtri
from bigtri.precision import RUNGS
from bigtri.reference import rasterize
from bigtri.study import errors, truth


def test_weights_and_depth_of_a_triangle_in_perspective() -> None:
    """Corners at w 1, 1 and 2; the centre of the one pixel of an image of 1x1 is n = (0, 0)."""
    positions = np.array([[-1, -1, 0.5, 1], [1, -1, 0, 1], [0, 2, 1, 2]], np.float32)
    found = truth.seen(positions, np.array([[0, 1, 2]], np.int32), 1, 1)
    assert found.triangle.tolist() == [[0]] and found.times.tolist() == [[1]]
    # (x, y) of b0 * A + b1 * B + b2 * C is 0: b0 = b1, -b0 - b1 + 2 * b2 = 0.
    assert found.weights[0, 0].tolist() == [Fraction(1, 3)] * 3
    assert found.depth[0, 0] == (Fraction(3, 2) / 4 + 1) / 2  # z is 1/2 + 0 + 1, w is 1 + 1 + 2, each over 3


@pytest.mark.parametrize("turn", [1, -1])
def test_each_centre_on_an_edge_has_one_owner(turn: int) -> None:
    """Two squares' halves whose edges all run through pixel centres, of both orientations."""
    corners = np.array([[[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5]], [[-0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]]])[:, ::turn]
    shift = 1 / 8  # half a pixel of 8
    xy = corners + [shift, -shift]
    positions, triangles = soup(np.concatenate([xy, np.zeros((2, 3, 1)), np.ones((2, 3, 1))], axis=-1))
    found = truth.seen(positions, triangles, 8, 8)
    expected = np.zeros((8, 8), np.int64)
    expected[2:6, 2:6] = 1  # left and upper borders in, right and lower ones out
    np.testing.assert_array_equal(found.times, expected)
    packed, _ = rasterize(positions, triangles, 8, 8)
    np.testing.assert_array_equal(found.triangle, packed.astype(np.uint32).view(np.int32))


def test_what_lies_behind_the_eye_or_beyond_a_plane_is_not_seen() -> None:
    rows = {
        "before the near plane": ([[-1, 1, -2, 1], [3, 1, -2, 1], [-1, -3, -2, 1]], 0),
        "beyond the far plane": ([[-1, 1, 2, 1], [3, 1, 2, 1], [-1, -3, 2, 1]], 0),
        "behind the eye": ([[-1, 1, 0, -1], [3, 1, 0, -1], [-1, -3, 0, -1]], 0),
        "edge-on": ([[-1, 0, 0, 1], [0, 0, 0, 1], [1, 0, 0, 1]], 0),
        "on the near plane": ([[-1, 1, -1, 1], [3, 1, -1, 1], [-1, -3, -1, 1]], 16),
    }
    for name, (corners, pixels) in rows.items():
        found = truth.seen(*soup(np.array([corners])), 4, 4)
        assert int((found.triangle == 0).sum()) == pixels, name
    # Half of a floor is behind the eye: its horizon is the line y = 0, the middle of the image.
    floor = truth.seen(*soup(np.array([[[-9, -1, 2, 4], [9, -1, 2, 4], [0, -1, -1.5, -2]]])), 8, 8)
    assert not (floor.triangle[:4] == 0).any() and (floor.triangle[4:] == 0).any()


def test_the_nearer_one_is_seen_and_the_lower_index_of_equals() -> None:
    whole = np.array([[-1, 1], [3, 1], [-1, -3]])
    depths = [0.25, 0.125, 0.125]
    corners = np.array([[[x, y, z, 1] for x, y in whole] for z in depths])
    found = truth.seen(*soup(corners), 4, 4)
    assert (found.triangle == 1).all() and (found.times == 3).all()
    assert (found.depth == Fraction(9, 16)).all()


def test_exact_is_wrong_only_where_snapping_moved_an_edge() -> None:
    """And a rung of fewer bits is wrong more often; one broken on purpose far more."""
    rng = np.random.default_rng(41)
    xy = rng.uniform(-0.9, 0.9, (12, 3, 2))
    corners = np.concatenate([xy, rng.uniform(-0.9, 0.9, (12, 3, 1)), np.ones((12, 3, 1))], axis=-1)
    positions, triangles = soup(corners)
    found = truth.seen(positions, triangles, 96, 96)
    wrong = {}
    for name in ("subpixel16", "exact", "subpixel4"):
        packed, _ = rasterize(positions, triangles, 96, 96, arithmetic=RUNGS[name])
        wrong[name] = errors.wrong_pixels(packed.astype(np.uint32).view(np.int32), found)
    assert wrong["subpixel16"] <= wrong["exact"] < wrong["subpixel4"]
    assert wrong["exact"] < 10 < (found.triangle >= 0).sum()
    moved, _ = rasterize(positions + np.float32([0.02, 0, 0, 0]), triangles, 96, 96)
    assert errors.wrong_pixels(moved.astype(np.uint32).view(np.int32), found) > 100


def test_gaps_and_overlaps_of_a_shared_edge() -> None:
    """A diagonal through pixel centres: drawn once, twice, or not at all."""
    corners = np.array([[[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5]], [[-0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]]])
    xy = corners + [1 / 16, -1 / 16]
    positions, triangles = soup(np.concatenate([xy, np.zeros((2, 3, 1)), np.ones((2, 3, 1))], axis=-1))
    found = truth.seen(positions, triangles, 16, 16)
    for name, wanted in (
        ("exact", (0, 0)),
        # 9 on the diagonal from corner to corner, and the 8 others each of the right and of the lower border.
        ("coverage_float32_inclusive", (0, 25)),
        # 7 on the diagonal between the corners, and 8 each of the left and of the upper border, less their common corner.
        ("coverage_float32_strict", (22, 0)),
    ):
        got = errors.coverage(positions, triangles, found, precision=name, backend="reference")
        assert got == wanted, name


def test_depth_in_units_of_the_last_place() -> None:
    positions, triangles = soup(np.array([[[-1, 1, -1, 1], [3, 1, 3, 1], [-1, -3, -1, 1]]]))
    found = truth.planes(positions, triangles, 4, 4)
    depth = np.tile(np.float32([0.125, 0.375, 0.625, 0.875]), (4, 1))
    triangle = np.zeros((4, 4), np.int32)
    assert (errors.depth_ulp(depth, triangle, found) == 0).all()
    off = errors.depth_ulp(np.nextafter(depth, np.float32(1)), triangle, found)
    assert (off == 1).all()
    assert len(errors.depth_ulp(depth, triangle - 1, found)) == 0
    assert errors._ulp(Fraction(1)) == Fraction(1, 2**23) and errors._ulp(Fraction(1) - Fraction(1, 2**30)) == Fraction(1, 2**24)
    assert errors._ulp(Fraction(0)) == errors._ulp(Fraction(1, 2**126)) == Fraction(1, 2**149)


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [
        ("exact", 0, 0.51),
        ("depth_fixed_cell", 0, 0.51),
        ("depth_float32_barycentric", 0.6, 4),
        ("depth_float32_cell", 10, 1000),
        ("depth_float32_vertex", 10, 10000),
    ],
)
def test_the_known_errors_of_depth(name: str, low: float, high: float) -> None:
    """Large triangles with depths over all of (0, 1): what is known of each rule, in units in the last place."""
    rng = np.random.default_rng(43)
    xy = rng.uniform(-20, 20, (60, 3, 2))
    corners = np.concatenate([xy, rng.uniform(-1, 1, (60, 3, 1)), np.ones((60, 3, 1))], axis=-1)
    worst = 0.0
    for one in corners:
        positions, triangles = soup(one[None])
        packed, _ = rasterize(positions, triangles, 12, 12, arithmetic=RUNGS[name])
        found = truth.planes(positions, triangles, 12, 12)
        depth = (packed >> 32).astype(np.int32).view(np.float32)
        off = errors.depth_ulp(depth, packed.astype(np.uint32).view(np.int32), found)
        worst = max(worst, off.max(initial=0))
    assert low <= worst <= high


def test_z_fighting_is_counted() -> None:
    """Two planes that cross at an angle too small for 16 bits."""
    plane = np.array([[-1, 1, 0], [3, 1, 0], [-1, -3, 0]])
    tilted = plane + [[0, 0, -1e-5], [0, 0, 3e-5], [0, 0, -1e-5]]
    corners = np.stack([plane, tilted]) + [0, 0, 1.5 / 65535]  # the middle of a level of 16 bits
    positions, triangles = soup(np.concatenate([corners, np.ones((2, 3, 1))], axis=-1))
    found = truth.planes(positions, triangles, 8, 8)
    assert {0, 1} == {*found.triangle.ravel().tolist()} and (found.times == 2).all()
    seen = {}
    for name in ("exact", "depth_stored24", "depth_stored16"):
        packed, _ = rasterize(positions, triangles, 8, 8, arithmetic=RUNGS[name])
        seen[name] = errors.flips(packed.astype(np.uint32).view(np.int32), found)
    assert seen["exact"] == seen["depth_stored24"] == 0 and seen["depth_stored16"] == (found.triangle == 1).sum()


def test_the_error_of_attributes_in_texels() -> None:
    """uv over a square in perspective: float64 weights are exact to float32; affine ones would be off by hundreds of texels."""
    positions = np.array([[-1, -1, 0, 1], [4, -4, 0, 4], [-1, 1, 0, 1]], np.float32)
    triangles, uv = np.array([[0, 1, 2]], np.int32), np.array([[0, 0], [1, 0], [0, 1]], np.float32)
    drawn = bigtri.rasterize(positions, triangles, (16, 16), backend="reference")
    values = bigtri.interpolate(uv, drawn, positions, triangles, backend="reference")
    found = truth.seen(positions, triangles, 16, 16)
    triangle = np.asarray(drawn.triangle)
    off = errors.attribute_error(np.asarray(values), triangle, uv, triangles, found, scale=1024)
    assert off.size == (found.triangle == 0).sum() > 100
    assert off.max() < 1024 * 2**-23
    shifted = errors.attribute_error(np.asarray(values) + np.float32(0.5), triangle, uv, triangles, found, scale=1024)
    np.testing.assert_allclose(shifted, 512, atol=1e-3)


def test_likeness_of_pictures() -> None:
    rng = np.random.default_rng(44)
    image = rng.integers(0, 255, (16, 16, 3), dtype=np.uint8)
    assert errors.likeness(image, image) == (float("inf"), 1.0)
    off_by_one = errors.likeness(image + np.uint8(1), image)
    assert off_by_one.psnr == pytest.approx(20 * np.log10(255)) and 0.9 < off_by_one.ssim < 1


def test_what_masks_look_at() -> None:
    """A diagonal band: the tighter the mask, the fewer tiles; none of them misses a tile that has a covered pixel."""
    corners = np.array([[[-1, 1, 0, 1], [-0.9, 1, 0, 1], [1, -1, 0, 1]], [[-1, 1, 0, 1], [1, 1, 0, 1], [-1, -1, 0, 1]]])
    found = {
        name: errors.masks(*soup(corners), 200, 200, RUNGS[name])
        for name in ("exact", "mask_half_tile", "mask_bounds", "mask_none")
    }
    touched = [one.touched for one in found.values()]
    assert touched == sorted(set(touched)) and found["exact"].full > found["mask_half_tile"].full > found["mask_bounds"].full == 0
    assert len({one.touched - one.empty for one in found.values()}) == 1
    assert found["mask_bounds"].touched == 2 * 25**2 and found["mask_none"].touched == 2 * 32**2
    assert found["exact"].empty < 10

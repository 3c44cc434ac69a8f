"""The truth of single pixels against that of whole images."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from cases import Case, behind_camera, degenerate, equal_depth, huge, on_centres, random_corners
from counting import soup

from bigtri.precision import RUNGS
from bigtri.study import sampled, truth

CASES = [behind_camera, degenerate, equal_depth, huge, on_centres]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.__name__)
def test_single_pixels_are_those_of_the_whole_image(case: Callable[[np.random.Generator], Case]) -> None:
    """What crosses the eye's plane, has no area, lies at equal depth or beyond all bounds, and edges through centres."""
    positions, triangles, _ = case(np.random.default_rng(51))
    triangles, height, width = triangles[::3], 24, 40
    wanted = truth.seen(positions, triangles, height, width).triangle.ravel()
    everywhere = sampled.pixels(height, width, height * width, seed=0)
    np.testing.assert_array_equal(sampled.nearest(positions, triangles, height, width, everywhere), wanted)
    some = sampled.pixels(height, width, 100, seed=1)
    assert len(np.unique(some)) == 100 and some.min() >= 0 and some.max() < height * width
    np.testing.assert_array_equal(sampled.nearest(positions, triangles, height, width, some), wanted[some])


def test_what_is_not_drawn_does_not_show() -> None:
    """Triangles that are not finite, and the faces that are culled."""
    positions, triangles = soup(random_corners(np.random.default_rng(52), 30, 0.7, behind=True))
    positions[4] = np.nan
    corners = positions[triangles].astype(np.float64)[..., [0, 1, 3]]
    back = np.linalg.det(np.nan_to_num(corners)) < 0
    at = sampled.pixels(24, 24, 24 * 24, seed=0)
    for cull, drawn in (("back", ~back), ("front", back)):
        kept = np.flatnonzero(drawn & np.isfinite(corners).all(axis=(1, 2)))
        alone = sampled.nearest(positions, triangles[kept], 24, 24, at)
        wanted = np.where(alone < 0, -1, kept[alone])
        np.testing.assert_array_equal(sampled.nearest(positions, triangles, 24, 24, at, cull), wanted)
        assert (wanted >= 0).any()


@pytest.mark.parametrize("rung", ["exact", "subpixel4"])
def test_depth_and_weights_are_those_of_the_whole_image(rung: str) -> None:
    positions, triangles = soup(random_corners(np.random.default_rng(53), 5, 0.6))
    shown = truth.seen(positions, triangles, 20, 20)
    depths = truth.planes(positions, triangles, 20, 20, RUNGS[rung])
    at = sampled.pixels(20, 20, 150, seed=2)
    found = sampled.values(positions, triangles, 20, 20, at, shown.triangle.ravel()[at], RUNGS[rung])
    there = found.triangle != truth.BACKGROUND
    same = there & (depths.triangle.ravel()[at] == found.triangle)
    assert same.sum() > 50
    assert (found.depth[same] == depths.depth.ravel()[at][same]).all()
    assert (found.weights[there] == shown.weights.reshape(-1, 3)[at][there]).all()


def test_nothing_is_seen_where_no_triangle_is() -> None:
    at = sampled.pixels(4, 4, 16, seed=0)
    nothing = np.empty((0, 4), np.float32), np.empty((0, 3), np.int32)
    aside = soup(np.array([[[5, 0, 0, 1], [6, 0, 0, 1], [5, 1, 0, 1]]]))
    for positions, triangles in (nothing, aside):
        assert (sampled.nearest(positions, triangles, 4, 4, at) == truth.BACKGROUND).all()

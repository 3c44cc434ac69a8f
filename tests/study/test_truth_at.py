"""The truth of single pixels against that of whole images."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from cases import Case, behind_camera, degenerate, equal_depth, huge, on_centres, random_corners
from counting import soup

from bigtri.precision import RUNGS
from bigtri.study import truth


def everywhere(height: int, width: int) -> np.ndarray:
    """int64 [H * W, 2]: column and row of every pixel."""
    return np.stack(np.divmod(np.arange(height * width), width)[::-1], axis=1)


CASES = [behind_camera, degenerate, equal_depth, huge, on_centres]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.__name__)
def test_single_pixels_are_those_of_the_whole_image(
    case: Callable[[np.random.Generator], Case], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What crosses the eye's plane, has no area, lies at equal depth or beyond all bounds, and edges through centres."""
    positions, triangles, _ = case(np.random.default_rng(51))
    triangles, height, width = triangles[::3], 24, 40
    wanted = truth.seen(positions, triangles, height, width).triangle.ravel()
    pixels = everywhere(height, width)
    np.testing.assert_array_equal(truth.nearest_at(positions, triangles, height, width, pixels), wanted)
    monkeypatch.setattr(truth, "_CHUNK", 100)
    some = np.sort(np.random.default_rng(54).choice(height * width, 100, replace=False))
    np.testing.assert_array_equal(truth.nearest_at(positions, triangles, height, width, pixels[some]), wanted[some])


def test_what_is_not_drawn_does_not_show() -> None:
    """Triangles that are not finite, and the faces that are culled."""
    positions, triangles = soup(random_corners(np.random.default_rng(52), 30, 0.7, behind=True))
    positions[4] = np.nan
    corners = positions[triangles].astype(np.float64)[..., [0, 1, 3]]
    back = np.linalg.det(np.nan_to_num(corners)) < 0
    at = everywhere(24, 24)
    for cull, drawn in (("back", ~back), ("front", back)):
        kept = np.flatnonzero(drawn & np.isfinite(corners).all(axis=(1, 2)))
        alone = truth.nearest_at(positions, triangles[kept], 24, 24, at)
        wanted = np.where(alone < 0, -1, kept[alone])
        np.testing.assert_array_equal(truth.nearest_at(positions, triangles, 24, 24, at, cull), wanted)
        assert (wanted >= 0).any()


@pytest.mark.parametrize("rung", ["exact", "subpixel4"])
def test_depth_and_weights_are_those_of_the_whole_image(rung: str) -> None:
    positions, triangles = soup(random_corners(np.random.default_rng(53), 5, 0.6))
    shown = truth.seen(positions, triangles, 20, 20)
    depths = truth.planes(positions, triangles, 20, 20, RUNGS[rung])
    at = np.sort(np.random.default_rng(55).choice(400, 150, replace=False))
    found = truth.at(positions, triangles, 20, 20, everywhere(20, 20)[at], shown.triangle.ravel()[at], RUNGS[rung])
    there = found.triangle != truth.BACKGROUND
    same = there & (depths.triangle.ravel()[at] == found.triangle)
    assert same.sum() > 50
    assert (found.depth[same] == depths.depth.ravel()[at][same]).all()
    assert (found.weights[there] == shown.weights.reshape(-1, 3)[at][there]).all()


def test_nothing_is_seen_where_no_triangle_is() -> None:
    at = everywhere(4, 4)
    nothing = np.empty((0, 4), np.float32), np.empty((0, 3), np.int32)
    aside = soup(np.array([[[5, 0, 0, 1], [6, 0, 0, 1], [5, 1, 0, 1]]]))
    for positions, triangles in (nothing, aside):
        assert (truth.nearest_at(positions, triangles, 4, 4, at) == truth.BACKGROUND).all()

"""The benchmark's scenes: the same every time, on the grid they promise, of the sizes they promise."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
from exhaustive import some_of

import bigtri
from bigtri.study import scenes

SIZES = [(1920, 1080), (3840, 2160)]  # width, height, px
COUNTS = {"S1": 8, "S2": 64, "S3": 32, "S4f": 200, "S4b": 200, "S5": 1000, "S6": 1_000_000, "S6-200k": 200_000, "S7": 1_000_064}
COUNTS |= {"S8": 2000}

# SHA-256 (first 16 digits) of x and y in pixel space, int32 in units of 1/1024 px: figures of different dates stay comparable
DIGESTS = {
    ("S1", 1920): "4bf83c2b35abf759",
    ("S1", 3840): "dcd34dfbda20185b",
    ("S2", 1920): "6c71109dcc312ce9",
    ("S2", 3840): "b66c635f312d3236",
    ("S3", 1920): "855c2c68a7e2a8ec",
    ("S3", 3840): "bb43b7bdf3b63eba",
    ("S4f", 1920): "2342e33c85d5b7ca",
    ("S4f", 3840): "31dee81435e06a56",
    ("S4b", 1920): "2342e33c85d5b7ca",
    ("S4b", 3840): "31dee81435e06a56",
    ("S5", 1920): "598186065f4c4a5d",
    ("S5", 3840): "352e3108445e89e3",
    ("S6", 1920): "bd43d924c1ae6b13",
    ("S6", 3840): "7d60c342cffceef7",
    ("S6-200k", 1920): "e5aa7dd7b49d5079",
    ("S6-200k", 3840): "b4fbb45345325b02",
    ("S7", 1920): "ea8581afe42ed688",
    ("S7", 3840): "e556672e2b83f0ee",
    ("S8", 1920): "282d6f84f043f8d0",
    ("S8", 3840): "c7ca61c925b28487",
}


def area(triangles: np.ndarray) -> np.ndarray:
    """Signed area, px, of triangles [T, 3, 3] in pixel space."""
    ab, ac = (triangles[:, k, :2].astype(np.float64) - triangles[:, 0, :2] for k in (1, 2))
    return (ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]) / 2


def snapped(scene: scenes.Triangles, width: int, height: int) -> np.ndarray:
    """The vertices of each triangle after projection and snapping, int64 [T, 3, 2] subpx (docs/numerics.md 2.2)."""
    x, y, _, w = (scene.positions[scene.triangles].astype(np.float64)[..., k] for k in range(4))
    steps = np.stack([128 * width + np.rint(x / w * (128 * width)), 128 * height - np.rint(y / w * (128 * height))], axis=-1)
    return steps.astype(np.int64)


@pytest.mark.parametrize("width, height", SIZES)
@pytest.mark.parametrize("name", COUNTS)
def test_scene(name: str, width: int, height: int) -> None:
    scene = scenes.make(name, width, height)
    pixels = scenes.pixels(name, width, height)
    assert scene.positions.dtype == np.float32 and scene.triangles.dtype == np.int32
    assert pixels.shape == (COUNTS[name], 3, 3) and len(scene.triangles) == COUNTS[name]
    assert (area(pixels) > 0).all()
    assert pixels[..., 2].min() > 0 and pixels[..., 2].max() < 1
    # float32 clip space keeps every vertex on its sub-pixel
    quarters = pixels[..., :2].astype(np.float64) * 1024
    assert (quarters % 4 == 1).all()
    np.testing.assert_array_equal(snapped(scene, width, height), quarters.astype(np.int64) // 4)
    digest = hashlib.sha256(quarters.astype("<i4").tobytes()).hexdigest()[:16]
    assert digest == DIGESTS[name, width]


def test_seed_and_size_make_another_draw() -> None:
    first = scenes.pixels("S2", 1920, 1080)
    np.testing.assert_array_equal(first, scenes.pixels("S2", 1920, 1080))
    assert not np.array_equal(first, scenes.pixels("S2", 1920, 1080, seed=1001))
    assert not np.array_equal(first, scenes.pixels("S2", 1280, 720))


@pytest.mark.parametrize(
    "name, low, high", [("S1", 4_000, 40_000), ("S2", 4_000, 40_000), ("S6", 3, 18), ("S6-200k", 8, 35), ("S8", 500, 20_000)]
)
def test_areas(name: str, low: float, high: float) -> None:
    sizes = area(scenes.pixels(name, 1920, 1080))
    assert low * 0.99 <= sizes.min() and sizes.max() <= high * 1.01
    if name.startswith("S6"):
        assert np.median(sizes) == pytest.approx({"S6": 10, "S6-200k": 20}[name], rel=0.05)


def test_very_large_triangles_show_a_quarter_of_the_screen() -> None:
    corners = scenes.pixels("S3", 1920, 1080)[..., :2].astype(np.float64)
    shown = [scenes.visible_area(triangle, 1920, 1080) for triangle in corners]
    assert min(shown) > 0.25 * 1920 * 1080


def test_full_screen_triangles_cover_the_screen_in_order() -> None:
    front, back = (scenes.pixels(name, 1920, 1080) for name in ("S4f", "S4b"))
    for triangle in front[..., :2].astype(np.float64):
        assert scenes.visible_area(triangle, 1920, 1080) == pytest.approx(1920 * 1080)
    assert (front[:-1, :, 2].max(axis=1) < front[1:, :, 2].min(axis=1)).all()
    assert (back[:-1, :, 2].min(axis=1) > back[1:, :, 2].max(axis=1)).all()


def test_slivers_are_long_and_thin() -> None:
    triangles = scenes.pixels("S5", 1920, 1080).astype(np.float64)
    longest = np.linalg.norm(triangles[:, [1, 2, 0], :2] - triangles[..., :2], axis=2).max(axis=1)
    assert longest.min() > 1399 and longest.max() < 1601
    across = 2 * area(triangles) / longest
    assert across.min() > 0.95 and across.max() < 2.05


def test_16k() -> None:
    scene = scenes.make("S3", 15360, 8640)
    assert len(scene.triangles) == 32 and np.isfinite(scene.positions).all()


def test_errors() -> None:
    with pytest.raises(ValueError, match="name must be one of R4k, .*S8, got 'S9'"):
        scenes.make("S9", 64, 64)
    with pytest.raises(ValueError, match="name must be one of S1, .*S8, got 'R4k'"):
        scenes.pixels("R4k", 64, 64)
    for size in ((0, 64), (64, 16385)):
        with pytest.raises(ValueError, match="must be an integer from 1 to 16384"):
            scenes.make("S3", *size)
    with pytest.raises(ValueError, match="seed must be an integer of at least 0, got -1"):
        scenes.make("S3", 64, 64, -1)
    with pytest.raises(TypeError, match="width must be an integer .*got 64.0"):
        scenes.make("S3", 64.0, 64)


REAL_COUNTS = {
    **{"R4k": 4072, "R16k": 15860, "R16k-close": 15860, "R16k-far": 15860, "R100k": 100124, "R100k-shuffled": 100124},
    **{"R1M": 1001992, "R1M-shuffled": 1001992, "Rcourtyard": 11542, "Rterrain": 100352, "Rroom": 37412},
}


@pytest.mark.parametrize("name", some_of([n for n in REAL_COUNTS if "1M" not in n], list(REAL_COUNTS)))
def test_real_scenes(name: str) -> None:
    """What each is for is in the picture: all of it, a part, huge and tiny triangles, some across the near plane."""
    scene = scenes.make(name, 320, 180)
    assert scene.positions.dtype == np.float32 and scene.triangles.dtype == np.int32 and np.isfinite(scene.positions).all()
    # Marching cubes looks at the sign of a sum of sines, whose last bit the machine decides.
    assert len(scene.triangles) == pytest.approx(REAL_COUNTS[name], rel=1e-3)
    seen = bigtri.rasterize(scene.positions, scene.triangles, (180, 320))
    assert seen.dropped == 0
    covered = seen.triangle >= 0
    border = np.concatenate([covered[0], covered[-1], covered[:, 0], covered[:, -1]])
    share = covered.mean()
    in_front = (scene.positions[:, 2] + scene.positions[:, 3] > 0)[scene.triangles]
    crossing = in_front.any(axis=1) & ~in_front.all(axis=1)
    if name in ("Rcourtyard", "Rterrain", "Rroom"):
        assert share > 0.3 and border.any() and (crossing.any() or name == "Rterrain")
    else:
        assert not crossing.any() and border.any() == (name == "R16k-close")
        assert {"R16k-close": 0.4, "R16k-far": 0.0005}.get(name, 0.08) < share < {"R16k-far": 0.01}.get(name, 0.9)
    if name.endswith("-shuffled"):
        ordered = scenes.make(name.removesuffix("-shuffled"), 320, 180)
        assert not np.array_equal(ordered.triangles, scene.triangles)
        assert np.array_equal(
            np.sort(ordered.triangles.view("i4,i4,i4"), axis=0), np.sort(scene.triangles.view("i4,i4,i4"), axis=0)
        )


def test_a_body_is_closed_and_follows_its_seed() -> None:
    scene = scenes.make("R4k", 64, 64)
    edges = scene.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    assert np.array_equal(np.unique(edges, axis=0), np.unique(edges[:, ::-1], axis=0))
    assert np.array_equal(scene.positions, scenes.make("R4k", 64, 64).positions)
    assert len(scenes.make("R4k", 64, 64, seed=7).triangles) != len(scene.triangles)


@pytest.mark.parametrize("name", ["S1", "S5", "S6", "S6-200k", "S7"])
@pytest.mark.parametrize("size", [(1, 1), (3, 3), (10, 10)])
def test_an_image_that_is_too_small_is_refused_at_once(name: str, size: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match="which is too small"):
        scenes.make(name, *size)


def test_the_search_for_very_large_triangles_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scenes, "MAX_DRAWS", 50)
    with pytest.raises(ValueError, match="32 triangles that show a quarter of it"):
        scenes.very_large(32, 0, 0, 1)

"""What suggest_precision names, against the measured truth of whole images of scenes that it was not made for."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import bigtri
from bigtri import Camera, Material, Scene, Tolerance, native, suggest_precision
from bigtri.precision import DEFAULT, PRECISIONS, RUNGS
from bigtri.study import errors, truth
from bigtri.study.clock import Timing
from bigtri.study.suggest import Suggestion, _at_most

CANDIDATES = tuple(name for name in PRECISIONS if name != "depth_reversed")
FRONT = Camera((0, 0, 1), (0, 0, 0), fov_y=90, near=0.1, far=10)  # sees the square from -1 to 1 at z = 0
PAGE = Path(__file__).parents[2] / "docs" / "accuracy.md"


@pytest.fixture
def every_rung(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the extension lacks rungs, as wheels do, the reference draws, which has all: the bits are the same."""
    if not {*CANDIDATES} <= {*native.REGISTRY.get("cpu", ())}:
        monkeypatch.setattr(native, "REGISTRY", {})


def timed(ms: Mapping[str, float], otherwise: float = 10.0, spread: float = 0.0) -> dict[str, Timing]:
    """Times of all candidates, in which half the calls are within ``spread`` of the median."""
    return {
        name: Timing(median, median - spread, median - spread, median + spread, 9)
        for name, median in ((name, ms.get(name, otherwise)) for name in CANDIDATES)
    }


def of_triangles(corners: np.ndarray, **settings: Any) -> Scene:
    """Unconnected triangles from corners [T, 3, 3]."""
    positions = np.ascontiguousarray(corners, np.float32).reshape(-1, 3)
    return Scene(positions, np.arange(len(positions), dtype=np.int32).reshape(-1, 3), **settings)


def cloud(seed: int, count: int = 14) -> Scene:
    """Triangles of all sizes and angles before FRONT, some of which cross the near plane."""
    rng = np.random.default_rng(seed)
    centre = rng.uniform((-0.8, -0.8, -2), (0.8, 0.8, 0.7), (count, 1, 3))
    return of_triangles(centre + rng.normal(0, 1, (count, 3, 3)) * 10 ** rng.uniform(-1.5, 0.3, (count, 1, 1)))


@lru_cache
def seen_of(scene: Scene, camera: Camera, resolution: tuple[int, int]) -> truth.Seen:
    """The truth of the whole image; ``scene`` is known by its identity."""
    height, width = resolution
    return truth.seen(camera.transform(scene.positions, width / height), scene.triangles, height, width)


def truly_wrong(scene: Scene, camera: Camera, resolution: tuple[int, int], precision: str) -> int:
    """Wrong pixels of the whole image, as the reference draws it."""
    positions = camera.transform(scene.positions, resolution[1] / resolution[0])
    drawn = bigtri.rasterize(positions, scene.triangles, resolution, precision=precision, backend="reference")
    return errors.wrong_pixels(np.asarray(drawn.triangle), seen_of(scene, camera, resolution))


def truly_off(scene: Scene, camera: Camera, resolution: tuple[int, int], precision: str) -> float:
    """The largest error of depth in the whole image, ulp, where the planes of the snapped triangles lie as they should."""
    height, width = resolution
    positions = camera.transform(scene.positions, width / height)
    grid = {8: DEFAULT, 4: "subpixel4", 12: "subpixel12", 16: "subpixel16"}[RUNGS[precision].subpixel_bits]
    planes = truth.planes(positions, scene.triangles, height, width, RUNGS[grid])
    drawn = bigtri.rasterize(positions, scene.triangles, resolution, precision=precision, backend="reference")
    return float(errors.depth_ulp(np.asarray(drawn.depth), np.asarray(drawn.triangle), planes).max(initial=0))


# --- Random scenes


@pytest.mark.usefixtures("every_rung")
@pytest.mark.parametrize("seed", range(100, 112))
def test_the_suggested_rung_meets_the_tolerance_on_all_pixels(seed: int) -> None:
    """Whatever is fast: a limit on wrong pixels, one on depth, and both."""
    rng = np.random.default_rng(seed)
    scene, resolution = cloud(seed), (20, 30)
    times = timed({name: float(ms) for name, ms in zip(CANDIDATES, rng.uniform(1, 9, len(CANDIDATES)), strict=True)})
    for limits in (
        {"wrong_pixels_per_million": float(rng.choice([0, 2000, 10000, 50000]))},
        {"depth_ulp": float(rng.choice([0.6, 5, 100]))},
        {"wrong_pixels_per_million": 5000.0, "depth_ulp": 20.0},
    ):
        found = suggest_precision(scene, FRONT, resolution, Tolerance(**limits), times=times)
        assert found.pixels == found.values == 600
        wrong = truly_wrong(scene, FRONT, resolution, found.precision)
        assert found.of(found.precision).wrong == wrong
        assert found.of("subpixel4").depth_ulp <= 0.51, "of the planes that it has itself, with vertices on its own grid"
        if not found.meets:
            assert found.precision == DEFAULT and not any(one.meets for one in found.evidence)
            continue
        assert 1e6 * wrong / 600 <= limits.get("wrong_pixels_per_million", math.inf)
        assert truly_off(scene, FRONT, resolution, found.precision) <= limits.get("depth_ulp", math.inf)
        assert all(
            found.of(name).time.median >= found.of(found.precision).time.median for name in CANDIDATES if found.of(name).meets
        )


@pytest.mark.usefixtures("every_rung")
def test_what_a_sample_says_of_all_pixels_holds() -> None:
    """With 95 % confidence, which leaves one scene in twenty; and a rung is suggested by it, not by what the sample has."""
    resolution, limit = (40, 50), 30000.0
    suggested, beyond = 0, dict.fromkeys((DEFAULT, "subpixel4", "clip_none"), 0)
    for seed in range(200, 220):
        scene, tolerance = cloud(seed, 8), Tolerance(wrong_pixels_per_million=limit)
        found = suggest_precision(scene, FRONT, resolution, tolerance, samples=500, seed=seed, times=timed({}))
        assert found.pixels == found.values == 500
        for name in beyond:
            one = found.of(name)
            assert one.wrong_pixels_per_million < one.at_most_per_million and one.meets == (one.at_most_per_million <= limit)
            beyond[name] += 1e6 * truly_wrong(scene, FRONT, resolution, name) / 2000 > one.at_most_per_million
        if found.meets:
            suggested += 1
            assert 1e6 * truly_wrong(scene, FRONT, resolution, found.precision) / 2000 <= limit
    assert suggested > 10 and max(beyond.values()) <= 1


def test_the_bound_is_the_largest_number_that_a_sample_leaves_likely() -> None:
    """Against sums of binomial coefficients, and the rule of three."""
    everything, samples = 30, 12
    for found in (0, 1, 5, 12):
        bound = _at_most(found, samples, everything)

        def likely(there: int, found: int = found) -> bool:
            ways = (math.comb(there, k) * math.comb(everything - there, samples - k) for k in range(found + 1))
            return Fraction(sum(ways), math.comb(everything, samples)) > Fraction(1, 20)

        possible = [there for there in range(found, everything - samples + found + 1) if likely(there)]
        assert bound == max(possible)
    assert _at_most(3, 100, 100) == 3
    assert 0.9 < _at_most(0, 3000, 10**7) / 10**7 * 1000 < 1


# --- Scenes that break a rung


def slivers() -> Scene:
    """Needles of 1/100 px to 1/10 px, of 32 px a side, fanned out around a corner."""
    rng = np.random.default_rng(301)
    turn = rng.uniform(0, 2 * np.pi, 150)
    along = np.stack([np.cos(turn), np.sin(turn), np.zeros(150)], axis=1) * rng.uniform(0.5, 1.2, (150, 1))
    across = np.stack([-np.sin(turn), np.cos(turn), np.zeros(150)], axis=1) * 10 ** rng.uniform(-3.2, -2.2, (150, 1))
    start = rng.uniform(-0.6, 0.6, (150, 3)) * [1, 1, 0.2]
    return of_triangles(np.stack([start, start + along, start + along + across], axis=1))


def two_far_walls() -> Scene:
    """Four metres apart, 400 m away from an eye that sees from 10 cm on: some 40 ulp, far below what 16 bits tell apart."""
    wall = np.array([[-1, -1, 0], [3, -1, 0], [-1, 3, 0]]) * 1e4
    return of_triangles(np.stack([wall + [0, 0, -404], wall + [0, 0, -400]]))


def floor_under_the_eye() -> Scene:
    """Two large triangles, which go on behind the eye."""
    return of_triangles(np.array([[[-50, -1, -50], [-50, -1, 50], [50, -1, 50]], [[-50, -1, -50], [50, -1, 50], [50, -1, -50]]]))


def textured_floor() -> Scene:
    """The same before the eye, with a texture of 64x64 texels, and another of 8x16 beside it."""
    corners = np.array([[[-1, -1, 0], [1, -1, 0], [1, -1, -20]], [[-1, -1, 0], [1, -1, -20], [-1, -1, -20]]])
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 0], [1, 1], [0, 1]], np.float32)
    textures = (np.zeros((64, 64, 3), np.float32), np.zeros((8, 16, 3), np.float32))
    return of_triangles(
        corners, uvs=uv, materials=tuple(Material(texture=texture) for texture in textures), material=np.array([0, 1], np.int32)
    )


LOOKING_FAR = Camera((0, 0, 0), (0, 0, -1), fov_y=60, near=0.1, far=1e5)
WALKING = Camera((0.1, 0, 2), (0, -0.3, -1), fov_y=60, near=0.05, far=200)
BROKEN = {
    "slivers": (slivers, FRONT, "subpixel4", {"wrong_pixels_per_million": 30000}),
    "depth range": (two_far_walls, LOOKING_FAR, "depth_stored16", {"wrong_pixels_per_million": 1000}),
    "near plane": (floor_under_the_eye, WALKING, "clip_none", {"wrong_pixels_per_million": 1000}),
    "near plane, depth": (floor_under_the_eye, WALKING, "clip_none", {"depth_ulp": 5}),
    "texture": (textured_floor, WALKING, "attributes_affine", {"attribute_texels": 2}),
}


@pytest.mark.usefixtures("every_rung")
@pytest.mark.parametrize("name", BROKEN)
def test_a_fast_rung_that_a_scene_breaks_is_not_suggested(name: str) -> None:
    make, camera, broken, limits = BROKEN[name]
    scene, resolution, tolerance = make(), (24, 32), Tolerance(**limits)
    found = suggest_precision(scene, camera, resolution, tolerance, times=timed({broken: 1.0}))
    assert found.meets and found.of(found.precision).meets
    assert found.precision == ("subpixel12" if name == "slivers" else DEFAULT), "the most accurate of those as fast"
    one = found.of(broken)
    assert not one.meets and one.wrong == truly_wrong(scene, camera, resolution, broken)
    assert found.of(DEFAULT).wrong == truly_wrong(scene, camera, resolution, DEFAULT)
    if "wrong_pixels_per_million" in limits:
        assert one.wrong * 1e6 / 768 > limits["wrong_pixels_per_million"]


@pytest.mark.usefixtures("every_rung")
def test_texels_are_those_of_the_texture_that_is_seen() -> None:
    """Each triangle alone, whose error is that of its uv times its own texture's size; together the larger one."""
    scene, tolerance, apart = textured_floor(), Tolerance(attribute_texels=1), []
    for index, sizes in enumerate(((64, 64), (16, 8))):
        alone = scene.with_(triangles=scene.triangles[index : index + 1], material=scene.material[index : index + 1])
        positions = WALKING.transform(alone.positions, 32 / 24)
        seen = truth.seen(positions, alone.triangles, 24, 32)
        drawing: dict[str, Any] = {"precision": "attributes_affine", "backend": "reference"}
        drawn = bigtri.rasterize(positions, alone.triangles, (24, 32), **drawing)
        uv = np.asarray(bigtri.interpolate(alone.uvs, drawn, positions, alone.triangles, **drawing))
        off = max(
            errors.attribute_error(
                uv[..., c : c + 1], np.asarray(drawn.triangle), alone.uvs[:, c : c + 1], alone.triangles, seen, size
            ).max()
            for c, size in enumerate(sizes)
        )
        found = suggest_precision(alone, WALKING, (24, 32), tolerance, times=timed({}))
        # Pixels that snapping takes from the triangle count for one and not for the other.
        assert found.of("attributes_affine").attribute_texels == pytest.approx(off, rel=0.2)
        apart.append(found.of("attributes_affine").attribute_texels)
    both = suggest_precision(scene, WALKING, (24, 32), tolerance, times=timed({})).of("attributes_affine")
    assert both.attribute_texels == max(apart)


@pytest.mark.usefixtures("every_rung")
def test_the_picture_is_compared_with_one_of_many_samples() -> None:
    """Edges alone decide it, so a rung that loses the floor is far off and the others are as good as exact."""
    scene = floor_under_the_eye()
    found = suggest_precision(scene, WALKING, (24, 32), Tolerance(psnr_db=40), times=timed({"clip_none": 1.0}))
    assert found.supersample == 8 and found.meets and found.precision == DEFAULT
    fine, coarse = (bigtri.render(scene, WALKING, (24, 32), supersample=n, backend="reference") for n in (8, 1))
    assert found.of(DEFAULT).psnr_db == errors.likeness(coarse, fine).psnr > 40 > found.of("clip_none").psnr_db
    assert "PSNR: against 8x8 samples a pixel" in str(found)


# --- The choice


def on_the_grid() -> Scene:
    """A triangle with its corners on pixels' corners, drawn without any error."""
    return of_triangles(np.array([[[-0.5, -0.5, 0], [0.5, -0.5, 0], [-0.5, 0.5, 0]]]))


@pytest.mark.usefixtures("every_rung")
def test_a_tolerance_of_nothing_gives_a_rung_without_an_error() -> None:
    nothing = Tolerance(wrong_pixels_per_million=0)
    found = suggest_precision(
        on_the_grid(), FRONT, (16, 16), nothing, times=timed({"coverage_float32_inclusive": 1.0, "exact": 5.0})
    )
    assert found.precision == DEFAULT and found.meets and found.of("coverage_float32_inclusive").wrong > 0
    # Where exact itself is wrong, as snapping has moved an edge over a centre, a finer grid is named.
    for scene in map(cloud, range(400, 440)):
        if truly_wrong(scene, FRONT, (48, 48), DEFAULT):
            found = suggest_precision(scene, FRONT, (48, 48), nothing, times=timed({"exact": 1.0}))
            assert found.meets and found.precision == "subpixel12" and found.of("subpixel12").wrong == 0
            assert truly_wrong(scene, FRONT, (48, 48), "subpixel12") == 0
            return
    pytest.fail("exact has no wrong pixel in any of these scenes")


@pytest.mark.usefixtures("every_rung")
def test_of_rungs_as_fast_within_the_spread_the_most_accurate() -> None:
    scene, resolution = cloud(501), (48, 48)
    tolerance = Tolerance(wrong_pixels_per_million=1e6)

    def chosen(ms: Mapping[str, float], spread: float) -> str:
        return suggest_precision(scene, FRONT, resolution, tolerance, times=timed(ms, spread=spread)).precision

    assert truly_wrong(scene, FRONT, resolution, "subpixel4") > truly_wrong(scene, FRONT, resolution, DEFAULT)
    ms = {"subpixel4": 4.0, "exact": 5.0, "mask_half_tile": 5.0}
    assert chosen(ms, spread=0.4) == "subpixel4"
    assert chosen(ms, spread=0.6) == DEFAULT, "which is as fast; of those with the same errors it comes first"


@pytest.mark.usefixtures("every_rung")
def test_where_no_rung_is_good_enough_it_is_exact_and_said() -> None:
    found = suggest_precision(textured_floor(), WALKING, (24, 32), Tolerance(attribute_texels=0), times=timed({"exact": 99.0}))
    assert not found.meets and found.precision == DEFAULT
    assert str(found).startswith("exact: no rung was shown to meet attribute_texels <= 0\n")
    # A sample without an error does not show that there is none.
    few = suggest_precision(on_the_grid(), FRONT, (16, 16), Tolerance(wrong_pixels_per_million=0), samples=100, times=timed({}))
    assert not few.meets and few.of(DEFAULT).wrong == 0 < few.of(DEFAULT).at_most_per_million


@pytest.mark.usefixtures("every_rung")
def test_culled_faces_are_not_missed() -> None:
    scene = cloud(502)
    for cull in ("back", "front"):
        found = suggest_precision(
            scene.with_(cull=cull), FRONT, (24, 24), Tolerance(wrong_pixels_per_million=20000), times=timed({})
        )
        assert found.of(DEFAULT).wrong <= 3
    empty = suggest_precision(of_triangles(np.empty((0, 3, 3))), FRONT, (4, 4), Tolerance(depth_ulp=0), times=timed({}))
    assert empty.meets and all(one.wrong == 0 and one.depth_ulp == 0 for one in empty.evidence)


# --- What is said


@pytest.mark.usefixtures("every_rung")
def test_the_same_seed_gives_the_same_answer() -> None:
    def answer(seed: int) -> Suggestion:
        limit = Tolerance(wrong_pixels_per_million=50000)
        return suggest_precision(cloud(503), FRONT, (48, 48), limit, samples=300, seed=seed, times=timed({}))

    assert answer(1) == answer(1)
    assert answer(1).evidence != answer(2).evidence


@pytest.mark.usefixtures("every_rung")
def test_the_table_has_every_rung_the_fastest_first() -> None:
    ms = {name: 1.0 + k for k, name in enumerate(reversed(CANDIDATES))}
    found = suggest_precision(
        cloud(504), FRONT, (48, 48), Tolerance(wrong_pixels_per_million=1e5, depth_ulp=1000), samples=300, times=timed(ms)
    )
    lines = str(found).splitlines()
    header = next(k for k, line in enumerate(lines) if line.startswith("rung"))
    assert [line.split()[0] for line in lines[header + 1 :]] == list(reversed(CANDIDATES))
    assert lines[0] == f"{found.precision}: the cheapest rung that meets wrong_pixels_per_million <= 100000, depth_ulp <= 1000"
    assert lines[1].startswith("48x48 px, cpu (")
    assert lines[2] == "wrong pixels: of 300 pixels of 2304, seed 0; 'at most' is of all, with 95% confidence"
    assert lines[3].startswith("depth and texels: the largest errors of 300 pixels; at most ")
    slowest = found.of(DEFAULT)
    assert lines[-1].split()[:3] == [DEFAULT, f"{slowest.time.median:.3f}", "1.00"] and slowest.relative == 1
    assert found.of(CANDIDATES[-1]).relative == 1 / len(CANDIDATES)


def test_times_are_measured_where_none_are_given() -> None:
    found = suggest_precision(on_the_grid(), FRONT, (16, 16), Tolerance(depth_ulp=1), seconds=0.01)
    assert {one.precision for one in found.evidence} == {n for n in native.REGISTRY.get("cpu", PRECISIONS) if n in CANDIDATES}
    assert all(one.time.repeats >= 5 and 0 < one.time.p25 <= one.time.p75 for one in found.evidence)
    assert found.of(DEFAULT).relative == 1


def test_the_example_of_the_page_does_what_it_says() -> None:
    section = PAGE.read_text().split("## Which one for me")[1].split("\n## ")[0]
    (example,) = re.findall(r"```python\n(.*?)```", section, re.S)
    names: dict[str, Any] = {}
    exec(example, names)
    assert names["found"].meets and names["image"].shape == (90, 160, 3)


# --- Errors


@pytest.mark.parametrize(
    ("limits", "error", "text"),
    [
        ({}, ValueError, "at least one of wrong_pixels_per_million, depth_ulp, attribute_texels, psnr_db must be a number"),
        ({"depth_ulp": "1"}, TypeError, "depth_ulp must be a finite number, got '1'"),
        ({"depth_ulp": math.nan}, ValueError, "depth_ulp must be a finite number, got nan"),
        ({"wrong_pixels_per_million": -1}, ValueError, "wrong_pixels_per_million must not be negative, got -1.0"),
        ({"depth_ulp": 1, "psnr_db": math.inf}, ValueError, "psnr_db must be a finite number, got inf"),
    ],
)
def test_limits_that_are_none(limits: dict[str, Any], error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=f"bigtri.Tolerance: {text}"):
        Tolerance(**limits)


TEXELS, PSNR = Tolerance(attribute_texels=1), Tolerance(psnr_db=30)


@pytest.mark.parametrize(
    ("changed", "error", "text"),
    [
        ({"scene": None}, TypeError, "scene must be a Scene, got None"),
        ({"camera": [FRONT]}, TypeError, "camera must be a Camera, got list"),
        ({"resolution": (0, 4)}, ValueError, "resolution must be"),
        ({"tolerance": 3.0}, TypeError, "tolerance must be a Tolerance, got 3.0"),
        ({"tolerance": TEXELS}, ValueError, "tolerance must not name attribute_texels for a scene without uvs"),
        ({"tolerance": PSNR, "resolution": (6, 9)}, ValueError, "resolution must be at least 7 px a side where psnr_db is named"),
        ({"tolerance": PSNR, "resolution": (4096, 4096)}, ValueError, "resolution must be at most 4194304 px, .*, got .4096"),
        ({"tolerance": PSNR, "resolution": (16, 16384)}, ValueError, "resolution must be at most 4194304 px, and 8192 a side"),
        ({"device": "tpu"}, ValueError, "device must be one of 'cpu'.*, got 'tpu'"),
        ({"samples": 0}, ValueError, "samples must be a whole number of at least 1, got 0"),
        ({"seed": -1}, ValueError, "seed must be a whole number of at least 0, got -1"),
        ({"seconds": 0}, ValueError, "seconds must be positive, got 0"),
        ({"times": 3}, TypeError, "times must have a positive Timing for every candidate, got 3"),
        ({"times": {}}, ValueError, "times must have a positive Timing for every candidate, got none for 'exact'"),
        ({"times": {"exact": 2.0}}, TypeError, "times must have .*, got 2.0 for 'exact'"),
        ({"times": timed({"exact": 0.0})}, ValueError, "times must have .*, got a median of 0.0 for 'exact'"),
    ],
)
def test_errors_name_the_argument(changed: dict[str, Any], error: type[Exception], text: str) -> None:
    given: dict[str, Any] = {"scene": on_the_grid(), "camera": FRONT, "resolution": (8, 8), "tolerance": Tolerance(depth_ulp=1)}
    with pytest.raises(error, match=f"bigtri.suggest_precision: {text}"):
        suggest_precision(**{**given, **changed})
    with pytest.raises(ValueError, match="bigtri.Suggestion.of: precision must be one of 'exact'"):
        suggest_precision(**given, times=timed({})).of("depth_reversed")

"""The accuracy study: the truth of large scenes, what is known of the rungs, and that what is broken shows. Asserts no time."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import lru_cache

import numpy as np
import pytest

from bigtri import native
from bigtri.check import stages
from bigtri.ops.interpolate import barycentrics
from bigtri.ops.rasterize import Visibility, rasterize
from bigtri.precision import RUNGS
from bigtri.study import accuracy, breaks, clock, errors, truth

EFFORT = accuracy.Effort(pairs=400_000, pixels=40, picture=200_000, seconds=0)
needs_ladder = pytest.mark.skipif(
    not (native.available() and set(RUNGS) <= set(native.REGISTRY["cpu"])), reason="the ladder is not built"
)


def random_triangles(seed: int, kind: str) -> tuple[np.ndarray, np.ndarray]:
    """40 triangles, some of whose corners lie behind the eye, beyond a plane, or on pixel centres."""
    rng = np.random.default_rng(seed)
    positions = rng.normal(size=(120, 4)).astype(np.float32)
    positions[:, 3] += {"behind": 0.0, "before": 1.5, "ties": 1.5}[kind]
    if kind == "ties":
        positions = np.round(positions * 4) / 4
    return positions, np.arange(120, dtype=np.int32).reshape(-1, 3)


@pytest.mark.parametrize("kind", ["behind", "before", "ties"])
def test_rows_are_those_of_the_whole_truth(kind: str) -> None:
    positions, triangles = random_triangles(51, kind)
    whole = truth.seen(positions, triangles, 24, 32)
    rows = np.arange(1, 24, 3)
    found = truth.in_rows(positions, triangles, 24, 32, rows)
    np.testing.assert_array_equal(found.triangle, whole.triangle[rows])
    np.testing.assert_array_equal(found.times, whole.times[rows])
    assert found.times.max() > 2
    place, _ = np.divmod(found.pairs, len(triangles))
    np.testing.assert_array_equal(np.bincount(place, minlength=found.times.size), found.times.ravel())


def test_equally_near_ones_and_no_triangles() -> None:
    """Three times the same triangle: float64 decides nothing, the lowest index wins."""
    positions = np.array([[-1, 1, 0.3, 1], [3, 1, -0.3, 1.5], [-1, -3, 0.1, 1]], np.float32)
    found = truth.in_rows(positions, np.tile(np.arange(3, dtype=np.int32), (3, 1)), 8, 8, np.arange(8))
    assert (found.triangle[found.times > 0] == 0).all() and found.times.max() == 3
    nothing = truth.in_rows(positions, np.empty((0, 3), np.int32), 8, 8, np.arange(8))
    assert (nothing.triangle == truth.BACKGROUND).all() and nothing.pairs.size == 0


def test_boxes_have_every_pixel_that_shows() -> None:
    positions, triangles = random_triangles(52, "behind")
    box = truth.boxes(positions, triangles, 24, 32)
    for index, (x0, y0, x1, y1) in enumerate(box.tolist()):
        y, x = np.nonzero(truth.seen(positions, triangles[index : index + 1], 24, 32).times)
        assert ((x >= x0) & (x < x1) & (y >= y0) & (y < y1)).all()


@pytest.mark.parametrize("name", ["exact", "depth_reversed"])
def test_single_pixels_are_those_of_the_planes(name: str) -> None:
    positions, triangles = random_triangles(53, "before")
    if name == "depth_reversed":
        positions = accuracy.reversed_depth(positions)
    planes = truth.planes(positions, triangles, 12, 16, RUNGS[name])
    y, x = np.nonzero(planes.triangle != truth.BACKGROUND)
    shown = planes.triangle[y, x]
    found = truth.at(positions, triangles, 12, 16, np.stack([x, y], axis=1), shown, RUNGS[name])
    assert (found.triangle == shown).all() and len(shown) > 60
    assert (found.depth == planes.depth[y, x]).all()
    assert all(sum(weights) == 1 for weights in found.weights)
    assert truth.at(positions, triangles, 12, 16, np.array([[0, 0]]), np.array([-1], np.int32)).triangle.tolist() == [-1]


def test_reversed_planes_show_the_nearer_one() -> None:
    """Depth is 1 at the near plane there, so the larger one is nearer."""
    whole = np.array([[-1, 1], [3, 1], [-1, -3]])
    corners = np.array([[x, y, z, 1] for z in (0.25, 0.75) for x, y in whole], np.float32)
    found = truth.planes(corners, np.arange(6, dtype=np.int32).reshape(2, 3), 4, 4, RUNGS["depth_reversed"])
    assert (found.triangle == 1).all() and (found.depth == 0.75).all()


# --- what is known of the rungs


@lru_cache
def judge(name: str) -> accuracy.Judge:
    return accuracy.Judge(accuracy.HARD[name](), EFFORT)


def judged(name: str, rung: str, change: Callable[[Visibility, np.ndarray], None] = lambda drawn, weights: None) -> dict:
    """What the study says of a rung, whose output may be changed first."""
    case = accuracy.HARD[name]()
    given, size = case.positions_for(rung), (case.height, case.width)
    drawn = rasterize(given, case.triangles, size, precision=rung)
    weights = np.asarray(barycentrics(drawn, given, case.triangles, precision=rung))
    change(drawn, weights)
    return judge(name).of(rung, drawn, weights)


@needs_ladder
def test_known_facts_of_coverage() -> None:
    exact = judged("ties", "exact")
    assert exact["wrong_ppm"] == exact["cracks_ppm"] == exact["overlaps_ppm"] == 0
    inclusive, strict = judged("ties", "coverage_float32_inclusive"), judged("ties", "coverage_float32_strict")
    assert inclusive["overlaps_ppm"] > 10_000 and inclusive["cracks_ppm"] == 0
    assert strict["cracks_ppm"] > 10_000 and strict["overlaps_ppm"] == 0
    fused = judged("needles", "coverage_float32_fused")
    assert fused["cracks_ppm"] > 100 and fused["overlaps_ppm"] > 100
    assert judged("needles", "subpixel4")["wrong_ppm"] > 1000
    assert judged("needles", "exact")["wrong_ppm"] == judged("needles", "coverage_float32_canonical")["cracks_ppm"] == 0
    clipped = judged("floor", "clip_none")
    assert clipped["wrong_ppm"] > 100_000 and clipped["psnr"] < judged("floor", "exact")["psnr"]


@needs_ladder
def test_known_facts_of_depth_and_attributes() -> None:
    exact = judged("fight", "exact")
    assert exact["flips_ppm"] == 0 and 0.4 < exact["depth_ulp_max"] <= 0.51
    assert exact["flips_ppm"] < judged("fight", "depth_stored24")["flips_ppm"] < judged("fight", "depth_stored16")["flips_ppm"]
    assert judged("fight", "depth_float32_vertex")["flips_ppm"] > 0
    assert judged("far_planes", "exact")["flips_ppm"] == 1e6 and judged("far_planes", "depth_reversed")["wrong_ppm"] == 0
    assert judged("far_planes", "depth_reversed")["depth_ulp_max"] <= 0.51
    assert judged("floor", "exact")["texels_max"] < 1 and judged("floor", "attributes_affine")["texels_max"] > 100
    assert judged("floor", "attributes_unsnapped")["texels_max"] < judged("floor", "exact")["texels_max"] / 100


# --- what is broken on purpose shows


def test_a_wrong_depth_shows() -> None:
    def change(drawn: Visibility, weights: np.ndarray) -> None:
        drawn.depth.view(np.int32)[...] += 3  # type: ignore[union-attr]

    assert 2.4 < judged("ties", "exact", change)["depth_ulp_median"] < 3.6


def test_wrong_weights_show() -> None:
    def change(drawn: Visibility, weights: np.ndarray) -> None:
        weights[...] += np.float32(2 / 1024)

    assert 1.9 < judged("ties", "exact", change)["texels_median"] < 2.1


def test_a_wrong_triangle_shows() -> None:
    def change(drawn: Visibility, weights: np.ndarray) -> None:
        drawn.packed[:64] = (1 << 62) | 5

    found = judged("ties", "exact", change)
    assert found["wrong_ppm"] > 200_000 and found["cracks_ppm"] == 0


def test_wrong_stages_show(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each span loses its last pixel, or gets one more: cracks, or overlaps."""
    original = stages.scanline
    for more, field in ((-1, "cracks_ppm"), (1, "overlaps_ppm")):

        def scanline(*given: object, more: int = more, **named: object) -> np.ndarray:
            spans = original(*given, **named)  # type: ignore[arg-type]
            spans[:, 3] += more
            return spans

        monkeypatch.setattr(errors.stages, "scanline", scanline)
        judge.cache_clear()  # it remembers what a rung's stages gave
        found = judged("ties", "exact")
        assert found[field] > 1000
        assert found["cracks_ppm"] * found["overlaps_ppm"] == 0
    judge.cache_clear()


# --- rows


@needs_ladder
def test_a_row_for_each_rung_the_control_and_the_samples() -> None:
    rungs = ["subpixel4", "depth_stored16", "mask_bounds", "attributes_affine"]
    rows = accuracy.study(accuracy.HARD["floor"](), rungs, accuracy.Setting(), EFFORT)
    by_name = {row.precision: row for row in rows}
    assert list(by_name) == ["exact", accuracy.CONTROL, *rungs, "samples2", "samples3", "samples4"]
    assert [by_name[rung].axis for rung in rungs] == ["coverage", "depth", "mask", "attributes"]
    assert by_name["attributes_affine"].timed == "barycentrics" and by_name["exact"].timed == "rasterize"
    assert by_name["exact"].ratio == 1 and all(row.ms_median > 0 and row.rounds > 2 for row in rows)
    assert by_name["mask_bounds"].tiles > by_name["exact"].tiles > by_name["exact"].empty_tiles
    assert by_name["samples2"].psnr < by_name["samples4"].psnr and by_name[accuracy.CONTROL].wrong_ppm is None


@pytest.mark.skipif(not native.available(), reason="the extension is not built")
def test_times_alone() -> None:
    setting = accuracy.Setting(variant="auto")
    exact, again, other, *_ = accuracy.study(accuracy.HARD["floor"](), ["subpixel4"], setting, EFFORT, with_errors=False)
    assert [exact.precision, again.precision, other.precision] == ["exact", accuracy.CONTROL, "subpixel4"]
    assert other.ratio > 0 and (other.wrong_ppm, other.depth_px, other.psnr) == (None, None, None)


def test_all_rungs_take_one_way_through_a_variant(monkeypatch: pytest.MonkeyPatch) -> None:
    """On CUDA ``exact`` draws small triangles by rows, rungs of the ladder do not: it is compared with them as they are drawn."""
    rows = native.Parameter("rows", "", "", 1, 0, 1, ())
    rung = {"bin_owned": native.Variant("", "", {}), "two_stage": native.Variant("", "", {"rows": rows})}
    monkeypatch.setitem(native.REGISTRY, "cuda", {"exact": rung})
    assert accuracy.parameters_of("cuda", "exact", "two_stage") == {"rows": 0}
    assert accuracy.parameters_of("cuda", "exact", "bin_owned") is accuracy.parameters_of("cuda", "exact", "auto") is None
    assert accuracy.parameters_of("cpu", "exact", "two_stage") is None


def test_axes_of_rungs() -> None:
    assert accuracy.axis_of("exact") == "none" and accuracy.axis_of("depth_reversed") == "depth"
    assert accuracy.timed_of("clip_none") == "rasterize" and accuracy.timed_of("balanced") == "barycentrics"
    assert accuracy.axis_of("fast") == "depth+attributes" and accuracy.timed_of("fast") == "rasterize+barycentrics"


def test_front_of_those_that_none_beats() -> None:
    assert accuracy.front([(1, 5), (2, 2), (3, 3), (2, 2), (0.5, 9), (4, 0)]) == [0, 1, 3, 4, 5]


def test_every_round_calls_each_once_in_an_order_of_its_own() -> None:
    calls: list[str] = []
    ms = clock.interleaved({name: lambda name=name: calls.append(name) for name in "abcd"}, seconds=0, at_least=6)
    rounds = ["".join(calls[k : k + 4]) for k in range(0, len(calls), 4)]
    assert len(rounds) == 7 and all(sorted(one) == list("abcd") for one in rounds) and len(set(rounds)) > 2
    assert {name: len(values) for name, values in ms.items()} == dict.fromkeys("abcd", 6)


def test_cases_have_the_columns_of_the_csv() -> None:
    names = [field.name for field in dataclasses.fields(accuracy.Row)]
    assert {"device", "versions", "commit", "command", "wrong_ppm", "depth_ulp_p99", "texels_max", "psnr"} <= set(names)


@needs_ladder
@pytest.mark.parametrize("rung", breaks.BREAKS)
def test_each_picture_shows_a_break(rung: str) -> None:
    """Its window holds pixels that are marked: the third panel is grey elsewhere."""
    scene, (x0, y0, x1, y1), _, draw = breaks.BREAKS[rung]
    mine, exact, marked = (panel[y0:y1, x0:x1].astype(int) for panel in draw(scene(), rung))
    assert mine.shape == exact.shape == marked.shape == (y1 - y0, x1 - x0, 3)
    assert (np.ptp(marked, axis=2) > 100).any()

"""The map of the work is the reference's, and its sums are the counters."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
import torch
from cases import CASES, Case, from_pixels
from exhaustive import some_of
from numpy.typing import NDArray

import bigtri
from bigtri import native, reference
from bigtri.check import counters
from bigtri.check.work_map import WorkMap, map_work
from bigtri.reference.numerics import BIN, TILE
from bigtri.reference.variants import MODELS
from bigtri.reference.work_map import levels_of

pytestmark = pytest.mark.skipif(not native.available(), reason="the extension is not built")
VARIANTS = native.VARIANTS.get("cpu", ())
COUNTED = [rung for rung, variants in native.REGISTRY.get("cpu", {}).items() if len(variants) > 1]
SOME = some_of(
    ("behind_camera", "layers", "long_slivers"), ("behind_camera", "guard_band", "layers", "long_slivers", "mesh_of_small")
)
IMAGE = NDArray[np.int64]


def make(name: str) -> Case:
    return CASES[name](np.random.default_rng([0, *name.encode()]))


@contextmanager
def threads(count: int) -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def coverage(case: Case) -> IMAGE:
    """How many records cover each pixel, by the reference's spans."""
    records, _ = reference.setup(case.positions, case.triangles, *case.resolution)
    image = np.zeros(case.resolution, np.int64)
    small = np.arange(len(records.xy), dtype=np.int32)
    for _, y, lower, upper in reference.scanline(records, np.zeros((0, 3), np.int32), np.zeros(0, np.int64), small):
        image[y, lower:upper] += 1
    return image


def in_the_last_corner() -> Case:
    """Of a square of 16x16 px around the triangle, a part lies beyond the image's bins."""
    return from_pixels(np.array([[[693, 308], [703, 309], [697, 319]]]), np.full((1, 3), 0.5), (320, 704))


def assert_same(a: WorkMap, b: WorkMap) -> None:
    assert a.counters == b.counters
    assert np.array_equal(a.fragments, b.fragments)
    assert a.edges is not None and b.edges is not None
    for level, (mine, yours) in enumerate(zip(a.edges, b.edges, strict=True)):
        assert np.array_equal(mine, yours), TILE << level
    assert np.array_equal(a.tasks, b.tasks)


@pytest.mark.parametrize("name", [*SOME, "in_the_last_corner"])
@pytest.mark.parametrize("variant", VARIANTS)
def test_the_map_is_the_reference_s(name: str, variant: str) -> None:
    case = in_the_last_corner() if name == "in_the_last_corner" else make(name)
    early = MODELS[variant].REJECTS_BY_DEPTH
    for parameters in ({}, {early: 0}) if early else ({},):
        how = {"variant": variant, "parameters": parameters}
        with threads(1):
            assert_same(*(map_work(*case, **how, backend=backend) for backend in ("native", "reference")))


@pytest.mark.parametrize("variant", VARIANTS)
def test_the_map_with_other_parameters_and_a_scissor(variant: str) -> None:
    case = make("layers")
    own = native.REGISTRY["cpu"]["exact"][variant].parameters.values()
    for p in own:
        how: dict[str, Any] = {"variant": variant, "scissor": (9, 5, 70, 50), "cull": "back", "precision": COUNTED[-1]}
        how["parameters"] = {p.name: p.standard // 2 if p.standard > 1 else p.low if p.low < p.standard else p.high}
        with threads(1):
            assert_same(*(map_work(*case, **how, backend=backend) for backend in ("native", "reference")))


@pytest.mark.parametrize("name", SOME)
@pytest.mark.parametrize("variant", VARIANTS)
def test_the_sums_are_the_counters(name: str, variant: str) -> None:
    case = make(name)
    with threads(1):
        assert map_work(*case, variant=variant).counters == counters.count(*case, variant=variant)
    for count in (1, 3):
        with threads(count):
            work = map_work(*case, variant=variant)
        of = {name: work.counters.get(name, 0) for name in native.COUNTERS}
        assert sum(int(edges.sum()) for edges in work.edges or ()) == of["edges_64"] + of["edges_32"]
        assert work.fragments.sum() == of["fragments"]
        # by_tile() spreads a wide square's integer over its tiles: quotients of float64, and their sum.
        assert work.by_tile().sum() == pytest.approx(of["edges_64"] + of["edges_32"] + of["fragments"], rel=1e-12)
        assert (len(work.tasks), work.tasks.sum(), work.tasks[0]) == (of["tasks"], of["work"], of["most_work"])
        assert (np.diff(work.tasks) <= 0).all()


@pytest.mark.parametrize("name", SOME)
@pytest.mark.parametrize("variant", VARIANTS)
def test_fragments_lie_where_records_cover_pixels(name: str, variant: str) -> None:
    """Without early reject on each pixel that is covered, once for each record; with it on no more, and on all that are seen."""
    case = make(name)
    height, width = case.resolution
    covered = coverage(case)
    seen = bigtri.rasterize(*case, variant=variant).triangle >= 0
    early = MODELS[variant].REJECTS_BY_DEPTH
    for parameters in ({}, {early: 0}) if early else ({},):
        work = map_work(*case, variant=variant, parameters=parameters)
        offered = work.fragments[:height, :width]
        assert (offered <= covered).all() and (offered[seen] > 0).all(), parameters
        if not work.counters.keys() & {"bins_hidden", "tiles_hidden"}:
            assert np.array_equal(offered, covered), parameters


def test_a_wide_square_is_spread_over_its_tiles() -> None:
    """An image of 1x3 bins: its last squares reach beyond them."""
    edges = tuple(np.zeros(shape, np.int64) for shape in levels_of(BIN, 3 * BIN))
    assert [level.shape for level in edges] == [(8, 24), (4, 12), (2, 6), (1, 3), (1, 2), (1, 1)]
    work = WorkMap({}, np.zeros((BIN, 3 * BIN), np.int64), edges, np.zeros(0, np.int64))
    edges[0][2, 3], edges[1][0, 11], edges[4][0, 1], edges[5][0, 0] = 5, 8, 64, 192
    work.fragments[7, 8] = 1
    expected = np.ones((8, 24))
    expected[2, 3] += 5
    expected[0:2, 22:24] += 2
    expected[:, 16:] += 1
    expected[0, 1] += 1
    assert np.array_equal(work.by_tile(), expected)


def test_a_map_of_fragments_alone() -> None:
    """As kernels on CUDA count them."""
    work = WorkMap({}, np.arange(BIN * BIN).reshape(BIN, BIN), None, np.zeros(0, np.int64))
    assert np.array_equal(work.by_tile(), work.fragments.reshape(8, 8, 8, 8).sum(axis=(1, 3)))


def test_an_image_without_triangles() -> None:
    nothing = np.zeros((0, 4), np.float32), np.zeros((0, 3), np.int32), (70, 9)
    for variant in VARIANTS:
        work = map_work(*nothing, variant=variant)
        assert not work.by_tile().any() and len(work.tasks) == 0, variant


@pytest.mark.parametrize(
    ("change", "error", "text"),
    [
        ({"variant": "fast"}, ValueError, "bigtri.map_work: variant must be one of 'batched', "),
        ({"positions": np.zeros((1, 3, 4), np.float32)}, ValueError, r"bigtri.map_work: positions must .*\[V, 4\]"),
        # Without the ladder there is no such rung, and with it no such variant of the rung.
        ({"precision": "depth_stored16"}, (RuntimeError, ValueError), "precision|must be one of 'two_stage', got 'scanline'"),
        ({"parameters": {"speed": 1}}, ValueError, "bigtri.map_work: parameters of variant 'scanline' are share, got 'speed'"),
        ({"triangles": np.full((1, 3), 7000, np.int32)}, RuntimeError, "bigtri.map_work: triangles"),
    ],
)
def test_what_is_wrong_is_named(change: dict[str, Any], error: type[Exception], text: str) -> None:
    case = make("on_bins")
    given = {**case._asdict(), "variant": "scanline", **change}
    with pytest.raises(error, match=text):
        map_work(**given)

"""The map of the work: its sums are the counters; fragments and edge values lie where the reference says that they do."""

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
from bigtri.check import counters, work_map
from bigtri.check.work_map import WorkMap, map_work
from bigtri.precision import RUNGS
from bigtri.reference.numerics import BIN, TILE, TILES
from bigtri.reference.variants import MODELS
from bigtri.reference.work import Job, squares_of

pytestmark = pytest.mark.skipif(not native.available(), reason="the extension is not built")
VARIANTS = native.VARIANTS.get("cpu", ())
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


def job_of(case: Case) -> Job:
    records, _ = reference.setup(case.positions, case.triangles, *case.resolution)
    return Job(case.positions, case.triangles, records, *case.resolution, RUNGS["exact"], {})


def coverage(case: Case) -> IMAGE:
    """How many records cover each pixel, by the reference's spans."""
    job = job_of(case)
    image = np.zeros(case.resolution, np.int64)
    small = np.arange(len(job.records.xy), dtype=np.int32)
    no_queue = np.zeros((0, 3), np.int32), np.zeros(0, np.int64)
    for _, y, lower, upper in reference.scanline(job.records, *no_queue, small, job.arithmetic):
        image[y, lower:upper] += 1
    return image


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
        assert sum(int(edges.sum()) for edges in work.edges) == of["edges_64"] + of["edges_32"]
        assert work.fragments.sum() == of["fragments"]
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


@pytest.mark.parametrize("name", SOME)
@pytest.mark.parametrize("variant", VARIANTS)
def test_tasks_are_the_model_s(name: str, variant: str, monkeypatch: pytest.MonkeyPatch) -> None:
    case = make(name)
    found: list[IMAGE] = []
    real = MODELS[variant].load  # type: ignore[attr-defined]
    monkeypatch.setattr(MODELS[variant], "load", lambda work: found.append(work) or real(work))
    counters.count(*case, variant=variant, backend="reference")
    (expected,) = found
    with threads(1):
        tasks = map_work(*case, variant=variant).tasks
    assert tasks.tolist() == sorted(expected[expected > 0].tolist(), reverse=True)


def edges_of(case: Case, variant: str) -> dict[int, IMAGE]:
    """What is computed for squares of 8 to 128 px, by their size, of variants that leave nothing out."""
    job = job_of(case)
    rows, columns = (-(-size // BIN) for size in case.resolution)
    expected = {TILE << k: np.zeros([-(-n * BIN // (TILE << k)) for n in (rows, columns)], np.int64) for k in range(5)}
    if variant in ("batched", "scanline"):
        for x0, y0, x1, y1 in job.records.bbox:
            if variant == "scanline":
                np.add.at(expected[TILE], (np.arange(y0, y1) // TILE, x0 // TILE), 3)
            else:
                y, x = np.mgrid[y0:y1, x0:x1]
                np.add.at(expected[TILE], (y // TILE, x // TILE), 3)
        return expected
    of_bin = {"two_stage": 6, "tile_queues": 0}.get(variant, 3 + 6 * TILES * TILES)
    of_boxed, of_touched = {"two_stage": (3, 3 + 3 * TILE * TILE), "tile_queues": (3, 3)}.get(variant, (0, 0))
    of_partly = 0 if variant == "two_stage" else 3 * TILE * TILE
    wide = 2 * BIN if variant == "tile_queues" else BIN
    candidates, _ = squares_of(job, wide)
    np.add.at(expected[wide], (candidates[:, 2], candidates[:, 1]), 3)
    bins = reference.binning(job.records, -1, job.arithmetic)
    queue = bins.candidates[bins.kept]
    np.add.at(expected[BIN], (queue[:, 2], queue[:, 1]), of_bin)
    for (record, column, row), touched, full in zip(queue, *reference.tile_mask(job.records, queue, job.arithmetic), strict=True):
        x0, y0, x1, y1 = job.records.bbox[record]
        for t in range(TILES * TILES):
            x, y = TILES * column + t % TILES, TILES * row + t // TILES
            if variant != "tile_queues" and x0 < TILE * (x + 1) and TILE * x < x1 and y0 < TILE * (y + 1) and TILE * y < y1:
                expected[TILE][y, x] += of_boxed
            if touched >> t & 1:
                expected[TILE][y, x] += of_touched + (0 if full >> t & 1 else of_partly)
    if variant == "tile_queues":  # its wide bins are kept more often than the narrow ones in them
        for record, column, row in candidates[squares_of(job, wide)[1]]:
            x0, y0, x1, y1 = job.records.bbox[record]
            y, x = np.mgrid[max(y0, wide * row) // TILE : (min(y1, wide * (row + 1)) - 1) // TILE + 1,
                            max(x0, wide * column) // TILE : (min(x1, wide * (column + 1)) - 1) // TILE + 1]  # fmt: skip
            expected[TILE][y, x] += of_boxed
    return expected


PLACED = ("batched", "scanline", "two_stage", "persistent", "coverage_masks", "tile_queues")


@pytest.mark.parametrize("name", SOME)
@pytest.mark.parametrize("variant", PLACED)
def test_edge_values_lie_where_they_are_due(name: str, variant: str) -> None:
    case = make(name)
    work = map_work(*case, variant=variant)
    expected = edges_of(case, variant)
    for level, edges in enumerate(work.edges):
        wanted = expected.pop(TILE << level, np.zeros_like(edges))
        assert np.array_equal(edges, wanted), TILE << level
    assert not any(rest.sum() for rest in expected.values())


@pytest.mark.parametrize("place", [(200, 140), (693, 308)], ids=["in_the_middle", "in_the_last_corner"])
@pytest.mark.parametrize("variant", [v for v in VARIANTS if v not in PLACED])
def test_no_edge_value_lies_far_from_a_record(variant: str, place: tuple[int, int]) -> None:
    """Of one small triangle in a large image all lie in its bin, or in larger squares that hold it."""
    corners = np.array([[[0, 0], [10, 1], [4, 11]]]) + place
    case = from_pixels(corners, np.full((1, 3), 0.5), (320, 704))
    work = map_work(*case, variant=variant)
    assert sum(int(edges.sum()) for edges in work.edges) > 0
    bin_x, bin_y = (BIN * (at // BIN) + BIN / 2 for at in place)
    for level, edges in enumerate(work.edges):
        size = TILE << level
        y, x = np.nonzero(edges)
        assert (np.abs(size * x + size / 2 - bin_x) < (BIN + size) / 2).all(), size
        assert (np.abs(size * y + size / 2 - bin_y) < (BIN + size) / 2).all(), size


def test_a_wide_square_is_spread_over_its_tiles() -> None:
    """An image of 1x3 bins: its last squares reach beyond them."""
    edges = tuple(np.zeros(shape, np.int64) for shape in work_map._levels(BIN, 3 * BIN))
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


def test_an_image_without_triangles() -> None:
    nothing = np.zeros((0, 4), np.float32), np.zeros((0, 3), np.int32), (70, 9)
    for variant in VARIANTS:
        work = map_work(*nothing, variant=variant)
        assert not work.by_tile().any() and len(work.tasks) == 0, variant


@pytest.mark.parametrize(
    ("change", "error", "text"),
    [
        ({"variant": "fast"}, ValueError, "bigtri.map_work: variant must be one of 'bin_owned', "),
        ({"positions": np.zeros((1, 3, 4), np.float32)}, ValueError, r"bigtri.map_work: positions must .*\[V, 4\]"),
        ({"precision": "depth_stored16"}, (RuntimeError, ValueError), "precision"),
        ({"parameters": {"speed": 1}}, ValueError, "bigtri.map_work: parameters of variant 'scanline' are share, got 'speed'"),
        ({"triangles": np.full((1, 3), 7000, np.int32)}, RuntimeError, "bigtri.map_work: triangles"),
    ],
)
def test_what_is_wrong_is_named(change: dict[str, Any], error: type[Exception], text: str) -> None:
    case = make("on_bins")
    given = {**case._asdict(), "variant": "scanline", **change}
    with pytest.raises(error, match=text):
        map_work(**given)

"""Every rung in bits, every counter against the reference, views drawn together, and what the registry says of parameters."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from cases import CASES, Case, from_pixels
from counting import on_grid, soup
from operators import call

import bigtri
from bigtri import native, reference
from bigtri.check import counters, stages
from bigtri.check.work_map import map_work
from bigtri.precision import PRECISIONS, RUNGS
from bigtri.reference import work
from bigtri.reference.variants import MODELS, Model

pytestmark = pytest.mark.skipif(not native.available(), reason="the extension is not built")
CSRC = Path(bigtri.__file__).parent / "csrc"
FEW = ("behind_camera", "guard_band", "clipped_fans", "layers", "long_slivers", "mesh_of_small", "small_on_cells", "on_bins")
VARIANTS = native.VARIANTS.get("cpu", ())
COMPILED = tuple(native.REGISTRY.get("cpu", ()))
COUNTED = tuple(name for name in COMPILED if len(native.REGISTRY["cpu"][name]) > 1)
# What the rungs share is the same source: the cases in which depths, clipping and thin records show are enough for the others.
LADDER_CASES = ("behind_camera", "clipped_fans", "guard_band", "long_slivers", "on_bins", "on_centres", "on_planes")
STAGED = tuple(name for name in COMPILED if RUNGS[name].has_stages)  # have their stages one by one
RUNG_AND_CASE = [(rung, name) for rung in COMPILED[1:] for name in (CASES if rung in COUNTED else LADDER_CASES)]


@pytest.fixture(scope="module", autouse=True)
def counted_once() -> Iterator[None]:
    """What a model counts of a view depends on the scene, the variant and its parameters alone, and how many fragments pass on
    the records and their order: views that are drawn again, and variants of the same scene, are told what was counted then."""
    views: dict[tuple, Any] = {}
    passed: dict[tuple, int] = {}

    def once(kept: dict[tuple, Any], key: tuple, count: Callable[[], Any]) -> Any:
        if key not in kept:
            kept[key] = count()
            if len(kept) > 16:
                kept.pop(next(iter(kept)))
        return kept[key]

    def modelled(op: str, scene: counters.Scene, variant: str, parameters: dict[str, int] | None) -> Any:
        key = scene.clip.numpy().tobytes(), scene.faces.numpy().tobytes(), *scene[2:], variant, str(parameters)
        return once(views, key, lambda: count_view(op, scene, variant, parameters))

    def passing(job: work.Job) -> int:
        records = (None if field is None else field.tobytes() for field in job.records)
        return once(passed, (*records, job.height, job.width, job.arithmetic), lambda: count_passing(job))

    count_view, count_passing = counters.modelled, work.passing
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(counters, "modelled", modelled)
        for model in MODELS.values():
            patch.setattr(model, "passing", passing, raising=False)
        yield


def make(name: str) -> Case:
    return CASES[name](np.random.default_rng([0, *name.encode()]))


def same(a: bigtri.Visibility, b: bigtri.Visibility) -> bool:
    assert a.depth is not None and b.depth is not None
    bits = [np.asarray(v.depth).view(np.int32) for v in (a, b)]
    return np.array_equal(a.packed, b.packed) and np.array_equal(*bits) and np.array_equal(a.dropped, b.dropped)


@pytest.mark.skipif(not CSRC.exists(), reason="the sources are not here")
def test_the_rungs_are_those_of_the_header() -> None:
    text = (CSRC / "core/precision.h").read_text()
    constants: dict[str, dict[str, str]] = {}
    for name, base, body in re.findall(r"struct (\w+)(?: : (\w+))? \{\n(.*?)\n\};", text, re.S):
        own = re.findall(r"static constexpr \w+ (\w+) = (?:\w+::)?(\w+);", body)
        constants[name] = {**constants.get(base, {}), **dict(own)}
    for name, rung in RUNGS.items():
        assert constants[name]["kSubpixelBits"] == str(rung.subpixel_bits), name
        fixed = rung.precision.coverage.startswith("fixed")
        coverage = "kFixed" if fixed else "k" + rung.precision.coverage.title().replace("_", "")
        assert constants[name]["kCoverage"] == coverage, name
        wide = rung.subpixel_bits > 8 or rung.precision.coverage == "fixed8_int64"
        assert constants[name]["kWideEdges"] == ("true" if wide else "false"), name
        assert constants[name]["kWraps"] == ("true" if rung.wraps else "false"), name
        assert constants[name]["kMask"] == "k" + rung.precision.mask.title().replace("_", ""), name
        for constant, choice in (("kClip", rung.precision.clip), ("kAttributes", rung.precision.attributes)):
            assert constants[name][constant] == "k" + choice.title(), name
        assert constants[name]["kDepth"] == "k" + rung.precision.depth.title().replace("_", ""), name
    listed = [re.findall(r"X\((\w+)\)", text.partition(f"#define {lists}(X)")[2]) for lists in ("BIGTRI_RUNGS", "BIGTRI_LADDER")]
    assert tuple(listed[0]) == PRECISIONS, "BIGTRI_RUNGS, and then BIGTRI_LADDER, in the order of RUNGS"
    on_cuda = re.findall(r"#define BIGTRI_CUDA_VARIANTS_(\w+)\(X\)", (CSRC / "cuda/variants.h").read_text())
    assert on_cuda == [*PRECISIONS], "csrc/cuda/variants.h lists every rung"


@pytest.mark.skipif(not CSRC.exists(), reason="the sources are not here")
def test_the_variants_are_those_of_the_header() -> None:
    """A variant is copied from another one, whose name it may have kept; it would hide that one, or be hidden by it."""
    lists = re.findall(r"#define BIGTRI_CPU_VARIANTS_(\w+)\(X\)((?:.*\\\n)*.*)", (CSRC / "cpu/variants.h").read_text())
    assert tuple(rung for rung, _ in lists) == PRECISIONS
    for rung, names in lists:
        if rung in COMPILED:
            assert [*native.REGISTRY["cpu"][rung]] == re.findall(r"X\((\w+)\)", names), rung
    assert {*MODELS} == {*VARIANTS}, "bigtri/reference/variants has one file per variant of the CPU"
    for name, model in MODELS.items():
        parameters = native.REGISTRY["cpu"]["exact"][name].parameters.values()
        assert {p.name: p.standard for p in parameters} == model.STANDARD, name


@pytest.mark.parametrize(("precision", "name"), RUNG_AND_CASE)
def test_every_rung_has_its_reference_s_bits(name: str, precision: str) -> None:
    case = make(name)
    wanted = bigtri.rasterize(*case, precision=precision, backend="reference")
    for isa in native.isa_levels():
        for variant in native.REGISTRY["cpu"][precision]:
            with native.using_isa(isa):
                seen = bigtri.rasterize(*case, precision=precision, variant=variant, backend="native")
            assert same(seen, wanted), (isa, variant)


@pytest.mark.parametrize(("precision", "name"), [(r, n) for r in STAGED for n in (FEW if r in COUNTED else FEW[:3])])
def test_stages_and_attributes_of_a_rung(name: str, precision: str) -> None:
    positions, triangles, (height, width) = make(name)
    colors = np.random.default_rng(0).random((len(positions), 3), np.float32)
    found = []
    for backend in ("reference", "native"):
        how = {"backend": backend, "precision": precision}
        records, dropped = stages.setup(positions, triangles, height, width, **how)
        bins = stages.binning(records, 64, **how)
        queue = bins.candidates[bins.kept]
        touched, full = stages.tile_mask(records, queue, **how)
        spans = stages.scanline(records, queue, touched, bins.small, **how)
        depth = stages.depth(records, spans, **how)
        seen = bigtri.rasterize(positions, triangles, (height, width), **how)
        values = bigtri.interpolate(colors, seen, positions, triangles, **how)
        weights = bigtri.barycentrics(seen, positions, triangles, **how)
        found.append((*records, dropped, *bins, touched, full, spans, depth, seen.packed, values, weights))
    for a, b in zip(*found, strict=True):
        a, b = np.asarray(a), np.asarray(b)
        assert a.dtype == b.dtype or a.ndim == 0
        assert a.tobytes() == b.tobytes() if a.ndim else a == b


@pytest.mark.parametrize("precision", [name for name in COMPILED if name not in STAGED])
@pytest.mark.parametrize("name", FEW[:4])
def test_attributes_of_a_rung_without_stages(name: str, precision: str) -> None:
    positions, triangles, resolution = make(name)
    colors = np.random.default_rng(0).random((len(positions), 3), np.float32)
    seen = bigtri.rasterize(positions, triangles, resolution, precision=precision)
    for draw in (bigtri.barycentrics, lambda *given, **how: bigtri.interpolate(colors, *given, **how)):
        images = [draw(seen, positions, triangles, precision=precision, backend=b) for b in ("reference", "native")]
        assert np.asarray(images[0]).tobytes() == np.asarray(images[1]).tobytes()
    with pytest.raises(ValueError, match=f"bigtri.setup: backend must be 'reference' with precision '{precision}'"):
        stages.setup(positions, triangles, *resolution, backend="native", precision=precision)
    with pytest.raises(
        RuntimeError, match="bigtri::setup: precision must be one whose records and spans hold all that coverage needs"
    ):
        torch.ops.bigtri.setup(
            *map(torch.from_numpy, (positions, triangles)), *resolution, cull="none", scissor=[0, 0, 1, 1], precision=precision
        )


def batch_of(case: Case) -> torch.Tensor:
    """Views that touch different parts of the image, all of it, and none of it."""
    moved = [case.positions, case.positions * np.float32([0.5, -1, 1, 1]), np.full_like(case.positions, 9), case.positions[::-1]]
    return torch.from_numpy(np.stack([*moved, np.full_like(case.positions, 9), case.positions]))


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("name", FEW)
@pytest.mark.filterwarnings("ignore:invalid value")
def test_views_drawn_together_are_those_drawn_alone(name: str, variant: str) -> None:
    case = make(name)
    views, triangles = batch_of(case), torch.from_numpy(case.triangles)
    alone = [bigtri.rasterize(view, triangles, case.resolution, backend="native") for view in views]
    own = native.REGISTRY["cpu"]["exact"][variant].parameters.values()
    for parameters in (
        {},
        {p.name: p.low for p in own},
        {p.name: p.low + 40 for p in own if not p.only and p.low + 40 <= p.high},
    ):
        seen = bigtri.rasterize(views, triangles, case.resolution, variant=variant, parameters=parameters)
        for b, one in enumerate(alone):
            assert same(bigtri.Visibility(*(field[b] for field in seen)), one), (parameters, b)


@contextmanager
def threads(count: int) -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def assert_within_bounds(counts: dict[str, int], serial: dict[str, int], covered: int, model: Model) -> None:
    """What holds of a parallel run, whatever the order.

    What depends on nothing is what the reference has. So is what a depth test spares, if the variant has none whose order
    threads decide. Of an order: a pixel that is covered in the end was nearer than the background once, so it passed and was
    written; what is written was nearer than what the pixel held; and what passes was offered.
    """
    of = {name: counts.get(name, 0) for name in native.COUNTERS}
    for name, counter in native.COUNTERS.items():
        if counter.depends == "nothing" or (counter.depends in ("spared", "most") and not model.REJECTS_BY_DEPTH):
            assert of[name] == serial.get(name, 0), name
    assert covered <= of["passed"] <= of["fragments"]
    assert covered <= of["written"]
    if not model.OWNS_PIXELS:
        assert of["written"] <= of["passed"] and of["written"] <= of["atomics"]
    assert of["tasks"] <= of["work"] <= of["most_work"] * of["tasks"]
    assert 1 <= counters.load(counts) <= of["tasks"]


# Rungs share the code that counts; exact's draws balanced.
PATHS = ("by_rows", "by_tiles", "within_16", "within_4")  # every record takes one of them
COUNTED_CASES = [(rung, name) for rung in COUNTED if rung != "balanced" for name in (FEW if rung == "exact" else FEW[:2])]


# The mark that stands first varies fastest: fragments that pass are counted for all variants of a scene together.
@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize(("precision", "name"), COUNTED_CASES)
@pytest.mark.filterwarnings("ignore:invalid value")
def test_counters_are_the_reference_s(name: str, variant: str, precision: str) -> None:
    case = make(name)
    given = batch_of(case), case.triangles, case.resolution
    how = {"variant": variant, "precision": precision}
    expected = counters.count(*given, **how, backend="reference")
    with threads(1):
        assert counters.count(*given, **how, backend="native") == expected
    assert expected["records"] == sum(expected.get(path, 0) for path in PATHS)
    covered = int((bigtri.rasterize(*given, precision=precision).triangle >= 0).sum())
    model = MODELS[variant]
    most = {}
    if model.REJECTS_BY_DEPTH:
        most = counters.count(*given, **how, backend="reference", parameters={model.REJECTS_BY_DEPTH: 0})
    for count in (2, 5):
        with threads(count):
            counts = counters.count(*given, **how, backend="native")
        assert_within_bounds(counts, expected, covered, model)
        for counter in (name for name in most if native.COUNTERS[name].depends in ("spared", "most")):
            assert counts.get(counter, 0) <= most[counter], counter


@pytest.mark.parametrize("variant", VARIANTS)
def test_counters_of_other_parameters_are_the_reference_s(variant: str) -> None:
    case = make("layers")
    for p in native.REGISTRY["cpu"]["exact"][variant].parameters.values():
        other = p.standard // 2 if p.standard > 1 else p.low if p.low < p.standard else p.high
        how = {"variant": variant, "parameters": {p.name: other}}
        with threads(1):
            both = [counters.count(*case, **how, backend=b) for b in ("reference", "native")]
        assert both[0] == both[1], p.name


@pytest.mark.parametrize("scissor", [None, (5, 6, 18, 9), (5, 6, 7, 8)])
@pytest.mark.parametrize("size", [300, 1500])
def test_tiny_triangles_that_cover_nothing_have_no_record(size: int, scissor: tuple[int, int, int, int] | None) -> None:
    """Of boxes of one and two columns and rows, also of triangles that the scissor cuts, tiny ones and others."""
    rng = np.random.default_rng(size)
    xy = rng.integers(0, (40 * 256, 24 * 256), (600, 1, 2)) + rng.integers(-size, size + 1, (600, 3, 2))
    mesh = soup(on_grid(xy, rng.uniform(0.1, 0.9, (600, 3)), (24, 40)).astype(np.float32))
    given = Case(*mesh, (24, 40))
    with threads(1):  # the order of fragments counts
        count, model = (counters.count(*given, variant="scanline", scissor=scissor, backend=b) for b in ("native", "reference"))
    records, _ = reference.setup(*mesh, 24, 40, "none", scissor)
    assert count == model and count["records"] > 0
    assert count["records"] < len(records.xy) or size > 300


HAVE = {name: [v for v in VARIANTS if name in native.REGISTRY["cpu"]["exact"][v].parameters] for name in ("room", "share")}


def one_bin_of_many() -> Case:
    """3000 triangles in a corner of an image, more than any queue's first segment holds; some reach over the whole image."""
    rng = np.random.default_rng(7)
    corners = rng.uniform(0, 60, (3000, 1, 2)) + rng.uniform(-9, 9, (3000, 3, 2))
    corners[::50] = rng.uniform(-20, 180, (60, 3, 2))
    return from_pixels(corners, rng.uniform(0, 1, (3000, 3)), (96, 150))


@pytest.mark.parametrize("variant", HAVE["room"])
def test_queues_lose_nothing_that_comes_after_they_are_full(variant: str) -> None:
    case = one_bin_of_many()
    wanted = bigtri.rasterize(*case, backend="reference")
    standard = native.REGISTRY["cpu"]["exact"][variant].parameters["room"].standard
    for room in (standard, 1, 7):
        how = {"variant": variant, "parameters": {"room": room}}
        with threads(1):
            both = [counters.count(*case, **how, backend=b) for b in ("reference", "native")]
        assert both[0] == both[1]
        assert room == 0 or both[0]["overflows"] > 3000 - 2 * standard, "0 is room enough, chosen by itself"
        for count in (1, 5):
            with threads(count):
                assert same(bigtri.rasterize(*case, **how, backend="native"), wanted), (room, count)


@pytest.mark.parametrize("variant", HAVE["share"])
def test_more_shares_than_are_set_up_at_once(variant: str) -> None:
    """Each later round goes on from the pixels of the earlier ones."""
    case = one_bin_of_many()
    wanted = bigtri.rasterize(*case, backend="reference")
    views = torch.from_numpy(np.stack([case.positions, case.positions * np.float32([1, -1, 1, 1])]))
    turned = bigtri.rasterize(views[1], torch.from_numpy(case.triangles), case.resolution, backend="reference")
    for share in (1, 2, 3):
        how = {"variant": variant, "parameters": {"share": share}}
        assert same(bigtri.rasterize(*case, **how, backend="native"), wanted), share
        seen = bigtri.rasterize(views, torch.from_numpy(case.triangles), case.resolution, **how)
        assert all(same(bigtri.Visibility(*(field[b] for field in seen)), one) for b, one in enumerate((wanted, turned))), share
    if MODELS[variant].OWNS_PIXELS:
        with pytest.raises(ValueError, match="what 1024 shares make; with parameter share = 2 this view has 1500"):
            counters.count(*case, variant=variant, parameters={"share": 2}, backend="reference")


def test_the_load_is_the_most_over_the_mean() -> None:
    assert counters.load({"tasks": 4, "work": 100, "most_work": 50}) == 2
    assert counters.load({}) == 0
    with pytest.raises(ValueError, match=r"bigtri.count: parameters of variant 'scanline' are share, got 'speed'"):
        counters.count(*make("on_bins"), variant="scanline", backend="reference", parameters={"speed": 1})
    with pytest.raises(ValueError, match="in one pass; with parameter records = 3 this view takes more, since it needs"):
        counters.count(*make("layers"), variant="bin_owned", backend="reference", parameters={"records": 3})


def test_parameters_are_checked_by_name() -> None:
    case = make("on_bins")
    with pytest.raises(ValueError, match=r"parameters of variant 'bin_owned' are records, candidates, got 'speed'"):
        bigtri.rasterize(*case, parameters={"speed": 1})
    # An entry of a bin's list has 30 bits for its record, and a list begins at a place of 32 bits.
    for name, most in (("records", 2**30), ("candidates", 2**32 - 1)):
        for wrong in (0, most + 1, -1, True, 1.0):
            with pytest.raises(ValueError, match=rf"parameter {name} of variant 'bin_owned' must be 1 to {most}, got {wrong}"):
                bigtri.rasterize(*case, parameters={name: wrong})
        with (
            pytest.raises(ValueError, match=f"using_parameters: {name} must be 1 to {most}"),
            native.using_parameters(**{name: most + 1}),
        ):
            pass
    with pytest.raises(ValueError, match="parameters must be None with the reference"):
        bigtri.rasterize(*case, backend="reference", parameters={"records": 1})
    with pytest.raises(TypeError, match="using_parameters: parameters are .*, got speed"), native.using_parameters(speed=1):
        pass


def test_what_nothing_serves_yet_is_refused_by_name() -> None:
    case = make("on_bins")
    height, width = case.resolution
    packed = torch.empty(1, height, width, dtype=torch.int64)
    for name, samples, behind in (("samples", 4, None), ("behind", 1, packed)):
        mesh = torch.from_numpy(case.positions)[None], torch.from_numpy(case.triangles)
        values = (*mesh, height, width, "none", [0, 0, width, height])
        outputs = (packed, None, torch.empty(1, dtype=torch.int64), None)
        with pytest.raises(RuntimeError, match=f"bigtri::rasterize: {name} must be"):
            call("rasterize", (*values, "bin_owned", "exact", samples, [], None, behind, *outputs))


@pytest.mark.parametrize("ask", [counters.count, map_work])
def test_counting_on_cuda_needs_a_device(ask: Callable[..., Any]) -> None:
    mesh = np.zeros((3, 4), np.float32), np.array([[0, 1, 2]], np.int32), (8, 8)
    with pytest.raises(ValueError, match="device must be one of 'cpu', 'cuda', got 'gpu'"):
        ask(*mesh, variant="scanline", device="gpu")
    if "cuda" not in native.devices():
        with pytest.raises(RuntimeError, match="device='cuda' needs a CUDA device"):
            ask(*mesh, variant="scanline", device="cuda", backend="native")

"""The extension against the reference, in bits: stage by stage, on every instruction set, at one and many threads."""

from __future__ import annotations

import functools
import importlib
from itertools import product

import numpy as np
import pytest
import torch
from cases import CASES, Case
from exhaustive import some_of
from test_reference_stages import corners_of_almost_none

import bigtri
from bigtri import native
from bigtri.check import sentences, stages, verify
from bigtri.ops.rasterize import CULLS
from bigtri.reference.records import Bins, Records

pytestmark = pytest.mark.skipif(not native.available(), reason="the extension is not built")


# On every instruction set. The mark that stands first varies fastest, so that one picture of the reference serves them all.
EVERY_ISA = pytest.mark.parametrize("isa", native.isa_levels(), indirect=True)


@pytest.fixture
def isa(request):
    with native.using_isa(request.param):
        yield request.param


@pytest.fixture(scope="module", autouse=True)
def reference_once():
    """What ``verify`` asks of the reference depends on the scene and the threshold alone, so the last ones' answers are kept."""
    ask = verify._Run._on_backend
    kept: dict[tuple, dict[str, list]] = {}

    def remember(run, stage, given, backend):
        if backend != "reference":
            return ask(run, stage, given, backend)
        scene = (run.positions.tobytes(), run.triangles.tobytes(), *run[2:6], run.precision, run.threshold)
        answers = kept[scene] = kept.pop(scene, {})
        if len(kept) > 4:
            kept.pop(next(iter(kept)))
        if stage not in answers:
            answers[stage] = ask(run, stage, given, backend)
        return answers[stage]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(verify._Run, "_on_backend", remember)
        yield


@pytest.fixture(params=[1, 2, 5])
def threads(request):
    before = torch.get_num_threads()
    torch.set_num_threads(request.param)
    yield request.param
    torch.set_num_threads(before)


def make(name: str, seed: int = 0) -> Case:
    return CASES[name](np.random.default_rng([seed, *name.encode()]))


@functools.lru_cache(maxsize=8)
def drawn_by_the_reference(name: str, scissor: tuple[int, int, int, int] | None = None) -> np.ndarray:
    return bigtri.rasterize(*make(name), backend="reference", scissor=scissor).packed


@functools.lru_cache(maxsize=1)
def listed_by_the_reference(name: str) -> tuple[Records, Bins, np.ndarray, np.ndarray]:
    """What setup and binning give, the masks of touched tiles, and the spans."""
    positions, triangles, (height, width) = make(name)
    records, _ = stages.setup(positions, triangles, height, width, backend="reference")
    bins = stages.binning(records, 64, backend="reference")
    touched, _ = stages.tile_mask(records, bins.candidates[bins.kept], backend="reference")
    spans = stages.scanline(records, bins.candidates[bins.kept], touched, bins.small, backend="reference")
    return records, bins, touched, spans


def assert_same_image(expected: np.ndarray, got: np.ndarray) -> None:
    """As ``verify.compare`` says it, for images that come from elsewhere."""
    if (difference := next(sentences.packed("rasterize", expected, got), None)) is not None:
        pytest.fail(str(difference))


def assert_same_depth(records: Records, spans: np.ndarray) -> None:
    """The depth stage by itself, of records that no setup makes."""
    expected, got = (stages.depth(records, spans, backend=backend) for backend in ("reference", "native"))
    assert not np.signbit(expected).any()
    if (difference := next(sentences.depth(records, spans, expected, got), None)) is not None:
        pytest.fail(str(difference))


@EVERY_ISA
@pytest.mark.parametrize("name", CASES)
def test_every_stage_has_the_reference_bits(name, isa):
    case = make(name)
    threshold = 4000 if case.resolution[0] * case.resolution[1] > 10**6 else 64
    for variant in native.VARIANTS["cpu"]:
        assert (difference := verify.compare(*case, variant=variant, threshold=threshold)) is None, str(difference)


@EVERY_ISA
@pytest.mark.parametrize("name", CASES)
def test_the_extension_lists_in_the_order_of_the_reference(name, isa):
    """What docs/architecture.md says of the outputs of its stages, beyond what ``verify`` asks of a stage."""
    records, bins, touched, spans = listed_by_the_reference(name)
    got = stages.binning(records, 64, backend="native")
    for field, expected, listed in zip(bins._fields, bins, got, strict=True):
        assert np.array_equal(expected, listed), f"stage binning, {field} in another order"
    got = stages.scanline(records, bins.candidates[bins.kept], touched, bins.small, backend="native")
    assert np.array_equal(spans, got), "stage scanline, spans in another order or cut in another way"


# Culling leaves records out, and all of them are compared where nothing is culled: one seed each is enough for it.
SEEDS_AND_CULLS = some_of([*((seed, "none") for seed in range(1, 6)), (1, "back"), (2, "front")], [*product(range(1, 6), CULLS)])


@pytest.mark.parametrize("seed_and_cull", SEEDS_AND_CULLS, ids=str)
@pytest.mark.parametrize("name", [name for name in CASES if not name.startswith("size")])
def test_more_seeds(name, seed_and_cull):
    seed, cull = seed_and_cull
    assert (difference := verify.compare(*make(name, seed), cull=cull, threshold=1000)) is None, str(difference)


@EVERY_ISA
@pytest.mark.parametrize("name", ["screen_size", "many_small", "layers", "behind_camera"])
@pytest.mark.parametrize("variant", native.VARIANTS.get("cpu", ()))
def test_variants_threads_and_instruction_sets_change_no_bit(variant, name, isa, threads):
    case = make(name)
    for _ in range(3):
        got = bigtri.rasterize(*case, backend="native", variant=variant)
        assert_same_image(drawn_by_the_reference(name), got.packed)


@EVERY_ISA
@pytest.mark.parametrize("scissor", [(0, 0, 100, 100), (33, 17, 130, 90), (64, 64, 128, 128), (50, 50, 51, 51), (70, 20, 70, 90)])
def test_scissor_is_a_crop(scissor, isa):
    for name in ("screen_size", "many_small", "corner_of_huge", "slivers"):
        assert (difference := verify.compare(*make(name), scissor=scissor)) is None, str(difference)
    case = make("screen_size")
    whole = drawn_by_the_reference("screen_size")
    x0, y0, x1, y1 = scissor
    expected = np.full_like(whole, 2**63 - 1)
    expected[y0:y1, x0:x1] = whole[y0:y1, x0:x1]
    assert np.array_equal(drawn_by_the_reference("screen_size", scissor), expected)
    assert np.array_equal(bigtri.rasterize(*case, backend="native", scissor=scissor).packed, expected)


@EVERY_ISA
def test_nothing_is_written_outside_the_image(isa):
    """Partial bins at the right and lower edge, between guard words."""
    case = make("size_63x63")
    expected = bigtri.rasterize(*case, backend="reference").packed
    memory = torch.full((3, 63, 63), 0x5555, dtype=torch.int64)
    positions, triangles = torch.from_numpy(case.positions), torch.from_numpy(case.triangles)
    bigtri.rasterize(positions, triangles, case.resolution, backend="native", out=memory[1])
    assert_same_image(expected, memory[1].numpy())
    assert (memory[0] == 0x5555).all() and (memory[2] == 0x5555).all()


def test_many_passes():
    """More clipped triangles than one batch holds: later passes take up what earlier ones drew."""
    rng = np.random.default_rng(5)
    corners = rng.normal(0, 200, (40_000, 3, 4)) + [0, 0, 0, 1]
    corners[..., 3] = np.abs(corners[..., 3])
    corners[20_000:, :, :2] = corners[20_000:, :1, :2] + rng.normal(0, 3, (20_000, 3, 2))
    corners[..., 2] = rng.uniform(-2, 2, (40_000, 3)) * corners[..., 3]
    positions = corners.reshape(-1, 4).astype(np.float32)
    triangles = np.arange(len(positions), dtype=np.int32).reshape(-1, 3)
    a, b = (bigtri.rasterize(positions, triangles, (70, 130), backend=backend) for backend in ("reference", "native"))
    assert_same_image(a.packed, b.packed)


@EVERY_ISA
@pytest.mark.parametrize("values", [(0, 1e-45), (-0.0, 1e-45, 1e-42), (0, -0.0), (1e-38, 3e-39)])
def test_depths_that_vanish(values, isa):
    """Sums below the smallest float32 round to -0, whose bits would be the farthest of all: depth is never -0."""
    case = make("screen_size")
    records, _ = stages.setup(*case[:2], *case.resolution, backend="reference")
    records = records._replace(z=np.random.default_rng(1).choice(np.array(values, np.float32), records.z.shape))
    spans = stages.scanline(records, np.zeros((0, 3), np.int32), np.zeros(0, np.int64), np.arange(len(records.z), dtype=np.int32))
    assert_same_depth(records, spans)


@EVERY_ISA
@pytest.mark.parametrize("size", [300, 30000])
def test_depths_that_show_every_rounding(size, isa):
    records, _, spans = corners_of_almost_none(size)
    assert_same_depth(records, spans)


def test_flush_to_zero_of_the_caller_changes_nothing():
    """Denormal depths survive a thread that flushes them."""
    corners = np.array([[[-1, -1, -1, 1], [3, -1, -1, 1], [-1, 3, -1, 1]]], np.float64)
    corners[0, :, 2] = [-1, -1 + 2.0**-24, -1]
    positions = (corners * 1e-38).astype(np.float32).reshape(-1, 4)
    triangles = np.array([[0, 1, 2]], np.int32)
    expected = bigtri.rasterize(positions, triangles, (33, 40), backend="reference")
    assert (expected.triangle == 0).any()
    if not torch.set_flush_denormal(True):
        pytest.skip("this processor cannot flush denormals")
    try:
        got = bigtri.rasterize(positions, triangles, (33, 40), backend="native")
    finally:
        torch.set_flush_denormal(False)
    assert_same_image(expected.packed, got.packed)


def test_flush_to_zero_of_the_caller_does_not_reach_the_depth_stage():
    case = make("screen_size")
    records, _ = stages.setup(*case[:2], *case.resolution, backend="reference")
    records = records._replace(z=np.random.default_rng(2).uniform(1e-42, 1e-38, records.z.shape).astype(np.float32))
    spans = stages.scanline(records, np.zeros((0, 3), np.int32), np.zeros(0, np.int64), np.arange(len(records.z), dtype=np.int32))
    expected = stages.depth(records, spans, backend="reference")
    assert ((expected > 0) & (expected < np.finfo(np.float32).tiny)).any()
    if not torch.set_flush_denormal(True):
        pytest.skip("this processor cannot flush denormals")
    try:
        got = stages.depth(records, spans, backend="native")
    finally:
        torch.set_flush_denormal(False)
    assert expected.tobytes() == got.tobytes()


def test_a_difference_is_named(monkeypatch):
    """One flipped bit in the output of any operator is reported with its stage, bin, tile and pixel."""
    case = make("on_bins")
    real = torch.ops.bigtri

    class Flipped:
        def __init__(self, op: str, output: int, bit: int) -> None:
            self.op, self.output, self.bit = op, output, bit

        def __getattr__(self, name: str):
            if name not in (self.op, f"{self.op}_new"):
                return getattr(real, name)

            def call(*arguments, **named):
                result = getattr(real, name)(*arguments, **named)
                # What is written: packed, or the last argument.
                written = arguments[-4] if name == "rasterize" else named.get("out", arguments[-1])
                tensors = (written,) if result is None else result if isinstance(result, tuple) else (result,)
                flat = tensors[self.output].view(-1)
                flat.view(torch.uint8)[(flat.numel() // 2) * flat.element_size()] ^= 1 << self.bit
                return result

            call.default = call
            return call

    places = {"binning": ("bin",), "tile_mask": ("bin", "tile")}
    pixel = ("bin", "tile", "pixel")
    for stage, output in ((stage, k) for stage, outputs in verify._OUTPUTS.items() for k in range(len(outputs))):
        if (stage, output) in (("binning", 2), ("rasterize", 1)):
            continue  # the case has no small record; what rasterize drops is not what it returns first
        op = "barycentrics" if stage == "attributes" else stage
        flipped = Flipped(op, output, bit=0)
        monkeypatch.setattr(torch.ops, "bigtri", flipped, raising=False)
        monkeypatch.setattr(importlib.import_module("bigtri.ops.rasterize"), "_rasterize_new", flipped.rasterize_new)
        found = verify.compare(*case, threshold=64)
        assert found is not None, (stage, output)
        assert found.stage == stage, found
        wanted = () if stage == "setup" else places.get(stage, pixel)
        assert all(getattr(found, place) is not None for place in wanted), found
        assert found.stage in str(found)

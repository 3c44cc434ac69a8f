"""Stages and variants of one's own under a name: what is compared, what the sentences blame, what is refused."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from cases import CASES, from_pixels

import bigtri
from bigtri import hard_cases, native, reference
from bigtri.check import registered, verify
from bigtri.precision import RUNGS
from bigtri.reference import attributes

CASE = from_pixels(np.array([[[10, 10], [150, 20], [30, 90.0]]]), np.array([[0.25, 0.5, 0.75]]), (96, 160))
STAGES = {name: attributes.barycentrics if name == "attributes" else getattr(reference, name) for name in registered.ARGUMENTS}


@pytest.fixture(autouse=True)
def no_variant_stays():
    yield
    for name in bigtri.registered_variants():
        bigtri.unregister_variant(name)


def without_spans(*arguments):
    return reference.scanline(*arguments)[:0]


def background(positions, triangles, height, width, cull, scissor):
    return np.full((height, width), 2**63 - 1), 0


def test_what_is_registered_is_what_verify_has():
    assert list(registered.ARGUMENTS) == list(verify._OUTPUTS)


@pytest.mark.parametrize("stage", [name for name in STAGES if name != "rasterize"])
def test_a_stage_of_the_reference_agrees(stage):
    assert bigtri.register_stage(stage, variant="mine")(STAGES[stage]) is STAGES[stage]
    assert bigtri.registered_variants() == {"mine": (stage,)}
    assert verify.compare(*CASE, variant="mine", every=True) == []


def test_a_whole_variant_in_three_lines():
    @bigtri.register_variant("mine")
    def draw(positions, triangles, height, width, cull, scissor):
        return reference.rasterize(positions, triangles, height, width, cull, scissor)

    for name in ("behind_camera", "equal_depth", "not_finite"):
        assert (
            verify.compare(*CASES[name](np.random.default_rng(3)), variant="mine", cull="front", scissor=(3, 5, 70, 60)) is None
        )


def test_a_stage_is_compared_by_itself_and_in_the_whole():
    bigtri.register_stage("scanline", variant="mine")(without_spans)
    found = verify.compare(*CASE, variant="mine", every=True)
    assert str(found[0]) == "stage scanline, pixels (10, 10) to (16, 10): not covered by triangle 0, covered expected"
    assert {difference.stage for difference in found} == {"scanline", "rasterize"}
    assert not any("fault" in str(difference) or "by itself" in str(difference) for difference in found)
    covered = int((reference.rasterize(*CASE[:2], *CASE.resolution)[0] != 2**63 - 1).sum())
    assert sum(difference.stage == "rasterize" for difference in found) == covered


def test_a_whole_variant_is_compared_at_the_end_alone(monkeypatch):
    """Nor does the reference run its stages one by one, which may need more memory than the whole."""
    bigtri.register_variant("mine")(background)
    for stage in verify._BY_ITSELF:
        monkeypatch.delattr(verify.one_stage, stage)
    found = verify.compare(*CASE, variant="mine")
    assert str(found) == (
        "stage rasterize, pixel (10, 10) in tile (1, 1) of bin (0, 0): background, triangle 0 at depth 0.25363636 expected"
    )


def test_the_schedule_is_at_fault_where_all_stages_agree():
    bigtri.register_variant("mine")(background)
    for stage in verify._BY_ITSELF:
        bigtri.register_stage(stage, variant="mine")(STAGES[stage])
    assert str(verify.compare(*CASE, variant="mine")).endswith(
        "expected; every stage by itself agrees, so the schedule of variant 'mine' is at fault"
    )


def test_stages_that_agree_by_themselves_and_not_together():
    """The queue in another order is no fault of binning; that the masks need it in that order is one of tile_mask."""

    @bigtri.register_stage("binning", variant="mine")
    def binning(records, threshold):
        bins = reference.binning(records, 0)
        return bins._replace(candidates=bins.candidates[::-1], kept=bins.kept[::-1])

    @bigtri.register_stage("tile_mask", variant="mine")
    def tile_mask(records, queue):
        return reference.tile_mask(records, queue[np.lexsort(queue.T[[1, 2, 0]])])

    found = verify.compare(*CASE, variant="mine", threshold=0)
    assert found.stage == "rasterize"
    assert str(found).endswith(
        "; each stage by itself agrees, so one of them depends on more than it may, such as the order of a queue"
    )


@pytest.mark.parametrize("stage", ["rasterize", "visibility"])
def test_what_a_variant_draws_may_be_seen(stage):
    """As a whole, or by its stages one after the other; right or wrong."""

    def inverted(*given):
        result = STAGES[stage](*given)
        return (result[0] ^ 1, result[1] + 1) if stage == "rasterize" else result ^ 1

    register = bigtri.register_variant("mine") if stage == "rasterize" else bigtri.register_stage(stage, variant="mine")
    register(inverted)
    scene = CASES["not_finite"](np.random.default_rng(3))
    expected, dropped = reference.rasterize(*scene[:2], *scene.resolution, "back", (3, 5, 70, 60))
    packed, lost = verify.draw("mine", *scene, cull="back", scissor=(3, 5, 70, 60))
    assert np.array_equal(packed, expected ^ 1) and lost == dropped + (stage == "rasterize") and dropped > 0
    with pytest.raises(ValueError, match="bigtri.verify.draw: variant must be one of 'mine', got 'bin_owned'"):
        verify.draw("bin_owned", *scene)


def test_nothing_of_the_extension_is_compared_with_it(monkeypatch):
    monkeypatch.setattr(native, "available", lambda: False)
    bigtri.register_stage("depth", variant="mine")(reference.depth)
    assert verify.compare(*CASE, variant="mine") is None
    monkeypatch.setattr(native, "available", lambda: True)
    real = verify._Run._on_backend

    def on_backend(run, stage, given, backend):
        assert backend == "reference"
        return real(run, stage, given, backend)

    monkeypatch.setattr(verify._Run, "_on_backend", on_backend)
    assert verify.compare(*CASE, variant="mine") is None


def test_a_stage_given_in_the_call_stands_before_the_registered_one():
    bigtri.register_stage("scanline", variant="mine")(without_spans)
    assert verify.compare(*CASE, variant="mine", stages={"scanline": reference.scanline}) is None


def test_registering_again_replaces():
    bigtri.register_stage("scanline", variant="mine")(without_spans)
    bigtri.register_stage("scanline", variant="mine")(reference.scanline)
    assert verify.compare(*CASE, variant="mine") is None
    bigtri.unregister_variant("mine")
    with pytest.raises(ValueError, match="bigtri.verify: variant must be one of 'auto'.*, got 'mine'"):
        verify.compare(*CASE, variant="mine")


def test_a_function_gets_tensors_where_it_asks_for_a_device():
    seen = []

    def depth(records, spans):
        seen.extend([spans, *records])
        return torch.from_numpy(reference.depth(reference.Records(*(field.numpy() for field in records)), spans.numpy()))

    @bigtri.register_variant("mine", device=torch.device("cpu"))
    def draw(positions, triangles, height, width, cull, scissor):
        seen.extend([positions, triangles])
        packed, dropped = reference.rasterize(positions.numpy(), triangles.numpy(), height, width, cull, scissor)
        return torch.from_numpy(packed), torch.tensor(dropped)

    bigtri.register_stage("depth", variant="mine", device="cpu")(depth)
    assert verify.compare(*CASE, variant="mine") is None
    assert len(seen) >= 12 and {type(value) for value in seen} == {torch.Tensor}


def test_what_a_stage_raises_and_what_it_returns_is_told_with_its_variant():
    @bigtri.register_stage("depth", variant="mine")
    def depth(records, spans):
        raise LookupError("nothing there")

    with pytest.raises(RuntimeError, match="^bigtri.verify: stage depth of variant 'mine' raised LookupError: nothing there$"):
        verify.compare(*CASE, variant="mine")
    bigtri.register_stage("depth", variant="mine")(lambda records, spans: np.zeros(3))
    with pytest.raises(TypeError, match=r"^bigtri.verify: stage depth must return depth as float32 \[F\].*, got float64 \[3\]$"):
        verify.compare(*CASE, variant="mine")


def test_a_precision_reaches_the_reference():
    fewer_bits = RUNGS["subpixel4"]

    @bigtri.register_stage("setup", variant="mine")
    def setup(*scene):
        return reference.setup(*scene, fewer_bits)

    assert verify.compare(*CASE, variant="mine", precision="subpixel4") is None
    assert verify.compare(*CASE, variant="mine").stage == "setup"


@pytest.mark.parametrize("precision", [name for name, arithmetic in RUNGS.items() if not arithmetic.has_stages])
def test_a_precision_whose_stages_hand_on_more(precision):
    bigtri.register_variant("mine")(lambda *scene: reference.rasterize(*scene, arithmetic=RUNGS[precision]))
    assert verify.compare(*CASE, variant="mine", precision=precision) is None
    bigtri.register_stage("depth", variant="mine")(reference.depth)
    with pytest.raises(ValueError, match=f"stages must be 'rasterize' or 'attributes' with precision '{precision}'.*got 'depth'"):
        verify.compare(*CASE, variant="mine", precision=precision)


@pytest.mark.parametrize(
    ("register", "error", "text"),
    [
        (
            lambda: bigtri.register_stage("bining", variant="a"),
            ValueError,
            "register_stage: stage must be one of 'setup', 'binning'",
        ),
        (
            lambda: bigtri.register_stage("rasterize", variant="a"),
            ValueError,
            "stage must be one of .*'attributes', got 'rasterize'",
        ),
        (lambda: bigtri.register_stage(reference.depth, variant="a"), TypeError, "stage must be one of 'setup'"),
        (lambda: bigtri.register_variant(3), TypeError, "register_variant: name must be a string, got 3"),
        (
            lambda: bigtri.register_variant(""),
            ValueError,
            "register_variant: name must be a name of your own, not .*auto.*, got ''",
        ),
        (
            lambda: bigtri.register_stage("depth", variant="auto"),
            ValueError,
            "register_stage: variant must be a name of your own",
        ),
        (lambda: bigtri.register_variant("a", device="gpu"), ValueError, "device must be one of torch's or None, got 'gpu'"),
        (lambda: bigtri.register_variant("a")(None), TypeError, "register_variant: rasterize must be callable, got None"),
        (
            lambda: bigtri.register_stage("binning", variant="a")(lambda records: records),
            TypeError,
            r"must take the arguments binning\(records, threshold\), got <lambda>\(records\)",
        ),
        (
            lambda: bigtri.register_variant("a")(reference.binning),
            TypeError,
            r"must take the arguments rasterize\(positions, triangles, height, width, cull, scissor\), got binning\(",
        ),
        (
            lambda: bigtri.unregister_variant("a"),
            ValueError,
            r"unregister_variant: name must be a registered variant \(none\), got 'a'",
        ),
    ],
)
def test_what_cannot_be_registered(register, error, text):
    with pytest.raises(error, match=text):
        register()
    assert bigtri.registered_variants() == {}


@pytest.mark.skipif(not native.available(), reason="the extension is not built")
@pytest.mark.parametrize("kind", sorted(native.VARIANTS))
def test_the_extension_s_names_are_taken(kind):
    for name in native.VARIANTS[kind]:
        with pytest.raises(ValueError, match=f"name must be a name of your own, not .*{name}.*, got '{name}'"):
            bigtri.register_variant(name)


def test_the_hard_cases_meshes():
    found = list(hard_cases.meshes())
    assert {"H01", "H20", "pytorch3d-439"} <= {name for name, _ in found} <= set(hard_cases.cases())
    assert all(mesh.positions.shape == (3 * len(mesh.triangles), 4) for _, mesh in found)

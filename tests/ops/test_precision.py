"""The argument ``precision=``: names and mixes, what is refused, and why."""

from __future__ import annotations

import dataclasses
import importlib

import numpy as np
import pytest

import bigtri
from bigtri import native
from bigtri.check import stages
from bigtri.precision import (
    ATTRIBUTES,
    CLIPS,
    COVERAGES,
    DEPTHS,
    EXACT,
    MASKS,
    PRECISIONS,
    PRESETS,
    RUNGS,
    Precision,
    arithmetic_of,
)

P = np.array([[-1, -1, 0, 1], [3, -1, 0.3, 1], [-1, 3, 0.9, 1]], np.float32)
T = np.array([[0, 1, 2]], np.int32)
MIX = Precision(coverage="fixed4", depth="stored16")  # valid, and without a name

needs_extension = pytest.mark.skipif(not native.available(), reason="the extension is not built")


def test_a_rung_is_a_precision_with_a_name() -> None:
    assert Precision() == EXACT.precision and arithmetic_of(Precision()) is EXACT
    for name, rung in RUNGS.items():
        assert rung.name == name and rung.precision == Precision(**dataclasses.asdict(rung.precision))
        if name != "attributes_float32":
            assert arithmetic_of(dataclasses.replace(rung.precision)) is rung
    assert arithmetic_of(MIX).name not in RUNGS and arithmetic_of(MIX).precision is MIX


def test_of_two_names_a_precision_has_that_which_every_build_has() -> None:
    assert RUNGS["attributes_float32"].precision == RUNGS["balanced"].precision
    assert arithmetic_of(Precision(attributes="float32")).name == "balanced"
    assert len({rung.precision for rung in RUNGS.values()}) == len(RUNGS) - 1


def test_rungs_step_down_on_one_axis_at_a_time() -> None:
    for name, rung in RUNGS.items():
        pairs = zip(dataclasses.astuple(rung.precision), dataclasses.astuple(EXACT.precision), strict=True)
        assert name in PRESETS or sum(a != b for a, b in pairs) == 1, name


@pytest.mark.parametrize(
    ("choices", "error", "text"),
    [
        ({"depth": "double"}, ValueError, "bigtri.Precision: depth must be one of 'float64_cell', .*'reversed', got 'double'"),
        (
            {"coverage": "float32", "mask": "half_tile"},
            ValueError,
            "bigtri.Precision: mask must not be 'half_tile' with coverage 'float32': a value at a tile's centre",
        ),
        ({"coverage": 8}, TypeError, "bigtri.Precision: coverage must be one of 'fixed8', 'fixed4', .*, got 8"),
    ],
)
def test_a_choice_that_there_is_not_is_named(choices: dict, error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        Precision(**choices)


def test_the_reference_draws_every_mix() -> None:
    resolution = (64, 64)
    seen = bigtri.rasterize(P, T, resolution, precision=MIX, backend="reference")
    named = [bigtri.rasterize(P, T, resolution, precision=name, backend="reference") for name in ("exact", "depth_stored16")]
    assert np.array_equal(seen.packed, named[1].packed) and not np.array_equal(seen.packed, named[0].packed)
    by_fields = bigtri.rasterize(P, T, resolution, precision=Precision(depth="stored16"), backend="reference")
    assert np.array_equal(by_fields.packed, named[1].packed)
    values = bigtri.interpolate(P, seen, P, T, precision=MIX, backend="reference")
    assert np.array_equal(values, bigtri.interpolate(P, seen, P, T, backend="reference"))


@needs_extension
@pytest.mark.parametrize("backend", ["auto", "native"])
def test_the_extension_refuses_a_mix_without_a_name(backend: str) -> None:
    seen = bigtri.rasterize(P, T, (8, 8), backend="native")
    records, _ = stages.setup(P, T, 8, 8)
    text = r"bigtri.\w+: precision must be one of 'exact', .* on the CPU, got .*stored16.*; a mix without a name"
    for call in (
        lambda: bigtri.rasterize(P, T, (8, 8), precision=MIX, backend=backend),
        lambda: bigtri.rasterize(P, T, (8, 8), precision=MIX, backend=backend, variant="two_stage"),
        lambda: bigtri.interpolate(P, seen, P, T, precision=MIX, backend=backend),
        lambda: bigtri.barycentrics(seen, P, T, precision=MIX, backend=backend),
        lambda: stages.depth(records, np.zeros((0, 4), np.int32), precision=MIX, backend=backend),
    ):
        with pytest.raises(ValueError, match=text):
            call()


@needs_extension
def test_a_rung_that_is_not_built_is_refused_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    few = {name: native.REGISTRY["cpu"][name] for name in (*PRESETS, "subpixel4")}
    monkeypatch.setitem(native.REGISTRY, "cpu", few)

    def refused(*_: object) -> None:
        raise RuntimeError("as an extension without the rung says")

    monkeypatch.setattr(importlib.import_module("bigtri.ops.rasterize"), "_rasterize_new", refused)
    text = (
        "precision must be one of 'exact', 'balanced', 'fast', 'subpixel4' on the CPU, got 'depth_reversed'; build the extension "
        "with BIGTRI_LADDER=1"
    )
    with pytest.raises(ValueError, match=text):
        bigtri.rasterize(P, T, (8, 8), precision="depth_reversed")
    reference = bigtri.rasterize(P, T, (8, 8), precision="depth_reversed", backend="reference")
    assert (np.asarray(reference.triangle) == 0).any()


@needs_extension
@pytest.mark.parametrize("name", PRECISIONS)
def test_a_precision_draws_what_its_name_draws(name: str) -> None:
    if name not in native.REGISTRY["cpu"]:
        pytest.skip("not built")
    a, b = (bigtri.rasterize(P, T, (64, 64), precision=one) for one in (name, RUNGS[name].precision))
    assert np.array_equal(a.packed, b.packed)


def test_every_choice_has_a_rung() -> None:
    for axis, choices in (
        ("coverage", COVERAGES),
        ("depth", DEPTHS),
        ("mask", MASKS),
        ("clip", CLIPS),
        ("attributes", ATTRIBUTES),
    ):
        assert {getattr(rung.precision, axis) for rung in RUNGS.values()} == {*choices}, axis

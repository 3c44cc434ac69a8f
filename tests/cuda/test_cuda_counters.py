"""Counters of work on CUDA against the reference, where the extension was built with BIGTRI_CUDA_COUNTING=1; and the tuner."""

from __future__ import annotations

import pytest
import torch
from cuda_bits import DEVICE, Scene, case_of, needs_cuda

from bigtri import native, reference
from bigtri.check import counters
from bigtri.precision import EXACT
from bigtri.reference.work import without_empty
from bigtri.study import tune

pytestmark = needs_cuda

COUNTED = ("scanline", "batched", "recursive_descent", "hierarchical_tiles", "tile_queues", "coverage_masks", "tile_owned")


def counted(name: str, variant: str, parameters: dict[str, int]) -> dict[str, int]:
    try:
        return counters.count(*case_of(Scene(name)), variant=variant, device=DEVICE, backend="native", parameters=parameters)
    except RuntimeError as error:
        if "built with BIGTRI_CUDA_COUNTING=1" in str(error):
            pytest.skip(str(error))
        raise


@pytest.mark.parametrize("name", ["many_small", "guard_band", "mixed"])
@pytest.mark.parametrize("variant", COUNTED)
def test_work_is_the_reference_s(variant: str, name: str) -> None:
    """What depends on nothing: records, and the pixels that they cover, each offered its depth once."""
    has = native.REGISTRY[DEVICE]["exact"][variant].parameters
    found = counted(name, variant, {"early_z": 0} if "early_z" in has else {})
    case = case_of(Scene(name))
    records = without_empty(reference.setup(case.positions, case.triangles, *case.resolution)[0], EXACT)
    model = counters.count(*case, variant="scanline", backend="reference")
    assert (found["records"], found["fragments"]) == (len(records.xy), model["fragments"])
    if "early_z" in has:
        assert counted(name, variant, {"early_z": 1})["fragments"] <= found["fragments"]


def test_what_is_not_counted_is_named() -> None:
    counted("mixed", "scanline", {})
    with pytest.raises(RuntimeError, match="variant must be one of .*scanline"):
        counters.count(*case_of(Scene("mixed")), variant="bin_owned", device=DEVICE, backend="native")


def test_the_tuner_draws_the_same_bits() -> None:
    """It raises where a way that it tries draws others."""
    case = case_of(Scene("mixed"))
    positions, triangles = (torch.from_numpy(array).to(DEVICE) for array in (case.positions, case.triangles))
    found = tune.tune(tune.Job("mixed", positions, triangles, case.resolution), 0.05)
    assert found.ways[0].variant == next(iter(native.REGISTRY[DEVICE]["exact"])) and found.ways[0].ratio == 1
    assert len(found.ways) > 1 and {way.variant for way in found.ways} <= {*native.REGISTRY[DEVICE]["exact"]}
    assert found.threads == 0 and found.isa == ""

"""The comparison that the tests of the CUDA kernels rest on sees a single bit. Runs wherever the extension is built."""

from __future__ import annotations

import functools

import numpy as np
import pytest
import torch
from cases import CASES
from cuda_bits import PATHS, Scene, assert_same, case_of

import bigtri
from bigtri import native
from bigtri.ops.rasterize import Visibility

pytestmark = pytest.mark.skipif(not native.available(), reason="the extension is not built")


@functools.cache
def picture(device: str) -> Visibility:
    positions, triangles, resolution = case_of(Scene("not_finite"))
    return bigtri.rasterize(torch.from_numpy(positions).to(device), torch.from_numpy(triangles).to(device), resolution)


def flipped(field: torch.Tensor, element: int, bit: int) -> torch.Tensor:
    changed = field.clone(memory_format=torch.contiguous_format)
    flat = changed.view(-1).view(torch.uint8)
    flat[element * field.element_size() + bit // 8] ^= 1 << bit % 8
    return changed


@pytest.mark.parametrize("device", native.devices())
@pytest.mark.parametrize("name", Visibility._fields)
def test_a_flipped_bit_is_seen(name, device):
    seen = picture(device)
    assert_same(seen, Visibility(*(field.clone() for field in seen)))
    field = getattr(seen, name)
    rng = np.random.default_rng(0)
    for bit in range(8 * field.element_size()):
        for element in {0, field.numel() - 1, int(rng.integers(field.numel()))}:
            wrong = seen._replace(**{name: flipped(field, element, bit)})
            for a, b in ((seen, wrong), (wrong, seen)):
                with pytest.raises(pytest.fail.Exception, match=f"after all: {name} differs in 1 of {field.numel()}, first at "):
                    assert_same(a, b, "after all")


def test_a_field_that_is_not_there_is_seen():
    seen = picture("cpu")
    for a, b in ((seen, seen._replace(depth=None)), (seen._replace(depth=None), seen)):
        with pytest.raises(AssertionError, match="depth is there on one side only"):
            assert_same(a, b)
    for wrong in (seen.packed[:-1], seen.packed.int(), seen.packed[None]):
        with pytest.raises(AssertionError, match="packed"):
            assert_same(seen, seen._replace(packed=wrong))


def test_signs_of_zero_and_kinds_of_nan_are_seen():
    seen = picture("cpu")
    zero = seen._replace(depth=torch.zeros_like(seen.depth))
    with pytest.raises(pytest.fail.Exception, match="depth differs"):
        assert_same(zero, zero._replace(depth=-zero.depth))
    nan = torch.full_like(seen.depth, torch.nan)
    assert_same(seen._replace(depth=nan), seen._replace(depth=nan.clone()))


def test_every_construction_can_be_seen():
    """No scene is empty, and each path has settings of its own."""
    for name in (*CASES, "mixed", "full_screens"):
        assert (bigtri.rasterize(*case_of(Scene(name))).triangle >= 0).any() or name == "size_1x1", name
    assert len({tuple(sorted(settings.items())) for settings in PATHS.values()}) == len(PATHS)

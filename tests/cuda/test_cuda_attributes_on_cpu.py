"""What reads a visibility buffer on a GPU, without one, in bits against the CPU: attributes.cu and shading.cu, run
by cuda_on_cpu.py."""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable, Iterable
from pathlib import Path

import cuda_on_cpu
import numpy as np
import pytest
import torch
from attribute_cases import (
    CHANNELS,
    OPS,
    RESOLUTIONS,
    Call,
    of_a_case,
    of_any_buffer,
    of_batches,
    of_channels,
    of_every_code,
    of_indices_out_of_range,
    of_lights,
    of_numbers,
    of_textures,
    views_of_a_clipped_scene,
)
from cuda_bits import CONSTRUCTIONS, Scene, case_of
from exhaustive import some_of
from numpy.typing import NDArray

import bigtri
from bigtri import native
from bigtri.ops.texture import FILTERS, WRAPS
from bigtri.reference.shading import encode_thresholds

pytestmark = [
    pytest.mark.skipif(bool(cuda_on_cpu.available()), reason=cuda_on_cpu.available()),
    pytest.mark.skipif(not native.available(), reason="the extension is not built"),
    pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning"),
]

SMALL, PIXELS = 25_000, 150_000  # of cases for every run, and of those that are not too large
SIZES = {name: int(np.prod(case_of(Scene(name)).resolution)) for name in CONSTRUCTIONS}


# --- The operators, by their kernels: arguments and result as in attribute_cases.OPS ------------------------------------------


def pointer(tensor: torch.Tensor | None) -> ctypes.c_void_p:
    return ctypes.c_void_p(tensor.data_ptr() if tensor is not None else None)


def numbers(*values: int) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.int64)


def interpolate(
    library: ctypes.CDLL, packed: torch.Tensor, positions: torch.Tensor, triangles: torch.Tensor, attributes: torch.Tensor | None
) -> torch.Tensor:
    views, _, channels = (0, 0, 3) if attributes is None else attributes.shape
    out = torch.empty(*packed.shape, channels)
    sizes = numbers(*packed.shape, positions.shape[1], len(triangles), channels, views)
    assert library.interpolate_on_cpu(*map(pointer, (packed, positions, triangles, attributes, sizes, out))) == 0
    return out


def barycentrics(library: ctypes.CDLL, packed: torch.Tensor, positions: torch.Tensor, triangles: torch.Tensor) -> torch.Tensor:
    return interpolate(library, packed, positions, triangles, None)


def sample_texture(library: ctypes.CDLL, texture: torch.Tensor, uv: torch.Tensor, how: str, wrap: str) -> torch.Tensor:
    out = torch.empty(len(uv), texture.shape[2])
    sizes = numbers(*texture.shape, len(uv), ("nearest", "bilinear").index(how), ("repeat", "clamp").index(wrap))
    bytes_of_texel = ctypes.c_int64(texture.itemsize)
    assert library.sample_on_cpu(pointer(texture), bytes_of_texel, *map(pointer, (uv, sizes, out))) == 0
    return out


def lambert(library: ctypes.CDLL, *arguments: torch.Tensor) -> torch.Tensor:
    out = torch.empty_like(arguments[0])
    lights, count = (ctypes.c_int64(len(arguments[k])) for k in (3, 0))
    assert library.lambert_on_cpu(*map(pointer, arguments), lights, count, pointer(out)) == 0
    return out


def encode_srgb(library: ctypes.CDLL, linear: torch.Tensor) -> torch.Tensor:
    out = torch.empty(linear.shape, dtype=torch.uint8)
    thresholds = torch.tensor(encode_thresholds())
    assert library.encode_on_cpu(pointer(linear), pointer(thresholds), ctypes.c_int64(linear.numel()), pointer(out)) == 0
    return out


KERNELS: dict[object, Callable[..., torch.Tensor]] = {
    OPS.interpolate: interpolate,
    OPS.barycentrics: barycentrics,
    OPS.sample_texture: sample_texture,
    OPS.lambert: lambert,
    bigtri.encode_srgb: encode_srgb,
}


def bits(result: torch.Tensor) -> NDArray:
    """One NaN is as good as another. By NumPy: torch's threads do not outlive a fork."""
    a = result.numpy()
    return np.where(np.isnan(a), np.float32(np.nan), a).view(np.int32) if a.dtype == np.float32 else a


def differences(library: ctypes.CDLL, calls: Iterable[tuple[Call, torch.Tensor]]) -> list[str]:
    """Of what the kernels give for the calls from what they have to, a line each."""
    found = []
    for number, ((op, *arguments), wanted) in enumerate(calls):
        for order in (number % 3, 3 + number % 2):  # of threads, and of warps: must not matter
            library.set_order(order)
            got = KERNELS[op](library, *arguments)
            assert (got.dtype, got.shape) == (wanted.dtype, wanted.shape)
            if count := int((bits(wanted) != bits(got)).sum()):
                found.append(f"{KERNELS[op].__name__}, call {number}, order {order}: {count} values differ")
    return found


def assert_right(calls: Iterable[Call]) -> None:
    """The kernels give what the CPU gives."""
    with_results = [(call, call[0](*call[1:])) for call in calls]
    said = cuda_on_cpu.in_children([functools.partial(differences, cuda_on_cpu.kernels(), with_results)])
    assert not said, said


# --- Interpolation ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", some_of([n for n in SIZES if SIZES[n] <= SMALL], [n for n in SIZES if SIZES[n] <= PIXELS]))
def test_every_case(name: str) -> None:
    assert_right(of_a_case(name))


@pytest.mark.parametrize("channels", CHANNELS)
def test_any_number_of_channels(channels: int) -> None:
    assert_right(of_channels(channels, views_of_a_clipped_scene(2, (31, 39))))


@pytest.mark.parametrize("resolution", RESOLUTIONS)
def test_batches_with_shared_and_with_own_attributes(resolution: tuple[int, int]) -> None:
    assert_right(of_batches(resolution))


def test_buffers_that_say_anything() -> None:
    assert_right(of_any_buffer())


def test_indices_out_of_range_read_as_background() -> None:
    calls = list(of_indices_out_of_range())
    said = cuda_on_cpu.in_children([functools.partial(differences, cuda_on_cpu.kernels(), calls)])
    assert not said, said


# --- Textures and shading --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("wrap", WRAPS)
@pytest.mark.parametrize("how", FILTERS)
def test_textures(how: str, wrap: str) -> None:
    assert_right(of_textures(how, wrap, 300))


def test_every_code_of_a_texture() -> None:
    assert_right(of_every_code())


@pytest.mark.parametrize("lights", range(4))
def test_lambert(lights: int) -> None:
    assert_right(of_lights(lights, 1500))


def test_srgb() -> None:
    assert_right(of_numbers(10_003))


# --- What the comparison sees ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("file", "old", "new", "said"),
    [
        (
            "attributes.cu",
            "b[k] = __shfl_sync(kAllLanes, weight[k], pixel);",
            "b[k] = __shfl_sync(kAllLanes, weight[0], pixel);",
            "values differ",
        ),
        ("attributes.cu", "if (i >= pixels) return", "if (i >= pixels + 32) return", "cuda_on_cpu: access beyond memory"),
        (
            "shading.cu",
            "shared[k] = thresholds.value[k];\n  __syncthreads();",
            "shared[k] = thresholds.value[k];",
            "encode_srgb, call 3, order 0",
        ),
    ],
)
def test_what_is_broken_shows(file: str, old: str, new: str, said: str, tmp_path: Path) -> None:
    """A formula, memory, a barrier that is not there."""
    library = cuda_on_cpu.build(tmp_path / "build", (file, old, new))
    calls = [*of_batches((37, 45)), *of_numbers(0)]
    given = [(call, call[0](*call[1:])) for call in calls]
    assert said in cuda_on_cpu.in_children([functools.partial(differences, library, given)])

"""The reference in a thread that flushes denormals to zero, or rounds in another direction: the same bits, and the mode stays."""

import ctypes
import inspect
import platform
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest
import torch

import bigtri
from bigtri import reference
from bigtri.check import stages
from bigtri.reference import attributes, brute_force, shading, texture

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="elsewhere the reference computes in the caller's mode")

ONE = np.array([[0, 1, 2]], np.int32)
TINY = 1e-38  # the smallest normal float32 is 1.2e-38
SIZE = (33, 40)
UPWARD = 0x800  # FE_UPWARD of x86-64
LIBM = ctypes.CDLL(None)


def denormals(*shape: int) -> np.ndarray:
    return (np.random.default_rng(41).uniform(0.5, 1, shape) * TINY).astype(np.float32)


# Inputs are made here, before any test flushes denormals. Each triangle covers the whole screen.
PLAIN = np.array([[-1, -1, 0.25, 1], [3, -1, 0.5, 1], [-1, 3, 0.75, 1]], np.float32)
POSITIONS = (np.array([[-1, -1, -1, 1], [3, -1, -1 + 2.0**-24, 1], [-1, 3, -1, 1]]) * TINY).astype(np.float32)
DRAWN = (np.zeros(SIZE, np.int64), POSITIONS, ONE)  # triangle 0 at depth 0, everywhere
RECORDS = reference.setup(PLAIN, ONE, *SIZE)[0]._replace(z=np.array([[1e-45, 3e-42, 2e-39]], np.float32))
SPANS = reference.scanline(RECORDS, np.zeros((0, 3), np.int32), np.zeros(0, np.int64), np.zeros(1, np.int32))
RECORD = brute_force.records(PLAIN, ONE, *SIZE)[0][0]._replace(z=(5e-324, 5e-324, 5e-324))
ATTRIBUTES, TEXTURE = denormals(3, 4), denormals(4, 5, 3)
UV = np.random.default_rng(43).uniform(0, 1, (200, 2)).astype(np.float32)
WHITE = np.ones((1, 3), np.float32)
LIT = (UV[:150].reshape(100, 3), denormals(100, 3), np.full(3, 0.5, np.float32), WHITE, WHITE)

# Every entry that computes with floating-point numbers, on inputs whose result changes where denormals are flushed.
ENTRIES: dict[str, Callable[[], object]] = {
    "rasterize": lambda: bigtri.rasterize(POSITIONS, ONE, SIZE, backend="reference"),
    "interpolate": lambda: bigtri.interpolate(ATTRIBUTES, *DRAWN, backend="reference"),
    "barycentrics": lambda: bigtri.barycentrics(*DRAWN, backend="reference"),
    "sample_texture": lambda: bigtri.sample_texture(TEXTURE, UV, backend="reference"),
    "lambert": lambda: bigtri.lambert(*LIT, backend="reference"),
    "stages.setup": lambda: stages.setup(POSITIONS, ONE, *SIZE, backend="reference"),
    "stages.depth": lambda: stages.depth(RECORDS, SPANS, backend="reference"),
    "reference.resolve": lambda: reference.resolve(*DRAWN),
    "brute_force.records": lambda: brute_force.records(POSITIONS, ONE, *SIZE),
    "brute_force.depth": lambda: brute_force.depth(RECORD, 3, 3),
    "brute_force.rasterize": lambda: brute_force.rasterize(POSITIONS, ONE, *SIZE),
}

# Everything that is called from outside of the reference, those too that happen to need no floating-point numbers today.
PUBLIC = [getattr(reference, name) for name in reference.__all__ if name not in ("Bins", "Records")] + [
    attributes.barycentrics,
    attributes.interpolate,
    texture.sample_texture,
    shading.lambert,
    shading.encode_srgb,
    shading.decode_srgb,
    brute_force.records,
    brute_force.depth,
    brute_force.rasterize,
]


def flushes() -> bool:
    """Whether this thread flushes denormals."""
    return float((np.array([1e-40], np.float32) * np.float32(0.5))[0]) == 0


@contextmanager
def flushing() -> Iterator[None]:
    if not torch.set_flush_denormal(True):
        pytest.skip("this processor cannot flush denormals")
    try:
        yield
    finally:
        torch.set_flush_denormal(False)


def bits(value: object) -> object:
    """``value`` as nested lists and bytes, which compare without arithmetic."""
    if isinstance(value, (tuple, list)):
        return [bits(part) for part in value]
    array = np.asarray(value)
    return array.dtype.str, array.shape, array.tobytes()


@pytest.mark.parametrize("name", ENTRIES)
def test_flushing_denormals_changes_no_bit(name: str) -> None:
    expected = bits(ENTRIES[name]())
    with flushing():
        got = ENTRIES[name]()
        stays = flushes()
    assert bits(got) == expected
    assert stays and not flushes()


class TouchedError(Exception):
    pass


class Probe:
    """An argument that notes the thread's mode as soon as anything is done with it, and ends the call."""

    def __init__(self) -> None:
        self.seen: bool | None = None

    def _touched(self, *_: object) -> None:
        self.seen = flushes()
        raise TouchedError

    __getattr__ = __getitem__ = __array__ = __index__ = __len__ = __and__ = __rmul__ = _touched


@pytest.mark.parametrize("function", PUBLIC, ids=lambda f: f"{f.__module__}.{f.__name__}")
def test_every_entry_keeps_denormals_and_puts_the_mode_back_after_an_error(function: Callable[..., object]) -> None:
    probe = Probe()
    required = [p for p in inspect.signature(function).parameters.values() if p.default is p.empty]
    with flushing():
        with pytest.raises(TouchedError):
            function(*[probe] * len(required))
        stays = flushes()
    assert probe.seen is False
    assert stays and not flushes()


@pytest.mark.skipif(platform.machine() != "x86_64", reason="FE_UPWARD is that of x86-64")
def test_rounding_upwards_changes_no_bit() -> None:
    rng = np.random.default_rng(44)
    corners = rng.normal(size=(90, 4)).astype(np.float32)
    triangles = np.arange(90, dtype=np.int32).reshape(-1, 3)
    values = rng.normal(size=(90, 2)).astype(np.float32)
    packed, _ = reference.rasterize(corners, triangles, *SIZE)
    expected = attributes.interpolate(packed, corners, triangles, values)
    nearest = LIBM.fegetround()
    assert LIBM.fesetround(UPWARD) == 0
    try:
        again, _ = reference.rasterize(corners, triangles, *SIZE)
        got = attributes.interpolate(packed, corners, triangles, values)
        stays = LIBM.fegetround() == UPWARD
    finally:
        LIBM.fesetround(nearest)
    assert stays
    np.testing.assert_array_equal(again, packed)
    np.testing.assert_array_equal(got.view(np.int32), expected.view(np.int32))

"""What stands for float64 on GPUs where that is slow (core/float_pair.h, core/pair_depth.h, pair_snap), on the CPU: whatever
pairs of float32 decide is what float64 rounds to, and they decide nearly everything."""

from __future__ import annotations

import ctypes
import functools
import shutil
import subprocess
import tempfile
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from cuda_on_cpu import COMPILER, CSRC
from numpy.typing import NDArray

pytestmark = pytest.mark.skipif(not shutil.which("c++"), reason="no C++ compiler")

U = Fraction(1, 2**24)
PLANES = ("triangle", "cell", "row")


@functools.cache
def library() -> ctypes.CDLL:
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "float_pairs.so"
        source = Path(__file__).with_name("float_pairs.cpp")
        subprocess.run([*COMPILER, "-O2", f"-I{CSRC}", "-shared", str(source), "-o", str(made)], check=True)
        return ctypes.CDLL(str(made))


def pointer(array: NDArray) -> ctypes.c_void_p:
    return array.ctypes.data_as(ctypes.c_void_p)


def depth_counts(corners: NDArray, z: NDArray, planes: str = "triangle", bound: float = 1.0) -> tuple[int, int, int]:
    """Covered pixels of triangles [count, 3, 2], subpx, those not decided, and those decided wrongly. planes: for each what there
    is a plane; those of cells, as patches have them, bound the cell's pixels, and those of rows are what slivers have."""
    x, y = (np.ascontiguousarray(corners[..., k], np.int32) for k in range(2))
    depths, counts = np.ascontiguousarray(z, np.float32), np.zeros(5, np.int64)
    library().decide_depth(len(x), *map(pointer, (x, y, depths)), PLANES.index(planes), ctypes.c_float(bound), pointer(counts))
    assert counts[4] == 0
    return int(counts[0]), int(counts[1]), int(counts[2])


def corners_of(rng: np.random.Generator, side: int, count: int) -> NDArray[np.int64]:
    """Triangles of about so many px, some of them slivers."""
    corners = rng.integers(0, 256 * 1000, (count, 1, 2)) + rng.integers(0, 256 * side + 1, (count, 3, 2))
    corners[::4, 2] = corners[::4, 1] + rng.integers(-256, 257, (len(corners[::4]), 2))
    return corners


SIDES = {2: 40_000, 5: 10_000, 30: 500, 250: 8}
# Depths of the vertices, and the least share of pixels that have to be decided, but with a plane for each cell.
DEPTHS = {
    "any": (lambda rng, n: rng.uniform(0, 1, (n, 3)), 0.999),
    "of a mesh": (lambda rng, n: 1 - rng.uniform(1e-3, 0.1, (n, 1)) + rng.normal(0, 1e-4, (n, 3)), 0.999),
    "near": (lambda rng, n: rng.uniform(1e-3, 2e-3, (n, 1)) + rng.normal(0, 1e-5, (n, 3)), 0.999),
    "flat": (lambda rng, n: np.repeat(rng.uniform(0, 1, (n, 1)), 3, axis=1), 1.0),
    "of every size": (lambda rng, n: np.exp2(rng.uniform(-140, 0, (n, 3))), 0.9),
    "all tiny": (lambda rng, n: rng.integers(0, 1 << 20, (n, 3)) * 2.0**-149, 0.0),
    "beyond 1": (lambda rng, n: rng.uniform(0, 2.5, (n, 3)), 0.999),
}


@pytest.mark.parametrize("planes", PLANES)
@pytest.mark.parametrize("depths", DEPTHS)
@pytest.mark.parametrize("side", SIDES)
def test_what_pairs_decide_of_depth_is_what_float64_rounds_to(side: int, depths: str, planes: str) -> None:
    rng = np.random.default_rng([side, *depths.encode()])
    corners = corners_of(rng, side, SIDES[side])
    make, share = DEPTHS[depths]
    pixels, undecided, wrong = depth_counts(corners, np.abs(make(rng, len(corners))), planes)
    anchored = 15 if planes == "cell" else 1  # a cell's corner is far from a small triangle
    assert pixels > 1000 and wrong == 0 and undecided <= anchored * (1 - share) * pixels, (pixels, undecided, wrong)


def between(rng: np.random.Generator, count: int) -> tuple[NDArray, NDArray]:
    """Right-angled triangles of 32 px whose planes change by a quarter of what float32 resolves at 0.5, from pixel to pixel, so
    that many lie just between two numbers."""
    corners = np.array([[0, 0], [32, 0], [0, 32]]) * 256 + 128 + 256 * rng.integers(0, 1000, (count, 1, 2))
    step = 2.0**-26 * rng.integers(1, 8, (count, 1)) * np.array([[0, 32, 64]])
    return corners, 0.5 + step + rng.integers(0, 2, (count, 3)) * 2.0**-24


def test_what_lies_between_two_numbers_is_not_decided() -> None:
    corners, z = between(np.random.default_rng(0), 400)
    pixels, undecided, wrong = depth_counts(corners, z)
    assert wrong == 0 and undecided > pixels / 16


def test_without_a_bound_pairs_would_be_wrong() -> None:
    rng = np.random.default_rng(5)
    corners, depths = corners_of(rng, 5, 20_000), np.exp2(rng.uniform(-140, 0, (20_000, 3)))
    assert depth_counts(corners, depths)[2] == 0 < depth_counts(corners, depths, bound=0.0)[2]


def nearly_half(rng: np.random.Generator, count: int, size: int) -> tuple[NDArray, NDArray]:
    """x and w such that x / w * 128 size is a half as nearly as float32 has it, or an ulp or two away."""
    w = np.exp2(rng.uniform(-8, 12, count)).astype(np.float32)
    place = (rng.integers(-128 * size, 128 * size, count) + 0.5) / (128 * size)
    x = (place * w).astype(np.float32)
    return (x + rng.integers(-2, 3, count).astype(np.float32) * np.spacing(x)).astype(np.float32), w


@pytest.mark.parametrize("size", [1, 100, 1919, 16384])
def test_what_pairs_decide_of_vertices_is_what_float64_rounds_to(size: int) -> None:
    rng = np.random.default_rng(size)
    count = 200_000
    w = np.exp2(rng.uniform(-60, 60, count)).astype(np.float32)
    power = np.float32(2) ** rng.integers(-3, 4, count).astype(np.float32)
    families = {
        "any": ((rng.uniform(-1, 1, count) * w).astype(np.float32), w, 1e-4),
        "tiny": ((rng.uniform(-1, 1, count) * w).astype(np.float32) * np.float32(2.0**-60), w, 1e-4),
        "halves": (*nearly_half(rng, count, size), 0.2),
        "exact halves": (np.float32(rng.integers(-64, 65, count) / 128) * power, power, 1.0),
        "not numbers": (np.resize(np.array([np.nan, np.inf, 0, 1e38], np.float32), count), np.resize(w, count), 1.0),
    }
    for name, (x, by, share) in families.items():
        x, by, counts = np.ascontiguousarray(x), np.ascontiguousarray(by), np.zeros(3, np.int64)
        library().decide_snap(count, pointer(x), pointer(by), size, pointer(counts))
        assert counts[2] == 0 and counts[1] <= share * count, (name, counts)


def pairs(rng: np.random.Generator, count: int) -> NDArray[np.float32]:
    """Of either sign, the low word of up to half of the high one's last place, or 0."""
    high = (np.exp2(rng.uniform(-20, 20, count)) * rng.choice([-1, 1], count)).astype(np.float32)
    low = np.spacing(np.abs(high)) * rng.uniform(-0.5, 0.5, count) * rng.integers(0, 2, count)
    return np.stack([high, low.astype(np.float32)], axis=1)


@pytest.mark.parametrize(
    ("operation", "exact", "bound"),
    [
        (0, lambda a, b: a + b, lambda a, b: 4 * U**2 * (abs(a) + abs(b))),
        (2, lambda a, b: a * b, lambda a, b: 8 * U**2 * abs(a * b)),
        (3, lambda a, b: 1 / a, lambda a, b: 32 * U**2 / abs(a)),
    ],
)
def test_operations_keep_their_bounds(operation: int, exact, bound) -> None:
    rng = np.random.default_rng(operation)
    a, b = pairs(rng, 4000), pairs(rng, 4000)
    b[:1000] = -a[:1000] * np.float32(1 + 2.0**-20)  # much of the sum cancels
    b[:1000, 1] = a[:1000, 1]
    if operation == 3:
        a = np.abs(a) * np.array([1, rng.choice([-1, 1])], np.float32)
    out = np.zeros_like(a)
    library().compute(operation, len(a), pointer(a), pointer(b), None, pointer(out))
    for p, q, r in zip(a.tolist(), b.tolist(), out.tolist(), strict=True):
        x, y, z = (Fraction(v[0]) + Fraction(v[1]) for v in (p, q, r))
        assert abs(z - exact(x, y)) <= bound(x, y), (p, q, r)
        assert abs(r[1]) <= abs(r[0]) * 2.0**-24


def test_integers_are_exact_pairs() -> None:
    rng = np.random.default_rng(4)
    v = rng.integers(-(2**49) + 1, 2**49, 4000) >> rng.integers(0, 49, 4000)
    v[:4] = 2**49 - 1, -(2**49) + 1, 2**24, -(2**25)
    out, unused = np.zeros((len(v), 2), np.float32), np.zeros((len(v), 2), np.float32)
    library().compute(4, len(v), pointer(unused), pointer(unused), pointer(v), pointer(out))
    assert (out.astype(np.float64).sum(axis=1) == v).all()

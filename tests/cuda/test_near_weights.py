"""Weights by multiplication, which CUDA takes for the rule's where that is sure (csrc/cuda/near_weights.cuh), on the CPU: what is
sure is what the rule's divisions in float64 round to, and nearly everything is."""

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
from cuda_on_cpu import COMPILER, copy_sources
from numpy.typing import NDArray

pytestmark = pytest.mark.skipif(not shutil.which("c++"), reason="no C++ compiler")

COUNT = 400_000
HEADER = "near_weights.cuh"


@functools.cache
def library(rung: str = "exact", old: str = "", new: str = "") -> ctypes.CDLL:
    """Of a rung; old, new: text of the header, and what to put in its place."""
    with tempfile.TemporaryDirectory() as folder:
        sources, made = Path(folder) / "sources", Path(folder) / "near_weights.so"
        copy_sources(sources, (HEADER, old, new) if old else None)
        source = Path(__file__).with_name("near_weights.cpp")
        flags = ["-O2", f"-DBIGTRI_RUNG={rung}", f"-I{sources}", "-shared"]
        subprocess.run([*COMPILER, *flags, str(source), "-o", str(made)], check=True)
        return ctypes.CDLL(str(made))


def weigh(e: NDArray, w: NDArray, t: NDArray | None = None, of: ctypes.CDLL | None = None) -> tuple[NDArray, NDArray]:
    """Which pixels are sure, and which of them are not what they have to be; e and w [N, 3], t [N, 3, 3]."""
    e, w = np.ascontiguousarray(e, np.int64), np.ascontiguousarray(w, np.float64)
    slots = None if t is None else np.ascontiguousarray(t, np.float64)
    near, rule = np.zeros((2, *e.shape), np.float32)
    sure = np.zeros(len(e), bool)
    arrays = (a if a is None else a.ctypes.data_as(ctypes.c_void_p) for a in (e, w, slots, near, rule, sure))
    (of or library()).weigh(len(e), *arrays)
    return sure, sure & (near.view(np.int32) != rule.view(np.int32)).any(axis=1)


def edge_values(rng: np.random.Generator, count: int, side: float, beyond: float = 0.0) -> NDArray[np.int64]:
    """At points of triangles of about so many subpx that wind the right way; beyond: how far outside they may be."""
    corners = np.rint(rng.uniform(-side / 2, side / 2, (count, 3, 2))).astype(np.int64)
    share = rng.dirichlet([1, 1, 1], count) + beyond * rng.uniform(-1, 1, (count, 3))
    point = np.rint((share[..., None] * corners).sum(axis=1)).astype(np.int64)
    at = corners - point[:, None]
    p, q = at[:, [1, 2, 0]], at[:, [2, 0, 1]]
    e = p[..., 0] * q[..., 1] - q[..., 0] * p[..., 1]
    e *= np.sign(e.sum(axis=1))[:, None]
    return e[(e.sum(axis=1) > 0) & ((e >= 0).all(axis=1) | (beyond > 0))]


def slots(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Rows of records: corners of the triangle, points of its edges, and inner ones, of any scale that clipping leaves."""
    t = rng.uniform(0, 1, (count, 3, 3)) * (rng.integers(0, 3, (count, 3, 3)) > 0)
    t += np.eye(3) * (t.sum(axis=1, keepdims=True) == 0)  # a record that has an area has something of every slot
    t[..., 0] += t.sum(axis=2) == 0
    t *= np.exp2(rng.uniform(-20, 0, (count, 3, 3)) * rng.integers(0, 2, (count, 1, 1)))
    return t / t.sum(axis=2, keepdims=True) * rng.uniform(0.5, 1, (count, 3, 1))


# w of the corners.
W = {
    "equal": lambda rng, n: np.repeat(rng.uniform(0.1, 10, (n, 1)), 3, axis=1),
    "nearly equal": lambda rng, n: rng.uniform(0.1, 10, (n, 1)) * (1 + rng.normal(0, 1e-6, (n, 3))),
    "near": lambda rng, n: rng.uniform(0.1, 10, (n, 3)),
    "of every size": lambda rng, n: np.exp2(rng.uniform(-12, 12, (n, 3))),
}


def float32_of(w: NDArray) -> NDArray:
    return w.astype(np.float32).astype(np.float64)


def test_inverses_keep_their_bound() -> None:
    v = np.exp2(np.random.default_rng(9).uniform(-900, 900, 4000))
    out = np.zeros_like(v)
    library().invert(len(v), *(a.ctypes.data_as(ctypes.c_void_p) for a in (v, out)))
    for a, b in zip(v.tolist(), out.tolist(), strict=True):
        assert abs(Fraction(a) * Fraction(b) - 1) <= Fraction(1, 2**52)


@pytest.mark.parametrize("clipped", [False, True])
@pytest.mark.parametrize("w", W)
@pytest.mark.parametrize("side", [2**8, 2**14, 2**24 - 2])
def test_what_is_sure_is_what_the_rule_rounds_to(side: int, w: str, clipped: bool) -> None:
    rng = np.random.default_rng([side, *w.encode()])
    e = edge_values(rng, COUNT, side)
    t = slots(rng, len(e)) if clipped else None
    sure, wrong = weigh(e, float32_of(W[w](rng, len(e))), t)
    inside = (e > 0).all(axis=1)  # else a weight may be 0
    assert inside.sum() > COUNT / 2 and not wrong.any() and (~sure & inside).sum() <= 12, (~sure & inside).sum()


@pytest.mark.parametrize("clipped", [False, True])
def test_w_of_every_magnitude_there_is(clipped: bool) -> None:
    """Weights may then be too small for float32."""
    rng = np.random.default_rng(7)
    e = edge_values(rng, COUNT, 2**20)
    w = float32_of(np.exp2(rng.uniform(-149, 127.9, (len(e), 3))))
    if clipped:  # new vertices have float64
        w *= np.exp2(rng.uniform(-1000, 100, w.shape) * rng.integers(0, 2, (len(e), 1)))
    sure, wrong = weigh(e, w, slots(rng, len(e)) if clipped else None)
    assert not wrong.any() and 0 < sure.sum() < len(e)


def beside_the_middle(rng: np.random.Generator, count: int, w: NDArray) -> NDArray[np.int64]:
    """e below 2^49 such that the first weight lies in the middle of two float32, but for what rounding e takes away, and up to
    2^-44 of it."""
    low = rng.uniform(0.25, 0.5, count).astype(np.float32)
    middle = np.longdouble(low) + np.longdouble(np.spacing(low)) / 2
    e, w = rng.integers(2**46, 2**47, (count, 3)), np.longdouble(w)
    others = (e[:, 1:] * w[:, :1] / w[:, 1:]).sum(axis=1)
    e[:, 0] = np.rint(others * middle / (1 - middle)).astype(np.int64) + rng.integers(-3, 4, count)
    assert (e < 2**49).all()
    return e


def families(rng: np.random.Generator) -> dict[str, tuple[NDArray, NDArray, NDArray | None]]:
    """Weights beside the middle of two float32; the slots of a clipped triangle that is not are its corners."""
    near, equal = float32_of(rng.uniform(0.8, 1.25, (COUNT, 3))), np.full((COUNT, 3), 3.0)
    unit = np.broadcast_to(np.eye(3), (COUNT, 3, 3)) * rng.uniform(0.5, 1, (COUNT, 1, 1))
    return {
        "whole": (beside_the_middle(rng, COUNT, near), near, None),
        "equal": (beside_the_middle(rng, COUNT, equal), equal, None),
        "clipped": (beside_the_middle(rng, COUNT, near), near, unit),
    }


@pytest.mark.parametrize("family", ["whole", "equal", "clipped"])
def test_beside_the_middle_of_two_numbers(family: str) -> None:
    sure, wrong = weigh(*families(np.random.default_rng(3))[family])
    assert not wrong.any() and 0.1 * COUNT < sure.sum() < 0.9 * COUNT, sure.sum()


def test_in_the_middle_nothing_is_sure() -> None:
    rng = np.random.default_rng(4)
    first = 2 * rng.integers(2**23, 2**24, COUNT) + 1  # of 2^26
    rest = 2**26 - first
    second = (rng.uniform(0.1, 0.9, COUNT) * rest).astype(np.int64)
    e = np.stack([first, second, rest - second], axis=1)
    for w in (1.0, 3.0, 1e-30):
        sure, _ = weigh(e, np.full(e.shape, w))
        assert not sure.any()


def tiny(rng: np.random.Generator) -> tuple[NDArray, NDArray]:
    """Weights beside the middle of two subnormal float32."""
    w = np.stack([np.full(COUNT, 2.0**127), np.ones(COUNT), np.ones(COUNT)], axis=1)
    e = rng.integers(2**45, 2**46, (COUNT, 3))
    middle = (2 * rng.integers(2**19, 2**20, COUNT) + 1) * np.longdouble(2.0**-150)
    e[:, 0] = np.rint(np.longdouble(e[:, 1] + e[:, 2]) * middle * np.longdouble(2.0**127)).astype(np.int64)
    return e, w


def test_what_is_too_small_is_not_sure() -> None:
    sure, _ = weigh(*tiny(np.random.default_rng(5)))
    assert not sure.any()


@pytest.mark.parametrize("beyond", [1e-5, 0.1, 3.0])
def test_beyond_an_edge_or_on_it_nothing_is_sure(beyond: float) -> None:
    """A whole triangle's pixel that another rule than the edge values' has covered, or that a caller's buffer says is its."""
    rng = np.random.default_rng(6)
    e = edge_values(rng, COUNT, 2**16, beyond)
    e[::3, 1] = 0
    e = e[(e.min(axis=1) <= 0) & (e.sum(axis=1) > 0)]
    for w in (np.full(e.shape, 2.0), float32_of(rng.uniform(0.5, 2, e.shape))):
        assert len(e) > COUNT / 20 and not weigh(e, w)[0].any()


@pytest.mark.parametrize("rung", ["coverage_int32", "coverage_float32", "coverage_float32_strict"])
def test_clipped_triangles_whose_terms_cancel_are_not_sure(rung: str) -> None:
    """Where these edge values do not decide what is covered, one may be negative, and yet no weight be below 0."""
    rng = np.random.default_rng(8)
    e = edge_values(rng, COUNT, 2**16, 0.1)
    e = e[e.min(axis=1) < 0]
    t = slots(rng, len(e))
    w = float32_of(rng.uniform(0.5, 2, e.shape))
    assert weigh(e, w, t)[0].any() and not weigh(e, w, t, library(rung))[0].any()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("kNear = 64", "kNear = 2"),
        ("kMiddle = 1u << 28", "kMiddle = 1u << 27"),
        ("<< 3 > 2 * kNear << 3", "> 2 * kNear"),
        ("weight[0] >= kLeastSure", "weight[0] >= 0.0f"),
        ("__fma_rn(e, e, e)", "e"),
        ("(b[0] + b[1]) + b[2]", "b[0] + b[1]"),
    ],
)
def test_what_is_broken_shows(old: str, new: str) -> None:
    """How near the middle is, where it is, bits that do not matter, how small a weight may be, an inverse, and a sum."""
    broken, rng = library(old=old, new=new), np.random.default_rng(3)
    cases = [*families(rng).values(), (*tiny(rng), None)]
    assert any(weigh(*case, of=broken)[1].any() for case in cases) and not any(weigh(*case)[1].any() for case in cases)

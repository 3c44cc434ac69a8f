"""What each preset keeps and what it gives up, on triangles at random and adversarial ones: the families of ``test_exactness``.

``balanced`` draws the visibility buffer of ``exact``; ``fast`` covers the same pixels. That is asked of each variant that the
extension has, whose proofs rest on it. What they give up has bounds, in roundings of 2^-24, which are proved where they are
asserted.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from counting import on_grid, scaled, soup
from numpy.typing import NDArray
from test_exactness import FAMILIES, GUARD, ONE, covered, depths, oriented, with_w

import bigtri
from bigtri import native
from bigtri.precision import DEFAULT, EXACT, PRECISIONS, PRESETS, RUNGS

LESS = tuple(name for name in PRESETS if name != DEFAULT)
HEIGHT, WIDTH = 64, 128
SIZE = np.array([256 * WIDTH, 256 * HEIGHT])
ROUNDING = 2.0**-24  # of float32, relative
BACKGROUND = 2**63 - 1


def drawn_by_all(positions: NDArray[np.float32], triangles: NDArray[np.int32], precision: str) -> bigtri.Visibility:
    """What every variant of the extension draws, with its fastest instruction set; the reference's where it is not built."""
    size = HEIGHT, WIDTH
    if not native.available():
        return bigtri.rasterize(positions, triangles, size, precision=precision)
    seen = [
        bigtri.rasterize(positions, triangles, size, precision=precision, variant=variant)
        for variant in native.REGISTRY["cpu"][precision]
    ]
    assert len(seen) == len(native.VARIANTS["cpu"]), "a preset has every variant of the CPU"
    for one in seen[1:]:
        np.testing.assert_array_equal(one.packed, seen[0].packed)
        np.testing.assert_array_equal(one.depth, seen[0].depth)
    return seen[0]


def test_presets_are_named_mixes_and_the_default_is_one() -> None:
    assert PRESETS[0] == DEFAULT == "exact" and PRECISIONS[: len(PRESETS)] == PRESETS == ("exact", "balanced", "fast")
    for name in PRESETS:
        assert RUNGS[name].precision.coverage == EXACT.precision.coverage, "watertight, whatever the preset"
        assert RUNGS[name].precision.clip == EXACT.precision.clip
    differing = [
        sum(a != b for a, b in zip(*map(dataclasses.astuple, (RUNGS[name].precision, EXACT.precision)), strict=True))
        for name in PRESETS
    ]
    assert differing == sorted(differing), "each gives up what the one before does, and more"


@pytest.mark.parametrize("precision", LESS)
@pytest.mark.parametrize("name", FAMILIES)
def test_presets_cover_what_exact_covers(name: str, precision: str) -> None:
    """No wrong pixel of any triangle, drawn alone; and of ``balanced`` every bit of depth."""
    rng = np.random.default_rng([61, *name.encode()])
    xy = FAMILIES[name](rng, scaled(300) if native.available() else 40, SIZE)
    corners = on_grid(xy, depths(rng, len(xy)), (HEIGHT, WIDTH)).astype(np.float32)
    seen = drawn_by_all(corners, ONE, precision)
    np.testing.assert_array_equal(seen.triangle == 0, covered(xy, HEIGHT, WIDTH))
    exact = bigtri.rasterize(corners, ONE, (HEIGHT, WIDTH))
    if RUNGS[precision].precision.depth == EXACT.precision.depth:
        np.testing.assert_array_equal(seen.packed, exact.packed)
    else:
        z, low, high = seen.depth, *(limit(window_depths(corners), axis=1) for limit in (np.min, np.max))
        inside = seen.triangle == 0
        assert ((z >= low[:, None, None]) & (z <= high[:, None, None]))[inside].all(), "each pixel lies within its triangle"


def window_depths(corners: NDArray[np.float32]) -> NDArray[np.float32]:
    return corners[..., 2] * np.float32(0.5) + np.float32(0.5)


@pytest.mark.parametrize("name", FAMILIES)
def test_depth_of_fast_is_off_by_roundings_of_its_terms(name: str) -> None:
    """At most 9 roundings of each term of the plane, slivers and all.

    The depth at a pixel is a sum of e_k z_k / A at the cell's first pixel and, up to 63 times each, of its changes in x and in y.
    In float32 each term is rounded as e_k, by the product with z_k, in up to two sums, as A, by the quotient, by the product with
    the number of steps, and in up to two sums more: 9 times. Nothing is lost otherwise: changes of e are exact.
    """
    rng = np.random.default_rng([62, *name.encode()])
    xy = FAMILIES[name](rng, scaled(200) if native.available() else 40, SIZE)
    corners = on_grid(xy, depths(rng, len(xy)), (HEIGHT, WIDTH)).astype(np.float32)
    exact, fast = (bigtri.rasterize(corners, ONE, (HEIGHT, WIDTH), precision=p) for p in ("exact", "fast"))
    view, y, x = np.nonzero(exact.triangle == 0)
    area, vertices = oriented(xy)
    z = np.take_along_axis(window_depths(corners), np.argsort(order_of(xy, vertices), axis=1), axis=1).astype(np.float64)
    terms = np.zeros(len(view))
    for k in range(3):
        (px, py), (qx, qy) = vertices[view, (k + 1) % 3].T, vertices[view, (k + 2) % 3].T
        dx, dy = qx - px, qy - py
        first = dx * (256 * (y & -64) + 128 - py) - dy * (256 * (x & -64) + 128 - px)
        changes = 256 * (np.abs(dy) * (x & 63) + np.abs(dx) * (y & 63))
        terms += (np.abs(first) + changes).astype(np.float64) * z[view, k]
    bound = 9 * ROUNDING * (1 + 2.0**-20) * terms / area[view] + np.spacing(exact.depth[view, y, x])
    off = np.abs(fast.depth[view, y, x].astype(np.float64) - exact.depth[view, y, x])
    assert (off <= bound).all() and len(off) > 10


def order_of(xy: NDArray[np.int64], vertices: NDArray[np.int64]) -> NDArray[np.int64]:
    """int64 [N, 3]: at which place of ``vertices`` each vertex of ``xy`` stands; the same, or the last two turned round."""
    turned = (xy[:, 1] != vertices[:, 1]).any(axis=1)
    return np.where(turned[:, None], [0, 2, 1], [0, 1, 2])


@pytest.mark.parametrize("decades", [0, 1, 6])
@pytest.mark.parametrize("name", FAMILIES)
def test_weights_of_presets_are_off_by_eleven_roundings(name: str, decades: int) -> None:
    """Of triangles that are not clipped; w ratios up to 10^decades.

    u = (e / A) / w is rounded as e, as A and by two quotients, which is 4 times; a sum of three positive terms twice more; the
    quotient of both is off by 4 + (4 + 2) + 1 = 11 roundings, relative. `exact` adds half of one.
    """
    rng = np.random.default_rng([63, decades, *name.encode()])
    xy = FAMILIES[name](rng, scaled(200) if native.available() else 40, SIZE)
    w = 10.0 ** rng.uniform(-decades / 2, decades / 2, (len(xy), 3)) if decades else np.full((len(xy), 3), 2.5)
    corners = with_w(np.clip(xy, 4096 - GUARD, GUARD - 4096), rng.uniform(0, 1, (len(xy), 3)), w, (HEIGHT, WIDTH))
    seen = bigtri.rasterize(corners, ONE, (HEIGHT, WIDTH))
    exact = bigtri.barycentrics(seen, corners, ONE).astype(np.float64)
    for precision in LESS:
        weights = bigtri.barycentrics(seen, corners, ONE, precision=precision)
        assert (np.abs(weights - exact) <= 12 * ROUNDING * exact).all()
        assert (weights != exact).any() or not decades


@pytest.mark.parametrize("seed", range(4))
def test_hidden_surfaces_at_depths_next_to_each_other(seed: int) -> None:
    """Layers of one plane, each nearer by little, that fill bins and tiles: a depth bound that is not one loses pixels.

    The variant ``bin_owned`` skips what lies behind a bound; the other two compare every fragment.
    """
    rng = np.random.default_rng([64, seed])
    slope = rng.normal(0, 0.3, (1, 1, 2)) * 10.0 ** rng.uniform(-4, 0)
    xy = rng.normal(0, 1, (60, 3, 2)) * 10.0 ** rng.uniform(-1.2, 0.7, (60, 1, 1)) + rng.uniform(-0.7, 0.7, (60, 1, 2))
    xy[:12] = np.array([[-1, 1], [3, 1], [-1, -3]]) * rng.uniform(1.01, 40, (12, 1, 1))  # cover the image
    z = 0.2 + (xy * slope).sum(axis=-1) + rng.integers(-3, 4, (60, 1)) * 2.0**-24
    z[:12] += 2.0**-23  # most of the others can be seen before them
    z = np.where(rng.random((60, 1)) < 0.2, z + 2.0**-12, z)
    corners = np.concatenate([xy, z[..., None], np.ones((60, 3, 1))], axis=-1)
    for precision in LESS:
        seen = drawn_by_all(*soup(corners), precision)
        assert len(np.unique(seen.triangle)) > 2
        wanted = bigtri.rasterize(*soup(corners), (HEIGHT, WIDTH), precision=precision, backend="reference")
        np.testing.assert_array_equal(seen.packed, wanted.packed)


def test_the_presets_differ_where_they_say() -> None:
    """Else a preset that forgot its choice would pass every comparison of backends."""
    rng = np.random.default_rng(65)
    w = rng.uniform(0.5, 2, (20, 3, 1))
    corners = np.concatenate([rng.normal(0, 1, (20, 3, 2)) * w, rng.uniform(-0.9, 0.9, (20, 3, 1)) * w, w], axis=-1)
    exact, balanced, fast = (bigtri.rasterize(*soup(corners), (HEIGHT, WIDTH), precision=p).packed for p in PRESETS)
    np.testing.assert_array_equal(balanced, exact)
    assert (fast != exact).any()
    assert np.array_equal(fast == BACKGROUND, exact == BACKGROUND)

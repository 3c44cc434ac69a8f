"""Coverage, depth and weights against exact integers: random and adversarial triangles by the hundred thousand.

Each triangle is drawn alone, as one view of a batch, by the public call. The oracle below knows the snapped vertices by
construction and shares nothing with the stages. BIGTRI_TEST_SCALE=20 draws millions.

What is asserted of the drawn values, besides that coverage has no wrong pixel:

* depth: within 0.5 ulp + 2^-39 of the plane through the snapped vertices;
* barycentrics b: within 0.5 ulp + 8 * 2^-53 * b of the exact ones. Edge values are exact; e/A and its division by w round once
  each, a sum of three positive terms twice more, the last division once: 2 + (2 + 2) + 1 = 7 roundings of 2^-53, relative, since
  nothing is subtracted. That holds for every sliver and every ratio of w;
* attributes: within 2^-22 * sum(b |a|): each term has b's rounding, the product's, and at most two sums': 4 * 2^-24, and 2^-20 of
  that for products of roundings.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from counting import on_grid, scaled
from numpy.typing import NDArray

import bigtri
from bigtri import native

Ints = NDArray[np.int64]
ONE = np.array([[0, 1, 2]], np.int32)
GUARD = 2**23
UNIT = 1 << 149  # all float32 are multiples of its inverse
DEPTH_ERROR = 2.0**-39

# --- The oracle --------------------------------------------------------------------------------------------------------------


def oriented(xy: Ints) -> tuple[Ints, Ints]:
    """Twice the area [N], > 0, and the vertices [N, 3, 2] in the order that gives it: clockwise, y down."""
    (ax, ay), (bx, by), (cx, cy) = (xy[:, k].T for k in range(3))
    area = ax * (by - cy) + bx * (cy - ay) + cx * (ay - by)
    return np.abs(area), np.where((area < 0)[:, None, None], xy[:, [0, 2, 1]], xy)


def covered(xy: Ints, height: int, width: int) -> NDArray[np.bool_]:
    """bool [N, H, W]: centres inside, or on an edge that has the inside to its right, or below it if it is level."""
    area, vertex = oriented(xy)
    inside = np.broadcast_to((area > 0)[:, None, None], (len(xy), height, width)).copy()
    sx, sy = 256 * np.arange(width) + 128, 256 * np.arange(height) + 128
    for k in range(3):
        (px, py), (qx, qy) = vertex[:, k].T, vertex[:, (k + 1) % 3].T
        by_row = (qx - px)[:, None] * (sy - py[:, None])
        by_column = (qy - py)[:, None] * (sx - px[:, None])
        owns = (qy < py) | ((qy == py) & (qx > px))
        inside &= by_row[:, :, None] - by_column[:, None, :] > -owns.astype(np.int64)[:, None, None]
    return inside


def edge_values(xy: Ints, x: Ints, y: Ints) -> NDArray[Any]:
    """Python ints [P, 3]: twice the area of the centre of pixel (x, y) [P] and the side opposite vertex k of ``xy`` [P, 3, 2]."""
    sample = np.stack([256 * x + 128, 256 * y + 128], axis=1)
    values = []
    for k in range(3):
        part = xy.copy()
        part[:, k] = sample
        (ax, ay), (bx, by), (cx, cy) = (part[:, m].T for m in range(3))
        values.append(ax * (by - cy) + bx * (cy - ay) + cx * (ay - by))
    result = np.stack(values, axis=1)
    return (result * np.sign(result.sum(axis=1, keepdims=True))).astype(object)


def as_ints(values: NDArray[np.float32]) -> NDArray[Any]:
    """Python ints: ``values`` times 2^149, exactly."""
    flat = [int(n) * (UNIT // d) for n, d in (v.as_integer_ratio() for v in values.reshape(-1).tolist())]
    return np.array(flat, dtype=object).reshape(values.shape)


# --- Triangles ---------------------------------------------------------------------------------------------------------------


def anywhere(rng: np.random.Generator, count: int, size: Ints) -> Ints:
    """Up to the size of the screen, all around it."""
    return rng.integers(-size, 2 * size, (count, 3, 2))


def sub_pixel(rng: np.random.Generator, count: int, size: Ints) -> Ints:
    """Up to two pixels, most of them less than one."""
    reach = np.rint(2.0 ** rng.uniform(3, 9, (count, 1, 1))).astype(np.int64)
    return rng.integers(0, size, (count, 1, 2)) + rng.integers(-reach, reach + 1, (count, 3, 2))


def on_centres(rng: np.random.Generator, count: int, size: Ints) -> Ints:
    """Vertices on pixel centres or one subpx beside them: ties wherever there can be some."""
    return 256 * rng.integers(-4, size // 256 + 4, (count, 3, 2)) + 128 + rng.choice([-1, 0, 0, 0, 0, 1], (count, 3, 2))


def coarse(rng: np.random.Generator, count: int, size: Ints) -> Ints:
    """Few directions: level and upright edges, vertices in common, no area."""
    return 128 * rng.integers(-2, size // 1024, (count, 3, 2)) + 128 * rng.integers(0, size // 256, (count, 1, 2))


def through_a_centre(rng: np.random.Generator, count: int, size: Ints) -> Ints:
    """An edge exactly through a pixel centre, from and to anywhere, or past it by the least there is."""
    centre = 256 * rng.integers(0, size // 256, (count, 2)) + 128
    step = np.rint(rng.normal(size=(count, 2)) * 2.0 ** rng.uniform(0, 12, (count, 1))).astype(np.int64)
    before, behind = rng.integers(1, 600, (2, count, 1))
    beside = rng.choice([-1, 0, 0, 0, 1], (count, 2))
    third = rng.integers(-size, 2 * size, (count, 2))
    return inside_guard(np.stack([centre - before * step, centre + behind * step + beside, third], axis=1))


def slivers(rng: np.random.Generator, count: int, size: Ints) -> Ints:
    """A long edge through the screen, and a third vertex within 3 subpx of it: areas down to the least that there is."""
    middle = rng.integers(0, size, (count, 2))
    along = np.rint(rng.normal(size=(count, 2)) * 2.0 ** rng.uniform(8, 22, (count, 1))).astype(np.int64)
    a, b = middle - along, middle + np.rint(along * rng.uniform(0.1, 2, (count, 1))).astype(np.int64)
    c = np.rint(a + (b - a) * rng.uniform(-0.5, 1.5, (count, 1))).astype(np.int64) + rng.integers(-3, 4, (count, 2))
    return inside_guard(np.stack([a, b, c], axis=1))


def guard_band(rng: np.random.Generator, count: int, size: Ints) -> Ints:
    """Vertices anywhere in the guard band and at its ends, an edge through the screen: products of 49 bits."""
    xy = rng.integers(-GUARD, GUARD, (count, 3, 2))
    xy = np.where(rng.random((count, 3, 2)) < 0.1, rng.choice([-GUARD, GUARD - 1], (count, 3, 2)), xy)
    middle = rng.integers(0, size, (count, 2))
    towards = middle - xy[:, 0]
    xy[:, 1] = middle + np.rint(towards * rng.uniform(0, 1, (count, 1))).astype(np.int64)
    return inside_guard(xy)


def inside_guard(xy: Ints) -> Ints:
    return np.clip(xy, -GUARD, GUARD - 1)


FAMILIES: dict[str, Callable[[np.random.Generator, int, Ints], Ints]] = {
    f.__name__: f for f in (anywhere, sub_pixel, on_centres, coarse, through_a_centre, slivers, guard_band)
}


def depths(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """[count, 3] of all kinds: any, nearly equal, next to 0 and 1, and at them."""
    kind = rng.integers(0, 4, (count, 1))
    z = rng.uniform(0, 1, (count, 3))
    z = np.where(kind == 1, z[:, :1] + rng.integers(-2, 3, (count, 3)) * 2.0**-24, z)
    z = np.where(kind == 2, 2.0 ** -rng.uniform(0, 25, (count, 3)), z)
    return np.clip(np.where(kind == 3, rng.choice([0, 2.0**-25, 0.5, 1 - 2.0**-24, 1], (count, 3)), z), 0, 1)


def window_depths(corners: NDArray[np.float32]) -> NDArray[np.float32]:
    """float32 [N, 3] of clip-space corners [N, 3, 4] with w = 1."""
    return corners[..., 2] * np.float32(0.5) + np.float32(0.5)


def chunks(count: int, size: int) -> list[int]:
    return [min(size, count - first) for first in range(0, count, size)]


# --- Coverage and depth ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("height", "width", "count"), [(64, 64, 16_000), (32, 256, 4_000), (256, 512, 200)])
@pytest.mark.parametrize("name", FAMILIES)
def test_coverage_and_depth_are_exact(name: str, height: int, width: int, count: int, record_property) -> None:
    """No wrong pixel of any triangle; depth, at up to 2 pixels of each, within its bound."""
    rng = np.random.default_rng([40, height, *name.encode()])
    size = np.array([256 * width, 256 * height])
    fragments = samples = 0
    worst_ulp = worst_excess = 0.0
    for n in chunks(scaled(count) if native.available() else count // 20, max(1, 2**22 // (height * width))):
        xy = FAMILIES[name](rng, n, size)
        corners = on_grid(xy, depths(rng, n), (height, width)).astype(np.float32)
        seen = bigtri.rasterize(corners, ONE, (height, width))
        expected = covered(xy, height, width)
        wrong = np.argwhere((seen.triangle == 0) != expected)
        assert not len(wrong), f"{len(wrong)} wrong pixels, first {wrong[0][:0:-1].tolist()} of {xy[wrong[0][0]].tolist()}"
        fragments += int(expected.sum())

        pixel = np.flatnonzero(expected)
        view, y, x = np.unravel_index(pixel, expected.shape)
        tips = np.unique(view, return_index=True)[1]  # the first pixel of each triangle
        chosen = rng.permutation(np.concatenate([tips, rng.integers(0, max(1, len(view)), min(n, len(view)))]))[: max(60, n // 3)]
        view, y, x = view[chosen], y[chosen], x[chosen]
        z = seen.depth[view, y, x]
        ulps, excess = depth_errors(xy[view], window_depths(corners)[view], x, y, z)
        assert (excess <= DEPTH_ERROR).all(), (xy[view[excess.argmax()]].tolist(), excess.max())
        samples += len(chosen)
        worst_excess = max(worst_excess, excess.max(initial=0))
        worst_ulp = max(worst_ulp, ulps[z >= 2.0**-12].max(initial=0))  # below, 2^-39 is more than 1/16 ulp
    for key, value in (("fragments", fragments), ("depth samples", samples), ("worst ulp", worst_ulp)):
        record_property(key, float(value))
    beyond = f"2^{np.log2(worst_excess):.1f}" if worst_excess else "nothing"
    print(f"{name} {width}x{height}: {scaled(count)} triangles, {fragments} fragments; {samples} depths:", end=" ")
    print(f"{worst_ulp:.9f} ulp where z >= 2^-12, {beyond} beyond half an ulp")
    assert fragments > count // 10


def depth_errors(
    xy: Ints, corner_z: NDArray[np.float32], x: Ints, y: Ints, z: NDArray[np.float32]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """How far ``z`` [P] is from the exact depth: in units in the last place, and what it is beyond half of one, absolutely."""
    e = edge_values(xy, x, y)
    area = e.sum(axis=1)
    error = np.abs(as_ints(z) * area - (e * as_ints(corner_z)).sum(axis=1))  # times area * 2^149
    ulp = as_ints(np.spacing(z))
    half_ulp = ulp * area // 2  # ulp is 1 at least, and then area may be odd: a little less than half will do
    return (error / (ulp * area)).astype(np.float64), (np.maximum(error - half_ulp, 0) / (area * UNIT)).astype(np.float64)


def test_depth_beyond_the_far_plane_is_dropped_exactly(record_property) -> None:
    """Fragments are dropped where the rounded depth is > 1: the exact one beyond 1 + 2^-24, up to the bound of depth."""
    rng = np.random.default_rng(41)
    height, width = 64, 64
    compared = dropped = 0
    for n in chunks(scaled(2000), 500):
        xy = anywhere(rng, n, np.array([256 * width, 256 * height]))
        corners = on_grid(xy, 1 + rng.uniform(-1, 1, (n, 3)) * 10.0 ** rng.uniform(-7, 0, (n, 1)), (height, width)).astype(
            np.float32
        )
        seen = bigtri.rasterize(corners, ONE, (height, width))
        view, y, x = np.nonzero(covered(xy, height, width))
        chosen = rng.integers(0, len(view), 3 * n)
        view, y, x = view[chosen], y[chosen], x[chosen]
        e = edge_values(xy[view], x, y)
        exact = (e * as_ints(window_depths(corners)[view])).sum(axis=1) / (e.sum(axis=1) * UNIT)
        beyond = exact.astype(np.float64) - (1 + 2.0**-24)
        drawn = seen.triangle[view, y, x] == 0
        assert drawn[beyond < -DEPTH_ERROR].all() and not drawn[beyond > DEPTH_ERROR].any()
        compared, dropped = compared + len(drawn), dropped + int((~drawn).sum())
    record_property("pixels", compared)
    assert compared // 10 < dropped < compared


# --- Barycentrics and attributes ---------------------------------------------------------------------------------------------


def snapped(corners: NDArray[np.float32], height: int, width: int) -> Ints:
    """[N, 3, 2] of clip-space corners in the guard band: docs/numerics.md 2.2, which defines it by these operations."""
    p = corners.astype(np.float64)
    x = 128 * width + np.rint(p[..., 0] / p[..., 3] * (128 * width))
    y = 128 * height - np.rint(p[..., 1] / p[..., 3] * (128 * height))
    return np.stack([x, y], axis=-1).astype(np.int64)


def with_w(xy: Ints, z: NDArray[np.float64], w: NDArray[np.float64], resolution: tuple[int, int]) -> NDArray[np.float32]:
    """Clip-space corners with w [N, 3] that lie near the grid points ``xy``."""
    return (on_grid(np.clip(xy, 4096 - GUARD, GUARD - 4096), z, resolution) * w[..., None]).astype(np.float32)


@pytest.mark.parametrize("decades", [0, 1, 6, 25])
@pytest.mark.parametrize("name", FAMILIES)
def test_weights_and_attributes_are_exact_to_their_bounds(name: str, decades: int, record_property) -> None:
    """w ratios up to 10^decades, slivers and all."""
    rng = np.random.default_rng([42, decades, *name.encode()])
    height, width = 64, 64
    size = np.array([256 * width, 256 * height])
    total = samples = 0
    worst_ulp = worst_attribute = 0.0
    for n in chunks(scaled(1500) if native.available() else 200, 500):
        xy = FAMILIES[name](rng, n, size)
        w = 10.0 ** rng.uniform(-decades / 2, decades / 2, (n, 3)) if decades else np.full((n, 3), 2.5)
        corners = with_w(xy, rng.uniform(0, 1, (n, 3)), w, (height, width))
        values = (rng.normal(size=(n, 3, 2)) * 10.0 ** rng.uniform(-3, 3, (n, 1, 2))).astype(np.float32)
        seen = bigtri.rasterize(corners, ONE, (height, width))
        weights = bigtri.barycentrics(seen, corners, ONE)
        image = bigtri.interpolate(values, seen, corners, ONE)
        view, y, x = np.nonzero(seen.triangle == 0)
        b, a = weights[view, y, x], image[view, y, x]
        assert (b >= 0).all() and (b <= 1).all() and np.isfinite(a).all()  # NaN fails the first
        assert np.abs(b.astype(np.float64).sum(axis=1) - 1).max(initial=0) <= 2.0**-23
        total += len(view)

        chosen = rng.integers(0, max(1, len(view)), min(len(view), n))
        view, y, x, b, a = (v[chosen] for v in (view, y, x, b, a))
        e = edge_values(snapped(corners, height, width)[view], x, y)
        w_exact = as_ints(corners[view][..., 3])
        u = e * np.roll(w_exact, -1, axis=1) * np.roll(w_exact, -2, axis=1)
        whole = u.sum(axis=1, keepdims=True)
        error = np.abs(as_ints(b) * whole - u * UNIT)  # times whole * 2^149
        ulp = as_ints(np.spacing(b))
        bound = ulp * whole + (u * UNIT >> 49)  # twice: half an ulp, and 8 * 2^-53 * b
        assert (2 * error <= bound).all()
        worst_ulp = max(worst_ulp, float((error / (ulp * whole)).max(initial=0)))
        for channel in range(2):
            v = as_ints(values[view][..., channel])
            attribute_error = np.abs(as_ints(a[:, channel]) * whole[:, 0] - (u * v).sum(axis=1))
            size_of_terms = (u * np.abs(v)).sum(axis=1)
            assert (attribute_error << 42 <= (size_of_terms << 20) + size_of_terms).all()
            worst_attribute = max(worst_attribute, float(((attribute_error << 24) / np.maximum(size_of_terms, 1)).max(initial=0)))
        samples += len(view)
    for key, value in (("pixels", total), ("samples", samples), ("worst ulp", worst_ulp), ("worst attribute", worst_attribute)):
        record_property(key, float(value))
    print(f"{name}, w over 10^{decades}: {total} px, {samples} exact:", end=" ")
    print(f"weights {worst_ulp:.9f} ulp, attributes {worst_attribute:.3f} * 2^-24")
    assert samples > 100


@pytest.mark.parametrize("decades", [0, 2, 6, 12, 30])
def test_weights_of_clipped_triangles_place_the_pixel(decades: int, record_property) -> None:
    """Never outside [0, 1], never NaN, and the corners that they mix lie where the pixel is, to the half subpx of snapping.

    Per axis: each vertex of a record was moved by at most half a subpx, hence so is what its weights mix. What float32 weights
    add is 2^-23 of the terms' size.
    """
    rng = np.random.default_rng([43, decades])
    height, width = 64, 96
    pixels = clipped = 0
    for n in chunks(scaled(2000) if native.available() else 200, 500):
        corners = rng.normal(size=(n, 3, 4))
        corners[..., :2] *= 10.0 ** rng.uniform(-decades / 2, decades, (n, 3, 2))
        corners[..., 2] = np.minimum(corners[..., 2], corners[..., 3])
        corners = corners.astype(np.float32)
        seen = bigtri.rasterize(corners, ONE, (height, width))
        view, y, x = np.nonzero(seen.triangle == 0)
        b = bigtri.barycentrics(seen, corners, ONE)[view, y, x].astype(np.float64)
        assert (b >= 0).all() and (b <= 1).all()
        assert np.abs(b.sum(axis=1) - 1).max(initial=0) <= 2.0**-23
        position = (b[..., None] * corners[view]).sum(axis=1)
        size = (b[..., None] * np.abs(corners[view])).sum(axis=1)
        centre = np.stack([(2 * x + 1 - width) / width, (height - 2 * y - 1) / height], axis=1)
        off = np.abs(position[:, :2] - centre * position[:, 3:])
        half_subpixel = 0.5 / np.array([128 * width, 128 * height]) * np.abs(position[:, 3:])
        rounding = 2.0**-23 * (size[:, :2] + np.abs(centre) * size[:, 3:]) + half_subpixel * 1e-6
        assert (off <= half_subpixel + rounding).all(), corners[
            view[(off - half_subpixel - rounding).max(axis=1).argmax()]
        ].tolist()
        pixels += len(view)
        inside = (np.abs(corners[..., :3]) <= corners[..., 3:]).all(axis=2)[view]
        clipped += int((~inside).any(axis=1).sum())
    record_property("pixels", pixels)
    print(f"xy over 10^{decades}: {pixels} px, most of clipped triangles")
    assert pixels > 1000 and clipped > 500


def test_weights_of_any_floats_are_weights() -> None:
    """All of float32's range, slivers and all: in [0, 1], of sum 1."""
    rng = np.random.default_rng(44)
    height, width = 32, 48
    pixels = 0
    for n in chunks(scaled(15_000) if native.available() else 500, 2000):
        corners = rng.normal(size=(n, 3, 4)) * 10.0 ** rng.uniform(-37, 37, (n, 3, 4))
        corners[::2, 2] = corners[::2, 1] * (1 + rng.normal(size=(len(corners[::2]), 4)) * 1e-6)
        corners = corners.astype(np.float32)
        seen = bigtri.rasterize(corners, ONE, (height, width))
        b = bigtri.barycentrics(seen, corners, ONE)[seen.triangle == 0].astype(np.float64)
        assert (b >= 0).all() and (b <= 1).all()
        assert np.abs(b.sum(axis=1) - 1).max(initial=0) <= 2.0**-23
        pixels += len(b)
    assert pixels > 1000

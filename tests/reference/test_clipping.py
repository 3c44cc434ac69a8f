"""Clipping: the true picture to 1/256 px, the same vertices on shared edges, no gap and no overlap, closed meshes stay closed."""

from __future__ import annotations

from collections.abc import Callable
from math import isqrt

import numpy as np
import pytest
import torch
import trimesh
from counting import fragments, fragments_by_triangle, scaled, soup
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import bigtri
from bigtri import native
from bigtri.check import stages
from bigtri.reference.clip import clip, clip_planes

FLOAT32_MAX = float(np.finfo(np.float32).max)

# --- The true picture --------------------------------------------------------------------------------------------------------


def true_side(corners: NDArray[np.float32], height: int, width: int) -> NDArray[np.int64]:
    """int64 [H, W] of a triangle [3, 4]: 1 where a pixel's centre is inside it by more than 1/256 px, -1 outside by more, else 0.

    Inside means: seen in front of the eye, at z >= -w and z <= 4w. What is seen edge-on has no inside, but a border where it may
    show after snapping. Exact: integers throughout, by Cramer's rule on (x, y, w), so
    that neither projection nor clipping is computed. Shares no code with bigtri, nor with its brute force.
    """
    x = (2 * np.arange(width) + 1).astype(object)[None, :]  # in half pixels, as Python's integers
    y = (2 * np.arange(height) + 1).astype(object)[:, None]
    side = np.ones((height, width), np.int64)
    for nx, ny, nw in half_planes(integers(corners)):
        slope_x, slope_y = height * nx, -width * ny  # per half pixel
        value = slope_x * x + slope_y * y + width * height * (nw - nx + ny)
        margin = isqrt((slope_x * slope_x + slope_y * slope_y) >> 14)  # 1/256 px are 1/128 half pixels
        side = np.minimum(side, (value > margin).astype(np.int64) - (value < -margin).astype(np.int64))
    return side


def true_side_at(corners: NDArray[np.float32], height: int, width: int, pixels: list[tuple[int, int]]) -> NDArray[np.int64]:
    """``true_side`` at the ``pixels`` (x, y) alone, each as the only one of an image of its own: for large images."""
    points = integers(corners)
    sides = []
    for px, py in pixels:
        # Half pixels from the pixel's centre, in place of normalized device coordinates.
        moved = [(width * x - (2 * px + 1 - width) * w, height * y - (height - 2 * py - 1) * w, z, w) for x, y, z, w in points]
        side = 1
        for nx, ny, nw in half_planes(moved):
            margin = isqrt((nx * nx + ny * ny) >> 14)
            side = min(side, (nw > margin) - (nw < -margin))
        sides.append(side)
    return np.array(sides)


def integers(corners: NDArray[np.float32]) -> list[tuple[int, ...]]:
    """The corners [3, 4] times the power of two that makes them integers."""
    ratios = [[c.as_integer_ratio() for c in corner] for corner in corners.tolist()]
    unit = max(denominator for corner in ratios for _, denominator in corner)
    return [tuple(numerator * (unit // denominator) for numerator, denominator in corner) for corner in ratios]


def half_planes(points: list[tuple[int, ...]]) -> list[tuple[int, ...]]:
    """(a, b, c) with a * x/w + b * y/w + c >= 0, whose intersection is what a triangle of (x, y, z, w) shows."""
    a, b, c = ((x, y, w) for x, y, _, w in points)
    normals = [_cross(b, c), _cross(c, a), _cross(a, b)]
    determinant = sum(n * v for n, v in zip(normals[0], a, strict=True))
    if determinant == 0:  # edge-on: the line that it is seen as, or nothing
        line = next((normal for normal in normals if any(normal)), (0, 0, -1))
        return [line, tuple(-n for n in line)]
    if determinant < 0:
        normals = [tuple(-n for n in normal) for normal in normals]
    edges = normals[:]
    for distances in ([z + w for _, _, z, w in points], [4 * w - z for _, _, z, w in points]):
        normals.append(tuple(sum(d * n[k] for d, n in zip(distances, edges, strict=True)) for k in range(3)))
    return normals


def _cross(a: tuple[int, ...], b: tuple[int, ...]) -> tuple[int, ...]:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def wrong_pixels(drawn: NDArray[np.int64], side: NDArray[np.int64]) -> int:
    """Pixels not drawn exactly once inside, or drawn outside."""
    return int(((side == 1) & (drawn != 1)).sum() + ((side == -1) & (drawn != 0)).sum())


Corners = NDArray[np.float64]
MAGNITUDES = np.concatenate([[0, 0, 0.5, 1, 1, 1, 2, 3], 2.0 ** np.arange(-120, 128, 8), 10.0 ** np.arange(-35, 39, 4)])


def near_plane(rng: np.random.Generator, count: int) -> Corners:
    """Around the eye: w of either sign, the near plane across the picture."""
    return rng.normal(size=(count, 3, 4)) * [1, 1, 1, 0.8]


def grazing_near(rng: np.random.Generator, count: int) -> Corners:
    """A vertex on the near plane, or beside it by some units in the last place."""
    corners = rng.normal(size=(count, 3, 4))
    corners[:, 0, 2] = -corners[:, 0, 3].astype(np.float32) * (1 + rng.integers(-3, 4, count) * 2.0**-24)
    return corners


def guard_planes(rng: np.random.Generator, count: int) -> Corners:
    """Out of the guard band by any amount, in front of the eye."""
    corners = rng.normal(size=(count, 3, 4))
    corners[..., :2] *= 10.0 ** rng.uniform(0, 37, (count, 3, 2))
    corners[..., 3] = rng.uniform(0.5, 2, (count, 3))
    corners[..., 2] *= 0.3
    return corners


def both(rng: np.random.Generator, count: int) -> Corners:
    """Across the eye and far out of the guard band."""
    corners = rng.normal(size=(count, 3, 4))
    corners[..., :2] *= 10.0 ** rng.uniform(-5, 37, (count, 3, 2))
    return corners


def vertices_of_all_sizes(rng: np.random.Generator, count: int) -> Corners:
    """Vertices that are 10^37 times as long as their neighbours."""
    return rng.normal(size=(count, 3, 4)) * 10.0 ** rng.uniform(-37, 37, (count, 3, 1))


def components_of_all_sizes(rng: np.random.Generator, count: int) -> Corners:
    return rng.normal(size=(count, 3, 4)) * 10.0 ** rng.uniform(-37, 37, (count, 3, 4))


def simple_numbers(rng: np.random.Generator, count: int) -> Corners:
    """Zeros, ones, powers of two and of ten: vertices on planes, equal components, exact cancellation."""
    return rng.choice(MAGNITUDES, (count, 3, 4)) * rng.choice([-1, 1], (count, 3, 4))


def mirrored(rng: np.random.Generator, count: int) -> Corners:
    """Vertices that are each other's mirror images in some components, however large: edges through the middle of the picture."""
    vertex = (rng.normal(size=(count, 1, 4)) * 10.0 ** rng.uniform(-3, 30, (count, 1, 4))).astype(np.float32)
    return vertex * rng.choice([-1, 1, 0.5, -0.5, 0, 1 / 3, -3], (count, 3, 4))


def through_the_screen(rng: np.random.Generator, count: int) -> Corners:
    """Long triangles around a point of the near plane that is on the screen."""
    seen = np.concatenate([rng.uniform(-1, 1, (count, 3, 2)), np.ones((count, 3, 2)) * [-1, 1]], axis=2)
    away = rng.normal(size=(count, 1, 4)) * 10.0 ** rng.uniform(-3, 10, (count, 1, 4))
    return seen * rng.uniform(0.1, 3, (count, 3, 1)) + away * rng.uniform(-1, 1, (count, 3, 1)) * 10.0 ** rng.uniform(
        -4, 4, (count, 3, 1)
    )


FAMILIES: dict[str, Callable[[np.random.Generator, int], Corners]] = {
    f.__name__: f
    for f in (
        near_plane,
        grazing_near,
        guard_planes,
        both,
        vertices_of_all_sizes,
        components_of_all_sizes,
        simple_numbers,
        mirrored,
        through_the_screen,
    )
}


@pytest.mark.parametrize("name", FAMILIES)
def test_the_picture_is_the_true_one_to_a_subpixel(name: str) -> None:
    """Every pixel of every triangle against exact rational clipping: only centres within 1/256 px of a true edge may differ."""
    height, width = 12, 16
    corners = FAMILIES[name](np.random.default_rng([30, *name.encode()]), scaled(1500)).astype(np.float32)
    corners = corners[np.isfinite(corners).all(axis=(1, 2))]
    positions, triangles = soup(corners)
    certain = 0
    for first in range(0, len(corners), 1000):
        drawn = fragments_by_triangle(positions, triangles[first : first + 1000], (height, width))
        for corner, count in zip(corners[first : first + 1000], drawn, strict=True):
            side = true_side(corner, height, width)
            assert not wrong_pixels(count, side), corner.tolist()
            certain += (side == 1).sum()
    assert certain > 2 * len(corners)
    assert stages.setup(positions, triangles, height, width)[0].clipped.sum() > len(corners) // 10


@pytest.mark.parametrize("resolution", [(1080, 1920), (16384, 16384), (1, 16384)])
@pytest.mark.parametrize("name", ["near_plane", "both", "mirrored"])
def test_the_picture_is_the_true_one_on_real_screens(name: str, resolution: tuple[int, int]) -> None:
    """The guard planes, and what 1/256 px is, depend on the size: random pixels, covered or not by hand."""
    height, width = resolution
    rng = np.random.default_rng([31, *name.encode()])
    corners = FAMILIES[name](rng, scaled(60)).astype(np.float32)
    positions, triangles = soup(corners[np.isfinite(corners).all(axis=(1, 2))])
    records, _ = stages.setup(positions, triangles, height, width)
    compared = 0
    for index in range(len(triangles)):
        x, y = rng.integers(0, width, 40), rng.integers(0, height, 40)
        mine = np.flatnonzero(records.triangle == index)
        drawn = sum((covers(records.xy[r], records.bbox[r], x, y) for r in mine), np.zeros(40, np.int64))
        side = true_side_at(positions[triangles[index]], height, width, list(zip(x.tolist(), y.tolist(), strict=True)))
        assert not wrong_pixels(drawn, side), positions[triangles[index]].tolist()
        compared += (side == 1).sum()
    assert compared > 100


def covers(xy: NDArray[np.int32], bbox: NDArray[np.int32], x: NDArray[np.int64], y: NDArray[np.int64]) -> NDArray[np.int64]:
    """Whether the centres of pixels (x, y) [P] are in a record's triangle [3, 2], by the signs of int64 edge functions."""
    corners = xy.astype(np.int64)
    inside = (x >= bbox[0]) & (x < bbox[2]) & (y >= bbox[1]) & (y < bbox[3])
    for k in range(3):
        (px, py), (qx, qy) = corners[(k + 1) % 3], corners[(k + 2) % 3]
        value = (qx - px) * (256 * y + 128 - py) - (qy - py) * (256 * x + 128 - px)
        inside &= (value > 0) | ((value == 0) & ((qy < py) | ((qy == py) & (qx > px))))
    return inside.astype(np.int64)


def ends_that_cancel(rng: np.random.Generator) -> NDArray[np.float32]:
    """[2, 4]: the ends of an edge that meets the near plane near the middle of the picture, though both are far to the sides.

    With ints a, b, c, d such that a * d - 2^20 * b * c = 1, x = -b and 2^-20 * a, and distances d and -c from the plane: what is
    left at the plane is the last of 69 bits.
    """
    while True:
        c, d = int(rng.integers(4, 8)) | 1, int(rng.integers(2**22, 2**23)) | 1
        try:
            b = -pow(c << 20, -1, d) % d
        except ValueError:  # not coprime
            continue
        a = ((c * b << 20) + 1) // d
        if b >> 22 and not a >> 24:
            break
    unit = 2.0**-23
    p, q = int(rng.integers(2**21, 2**22)) * unit, int(rng.integers(2**22, 2**23)) * unit  # z of the one, -z of the other
    return np.array([[-b * 2.0**42, 0.1, p, d * unit - p], [a * 2.0**22, 0.2, -q, q - c * unit]], np.float32)


def test_the_picture_is_the_true_one_where_the_ends_of_an_edge_cancel() -> None:
    """Found by construction: the new vertex is up to half a screen off, since its terms are rounded before they cancel."""
    rng = np.random.default_rng(29)
    height, width = 16, 16
    for _ in range(20):
        ends = ends_that_cancel(rng)
        corners = np.stack([ends[0], ends[1], ends[1] * np.float32([1, 0, 1, 1]) - np.float32([0, 0.5, 0, 0])])
        positions, triangles = soup(corners[None])
        wrong = wrong_pixels(fragments(positions, triangles, (height, width)), true_side(corners, height, width))
        assert not wrong, (wrong, corners.tolist())


@pytest.mark.parametrize("device", native.devices())
def test_no_depth_is_negative(device: str) -> None:
    """Of negative floats the order of bits is reversed. Within an ulp of the near plane, rounding would leave a vertex made by
    two other planes in front of it, by some 1e-16.
    """
    cut = (
        ("0x1.55718ep+20", "0x1.44a348p-13", "-0x1.99e56ep-13", "0x1.99e57p-13"),
        ("-0x1.e0b9a4p+38", "0x1.74f26ap+37", "-0x1.abb102p+39", "0x1.abb102p+39"),
        ("0x1.44ba9ep-34", "0x1.c4903ep-34", "-0x1.6f5728p-57", "0x1.6f5728p-57"),
    )
    positions = torch.tensor([[float.fromhex(number) for number in vertex] for vertex in cut], dtype=torch.float32)
    triangles = torch.arange(3, dtype=torch.int32)[None]
    expected = bigtri.rasterize(positions, triangles, (480, 640), backend="reference").packed
    assert (expected >= 0).all() and (expected < 2**63 - 1).sum() > 70_000
    for variant in native.VARIANTS[device]:
        got = bigtri.rasterize(positions.to(device), triangles.to(device), (480, 640), backend="native", variant=variant)
        assert torch.equal(got.packed.cpu(), expected), variant


def test_the_picture_is_the_true_one_where_a_vertex_lies_on_the_near_plane() -> None:
    """Found among simple numbers: an edge from a vertex exactly on the near plane to one behind the eye and far to the side.

    It meets the plane in the first, which is seen below the middle of the picture; what is computed is the middle itself.
    """
    corners = np.float32([[0, 0, 256, 10], [-1e25, -(2.0**120), -1e37, 1e37], [2.0**120, 2.0**112, 0, -(2.0**-32)]])
    positions, triangles = soup(corners[None])
    drawn = fragments(positions, triangles, (12, 16))
    assert not wrong_pixels(drawn, true_side(corners, 12, 16)), drawn


finite = st.floats(width=32, allow_nan=False, allow_infinity=False)
vertex = st.tuples(finite, finite, finite, finite)


@settings(max_examples=scaled(300), deadline=None)
@given(st.tuples(vertex, vertex, vertex))
@example(((3e38, 3e38, 0, 1e-38), (-3e38, 3e38, 0, 1e-38), (0, -3e38, 0, 1e-38)))
@example(((0, 0, 0, 1), (1, 1, 0, 0), (-1, -1, 0, 1)))  # edge-on
@example(((FLOAT32_MAX, 0, 0, 1), (-FLOAT32_MAX, FLOAT32_MAX, 0, 1), (-FLOAT32_MAX, -FLOAT32_MAX, 0, 1)))
def test_the_picture_is_the_true_one_whatever_the_floats(corners: tuple[tuple[float, ...], ...]) -> None:
    """A search with shrinking over all finite float32 values."""
    positions, triangles = soup(np.array([corners]))
    assert not wrong_pixels(fragments(positions, triangles, (7, 9)), true_side(positions, 7, 9))


# --- The same vertices on shared edges ---------------------------------------------------------------------------------------


def on_shared_edge(quads: NDArray[np.float64], order: NDArray[np.int64]) -> tuple[NDArray[np.uint64], NDArray[np.bool_]]:
    """The vertices that a clipped triangle has on the edge from corner 1 to corner 2 of its quad.

    Args:
        quads: [N, 4, 4].
        order: [N, 3], the corners of the quad that are the triangle's vertices, in this order.

    Returns:
        uint64 [M, 6]: (quad, position bits, set of planes), each once, sorted. bool [N]: whether anything is left to draw.
    """
    polygons, first = clip(np.take_along_axis(quads, order[:, :, None], axis=1), clip_planes(77, 133))
    slots = np.take_along_axis(order, first, axis=1)  # the quad's corner that slot m is
    shared = np.isin(slots, [1, 2])
    # Edge j joins slots j and j + 1; exactly one of the three has both ends shared.
    edge = np.argmax(shared & shared[:, [1, 2, 0]], axis=1)
    is_on = (polygons.edges >> edge[polygons.owner].astype(np.uint8)) & 1 == 1
    keys = np.concatenate(
        [
            polygons.owner[is_on, None].astype(np.uint64),
            np.ascontiguousarray(polygons.position[is_on]).view(np.uint64),
            polygons.made[is_on, None].astype(np.uint64),
        ],
        axis=1,
    )
    drawn = np.zeros(len(quads), np.bool_)
    drawn[polygons.owner] = True
    return np.unique(keys, axis=0), drawn


@pytest.mark.parametrize("exponent", [-30, -20, -10, -3, 0, 3, 10, 20, 30])
def test_neighbours_get_the_same_vertices_in_bits(exponent: int, record_property) -> None:
    """Two triangles of a quad, each with its vertices in any order, hence the shared edge in any direction: one set of vertices.

    Their third corners are independent, so that one neighbour may be cut by planes that the other does not meet.
    """
    rng = np.random.default_rng([32, exponent + 50])
    count = scaled(16_000)
    spread = rng.uniform(0, 4, (count, 1, 1)) * rng.choice([0, 1], (count, 4, 1))  # of the corners of a quad, decades
    quads = rng.normal(size=(count, 4, 4)) * 10.0 ** (exponent + spread)
    quads[: count // 2, :, 3] = np.abs(quads[: count // 2, :, 3])  # half of them with fewer vertices behind the eye
    quads[::3, 1:3, :2] *= 0.01  # a third with the shared edge in view
    quads = quads.astype(np.float32).astype(np.float64)
    orders = [rng.permuted(np.tile(corners, (count, 1)), axis=1) for corners in ([0, 1, 2], [3, 1, 2])]
    (one, drawn), (two, also_drawn) = (on_shared_edge(quads, order) for order in orders)
    is_compared = drawn & also_drawn
    one, two = (keys[is_compared[keys[:, 0].astype(np.int64)]] for keys in (one, two))
    compared = len(np.unique(one[:, 0]))
    new = int((one[:, 5] != 0).sum())
    record_property("shared edges", compared)
    record_property("new vertices", new)
    print(f"scale 1e{exponent}: {compared} shared edges, {new} new vertices")
    np.testing.assert_array_equal(one, two)
    assert compared > count // 4 and new > count // 4


def test_a_cut_neighbour_keeps_the_vertices_of_an_uncut_one() -> None:
    """One triangle is not clipped, the other only by its far corner: snapped vertices and depths of the edge agree in bits."""
    rng = np.random.default_rng(33)
    count = scaled(20_000)
    quads = rng.uniform(-1, 1, (count, 4, 4)) * [1, 1, 0.9, 0] + [0, 0, 0, 1] * rng.uniform(1, 3, (count, 4, 1))
    quads[:, 3] = rng.normal(size=(count, 4)) * 10.0 ** rng.uniform(3, 30, (count, 1))
    positions = quads.astype(np.float32).reshape(-1, 4)
    first = 4 * np.arange(count)[:, None]
    height, width = 77, 133
    seen = []
    for corners in (np.array([0, 1, 2]), np.array([1, 2, 3])):
        records, _ = stages.setup(positions, (first + corners).astype(np.int32), height, width)
        assert records.clipped.mean() > 0.7 if corners[2] == 3 else not records.clipped.any()
        # Of a clipped triangle, a vertex that has weight in one slot only is that corner.
        slot = np.where(records.clipped[:, None], np.argmax(records.weights, axis=2), np.arange(3))  # [N, 3]
        is_corner = (records.weights != 0).sum(axis=2) == 1
        corner = corners[np.take_along_axis(records.corner, slot, axis=1)]
        n, k = np.nonzero(is_corner & np.isin(corner, [1, 2]))
        bits = zip(records.xy[n, k, 0], records.xy[n, k, 1], records.z.view(np.int32)[n, k], strict=True)
        seen.append(dict(zip(zip(records.triangle[n].tolist(), corner[n, k].tolist(), strict=True), bits, strict=True)))
    in_both = seen[0].keys() & seen[1].keys()  # a part of a fan that shows no pixel has no record
    assert len(in_both) > count // 2
    assert all(seen[0][key] == seen[1][key] for key in in_both)


# --- Neither gap nor overlap -------------------------------------------------------------------------------------------------


def subdivided(parts: int) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Weights [V, 3], of sum ``parts``, and triangles [parts^2, 3] of a triangle cut into parts^2 equal ones."""
    place = {(i, j): k for k, (i, j) in enumerate((i, j) for i in range(parts + 1) for j in range(parts + 1 - i))}
    weights = np.array([(parts - i - j, i, j) for i, j in place])
    upright = [(place[i, j], place[i + 1, j], place[i, j + 1]) for i, j in place if i + j < parts]
    turned = [(place[i + 1, j], place[i + 1, j + 1], place[i, j + 1]) for i, j in place if i + j < parts - 1]
    return weights, np.array(upright + turned, np.int32)


@pytest.mark.parametrize("exponent", [0, 5, 10, 30, 60, 100])
def test_flat_meshes_cover_each_pixel_once(exponent: int, record_property) -> None:
    """A triangle cut into 256 parts, in any order, across the near plane and the guard planes, up to 2^100.

    Corners are small integers times a power of two for each component, so that the parts lie exactly where the whole is: inside
    it, each pixel once; outside never. Parts narrower than the sub-pixel grid may fold over when they are snapped; a pixel then
    has a front and a back face more, which cancel. Where nothing folds over, all faces are of one kind.
    """
    rng = np.random.default_rng([34, exponent])
    height, width = 33, 47
    weights, faces = subdivided(16)
    inside = clipped = folded = 0
    for _ in range(scaled(400)):
        corners = np.rint(rng.normal(size=(3, 4)) * 2.0 ** rng.uniform(4, 15, 4))
        corners[:, 2] = np.minimum(corners[:, 2], corners[:, 3])  # nothing beyond the far plane
        size = 2.0 ** np.array([*rng.integers(-exponent // 4, exponent + 1, 2), 0, 0])  # of x, y, z and w
        corners *= size
        vertices = weights @ corners
        positions = vertices.astype(np.float32)
        assert (positions == vertices).all()
        order = np.roll(faces[rng.permutation(len(faces))], rng.integers(0, 3), axis=1)
        side = true_side(corners.astype(np.float32), height, width)
        front, back = (fragments(positions, order, (height, width), cull) for cull in ("back", "front"))
        sign = 1 if front.sum() > back.sum() else -1
        assert not wrong_pixels(sign * (front - back), side), corners.tolist()
        folded += bool(front.any() and back.any())
        inside += (side == 1).sum()
        clipped += stages.setup(positions, order, height, width)[0].clipped.sum()
    record_property("pixels", int(inside))
    print(f"up to 2^{exponent}: {inside} pixels inside, {clipped} clipped parts in view")
    assert inside > 3000 and clipped > 50 and folded < scaled(400) // 20


@pytest.mark.parametrize("reach", [1e2, 1e5, 1e10, 1e20, 1e30])
def test_a_floor_cut_by_the_near_plane_has_no_hole(reach: float) -> None:
    """A floor around the eye, out to ``reach`` in all directions, cut across the picture by the near plane: below the horizon and
    before the cut each pixel once. Its grid grows outwards, so that near and far cells are of one size on the screen."""
    rng = np.random.default_rng(35)
    height, width = 120, 161
    steps = np.concatenate([[0], np.geomspace(0.05, reach, 16)])
    axis = np.concatenate([-steps[:0:-1], steps])
    gx, gz = np.meshgrid(axis, axis)
    n = len(axis)
    corner = np.arange(n * n).reshape(n, n)
    a, b, c, d = (v.reshape(-1) for v in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]))
    flip = rng.integers(0, 2, len(a))[:, None] == 1
    faces = np.concatenate(
        [np.where(flip, np.stack(one, 1), np.stack(two, 1)) for one, two in (((a, b, c), (a, b, d)), ((a, c, d), (b, c, d)))]
    ).astype(np.int32)
    for _ in range(scaled(40)):
        angle, tilt, near = rng.uniform(0, 2 * np.pi), rng.uniform(-0.6, 0.6), rng.uniform(0.05, 1.5)
        x = gx * np.cos(angle) - gz * np.sin(angle)
        z = gx * np.sin(angle) + gz * np.cos(angle)  # to the front
        y = -1.0
        depth = z * np.cos(tilt) - y * np.sin(tilt)
        up = z * np.sin(tilt) + y * np.cos(tilt)
        # Infinite far plane: z/w from -1 at ``near`` to 1.
        clip_space = np.stack([x, up * width / height, depth - 2 * near, depth], axis=-1).reshape(-1, 4).astype(np.float32)
        count = fragments(clip_space, faces, (height, width))
        # The direction through a pixel hits the floor at w = t: t * (v cos(tilt) - sin(tilt)) = -1 with v = up / depth.
        v = (1 - 2 * (np.arange(height) + 0.5) / height) * height / width
        falls = np.sin(tilt) - v * np.cos(tilt)  # > 0: towards the floor
        w = 1 / np.where(falls > 0, falls, np.nan)
        rows = (w > near * 1.001) & (w < reach * 0.05)
        margin = 1.5 / height  # px of the horizon and of the cut are left out
        rows &= (falls > margin) & (np.abs(falls - 1 / near) > margin)
        beyond = (w < near * 0.999) & (np.abs(falls - 1 / near) > margin)
        assert (count[rows] == 1).all()
        assert (count[beyond | (falls < -margin)] == 0).all()


# --- Closed meshes -----------------------------------------------------------------------------------------------------------


def shapes() -> dict[str, tuple[trimesh.Trimesh, Callable[[NDArray[np.float64]], NDArray[np.bool_]]]]:
    """Closed meshes, and a function that says of points [N, 3] whether they are clearly inside (True) or outside."""
    sphere = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
    torus = trimesh.creation.torus(major_radius=1.0, minor_radius=0.4, major_sections=28, minor_sections=14)
    spiky = sphere.copy()
    spiky.vertices *= np.random.default_rng(36).uniform(0.7, 1.6, (len(spiky.vertices), 1))
    return {
        "box": (trimesh.creation.box((2, 2, 2)), lambda p: np.abs(p).max(axis=1) < 1),
        "icosphere": (sphere, lambda p: np.linalg.norm(p, axis=1) < 1),
        "torus": (torus, lambda p: np.hypot(np.hypot(p[:, 0], p[:, 1]) - 1, p[:, 2]) < 0.4),
        "spiky": (spiky, lambda p: np.linalg.norm(p, axis=1) < 0.7),
    }


SHAPES = shapes()


def cameras(rng: np.random.Generator, name: str, count: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Positions [count, 3] a good deal farther from the surface than the near plane, and whether each is inside."""
    p = rng.normal(size=(20 * count, 3))
    p *= (10.0 ** rng.uniform(-1.5, 0.9, (len(p), 1))) / np.linalg.norm(p, axis=1, keepdims=True)
    if name == "torus":
        angle, r = rng.uniform(0, 2 * np.pi, len(p) // 2), rng.uniform(0, 0.33, len(p) // 2)
        tube = rng.uniform(0, 2 * np.pi, len(p) // 2)
        ring = 1 + r * np.cos(tube)
        p[: len(p) // 2] = np.stack([ring * np.cos(angle), ring * np.sin(angle), r * np.sin(tube)], axis=1)
        away = np.abs(np.hypot(np.hypot(p[:, 0], p[:, 1]) - 1, p[:, 2]) - 0.4) > 0.06
    elif name == "box":
        away = np.abs(np.abs(p).max(axis=1) - 1) > 0.05
    else:
        radius = np.linalg.norm(p, axis=1)
        away = (radius < 0.93) | (radius > 1.03) if name == "icosphere" else (radius < 0.6) | (radius > 1.65)
    p = p[away]
    inside = SHAPES[name][1](p)
    half = count // 2
    chosen = np.concatenate([np.flatnonzero(inside)[:half], np.flatnonzero(~inside)[: count - half]])
    assert len(chosen) == count
    return p[chosen], inside[chosen]


@pytest.mark.parametrize("name", SHAPES)
def test_closed_meshes_are_crossed_evenly_from_outside_and_oddly_from_inside(name: str, record_property) -> None:
    """From random cameras, of any angle of view, each pixel sees as many front as back faces, and from inside one back face more.

    The near plane cuts only what is beside or behind the eye, out of the picture; from inside it always cuts something.
    """
    rng = np.random.default_rng([37, *name.encode()])
    mesh, _ = SHAPES[name]
    assert mesh.is_watertight and mesh.is_winding_consistent
    eyes, inside = cameras(rng, name, scaled(800))
    faces = mesh.faces.astype(np.int32)
    height, width = 40, 56
    clipped = crossings = 0
    for eye, is_inside in zip(eyes, inside.tolist(), strict=True):
        view = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        view *= np.sign(np.linalg.det(view))  # a rotation
        p = (mesh.vertices - eye) @ view.T
        near, far = 0.004, 50.0
        focal = 10.0 ** rng.uniform(-0.5, 1.2, 2)  # the widest reaches 0.004 * 3.3 * sqrt(2) to the side at the near plane
        z = -(p[:, 2] * (far + near) + 2 * far * near) / (far - near)
        positions = np.stack([focal[0] * p[:, 0], focal[1] * p[:, 1], z, -p[:, 2]], axis=1).astype(np.float32)
        front, back = (fragments(positions, faces, (height, width), cull) for cull in ("back", "front"))
        assert (back - front == is_inside).all(), (eye.tolist(), view.tolist(), focal.tolist())
        crossings += int((front + back).sum())
        before = (positions[:, 2] + positions[:, 3] >= 0)[faces]
        clipped += int((before.any(axis=1) & ~before.all(axis=1)).any())
    record_property("cameras", len(eyes))
    print(f"{name}: {len(eyes)} cameras, {clipped} of them with clipped triangles, {crossings} crossings")
    assert clipped > 0.45 * len(eyes) and crossings > 1000 * len(eyes)

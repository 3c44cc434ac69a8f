"""Setup: dropping, clipping, snapping, orientation and culling, against the scalar oracle and against what each rule says."""

import itertools

import numpy as np
import pytest

from bigtri.reference import Records, brute_force, setup
from bigtri.reference.clip import DEPTH, NEAR, X_HIGH, X_LOW, Y_HIGH, Y_LOW, clip, clip_planes

GUARD = 2**23
SIZE = 256  # px; with a power of two, snapped coordinates can be chosen exactly


def random_triangles(seed: int, count: int, decades: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices with w of either sign, whose components spread over ``decades`` powers of ten to both sides of 1."""
    rng = np.random.default_rng(seed)
    positions = rng.normal(size=(count, 4)) * 10.0 ** rng.uniform(-decades, decades, (count, 4))
    return positions.astype(np.float32), rng.integers(0, count, (count, 3)).astype(np.int32)


def on_grid(x: int, y: int, z: float = 0.5, w: float = 1.0) -> list[float]:
    """A clip-space position that snaps to (x, y), subpx, in an image of SIZE x SIZE px and has window depth z."""
    half = 128 * SIZE
    return [(x - half) / half * w, (half - y) / half * w, (2 * z - 1) * w, w]


def setup_one(*corners: list[float], **options) -> Records:
    records, _ = setup(np.array(corners, np.float32), np.array([[0, 1, 2]], np.int32), SIZE, SIZE, **options)
    return records


def assert_same(records: Records, expected: list[brute_force.Record]) -> None:
    assert len(records.triangle) == len(expected)
    for name, field in zip(Records._fields, records, strict=True):
        np.testing.assert_array_equal(field, np.array([getattr(e, name) for e in expected]).reshape(field.shape), name)


@pytest.mark.parametrize("decades", [0.3, 1, 3, 6, 12, 37])
@pytest.mark.parametrize(("height", "width"), [(77, 133), (1, 1), (16384, 16384)])
def test_records_equal_the_scalar_ones(decades: float, height: int, width: int) -> None:
    positions, triangles = random_triangles(int(decades), 600, decades)
    records, dropped = setup(positions, triangles, height, width)
    expected, expected_dropped = brute_force.records(positions, triangles, height, width)
    assert_same(records, expected)
    assert dropped == expected_dropped == 0
    if (height, width) == (77, 133) and decades <= 12:
        assert records.clipped.sum() > 20 and len(np.unique(records.triangle)) < len(records.triangle)


@pytest.mark.parametrize("cull", ["none", "back", "front"])
@pytest.mark.parametrize("scissor", [None, (10, 20, 50, 30), (-5, -5, 1000, 1000), (40, 40, 40, 60)])
def test_culling_and_scissor_equal_the_scalar_ones(cull: str, scissor: tuple[int, int, int, int] | None) -> None:
    positions, triangles = random_triangles(3, 400, 1)
    records, _ = setup(positions, triangles, 77, 133, cull, scissor)
    assert_same(records, brute_force.records(positions, triangles, 77, 133, cull, scissor)[0])


def test_field_types() -> None:
    records = setup_one(on_grid(0, 0), on_grid(5000, 0), on_grid(0, 5000))
    kinds = ["int32", "int32", "float32", "int64", "int32", "float64", "int32", "float64", "bool", "float32"]
    assert [field.dtype.name for field in records] == kinds
    shapes = [(1,), (1, 3, 2), (1, 3), (1,), (1, 4), (1, 3), (1, 3), (1, 3, 3), (1,), (1, 0, 2)]
    assert [field.shape for field in records] == shapes
    none, _ = setup(np.zeros((0, 4), np.float32), np.zeros((0, 3), np.int32), 5, 7)
    assert [field.dtype.name for field in none] == kinds
    assert [field.shape for field in none] == [(0, *shape[1:]) for shape in shapes]


def test_rotating_the_vertices_changes_only_the_corners() -> None:
    positions, triangles = random_triangles(5, 500, 1)
    records, _ = setup(positions, triangles, 77, 133)
    for shift in (1, 2):
        rotated_triangles = np.roll(triangles, shift, axis=1)
        rotated, _ = setup(positions, rotated_triangles, 77, 133)
        for name, field, other in zip(Records._fields, records, rotated, strict=True):
            if name != "corner":
                np.testing.assert_array_equal(field, other, name)
        vertex = np.take_along_axis(triangles[records.triangle], records.corner, axis=1)
        np.testing.assert_array_equal(vertex, np.take_along_axis(rotated_triangles[rotated.triangle], rotated.corner, axis=1))


def test_turning_a_triangle_over_changes_only_its_facing() -> None:
    positions, triangles = random_triangles(6, 500, 1)

    def contents(order: list[int], cull: str) -> set:
        records, _ = setup(positions, triangles[:, order], 77, 133, cull)
        return {
            tuple(f[i].tobytes() for f in (records.triangle, records.xy, records.z, records.w)) for i in range(len(records.z))
        }

    assert contents([0, 1, 2], "none") == contents([0, 2, 1], "none")
    assert contents([0, 1, 2], "back") == contents([0, 2, 1], "front") != contents([0, 1, 2], "front")


def test_counter_clockwise_is_the_front() -> None:
    left, right, top = on_grid(0, 9000), on_grid(9000, 9000), on_grid(4000, 0)
    assert len(setup_one(left, right, top, cull="back").triangle) == 1
    assert len(setup_one(left, right, top, cull="front").triangle) == 0
    assert len(setup_one(left, top, right, cull="back").triangle) == 0
    assert len(setup_one(left, top, right, cull="front").triangle) == 1


def test_snapping_rounds_half_to_even_about_the_centre() -> None:
    """Offsets from the viewport's centre, in subpx, and what they snap to; y points down but is rounded while it points up."""
    half = 128 * SIZE
    for offset, snapped in ((0.5, 0), (1.5, 2), (2.5, 2), (-0.5, 0), (-1.5, -2), (-2.5, -2), (0.75, 1), (-0.75, -1), (1.25, 1)):
        corner = [offset / half, offset / half, 0, 1]
        records = setup_one(corner, on_grid(half + 9000, half + 100), on_grid(half + 100, half + 9000))
        expected = [half + snapped, half - snapped]
        assert expected in records.xy[0].tolist(), offset


def test_snapping_divides_in_float64() -> None:
    """Of up to 22 bits and a sign of subpx, float32's 24 bits leave too few behind the point to round right."""
    rng = np.random.default_rng(8)
    ndc = rng.uniform(-30, 30, (3000, 2))
    w = rng.uniform(1, 9, (3000, 1))
    positions = np.concatenate([ndc * w, np.zeros((3000, 1)), w], axis=1).astype(np.float32)
    records, _ = setup(positions, np.arange(3000, dtype=np.int32).reshape(-1, 3), 1080, 1920)
    p = positions[3 * records.triangle[:, None] + records.corner].astype(np.float64)
    x = 128 * 1920 + np.rint(p[..., 0] / p[..., 3] * (128 * 1920))
    y = 128 * 1080 - np.rint(p[..., 1] / p[..., 3] * (128 * 1080))
    np.testing.assert_array_equal(records.xy, np.stack([x, y], axis=-1))
    assert not records.clipped.any() and len(records.z) > 300


def test_the_guard_band_ends_where_it_says() -> None:
    far = GUARD - 1
    for x, y in ((-GUARD, 0), (far, 0), (0, -GUARD), (0, far)):
        records = setup_one(on_grid(x, y), on_grid(9000, 3000), on_grid(3000, 9000))
        assert not records.clipped.any() and [x, y] in records.xy[0].tolist()
    for x, y in ((-GUARD - 1, 0), (far + 1, 0), (0, -GUARD - 1), (0, far + 1)):
        records = setup_one(on_grid(x, y), on_grid(9000, 3000), on_grid(3000, 9000))
        assert records.clipped.all()
        axis = 0 if x else 1
        assert (records.xy[..., axis] == (-GUARD if min(x, y) < 0 else far)).any()
        assert records.xy.min() >= -GUARD and records.xy.max() <= far


def test_vertices_on_clip_planes_take_the_exact_values() -> None:
    positions, triangles = random_triangles(9, 4000, 1)
    corners = positions[triangles].astype(np.float64)
    planes = clip_planes(77, 133)
    outside = np.stack([plane.distance(corners) < 0 for plane in planes], axis=-1)
    cut = outside.any(axis=(1, 2)) & ~outside.all(axis=1).any(axis=1)
    polygons, _ = clip(corners[cut], planes)
    # Every plane must make some vertex, else the test below says nothing.
    for plane in (NEAR, X_LOW, X_HIGH, Y_LOW, Y_HIGH, DEPTH):
        assert ((polygons.made >> plane) & 1).sum() > 20
    assert (polygons.position[:, 3] > 0).all() and (polygons.weights >= 0).all()

    records, _ = setup(positions, triangles, 77, 133)
    assert records.xy.min() == -GUARD and records.xy.max() == GUARD - 1
    assert (records.z >= 0).all() and not np.signbit(records.z).any()
    assert records.z.max() <= 2.5  # z <= 4w
    assert (records.z == 0).sum() > 100


def test_neighbours_get_the_same_vertices_on_their_shared_edge() -> None:
    """Two triangles share an edge, run in either direction, and are cut on their own; vertices on it must agree bit for bit."""
    rng = np.random.default_rng(10)
    planes = clip_planes(77, 133)
    quads = (rng.normal(size=(3000, 4, 4)) * 10.0 ** rng.uniform(-1, 3, (3000, 1, 1))).astype(np.float32).astype(np.float64)

    def on_shared_edge(order: list[int], shared: tuple[int, int]) -> list[set]:
        corners = quads[:, order]
        polygons, corner = clip(corners, planes)
        result: list[set] = [set() for _ in quads]
        for owner, position, edges in zip(polygons.owner, polygons.position, polygons.edges, strict=True):
            for j in range(3):
                ends = {order[corner[owner, j]], order[corner[owner, (j + 1) % 3]]}
                if edges >> j & 1 and ends == set(shared):
                    result[owner].add(tuple(position.tolist()))
        return result

    compared = 0
    for second in ([2, 1, 3], [1, 2, 3], [3, 2, 1]):
        for a, b in zip(on_shared_edge([0, 1, 2], (1, 2)), on_shared_edge(second, (1, 2)), strict=True):
            if a and b:
                assert a == b
                compared += 1
    assert compared > 2000


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("component", range(4))
def test_only_triangles_with_nonfinite_input_are_dropped(bad: float, component: int) -> None:
    positions = np.array([on_grid(0, 0), on_grid(9000, 0), on_grid(0, 9000), on_grid(9000, 9000)], np.float32)
    positions[3, component] = bad
    records, dropped = setup(positions, np.array([[0, 1, 3], [0, 1, 2], [3, 1, 2]], np.int32), SIZE, SIZE)
    assert dropped == 2 and records.triangle.tolist() == [1]


def test_overflow_on_the_way_drops_nothing() -> None:
    records = setup_one([3e38, 3e38, 0, 1e-38], [-3e38, 3e38, 0, 1e-38], [0, -3e38, 0, 1e-38])
    assert records.clipped.all() and (records.bbox == [0, 0, SIZE, SIZE]).all(axis=1).any()


def test_what_shows_nothing_has_no_record() -> None:
    a, b, c = on_grid(1000, 1000), on_grid(9000, 1000), on_grid(1000, 9000)
    assert len(setup_one(a, b, c).triangle) == 1
    assert len(setup_one(a, b, on_grid(17000, 1000)).triangle) == 0  # collinear
    assert len(setup_one(a, a, b).triangle) == 0
    assert len(setup_one(a, b, on_grid(5000, 1000.4)).triangle) == 0  # collinear once snapped
    assert len(setup_one(a, b, [0, 0, 0, 0]).triangle) == 0  # inside all planes, yet nowhere
    assert len(setup_one([0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]).triangle) == 0
    assert len(setup_one(on_grid(129, 129), on_grid(300, 129), on_grid(129, 300)).triangle) == 0  # between pixel centres
    assert len(setup_one(on_grid(128, 128), on_grid(300, 128), on_grid(128, 300)).triangle) == 1


def test_wholly_outside_one_plane_shows_nothing() -> None:
    inside = [on_grid(1000, 1000), on_grid(9000, 1000), on_grid(1000, 9000)]
    for component, sign in itertools.product(range(3), (-1, 1)):
        outside = np.array(inside)
        outside[:, component] += sign * 1e6
        assert len(setup_one(*outside).triangle) == 0
    assert len(setup_one(*-np.array(inside)).triangle) == 0  # behind the eye


def test_bbox_holds_exactly_the_centres_within_the_bounds() -> None:
    for low, high in itertools.product(range(120, 137), range(1400, 1420)):
        centres = [px for px in range(SIZE) if low <= 256 * px + 128 <= high]
        records = setup_one(on_grid(low, low), on_grid(high, low), on_grid(low, high))
        assert records.bbox[0].tolist() == [centres[0], centres[0], centres[-1] + 1, centres[-1] + 1]

"""The rungs of the precision ladder: each against the scalar oracle, and against `exact` on the same sub-pixel grid."""

import re
from dataclasses import fields
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from counting import soup
from exhaustive import some_of

from bigtri.precision import COVERAGES, DEFAULT, EXACT, PRECISIONS, RUNGS, Arithmetic, Precision, arithmetic_of
from bigtri.reference import Records, binning, brute_force, depth, rasterize, resolve, scanline, setup, tile_mask
from bigtri.reference.attributes import barycentrics, interpolate

HEIGHT, WIDTH = 96, 160
SIZE = 128  # px; a power of two, so that snapped coordinates can be chosen exactly
BACKGROUND = 2**63 - 1
SPECIFICATION = Path(__file__).parents[2] / "docs/numerics.md"
RUNG = pytest.mark.parametrize("rung", RUNGS.values(), ids=PRECISIONS)
COARSER = [name for name, rung in RUNGS.items() if rung.subpixel_bits < EXACT.subpixel_bits]
CLIPPING = [rung for rung in RUNGS.values() if rung.precision.clip != "none"]
COARSER_RUNG = pytest.mark.parametrize("rung", [RUNGS[name] for name in COARSER], ids=COARSER)


def random_corners(kind: str, count: int) -> np.ndarray:
    """float64 [T, 3, 4], clip space."""
    rng = np.random.default_rng(31)
    if kind == "clipped":  # vertices behind the eye, and some far beyond the guard band
        corners = rng.normal(size=(count, 3, 4)) * [1, 1, 0.5, 1]
        corners[: count // 2, :, :2] *= 10.0 ** rng.uniform(0, 7, (count // 2, 3, 1))
        return corners
    spread = {"large": 1.2, "small": 0.1, "slivers": 0.8}[kind]
    centre = rng.uniform(-0.9, 0.9, (count, 1, 2))
    xy = centre + rng.normal(0, spread, (count, 3, 2))
    if kind == "slivers":
        xy[:, 2] = xy[:, 0] + rng.normal(0, 0.002, (count, 2))
    w = rng.uniform(0.5, 2, (count, 3, 1))
    return np.concatenate([xy * w, rng.uniform(-0.9, 1.1, (count, 3, 1)) * w, w], axis=-1)


def snapped_at(xy: np.ndarray, z: np.ndarray, rung: Arithmetic) -> tuple[np.ndarray, np.ndarray]:
    """Triangles with the snapped vertices ``xy`` [T, 3, 2], subpx of the rung, and window depths ``z`` [T, 3]; SIZE x SIZE px."""
    ndc = (xy / (rung.half * SIZE) - 1) * [1, -1]
    return soup(np.concatenate([ndc, 2 * z[..., None] - 1, np.ones_like(z)[..., None]], axis=-1))


def all_stages(records: Records, threshold: int, rung: Arithmetic) -> tuple[np.ndarray, ...]:
    """What binning, tile_mask, scanline and depth give, one after the other."""
    bins = binning(records, threshold, rung)
    queue = bins.candidates[bins.kept]
    touched, full = tile_mask(records, queue, rung)
    spans = scanline(records, queue, touched, bins.small, rung)
    return (*bins, touched, full, spans, depth(records, spans, rung))


def test_the_rungs_have_the_numbers_of_the_specification() -> None:
    """The tables of docs/numerics.md 12: each rung's choices; and of each coverage s, h, the exponent of G, and the grid."""
    text = SPECIFICATION.read_text()
    choices_of_all_axes = r" \| `(\w+)`" * len(fields(Precision))
    rungs = re.findall(rf"^\| `(\w+)`(, the default)?{choices_of_all_axes} \|$", text, re.M)
    assert tuple(name for name, *_ in rungs) == PRECISIONS
    assert [name for name, default, *_ in rungs if default] == [DEFAULT]
    for name, _, *choices in rungs:
        assert Precision(*choices) == RUNGS[name].precision, name
    grids = re.findall(r"^\| `(\w+)` \| (\d+) \| (\d+) \| 2\^(\d+) \| 1/(\d+) px \|$", text, re.M)
    by_coverage = {name: [int(n) for n in numbers] for name, *numbers in grids}
    for name in COVERAGES:
        s, h, exponent, grid = by_coverage.get(name, by_coverage["fixed8"])
        rung = arithmetic_of(Precision(coverage=name))
        assert (s, h, 2**exponent, grid) == (rung.subpixel, rung.half, rung.guard, rung.subpixel), name


@RUNG
@pytest.mark.parametrize("kind", ["large", "small", "slivers", "clipped"])
def test_every_bit_equals_the_oracle(kind: str, rung: Arithmetic) -> None:
    # The rungs that have the coverage of another one share most of its code: fewer triangles tell what is theirs.
    whole = rung.name in ("exact", *COARSER)
    corners = random_corners(kind, 80 if whole or rung not in CLIPPING else 12)
    positions, triangles = soup(corners * [1, 1, -1 if rung.reversed else 1, 1])  # reversed, nearer than the near plane is z > w
    for cull, scissor in (("none", None), ("back", (9, -2, 150, 70)))[: 2 if whole else 1]:
        records, _ = setup(positions, triangles, HEIGHT, WIDTH, cull, scissor, rung)
        one_by_one, _ = brute_force.records(positions, triangles, HEIGHT, WIDTH, cull, scissor, rung)
        assert len(records.triangle) == len(one_by_one) > 0
        assert records.clipped.any() == (kind == "clipped" and rung.precision.clip != "none")
        for name, field in zip(Records._fields, records, strict=True):
            expected = np.array([getattr(record, name) for record in one_by_one]).reshape(field.shape)
            np.testing.assert_array_equal(field, expected, name)
        expected, _ = brute_force.rasterize(positions, triangles, HEIGHT, WIDTH, cull, scissor, rung)
        assert (expected != BACKGROUND).any()
        for threshold in (0, 4000):
            packed, _ = rasterize(positions, triangles, HEIGHT, WIDTH, cull, scissor, threshold, rung)
            np.testing.assert_array_equal(packed, expected)


# What depth (but reversed, which has another near plane) and attributes are computed with moves no edge.
EDGES = [r for r in CLIPPING if not (r.has_float_coverage or r.wraps)]
OTHER_EDGES = {(r.precision.coverage, r.precision.mask, r.precision.clip, r.reversed): r for r in reversed(EDGES)}.values()


@pytest.mark.parametrize("rung", some_of(OTHER_EDGES, EDGES), ids=lambda rung: rung.name)
def test_clipping_moves_no_edge_by_more_than_a_subpixel(rung: Arithmetic) -> None:
    """Triangle by triangle against its true projection; only centres within 1 subpx of its border may differ."""
    height, width = 10, 14
    certain = clipped = 0
    for corners in random_corners("clipped", 120).astype(np.float32):
        # The far plane is cut by depth, not here.
        corners[:, 2] = np.maximum(corners[:, 2], 0) if rung.reversed else np.minimum(corners[:, 2], corners[:, 3])
        packed, _ = rasterize(*soup(corners[None]), height, width, arithmetic=rung)
        outline = brute_force.outline(corners.tolist(), height, width, rung)
        side = np.array([[brute_force.true_side(outline, x, y, rung) for x in range(width)] for y in range(height)])
        drawn = packed != BACKGROUND
        assert drawn[side == 1].all() and not drawn[side == -1].any()
        certain += (side == 1).sum()
        clipped += setup(*soup(corners[None]), height, width, arithmetic=rung)[0].clipped.any()
    assert certain > 1000 and clipped > 15


@pytest.mark.parametrize("rung", CLIPPING, ids=lambda rung: rung.name)
def test_snapped_coordinates_reach_just_the_ends_of_the_guard_band(rung: Arithmetic) -> None:
    """Whatever the clipper made, or let through on the border itself."""
    positions, triangles = soup(random_corners("clipped", 600))
    records, _ = setup(positions, triangles, HEIGHT, WIDTH, arithmetic=rung)
    for axis in (0, 1):
        assert records.xy[..., axis].min() == -rung.guard and records.xy[..., axis].max() == rung.guard - 1


@COARSER_RUNG
def test_a_coarser_rung_is_exact_on_a_coarser_grid(rung: Arithmetic) -> None:
    """The rungs differ in setup alone: every later stage gives the bits that `exact` gives the vertices on its own grid."""
    ratio = EXACT.subpixel // rung.subpixel
    for kind in ("large", "small", "slivers", "clipped"):
        records, _ = setup(*soup(random_corners(kind, 80)), HEIGHT, WIDTH, arithmetic=rung)
        finer = records._replace(xy=records.xy * ratio, area=records.area * ratio**2)
        for threshold in (0, 4000):
            got, expected = all_stages(records, threshold, rung), all_stages(finer, threshold, EXACT)
            for a, b in zip(got, expected, strict=True):
                np.testing.assert_array_equal(a, b)


@COARSER_RUNG
def test_vertices_on_the_coarser_grid_make_the_same_picture_on_both_rungs(rung: Arithmetic) -> None:
    rng = np.random.default_rng(32)
    xy = rng.integers(-rung.subpixel * 40, rung.subpixel * (SIZE + 40), (200, 3, 2))
    positions, triangles = snapped_at(xy, rng.uniform(0, 1, (200, 3)), rung)
    images = [rasterize(positions, triangles, SIZE, SIZE, arithmetic=a)[0] for a in (EXACT, rung)]
    assert len(np.unique(images[0])) > 1000
    np.testing.assert_array_equal(*images)


@COARSER_RUNG
def test_a_vertex_between_the_points_of_the_coarser_grid_makes_another_picture(rung: Arithmetic) -> None:
    """A left edge 1/256 px to the right of the pixel centres misses them; snapped to the rung's grid it lies on them."""
    centre = 20 * 256 + 128
    xy = np.array([[[centre + 1, 0], [centre + 5000, 0], [centre + 1, 20000]]])
    drawn = [
        rasterize(*snapped_at(xy, np.full((1, 3), 0.5), EXACT), SIZE, SIZE, arithmetic=a)[0] != BACKGROUND for a in (EXACT, rung)
    ]
    assert not drawn[0][:, :21].any() and drawn[0][:70, 21].all()
    assert not drawn[1][:, :20].any() and drawn[1][:70, 20].all()


@RUNG
@pytest.mark.parametrize("kind", ["large", "small", "clipped"])
def test_every_visible_pixel_finds_its_record(kind: str, rung: Arithmetic) -> None:
    """Resolved with the rung that drew it, each pixel has a record of its triangle that covers it."""
    positions, triangles = soup(random_corners(kind, 80))
    packed, _ = rasterize(positions, triangles, HEIGHT, WIDTH, arithmetic=rung)
    records, index = resolve(packed, positions, triangles, rung)
    covered = packed != BACKGROUND
    np.testing.assert_array_equal(index >= 0, covered)
    np.testing.assert_array_equal(records.triangle[index[covered]], (packed & 0xFFFFFFFF)[covered])
    one_by_one, _ = brute_force.records(positions, triangles, HEIGHT, WIDTH, arithmetic=rung)
    by_vertices = {(r.triangle, r.xy): r for r in one_by_one}
    for y, x in np.argwhere(covered)[::97].tolist():
        k = index[y, x]
        record = by_vertices[int(records.triangle[k]), tuple(map(tuple, records.xy[k].tolist()))]
        assert brute_force.covers(record, x, y, rung)


@COARSER_RUNG
def test_weights_on_a_coarser_rung_are_those_of_exact_on_the_coarser_grid(rung: Arithmetic) -> None:
    rng = np.random.default_rng(33)
    xy = rng.integers(-rung.subpixel * 40, rung.subpixel * (SIZE + 40), (60, 3, 2))
    positions, triangles = snapped_at(xy, rng.uniform(0, 1, (60, 3)), rung)
    w = rng.choice(np.float32([0.5, 1, 2, 4]), (len(positions), 1))  # powers of two, so that x / w stays what it was
    positions = positions * w
    packed, _ = rasterize(positions, triangles, SIZE, SIZE)
    values = rng.normal(size=(len(positions), 5)).astype(np.float32)
    on_exact, on_coarser = (
        (barycentrics(packed, positions, triangles, a), interpolate(packed, positions, triangles, values, a))
        for a in (EXACT, rung)
    )
    assert len(np.unique(on_exact[0])) > 1000
    for a, b in zip(on_exact, on_coarser, strict=True):
        np.testing.assert_array_equal(a, b)


def test_weights_off_the_grid_are_those_of_the_rung() -> None:
    """A vertex moved by less than half a coarse subpx: `subpixel4` gives the weights of the vertex where it snaps to."""
    xy = np.array([[[0, 0], [100 * 256, 0], [0, 100 * 256]]])
    depths = np.full((1, 3), 0.5)
    snapped, moved = snapped_at(xy, depths, EXACT), snapped_at(xy + [[3, -5], [-4, 6], [7, 2]], depths, EXACT)
    packed, _ = rasterize(*snapped, SIZE, SIZE)
    expected = barycentrics(packed, *snapped, EXACT)
    np.testing.assert_array_equal(barycentrics(packed, *moved, RUNGS["subpixel4"]), expected)
    assert (barycentrics(packed, *moved, EXACT) != expected).any()


def a_plane(corners: list[list[float]], resolution: tuple[int, int], rung: Arithmetic) -> np.ndarray:
    """The depths of one triangle, whose clip-space corners are given, that covers all of the image."""
    packed, _ = rasterize(*soup(np.array([corners])), *resolution, arithmetic=rung)
    assert (packed != BACKGROUND).all()
    return (packed >> 32).astype(np.int32).view(np.float32)


SLOPE = [[-1, 1, -1, 1], [3, 1, 3, 1], [-1, -3, -1, 1]]  # z/w is x/w: window depth is the share of the image's width


def test_a_stored_depth_has_as_many_levels_as_its_bits() -> None:
    exact = a_plane(SLOPE, (1, 16384), EXACT)
    for bits in (16, 24):
        levels = 2**bits - 1
        stored = a_plane(SLOPE, (1, 16384), RUNGS[f"depth_stored{bits}"])
        np.testing.assert_array_equal(stored, np.float32(np.rint(exact.astype(np.float64) * levels) / levels))
        assert (stored != exact).any() and np.abs(stored.astype(np.float64) - exact).max() <= 0.5 / levels + 2**-25
    every = np.arange(2**24) / (2**24 - 1)
    assert (np.diff(every.astype(np.float32)) > 0).all(), "levels of 24 bits stay different in float32"


def test_reversed_depth_tells_planes_apart_that_window_depth_does_not() -> None:
    """Two planes 0.1 apart at a distance of 100, near 0.001, no far plane: clip depth is the near distance, w the distance."""
    square = np.array([[-1, 1], [3, 1], [-1, -3]])
    for rung, right in ((EXACT, False), (RUNGS["depth_reversed"], True)):
        corners = []
        for w in (100.1, 100.0):  # the farther one first, which wins where depths are equal
            z = 0.001 if rung.reversed else w - 0.002
            corners.append([[x * w, y * w, z, w] for x, y in square])
        packed, _ = rasterize(*soup(np.array(corners)), 8, 8, arithmetic=rung)
        assert ((packed & 0xFFFFFFFF) == 1).all() == right


def test_reversed_depth_is_one_on_the_near_plane_and_zero_on_the_far_one() -> None:
    rung = RUNGS["depth_reversed"]
    for z, stored in ((1.0, 0.0), (0.0, 1.0), (0.25, np.int32(0x3F800000 - 0x3E800000).view(np.float32))):
        assert (a_plane([[-1, 1, z, 1], [3, 1, z, 1], [-1, -3, z, 1]], (4, 4), rung) == np.float32(stored)).all(), z
    beyond, _ = rasterize(*soup(np.array([[[-1, 1, -0.1, 1], [3, 1, -0.1, 1], [-1, -3, -0.1, 1]]])), 4, 4, arithmetic=rung)
    assert (beyond == BACKGROUND).all()


def test_a_plane_in_int64_holds_the_steepest_records_that_are_not_thin() -> None:
    """Depths from 0 to 2.5 over the height of 1/16 px: the plane far away within the cell is still that of Python's integers."""
    rung = RUNGS["depth_fixed_cell"]
    tall = 60 * rung.subpixel
    for width in range(14, 40):
        xy = np.array([[[3 * rung.subpixel, 0], [3 * rung.subpixel + width, 0], [40 * rung.subpixel, tall]]])
        positions, triangles = snapped_at(xy, np.array([[0, 2.5, 1.0]]), rung)
        packed, _ = rasterize(positions, triangles, SIZE, SIZE, arithmetic=rung)
        expected, _ = brute_force.rasterize(positions, triangles, SIZE, SIZE, arithmetic=rung)
        np.testing.assert_array_equal(packed, expected)


def test_each_float32_rule_gives_other_depths_than_the_default() -> None:
    """Else a rung that forgot its rule would pass every comparison of backends."""
    corners = random_corners("large", 40)
    exact, _ = rasterize(*soup(corners), HEIGHT, WIDTH)
    seen = {exact.tobytes()}
    for name in ("depth_float32_cell", "depth_float32_vertex", "depth_float32_barycentric"):
        packed, _ = rasterize(*soup(corners), HEIGHT, WIDTH, arithmetic=RUNGS[name])
        np.testing.assert_array_equal(packed == BACKGROUND, exact == BACKGROUND)
        assert packed.tobytes() not in seen, name
        seen.add(packed.tobytes())


def times_covered(xy: np.ndarray, rung: Arithmetic) -> np.ndarray:
    """How many of the triangles with the snapped vertices ``xy`` [T, 3, 2], subpx of `exact`, cover each pixel."""
    positions, triangles = snapped_at(xy, np.full(xy.shape[:2], 0.5), EXACT)
    drawn = [rasterize(positions, one[None], SIZE, SIZE, arithmetic=rung)[0] != BACKGROUND for one in triangles]
    return np.sum(drawn, axis=0)


def quads(count: int) -> np.ndarray:
    """Two triangles each, int64 [N, 2, 3, 2], subpx of `exact`, that share a long edge through a pixel's centre.

    A tie: exactly 0 there, and what rounding makes of it in float32.
    """
    rng = np.random.default_rng(35)
    centre = 256 * rng.integers(10, SIZE - 10, (count, 2)) + 128
    step = rng.integers(-(1 << 11), 1 << 11, (count, 2)) | 1
    begin, end = (centre + sign * step * rng.integers(1 << 10, 1 << 11, (count, 1)) for sign in (1, -1))
    across = np.stack([-step[:, 1], step[:, 0]], axis=1) << 10
    shared = np.stack([begin, end], axis=1)
    return np.stack([np.concatenate([shared, (centre + sign * across)[:, None]], axis=1) for sign in (1, -1)], axis=1)


def gaps_and_overlaps(name: str) -> int:
    """How many pixels along the shared edges of quads are covered by none or by both of their triangles."""
    return sum(int((times_covered(quad, RUNGS[name]) != times_covered(quad, EXACT)).sum()) for quad in quads(60))


@pytest.mark.parametrize("name", ["coverage_int64", "coverage_float32_canonical"])
def test_a_shared_edge_leaves_no_gap_and_no_overlap(name: str) -> None:
    for quad in quads(60):
        assert times_covered(quad, RUNGS[name]).max() == 1
    assert gaps_and_overlaps("coverage_int64") == 0
    assert gaps_and_overlaps("coverage_float32_canonical") == 0, "a pixel that changes hands is still covered once"


@pytest.mark.parametrize("name", ["coverage_float32", "coverage_float32_fused", "coverage_float32_inclusive"])
def test_float32_breaks_shared_edges(name: str) -> None:
    """Else the canonical direction would be for nothing."""
    assert gaps_and_overlaps(name) > 0


def test_ties_without_a_fill_rule() -> None:
    """A square whose diagonal runs through pixel centres: each is drawn once by top-left, twice by >=, never by >."""
    low, high = 10 * 256 + 128, 100 * 256 + 128
    square = np.array([[[low, low], [high, low], [high, high]], [[low, low], [high, high], [low, high]]])
    diagonal = np.arange(11, 100)
    for name, times in (("exact", 1), ("coverage_float32", 1), ("coverage_float32_inclusive", 2), ("coverage_float32_strict", 0)):
        assert (times_covered(square, RUNGS[name])[diagonal, diagonal] == times).all(), name


def test_int64_everywhere_changes_no_bit() -> None:
    for kind in ("large", "slivers", "clipped"):
        images = [
            rasterize(*soup(random_corners(kind, 60)), HEIGHT, WIDTH, arithmetic=RUNGS[n])[0] for n in ("exact", "coverage_int64")
        ]
        np.testing.assert_array_equal(*images)


def one_drawn(xy: np.ndarray, rung: Arithmetic) -> np.ndarray:
    """bool [SIZE, SIZE]: what the triangle of the snapped vertices ``xy`` [3, 2], subpx, covers."""
    return rasterize(*snapped_at(xy[None], np.full((1, 3), 0.5), EXACT), SIZE, SIZE, arithmetic=rung)[0] != BACKGROUND


def test_int32_is_right_up_to_the_size_where_it_wraps() -> None:
    """Where (width + 63 px) * (height + 63 px) of the bounding box is below 2^15 px^2, as docs/numerics.md 14.1 has it."""
    rng = np.random.default_rng(40)
    right = 0
    for _ in range(150):
        width = int(2 ** rng.uniform(0, 8.6))
        height = min(2**15 // (width + 63) - 63, 400)
        corner = rng.integers(-256 * min(width, height), 256 * SIZE, 2)
        ends = np.array([[0, 0], [256 * width, 256 * height]])
        xy = corner + rng.integers(*ends[:, None, :], (3, 2), endpoint=True)
        xy[:2] = corner + rng.permutation(ends) if rng.random() < 0.5 else corner + ends * [[1, 0]] + ends[::-1] * [[0, 1]]
        drawn = one_drawn(xy, RUNGS["coverage_int32"])
        np.testing.assert_array_equal(drawn, one_drawn(xy, EXACT))
        right += drawn.any()
    assert right > 100


def test_int32_breaks_beyond_that_size() -> None:
    """An edge from the lower left to the upper right: seen from a cell's first centre, its value is the largest there is."""
    cell = 64 * 256 + 128 + 63 * 256
    for size, breaks in ((118, False), (128, False), (129, True), (131, True)):
        side = 256 * size
        xy = cell - 64 * 256 + np.array([[side, 0], [side, side], [0, side]])
        assert (one_drawn(xy, RUNGS["coverage_int32"]) != one_drawn(xy, EXACT)).any() == breaks, size


@pytest.mark.parametrize(("name", "grid"), [("subpixel12", 4096), ("subpixel16", 65536)])
def test_finer_grids_place_edges_where_they_are(name: str, grid: int) -> None:
    """A left edge 1/grid px to the right of the pixel centres misses them; `exact` snaps it onto them."""
    x = (20.5 + 1 / grid) / (SIZE / 2) - 1  # exact in float32
    positions, triangles = soup(np.array([[[x, 1, 0, 1], [x + 0.5, 1, 0, 1], [x, -1, 0, 1]]]))
    drawn = [rasterize(positions, triangles, SIZE, SIZE, arithmetic=RUNGS[n])[0] != BACKGROUND for n in (name, "exact")]
    assert not drawn[0][:, 20].any() and drawn[0][:100, 21].all()
    assert drawn[1][:100, 20].all()


@RUNG
def test_masks_lose_no_pixel_that_the_rung_covers(rung: Arithmetic) -> None:
    """Bins and tiles against the rung's own rule, pixel by pixel, with edges that pass close by their corners."""
    rng = np.random.default_rng(37)
    corner = rng.choice([63.5, 64.5, 7.5, 8.5, 127.5], (30, 1, 2))
    xy = corner + rng.normal(0, 1, (30, 1, 2)) * 1e-3 + rng.normal(0, 60, (30, 3, 2)) * [[[0], [1], [-1]]]
    ndc = (xy / (SIZE / 2) - 1) * [1, -1]
    positions, triangles = soup(np.concatenate([ndc, np.zeros((30, 3, 1)), np.ones((30, 3, 1))], axis=-1))
    records, _ = setup(positions, triangles, SIZE, SIZE, arithmetic=rung)
    one_by_one, _ = brute_force.records(positions, triangles, SIZE, SIZE, arithmetic=rung)
    bins = binning(records, 0, rung)
    touched, full = tile_mask(records, bins.candidates[bins.kept], rung)
    masks = {
        tuple(entry): (t, f)
        for entry, t, f in zip(bins.candidates[bins.kept].tolist(), touched.tolist(), full.tolist(), strict=True)
    }
    checked = 0
    for number, record in enumerate(one_by_one[:8]):
        x0, y0, x1, y1 = record.bbox
        for y, x in rng.integers((y0, x0), (y1, x1), (300, 2)).tolist():
            t, f = masks.get((number, x // 64, y // 64), (0, 0))
            bit = 8 * (y % 64 // 8) + x % 64 // 8
            covered = brute_force.covers(record, x, y, rung)
            assert not covered or t >> bit & 1
            assert covered or not f >> bit & 1
            checked += covered
    assert checked > 100


def test_the_half_tile_test_is_that_of_the_whole_square() -> None:
    """Against fractions: the square of a tile, its border included, and the edge moved by the fill rule's bias."""
    rung = RUNGS["mask_half_tile"]
    records, _ = setup(*soup(random_corners("large", 12)), HEIGHT, WIDTH, arithmetic=rung)
    bins = binning(records, 0, rung)
    queue = bins.candidates[bins.kept]
    touched, full = tile_mask(records, queue, rung)
    s = rung.subpixel
    for (record, column, row), t, f in zip(queue[::7].tolist(), touched[::7].tolist(), full[::7].tolist(), strict=True):
        x, y = records.xy[record].T.tolist()
        x0, y0, x1, y1 = records.bbox[record].tolist()
        for tile in range(0, 64, 5):
            left, top = 64 * column + 8 * (tile % 8), 64 * row + 8 * (tile // 8)
            any_inside, all_inside = True, True
            for k in range(3):
                p, q = (k + 1) % 3, (k + 2) % 3
                dx, dy = x[q] - x[p], y[q] - y[p]
                bias = 0 if dy < 0 or (dy == 0 and dx > 0) else -1
                first = (dx * (s * top + s // 2 - y[p]) - dy * (s * left + s // 2 - x[p]) + bias) // s
                # f at the corners of the square, half a pixel beyond the first and the last centre.
                corners = [first + dx * b - dy * a for a in (-0.5, 7.5) for b in (-0.5, 7.5)]
                any_inside, all_inside = any_inside and max(corners) >= 0, all_inside and min(corners) >= 0
            meets = left < x1 and left + 8 > x0 and top < y1 and top + 8 > y0
            assert (t >> tile & 1) == (any_inside and meets)
            assert (f >> tile & 1) == (all_inside and meets)


@pytest.mark.parametrize("name", ["mask_half_tile", "mask_bounds", "mask_none"])
def test_a_mask_changes_no_pixel(name: str) -> None:
    for kind in ("large", "slivers", "clipped"):
        scene = soup(random_corners(kind, 60))
        images = [rasterize(*scene, HEIGHT, WIDTH, threshold=0, arithmetic=RUNGS[one])[0] for one in ("exact", name)]
        np.testing.assert_array_equal(*images)


def vertices_in_common(rung: Arithmetic) -> np.ndarray:
    """Of pairs of triangles on both sides of an edge that crosses the near plane: how many snapped vertices they share, [N]."""
    rng = np.random.default_rng(38)
    shared = []
    for _ in range(150):
        corners = rng.normal(0, 1, (4, 4))
        corners[:2, 3] = [1.3, -1.1]  # the edge from before the eye to behind it
        positions = corners.astype(np.float32)
        sides = [setup(positions, np.array([one], np.int32), HEIGHT, WIDTH, arithmetic=rung)[0] for one in ([0, 1, 2], [1, 0, 3])]
        a, b = ({tuple(v) for v in side.xy.reshape(-1, 2).tolist()} for side in sides)
        if a and b:
            shared.append(len(a & b))
    return np.array(shared)


def test_clipping_in_float32_parts_neighbours() -> None:
    """The shared edge is cut at the same point on both sides by the exact sum, and at two points by float32, by winding."""
    exact, float32, none = (vertices_in_common(RUNGS[name]) for name in ("exact", "clip_float32", "clip_none"))
    assert len(exact) > 50 and (exact < 2).sum() < 5  # where a part of a fan that has a vertex shows no pixel
    assert (float32 < 2).sum() > 10
    assert len(none) == 0


def test_clipping_in_float32_drops_what_leaves_its_range() -> None:
    big = np.float32(3e38)
    positions = np.array([[-big, -1, 0, 1], [big, 1, 0, -1], [big, -big, 0, 1]], np.float32)
    with np.errstate(all="raise"):
        packed, dropped = rasterize(positions, np.array([[0, 1, 2]], np.int32), 8, 8, arithmetic=RUNGS["clip_float32"])
    assert (packed == BACKGROUND).all() and dropped == 0


@RUNG
@pytest.mark.parametrize("kind", ["large", "clipped"])
def test_weights_equal_the_oracle(kind: str, rung: Arithmetic) -> None:
    """Pixel by pixel; triangles in perspective, so that every division matters."""
    corners = random_corners(kind, 30) * [1, 1, -1 if rung.reversed else 1, 1]
    if kind == "large":
        corners *= np.random.default_rng(39).uniform(0.3, 3, (30, 3, 1))
    positions, triangles = soup(corners)
    packed, _ = rasterize(positions, triangles, HEIGHT, WIDTH, arithmetic=rung)
    got = barycentrics(packed, positions, triangles, rung)
    records, index = resolve(packed, positions, triangles, rung)
    one_by_one, _ = brute_force.records(positions, triangles, HEIGHT, WIDTH, arithmetic=rung)
    by_vertices = {(r.triangle, r.xy): r for r in one_by_one}
    checked = 0
    for y, x in np.argwhere(index >= 0)[::41].tolist():
        k = index[y, x]
        record = by_vertices[int(records.triangle[k]), tuple(map(tuple, records.xy[k].tolist()))]
        expected = np.zeros(3, np.float32)
        corners = [tuple(positions[v].tolist()) for v in triangles[record.triangle].tolist()]
        expected[list(record.corner)] = brute_force.weights(record, x, y, rung, corners, (HEIGHT, WIDTH))
        assert got[y, x].tobytes() == expected.tobytes()
        checked += 1
    assert checked > 10


def test_attribute_rules_differ_and_only_affine_leaves_perspective_out() -> None:
    corners = random_corners("large", 30) * np.random.default_rng(39).uniform(0.3, 3, (30, 3, 1))
    positions, triangles = soup(corners)
    packed, _ = rasterize(positions, triangles, HEIGHT, WIDTH)
    exact, float32, reciprocal, affine = (
        barycentrics(packed, positions, triangles, RUNGS[name]).astype(np.float64)
        for name in ("exact", "attributes_float32", "attributes_reciprocal", "attributes_affine")
    )
    off = [np.abs(one - exact).max() for one in (float32, reciprocal, affine)]
    assert 0 < off[0] < off[1] < 1e-5 and off[2] > 0.1


def true_weights(corners: np.ndarray, x: int, y: int) -> list[Fraction]:
    """Of clip-space corners [3, 4] as they are given, at a pixel's centre: u_k, over their sum."""
    nx, ny = Fraction(2 * x + 1 - WIDTH, WIDTH), Fraction(HEIGHT - 2 * y - 1, HEIGHT)
    exact = [[Fraction(float(c)) for c in corner] for corner in corners]
    a, b = [c[0] - nx * c[3] for c in exact], [c[1] - ny * c[3] for c in exact]
    u = [a[k] * b[m] - a[m] * b[k] for k, m in ((1, 2), (2, 0), (0, 1))]
    return [one / sum(u) for one in u]


def test_unsnapped_weights_are_those_of_the_triangle_as_it_was_given() -> None:
    """Where its own border has the pixel inside; to a rounding of float32, where snapping is a hundred times as far off."""
    rung = RUNGS["attributes_unsnapped"]
    rng = np.random.default_rng(45)
    corners = random_corners("large", 30) * rng.uniform(0.3, 3, (30, 3, 1))
    corners[15:, :, :2] *= 0.02  # of a few pixels, which snapping moves by much of their size
    positions, triangles = soup(corners)
    packed, _ = rasterize(positions, triangles, HEIGHT, WIDTH)
    unsnapped, snapped = (barycentrics(packed, positions, triangles, one) for one in (rung, EXACT))
    off = []
    for y, x in np.argwhere(packed != BACKGROUND)[::37].tolist():
        true = true_weights(positions[triangles[packed[y, x] & 0xFFFFFFFF]], x, y)
        if min(true) >= 0:
            off.append(
                [
                    max(abs(float(t) - b) for t, b in zip(true, image[y, x].tolist(), strict=True))
                    for image in (unsnapped, snapped)
                ]
            )
    (mine, others) = np.max(off, axis=0)
    assert len(off) > 60 and mine < 2.0**-23 < 2.0**-12 < others


def test_unsnapped_weights_of_a_pixel_beyond_the_border_are_weights() -> None:
    """A triangle that only snapping gives an area covers pixels that it does not have: in [0, 1], and of sum 1."""
    rng = np.random.default_rng(46)
    begin, end = rng.uniform(-0.9, 0.9, (2, 2000, 1, 2))
    share = np.stack([np.zeros(2000), np.ones(2000), rng.uniform(0.2, 0.8, 2000)], axis=1)[:, :, None]
    xy = begin + (end - begin) * share + rng.normal(0, 1e-5, (2000, 3, 2))
    positions, triangles = soup(np.concatenate([xy, np.zeros((2000, 3, 1)), np.ones((2000, 3, 1))], axis=-1))
    packed, _ = rasterize(positions, triangles, HEIGHT, WIDTH)
    covered = packed != BACKGROUND
    weights = barycentrics(packed, positions, triangles, RUNGS["attributes_unsnapped"])[covered].astype(np.float64)
    assert covered.sum() > 10 and ((weights >= 0) & (weights <= 1)).all()
    assert np.abs(weights.sum(axis=1) - 1).max() < 2.0**-23
    assert (weights == 0).any(), "some lie beyond a side"


def test_unsnapped_weights_of_a_triangle_in_one_place_are_none() -> None:
    """All three vertices at the pixel's centre, of a visibility buffer that another drawing made."""
    centre = [1 / WIDTH, -1 / HEIGHT, 0, 1]
    seen, triangles = soup(np.array([[[-1, 1, 0, 1], [3, 1, 0, 1], [-1, -3, 0, 1]]]))
    rung = RUNGS["attributes_unsnapped"]
    packed, _ = rasterize(seen, triangles, HEIGHT, WIDTH)
    assert (barycentrics(packed, *soup(np.array([[centre] * 3])), rung) == 0).all()

"""Each stage behind setup against an exhaustive evaluation of its definition."""

from fractions import Fraction

import numpy as np
import pytest

from bigtri.reference import (
    Records,
    binning,
    brute_force,
    depth,
    pipeline,
    rasterize,
    resolve,
    scanline,
    setup,
    tile_mask,
    visibility,
)

BACKGROUND = 2**63 - 1
HEIGHT, WIDTH = 256, 512  # px; powers of two, so that snapped coordinates can be chosen exactly


def on_grid(xy: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions and indices of triangles with the snapped vertices ``xy`` [T, 3, 2], subpx, and window depths ``z`` [T, 3]."""
    half = np.array([128 * WIDTH, 128 * HEIGHT])
    ndc = (xy - half) / half * [1, -1]
    positions = np.concatenate([ndc, 2 * z[..., None] - 1, np.ones_like(z)[..., None]], axis=-1).astype(np.float32)
    return positions.reshape(-1, 4), np.arange(3 * len(xy), dtype=np.int32).reshape(-1, 3)


def families() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(11)
    screen = np.array([256 * WIDTH, 256 * HEIGHT])
    z = rng.uniform(0, 1, (24, 3))
    anywhere = rng.integers(-64, screen + 64, (24, 3, 2))
    centres = 256 * rng.integers(-1, screen // 256 + 1, (24, 3, 2)) + 128
    bin_borders = 256 * 64 * rng.integers(-1, screen // (256 * 64) + 2, (24, 3, 2)) + rng.choice(
        [-1, 0, 1, 127, 128, 129], (24, 3, 2)
    )
    guard = rng.integers(-(2**23), 2**23, (24, 3, 2))
    slivers = anywhere.copy()
    slivers[:, 2] = slivers[:, 1] + rng.integers(-300, 301, (24, 2))
    tiny = rng.integers(0, screen, (24, 1, 2)) + rng.integers(-600, 601, (24, 3, 2))
    boxes = {
        "anywhere": anywhere,
        "centres": centres,
        "bin borders": bin_borders,
        "guard": guard,
        "slivers": slivers,
        "tiny": tiny,
    }
    grids = {name: on_grid(xy, z) for name, xy in boxes.items()}
    clipped = rng.normal(size=(72, 4)) * [1, 1, 1, 0.7]
    return grids | {"clipped": (clipped.astype(np.float32), np.arange(72, dtype=np.int32).reshape(-1, 3))}


FAMILIES = families()


@pytest.fixture(params=FAMILIES)
def scene(request: pytest.FixtureRequest) -> tuple[Records, list[brute_force.Record]]:
    """The records of a family, as arrays and one by one."""
    positions, triangles = FAMILIES[request.param]
    records, _ = setup(positions, triangles, HEIGHT, WIDTH)
    one_by_one, _ = brute_force.records(positions, triangles, HEIGHT, WIDTH)
    assert len(one_by_one) == len(records.triangle) > 4
    return records, one_by_one


def queue_of(records: Records, threshold: int = 0) -> np.ndarray:
    bins = binning(records, threshold)
    return bins.candidates[bins.kept]


def inside_each_edge(record: brute_force.Record, left: int, top: int, size: int) -> np.ndarray:
    """bool [3, size, size]: which pixel centres of a square each edge alone would cover."""
    sx = (256 * np.arange(left, left + size, dtype=np.int64) + 128)[None, :]
    sy = (256 * np.arange(top, top + size, dtype=np.int64) + 128)[:, None]
    inside = []
    for k in range(3):
        (px, py), (qx, qy) = record.xy[(k + 1) % 3], record.xy[(k + 2) % 3]
        e = (qx - px) * (sy - py) - (qy - py) * (sx - px)
        owns = qy < py or (qy == py and qx > px)
        inside.append(e >= 0 if owns else e > 0)
    return np.stack(inside)


def all_spans(records: Records, threshold: int) -> np.ndarray:
    bins = binning(records, threshold)
    queue = bins.candidates[bins.kept]
    return scanline(records, queue, tile_mask(records, queue)[0], bins.small)


# --- Binning -----------------------------------------------------------------------------------------------------------------


def test_binning_keeps_the_bins_that_no_edge_rejects(scene: tuple[Records, list[brute_force.Record]]) -> None:
    records, one_by_one = scene
    bins = binning(records, threshold=0)
    assert bins.candidates.dtype == np.int32 and bins.small.dtype == np.int32 and bins.kept.dtype == bool
    expected, kept = [], []
    for index, record in enumerate(one_by_one):
        x0, y0, x1, y1 = record.bbox
        for row in range(HEIGHT // 64):
            for column in range(WIDTH // 64):
                if x0 < 64 * column + 64 and 64 * column < x1 and y0 < 64 * row + 64 and 64 * row < y1:
                    expected.append([index, column, row])
                    kept.append(inside_each_edge(record, 64 * column, 64 * row, 64).any(axis=(1, 2)).all())
    assert bins.candidates.tolist() == expected
    assert bins.kept.tolist() == kept


def test_bins_are_whole_beyond_the_edge_of_the_screen() -> None:
    """On a screen of 70 px, the second column of bins goes on to 128 px, and only there does this triangle reach row 60."""
    positions = np.array([[-1, -1, 0, 1], [3, -1, 0, 1], [-1, 3, 0, 1]], np.float32)
    records, _ = setup(positions, np.array([[0, 1, 2]], np.int32), 70, 70)
    bins = binning(records, 0)
    assert bins.candidates[:, 1:].tolist() == [[0, 0], [1, 0], [0, 1], [1, 1]] and bins.kept.all()


def test_a_bin_and_a_tile_may_hold_no_more_than_a_corner() -> None:
    """A left edge through the last pixel centre of bin (0, 0) covers just that; one subpx further to the right, nothing."""
    centre = 63 * 256 + 128
    for shift, covered in ((0, True), (1, False)):
        xy = np.array([[[centre + 5000, centre - 5000], [centre - 5000, centre + 5000], [centre + 9000, centre + 9000]]])
        records, _ = setup(*on_grid(xy + [shift, 0], np.full((1, 3), 0.5)), HEIGHT, WIDTH)
        bins = binning(records, 0)
        assert bins.candidates[0].tolist() == [0, 0, 0] and bins.kept[0] == covered
        touched, _ = tile_mask(records, bins.candidates)
        assert touched.view(np.uint64)[0] == (1 << 63 if covered else 0)


def test_large_means_more_pixels_in_the_bbox_than_the_threshold() -> None:
    corners = np.array([[[0, 0], [50 * 256, 0], [0, 80 * 256]], [[0, 0], [51 * 256, 0], [0, 80 * 256]]])
    records, _ = setup(*on_grid(corners, np.full((2, 3), 0.5)), HEIGHT, WIDTH)
    assert records.bbox.tolist() == [[0, 0, 50, 80], [0, 0, 51, 80]]
    bins = binning(records)
    assert bins.small.tolist() == [0] and set(bins.candidates[:, 0].tolist()) == {1}
    assert binning(records, threshold=3999).small.tolist() == []
    assert binning(records, threshold=4080).small.tolist() == [0, 1]


# --- Tile masks --------------------------------------------------------------------------------------------------------------


def test_tile_masks_hold_for_all_pixels_of_the_tiles(scene: tuple[Records, list[brute_force.Record]]) -> None:
    records, one_by_one = scene
    queue = queue_of(records)
    touched, full = tile_mask(records, queue)
    assert touched.dtype == full.dtype == np.int64
    for (index, column, row), some, every in zip(queue.tolist(), touched.tolist(), full.tolist(), strict=True):
        inside = inside_each_edge(one_by_one[index], 64 * column, 64 * row, 64).reshape(
            3, 8, 8, 8, 8
        )  # edge, tile y, y, tile x, x
        x0, y0, x1, y1 = one_by_one[index].bbox
        meets = np.zeros((64 + HEIGHT, 64 + WIDTH), bool)
        meets[y0:y1, x0:x1] = True
        meets = meets[64 * row : 64 * row + 64, 64 * column : 64 * column + 64].reshape(8, 8, 8, 8).any(axis=(1, 3))
        expected_touched = inside.any(axis=(2, 4)).all(axis=0) & meets
        expected_full = inside.all(axis=(0, 2, 4)) & meets
        assert [some >> bit & 1 for bit in range(64)] == expected_touched.reshape(-1).tolist()
        assert [every >> bit & 1 for bit in range(64)] == expected_full.reshape(-1).tolist()


@pytest.mark.parametrize("bit", [0, 1, 7, 8, 37, 62, 63])
def test_a_triangle_within_one_tile_touches_that_tile(bit: int) -> None:
    left, top = 256 * (64 + 8 * (bit % 8) + 3), 256 * (128 + 8 * (bit // 8) + 3)
    records, _ = setup(
        *on_grid(np.array([[[left, top], [left + 400, top], [left, top + 400]]]), np.full((1, 3), 0.5)), HEIGHT, WIDTH
    )
    touched, full = tile_mask(records, queue_of(records))
    assert touched.view(np.uint64).tolist() == [1 << bit] and full.tolist() == [0]


def test_full_does_not_look_at_the_scissor() -> None:
    positions = np.array([[-1, -1, 0, 1], [3, -1, 0, 1], [-1, 3, 0, 1]], np.float32)
    records, _ = setup(positions, np.array([[0, 1, 2]], np.int32), HEIGHT, WIDTH, "none", (3, 3, 20, 5))
    touched, full = tile_mask(records, queue_of(records))
    assert touched.tolist() == full.tolist() == [0b111]
    spans = scanline(records, queue_of(records), touched, np.zeros(0, np.int32))
    assert spans[:, 1:].tolist() == [[y, max(3, x), min(20, x + 8)] for x in (0, 8, 16) for y in (3, 4)]


# --- Scanline ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("threshold", [0, 4000, 10**9])
def test_spans_hold_exactly_the_covered_pixels(scene: tuple[Records, list[brute_force.Record]], threshold: int) -> None:
    records, one_by_one = scene
    spans = all_spans(records, threshold)
    assert spans.dtype == np.int32 and (spans[:, 2] < spans[:, 3]).all()
    count = np.zeros((len(one_by_one), HEIGHT, WIDTH), np.int64)
    for record, y, lower, upper in spans.tolist():
        count[record, y, lower:upper] += 1
    expected = np.stack([brute_force.coverage(record, HEIGHT, WIDTH) for record in one_by_one])
    assert expected.any()
    np.testing.assert_array_equal(count, expected)


def test_spans_are_sorted(scene: tuple[Records, list[brute_force.Record]]) -> None:
    records, _ = scene
    spans = all_spans(records, 4000)
    is_small = np.isin(spans[:, 0], binning(records, 4000).small)
    record, y, x, _ = spans.astype(np.int64).T
    tile_order = np.lexsort((y, x >> 3, y >> 3, x >> 6, y >> 6, record))  # record, bin row and column, tile row and column, row
    row_order = np.lexsort((y, record))
    expected = np.concatenate([tile_order[~is_small[tile_order]], row_order[is_small[row_order]]])
    np.testing.assert_array_equal(expected, np.arange(len(spans)))


def test_scanline_visits_no_tile_that_is_not_touched(scene: tuple[Records, list[brute_force.Record]]) -> None:
    records, _ = scene
    queue = queue_of(records)
    touched, _ = tile_mask(records, queue)
    none = np.zeros(0, np.int32)
    checkered = np.int64(0x55AA55AA55AA55AA)
    spans = scanline(records, queue, touched, none)
    some = scanline(records, queue, touched & checkered, none)
    bit = 8 * (spans[:, 1] // 8 % 8) + spans[:, 2] // 8 % 8
    np.testing.assert_array_equal(some, spans[(checkered >> bit.astype(np.int64)) & 1 == 1])


# --- Depth -------------------------------------------------------------------------------------------------------------------


def sampled_pixels(spans: np.ndarray, count: int) -> list[tuple[int, int, int, int]]:
    """(place in the depth output, record, x, y) of about ``count`` pixels."""
    pixels = [(record, x, y) for record, y, lower, upper in spans.tolist() for x in range(lower, upper)]
    return [(place, *pixels[place]) for place in range(0, len(pixels), max(1, len(pixels) // count))]


def assert_depth_is_near_exact(z: np.float32, record: brute_force.Record, x: int, y: int) -> None:
    """Half a unit in the last place of float32, and 2^-39."""
    error = abs(Fraction(float(z)) - brute_force.exact_depth(record, x, y))
    assert error <= Fraction(float(np.spacing(z))) / 2 + Fraction(1, 2**39)


def test_depth_is_the_specified_one_and_near_the_exact_one(scene: tuple[Records, list[brute_force.Record]]) -> None:
    records, one_by_one = scene
    spans = all_spans(records, 4000)
    z = depth(records, spans)
    assert z.dtype == np.float32 and len(z) == (spans[:, 3] - spans[:, 2]).sum() and not np.signbit(z).any()
    for place, index, x, y in sampled_pixels(spans, 3000):
        assert z[place] == np.float32(brute_force.depth(one_by_one[index], x, y))
        assert_depth_is_near_exact(z[place], one_by_one[index], x, y)


def test_depth_does_not_depend_on_how_pixels_are_cut_into_spans(scene: tuple[Records, list[brute_force.Record]]) -> None:
    records, _ = scene
    images = []
    for threshold in (0, 10**9):
        spans = all_spans(records, threshold)
        image = np.full((len(records.triangle), HEIGHT, WIDTH), np.nan, np.float32)
        values = iter(np.split(depth(records, spans), np.cumsum(spans[:, 3] - spans[:, 2])[:-1]))
        for record, y, lower, upper in spans.tolist():
            image[record, y, lower:upper] = next(values)
        images.append(image)
    np.testing.assert_array_equal(*images)


def test_depth_of_a_sliver_of_twice_area_2() -> None:
    """Its slopes would cancel: computed through its plane, this pixel was off by 280 units in the last place."""
    xy = [(2077075, -3530219), (-1924755, 3653355), (3006222, -5198105)]
    z = np.array([0.70698, 2.01e-7, 0.87113], np.float32)
    order = sorted(range(3), key=lambda k: xy[k])
    area = brute_force._determinant(*(xy[k] for k in order))
    if area < 0:
        order, area = [order[0], order[2], order[1]], -area
    record = brute_force.Record(
        0,
        tuple(xy[k] for k in order),
        tuple(float(z[k]) for k in order),
        area,
        (0, 0, 512, 256),
        (1.0,) * 3,
        (0, 1, 2),
        (),
        False,
    )
    records = Records(
        np.zeros(1, np.int32),
        np.array([record.xy], np.int32),
        np.array([record.z], np.float32),
        np.array([area]),
        np.array([record.bbox], np.int32),
        np.ones((1, 3)),
        np.array([[0, 1, 2]], np.int32),
        np.eye(3)[None],
        np.zeros(1, bool),
    )
    assert area == 2
    value = depth(records, np.array([[0, 240, 297, 298]], np.int32))[0]
    assert value == np.float32(brute_force.depth(record, 297, 240))
    assert_depth_is_near_exact(value, record, 297, 240)


@pytest.mark.parametrize(("length", "thickness"), [(272, 17), (144, 18), (80, 20), (48, 24)])
def test_thin_begins_above_the_ratio(length: int, thickness: int) -> None:
    """256 * sum(|dx| + |dy|) = 32 * A for legs with (length - 16) * (thickness - 16) = 256; one subpx less makes it thin.

    Depth 0 at a corner on a pixel centre brings the float64 rounding to light, which differs between the two formulas: there, a
    thin triangle has exactly 0, and a plane what its terms leave when they cancel.
    """
    rng = np.random.default_rng(13)
    left_over = []
    for legs in ((length, thickness), (length, thickness - 1), (length - 1, thickness)):
        corner = 256 * rng.integers(0, [WIDTH, HEIGHT], (200, 1, 2)) + 128
        z = np.concatenate([np.zeros((200, 1)), rng.uniform(0, 1, (200, 2))], axis=1)
        positions, triangles = on_grid(corner + np.array([[0, 0], [legs[0], 0], [0, legs[1]]]), z)
        records, _ = setup(positions, triangles, HEIGHT, WIDTH)
        one_by_one, _ = brute_force.records(positions, triangles, HEIGHT, WIDTH)
        spans = np.array([[k, *corner[k, 0, ::-1] // 256, corner[k, 0, 0] // 256 + 1] for k in range(200)], np.int32)
        values = depth(records, spans)
        assert values.tolist() == [brute_force.depth(one_by_one[k], *(corner[k, 0] // 256).tolist()) for k in range(200)]
        left_over.append(bool(values.any()))
    assert left_over == [True, False, False]


def corners_of_almost_none(size: int) -> tuple[Records, list[brute_force.Record], np.ndarray]:
    """Records, the same one by one, and spans of the pixel at each one's nearest corner, whose depth is 0 or tiny.

    There float32 shows float64's rounding: that of each operation, and of sums by their order.
    """
    rng = np.random.default_rng(14)
    corner = 256 * rng.integers(0, [WIDTH, HEIGHT], (600, 1, 2)) + 128
    xy = corner + rng.integers(-size, size + 1, (600, 3, 2)) * [[0], [1], [1]]
    z = rng.uniform(0.1, 1, (600, 3)) * [0, 1, 1]
    positions, triangles = on_grid(xy, z)
    records, _ = setup(positions, triangles, HEIGHT, WIDTH)
    # Setup itself gives no depth between 0 and 2^-25.
    tiny = rng.choice(np.array([0, 1e-12, 1e-7], np.float32), (len(records.z), 1))
    records = records._replace(z=np.where(records.z == 0, tiny, records.z))
    drawn, _ = brute_force.records(positions, triangles, HEIGHT, WIDTH)
    one_by_one = [record._replace(z=tuple(corners)) for record, corners in zip(drawn, records.z.tolist(), strict=True)]

    pixels = [(index, *(c // 256 for c in record.xy[record.z.index(min(record.z))])) for index, record in enumerate(one_by_one)]
    return records, one_by_one, np.array([[index, y, x, x + 1] for index, x, y in pixels], np.int32)


@pytest.mark.parametrize("size", [300, 30000])
def test_depth_next_to_a_corner_of_almost_none(size: int) -> None:
    """Rounding leaves some planes below their lowest corner, and both zeros are stored as +0, whose bits are 0."""
    records, one_by_one, spans = corners_of_almost_none(size)
    values = depth(records, spans)
    assert (values >= records.z.min(axis=1)).all() and not np.signbit(values).any()
    assert values.tolist() == [brute_force.depth(one_by_one[index], x, y) for index, y, x, _ in spans.tolist()]
    minus_zero = records._replace(z=np.full_like(records.z, -0.0))
    assert not depth(minus_zero, spans).view(np.uint32).any()


# --- Visibility --------------------------------------------------------------------------------------------------------------


def test_visibility_keeps_the_nearest_then_the_lowest() -> None:
    positions, triangles = on_grid(np.tile([[[0, 0], [9000, 0], [0, 9000]]], (5, 1, 1)), np.full((5, 3), 0.5))
    records, _ = setup(positions, triangles, HEIGHT, WIDTH)
    spans = np.array([[4, 3, 10, 12], [2, 3, 10, 12], [3, 3, 11, 13], [0, 3, 10, 14], [1, 5, 511, 512]], np.int32)
    z = np.array([0.5, 0.25, 0.5, 0.25, 0.125, 1, 0.75, 0.75, np.nextafter(np.float32(1), 2), 1.5, 0], np.float32)
    packed = visibility(records, spans, z, HEIGHT, WIDTH)
    drawn = {(3, 10): (0.5, 2), (3, 11): (0.125, 3), (3, 12): (1, 3), (5, 511): (0, 1)}
    assert packed.dtype == np.int64 and packed.shape == (HEIGHT, WIDTH)
    assert (packed != BACKGROUND).sum() == len(drawn)
    for (y, x), (depth_, triangle) in drawn.items():
        assert packed[y, x] & 0xFFFFFFFF == triangle
        assert (packed[y, x] >> 32).astype(np.uint32).view(np.float32) == np.float32(depth_)


def test_visibility_does_not_depend_on_the_order(scene: tuple[Records, list[brute_force.Record]]) -> None:
    records, _ = scene
    spans = all_spans(records, 4000)
    packed = visibility(records, spans, depth(records, spans), HEIGHT, WIDTH)
    backwards = spans[::-1]
    np.testing.assert_array_equal(packed, visibility(records, backwards, depth(records, backwards), HEIGHT, WIDTH))


def test_triangle_numbers_beyond_float32_survive() -> None:
    positions, triangles = on_grid(np.array([[[0, 0], [9000, 0], [0, 9000]]]), np.full((1, 3), 0.5))
    records = setup(positions, triangles, HEIGHT, WIDTH)[0]._replace(triangle=np.array([2**31 - 2], np.int32))
    packed = visibility(records, np.array([[0, 0, 0, 1]], np.int32), np.array([1], np.float32), HEIGHT, WIDTH)
    assert packed[0, 0] & 0xFFFFFFFF == 2**31 - 2 and packed[0, 0] < BACKGROUND


# --- Resolve and the pipeline ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("family", FAMILIES)
def test_resolve_finds_the_first_record_that_covers(family: str) -> None:
    positions, triangles = FAMILIES[family]
    packed, _ = rasterize(positions, triangles, HEIGHT, WIDTH, scissor=(5, 5, WIDTH, HEIGHT))
    records, index = resolve(packed, positions, triangles)
    visible = np.unique(packed[packed != BACKGROUND] & 0xFFFFFFFF)
    np.testing.assert_array_equal(np.unique(records.triangle), visible)
    one_by_one = [r for r in brute_force.records(positions, triangles, HEIGHT, WIDTH)[0] if r.triangle in visible]
    expected = np.full((HEIGHT, WIDTH), -1)
    for number in reversed(range(len(one_by_one))):
        record = one_by_one[number]
        seen = (packed != BACKGROUND) & (packed & 0xFFFFFFFF == record.triangle)
        expected[seen & brute_force.coverage(record, HEIGHT, WIDTH)] = number
    assert index.dtype == np.int64
    np.testing.assert_array_equal(index, expected)
    assert ((index == -1) == (packed == BACKGROUND)).all()
    np.testing.assert_array_equal(records.triangle, [r.triangle for r in one_by_one])


@pytest.mark.parametrize("family", FAMILIES)
def test_neither_threshold_nor_chunks_change_a_bit(family: str, monkeypatch: pytest.MonkeyPatch) -> None:
    positions, triangles = FAMILIES[family]
    packed, _ = rasterize(positions, triangles, HEIGHT, WIDTH)
    for threshold in (0, 10**9):
        np.testing.assert_array_equal(packed, rasterize(positions, triangles, HEIGHT, WIDTH, threshold=threshold)[0])
    for name, limit in (("BINS", 3), ("ROWS", 100), ("FRAGMENTS", 50)):
        monkeypatch.setattr(pipeline, name, limit)
    np.testing.assert_array_equal(packed, rasterize(positions, triangles, HEIGHT, WIDTH)[0])


def test_guard_band_triangles_on_the_widest_screen() -> None:
    """Edge values reach 51 bits here; a sample of pixels is checked in Python's integers."""
    rng = np.random.default_rng(12)
    height, width = 16, 16384
    # Sharp triangles whose tips lie at the ends of the guard band and whose bodies cross the screen.
    x = rng.choice([-(2**15), -(2**15) + 1, 2**15 - 1, 2**14, 0], (40, 3)) + rng.uniform(0, 1, (40, 3))
    y = rng.uniform(-30, 46, (40, 3))
    y[::2] *= 700
    ndc = np.stack([2 * x / width - 1, 1 - 2 * y / height, rng.uniform(-1, 1, (40, 3)), np.ones((40, 3))], axis=-1)
    positions, triangles = ndc.astype(np.float32).reshape(-1, 4), np.arange(120, dtype=np.int32).reshape(-1, 3)
    one_by_one, _ = brute_force.records(positions, triangles, height, width)
    packed, _ = rasterize(positions, triangles, height, width)
    assert max(abs(c) for r in one_by_one for v in r.xy for c in v) > 8_000_000
    for px, py in zip(rng.integers(0, width, 3000).tolist(), rng.integers(0, height, 3000).tolist(), strict=True):
        nearest = min(
            ((brute_force.depth(r, px, py), r.triangle) for r in one_by_one if brute_force.covers(r, px, py)), default=None
        )
        value = int(packed[py, px])
        assert (value == BACKGROUND) == (nearest is None)
        if nearest is not None:
            assert value & 0xFFFFFFFF == nearest[1] and value >> 32 == int(np.float32(nearest[0]).view(np.uint32))

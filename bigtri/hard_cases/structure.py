"""H37 to H46: images of awkward sizes, tiles and bins, order, areas of zero, the guard band's end, snapping, attributes."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import torch

from ..check import stages
from ..ops.interpolate import barycentrics, interpolate
from ..reference import brute_force
from .constructions import HALF, px
from .mesh import SUBPX, Backend, Case, clip_space, f32
from .rules import soup

GUARD = 2**23
NOTHING = 2**63 - 1


def _random(seed: int, count: int, resolution: tuple[int, int], spread: float = 1.3) -> np.ndarray:
    """Clip-space positions [3 count, 4], w between 0.5 and 2, depths in (0, 1)."""
    rng = np.random.default_rng(seed)
    w = rng.uniform(0.5, 2, (count, 3, 1))
    corners = np.concatenate([rng.normal(0, spread, (count, 3, 2)) * w, rng.uniform(-0.9, 0.9, (count, 3, 1)) * w, w], axis=-1)
    return corners.reshape(-1, 4).astype(np.float32)


def _scissor(backend: Backend) -> int:
    """The image under a scissor against a crop of the whole one, between guard words."""
    resolution = (150, 201)
    positions, triangles = _random(37, 30, resolution), soup(30)
    whole = np.asarray(backend.draw(positions, triangles, resolution).packed)
    wrong = 0
    for x0, y0, x1, y1 in ((0, 0, 64, 64), (33, 17, 130, 90), (63, 63, 65, 65), (200, 149, 201, 150), (50, 20, 50, 90)):
        expected = np.full_like(whole, NOTHING)
        expected[y0:y1, x0:x1] = whole[y0:y1, x0:x1]
        wrong += _guarded(backend, positions, triangles, expected, scissor=(x0, y0, x1, y1))
    return wrong


def _sizes(backend: Backend) -> int:
    """Images that end within a tile or a bin, between guard words, against the scalar oracle."""
    wrong = 0
    for resolution in ((1, 1), (1, 65), (65, 1), (63, 63), (65, 65), (9, 127)):
        positions, triangles = _random(38, 12, resolution), soup(12)
        expected, _ = brute_force.rasterize(positions, triangles, *resolution)
        wrong += _guarded(backend, positions, triangles, expected)
    return wrong


def _guarded(backend: Backend, positions: np.ndarray, triangles: np.ndarray, expected: np.ndarray, **options: object) -> int:
    """Words that differ from ``expected`` [H, W], or from the guard words before and behind it."""
    memory = np.full((3, *expected.shape), 0x5555, np.int64)
    backend.draw(positions, triangles, expected.shape, out=memory[1], **options)
    return int((memory[1] != expected).sum() + (memory[::2] != 0x5555).sum())


def _one_pixel_each(backend: Backend) -> int:
    """4096 triangles that cover one pixel each of a 64 x 64 bin: ids in order, and each a tile mask of one bit."""
    y, x = np.mgrid[:64, :64]
    corner = np.stack([x, y], -1).reshape(-1, 1, 2) * SUBPX + HALF
    xy = corner + np.array([[-40, -40], [60, -30], [-30, 60]])
    positions = clip_space(xy, (64, 64))
    drawn = np.asarray(backend.draw(positions, soup(4096), (64, 64)).triangle)
    wrong = int((drawn != np.arange(4096).reshape(64, 64)).sum())
    records = backend.setup(positions, soup(4096), (64, 64))
    bins = stages.binning(records, 0, backend=backend.name)
    queue = bins.candidates[bins.kept]
    bits = (np.arange(4096) // 512 * 8 + np.arange(4096) % 64 // 8).astype(np.uint64)
    for part in (slice(0, 2048), slice(2048, 4096)):
        touched, full = stages.tile_mask(records, queue[part], backend=backend.name)
        wrong += int((touched.view(np.uint64) != np.uint64(1) << bits[part]).sum() + np.count_nonzero(full))
    return wrong


def _deterministic(backend: Backend) -> int:
    """One against two threads, thresholds of the binning stage, the triangles in two halves: the same bits."""
    resolution = (150, 201)
    positions, triangles = _random(40, 60, resolution), soup(60)
    expected = np.asarray(backend.draw(positions, triangles, resolution).packed)
    halves = [np.asarray(backend.draw(positions[part], soup(30), resolution).packed) for part in (slice(90), slice(90, 180))]
    halves[1] = np.where(halves[1] == NOTHING, NOTHING, halves[1] + 30)
    wrong = int((np.minimum(*halves) != expected).sum())
    threads = torch.get_num_threads()
    try:
        for count in (1, 2):
            torch.set_num_threads(count)
            wrong += int((np.asarray(backend.draw(positions, triangles, resolution).packed) != expected).sum())
    finally:
        torch.set_num_threads(threads)
    records = backend.setup(positions, triangles, resolution)
    for threshold in (0, 100, 10**6):
        spans = backend.spans(records, threshold)
        depth = stages.depth(records, spans, backend=backend.name)
        wrong += int((stages.visibility(records, spans, depth, *resolution, backend=backend.name) != expected).sum())
    return wrong


def _order(backend: Backend) -> int:
    """Distinct depths: any order gives one image. Equal depths: the lowest index wins."""
    rng = np.random.default_rng(41)
    resolution = (100, 120)
    positions = _random(41, 50, resolution).reshape(50, 3, 4)
    positions[..., 2] = (np.arange(50)[:, None] / 50 - 0.5) * positions[..., 3]
    expected = np.asarray(backend.draw(positions.reshape(-1, 4), soup(50), resolution).triangle)
    wrong = 0
    for _ in range(5):
        order = rng.permutation(50)
        drawn = np.asarray(backend.draw(positions.reshape(-1, 4), soup(50)[order], resolution).triangle)
        wrong += int((np.where(drawn < 0, -1, order[drawn]) != expected).sum())
    equal = clip_space(rng.integers(0, 100 * SUBPX, (20, 3, 2)), resolution)
    once, thrice = (np.asarray(backend.draw(np.tile(equal, (n, 1)), soup(20 * n), resolution).triangle) for n in (1, 3))
    return wrong + int((once != thrice).sum())


def _no_area(backend: Backend) -> int:
    """Collinear, a vertex twice, all in one point, an area that vanishes by snapping: nothing drawn, nothing dropped."""
    a, b = [10.0, 20.0], [90.0, 60.0]
    xy = [[a, [50, 40], b], [a, a, b], [a, b, b], [a, a, a], [a, b, [50, 40.0009]], [[0, 0], [0, 90], [0, 50]]]
    positions = clip_space(np.array(xy, np.float64) * SUBPX, (100, 100), z=np.linspace(-0.5, 0.5, 18).reshape(6, 3))
    drawn = backend.draw(positions, soup(6), (100, 100))
    zero = backend.draw(np.zeros((3, 4), np.float32), soup(1), (100, 100))
    return sum(int((np.asarray(v.triangle) >= 0).sum()) + int(v.dropped) for v in (drawn, zero))


def _guard_limit(backend: Backend) -> int:
    """Vertices on the guard band's last coordinates, and one and two sub-pixels beyond: never wrapped around."""
    size = 256
    wrong = 0
    for low in (-GUARD, -GUARD - 1, -GUARD - 2):
        for high in (GUARD - 1, GUARD, GUARD + 1):
            for xy in ([[low, low], [high, low], [low, high]], [[low, high], [low, low], [high, high]]):
                positions = clip_space(np.array([xy], np.int64), (size, size))
                drawn = np.asarray(backend.draw(positions, soup(1), (size, size)).triangle)
                y, x = SUBPX * np.mgrid[:size, :size] + HALF
                # The slanted edges are x + y = low + high and x = y; on the latter a centre belongs to the right one.
                side = low + high - (x + y) if xy[1] == [high, low] else y - x
                sure = np.abs(side) > SUBPX  # the slant moves by less than a pixel when its ends are cut off
                wrong += int(((drawn >= 0) != (side > 0))[sure].sum())
    return wrong


def _snapping(backend: Backend) -> int:
    """Halfway between two sub-pixels, on both sides of the middle: to the even one, as Python's round does."""
    size = 128
    k = np.arange(-30, 31)
    corners = [(k + 0.5, k * 0 + 9000), (k + 9000, 3 * k + 0.5), (k * 0 - 9000, -k - 9000)]
    xy = np.stack([np.stack(corner, -1) for corner in corners], axis=1)
    middle = 128 * size
    positions = clip_space(middle + xy, (size, size))
    records = backend.setup(positions, soup(len(k)), (size, size))
    # The distance from the middle is what is rounded, and Python rounds half to even whatever the sign.
    expected = [{(middle + round(x), middle + round(y)) for x, y in triangle} for triangle in xy.tolist()]
    return sum({tuple(v) for v in got} != want for got, want in zip(records.xy.tolist(), expected, strict=True))


def _crowd(backend: Backend) -> int:
    """0, 1 and 70000 triangles in one bin: all are drawn, and the nearest is seen."""
    wrong = 0
    for count in (0, 1, 70_000):
        rng = np.random.default_rng(45)
        xy = rng.integers(0, 62 * SUBPX, (count, 1, 2)) + np.array([[0, 0], [2 * SUBPX, 0], [0, 2 * SUBPX]])
        order = rng.permutation(count)
        z = (order[:, None] - count / 2) / 2**17
        positions = clip_space(xy, (64, 64), np.broadcast_to(z, (count, 3)))
        drawn = np.asarray(backend.draw(positions, soup(count), (64, 64)).triangle)
        first = np.full(64 * 64, count)
        for corner in range(9):  # a right triangle of 2 px covers centres among the 9 around it
            x, y = xy[:, 0, 0] // SUBPX + corner % 3, xy[:, 0, 1] // SUBPX + corner // 3
            dx, dy = x * SUBPX + HALF - xy[:, 0, 0], y * SUBPX + HALF - xy[:, 0, 1]
            hit = (dx >= 0) & (dy >= 0) & (dx + dy < 2 * SUBPX) & (x < 64) & (y < 64)
            np.minimum.at(first, (y * 64 + x)[hit], order[hit])
        back = np.append(np.argsort(order), -1)
        wrong += int((drawn.ravel() != back[first]).sum())
    return wrong


def _attributes(backend: Backend) -> int:
    """w ratios of 10^4 to 10^6: attributes within 4 ulp of rational arithmetic, weights in [0, 1]."""
    rng = np.random.default_rng(46)
    size, wrong = 128, 0
    for ratio in (1e2, 1e4, 1e6):
        xy = px(rng.uniform(-20, 148, (6, 3, 2)))
        w = f32(ratio ** rng.uniform(0, 1, (6, 3)))
        w[:, 0], w[:, 1] = 1, ratio
        for t in range(6):
            positions = clip_space(xy[t], (size, size), 0.0, w[t])
            values = rng.uniform(1, 2, (3, 1)).astype(np.float32)
            drawn = backend.draw(positions, soup(1), (size, size))
            got = np.asarray(interpolate(values, drawn, positions, soup(1), backend=backend.name))[..., 0]
            weights = np.asarray(barycentrics(drawn, positions, soup(1), backend=backend.name))
            wrong += int((~((weights >= 0) & (weights <= 1))).sum())
            inside = np.argwhere(np.asarray(drawn.triangle) >= 0)
            record = brute_force.records(positions, soup(1), size, size)[0][:1]
            for y, x in inside[:: max(len(inside) // 40, 1)].tolist():
                exact = _exact_attribute(record[0].xy, record[0].corner, x, y, w[t].tolist(), values[:, 0].tolist())
                wrong += abs(Fraction(float(got[y, x])) - exact) > 4 * Fraction(2) ** -23
    return wrong


def _exact_attribute(xy: object, corner: object, x: int, y: int, w: list[float], values: list[float]) -> Fraction:
    """Perspective-correct interpolation at the centre of (x, y), fractions."""
    corners = list(zip(xy, corner, strict=True))  # type: ignore[call-overload]
    sx, sy = SUBPX * x + HALF, SUBPX * y + HALF
    top = bottom = Fraction(0)
    for k in range(3):
        (ax, ay), (bx, by) = corners[(k + 1) % 3][0], corners[(k + 2) % 3][0]
        share = Fraction((bx - ax) * (sy - ay) - (by - ay) * (sx - ax)) / Fraction(w[corners[k][1]])
        top, bottom = top + share * Fraction(values[corners[k][1]]), bottom + share
    return top / bottom


def _case(name: str, family: str, title: str, invariant: str, wrong: object, reason: str, unit: str = "px") -> Case:
    return Case(name, family, title, invariant, reason, wrong, unit=unit)  # type: ignore[arg-type]


STRUCTURE: list[Case] = [
    _case(
        "H37",
        "image",
        "Five scissors, also empty and of one pixel",
        "a crop of the whole image; nothing written outside",
        _scissor,
        "A scissor that ends within a tile cuts spans, masks and buffers.",
    ),
    _case(
        "H38",
        "image",
        "Images of 1 x 1 to 65 x 65 px",
        "equals the oracle; guard words untouched",
        _sizes,
        "Tiles and bins that are only partly there.",
    ),
    _case(
        "H39",
        "image",
        "4096 triangles of one pixel in one bin",
        "ids in order; each tile mask has one bit",
        _one_pixel_each,
        "Every pixel of every tile once: an index error somewhere shows.",
    ),
    _case(
        "H40",
        "invariance",
        "Threads, thresholds, halves of the triangles",
        "the same image, in bits",
        _deterministic,
        "What is scheduled differently must not be drawn differently.",
    ),
    _case(
        "H41",
        "invariance",
        "50 triangles in five orders; 20 triangles three times",
        "the same image; the lowest index wins a tie",
        _order,
        "Depth decides, not the order; where depth cannot, the index does.",
    ),
    _case(
        "H42",
        "input",
        "Collinear, twice the same vertex, all zero",
        "nothing drawn, nothing dropped",
        _no_area,
        "An area of zero is divided by if nobody looks.",
    ),
    _case(
        "H43",
        "far",
        "Vertices on the guard band's last sub-pixels and beyond",
        "never wrapped around",
        _guard_limit,
        "One past the end, a fixed-point coordinate changes its sign.",
    ),
    _case(
        "H44",
        "input",
        "61 triangles with vertices halfway between sub-pixels",
        "rounded half to even",
        _snapping,
        "floor(x + 0.5), truncation and rounding agree nearly everywhere.",
        "triangles",
    ),
    _case(
        "H45",
        "capacity",
        "0, 1 and 70000 triangles in one bin",
        "all drawn, the nearest seen",
        _crowd,
        "Lists of fixed length overflow, and what is lost is lost in silence.",
    ),
    _case(
        "H46",
        "attributes",
        "w ratios of 100 to 10^6",
        "attributes within 4 ulp, weights in [0, 1]",
        _attributes,
        "Weights are quotients of numbers that differ by the ratio's square.",
        "samples",
    ),
]

"""Nothing is lost, however much there is, and memory stays bounded: pictures whose answer is known by construction."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from cases import CASES, Case
from counting import on_grid, soup
from numpy.typing import NDArray

import bigtri
from bigtri import Camera, native, render
from bigtri.study import courtyard

pytestmark = pytest.mark.skipif(not native.available(), reason="the extension is not built")

BACKGROUND = 2**63 - 1
MEBIBYTE = 2**20
EXTRA_MEMORY = 256  # MiB that drawing may take beside its arguments and results, whatever is drawn; two threads


def many_full_screen_triangles() -> tuple[Case, NDArray[np.int32], NDArray[np.bool_]]:
    """2,500 triangles that all cover a 4K screen: planes that touch a dome from behind, each nearest in its own cell of 50 x 50.

    Returns:
        The case, the triangle expected at each pixel, and where that is certain: not right beside a border between cells.
    """
    height, width, side = 2160, 3840, 50
    axis = (np.arange(side) + 0.5) * 2 / side - 1
    px, py = (v.reshape(-1, 1) for v in np.meshgrid(axis, axis))  # where each plane touches the dome
    number = np.random.default_rng(60).permutation(side * side)
    corner = np.array([[-1, -1], [3, -1], [-1, 3]])
    z = 0.6 - 0.05 * (px**2 + py**2) - 0.1 * (px * (corner[:, 0] - px) + py * (corner[:, 1] - py))  # window depth
    corners = np.stack([*np.broadcast_arrays(corner[:, 0], corner[:, 1], 2 * z - 1, 1.0)], axis=2)
    triangles = np.arange(3 * side * side, dtype=np.int32).reshape(-1, 3)
    positions = corners[np.argsort(number)].astype(np.float32).reshape(-1, 4)  # triangle number[k] is plane k

    at = [(np.arange(width) + 0.5) / width * side, (1 - (np.arange(height) + 0.5) / height) * side]
    column, row = (a.astype(np.int64) for a in at)
    sure = [np.minimum(a % 1, 1 - a % 1) > 1e-3 for a in at]
    return Case(positions, triangles, (height, width)), number[side * row[:, None] + column], sure[1][:, None] & sure[0]


def many_small_triangles(height: int = 3200, width: int = 3200) -> tuple[Case, NDArray[np.int32]]:
    """A triangle for each pixel, 10.24 million, of one connected mesh, and the one expected at each pixel.

    Cells of 1 x 2 px, cut from the lower left to the upper right: each half has one pixel centre.
    """
    rows, columns = height // 2, width
    x = (np.arange(columns + 1) * (2 / width) - 1).astype(np.float32)
    y = (1 - np.arange(rows + 1) * (4 / height)).astype(np.float32)
    positions = np.zeros((rows + 1, columns + 1, 4), np.float32)
    positions[..., 0], positions[..., 1] = x, y[:, None]
    positions[..., 2] = np.random.default_rng(61).uniform(-0.9, 0.9, positions.shape[:2])
    positions[..., 3] = 1
    a = (np.arange(rows, dtype=np.int32)[:, None] * (columns + 1) + np.arange(columns, dtype=np.int32)).reshape(-1)
    count = 2 * len(a)
    triangles = np.empty((count, 3), np.int32)  # first all upper halves, then all lower ones, each from the last row up
    for half, corners in enumerate(([0, 1, columns + 1], [1, columns + 1, columns + 2])):
        for k, corner in enumerate(corners):
            np.add(a[::-1], np.int32(corner), out=triangles[half * len(a) : (half + 1) * len(a), k])
    number = np.arange(count, dtype=np.int32).reshape(2, rows, columns)[:, ::-1, ::-1]
    expected = np.stack([number[0], number[1]], axis=1)
    return Case(positions.reshape(-1, 4), triangles, (height, width)), expected.reshape(height, width)


def a_million_small_in_one_bin() -> tuple[Case, NDArray[np.int64]]:
    """Triangles of one pixel each, at any of 64 x 64 px and at a depth of their own, and the picture they make."""
    rng = np.random.default_rng(62)
    count = 10**6
    pixel = rng.integers(0, 4096, count)
    level = rng.permutation(2**20)[:count]
    z = (level / 2.0**20).astype(np.float32)  # flat, and exact through 2z - 1
    first = np.stack([pixel % 64, pixel // 64], axis=1)[:, None] * 256
    xy = first + np.array([[20, 20], [420, 20], [20, 420]])
    # Of the neighbours, these corners take in the centres to the right and below no more: 384 + 128 > 440.
    corners = on_grid(xy, np.broadcast_to(z[:, None], (count, 3)), (64, 64)).astype(np.float32)
    packed = np.full(4096, BACKGROUND)
    np.minimum.at(packed, pixel, (z.view(np.int32).astype(np.int64) << 32) | np.arange(count))
    return Case(*soup(corners), (64, 64)), packed.reshape(64, 64)


def a_million_large_in_one_bin() -> Case:
    """Triangles of any shape as large as the only bin."""
    rng = np.random.default_rng(63)
    count = 10**6
    corners = np.ones((count, 3, 4), np.float32)
    corners[..., :2] = rng.normal(0, 2, (count, 3, 2))
    corners[..., 2] = rng.uniform(-0.99, 0.99, (count, 3))
    return Case(*soup(corners), (64, 64))


def drawn_in_parts(case: Case, parts: int) -> torch.Tensor:
    """The minimum of the pictures of consecutive parts of the list, renumbered."""
    result = torch.full(case.resolution, BACKGROUND)
    positions = torch.from_numpy(case.positions)
    first = 0
    for part in np.array_split(case.triangles, parts):
        packed = bigtri.rasterize(positions, torch.from_numpy(part), case.resolution, depth=False).packed
        result = torch.minimum(result, torch.where(packed == BACKGROUND, packed, packed + first))
        first += len(part)
    return result


# --- Nothing is lost ---------------------------------------------------------------------------------------------------------


def test_many_full_screen_triangles_at_4k() -> None:
    """Each of 2,500 is the nearest somewhere, and just there."""
    case, expected, sure = many_full_screen_triangles()
    seen = bigtri.rasterize(*case)
    assert (seen.triangle[sure] == expected[sure]).all()
    assert len(np.unique(seen.triangle)) == 2500 and sure.mean() > 0.99
    parts = drawn_in_parts(case, 9).numpy()
    assert np.array_equal(seen.packed, parts)


def test_ten_million_small_triangles() -> None:
    """Each of 10,240,000 has one pixel of its own, and none is missing."""
    case, expected = many_small_triangles()
    assert len(case.triangles) > 10**7
    seen = bigtri.rasterize(*case, depth=False)
    assert np.array_equal(seen.triangle, expected)


def test_a_million_small_triangles_in_one_bin() -> None:
    case, expected = a_million_small_in_one_bin()
    assert np.array_equal(bigtri.rasterize(*case, depth=False).packed, expected)


def test_a_million_large_triangles_in_one_bin() -> None:
    """In one call as in parts, and a last one in front of them all is not forgotten."""
    case = a_million_large_in_one_bin()
    whole = bigtri.rasterize(*case, depth=False).packed
    assert np.array_equal(whole, drawn_in_parts(case, 7).numpy())
    assert len(np.unique(whole)) > 50
    front = np.float32([[-1, -1, -1, 1], [3, -1, -1, 1], [-1, 3, -1, 1]])
    last = len(case.positions) + np.array([[0, 1, 2]], np.int32)
    positions, triangles = np.concatenate([case.positions, front]), np.concatenate([case.triangles, last])
    assert (bigtri.rasterize(positions, triangles, case.resolution).triangle == 10**6).all()


def test_more_than_float32_can_count() -> None:
    """2^24 + 3 triangles; the last are the only ones that are seen, and float32 would not tell them apart."""
    positions = np.float32([[-1, -1, 0, 1], [3, -1, 0, 1], [-1, 3, 0, 1], [5, 5, 0, 1]])
    triangles = np.full((2**24 + 3, 3), 3, np.int32)  # no area
    triangles[-2:] = [0, 1, 2]
    assert (bigtri.rasterize(positions, triangles, (9, 9), depth=False).triangle == 2**24 + 1).all()


# --- Queues of any size ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [name for name in CASES if name not in ("size_1919x1079", "size_16384x7", "size_3x16384")])
def test_the_smallest_queues_give_the_same_bits(name: str) -> None:
    """One record at a time, one bin at a time: a triangle's fan and its bins do not fit, and are drawn all the same."""
    case = CASES[name](np.random.default_rng([64, *name.encode()]))
    expected = bigtri.rasterize(*case)
    for limits in ((1, 1), (2, 10**6), (10**6, 1), (7, 5)):
        with native.using_parameters(records=limits[0], candidates=limits[1]):
            got = bigtri.rasterize(*case)
        assert all(np.array_equal(a, b) for a, b in zip(expected, got, strict=True)), limits


@pytest.mark.parametrize("threads", [1, 2])
def test_more_views_than_are_drawn_together(threads: int) -> None:
    """7000 records a view: on one thread a pass ends with the third view, within the batch."""
    rng = np.random.default_rng(5)
    views = rng.uniform(-1, 1, (11, 3 * 7000, 4)).astype(np.float32)
    views[..., 3] = 1
    views.reshape(11, -1, 3, 4)[:, :, 1:, :2] = views.reshape(11, -1, 3, 4)[:, :, :1, :2] + rng.uniform(-0.2, 0.2, (2, 2))
    triangles = np.arange(3 * 7000, dtype=np.int32).reshape(-1, 3)
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(threads)
        batch = bigtri.rasterize(views, triangles, (70, 90))
        for k, view in enumerate(views):
            single = bigtri.rasterize(view, triangles, (70, 90))
            assert all(np.array_equal(a[k], b) for a, b in zip(batch, single, strict=True)), k
    finally:
        torch.set_num_threads(before)


def test_the_smallest_queues_hold_the_largest_images() -> None:
    """65,536 bins of one triangle, one at a time."""
    positions = np.float32([[-1, -1, -1, 1], [3, -1, 0, 1], [-1, 3, 0.5, 1], [0.3, 0.9, -2, 0.5], [-2, -2, 3, -1]])
    triangles = np.array([[0, 1, 2], [3, 4, 1], [2, 3, 0]], np.int32)
    expected = bigtri.rasterize(positions, triangles, (4096, 4096), depth=False).packed
    with native.using_parameters(records=1, candidates=1):
        assert np.array_equal(bigtri.rasterize(positions, triangles, (4096, 4096), depth=False).packed, expected)


def test_views_that_see_nothing_among_others_and_the_smallest_queues() -> None:
    """Of triangles behind the camera no record is expected, so such a view has no place in any batch."""
    scene = courtyard.courtyard()
    low, high = scene.positions.min(axis=0), scene.positions.max(axis=0)
    middle, size = (low + high) / 2, high - low
    away = Camera(middle + 2 * size, middle + 3 * size, near=0.1, far=100)
    inside = Camera(middle, middle + (1, 0, 0.3), near=0.05, far=100)
    cameras = [away, courtyard.camera(), away, inside, away]
    expected, (_, buffers) = render(scene, cameras, (45, 70)), render(scene, cameras, (45, 70), return_buffers=True)
    assert [bool((ids >= 0).any()) for ids in buffers.visibility.triangle] == [False, True, False, True, False]
    for limits in ((1, 1), (5000, 10**6), (40_000, 300)):
        with native.using_parameters(records=limits[0], candidates=limits[1]):
            assert np.array_equal(render(scene, cameras, (45, 70)), expected), limits


# --- Memory ------------------------------------------------------------------------------------------------------------------

MEASURE = """
import resource, sys
import numpy as np, torch
import bigtri, test_capacity
torch.set_num_threads(2)
made = getattr(test_capacity, sys.argv[1])()
case = made if isinstance(made, test_capacity.Case) else made[0]
out = np.zeros(case.resolution, np.int64)
def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
def now():
    return next(int(line.split()[1]) // 1024 for line in open("/proc/self/status") if line.startswith("VmRSS"))
bigtri.rasterize(case.positions[:3], case.triangles[:0], (8, 8), depth=False)
before = now()
# What was used and given back while the case was made counts as used already: it is filled again, up to the peak before.
ballast = np.ones(max(0, peak() - before) << 20, np.uint8)
before = now()
bigtri.rasterize(*case, depth=False, out=out)
print(peak() - before)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
@pytest.mark.parametrize(
    "scene", ["many_full_screen_triangles", "many_small_triangles", "a_million_small_in_one_bin", "a_million_large_in_one_bin"]
)
def test_memory_is_bounded(scene: str, record_property) -> None:
    """Beside its arguments and results, a call takes at most 256 MiB, of up to ten million triangles."""
    here = Path(__file__).resolve().parent
    result = subprocess.run(
        [sys.executable, "-c", MEASURE, scene],
        env={**os.environ, "PYTHONPATH": f"{here}:{here.parent}:{here.parents[1]}"},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert result.returncode == 0, result.stderr
    used = int(result.stdout)
    record_property("MiB", used)
    print(f"{scene}: {used} MiB")
    assert used <= EXTRA_MEMORY

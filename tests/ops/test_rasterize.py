"""The public call: what it returns, what it accepts, and what it says of what it does not."""

from __future__ import annotations

import importlib
import itertools
import warnings

import numpy as np
import pytest
import torch
from backends import BACKENDS
from cases import CASES, random_corners, soup

import bigtri
from bigtri import Camera, native
from bigtri.ops import arguments as checks
from bigtri.ops.arguments import as_is, for_operator
from bigtri.study import meshes

POSITIONS = np.array([[-0.5, -0.5, 0, 1], [0.5, -0.5, 0, 1], [0, 0.5, 0, 1]], np.float32)
TRIANGLES = np.array([[0, 1, 2]], np.int32)


@pytest.fixture(params=BACKENDS)
def backend(request):
    return request.param


def test_fields_of_a_visibility(backend):
    v = bigtri.rasterize(torch.from_numpy(POSITIONS), torch.from_numpy(TRIANGLES), (8, 16), backend=backend)
    assert v.packed.dtype == torch.int64 and v.packed.shape == (8, 16)
    assert v.triangle.dtype == torch.int32 and v.triangle.shape == (8, 16)
    assert np.shares_memory(v.triangle.numpy(), v.packed.numpy())
    assert v.depth.dtype == torch.float32 and v.depth.shape == (8, 16)
    assert v.dropped.dtype == torch.int64 and v.dropped.shape == ()
    background = v.triangle == -1
    assert 0 < background.sum() < background.numel()
    assert (v.packed[background] == 2**63 - 1).all() and torch.isinf(v.depth[background]).all()
    assert (v.depth[~background] == 0.5).all() and (v.triangle[~background] == 0).all()
    assert v.triangle[0, 0] == -1 and v.triangle[4, 8] == 0


def test_numpy_in_numpy_out(backend):
    v = bigtri.rasterize(POSITIONS, TRIANGLES, (8, 16), backend=backend)
    assert all(isinstance(field, (np.ndarray, np.generic)) for field in v)
    t = bigtri.rasterize(torch.from_numpy(POSITIONS), torch.from_numpy(TRIANGLES), (8, 16), backend=backend)
    assert all(np.array_equal(a, b.numpy()) for a, b in zip(v, t, strict=True))


def test_batch_equals_single_views(backend):
    views = np.stack([soup(random_corners(np.random.default_rng(k), 12, 1.2), (60, 70)).positions for k in range(3)])
    triangles = np.arange(36, dtype=np.int32).reshape(-1, 3)
    views[1, 4, 2] = np.nan
    batch = bigtri.rasterize(views, triangles, (60, 70), backend=backend)
    assert batch.packed.shape == (3, 60, 70) and batch.dropped.tolist() == [0, 1, 0]
    for k in range(3):
        single = bigtri.rasterize(views[k], triangles, (60, 70), backend=backend)
        assert all(np.array_equal(a[k], b) for a, b in zip(batch, single, strict=True))


@pytest.mark.skipif(not native.available(), reason="the extension is not built")
@pytest.mark.parametrize("threads", [2, 5])
@pytest.mark.parametrize("triangles", [12, 3000])
def test_many_small_views(triangles, threads):
    """Each thread draws some of them by itself: several at a time where triangles are few. The last takes fewer."""
    views = 8 * threads + 3
    rng = np.random.default_rng(triangles)
    size = 1.2 if triangles == 12 else 0.05
    positions = np.stack([soup(random_corners(rng, triangles, size), (70, 130)).positions for _ in range(views)])
    positions[1, 4, 2] = positions[views - 1, 5, 0] = np.nan
    faces = np.arange(3 * triangles, dtype=np.int32).reshape(-1, 3)
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(threads)
        batch = bigtri.rasterize(positions, faces, (70, 130), scissor=(3, 0, 120, 70))
        torch.set_num_threads(1)
        for k in range(views):
            single = bigtri.rasterize(positions[k], faces, (70, 130), scissor=(3, 0, 120, 70))
            assert all(np.array_equal(a[k], b) for a, b in zip(batch, single, strict=True)), k
    finally:
        torch.set_num_threads(before)
    assert np.flatnonzero(batch.dropped).tolist() == [1, views - 1]


@pytest.mark.skipif(not native.available(), reason="the extension is not built")
@pytest.mark.parametrize("variant", native.VARIANTS.get("cpu", ()))
def test_few_of_many_vertices(variant):
    """Fewer corners than vertices: set-up projects them by itself. Some triangles are clipped, one is dropped."""
    mesh = soup(random_corners(np.random.default_rng(11), 40, 1.3), (70, 130))
    place = np.sort(np.random.default_rng(12).permutation(5000)[: len(mesh.positions)]).astype(np.int32)
    positions = np.full((2, 5000, 4), np.nan, np.float32)
    positions[:, place] = mesh.positions
    positions[1, place[7], 2] = np.nan
    seen, expected = (
        bigtri.rasterize(positions, place[mesh.triangles], (70, 130), backend=backend, variant=variant)
        for backend in ("native", "reference")
    )
    assert seen.dropped.tolist() == [0, 1]
    assert all(np.array_equal(a, b) for a, b in zip(seen, expected, strict=True))


@pytest.mark.skipif(not native.available(), reason="the extension is not built")
@pytest.mark.parametrize("variant", native.VARIANTS.get("cpu", ()))
def test_views_of_many_vertices(variant):
    """Of more than 2^20 vertices together: they are drawn group by group. Most triangles have no area."""
    count = 150_000
    positions = np.zeros((3, 3 * count, 4), np.float32)
    positions[..., 3] = 1
    for k in range(3):
        positions[k, -120:] = soup(random_corners(np.random.default_rng(k), 40, 0.4), (70, 130)).positions
    positions[2, -1, 0] = np.nan
    triangles = torch.arange(3 * count, dtype=torch.int32).view(-1, 3)
    batch = bigtri.rasterize(torch.from_numpy(positions), triangles, (70, 130), variant=variant)
    assert batch.dropped.tolist() == [0, 0, 1]
    for k in range(3):
        corners = positions[k, -120:]
        single = bigtri.rasterize(torch.from_numpy(corners), triangles[:40], (70, 130), variant=variant)
        assert torch.equal(batch.depth[k], single.depth) and (single.triangle >= 0).any()
        assert torch.equal(batch.triangle[k], torch.where(single.triangle < 0, -1, single.triangle + count - 40))


RANGES = [(0, 40), (7, 1), (12, 0), (40, 0), (5, 30), (39, 1), (0, 12)]  # overlapping, empty, at the end


@pytest.mark.skipif(not native.available(), reason="the extension is not built")
@pytest.mark.parametrize("width", [1024, 1001])
@pytest.mark.parametrize("views", [1, 3])
def test_rows_without_triangles(views, width):
    """They are stored as one piece, the first 2^21 px of all views in another way than the rest; here and there is a triangle."""
    height = 2200 // views
    one = POSITIONS * np.float32([0.1, 0.1, 1, 1])
    positions = torch.from_numpy(np.stack([one + np.float32([0, y, 0, 0]) for y in (0.7, -0.4, 0)][:views]))
    memory = torch.empty(views * height * width + 1, dtype=torch.int64)
    before = torch.get_num_threads()
    drawn = []
    try:
        for threads, variant in ((1, "scanline"), (1, "bin_owned"), (3, "bin_owned"), (16, "bin_owned")):
            torch.set_num_threads(threads)
            out = memory[1:].view(views, height, width).fill_(-1)  # no row begins on a cache line
            seen = bigtri.rasterize(positions, torch.from_numpy(TRIANGLES), (height, width), variant=variant, out=out)
            drawn.append((seen.packed.clone(), seen.depth))
    finally:
        torch.set_num_threads(before)
    assert (drawn[0][0] != 2**63 - 1).any() and (drawn[0][0] == 2**63 - 1).sum() > 0.9 * memory.numel()
    for packed, depth in drawn[1:]:
        assert torch.equal(packed, drawn[0][0]) and torch.equal(depth, drawn[0][1])


@pytest.mark.parametrize("variant", ["auto", *native.VARIANTS.get("cpu", ())])
def test_ranges_are_views_of_some_triangles(backend, variant):
    if backend == "reference" and variant != "auto":
        pytest.skip("the reference has no variants")
    positions = soup(random_corners(np.random.default_rng(9), 40, 1.3), (70, 130)).positions
    positions[3 * 5, 1] = np.nan
    triangles = np.arange(120, dtype=np.int32).reshape(-1, 3)
    ranges = np.array(RANGES, np.int32)
    options = {"backend": backend, "variant": variant}
    batch = bigtri.rasterize(positions, triangles, (70, 130), ranges=ranges, **options)
    assert batch.packed.shape == (7, 70, 130) and batch.dropped.tolist() == [1, 0, 0, 0, 1, 0, 1]
    for k, (first, count) in enumerate(RANGES):
        single = bigtri.rasterize(positions, triangles[first : first + count], (70, 130), **options)
        assert np.array_equal(batch.depth[k], single.depth) and batch.dropped[k] == single.dropped
        assert np.array_equal(batch.triangle[k], np.where(single.triangle < 0, -1, single.triangle + first))
        assert np.array_equal(batch.packed[k] >> 32, single.packed >> 32)
    reference = bigtri.rasterize(positions, triangles, (70, 130), ranges=ranges, backend="reference")
    assert all(np.array_equal(a, b) for a, b in zip(batch, reference, strict=True))


@pytest.mark.skipif(not native.available(), reason="the extension is not built")
@pytest.mark.parametrize("threads", [1, 3])
def test_ranges_with_the_smallest_queues(threads):
    positions = torch.from_numpy(soup(random_corners(np.random.default_rng(9), 40, 1.3), (70, 130)).positions)
    triangles = torch.arange(120, dtype=torch.int32).reshape(-1, 3)
    ranges = torch.tensor(RANGES * 3, dtype=torch.int32)
    expected = bigtri.rasterize(positions, triangles, (70, 130), ranges=ranges, backend="reference")
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(threads)
        for records, candidates in ((1, 1), (3, 2), (50, 7)):
            limits = {"records": records, "candidates": candidates}
            got = bigtri.rasterize(positions, triangles, (70, 130), ranges=ranges, variant="bin_owned", parameters=limits)
            assert all(torch.equal(a, b) for a, b in zip(got, expected, strict=True)), limits
    finally:
        torch.set_num_threads(before)


def test_what_is_wrong_with_ranges(backend):
    def draw(ranges, positions=POSITIONS, **options):
        return bigtri.rasterize(positions, TRIANGLES, (8, 8), ranges=ranges, backend=backend, **options)

    count = len(TRIANGLES)
    for wrong in ((0, count + 1), (-1, 1), (0, -1), (count + 1, 0), (2**31 - 1, 2**31 - 1)):
        with pytest.raises(RuntimeError, match=rf"ranges must be \(first, count\) within the {count} triangles, got .* view 1"):
            draw(np.array([(0, count), wrong], np.int32))
    with pytest.raises(TypeError, match="ranges must be int32 .B, 2., got int64"):
        draw(np.array([(0, 1)]))
    with pytest.raises(ValueError, match="ranges must have size 2 in dimension 1"):
        draw(np.zeros((3, 3), np.int32))
    with pytest.raises(ValueError, match=r"positions must be \[V, 4\] where ranges says"):
        draw(np.zeros((1, 2), np.int32), POSITIONS[None])
    memory = torch.zeros(64, dtype=torch.int64)
    with pytest.raises(ValueError, match="out must not share memory with ranges"):
        draw(memory.view(torch.int32)[:2].view(1, 2), torch.from_numpy(POSITIONS), out=memory.view(1, 8, 8))
    assert draw(np.zeros((0, 2), np.int32)).packed.shape == (0, 8, 8)


@pytest.mark.skipif(not native.available(), reason="the extension is not built")
@pytest.mark.parametrize("isa", native.isa_levels() if native.available() else [])
@pytest.mark.parametrize("cull", ["none", "back", "front"])
def test_any_number_of_triangles_beside_clipped_ones(cull, isa):
    """Whole triangles are set up eight at a time, clipped ones between them one by one."""
    rng = np.random.default_rng(8)
    corners = random_corners(rng, 35, 0.9)
    corners[4::5, 0, 3] *= -1  # behind the camera
    corners[17, 1, 0] = np.nan
    for count in (*range(1, 19), 35):
        case = soup(corners[:count], (70, 130))
        for scissor in (None, (20, 11, 120, 53)):
            options = {"cull": cull, "scissor": scissor}
            expected = bigtri.rasterize(*case, backend="reference", **options)
            with native.using_isa(isa):
                got = bigtri.rasterize(*case, backend="native", **options)
            assert all(np.array_equal(a, b) for a, b in zip(got, expected, strict=True)), (count, scissor)


@pytest.mark.skipif(not native.available(), reason="the extension is not built")
def test_many_more_threads_than_cores():
    mesh = meshes.body(24, 3)
    cameras = [Camera.framing(mesh.bounds(), azimuth=36.0 * k) for k in range(10)]
    views = torch.from_numpy(np.stack([camera.transform(mesh.vertices, 1.0) for camera in cameras]))
    before, drawn = torch.get_num_threads(), []
    try:
        for threads in (1, 16, 61):
            torch.set_num_threads(threads)
            drawn.append(bigtri.rasterize(views, torch.from_numpy(mesh.triangles), (130, 190), backend="native"))
    finally:
        torch.set_num_threads(before)
    assert all(torch.equal(a, b) for other in drawn[1:] for a, b in zip(other, drawn[0], strict=True))
    assert all(drawn[0].triangle.flatten(1).amax(1) >= 0)


@pytest.mark.skipif(not native.available(), reason="the extension is not built")
@pytest.mark.parametrize(("height", "width"), [(70, 1031), (521, 1031), (1027, 4099), (1027, 4160)])
@pytest.mark.parametrize("isa", native.isa_levels() if native.available() else [])
def test_background_at_any_address(height, width, isa):
    """Of images that are stored through the caches and of some that are streamed around them, and nothing beside it."""
    positions = POSITIONS * np.float32([0.2, 0.1, 1, 1])
    expected = bigtri.rasterize(positions, TRIANGLES, (height, width), variant="scanline", backend="native")
    inputs = torch.from_numpy(positions), torch.from_numpy(TRIANGLES), (height, width)
    for start in (0, 1, 5):
        memory = torch.full((height * width + 16,), 7)
        out = memory[start : start + height * width].view(height, width)
        with native.using_isa(isa):
            got = bigtri.rasterize(*inputs, variant="bin_owned", out=out)
        assert np.array_equal(out, expected.packed) and np.array_equal(got.depth, expected.depth)
        assert (memory[:start] == 7).all() and (memory[start + height * width :] == 7).all()


def test_culling_is_by_winding_on_the_screen(backend):
    drawn = {
        cull: bigtri.rasterize(POSITIONS, TRIANGLES, (8, 8), backend=backend, cull=cull).triangle.max()
        for cull in ("none", "back", "front")
    }
    assert drawn == {"none": 0, "back": 0, "front": -1}


def test_depth_can_be_left_out(backend):
    assert bigtri.rasterize(POSITIONS, TRIANGLES, (8, 8), backend=backend, depth=False).depth is None


def test_out_is_written(backend):
    out = torch.zeros(8, 8, dtype=torch.int64)
    v = bigtri.rasterize(torch.from_numpy(POSITIONS), torch.from_numpy(TRIANGLES), (8, 8), backend=backend, out=out)
    assert v.packed.data_ptr() == out.data_ptr() and (out != 0).all()


@pytest.mark.parametrize("shape", [(0, 4), (2, 0, 4), (0, 3, 4)])
def test_nothing_to_draw(shape, backend):
    v = bigtri.rasterize(np.zeros(shape, np.float32), np.zeros((0, 3), np.int32), (5, 6), backend=backend)
    assert v.packed.shape == (*shape[:-2], 5, 6) and (v.packed == 2**63 - 1).all()
    assert v.dropped.shape == shape[:-2]


def test_memory_of_any_layout(backend):
    case = CASES["screen_size"](np.random.default_rng(0))
    expected = bigtri.rasterize(*case, backend=backend).packed
    strided = np.repeat(case.positions, 2, axis=0)[::2]
    column_major = np.asfortranarray(case.triangles)
    read_only = case.positions.copy()
    read_only.flags.writeable = False
    for positions, triangles in ((strided, case.triangles), (case.positions, column_major), (read_only, case.triangles)):
        assert np.array_equal(bigtri.rasterize(positions, triangles, case.resolution, backend=backend).packed, expected)


def test_a_negative_stride_that_leads_nowhere(backend):
    """An array with one row is contiguous in NumPy whatever the stride of its rows."""
    one = POSITIONS.reshape(1, 3, 4)
    expected = bigtri.rasterize(one, TRIANGLES, (1, 8), backend=backend).packed
    out = np.zeros((1, 1, 8), np.int64)
    seen = bigtri.rasterize(one[::-1], TRIANGLES[::-1], (1, 8), backend=backend, out=out[::-1])
    assert (seen.packed != 2**63 - 1).any() and np.array_equal(seen.packed, expected) and np.array_equal(out, expected)


P, T = torch.from_numpy(POSITIONS), torch.from_numpy(TRIANGLES)
IMAGE = torch.zeros(8, 8, dtype=torch.int64)
with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # torch calls both kinds unfinished
    NESTED, SPARSE_ROWS = [torch.nested.nested_tensor([t, t]) for t in (P, T)], IMAGE.to_sparse_csr()


@pytest.mark.parametrize(
    ("argument", "arguments", "keywords"),
    [
        ("positions", (P.double(), T, (8, 8)), {}),
        ("positions", (P[:, :3], T, (8, 8)), {}),
        ("positions", (P[0], T, (8, 8)), {}),
        ("positions", ([[0.0]], T, (8, 8)), {}),
        ("positions", (None, T, (8, 8)), {}),
        ("triangles", (P, T.long(), (8, 8)), {}),
        ("triangles", (P, T[:, :2], (8, 8)), {}),
        ("triangles", (P, T[0], (8, 8)), {}),
        ("triangles", (P, T.to("meta"), (8, 8)), {}),
        ("resolution", (P, T, (0, 8)), {}),
        ("resolution", (P, T, (8, -1)), {}),
        ("resolution", (P, T, (8, 16385)), {}),
        ("resolution", (P, T, (2**70, 8)), {}),
        ("resolution", (P, T, (8.0, 8)), {}),
        ("resolution", (P, T, 8), {}),
        ("resolution", (P, T, (8, 8, 8)), {}),
        ("cull", (P, T, (8, 8)), {"cull": "both"}),
        ("backend", (P, T, (8, 8)), {"backend": "gpu"}),
        ("variant", (P, T, (8, 8)), {"variant": "fast"}),
        ("precision", (P, T, (8, 8)), {"precision": "double"}),
        ("scissor", (P, T, (8, 8)), {"scissor": (0, 0, 8)}),
        ("scissor", (P, T, (8, 8)), {"scissor": (5, 0, 2, 8)}),
        ("scissor", (P, T, (8, 8)), {"scissor": (0, 0, 2.5, 8)}),
        ("out", (P, T, (8, 8)), {"out": torch.empty(8, 9, dtype=torch.int64)}),
        ("out", (P, T, (8, 8)), {"out": torch.empty(8, 8)}),
        ("out", (P, T, (8, 8)), {"out": torch.empty(8, 16, dtype=torch.int64)[:, ::2]}),
        ("out", (P, T, (8, 8)), {"out": "memory"}),
        ("out", (P, T, (8, 8)), {"out": np.zeros((8, 8), np.int32)}),
        ("out", (P, T, (8, 8)), {"out": np.broadcast_to(np.int64(0), (8, 8))}),
        ("positions", (P.to_sparse(), T, (8, 8)), {}),
        ("positions", (P.to("meta"), T.to("meta"), (8, 8)), {"backend": "reference"}),
        ("positions", (NESTED[0], T, (8, 8)), {}),
        ("triangles", (P, NESTED[1], (8, 8)), {}),
        ("resolution", (P, T, itertools.repeat(8)), {}),
        ("resolution", (P, T, None), {}),
        ("scissor", (P, T, (8, 8)), {"scissor": itertools.count()}),
        ("scissor", (P, T, (8, 8)), {"scissor": ()}),
        ("cull", (P, T, (8, 8)), {"cull": np.array(["none", "back"])}),
        ("cull", (P, T, (8, 8)), {"cull": None}),
        ("backend", (P, T, (8, 8)), {"backend": np.array(["auto", "native"])}),
        ("variant", (P, T, (8, 8)), {"variant": torch.zeros(2)}),
        ("precision", (P, T, (8, 8)), {"precision": 1}),
        ("depth", (P, T, (8, 8)), {"depth": np.ones(2)}),
        ("depth", (P, T, (8, 8)), {"depth": None}),
        ("validate", (P, T, (8, 8)), {"validate": torch.ones(2)}),
        ("validate", (P, T, (8, 8)), {"validate": "yes"}),
    ],
)
def test_errors_name_the_argument(argument, arguments, keywords):
    with pytest.raises((TypeError, ValueError), match=rf"bigtri\.rasterize: {argument} "):
        bigtri.rasterize(*arguments, **keywords)


@pytest.mark.parametrize("views", [(), (2,)])
def test_depth_into_memory_of_the_caller(views, backend):
    positions = POSITIONS if not views else np.stack([POSITIONS, POSITIONS * np.float32([1, 1, 1, 2])])
    expected = bigtri.rasterize(positions, TRIANGLES, (8, 9), backend=backend)
    for out in (None, np.zeros((*views, 8, 9), np.int64)):
        memory = np.zeros((*views, 8, 9), np.float32)
        seen = bigtri.rasterize(positions, TRIANGLES, (8, 9), backend=backend, out=out, depth_out=memory)
        assert np.shares_memory(seen.depth, memory) and np.array_equal(memory, expected.depth)
        assert np.array_equal(seen.packed, expected.packed)
        image = torch.zeros(*views, 8, 9)
        given = torch.from_numpy(positions), torch.from_numpy(TRIANGLES), (8, 9)
        assert bigtri.rasterize(*given, backend=backend, depth_out=image).depth is image
        assert np.array_equal(image.numpy(), expected.depth)


@pytest.mark.parametrize(
    ("depth_out", "error", "text"),
    [
        ("memory", TypeError, r"must be .*, got str$"),
        (IMAGE, TypeError, r"must be float32 \[8, 8\], contiguous, on cpu, got int64 \[8, 8\]$"),
        (np.zeros((8, 9), np.float32), ValueError, r"must be float32 \[8, 8\], contiguous, on cpu, got float32 \[8, 9\]$"),
        (torch.zeros(1, 8, 8), ValueError, r"must be float32 \[8, 8\], contiguous, on cpu, got float32 \[1, 8, 8\]$"),
        (torch.zeros(8, 8).t(), ValueError, r"must be .* with strides \(1, 8\)$"),
        (np.broadcast_to(np.float32(0), (8, 8)), ValueError, "must be writable, got a read-only NumPy array$"),
        (IMAGE.view(torch.float32).view(-1)[32:96].view(8, 8), ValueError, "must not share memory with out$"),
    ],
)
def test_what_depth_out_may_not_be(depth_out, error, text, backend):
    with pytest.raises(error, match=rf"bigtri\.rasterize: depth_out {text}"):
        bigtri.rasterize(P, T, (8, 8), backend=backend, out=IMAGE, depth_out=depth_out)


def test_depth_out_over_an_input_and_without_depth(backend):
    memory = torch.zeros(8, 8)
    positions = memory.view(-1)[:12].view(3, 4).copy_(P)
    with pytest.raises(ValueError, match=r"bigtri\.rasterize: depth_out must not share memory with positions$"):
        bigtri.rasterize(positions, T, (8, 8), backend=backend, depth_out=memory)
    assert torch.equal(positions, P)
    with pytest.raises(
        ValueError, match=r"bigtri\.rasterize: depth_out must be None where depth is False, got float32 \[8, 8\]$"
    ):
        bigtri.rasterize(P, T, (8, 8), backend=backend, depth=False, depth_out=memory)


def freed(tensor: torch.Tensor, size: int = 0) -> torch.Tensor:
    """A copy that has lost its memory, or all but ``size`` bytes of it."""
    copy = tensor.clone()
    copy.untyped_storage().resize_(size)
    return copy


@pytest.mark.parametrize(
    ("out", "error", "got"),
    [
        ("memory", TypeError, "str"),
        (np.zeros((8, 8)), TypeError, r"float64 \[8, 8\]"),
        (np.zeros((8, 8), ">i8"), TypeError, r">i8 \[8, 8\]"),
        (IMAGE.float(), TypeError, r"float32 \[8, 8\]"),
        (IMAGE.to_sparse(), ValueError, "torch.sparse_coo"),
        (SPARSE_ROWS, ValueError, "torch.sparse_csr"),
        (IMAGE[:, :7], ValueError, r"int64 \[8, 7\]"),
        (IMAGE.t(), ValueError, r"int64 \[8, 8\] with strides \(1, 8\)"),
        (np.zeros((8, 8), np.int64)[::-1], ValueError, r"int64 \[8, 8\] with strides \(-64, 8\)"),
        (IMAGE.to("meta"), ValueError, r"int64 \[8, 8\] on meta"),
        (torch._neg_view(IMAGE), ValueError, r"int64 \[8, 8\], a negated view"),
        (torch._efficientzerotensor((8, 8), dtype=torch.int64), ValueError, r"int64 \[8, 8\], a zero tensor without memory"),
        (torch._to_functional_tensor(IMAGE), ValueError, "one inside torch.vmap, torch.func or functionalization"),
        (freed(IMAGE), ValueError, "a storage of 0 bytes"),
        (freed(IMAGE, 504), ValueError, "a storage of 504 bytes"),
    ],
)
def test_what_out_may_not_be(out, error, got, backend):
    with pytest.raises(error, match=rf"bigtri\.rasterize: out must (be|have memory) .*, got {got}$"):
        bigtri.rasterize(P, T, (8, 8), backend=backend, out=out)


@pytest.mark.parametrize("kept", [0, 8])
def test_memory_that_is_gone(kept, backend):
    """torch lets go of a storage under its tensors; whoever reads them then reads what is not theirs."""
    for name, arguments in (("positions", (freed(P, kept), T)), ("triangles", (P, freed(T, kept)))):
        with pytest.raises(ValueError, match=rf"bigtri\.rasterize: {name} must have memory for all its elements, \d+ bytes, got"):
            bigtri.rasterize(*arguments, (8, 8), backend=backend)
    column_major = P.t().contiguous().t()  # the last element is read, whatever the order
    column_major.untyped_storage().resize_(44)
    with pytest.raises(ValueError, match="48 bytes, got a storage of 44 bytes"):
        bigtri.rasterize(column_major, T, (8, 8), backend=backend)
    with pytest.raises(ValueError, match=r"bigtri\.decode_srgb: encoded must have memory"):
        bigtri.decode_srgb(freed(torch.zeros(9, dtype=torch.uint8), kept), backend=backend)
    assert bigtri.decode_srgb(torch.zeros(0, dtype=torch.uint8), backend=backend).shape == (0,)


def test_views_that_negate_and_zeros_without_memory(backend):
    expected = bigtri.rasterize(-P, T, (8, 8), backend=backend).packed
    for negated in (torch._neg_view(P), torch.complex(P, P).conj().imag):
        assert negated.is_neg()
        assert torch.equal(bigtri.rasterize(negated, T, (8, 8), backend=backend).packed, expected)
    zeros = torch._efficientzerotensor((3, 4))
    assert (bigtri.rasterize(zeros, T, (8, 8), backend=backend).triangle == -1).all()
    assert not bigtri.encode_srgb(zeros, backend=backend).any()


def test_functional_and_batched_tensors(backend):
    """Operators that write into memory have no rule for them, and NumPy would read memory that they do not have."""
    functional = torch._to_functional_tensor
    for name, arguments in (("positions", (functional(P), T)), ("triangles", (P, functional(T)))):
        with pytest.raises(ValueError, match=rf"bigtri\.rasterize: {name} must be a plain tensor, got one inside torch.vmap"):
            bigtri.rasterize(*arguments, (8, 8), backend=backend)
    with pytest.raises(ValueError, match=r"bigtri\.rasterize: positions must be a plain tensor, got one inside torch.vmap"):
        torch.vmap(lambda p: bigtri.rasterize(p, T, (8, 8), backend=backend).packed)(P[None])
    if backend == "reference":
        with pytest.raises(ValueError, match=r"bigtri\.encode_srgb: linear must be a plain tensor"):
            bigtri.encode_srgb(functional(P), backend=backend)
    else:
        with pytest.raises(ValueError, match=r"bigtri\.encode_srgb: linear must be a plain tensor, got one inside torch.vmap"):
            torch.vmap(bigtri.encode_srgb)(P)
        gradient = torch.func.grad(lambda p: p.sum() + bigtri.rasterize(p, T, (8, 8), backend=backend).triangle.sum())(P)
        assert (gradient == 1).all()


class Subclass(torch.Tensor):
    """A tensor that may do anything when an operator gets it."""


READ_ONLY = TRIANGLES.copy()
READ_ONLY.flags.writeable = False


@pytest.mark.parametrize(
    "value",
    [
        T.long(),
        T[:, ::2],
        T.to("meta"),
        T.to_sparse(),
        NESTED[1],
        torch._neg_view(T),
        torch._efficientzerotensor((1, 3), dtype=torch.int32),
        torch._to_functional_tensor(T),
        T.as_subclass(Subclass),
        TRIANGLES.tolist(),
        TRIANGLES.astype(">i4"),
        TRIANGLES[:, ::2],
        READ_ONLY,
    ],
)
def test_what_is_not_taken_as_it_is(value):
    """All that an operator would read as something else, or that the checks have something to say about."""
    for ordinary in (T, T[:1], TRIANGLES):
        taken = as_is(ordinary, torch.int32)
        assert taken is not None and np.shares_memory(taken.numpy(), ordinary)
    assert as_is(value, torch.int32) is None


def test_gradients_and_batches_are_not_taken_as_they_are():
    assert as_is(P, torch.float32) is P and as_is(P.clone().requires_grad_(), torch.float32) is None
    seen = []
    torch.vmap(lambda p: (seen.append(as_is(p, torch.float32)), p)[1])(P)
    torch.func.grad(lambda p: (seen.append(as_is(p, torch.float32)), p.sum())[1])(P)
    assert seen == [None, None]


def test_what_an_operator_is_given():
    """Nothing that would be copied or warned of, or that torch would run the operator on by a rule of its own."""
    for whole in (P, P[:0], torch._neg_view(P), P.double()):
        assert for_operator(whole, torch.float32) is whole
    for value in (
        *(P[:, ::2], P.clone().requires_grad_(), P.as_subclass(Subclass), P.tolist(), POSITIONS[:, ::2], P.to("meta")),
        *(torch._efficientzerotensor((3, 4)), torch._to_functional_tensor(P)),
    ):
        assert for_operator(value, torch.float32) is None
    taken = for_operator(POSITIONS, torch.float32)
    assert taken is not None and np.shares_memory(taken.numpy(), POSITIONS)

    def refused(value):
        with pytest.raises(RuntimeError, match="data pointer"):
            for_operator(value, torch.float32)
        return value.sum()

    refused(P.to_sparse())
    torch.vmap(refused)(P)
    torch.func.grad(refused)(P)


ODD_POSITIONS = [
    *(P, P[None], POSITIONS, P[:0], P[None][:0], P[0], P[0, 0], P[None, None], P[:, :3].contiguous(), None, POSITIONS.tolist()),
    *(P.double(), P.int(), P.to(torch.complex64), POSITIONS.astype(">f4"), POSITIONS.astype(object), np.asmatrix(POSITIONS)),
    *(P.t().contiguous().t(), P[:1].expand(3, 4), torch.cat([P[0], P.flatten()])[4:].view(3, 4), np.asfortranarray(POSITIONS)),
    *(torch._neg_view(P), torch._efficientzerotensor((3, 4)), torch._to_functional_tensor(P), P.as_subclass(Subclass)),
    *(P.to("meta"), P.to_sparse(), torch.nested.nested_tensor([P, P]), freed(P), freed(P, 8), P * np.inf),
    *(P.clone().requires_grad_(), torch.nn.Parameter(P.clone(), requires_grad=False)),
]
ODD_TRIANGLES = [
    *(T, TRIANGLES, READ_ONLY, T[:0], T[0], T[None], T.repeat(1, 2)[:, :4], T.long(), T.float(), T - 1, T + 1, T + 2**31 - 3, P),
    *(T.repeat(1, 2)[:, ::2], T[:, :1].expand(1, 3), T.to("meta"), T.to_sparse(), freed(T), freed(T, 8), T.as_subclass(Subclass)),
]


@pytest.mark.filterwarnings("ignore:bigtri.rasterize. positions requires grad")
@pytest.mark.skipif(not native.available(), reason="the extension is not built")
@pytest.mark.parametrize(
    "options", [{}, {"cull": "back", "scissor": (4, 0, 9, 4), "depth": False, "precision": "fast"}, {"precision": "nothing"}]
)
@pytest.mark.parametrize("given", [0, 1, 2])
def test_the_short_way_of_a_call_does_what_the_long_one_does(given, options, monkeypatch):
    """Whatever comes: the same bits, in the same kind of array, or the same error. given: for how many results memory is."""

    def outcome(positions, triangles):
        memory = {"out": torch.full((8, 9), 7), "depth_out": torch.full((8, 9), 7.0)}
        into = dict(list(memory.items())[:given])
        try:
            seen = bigtri.rasterize(positions, triangles, (8, 9), **options, **into)
        except (TypeError, ValueError, RuntimeError) as error:
            assert all((field == 7).all() for field in memory.values())
            return type(error), str(error)
        assert "out" not in into or np.shares_memory(np.asarray(seen.packed), memory["out"].numpy())
        return [None if field is None else (type(field), *field.shape, np.asarray(field).tobytes()) for field in seen]

    pairs = [(positions, T) for positions in ODD_POSITIONS] + [(P, triangles) for triangles in ODD_TRIANGLES]
    short = [outcome(*pair) for pair in pairs]
    monkeypatch.setattr(importlib.import_module("bigtri.ops.rasterize"), "_rasterize_new", None)
    monkeypatch.setattr(importlib.import_module("bigtri.ops.rasterize"), "_rasterize_into", None)
    monkeypatch.setattr(importlib.import_module("bigtri.ops.rasterize"), "_draw_as_is", lambda *given: None)
    for pair, found in zip(pairs, short, strict=True):
        assert outcome(*pair) == found, pair


@pytest.mark.skipif(not native.available(), reason="the extension is not built")
def test_one_call_of_the_operator_draws_what_comes_as_it_is(monkeypatch):
    """The checks cost more than drawing a small picture, and the operator makes them too."""

    def checked(*arguments):
        raise AssertionError("checked again")

    monkeypatch.setattr(checks, "check_tensor", checked)
    out = torch.empty(8, 8, dtype=torch.int64)
    for positions, triangles in ((P, T), (P[None], T), (POSITIONS, TRIANGLES)):
        image = out if positions is P else None
        seen = bigtri.rasterize(positions, triangles, (8, 8), cull="back", scissor=(0, 0, 8, 5), out=image)
        assert (seen.triangle == 0).any()
    with pytest.raises(AssertionError, match="checked again"):
        bigtri.rasterize(P, T[:, :2], (8, 8))


@pytest.mark.parametrize("index", [-1, 3, 2**31 - 1, -(2**31)])
def test_an_index_out_of_range_draws_nothing(index, backend):
    out = torch.full((8, 8), 77, dtype=torch.int64)
    triangles = torch.tensor([[0, 1, 2], [0, 1, index]], dtype=torch.int32)
    with pytest.raises(RuntimeError, match="triangles must index positions, 0 to 2, got indices from"):
        bigtri.rasterize(P, triangles, (8, 8), backend=backend, out=out)
    assert (out == 77).all()


def test_read_only_memory_is_not_written(tmp_path, backend):
    """A mapping of a file opened for reading: writing through it would end the process."""
    np.zeros((8, 8), np.int64).tofile(tmp_path / "image")
    image = np.memmap(tmp_path / "image", np.int64, "r", shape=(8, 8))
    with pytest.raises(ValueError, match=r"bigtri\.rasterize: out must be writable"):
        bigtri.rasterize(POSITIONS, TRIANGLES, (8, 8), backend=backend, out=image)


@pytest.mark.parametrize("name", ["positions", "triangles"])
def test_an_output_over_an_input(name, backend):
    """Indices that change while they are read would lead anywhere; and the caller would lose them."""
    memory = torch.zeros(64, dtype=torch.int64)
    positions, triangles = P, T
    if name == "positions":
        positions = memory.view(torch.float32)[40:52].view(3, 4).copy_(P)
    else:
        triangles = memory.view(torch.int32)[40:43].view(1, 3).copy_(T)
    with pytest.raises(ValueError, match=rf"bigtri\.rasterize: out must not share memory with {name}"):
        bigtri.rasterize(positions, triangles, (8, 8), backend=backend, out=memory.view(8, 8))
    assert torch.equal(positions, P) and torch.equal(triangles, T)


@pytest.mark.parametrize("size", [8, 400])
def test_iterators_are_looked_at_once(size, backend):
    """By the short way of a call, and by what comes behind it where that draws nothing: 400x400 px, columns that lie apart."""
    scissor = (size // 4, 0, size, size)
    for positions in (P, P.t().contiguous().t(), POSITIONS):
        whole = bigtri.rasterize(positions, T, (size, size), backend=backend, scissor=scissor).packed
        seen = bigtri.rasterize(positions, T, iter((size, size)), backend=backend, scissor=iter(scissor)).packed
        assert np.array_equal(seen, whole)


def test_scissor_beyond_the_image_is_cut(backend):
    whole = bigtri.rasterize(POSITIONS, TRIANGLES, (8, 8), backend=backend).packed
    for scissor in ((-100, -100, 100, 100), (-(2**40), 0, 2**40, 8), (0, 0, 2**64, 2**64), (-(2**70), -(2**70), 8, 8)):
        assert np.array_equal(bigtri.rasterize(POSITIONS, TRIANGLES, (8, 8), backend=backend, scissor=scissor).packed, whole)
    for scissor in ((2**64, 0, 2**65, 8), (0, -(2**65), 8, -(2**64)), (8, 8, 8, 8)):
        assert (bigtri.rasterize(POSITIONS, TRIANGLES, (8, 8), backend=backend, scissor=scissor).triangle == -1).all()

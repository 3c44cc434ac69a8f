"""The CUDA kernels as torch sees them: streams, devices, graphs, compilation, and memory."""

from __future__ import annotations

import concurrent.futures
import gc
import os
from collections.abc import Iterator

import numpy as np
import pytest
import torch
from cuda_bits import (
    DEVICE,
    PATHS,
    VARIANTS,
    Scene,
    assert_same,
    case_of,
    draw,
    expected,
    needs_cuda,
    operator_arguments,
    paths_of,
    poison,
    uploaded,
)
from operators import split

import bigtri
from bigtri import native
from bigtri.ops.rasterize import Visibility

pytestmark = needs_cuda


@pytest.fixture(autouse=True)
def _leave_no_memory() -> Iterator[None]:
    """Several processes may share the device (pytest -n)."""
    yield
    torch.cuda.empty_cache()


CLOCKS = 400_000_000  # some 200 ms, also for a host that is busy with other tests: who does not wait for it is seen
NAMES = ("mixed", "layers", "screen_size", "many_small", "behind_camera")
WAITING = ("mixed", "behind_camera")  # for tests that wait so long


@pytest.fixture(params=VARIANTS)
def variant(request):
    return request.param


@pytest.fixture(params=PATHS)
def path(request, variant):
    if request.param not in paths_of(variant):
        pytest.skip("no other way through this variant")
    with native.using_parameters(**PATHS[request.param]):
        yield request.param


def busy() -> torch.cuda.Event:
    """Keep the current stream waiting; the event is done when it goes on."""
    torch.cuda._sleep(CLOCKS)
    event = torch.cuda.Event()
    event.record()
    return event


def views_of(name: str, count: int) -> list[np.ndarray]:
    """Positions of the scene, then moved ones, one of them with numbers that are not finite."""
    positions = case_of(Scene(name)).positions
    views = [positions + np.float32([0.07 * k, -0.05 * k, 0, 0]) for k in range(count)]
    views[-1][::50, 1] = np.nan
    return views


def cpu_pictures(name: str, views: list[np.ndarray]) -> list[Visibility]:
    _, triangles, resolution = case_of(Scene(name))
    seen = [bigtri.rasterize(torch.from_numpy(v), torch.from_numpy(triangles), resolution) for v in views]
    return [Visibility(*(field.to(DEVICE) for field in v)) for v in seen]


# --- Streams and devices -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", WAITING)
def test_the_current_stream_is_used(name, variant, path):
    """Inputs arrive, and results are read, on a stream behind a long wait: on any other, both would be what was there before."""
    positions, triangles, resolution = uploaded(Scene(name))
    wanted = expected(Scene(name))
    late = torch.full_like(positions, torch.nan)
    out = torch.zeros(resolution, dtype=torch.int64, device=DEVICE)
    torch.cuda.synchronize()
    stream = torch.cuda.Stream()

    def seen() -> Visibility:
        return Visibility(*(field.clone() for field in bigtri.rasterize(late, triangles, resolution, variant=variant, out=out)))

    with torch.cuda.stream(stream):
        seen()  # kernels are loaded and this stream has memory: neither happens again
        torch.cuda.synchronize()
        event = busy()
        late.copy_(positions)
        kept = seen()
        out.zero_()
        late.fill_(torch.nan)
        assert not event.query(), "the call waited for the device"
    stream.synchronize()
    assert_same(wanted, kept)


def test_two_streams_at_once(variant, path):
    torch.cuda.synchronize()
    streams = [torch.cuda.Stream() for _ in range(2)]
    names = ("mixed", "layers")
    wanted = [expected(Scene(name)) for name in names]
    arguments = [uploaded(Scene(name)) for name in names]
    torch.cuda.synchronize()
    results: list[tuple[int, Visibility]] = []
    for stream in streams:
        with torch.cuda.stream(stream):
            torch.cuda._sleep(CLOCKS // 40)
    for turn in range(40):
        with torch.cuda.stream(streams[turn % 2]):
            results.append((turn % 2, bigtri.rasterize(*arguments[turn % 2], variant=variant)))
    torch.cuda.synchronize()
    for which, seen in results:
        assert_same(wanted[which], seen, names[which])


def test_threads_with_streams_of_their_own(variant):
    wanted = {name: expected(Scene(name)) for name in NAMES}
    arguments = {name: uploaded(Scene(name)) for name in NAMES}
    torch.cuda.synchronize()

    def work(name: str) -> list[Visibility]:
        with torch.cuda.stream(torch.cuda.Stream()):
            seen = [bigtri.rasterize(*arguments[name], variant=variant) for _ in range(20)]
            torch.cuda.current_stream().synchronize()
        return seen

    with concurrent.futures.ThreadPoolExecutor(len(NAMES)) as pool:
        for name, results in zip(NAMES, pool.map(work, NAMES), strict=True):
            for seen in results:
                assert_same(wanted[name], seen, name)


def test_threads_that_share_a_stream():
    """Graphs that are kept of the stream's frames are everybody's, and each thread's frames are others."""
    wanted = {name: expected(Scene(name)) for name in NAMES}
    arguments = {name: uploaded(Scene(name)) for name in NAMES}
    torch.cuda.synchronize()

    def work(name: str) -> list[Visibility]:
        seen = [bigtri.rasterize(*arguments[name]) for _ in range(40)]
        return seen[::3]  # what the others had lies free meanwhile

    with concurrent.futures.ThreadPoolExecutor(2 * len(NAMES)) as pool:
        for name, results in zip(2 * NAMES, pool.map(work, 2 * NAMES), strict=True):
            for seen in results:
                assert_same(wanted[name], seen, name)


def test_frames_of_many_sizes(variant, path):
    """Kernels that are launched again, with other parameters, grids, outputs, and in other streams."""
    arguments = {name: uploaded(Scene(name)) for name in NAMES}
    whole = {name: expected(Scene(name)) for name in NAMES}
    positions, triangles, _ = arguments["mixed"]
    sizes = [(1, 1), (64, 64), (33, 150), (200, 7), (256, 256)]
    small = [bigtri.rasterize(positions.cpu(), triangles.cpu(), size).packed.to(DEVICE) for size in sizes]
    for turn in range(40):
        name, at = NAMES[turn % len(NAMES)], turn % len(sizes)
        with torch.cuda.stream(torch.cuda.Stream() if turn % 7 == 0 else torch.cuda.current_stream()):
            assert_same(whole[name], bigtri.rasterize(*arguments[name], variant=variant), (name, turn))
            seen = bigtri.rasterize(positions, triangles, sizes[at], variant=variant, depth=turn % 3 == 0)
            assert torch.equal(seen.packed, small[at]), (sizes[at], turn)


@pytest.mark.parametrize("name", WAITING)
def test_the_host_never_waits(name, variant, path):
    """torch's own check, and that the call returns while the stream is still busy; batches too."""
    positions, triangles, resolution = uploaded(Scene(name))
    batch = torch.stack([positions] * 3)

    def both() -> list[Visibility]:
        return [bigtri.rasterize(views, triangles, resolution, variant=variant) for views in (positions, batch)]

    both()  # loads kernels and leaves memory behind
    torch.cuda.synchronize()
    torch.cuda.set_sync_debug_mode("error")
    try:
        event = busy()
        seen, many = both()
        assert not event.query(), "the call waited for the device"
    finally:
        torch.cuda.set_sync_debug_mode("default")
    assert_same(expected(Scene(name)), seen)
    for k in range(3):
        assert_same(expected(Scene(name)), Visibility(*(field[k] for field in many)), k)


@pytest.mark.parametrize("name", NAMES)
def test_a_device_that_is_not_the_current_one(name, variant):
    if torch.cuda.device_count() < 2:
        pytest.skip("one CUDA device")
    case = case_of(Scene(name))
    arguments = torch.from_numpy(case.positions).to("cuda:1"), torch.from_numpy(case.triangles).to("cuda:1")
    with torch.cuda.device(0):
        seen = bigtri.rasterize(*arguments, case.resolution, variant=variant)
        assert seen.packed.device == torch.device("cuda:1") and torch.cuda.current_device() == 0
    assert_same(expected(Scene(name)), Visibility(*(field.to(DEVICE) for field in seen)))
    for positions, triangles in ((arguments[0], arguments[1].to("cuda:0")), (arguments[0].to("cuda:0"), arguments[1])):
        with pytest.raises(ValueError, match=r"bigtri\.rasterize: triangles must be on positions's device"):
            bigtri.rasterize(positions, triangles, case.resolution)
    with pytest.raises(ValueError, match=r"bigtri\.rasterize: out must be"):
        bigtri.rasterize(*arguments, case.resolution, out=torch.zeros(case.resolution, dtype=torch.int64, device="cuda:0"))


# --- Graphs and compilation --------------------------------------------------------------------------------------------------


def test_ranges_in_a_graph(variant, path):
    """A batch of different meshes: ranges that overlap, empty ones, more than a launch carries; a graph keeps those that it was
    captured with."""
    positions, triangles, _ = uploaded(Scene("mixed"))
    resolution, total = (37, 50), len(triangles)
    firsts = torch.arange(0, 600) * 7 % total
    ranges = torch.stack([firsts, torch.minimum(torch.arange(0, 600) % 250, total - firsts)], dim=1).to(torch.int32)
    wanted = bigtri.rasterize(positions.cpu(), triangles.cpu(), resolution, ranges=ranges)
    wanted = Visibility(wanted.packed.to(DEVICE), wanted.depth.to(DEVICE), wanted.dropped.to(DEVICE))
    assert_same(wanted, bigtri.rasterize(positions, triangles, resolution, ranges=ranges, variant=variant), "eager")
    given = ranges.clone()
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        seen = bigtri.rasterize(positions, triangles, resolution, ranges=given, variant=variant)
    given.zero_()
    for _ in range(3):
        seen.packed.zero_()
        graph.replay()
        assert_same(wanted, seen, "replayed")


@pytest.mark.parametrize("name", NAMES)
def test_graph(name, variant, path):
    """Captured once, replayed with other vertices in the same memory, onto outputs that hold something else."""
    positions, triangles, resolution = uploaded(Scene(name))
    views = views_of(name, 5)
    wanted = cpu_pictures(name, views)
    static = positions.clone()
    out = torch.empty(resolution, dtype=torch.int64, device=DEVICE)
    side = torch.cuda.Stream()
    side.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(side):
        bigtri.rasterize(static, triangles, resolution, variant=variant, out=out)
    torch.cuda.current_stream().wait_stream(side)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        seen = bigtri.rasterize(static, triangles, resolution, variant=variant, out=out)
    for turn in (0, 1, 2, 3, 4, 0, 4, 2):
        static.copy_(torch.from_numpy(views[turn]))
        seen.packed.zero_()
        seen.depth.fill_(-1)
        seen.dropped.fill_(77)
        graph.replay()
        assert_same(wanted[turn], seen, turn)
        with native.using_parameters(warps=16, blocks=3):
            assert_same(wanted[turn], bigtri.rasterize(static, triangles, resolution, variant=variant), turn)
    for _ in range(20):
        graph.replay()
    assert_same(wanted[2], seen)


def test_graphs_of_the_caller_between_frames_that_are_kept():
    """Frames that are launched as they were, while others are captured; other vertices come into the same memory."""
    _, triangles, resolution = uploaded(Scene("mixed"))
    views = views_of("mixed", 3)
    wanted = cpu_pictures("mixed", views)
    static = torch.from_numpy(views[0]).to(DEVICE)
    graphs = []
    for turn in range(9):
        static.copy_(torch.from_numpy(views[turn % 3]))
        for _ in range(4):
            assert_same(wanted[turn % 3], bigtri.rasterize(static, triangles, resolution), turn)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            graphs.append((graph, bigtri.rasterize(static, triangles, resolution)))
        for again, seen in graphs:
            seen.packed.zero_()
            again.replay()
            assert_same(wanted[turn % 3], seen, turn)


@pytest.mark.parametrize("name", ["mixed", "screen_size"])
def test_graph_of_a_batch(name, variant, path):
    _, triangles, resolution = uploaded(Scene(name))
    views = views_of(name, 3)
    wanted = cpu_pictures(name, views)
    static = torch.from_numpy(np.stack(views)).to(DEVICE)
    bigtri.rasterize(static, triangles, resolution, variant=variant)
    torch.cuda.synchronize()
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        seen = bigtri.rasterize(static, triangles, resolution, variant=variant)
    for order in ([0, 1, 2], [2, 0, 1], [1, 1, 1]):
        static.copy_(torch.from_numpy(np.stack([views[k] for k in order])))
        graph.replay()
        for k, view in enumerate(order):
            assert_same(wanted[view], Visibility(*(field[k] for field in seen)), order)


def test_compile_full_graph(variant):
    positions, triangles, resolution = uploaded(Scene("screen_size"))

    def picture(positions: torch.Tensor, shift: torch.Tensor) -> tuple[torch.Tensor, ...]:
        seen = bigtri.rasterize(positions + shift, triangles, resolution, variant=variant)
        return *seen, seen.triangle, torch.where(seen.triangle < 0, 0.0, seen.depth) * 2

    torch.compiler.reset()  # it compiles the same function for a few variants only, and there are more
    compiled = torch.compile(picture, fullgraph=True)
    for shift in (0.0, 0.25, -0.5):
        by = torch.tensor([shift, 0, 0, 0], device=DEVICE)
        wanted, got = picture(positions, by), compiled(positions, by)
        assert_same(Visibility(*wanted[:3]), Visibility(*got[:3]), shift)
        assert all(torch.equal(a, b) for a, b in zip(wanted[3:], got[3:], strict=True))


def test_opcheck(variant):
    utilities = ("test_schema", "test_autograd_registration", "test_faketensor", "test_aot_dispatch_dynamic")
    given, named = split("rasterize", operator_arguments(variant))
    torch.library.opcheck(torch.ops.bigtri.rasterize, given, named, test_utils=utilities)
    if variant == VARIANTS[0]:
        whole = *given[:4], "none", None, "exact", True
        torch.library.opcheck(torch.ops.bigtri.rasterize_new, whole, {}, test_utils=utilities)
        packed, depth, _ = torch.ops.bigtri.rasterize_new(*whole)
        torch.library.opcheck(
            torch.ops.bigtri.rasterize_into, (*given[:4], torch.empty_like(packed), depth), {}, test_utils=utilities
        )


def test_inputs_that_require_grad(variant, path):
    positions, triangles, resolution = uploaded(Scene("screen_size"))
    seen = bigtri.rasterize(positions.clone().requires_grad_(), triangles, resolution, variant=variant)
    assert not any(field.requires_grad for field in seen)
    assert_same(expected(Scene("screen_size")), seen)
    with torch.inference_mode():
        assert_same(expected(Scene("screen_size")), draw(Scene("screen_size"), variant=variant))


# --- Memory ------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_memory_is_torchs_own_and_returns(name, variant, path):
    """Outputs and scratch come from torch's allocator, go back to it, and nothing is taken from the device beside it."""
    positions, triangles, resolution = uploaded(Scene(name))
    pixels = resolution[0] * resolution[1]
    for _ in range(3):
        seen = bigtri.rasterize(positions, triangles, resolution, variant=variant)
        del seen
    torch.cuda.synchronize()
    gc.collect()
    free = torch.cuda.mem_get_info()[0]
    before = torch.cuda.memory_allocated()
    torch.cuda.reset_peak_memory_stats()
    seen = bigtri.rasterize(positions, triangles, resolution, variant=variant)
    held = torch.cuda.memory_allocated() - before
    assert 12 * pixels <= held <= 12 * pixels + 8192, "packed, depth and dropped are held, and nothing else"
    assert torch.cuda.max_memory_allocated() - before >= held
    del seen
    assert torch.cuda.memory_allocated() == before
    for _ in range(50):
        bigtri.rasterize(positions, triangles, resolution, variant=variant)
    torch.cuda.synchronize()
    assert torch.cuda.memory_allocated() == before
    # What is free is the whole device's: another process, such as a parallel run of these tests, takes of it too.
    assert "PYTEST_XDIST_WORKER" in os.environ or torch.cuda.mem_get_info()[0] >= free


def test_inputs_freed_right_after_the_call(variant, path):
    """The call is behind a wait when its inputs go back to the allocator and others fill their memory."""
    for name in ("mixed", "screen_size"):
        positions, triangles, resolution = uploaded(Scene(name))
        wanted = expected(Scene(name))
        torch.cuda.synchronize()
        busy()
        results = []
        for turn in range(8):
            mine, faces = positions.clone(), triangles.clone()
            sizes = [4 * mine.numel(), 4 * faces.numel()]
            results.append(bigtri.rasterize(mine, faces, resolution, variant=variant))
            del mine, faces
            poison((0xFF, 0x00)[turn % 2], *sizes)
        for turn, seen in enumerate(results):
            assert_same(wanted, seen, (name, turn))

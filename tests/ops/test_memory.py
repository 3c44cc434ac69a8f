"""Memory of results that is used again: never while anything refers to it, never more than the limit."""

from __future__ import annotations

import gc
import os
import threading

import pytest
import torch
from backends import BACKENDS

import bigtri
from bigtri import memory, native
from bigtri.ops.memory import SMALLEST

POSITIONS = torch.tensor([[-1.0, -1.0, 0.0, 1.0], [3.0, -1.0, 0.5, 1.0], [-1.0, 3.0, 0.25, 1.0]])
TRIANGLES = torch.tensor([[0, 1, 2]], dtype=torch.int32)
SIZE = (400, 512)  # packed has 1.6 MB


@pytest.fixture(autouse=True)
def empty_cache():
    gc.collect()
    memory.release()
    before = memory.limit()
    yield
    memory.limit(before)
    memory.release()


def draw(backend: str = "auto", depth: bool = False, size: tuple[int, int] = SIZE) -> bigtri.Visibility:
    return bigtri.rasterize(POSITIONS, TRIANGLES, size, backend=backend, depth=depth)


@pytest.mark.parametrize("backend", BACKENDS)
def test_memory_comes_back_when_the_last_view_is_gone(backend: str) -> None:
    first = draw(backend)
    address = first.packed.data_ptr()
    assert address % 64 == 0 and memory.held() == 0
    triangle, row = first.triangle, first.packed[3]
    del first
    assert draw(backend).packed.data_ptr() != address  # a view is alive
    memory.release()
    del triangle
    assert draw(backend).packed.data_ptr() != address
    memory.release()
    expected = row.clone()
    assert torch.equal(row, expected)
    del row
    again = draw(backend)
    assert again.packed.data_ptr() == address and memory.held() == 0
    assert torch.equal(again.packed[3], expected)


def test_an_array_keeps_its_memory() -> None:
    seen = bigtri.rasterize(POSITIONS.numpy(), TRIANGLES.numpy(), SIZE, depth=False)
    triangle = seen.triangle
    del seen
    others = [bigtri.rasterize(POSITIONS.numpy(), TRIANGLES.numpy(), SIZE, cull="back", depth=False) for _ in range(3)]
    assert memory.held() == 0 and (triangle == 0).all() and len({other.packed.ctypes.data for other in others}) == 3
    del triangle
    assert memory.held() > 0


def test_results_that_live_together_share_nothing() -> None:
    results = [draw(depth=True) for _ in range(4)]
    places = sorted((t.data_ptr(), t.nbytes) for result in results for t in (result.packed, result.depth))
    assert all(a + n <= b for (a, n), (b, _) in zip(places, places[1:], strict=False))


def test_only_what_is_about_as_large_is_used() -> None:
    draw(size=(800, 512))
    held = memory.held()
    small = draw()
    assert memory.held() == held >= 800 * 512 * 8
    del small
    less = draw(size=(700, 512))
    assert memory.held() < held + SIZE[0] * SIZE[1] * 8 and less.packed.shape == (700, 512)


def test_small_results_are_left_to_torch() -> None:
    draw(size=(8, 8))
    assert SMALLEST > 8 * 8 * 8 and memory.held() == 0


def test_the_limit() -> None:
    one = SIZE[0] * SIZE[1] * 8 + 64
    memory.limit(2 * one)
    results = [draw() for _ in range(5)]
    del results
    assert memory.held() == 2 * one
    assert memory.limit(one) == one and memory.held() == one
    memory.limit(0)
    draw()
    assert memory.held() == 0
    memory.limit(one)
    draw()
    assert memory.held() == one
    memory.release()
    assert memory.held() == 0
    for wrong, error in ((-1, ValueError), (1.5, TypeError), ("1", TypeError)):
        with pytest.raises(error, match="bigtri.memory.limit: most must be an integer of at least 0, got"):
            memory.limit(wrong)  # type: ignore[arg-type]


def test_every_operator_that_makes_an_image_uses_it() -> None:
    seen = draw(depth=True, size=(600, 512))
    uv = bigtri.interpolate(torch.rand(3, 2), seen, POSITIONS, TRIANGLES)
    color = bigtri.sample_texture(torch.rand(4, 4, 3), uv)
    results = [bigtri.encode_srgb(torch.rand(1200, 1024)), bigtri.barycentrics(seen, POSITIONS, TRIANGLES)]
    expected = sum(t.nbytes + 64 for t in (seen.packed, seen.depth, uv, color, *results))
    seen = uv = color = results = None
    assert memory.held() == expected


@pytest.mark.skipif(not native.available(), reason="the extension is not built")
def test_working_memory_is_kept_and_bounded() -> None:
    def drawn(count: int) -> torch.Tensor:
        corners = torch.rand(3 * count, 4, generator=torch.Generator().manual_seed(count)) * 2 - 1
        corners[:, 3] = 1
        corners.view(-1, 3, 4)[:, 1:, :2] = corners.view(-1, 3, 4)[:, :1, :2] + torch.tensor([[0.1, 0.0], [0.0, 0.1]])
        triangles = torch.arange(3 * count, dtype=torch.int32).view(-1, 3)
        return torch.as_tensor(bigtri.rasterize(corners, triangles, (64, 64), variant="bin_owned").packed)

    assert memory.working() == 0
    expected = drawn(3000)
    kept = memory.working()
    assert 3000 * 96 < kept < 4 << 20
    assert torch.equal(drawn(3000), expected) and memory.working() == kept
    drawn(300_000)
    assert kept < memory.working() <= 128 << 20
    memory.release()
    assert memory.working() == 0
    drawn(3_000_000)  # vertices alone are more than is kept
    assert memory.working() == 0
    assert torch.equal(drawn(3000), expected)


def test_several_callers_at_once() -> None:
    expected = {cull: bigtri.rasterize(POSITIONS, TRIANGLES, SIZE, cull=cull).packed.clone() for cull in ("none", "back")}
    wrong: list[str] = []

    def work(cull: str) -> None:
        for _ in range(60):
            if not torch.equal(bigtri.rasterize(POSITIONS, TRIANGLES, SIZE, cull=cull).packed, expected[cull]):
                wrong.append(cull)

    callers = [threading.Thread(target=work, args=(cull,)) for cull in ("none", "back") * 2]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join()
    assert not wrong and memory.held() <= memory.limit()


def test_collected_in_the_middle_of_a_call() -> None:
    """The collector may give memory back while the cache is being looked at."""

    class Cycle:
        def __init__(self, result: torch.Tensor) -> None:
            self.me, self.result = self, result

    before = gc.get_threshold()
    try:
        gc.set_threshold(1)
        for _ in range(50):
            Cycle(draw().packed)
    finally:
        gc.set_threshold(*before)
    assert (draw().triangle == 0).all() and memory.held() <= memory.limit()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_a_forked_child_has_its_own() -> None:
    kept = draw()
    draw()
    memory._cache.lock.acquire()
    try:
        child = os.fork()
        if not child:
            try:
                torch.set_num_threads(1)  # torch's own threads are not there
                memory.release()
                os._exit(0 if draw("reference").packed.equal(kept.packed) and memory.held() else 1)
            finally:
                os._exit(2)
    finally:
        memory._cache.lock.release()
    assert os.waitpid(child, 0)[1] == 0


def test_under_compile_torch_allocates() -> None:
    compiled = torch.compile(lambda p: bigtri.rasterize(p, TRIANGLES, SIZE, backend="auto").packed, backend="aot_eager")
    assert torch.equal(compiled(POSITIONS), draw().packed)


def test_memory_of_an_image_is_written_whole() -> None:
    """What an earlier result left shows nowhere."""
    first = bigtri.rasterize(POSITIONS, TRIANGLES, SIZE)
    expected = [field.clone() for field in first]
    del first
    bigtri.rasterize(POSITIONS * torch.tensor([1, 1, -1, 1]), TRIANGLES, SIZE, scissor=(5, 5, 100, 90))
    assert all(torch.equal(a, b) for a, b in zip(expected, bigtri.rasterize(POSITIONS, TRIANGLES, SIZE), strict=True))


def test_a_large_result_is_whole_huge_pages() -> None:
    large = draw(size=(1024, 1024)).packed
    assert large.data_ptr() % (2 << 20) == 0 and draw(size=(400, 512)).packed.data_ptr() % 64 == 0
    numbers = torch.arange(large.numel())
    large.copy_(numbers.view_as(large))
    assert torch.equal(large.view(-1), numbers)

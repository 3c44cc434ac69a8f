"""The clock: how long a call takes, how much memory it needs, how evenly it loads threads, and what holds meanwhile.

It warms up, then repeats until its time is spent, and reports median, minimum and quartiles: on a shared machine the minimum is
what the code can do, the distance between the quartiles how far to trust the median.

On CUDA it is the device's time that counts, not what the host takes to ask for it: calls are captured in CUDA graphs, whose
replays are timed by events.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from .. import native
from ..torch_private import keep_the_device_busy


class Timing(NamedTuple):
    """Milliseconds per call."""

    median: float
    minimum: float
    p25: float
    p75: float
    repeats: int


def summary(ms: Sequence[float]) -> Timing:
    p25, median, p75 = np.percentile(ms, [25, 50, 75])
    return Timing(float(median), float(min(ms)), float(p25), float(p75), len(ms))


def clock(call: Callable[[], object], seconds: float, warm: int = 2, at_least: int = 5, at_most: int = 1000) -> list[float]:
    """Milliseconds of each call, for about `seconds` but at least `at_least` calls, after `warm` calls that do not count."""
    for _ in range(warm):
        call()
    ms: list[float] = []
    end = time.perf_counter() + seconds
    while len(ms) < at_least or (time.perf_counter() < end and len(ms) < at_most):
        start = time.perf_counter()
        call()
        ms.append((time.perf_counter() - start) * 1e3)
    return ms


def interleaved(
    calls: Mapping[str, Callable[[], object]], seconds: float, at_least: int = 5, at_most: int = 400, device: str = "cpu"
) -> dict[str, list[float]]:
    """Milliseconds of each call by name, one of each a round, for about `seconds` but at least `at_least` rounds.

    Each round has an order of its own, so that no call always comes after the same one; the first round does not count. On
    "cuda" a call may only enqueue: it is captured, and its time is what it takes the device in a row of its like.
    """
    if device == "cuda":
        pool = torch.cuda.graph_pool_handle()  # what the calls work with meanwhile, which no two do at once
        timed = {name: _timed_replay(call, pool) for name, call in calls.items()}
    else:
        timed = {name: functools.partial(wall_ms, call) for name, call in calls.items()}
    rng = np.random.default_rng(0)
    names = list(calls)
    ms: dict[str, list[float]] = {name: [] for name in names}
    end = time.perf_counter() + seconds
    done = -1
    while done < at_least or (time.perf_counter() < end and done < at_most):
        for name in rng.permutation(names).tolist():
            value = timed[name]()
            if done >= 0:
                ms[name].append(value)
        done += 1
    return ms


def wall_ms(call: Callable[[], object]) -> float:
    """Milliseconds of one call by the host's clock."""
    start = time.perf_counter()
    call()
    return (time.perf_counter() - start) * 1e3


# --- CUDA

# A replay is of so many calls as take about so many milliseconds, so that what starting it costs is little beside them.
_REPLAY_MS, _MOST_CALLS = 0.4, 20
_WAIT_CYCLES = 200_000  # of the device's clock, some 100 us: longer than the host takes to start a replay


def captured(call: Callable[[], object], count: int, pool: Any = None) -> torch.cuda.CUDAGraph:
    """A CUDA graph of so many calls in a row; pool: memory that it shares with graphs that are not replayed at the same time."""
    stream = torch.cuda.Stream()
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        call()  # loads kernels, and gives torch its memory
    torch.cuda.current_stream().wait_stream(stream)
    torch.cuda.synchronize()
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph, pool=pool, stream=stream):
        for _ in range(count):
            call()
    return graph


def device_ms(call: Callable[[], object]) -> float:
    """Milliseconds of the device for a call that only enqueues, however long the host takes for it."""
    start, end = torch.cuda.Event(enable_timing=True), torch.cuda.Event(enable_timing=True)
    keep_the_device_busy(_WAIT_CYCLES)
    start.record()
    call()
    end.record()
    torch.cuda.synchronize()
    return start.elapsed_time(end)


def _timed_replay(call: Callable[[], object], pool: Any) -> Callable[[], float]:
    """What replays a call and gives its milliseconds."""
    call()  # loads kernels, and gives torch its memory
    ms = min(device_ms(call) for _ in range(5))  # the first calls find the device idle, its clocks low
    count = int(min(max(1.0, _REPLAY_MS / max(ms, 1e-3)), _MOST_CALLS))
    graph = captured(call, count, pool)
    return lambda: device_ms(graph.replay) / count


def peak_mib(call: Callable[[], object]) -> float | None:
    """How far the resident memory rises above where it was during `call`, MiB; None where the system cannot say.

    Measured on a first call, before scratch memory is kept for reuse.
    """

    def resident(field: str) -> int:  # KiB
        return int(next(line for line in status.read_text().splitlines() if line.startswith(field)).split()[1])

    status = Path("/proc/self/status")
    try:
        Path("/proc/self/clear_refs").write_text("5")  # resets VmHWM, the high-water mark (Linux)
        before = resident("VmRSS")
    except (OSError, StopIteration):
        call()
        return None
    call()
    return max(0, resident("VmHWM") - before) / 1024


class Load(NamedTuple):
    """How evenly a call's parallel loops load threads, milliseconds of processor time; the median of several calls."""

    longest: float  # the thread that works longest in a loop; all loops together
    mean: float  # of all threads


def thread_load(call: Callable[[], object], threads: int, calls: int = 9) -> Load:
    """How ``call``, which draws on the CPU, would load ``threads`` equal cores, however many there are here.

    One thread does all the work. Each piece is timed and counts for the thread that would have taken it: the first that is
    free. Asking for the time takes some 0.3 us, which is part of each piece. What a core has to wait for, memory above all, is
    not in it where another core would be the reason. Nothing else may draw meanwhile.
    """
    loads = []
    call()
    torch.ops.bigtri.thread_load(threads)
    try:
        for _ in range(calls):
            torch.ops.bigtri.thread_load(threads)
            call()
            longest, every = torch.ops.bigtri.thread_load(threads)
            loads.append(Load(longest / 1e6, every / 1e6 / threads))
    finally:
        torch.ops.bigtri.thread_load(0)
    return sorted(loads, key=lambda load: load.longest / max(load.mean, 1e-9))[calls // 2]


@contextmanager
def setting(threads: int, isa: str | None = None) -> Iterator[None]:
    """torch's thread count and bigtri's instruction set for a while."""
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        with native.using_isa(isa or native.isa()):
            yield
    finally:
        torch.set_num_threads(before)

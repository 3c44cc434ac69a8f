"""The clock: how long a call takes, how much memory it needs, how evenly it loads threads, and what holds meanwhile.

It warms up, then repeats until its time is spent, and reports median, minimum and quartiles: on a shared machine the minimum is
what the code can do, the distance between the quartiles how far to trust the median.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from .. import native


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
    calls: Mapping[str, Callable[[], object]], seconds: float, at_least: int = 5, at_most: int = 400
) -> dict[str, list[float]]:
    """Milliseconds of each call by name, one of each a round, for about `seconds` but at least `at_least` rounds.

    Each round has an order of its own, so that no call always comes after the same one; the first round does not count.
    """
    rng = np.random.default_rng(0)
    names = list(calls)
    ms: dict[str, list[float]] = {name: [] for name in names}
    end = time.perf_counter() + seconds
    done = -1
    while done < at_least or (time.perf_counter() < end and done < at_most):
        for name in rng.permutation(names).tolist():
            start = time.perf_counter()
            calls[name]()
            if done >= 0:
                ms[name].append((time.perf_counter() - start) * 1e3)
        done += 1
    return ms


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

"""How GPU time is measured, and the rows it goes into. cuda_run.py, best.py and cuda_scaling.py share it.

Four methods by CUDA events, in microseconds for a frame, or for a batch of them:
* `graph`: the replay of a CUDA graph that holds one frame;
* `graph20`: the replay of a graph that holds 20 frames, divided by 20: what a frame costs in a stream of them;
* `eager`: the call as Python makes it;
* `cold`: as `graph`, after a buffer of 256 MB has been zeroed, which leaves nothing else in the L2 cache.

A kernel that only waits runs in front of every measurement, for longer than the host needs to enqueue it: the host's time is
never in it. It does contain what starting a graph or a kernel costs the GPU. What is drawn on the CPU has the method
`wall`: the time of the call.

The host's own time is what `host` says: how long a call takes to come back, by the wall clock, without waiting for the GPU.
"""

from __future__ import annotations

import dataclasses
import os
import platform
import re
import subprocess
import time
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple, Protocol

import torch

from bigtri.app import arguments as option_types
from bigtri.study import provenance
from bigtri.study.clock import captured, summary

METHODS = ("graph", "graph20", "eager", "cold")
IN_A_ROW = 20  # frames in the graph of `graph20`
AT_LEAST, AT_MOST = 50, 200  # repeats
SLOW = 20_000  # us: above, a few repeats and no `graph20`
SLOW_REPEATS = 5
TURN, SLOW_TURN = 12, 3  # repeats of a turn, where several calls take turns; of what is slow
ROUNDS = 3  # of turns, at least
EVICT = 256 << 20  # bytes: several times any L2 cache
CYCLES = 2000  # of a GPU's clock in a microsecond, at most; only for the waiting kernel
POISON = 0x1234_5678_9ABC_DEF0  # what the image holds before it is checked
DIGITS = 3  # after the point, of the microseconds in a CSV

Call = Callable[[], object]


class Measurement(NamedTuple):
    us: list[float]  # of each repeat; empty where the method is too slow to be used
    again: Call  # draws once more, the way that was timed


class Clock(Protocol):
    def measure(self, call: Call, method: str, seconds: float, at_least: int = AT_LEAST) -> Measurement:
        """Times `call` by one of `METHODS` for about `seconds`, at least so many repeats."""

    def once(self, call: Call) -> float:
        """Microseconds of one call."""

    def replay(self, call: Call) -> Call:
        """What draws the same frame once more, as `graph` times it."""

    def times(self, replay: Call, count: int) -> list[float]:
        """Microseconds of so many replays."""

    def host(self, call: Call, seconds: float) -> list[float]:
        """Microseconds of the host for each call, for about `seconds`."""


def repeats_for(us: float, seconds: float, at_least: int = AT_LEAST) -> int:
    """How many repeats of something that takes `us`."""
    if us > SLOW:
        return SLOW_REPEATS
    return max(at_least, min(AT_MOST, int(seconds * 1e6 / max(us, 1e-3))))


class CudaClock:
    """By events on torch's current device."""

    def __init__(self) -> None:
        self.buffer: torch.Tensor | None = None

    def once(self, call: Call) -> float:
        return self._times(call, 1, 0, cold=False)[0]

    def measure(self, call: Call, method: str, seconds: float, at_least: int = AT_LEAST) -> Measurement:
        call()  # loads kernels, and gives torch its memory
        us = self.once(call)
        if method == "eager":
            start = time.perf_counter()
            call()
            host_us = (time.perf_counter() - start) * 1e6
            torch.cuda.synchronize()
            return Measurement(self._times(call, repeats_for(us, seconds, at_least), 50 + 2 * host_us, cold=False), call)
        if method == "graph20" and us > SLOW / 4:
            return Measurement([], call)
        frames = IN_A_ROW if method == "graph20" else 1
        graph = self.capture(call, frames)
        count = repeats_for(us * frames, seconds, at_least if frames == 1 else min(at_least, 20))
        times = self._times(graph.replay, count, 100, cold=method == "cold")
        return Measurement([t / frames for t in times], graph.replay)

    def replay(self, call: Call) -> Call:
        call()  # loads kernels, and gives torch its memory
        return self.capture(call, 1).replay

    def times(self, replay: Call, count: int) -> list[float]:
        return self._times(replay, count, 100, cold=False)

    def host(self, call: Call, seconds: float) -> list[float]:
        return _enqueued(call, seconds, torch.cuda.synchronize)

    def capture(self, call: Call, frames: int) -> torch.cuda.CUDAGraph:
        """A graph of `frames` calls."""
        return captured(call, frames)

    def evict(self) -> None:
        if self.buffer is None:
            self.buffer = torch.empty(EVICT, dtype=torch.uint8, device="cuda")
        self.buffer.zero_()

    def _times(self, call: Call, count: int, wait_us: float, cold: bool) -> list[float]:
        events = [(torch.cuda.Event(enable_timing=True), torch.cuda.Event(enable_timing=True)) for _ in range(count)]
        if count > 1:
            for _ in range(3):
                call()
            torch.cuda.synchronize()
        for number, (start, end) in enumerate(events):
            if cold:
                self.evict()
            if wait_us:
                torch.cuda._sleep(int(min(wait_us, 2000) * CYCLES))
            start.record()
            call()
            end.record()
            if number % 8 == 7:
                torch.cuda.synchronize()
        torch.cuda.synchronize()
        return [start.elapsed_time(end) * 1e3 for start, end in events]


class WallClock:
    """The host's clock, of what is drawn on the CPU and of dry runs: the methods differ in name only."""

    def once(self, call: Call) -> float:
        start = time.perf_counter()
        call()
        return (time.perf_counter() - start) * 1e6

    def measure(self, call: Call, method: str, seconds: float, at_least: int = AT_LEAST) -> Measurement:
        return Measurement(self.times(call, 3), call)

    def replay(self, call: Call) -> Call:
        return call

    def times(self, replay: Call, count: int) -> list[float]:
        if count > 1:
            replay()  # as on the device: what another call has left in the caches does not count
        return [self.once(replay) for _ in range(count)]

    def host(self, call: Call, seconds: float) -> list[float]:
        return _enqueued(call, seconds, lambda: None)


def _enqueued(call: Call, seconds: float, wait: Call) -> list[float]:
    """Microseconds of each call, for about `seconds`; `wait` now and then empties the GPU's queue, outside of what is timed."""
    us: list[float] = []
    end = time.perf_counter() + seconds
    call()
    while len(us) < AT_LEAST or (time.perf_counter() < end and len(us) < 10 * AT_MOST):
        if len(us) % 8 == 0:
            wait()
        start = time.perf_counter()
        call()
        us.append((time.perf_counter() - start) * 1e6)
    wait()
    return us


def take_turns(clock: Clock, replays: Mapping[str, Call], seconds: float, rounds: int = ROUNDS) -> dict[str, list[list[float]]]:
    """Microseconds [name][round][repeat] of at least so many rounds, for about `seconds`.

    In a round everyone replays its turn, one after the other, in an order that reverses every round, so that a change of the
    clocks meets all of them.
    """
    times: dict[str, list[list[float]]] = {name: [] for name in replays}
    turns = {name: TURN if clock.once(replay) < SLOW / 10 else SLOW_TURN for name, replay in replays.items()}
    end = time.perf_counter() + seconds
    number = 0
    while number < rounds or time.perf_counter() < end:
        for name in list(replays) if number % 2 == 0 else reversed(list(replays)):
            times[name].append(clock.times(replays[name], turns[name]))
        number += 1
    return times


def clock_for(device: torch.device) -> Clock:
    """The GPU's clock with the GPU warm; the host's for the CPU."""
    if device.type == "cpu":
        return WallClock()
    warm_up()
    return CudaClock()


def warm_up(seconds: float = 0.3) -> None:
    """Keeps the GPU busy until its clocks are up."""
    buffer = torch.empty(EVICT, dtype=torch.uint8, device="cuda")
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        for _ in range(20):
            buffer.zero_()
        torch.cuda.synchronize()


def kernels(call: Call, calls: int = 5) -> dict[str, float]:
    """GPU microseconds a call of each kernel, memset and copy, by name, longest first, through torch's profiler."""
    from torch.autograd import DeviceType
    from torch.profiler import ProfilerActivity, profile

    call()
    torch.cuda.synchronize()
    with profile(activities=[ProfilerActivity.CUDA]) as profiled:
        for _ in range(calls):
            call()
        torch.cuda.synchronize()
    spent: dict[str, float] = {}
    for event in profiled.events():
        if event.device_type != DeviceType.CPU:
            name = short_name(event.name)
            spent[name] = spent.get(name, 0.0) + event.time_range.elapsed_us() / calls
    return dict(sorted(spent.items(), key=lambda item: -item[1]))


def short_name(kernel: str) -> str:
    """A kernel's name without return type, namespaces and arguments."""
    kernel = re.sub(r"\(anonymous namespace\)::|<unnamed>::|\bbigtri::|^void ", "", kernel)
    return re.sub(r"\([\w: ]+\)(?=\d)", "", kernel).split("(")[0][:70]  # without the types of template arguments


# --- rows


class Job(NamedTuple):
    """What a row is about: a scene of one size, or a batch of views of it."""

    scene: str
    width: int  # px
    height: int  # px
    seed: int
    views: int = 1  # of a batch; 1: no batch, an image [H, W]

    @property
    def size(self) -> str:
        """WIDTHxHEIGHT; of a batch VIEWSxHEIGHTxWIDTH, as its tensor is."""
        size = f"{self.width}x{self.height}"
        return size if self.views == 1 else f"{self.views}x{self.height}x{self.width}"

    def __str__(self) -> str:
        return f"{self.scene} {self.size}"


class Machine(NamedTuple):
    """What a row says about where it comes from."""

    device: str
    driver: str
    torch: str
    cuda: str
    commit: str
    command: str


def machine(kind: str = "cuda") -> Machine:
    """kind: of the device that is measured; without a GPU it is a dry run."""
    if kind == "cpu":
        device = f"{provenance.device()}, {torch.get_num_threads()} threads"
    else:
        device = torch.cuda.get_device_name() if torch.cuda.is_available() else f"dry run: {provenance.device()}"
    # A copy without .git is told its commit.
    commit = os.environ.get("BIGTRI_COMMIT") or provenance.commit()
    return Machine(device, driver(), torch.__version__, torch.version.cuda or "", commit, provenance.command())


def driver() -> str:
    """The NVIDIA driver's version; empty if nobody says."""
    query = ["nvidia-smi", "--query-gpu=driver_version", "--format=csv,noheader"]
    try:
        found = subprocess.run(query, capture_output=True, text=True, check=True, timeout=20).stdout.split()
    except (OSError, subprocess.SubprocessError):
        return ""
    return found[0] if found else ""


@dataclasses.dataclass
class Row:
    """One (scene, size, seed, views, variant, method); the fields are the CSV's columns, the first ones those of `Job`."""

    scene: str
    width: int  # px
    height: int  # px
    seed: int
    views: int
    variant: str  # of bigtri's, with its settings; "memset", "empty kernel", "floor list", "floor shuffle"
    triangles: int
    method: str
    us_median: float
    us_min: float
    us_p25: float
    us_p75: float
    repeats: int
    wrong_pixels: int | None  # that differ from the CPU's image; of a floor: that show another triangle
    device: str
    driver: str
    torch: str
    cuda: str
    commit: str
    command: str

    @property
    def job(self) -> Job:
        return Job(self.scene, self.width, self.height, self.seed, self.views)


def row_of(job: Job, variant: str, triangles: int, method: str, us: list[float], wrong_pixels: int | None, where: Machine) -> Row:
    """us: of each repeat."""
    timing = summary(us)
    return Row(
        **job._asdict(),
        variant=variant,
        triangles=triangles,
        method=method,
        us_median=timing.median,
        us_min=timing.minimum,
        us_p25=timing.p25,
        us_p75=timing.p75,
        repeats=timing.repeats,
        wrong_pixels=wrong_pixels,
        **where._asdict(),
    )


def text_of(us: float | None) -> str:
    """Microseconds to three figures; "-" for none."""
    if us is None:
        return "-"
    return f"{us:.2f}" if us < 10 else f"{us:.1f}" if us < 100 else f"{us:.0f}"


def listed(text: str, what: str, known: Iterable[str]) -> list[str]:
    """Names separated by commas, or "all".

    Raises:
        SystemExit: one of them is not known.
    """
    try:
        return option_types.chosen(what, text, list(known))
    except ValueError as error:
        raise SystemExit(str(error)) from None


def headline(where: Machine) -> str:
    return (
        f"{where.device}; driver {where.driver or '?'}; torch {where.torch}; CUDA {where.cuda or '-'}; "
        f"python {platform.python_version()}; {where.commit or 'no commit'}"
    )

"""Measures variants for the report: all in turns on one scene, with a camera that stands or moves, stage by stage."""

from __future__ import annotations

import dataclasses
import itertools
import math
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import cuda_clock
import torch
from variant_rows import Key, Row

from bigtri import native
from bigtri.check import counters
from bigtri.ops.rasterize import rasterize
from bigtri.precision import DEFAULT
from bigtri.reference.numerics import LARGE_THRESHOLD
from bigtri.scene import Camera
from bigtri.study import clock, meshes, scenes, tune

SLOW = {"cpu": 0.25, "cuda": 0.02}  # s
STANDARD = "standard"
STEP = 3.0  # degrees from one frame of a moving camera to the next
FRAMES = 8  # after which it begins again
MOTIONS = ("moving", "still")  # in the order in which a camera draws them
AT_LEAST = 7  # rounds
CALLS = 3  # rounds of the stages one by one

Stages = dict[tuple[str, str], list[float]]  # ms of each frame, by motion and stage


def triangles_of(key: Key) -> scenes.Triangles:
    """
    Raises:
        ValueError: no such scene, or the image is too small for it.
    """
    name, at, distance = key.scene.partition("@")
    if not at:
        return scenes.make(*key)
    aspect = key.width / key.height
    mesh = mesh_of(name)
    return scenes.Triangles(meshes.whole(mesh, aspect, float(distance)).transform(mesh.vertices, aspect), mesh.triangles)


def mesh_of(name: str) -> meshes.Mesh:
    """
    Raises:
        ValueError: it is no real scene.
    """
    if name not in scenes.REAL:
        raise ValueError(f"a camera can be moved in {', '.join(scenes.REAL)}, got {name}")
    return meshes.of(scenes.REAL[name], scenes.SEED)


def turned(camera: Camera, degrees: float) -> Camera:
    """The camera gone so far around what it looks at."""
    (x, y, z), (tx, _, tz) = camera.eye, camera.target  # type: ignore[attr-defined]
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    eye = (tx + c * (x - tx) + s * (z - tz), y, tz + c * (z - tz) - s * (x - tx))
    return dataclasses.replace(camera, eye=eye)  # type: ignore[type-var]


class Case:
    """A scene on a device, and an image."""

    def __init__(self, key: Key, device: str, scene: scenes.Triangles | None = None) -> None:
        self.key, self.device = key, device
        self.scene = triangles_of(key) if scene is None else scene
        self.positions, self.triangles = (torch.from_numpy(array).to(device) for array in self.scene)
        self.known = key, len(self.triangles)
        self.size = key.height, key.width
        self.packed = torch.empty(self.size, dtype=torch.int64, device=device)

    def draw(self, setting: tune.Setting) -> None:
        rasterize(
            self.positions,
            self.triangles,
            self.size,
            backend="native",
            variant=setting.variant,
            parameters=dict(setting.parameters),
            depth=False,
            out=self.packed,
        )

    def able(self, settings: Sequence[tune.Setting]) -> dict[tune.Setting, bool]:
        """Those that can be drawn, and whether the picture is the first one's in bits; what the device refuses is said."""
        expected = None
        equal = {}
        for setting in settings:
            self.packed.fill_(-1)
            try:
                self.draw(setting)
                self.finish()
            except (RuntimeError, MemoryError) as error:
                print(f"{self.key.scene} {self.key.size}: {name_of(setting)} left out: {str(error).splitlines()[0]}")
                continue
            expected = self.packed.clone() if expected is None else expected
            equal[setting] = torch.equal(self.packed, expected)
        return equal

    def measure(
        self,
        part: str,
        settings: Sequence[tune.Setting],
        seconds: float,
        where: Mapping[str, str],
        count: bool,
    ) -> list[Row]:
        """Rows of all settings, which take turns. seconds: of the clock, for each of them."""
        equal = self.able(settings)
        calls = {name_of(setting): partial(self.draw, setting) for setting in equal}
        timings = in_turns(calls, seconds, self.device)
        return [
            Row(
                part,
                *self.known,
                setting.variant,
                " ".join(f"{name}={value}" for name, value in setting.parameters) or STANDARD * (part == "parameters"),
                timings[name_of(setting)],
                equal[setting],
                self.counted(setting) if count else {},
                self.scratch(setting),
                where,
            )
            for setting in equal
        ]

    def counted(self, setting: tune.Setting) -> dict[str, int]:
        """What the build that counts says; nothing on CUDA where it is another build, or does not count this variant."""
        parameters = dict(setting.parameters)
        call = partial(counters.count, *self.scene, self.size, variant=setting.variant, parameters=parameters)
        try:
            return call(backend="native", device=self.device)
        except RuntimeError as error:
            if self.device == "cuda" and "must be" in str(error):
                return {}
            raise

    def scratch(self, setting: tune.Setting) -> int | None:
        """Bytes of the device's memory that a call takes; None on the CPU."""
        if self.device != "cuda":
            return None
        self.finish()
        torch.cuda.reset_peak_memory_stats()
        before = torch.cuda.memory_allocated()
        self.draw(setting)
        self.finish()
        return torch.cuda.max_memory_allocated() - before

    def finish(self) -> None:
        if self.device == "cuda":
            torch.cuda.synchronize()


def in_turns(calls: Mapping[str, Callable[[], object]], seconds: float, device: str) -> dict[str, clock.Timing]:
    """Times of calls that take turns, so many seconds each. What is slow is drawn once more, and has that one's time."""
    slow: dict[str, clock.Timing] = {}
    for name, call in calls.items():
        start = time.perf_counter()
        call()
        if device == "cuda":
            torch.cuda.synchronize()
        if (once := time.perf_counter() - start) > SLOW[device]:
            slow[name] = clock.summary([once * 1e3])
    quick = {name: call for name, call in calls.items() if name not in slow}
    ms = clock.interleaved(quick, seconds * len(quick), AT_LEAST, device=device)
    return slow | {name: clock.summary(found) for name, found in ms.items()}


def name_of(setting: tune.Setting) -> str:
    return " ".join([setting.variant, *(f"{name}={value}" for name, value in setting.parameters)])


def steps(parameter: native.Parameter) -> list[int]:
    """Values to sweep: those allowed, or up to two steps of a factor of four to either side of the standard one."""
    up_and_down = tune.lines(parameter, parameter.standard)
    return sorted({parameter.standard, *itertools.chain(*(values[:2] for values in up_and_down))})


def sweep(variants: Mapping[str, native.Variant]) -> list[tune.Setting]:
    """The standard settings, and each parameter's other values."""
    found = []
    for name, variant in variants.items():
        start = tune.Setting(name)
        found.append(start)
        for parameter in variant.parameters.values():
            found += [start.changed(parameter, value) for value in steps(parameter) if value != parameter.standard]
    return found


# --- a camera that moves


class Moving(Case):
    """A scene seen by a camera that goes around what it looks at, `STEP` degrees a frame.

    Each camera draws two frames in a row: the first one follows another camera's, so its caches and branches have seen other
    triangles at other places (moving); the second one follows its like (still). The positions are written anew before either.
    So both draw the same pictures, and differ in what was drawn before.
    """

    def __init__(self, key: Key, device: str) -> None:
        aspect = key.width / key.height
        mesh = mesh_of(key.scene)
        camera = meshes.CAMERAS[scenes.REAL[key.scene].camera](mesh, aspect)
        degrees = [STEP * (frame - (FRAMES - 1) / 2) for frame in range(FRAMES)]
        seen = [turned(camera, each).transform(mesh.vertices, aspect) for each in degrees]
        super().__init__(key, device, scenes.Triangles(seen[0].copy(), mesh.triangles))
        self.seen = [torch.from_numpy(positions).to(device) for positions in seen]

    def look(self, frame: int) -> None:
        self.positions.copy_(self.seen[frame])

    def motion(self, variants: Sequence[str], seconds: float, where: Mapping[str, str]) -> list[Row]:
        """Whole frames; all variants take turns of `FRAMES` cameras, for about so many seconds each."""
        self.look(0)
        equal = self.able([tune.Setting(variant) for variant in variants])
        clocks = {setting.variant: self.frame_clock(setting) for setting in equal}
        ms: dict[tuple[str, str], list[float]] = {}
        end = time.perf_counter() + seconds * len(clocks)
        rounds = 0
        while rounds < 2 or time.perf_counter() < end:
            for variant, frame_ms in clocks.items():
                self.look(FRAMES - 1)
                frame_ms()
                for frame in range(FRAMES):
                    for motion in MOTIONS:
                        self.look(frame)
                        self.finish()
                        ms.setdefault((variant, motion), []).append(frame_ms())
            rounds += 1
        return [
            Row("motion", *self.known, variant, motion, clock.summary(found), equal[tune.Setting(variant)], {}, None, where)
            for (variant, motion), found in ms.items()
        ]

    def frame_clock(self, setting: tune.Setting) -> Callable[[], float]:
        """What draws a frame and gives its milliseconds; of the device on CUDA, by the replay of a graph."""
        draw = partial(self.draw, setting)
        if self.device == "cpu":
            return partial(clock.wall_ms, draw)
        return partial(clock.device_ms, clock.captured(draw, 1).replay)

    def stages(self, variants: Sequence[str], where: Mapping[str, str]) -> list[Row]:
        """Time in each stage: on the CPU of the stages one by one, on CUDA of each kernel of each variant."""
        self.look(0)
        equal = self.able([tune.Setting(variant) for variant in variants])
        if self.device == "cpu":
            expected = self.packed.clone()
            same = torch.equal(self.frame_by_stages(lambda stage, call: call()), expected)
            return self.rows_of_stages("stages", self.one_by_one(), same, where)
        rows = []
        for setting in equal:
            try:
                rows += self.rows_of_stages(setting.variant, self.kernels(setting), equal[setting], where)
            except RuntimeError as error:
                print(f"{self.key.scene} {self.key.size}: {setting.variant}: kernels left out: {error}")
        return rows

    def rows_of_stages(self, variant: str, ms: Stages, equal: bool, where: Mapping[str, str]) -> list[Row]:
        return [
            Row("stages", *self.known, variant, f"{motion} {stage}", clock.summary(found), equal, {}, None, where)
            for (motion, stage), found in ms.items()
        ]

    def one_by_one(self) -> Stages:
        """The stages of docs/architecture.md as operators, on one thread, each with the output of the one before."""
        ms: Stages = {}
        for _ in range(CALLS):
            for frame in range(FRAMES):
                for motion in MOTIONS:
                    self.look(frame)
                    self.frame_by_stages(lambda stage, call: self.timed(ms.setdefault((motion, stage), []), call))  # noqa: B023
        return ms

    @staticmethod
    def timed(ms: list[float], call: Callable[[], Any]) -> Any:
        start = time.perf_counter()
        found = call()
        ms.append((time.perf_counter() - start) * 1e3)
        return found

    def frame_by_stages(self, run: Callable[[str, Callable[[], Any]], Any]) -> torch.Tensor:
        """run: is handed each stage's name and call, and hands back what the call does."""
        ops, (height, width), rung = torch.ops.bigtri, self.size, {"precision": DEFAULT}
        given = (self.positions, self.triangles, height, width)
        triangle, xy, z, area, bbox, *_ = run(
            "setup", partial(ops.setup, *given, cull="none", scissor=[0, 0, width, height], **rung)
        )
        candidates, kept, small = run("binning", partial(ops.binning, xy, bbox, LARGE_THRESHOLD, **rung))
        queue = candidates[kept]
        touched, _ = run("tile_mask", partial(ops.tile_mask, xy, bbox, queue, **rung))
        spans = run("scanline", partial(ops.scanline, xy, bbox, queue, touched, small, **rung))
        depth = run("depth", partial(ops.depth, xy, z, area, spans, **rung))
        run("visibility", partial(ops.visibility, triangle, spans, depth, out=self.packed))
        return self.packed

    def kernels(self, setting: tune.Setting) -> Stages:
        """What CUDA's profiler says of each kernel, in frames that follow each other as those of `motion` do."""
        from torch.autograd import DeviceType
        from torch.profiler import ProfilerActivity, profile

        self.look(FRAMES - 1)
        self.draw(setting)
        self.finish()
        with profile(activities=[ProfilerActivity.CUDA]) as profiled:
            for frame in range(FRAMES):
                for _ in MOTIONS:
                    self.look(frame)
                    self.draw(setting)
            self.finish()
        events = sorted((e for e in profiled.events() if e.device_type != DeviceType.CPU), key=lambda e: e.time_range.start)
        return stages_of([(cuda_clock.short_name(event.name), event.time_range.elapsed_us() / 1e3) for event in events])


def stages_of(events: Sequence[tuple[str, float]]) -> Stages:
    """events: names and ms of kernels and copies in their order. The copy of the positions begins a frame.

    Raises:
        RuntimeError: there are more copies, or less.
    """
    frames: list[dict[str, float]] = []
    for name, ms in events:
        if name.startswith("Memcpy DtoD"):
            frames.append({})
        elif frames:
            frames[-1][name] = frames[-1].get(name, 0.0) + ms
    if len(frames) != FRAMES * len(MOTIONS):
        raise RuntimeError(f"the profiler saw {len(frames)} copies of positions, not {FRAMES * len(MOTIONS)}")
    found: Stages = {}
    for number, frame in enumerate(frames):
        for name, ms in frame.items():
            found.setdefault((MOTIONS[number % len(MOTIONS)], name), []).append(ms)
    return found

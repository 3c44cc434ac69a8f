"""How GPU time grows, for each CUDA variant and for each path of bin_owned. One CSV, one row per (point, way).

* `designs`: few large (S1), many large (S2) and very large triangles (S3) at 1920x1080, `persistent` beside `two_stage`;
* `count`: 1 to 1,000,000 triangles of 500 to 5000 px, and a mesh of 10 px triangles of 10 to 10,000,000, at 1920x1080;
* `area`: the number of *fragments* is fixed, so more area means fewer triangles. One layer of mesh over 16384x16384, triangles
of 100 px to one over all of it; and four layers over 1920x1080 of 2 to 100,000 px, as bench/scaling.py has it for the CPU;
* `depth`: 1 to 2500 triangles that each cover 1920x1080, front to back, back to front, and in random order;
* `resolution`: 32 very large triangles (as S3), and one full-screen triangle, on squares of 256 to 16384 px;
* `rows`: four layers over 1920x1080 of triangles of 10 to 30,000 px, with the longest side that is drawn by rows from 1 to 256
px: the variants that have it as a parameter. What is wider waits.

And, where they are asked for, in steps so small that a change of path shows, for "auto" on the bumpy body of the R-scenes:
* `body_count`: the first 10 to 1,000,000 triangles of a body, at 256x256, 640x480, 1920x1080 and 3840x2160;
* `body_share`: 16,000 triangles whose ball is 1 to 200 % as high as the picture, at the same sizes;
* `body_resolution`: 400, 16,000 and 100,000 triangles on squares of 64 to 4096 px;
* `body_views`: batches of 2 to 1024 views of 4,000 triangles, 128x128 each, and of 400, 512x512 each.
At the end stands where "auto" has a cliff: where a step costs more than the steps before and after it, or gains.

A way is a variant, or `bin_owned` kept to one of its paths or ways to share triangles by `bigtri.native.using_parameters`
(cuda_cases.py). Time is the median of graph replays (cuda_clock.py). A way that takes more than 50 ms is left out of the rest of
its curve, and so is one that would by its growth. Images are compared with the CPU's up to 2^24 px and 2,000,000 triangles, above
that with the first way's.

    python bench/cuda_scaling.py --csv build/gpu/cuda_scaling.csv --total 150
    python bench/cuda_scaling.py --curves sweeps --csv build/gpu/cuda_sweeps.csv
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import math
import statistics
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import cuda_cases
import cuda_clock
import cuda_floor
import numpy as np
import torch
from cuda_cases import ASPECT, AUTO, Way
from cuda_clock import Clock, Machine, text_of

from bigtri import native
from bigtri.app import arguments as option_types
from bigtri.precision import DEFAULT
from bigtri.scene import Camera
from bigtri.study import benchmark, meshes, scenes
from bigtri.study.clock import summary
from bigtri.study.scenes import layers_of

WIDTH, HEIGHT = 1920, 1080  # px, where a curve does not vary them
SWEPT = option_types.listed(option_types.size)(cuda_cases.SIZES)  # what the sweeps draw at
SIDE = 16384  # px, of `area`
LAYERS = 4
LIMIT = 50_000  # us
GUESS = 4  # a way is tried while its time, grown with the number of triangles, stays below so many limits
MAX_BYTES = 8 << 30
CPU_PIXELS, CPU_TRIANGLES = 1 << 24, 2_000_000  # up to here an image is compared with the CPU's
WIDEST = (1, 4, 8, 16, 32, 64, 128, 192, 256)  # px, of a side of the bbox
AT_LEAST = 15  # repeats


class Point(NamedTuple):
    """A place on a curve; the triangles are made when they are asked for."""

    curve: str
    kind: str
    x: int
    width: int
    height: int
    make: Callable[[], scenes.Mesh | meshes.Batch]  # in px, or in clip space
    widest: int | None = None  # px: the longest side that is drawn by rows
    turns: int = 1  # how often the ways take turns
    views: int = 1

    def given(self) -> meshes.Batch:
        """Its triangles, in clip space."""
        made = self.make()
        return made if isinstance(made, meshes.Batch) else meshes.Batch(*scenes.to_clip(made, self.width, self.height), None)


@dataclasses.dataclass
class Row:
    """The CSV's columns."""

    curve: str
    kind: str
    x: int
    width: int  # px
    height: int  # px
    variant: str
    path: str
    widest: int | None  # px
    triangles: int
    method: str
    us_median: float
    us_min: float
    us_p25: float
    us_p75: float
    repeats: int
    wrong_pixels: int
    against: str  # what the image was compared with
    us_memset: float | None  # of the image, in the same run
    device: str
    driver: str
    torch: str
    cuda: str
    commit: str
    command: str


def ways(variants: Mapping[str, native.Variant]) -> list[Way]:
    """Every variant as it is, bin_owned's paths as far as the extension has them, and auto."""
    return [*(Way(variant, "", {}) for variant in variants), *cuda_cases.ways(cuda_cases.PATHS, variants), AUTO]


def ways_on(curve: str, todo: list[Way], variants: Mapping[str, native.Variant]) -> list[Way]:
    """Those of `todo` that a curve compares: auto in a sweep, the others elsewhere; on `rows` the variants that have it."""
    compared = [way for way in todo if (way == AUTO) == (curve in SWEEPS)]
    if curve == "rows":
        compared = [way for way in compared if not way.path and "widest" in variants[way.variant].parameters]
    return compared


# --- the curves


def scattered(count: int, width: int, height: int, seed: int, area: tuple[float, float]) -> scenes.Mesh:
    """Triangles of any orientation, area log-uniform, with their centre on the screen: as scenes.large, but all at once."""
    rng = np.random.default_rng(seed)
    turn = rng.uniform(0, 2 * np.pi, (count, 1)) + np.array([0, 2, 4]) * np.pi / 3 + rng.uniform(-0.5, 0.5, (count, 3))
    corners = np.stack([np.cos(turn), np.sin(turn)], axis=2)
    side = corners[:, 1:] - corners[:, :1]
    here = np.abs(side[:, 0, 0] * side[:, 1, 1] - side[:, 0, 1] * side[:, 1, 0]) / 2
    wanted = np.exp(rng.uniform(np.log(area[0]), np.log(area[1]), count))
    centre = rng.uniform([0, 0], [width, height], (count, 1, 2))
    return scenes.soup(corners * np.sqrt(wanted / here)[:, None, None] + centre, scenes.tilted(rng, count, 0.03))


def shuffled(mesh: scenes.Mesh) -> scenes.Mesh:
    return mesh._replace(triangles=np.random.default_rng(scenes.SEED).permutation(mesh.triangles))


def design_points() -> Iterator[Point]:
    for kind, name in (("few large", "S1"), ("many large", "S2"), ("very large", "S3")):
        count = {"S1": 8, "S2": 64, "S3": 32}[name]
        yield Point("designs", kind, count, WIDTH, HEIGHT, partial(scenes.pixel_mesh, name, WIDTH, HEIGHT), turns=3)


def count_points() -> Iterator[Point]:
    for count in (1, 8, 32, 64, 128, 256, 512, 1024, 2048, 4096, 8192, 16384, 65536, 262144, 1048576):
        make = partial(scattered, count, WIDTH, HEIGHT, scenes.SEED, (500, 5000))
        yield Point("count", "500 to 5000 px", count, WIDTH, HEIGHT, make)
    for count in (10, 100, 1000, 3000, 10_000, 30_000, 100_000, 1_000_000, 10_000_000):
        make = partial(scenes.small_mesh, count, WIDTH, HEIGHT, scenes.SEED)
        yield Point("count", "mesh, 10 px", count, WIDTH, HEIGHT, make)


def area_points() -> Iterator[Point]:
    """The largest first, so that the number of triangles grows along the curve."""
    one = partial(scenes.full_screen, 1, SIDE, SIDE, scenes.SEED, back_to_front=False)
    yield Point("area", "1 layer, 16384 x 16384", SIDE * SIDE, SIDE, SIDE, one)
    for area in (2**27, 2**25, 2**22, 2**19, 2**16, 2**13, 1000, 100):
        make = partial(layers_of, area, SIDE, SIDE, 1)
        yield Point("area", "1 layer, 16384 x 16384", area, SIDE, SIDE, make)
    for area in (100_000, 10_000, 2000, 500, 100, 50, 20, 10, 5, 2):
        make = partial(layers_of, area, WIDTH, HEIGHT, LAYERS)
        yield Point("area", f"{LAYERS} layers, {WIDTH} x {HEIGHT}", area, WIDTH, HEIGHT, make)


def depth_points() -> Iterator[Point]:
    for layers in (1, 5, 20, 50, 200, 1000, 2500):
        for kind in ("front to back", "back to front", "random order"):

            def make(layers: int = layers, kind: str = kind) -> scenes.Mesh:
                mesh = scenes.full_screen(layers, WIDTH, HEIGHT, scenes.SEED, back_to_front=kind == "back to front")
                return shuffled(mesh) if kind == "random order" else mesh

            yield Point("depth", kind, layers, WIDTH, HEIGHT, make)


def resolution_points() -> Iterator[Point]:
    side = 256
    while side <= SIDE:
        many = partial(scenes.very_large, 32, side, side, scenes.SEED)
        yield Point("resolution", "32 very large", side, side, side, many)
        one = partial(scenes.full_screen, 1, side, side, scenes.SEED, back_to_front=False)
        yield Point("resolution", "1 full screen", side, side, side, one)
        side *= 2


def rows_points() -> Iterator[Point]:
    for area in (30_000, 8000, 2000, 500, 100, 10):
        for widest in WIDEST:
            make = partial(layers_of, area, WIDTH, HEIGHT, LAYERS)
            yield Point("rows", f"{area} px", widest, WIDTH, HEIGHT, make, widest)


# --- sweeps of the bumpy body


def steps(low: int, high: int, factor: float) -> list[int]:
    """Whole numbers from `low` to `high`, each about `factor` times the last."""
    count = math.ceil(math.log(high / low) / math.log(factor))
    return list(dict.fromkeys(round(low * (high / low) ** (k / count)) for k in range(count + 1)))


def body_of(count: int) -> meshes.Mesh:
    """The smallest body of at least so many triangles."""
    cells = max(2, math.ceil((count / 4.6) ** 0.5))
    while len(meshes.body(cells, scenes.SEED).triangles) < count:
        cells += 1
    return meshes.body(cells, scenes.SEED)


def first_of(count: int) -> meshes.Batch:
    """So many triangles of a body, from where all of it would be in the picture."""
    mesh = body_of(count)
    triangles = mesh.triangles[:count]
    vertices = mesh.vertices[: triangles.max() + 1]
    return meshes.Batch(meshes.whole(mesh, ASPECT).transform(vertices, ASPECT), triangles, None)


def as_high(count: int, percent: float) -> meshes.Batch:
    """A body from where the ball around it is so many percent as high as the picture."""
    mesh = body_of(count)
    low, high = mesh.bounds()
    center = (low + high) / 2
    radius = float(np.linalg.norm(mesh.vertices - center, axis=1).max())
    away = radius / math.sin(math.atan(percent / 100 * math.tan(math.radians(45) / 2)))
    camera = Camera.orbit(center, away, 30.0, 20.0, fov_y=45.0, near=(away - radius) / 2, far=2 * (away + radius))
    return meshes.Batch(camera.transform(mesh.vertices, ASPECT), mesh.triangles, None)


def body_count_points() -> Iterator[Point]:
    for count in steps(10, 1_000_000, 1.5):
        for width, height in SWEPT:
            yield Point("body_count", f"{width} x {height}", count, width, height, partial(first_of, count))


def body_share_points() -> Iterator[Point]:
    for percent in steps(1, 200, 1.5):
        for width, height in SWEPT:
            yield Point("body_share", f"{width} x {height}", percent, width, height, partial(as_high, 16_000, percent))


def body_resolution_points() -> Iterator[Point]:
    for side in steps(64, 4096, 2**0.5):
        for count in (400, 16_000, 100_000):
            yield Point("body_resolution", f"{count} triangles", side, side, side, partial(first_of, count))


def body_views_points() -> Iterator[Point]:
    for views in steps(2, 1024, 1.5):
        for count, side in ((4000, 128), (400, 512)):
            make = partial(meshes.batch, [body_of(count)], views, ASPECT)
            yield Point("body_views", f"{count} triangles, {side} x {side}", views, side, side, make, views=views)


CURVES: dict[str, Callable[[], Iterator[Point]]] = {
    "designs": design_points,
    "count": count_points,
    "area": area_points,
    "depth": depth_points,
    "resolution": resolution_points,
    "rows": rows_points,
}
SWEEPS: dict[str, Callable[[], Iterator[Point]]] = {
    "body_count": body_count_points,
    "body_share": body_share_points,
    "body_resolution": body_resolution_points,
    "body_views": body_views_points,
}


# --- measuring


class Limits:
    """Which ways have become too slow on which curve."""

    def __init__(self) -> None:
        self.last: dict[tuple[str, str, str], tuple[int, float]] = {}  # triangles and us of the last point

    def allows(self, point: Point, way: Way, triangles: int) -> bool:
        """Whether to try: not beyond what the path can do, nor where time would pass the limit by far."""
        if triangles > way.most:
            return False
        before, us = self.last.get((point.curve, point.kind, way.name), (triangles, 0.0))
        return us <= LIMIT and us * max(1.0, triangles / max(before, 1)) <= GUESS * LIMIT

    def saw(self, point: Point, way: Way, triangles: int, us: float) -> None:
        if point.curve != "rows":  # where time does not grow along the curve
            self.last[point.curve, point.kind, way.name] = (triangles, us)


class Stage(cuda_cases.Target):
    """A point's scene, and what its image has to be: the CPU's, or for large ones that of the first way to draw it."""

    def __init__(self, point: Point, given: meshes.Batch, device: torch.device) -> None:
        super().__init__(given, (point.height, point.width), device)
        self.expected: list[torch.Tensor] | None = None
        self.against = ""
        if point.width * point.height <= CPU_PIXELS and len(given.triangles) <= CPU_TRIANGLES:
            self.expected, self.against = self.from_cpu(), "cpu"

    def wrong_pixels(self, way: Way, again: cuda_clock.Call) -> int:
        images = self.poisoned(again)
        if self.expected is None:
            self.expected, self.against = [image.clone() for image in images], way.name
        return sum(map(cuda_cases.differing, images, self.expected))


def setting(way: Way, point: Point) -> contextlib.AbstractContextManager[None]:
    """The way's parameters, and the point's."""
    changes = {} if point.widest is None else {"widest": point.widest}
    return way._replace(parameters={**way.parameters, **changes}).setting()


class Scaling:
    """Measures points and keeps the rows."""

    def __init__(
        self, clock: Clock, where: Machine, device: torch.device, seconds: float, floor: cuda_floor.Floor | None = None
    ) -> None:
        self.clock, self.where, self.device, self.seconds, self.floor = clock, where, device, seconds, floor
        self.limits = Limits()
        self.rows: list[Row] = []
        self.failures: list[str] = []
        self.memset_us: dict[tuple[int, ...], float] = {}

    def point(self, point: Point, given: meshes.Batch, todo: list[Way]) -> None:
        stage = Stage(point, given, self.device)
        us_memset = self.memset(stage)
        count = len(given.triangles)
        times: dict[str, list[float]] = {}
        wrong: dict[str, int] = {}
        for turn in range(point.turns):
            for way in todo if turn % 2 == 0 else reversed(todo):
                if not self.limits.allows(point, way, count):
                    continue
                try:
                    with setting(way, point):
                        us = self.time(stage, way, point, count, wrong)
                except RuntimeError as error:
                    self.failures.append(f"{point.curve} {point.kind} {point.x} {way.name}: {str(error).splitlines()[0]}")
                    if self.device.type == "cuda":
                        torch.cuda.synchronize()  # raises again if the device is lost
                    continue
                if us:
                    times.setdefault(way.name, []).extend(us)
        for way in todo:
            if way.name in times:
                self.rows.append(self.row(point, way, count, times[way.name], wrong[way.name], stage.against, us_memset))

    def time(self, stage: Stage, way: Way, point: Point, count: int, wrong: dict[str, int]) -> list[float]:
        """Microseconds of graph replays; none where a first call passes the limit."""

        def call() -> None:
            stage.draw(way.variant)

        call()
        first = self.clock.once(call)
        self.limits.saw(point, way, count, first)
        if first > LIMIT:
            return []
        us, again = self.clock.measure(call, "graph", self.seconds, AT_LEAST)
        wrong[way.name] = max(wrong.get(way.name, 0), stage.wrong_pixels(way, again))
        self.limits.saw(point, way, count, statistics.median(us))
        return us

    def memset(self, stage: Stage) -> float | None:
        shape = tuple(stage.packed.shape)
        if self.floor and shape not in self.memset_us:
            us, _ = self.clock.measure(partial(self.floor.memset, stage.packed), "graph", self.seconds, AT_LEAST)
            self.memset_us[shape] = statistics.median(us)
        return self.memset_us.get(shape)

    def row(self, point: Point, way: Way, count: int, us: list[float], wrong: int, against: str, memset: float | None) -> Row:
        timing = summary(us)
        return Row(
            curve=point.curve,
            kind=point.kind,
            x=point.x,
            width=point.width,
            height=point.height,
            variant=way.variant,
            path=way.path,
            widest=point.widest,
            triangles=count,
            method="graph",
            us_median=timing.median,
            us_min=timing.minimum,
            us_p25=timing.p25,
            us_p75=timing.p75,
            repeats=timing.repeats,
            wrong_pixels=wrong,
            against=against,
            us_memset=memset,
            **self.where._asdict(),
        )


def bytes_of(point: Point) -> int:
    """Device memory for the image, what it is compared with and the comparison."""
    return point.views * point.width * point.height * (8 + 8 + 1)


def fits(point: Point, largest: int) -> bool:
    return max(point.width, point.height) <= largest and bytes_of(point) <= MAX_BYTES


def name_of(row: Row) -> str:
    return f"{row.variant} {row.path}".strip()


def point_line(rows: list[Row]) -> str:
    """One point: every way's time."""
    first = rows[0]
    line = f"{first.curve:15} {first.kind:25} {first.x:>10} {first.triangles:>9}  memset {text_of(first.us_memset):>6}  "
    line += "  ".join(f"{name_of(row)} {text_of(row.us_median)}" for row in rows)
    wrong = sum(row.wrong_pixels for row in rows)
    return line + (f"  WRONG PIXELS: {wrong}" if wrong else "")


# The same two designs in an earlier project, on a GTX 1070 Ti: ms, persistent and two-stage. Only the ratio is to be compared.
EARLIER_MS = {"few large": (0.991, 0.966), "many large": (1.521, 1.26), "very large": (2.126, 1.577)}


def design_lines(rows: list[Row]) -> list[str]:
    """persistent against two_stage on large triangles, beside the ratio of `EARLIER_MS`."""
    lines = []
    for kind, (persistent_ms, two_stage_ms) in EARLIER_MS.items():
        us = {row.variant: row for row in rows if row.curve == "designs" and row.kind == kind and not row.path}
        if not {"persistent", "two_stage"} <= us.keys():
            continue
        a, b = us["persistent"], us["two_stage"]
        lines.append(
            f"{kind:12} persistent {text_of(a.us_median):>7} us, two_stage {text_of(b.us_median):>7} us: ratio "
            f"{a.us_median / b.us_median:.3f} (quartiles {a.us_p25 / b.us_p75:.3f} to {a.us_p75 / b.us_p25:.3f}); "
            f"earlier {persistent_ms / two_stage_ms:.3f}"
        )
    return lines


# --- cliffs

CLIFF = (1.1, 1.0)  # times, and us above, what was to be expected


def cliffs(x: Sequence[float], us: Sequence[float]) -> list[int]:
    """The points of a curve after which there is a cliff; x: the work, rising; us: the time.

    Up: the time grows by a higher power of x than in the steps before and after; of the last step nobody knows. Down: more work
    takes less time, so that the work before it must have been done badly.
    """
    steps = range(len(us) - 1)
    power = [math.log(us[i + 1] / us[i]) / math.log(x[i + 1] / x[i]) for i in steps]
    times, above = CLIFF
    found = []
    for i in steps:
        beside = max([0.0, *power[max(0, i - 1) : i], *(power[i + 1 : i + 2] or [math.inf])])
        expected = us[i] * (x[i + 1] / x[i]) ** beside
        low, high = (us[i + 1], us[i]) if power[i] < 0 else (expected, us[i + 1])
        if high > times * low and high > low + above:
            found.append(i)
    return found


def cliff_lines(rows: list[Row]) -> list[str]:
    """Where "auto" has a cliff in a sweep."""
    lines = []
    for curve, kind in dict.fromkeys((row.curve, row.kind) for row in rows if row.curve in SWEEPS):
        here = [row for row in rows if (row.curve, row.kind) == (curve, kind)]
        found = cliffs([row.x for row in here], [row.us_median for row in here])
        for before, after in ((here[i], here[i + 1]) for i in found):
            change = f"{text_of(before.us_median)} us at {before.x} to {text_of(after.us_median)} at {after.x}"
            lines.append(f"{curve} {kind}: from {change}")
        lines.append(f"{curve} {kind}: {len(found)} cliffs in {len(here)} points")
    return lines


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument(
        "--curves",
        default=",".join(CURVES),
        help=f"of {', '.join((*CURVES, *SWEEPS))}; sweeps: the last ones (default the others)",
    )
    parser.add_argument(
        "--ways", default="all", help="variants, and 'bin_owned few' and so on, separated by commas (default all)"
    )
    parser.add_argument("--largest", type=int, default=SIDE, help=f"side of the largest image, px (default {SIDE}: 2 GiB)")
    parser.add_argument("--most", type=int, default=10_000_000, help="triangles of the largest scene (default ten million)")
    parser.add_argument("--seconds", type=float, default=0.03, help="time for each figure (default 0.03)")
    parser.add_argument("--total", type=float, default=150, help="s for all, shared out among the curves (default 150)")
    parser.add_argument("--csv", metavar="FILE", type=option_types.csv_file, help="write the rows there")
    parser.add_argument("--dry-run", action="store_true", help="on the CPU by the host's clock: does it run?")
    arguments = parser.parse_args(argv)
    started = time.perf_counter()
    device = cuda_cases.device_for(arguments.dry_run)
    variants = native.REGISTRY[device.type][DEFAULT]
    everything = {way.name: way for way in ways(variants)}
    todo = [everything[name] for name in cuda_clock.listed(arguments.ways, "way", everything)]
    named = ",".join(SWEEPS) if arguments.curves == "sweeps" else arguments.curves
    curves = cuda_clock.listed(named, "curve", (*CURVES, *SWEEPS))
    where = cuda_clock.machine()
    print(cuda_clock.headline(where), flush=True)
    clock = cuda_clock.clock_for(device)
    scaling = Scaling(clock, where, device, arguments.seconds, cuda_cases.start_floor(device))

    lost = False
    for number, curve in enumerate(curves):
        left = started + arguments.total - time.perf_counter()
        end = time.perf_counter() + left / (len(curves) - number)
        skipped = 0
        compared = ways_on(curve, todo, variants)
        if not compared:
            print(f"{curve}: left out, it compares none of the ways")
            continue
        made: tuple[str, meshes.Batch] | None = None  # the points of `rows` share their scenes
        for point in (CURVES | SWEEPS)[curve]():
            if time.perf_counter() > end or lost:
                skipped += 1
                continue
            if not fits(point, arguments.largest) or (curve in ("count", "body_count") and point.x > arguments.most):
                continue
            label = f"{point.kind} {0 if curve == 'rows' else point.x}"
            if made is None or made[0] != label:
                made = (label, point.given())
            if len(made[1].triangles) > arguments.most:
                continue
            before = len(scaling.rows)
            try:
                scaling.point(point, made[1], compared)
            except RuntimeError as error:
                scaling.failures.append(f"{point.curve} {point.kind} {point.x}: {str(error).splitlines()[0]}")
                lost = True
            if scaling.rows[before:]:
                print(point_line(scaling.rows[before:]), flush=True)
            if device.type == "cuda" and not lost:
                torch.cuda.empty_cache()
        if arguments.csv:
            benchmark.write_csv(arguments.csv, scaling.rows, cuda_clock.DIGITS)
        if skipped:
            print(f"{curve}: {skipped} points left out, its share of --total was over")
    print("\n".join((*design_lines(scaling.rows), *cliff_lines(scaling.rows))))
    for failure in scaling.failures:
        print("FAILED", failure)
    wrong = sum(row.wrong_pixels for row in scaling.rows)
    took = time.perf_counter() - started
    print(f"{len(scaling.rows)} rows in {took:.0f} s; {wrong} wrong pixels; {len(scaling.failures)} failures")
    return 1 if wrong or scaling.failures or not scaling.rows else 0


if __name__ == "__main__":
    sys.exit(main())

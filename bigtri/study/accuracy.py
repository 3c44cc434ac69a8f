"""The accuracy study: what each rung of the precision ladder gets wrong, beside the time that it takes.

A case is a scene in an image. Errors are counted against exact rational arithmetic (``truth.py``): coverage in rows of the image
that a seed chooses, all of them where the scene is small; depth and weights at pixels among these. A picture is judged by one of
8x8 samples a pixel. Times come from rounds: in each, every rung draws once, and the ratio is to the ``exact`` of the same round.
``exact`` draws twice a round, the second time as the control: what its ratio is away from 1, the clock cannot tell.

A rung draws the same bits on every device, so errors need no second study; ``study`` leaves them out on request.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from .. import native
from ..hard_cases import constructions
from ..ops.interpolate import barycentrics
from ..ops.rasterize import Visibility, rasterize
from ..ops.shading import encode_srgb
from ..precision import DEFAULT, PRECISIONS, RUNGS
from ..reference.numerics import BACKGROUND, MAX_SIZE
from ..scene import load_scene
from ..scene.camera import Camera
from . import errors, provenance, scenes, truth
from .clock import interleaved, setting, summary

CONTROL = "exact again"
SAMPLES = (2, 3, 4)  # a pixel along each axis, of rows of their own
TRUTH_SAMPLES = 8
TEXTURE = 1024  # texels along each edge of a triangle, for errors of its weights
_MASK_TRIANGLES = 500  # masks are counted with the reference, of scenes up to here


class Case(NamedTuple):
    """A scene in an image."""

    name: str
    width: int  # px
    height: int
    positions: NDArray[np.float32]  # [V, 4]
    triangles: NDArray[np.int32]  # [T, 3]
    reverse: NDArray[np.float32] | None = None  # [V, 4], of a projection that reverses depth; None: made from ``positions``
    meant: NDArray[np.float64] | None = None  # [V, 4], what the truth is of, where rounding ``positions`` already lost it

    def positions_for(self, precision: str) -> NDArray[np.float32]:
        """What a rung is given."""
        if not RUNGS[precision].reversed:
            return self.positions
        return reversed_depth(self.positions) if self.reverse is None else self.reverse


def reversed_depth(positions: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
    """Clip-space positions [V, 4] with z from w at the near plane to 0 at the far one, rounded once."""
    result = positions.astype(np.float64)
    result[:, 2] = (result[:, 3] - result[:, 2]) / 2
    return result.astype(np.float32)


@dataclasses.dataclass
class Row:
    """A rung in a case; the fields are the CSV's columns. What was not measured is empty."""

    scene: str
    triangles: int
    width: int  # px
    height: int  # px
    precision: str
    axis: str  # where it differs from exact, or "samples"
    timed: str  # "rasterize", "barycentrics", or both
    variant: str
    threads: int
    isa: str
    device: str
    versions: str
    commit: str
    command: str
    ms_median: float
    ms_min: float
    ms_p25: float
    ms_p75: float
    ratio: float  # the time over that of exact in the same round: median of the rounds
    ratio_p25: float
    ratio_p75: float
    rounds: int
    sample_px: int | None = None  # pixels in which coverage was compared
    wrong_ppm: float | None = None  # of these, per million: show another triangle than they should
    flips_ppm: float | None = None  # show a triangle that is there, but not the nearest one
    cracks_ppm: float | None = None  # along shared edges: neither triangle is drawn
    overlaps_ppm: float | None = None  # both are
    depth_px: int | None = None  # pixels in which depth and weights were compared
    depth_ulp_median: float | None = None
    depth_ulp_p99: float | None = None
    depth_ulp_max: float | None = None
    texels_median: float | None = None
    texels_p99: float | None = None
    texels_max: float | None = None
    psnr: float | None = None  # dB
    ssim: float | None = None
    tiles: int | None = None  # that the mask names
    empty_tiles: int | None = None  # of these, without a covered pixel


# What is not a time: the same on every device and instruction set.
ERRORS = tuple(field.name for field in dataclasses.fields(Row) if field.default is None)
_COUNTS = ("sample_px", "depth_px", "tiles", "empty_tiles")


def fill_errors(rows: Sequence[Row], earlier: Sequence[Mapping[str, str]]) -> int:
    """Gives rows whose times were measured alone the errors of an earlier study's CSV; returns how many found none there.

    A row's errors are those of the same rung in the same scene at the same size, whatever drew it.
    """

    def key(row: Mapping[str, Any]) -> tuple[str, ...]:
        return tuple(str(row[name]) for name in ("scene", "triangles", "width", "height", "precision"))

    known = {key(row): row for row in earlier}
    without = 0
    for row in rows:
        found = known.get(key(vars(row)), {})
        without += not found
        for name in ERRORS:
            if text := found.get(name):
                setattr(row, name, int(text) if name in _COUNTS else float(text))
    return without


class Effort(NamedTuple):
    """How much is compared."""

    pairs: int  # of a pixel and a triangle whose box has it, to choose the rows by
    pixels: int  # for depth and weights
    picture: int  # samples of the picture that is the truth
    seconds: float  # of the clock, a case


FULL = Effort(pairs=4_000_000, pixels=500, picture=8_300_000, seconds=12.0)
QUICK = Effort(pairs=300_000, pixels=60, picture=1_100_000, seconds=1.0)


# --- cases


def hard(build: Callable[[], list[Any]]) -> Case:
    """The first mesh of a construction of ``bigtri.hard_cases``."""
    mesh = build()[0]
    height, width = mesh.resolution
    return Case(build.__name__, width, height, mesh.positions, mesh.triangles)


def fight() -> Case:
    """A slope and strips that lie nearer by 2^-25 of the depth range, and each by twice as much as the one before.

    All are 12,000 px high, and the screen is at their near end: depth is small there and large at the corners. The strips have
    other corners than the slope, so what depends on corners may put them behind it.
    """
    width, height, strips = 512, 256, 8
    rng = np.random.default_rng(5)
    # On a grid of 1/16 px, so that no rung moves a plane.
    parts = [(np.array([[-6000.4375, -157.3125], [6011.9375, -151.125], [41.375, 12001.4375]]), 0.0)]
    for k in range(strips):
        left, right = 64 * k + 3.0, 64 * k + 60.0
        quad = np.array([[left, 9], [right, 11], [right, 11_950], [left, 11_970]]) + rng.integers(-16, 16, (4, 2)) / 16
        parts += [(quad[[0, 1, 2]], 2.0 ** (k - 25)), (quad[[0, 2, 3]], 2.0 ** (k - 25))]
    rows = []
    for xy, nearer in parts:
        z = 0.02 + 0.95 / 12_200 * (xy[:, 1] + 160) + 1e-6 * xy[:, 0] - nearer
        rows.append(np.column_stack([xy[:, 0] * 2 / width - 1, 1 - xy[:, 1] * 2 / height, 2 * z - 1, np.ones(3)]))
    positions = np.concatenate(rows).astype(np.float32)
    return Case("fight", width, height, positions, np.arange(len(positions), dtype=np.int32).reshape(-1, 3))


def far_planes() -> Case:
    """Two walls 10 cm apart at 100 m, where the near plane is 1 mm and the far one 1 km away."""
    near, far, size = 0.001, 1000.0, 128
    wall = [np.array([(-d, -d, -d), (d, -d, -d), (d, d, -d), (-d, d, -d)]) for d in (100.1, 100.0)]
    points = np.concatenate(wall)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the camera's, of a range of depth that is too large: it is what the case is for
        positions = Camera((0, 0, 0), (0, 0, -1), near=near, far=far).transform(points, 1.0)
    reverse = positions.copy()
    reverse[:, 2] = near * (far + points[:, 2]) / (far - near)
    meant = positions.astype(np.float64)
    meant[:, 2] = meant[:, 3] - 2 * reverse[:, 2].astype(np.float64)
    triangles = np.array([(0, 1, 2), (0, 2, 3), (4, 5, 6), (4, 6, 7)], np.int32)
    return Case("far_planes", size, size, positions, triangles, reverse, meant)


def floor() -> Case:
    """A floor of 6 x 6 squares, each of two triangles, that passes under the camera: both clipping and perspective."""
    width, height = 320, 240
    x, z = np.meshgrid(np.linspace(-7, 7, 7), np.linspace(4, -20, 7))
    points = np.stack([x, np.full_like(x, -1.0), z], axis=2).reshape(-1, 3)
    index = np.arange(49, dtype=np.int32).reshape(7, 7)
    corner, beside, below, across = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    triangles = np.stack([corner, beside, below, beside, across, below], axis=2).reshape(-1, 3)
    camera = Camera((0.37, 0.6, 0.2), (-0.4, 0.1, -3.0), fov_y=60.0, near=0.1, far=100.0)
    return Case("floor", width, height, camera.transform(points, width / height), triangles)


HARD: dict[str, Callable[[], Case]] = {
    "ties": lambda: hard(constructions.fan_through_centres)._replace(name="ties"),
    "needles": lambda: hard(constructions.needles),
    "far_fan": lambda: hard(constructions.far_fan),
    "fight": fight,
    "far_planes": far_planes,
    "floor": floor,
}
DEFAULT_NAMES = (*HARD, "S2", "S3", "S6-200k", "R4k", "R16k", "R100k", "Rcourtyard", "Rroom")


def case(name: str, width: int, height: int, seed: int = scenes.SEED) -> Case:
    """A hard case, which has a size of its own, or a scene of ``bigtri.study.scenes``."""
    if name in HARD:
        return HARD[name]()
    scene = scenes.make(name, width, height, seed)
    return Case(name, width, height, scene.positions, scene.triangles)


def of_model(path: Path, width: int, height: int) -> Case:
    """A model's file, all of it in the picture.

    Raises:
        OSError, ValueError: it cannot be read.
    """
    scene = load_scene(path)
    camera = Camera.framing(scene.bounds, aspect=width / height)
    return Case(path.name, width, height, camera.transform(scene.positions, width / height), scene.triangles)


# --- errors


class Judge:
    """The truth of a case, against which rungs are held."""

    def __init__(self, case: Case, effort: Effort, seed: int = scenes.SEED) -> None:
        self.case = case
        self._known: dict[tuple[Any, ...], Any] = {}
        rng = np.random.default_rng(seed)
        meant = case.positions if case.meant is None else case.meant
        size = case.height, case.width
        box = truth.boxes(meant, case.triangles, *size)
        pairs = int(((box[:, 2] - box[:, 0]) * (box[:, 3] - box[:, 1])).sum())
        count = min(case.height, max(1, case.height * effort.pairs // max(1, pairs)))
        rows = np.sort(rng.choice(case.height, count, replace=False))
        self.rows = truth.in_rows(meant, case.triangles, *size, rows)
        self._neighbours = errors.Neighbours(case.positions, case.triangles)
        covered = np.argwhere(self.rows.triangle != truth.BACKGROUND)
        chosen = covered[np.sort(rng.choice(len(covered), min(effort.pixels, len(covered)), replace=False))]
        self._shown = self.rows.triangle[chosen[:, 0], chosen[:, 1]]
        self._pixels = np.stack([chosen[:, 1], rows[chosen[:, 0]]], axis=1)
        self._picture = _picture_size(case, effort.picture)
        self._sharp = _picture(case, DEFAULT, self._picture, TRUTH_SAMPLES)

    def of(self, precision: str, drawn: Visibility, weights: NDArray[np.float32]) -> dict[str, Any]:
        """What a rung got wrong: fields of ``Row``.

        Args:
            precision: the rung.
            drawn: what it drew, NumPy [H, W], depth included.
            weights: float32 [H, W, 3], its barycentrics.
        """
        case = self.case
        given = case.positions_for(precision)
        found = errors.in_rows(np.asarray(drawn.triangle), len(case.triangles), self.rows)
        seams = self._once(
            "seams",
            precision,
            lambda: errors.seams(given, case.triangles, (case.height, case.width), self.rows, self._neighbours, precision),
        )
        million = 1e6 / found.pixels
        result = {
            "sample_px": found.pixels,
            "wrong_ppm": found.wrong * million,
            "flips_ppm": found.flips * million,
            "cracks_ppm": seams.cracks * million,
            "overlaps_ppm": seams.overlaps * million,
        }
        result |= self._depth_and_weights(precision, drawn, weights)
        psnr, ssim = errors.likeness(_picture(case, precision, self._picture), self._sharp)
        return {**result, "psnr": psnr, "ssim": ssim}

    def _depth_and_weights(self, precision: str, drawn: Visibility, weights: NDArray[np.float32]) -> dict[str, Any]:
        case, (x, y) = self.case, self._pixels.T
        here = np.asarray(drawn.triangle)[y, x]
        shown = np.where(here == self._shown, here, truth.BACKGROUND).astype(np.int32)
        found = self._once(
            shown.tobytes(),
            precision,
            lambda: truth.at(
                case.positions_for(precision),
                case.triangles,
                case.height,
                case.width,
                self._pixels,
                shown,
                RUNGS[precision],
            ),
        )
        depth = np.asarray(drawn.depth)[y, x]
        if RUNGS[precision].reversed:  # what is stored is the distance of its bits from those of 1
            depth = (np.float32(1).view(np.int32) - depth.view(np.int32)).view(np.float32)
        corners = np.broadcast_to(np.arange(3, dtype=np.int32), (len(case.triangles), 3))
        measured = {
            "depth_ulp": errors.depth_ulp(depth, here, found),
            "texels": errors.attribute_error(weights[y, x], here, np.eye(3, dtype=np.float32), corners, found, TEXTURE),
        }
        result: dict[str, Any] = {"depth_px": len(measured["texels"])}
        for name, values in measured.items():
            if len(values):
                median, high = np.percentile(values, [50, 99])
                result |= {f"{name}_median": float(median), f"{name}_p99": float(high), f"{name}_max": float(values.max())}
        return result

    def _once(self, what: str | bytes, precision: str, compute: Callable[[], Any]) -> Any:
        """A value that depends on a rung's records alone, computed for the first rung that makes these records."""
        rule = RUNGS[precision].precision
        key = what, rule.coverage, rule.clip, RUNGS[precision].reversed
        if key not in self._known:
            self._known[key] = compute()
        return self._known[key]

    def of_samples(self, samples: int) -> dict[str, Any]:
        """The likeness of ``exact`` with several samples a pixel."""
        psnr, ssim = errors.likeness(_picture(self.case, DEFAULT, self._picture, samples), self._sharp)
        return {"psnr": psnr, "ssim": ssim}

    def of_masks(self, precision: str) -> dict[str, Any]:
        """What a rung's masks name."""
        case = self.case
        if len(case.triangles) > _MASK_TRIANGLES:
            return {}
        found = errors.masks(case.positions_for(precision), case.triangles, case.height, case.width, RUNGS[precision])
        return {"tiles": found.touched, "empty_tiles": found.empty}


def _picture_size(case: Case, samples: int) -> tuple[int, int]:
    """Height and width of a picture of the case with at most so many samples at 8x8 a pixel, no larger than the case."""
    shrink = min(1.0, (samples / (TRUTH_SAMPLES**2 * case.width * case.height)) ** 0.5)
    return max(8, round(case.height * shrink)), max(8, round(case.width * shrink))


def _picture(case: Case, precision: str, size: tuple[int, int], samples: int = 1) -> NDArray[np.uint8]:
    """uint8 [H, W, 3], sRGB: a colour for each triangle, with an 8x8 checkerboard between its edges; the mean of NxN samples."""
    fine = size[0] * samples, size[1] * samples
    given = case.positions_for(precision)
    drawn = rasterize(given, case.triangles, fine, precision=precision, depth=False)
    weights = np.asarray(barycentrics(drawn, given, case.triangles, precision=precision))
    color = np.random.default_rng(1).uniform(0.1, 0.9, (len(case.triangles) + 1, 3)).astype(np.float32)
    color[-1] = 0.02
    with np.errstate(all="ignore"):
        dark = np.floor(weights[..., :2] * 8).sum(axis=-1) % 2 == 1
    linear = color[np.asarray(drawn.triangle)] * np.where(dark, np.float32(0.5), np.float32(1))[..., None]
    mean = linear.reshape(size[0], samples, size[1], samples, 3).mean(axis=(1, 3), dtype=np.float32)
    return np.asarray(encode_srgb(mean))


# --- times


class Drawing:
    """A rung's calls on a device, into memory that is there already."""

    def __init__(self, case: Case, precision: str, variant: str, device: str, samples: int = 1) -> None:
        self.size = case.height * samples, case.width * samples
        self.precision, self.variant, self.device = precision, variant, torch.device(device)
        self.parameters = parameters_of(device, precision, variant)
        self.positions = torch.from_numpy(case.positions_for(precision)).to(self.device)
        self.triangles = torch.from_numpy(case.triangles).to(self.device)
        self.packed = torch.full(self.size, BACKGROUND, dtype=torch.int64, device=self.device)
        self.weights = torch.empty((*self.size, 3), device=self.device)

    def rasterize(self) -> None:
        rasterize(
            self.positions,
            self.triangles,
            self.size,
            backend="native",
            variant=self.variant,
            precision=self.precision,
            parameters=self.parameters,
            depth=False,
            out=self.packed,
        )

    def barycentrics(self) -> None:
        barycentrics(self.packed, self.positions, self.triangles, backend="native", precision=self.precision, out=self.weights)

    def both(self) -> None:
        self.rasterize()
        self.barycentrics()

    def drawn(self) -> Visibility:
        """What the rung draws, depth included, as NumPy."""
        seen = rasterize(
            self.positions, self.triangles, self.size, backend="native", variant=self.variant, precision=self.precision
        )
        return Visibility(*(torch.as_tensor(field).cpu().numpy() for field in seen))


def parameters_of(device: str, precision: str, variant: str) -> dict[str, int] | None:
    """What a variant is given so that all rungs take the same way through it: those of the ladder never draw by rows on CUDA."""
    known = native.REGISTRY.get(device, {}).get(precision, {}).get(variant)
    return {"rows": 0} if known is not None and "rows" in known.parameters else None


def axis_of(precision: str) -> str:
    """The axes on which a rung differs from exact, joined by +; "none" for exact."""
    mine, default = RUNGS[precision].precision, RUNGS[DEFAULT].precision
    found = [field.name for field in dataclasses.fields(mine) if getattr(mine, field.name) != getattr(default, field.name)]
    return "+".join(found) or "none"


def timed_of(precision: str) -> str:
    """Which calls show what a rung costs: barycentrics where attributes differ, rasterize where anything else does."""
    axis = axis_of(precision)
    if axis == "attributes":
        return "barycentrics"
    return "rasterize+barycentrics" if "attributes" in axis else "rasterize"


class Setting(NamedTuple):
    """Where and how rungs are drawn."""

    device: str = "cpu"  # or "cuda"
    variant: str = "two_stage"
    threads: int = 1
    isa: str = ""  # empty: the fastest that there is

    def rungs(self) -> list[str]:
        """Those that the extension draws this way, exact first."""
        compiled = native.REGISTRY.get(self.device, {})
        return [rung for rung in PRECISIONS if rung in compiled and (self.variant == "auto" or self.variant in compiled[rung])]


def study(
    case: Case,
    rungs: Sequence[str],
    setting_: Setting,
    effort: Effort,
    seed: int = scenes.SEED,
    with_errors: bool = True,
) -> list[Row]:
    """A row for each rung, one for the control, and one for each number of samples a pixel; exact first.

    ``with_errors=False`` measures times alone, where the errors are known from another device.

    Raises:
        ValueError: a rung or a variant that the extension does not have there.
    """
    every = [DEFAULT, *(rung for rung in rungs if rung != DEFAULT)]
    drawings = {rung: Drawing(case, rung, setting_.variant, setting_.device) for rung in every}
    samples = [n for n in SAMPLES if max(case.width, case.height) * n <= MAX_SIZE]
    judge = Judge(case, effort, seed) if with_errors else None
    rows = []
    with setting(setting_.threads, setting_.isa or None):
        for drawing in drawings.values():
            drawing.rasterize()
        ms = interleaved(dict(_calls(case, drawings, setting_)), 0.7 * effort.seconds, device=setting_.device)
        # By themselves, since large images leave nothing of the small ones in the caches.
        finer = interleaved(
            {f"samples{n}": Drawing(case, DEFAULT, setting_.variant, setting_.device, n).rasterize for n in (1, *samples)},
            0.3 * effort.seconds,
            at_least=3,
            device=setting_.device,
        )
        isa = native.isa() if setting_.device == "cpu" else ""
        for name, axis, timed, found in _outcomes(every, drawings, samples, judge):
            base, own = (
                (finer["samples1"], finer[name]) if axis == "samples" else (ms[f"{DEFAULT} {timed}"], ms[f"{name} {timed}"])
            )
            low, ratio, high = np.percentile(np.array(own) / np.array(base), [25, 50, 75])
            timing = summary(own)
            rows.append(
                Row(
                    scene=case.name,
                    triangles=len(case.triangles),
                    width=case.width,
                    height=case.height,
                    precision=name,
                    axis=axis,
                    timed=timed,
                    variant=setting_.variant,
                    threads=setting_.threads,
                    isa=isa,
                    device=provenance.device(setting_.device),
                    versions=provenance.versions(),
                    commit=provenance.commit(),
                    command=provenance.command(),
                    ms_median=timing.median,
                    ms_min=timing.minimum,
                    ms_p25=timing.p25,
                    ms_p75=timing.p75,
                    ratio=float(ratio),
                    ratio_p25=float(low),
                    ratio_p75=float(high),
                    rounds=timing.repeats,
                    **found,
                )
            )
    return rows


def _calls(case: Case, drawings: dict[str, Drawing], setting_: Setting) -> Iterator[tuple[str, Callable[[], None]]]:
    """What the clock calls, by rung and by what is timed."""
    methods = {"rasterize": Drawing.rasterize, "barycentrics": Drawing.barycentrics, "rasterize+barycentrics": Drawing.both}
    wanted = {timed_of(rung) for rung in drawings}
    for rung, drawing in drawings.items():
        for timed in methods:
            if timed in wanted if rung == DEFAULT else timed == timed_of(rung):
                yield f"{rung} {timed}", methods[timed].__get__(drawing)
    again = Drawing(case, DEFAULT, setting_.variant, setting_.device)
    yield f"{CONTROL} rasterize", again.rasterize


def _outcomes(
    rungs: Sequence[str], drawings: dict[str, Drawing], samples: Sequence[int], judge: Judge | None
) -> Iterator[tuple[str, str, str, dict[str, Any]]]:
    """Name, axis, what is timed, and errors, of each row."""
    for rung in rungs:
        axis, found = axis_of(rung), {}
        if judge:
            drawing = drawings[rung]
            drawn = drawing.drawn()
            drawing.rasterize()
            drawing.barycentrics()
            found = judge.of(rung, drawn, drawing.weights.cpu().numpy())
            if axis in ("none", "mask"):
                found |= judge.of_masks(rung)
        yield rung, axis, timed_of(rung), found
        if rung == DEFAULT:
            yield CONTROL, "control", "rasterize", {}
    for n in samples:
        yield f"samples{n}", "samples", "rasterize", judge.of_samples(n) if judge else {}


# --- who dominates whom


def front(points: Sequence[tuple[float, float]]) -> list[int]:
    """The indices of points (cost, error) that no other one beats: none is as good in both and better in one."""
    best = []
    for k, (cost, error) in enumerate(points):
        if not any(c <= cost and e <= error and (c < cost or e < error) for c, e in points):
            best.append(k)
    return best

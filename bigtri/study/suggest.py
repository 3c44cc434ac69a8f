"""``suggest_precision``: the cheapest rung that is good enough for a scene, by its errors and its time there."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from .. import native
from ..ops import arguments
from ..ops.interpolate import interpolate
from ..ops.rasterize import rasterize
from ..precision import DEFAULT, PRECISIONS, RUNGS, Arithmetic
from ..reference.numerics import MAX_SIZE
from ..rendering.render import render
from ..scene.camera import Camera
from ..scene.plan import plan_for
from ..scene.scene import Scene
from ..scene.vectors import number
from . import errors, provenance, truth
from .clock import Timing, interleaved, summary
from .truth import BACKGROUND, Seen

CONFIDENCE = 0.95  # of what is said of all pixels after looking at some
_VALUES = 1 << 12  # pixels whose depth and attributes are compared, at most: each is a sum of fractions
_PICTURE_SAMPLES = 1 << 24  # of the picture that is the truth of one, at most
_SUPERSAMPLE = 8  # samples of it along each side of a pixel, where that is not too many
_SMALLEST_PICTURE = 7  # px a side, what ``errors.likeness`` takes


@dataclass(frozen=True)
class Tolerance:
    """How far a picture may be from the truth, in one unit or in several, all of which must hold.

    A limit on depth or attributes alone speaks of pixels that show the triangle that they should, and so asks in addition for no
    more wrong pixels than ``exact`` has. A limit on wrong pixels replaces that.

    Attributes:
        wrong_pixels_per_million: that show another triangle than the scene has at their centres, before anything is snapped.
        depth_ulp: of the depth of a pixel, in units in the last place of float32, from the plane through the snapped vertices.
        attribute_texels: of interpolated uv, in texels of the texture that is seen.
        psnr_db: the least peak signal-to-noise ratio, against a picture of 8x8 samples a pixel, or as many as fit into memory.

    Raises:
        TypeError: a limit that is no number.
        ValueError: no limit at all, or one that is negative or not finite.
    """

    wrong_pixels_per_million: float | None = None
    depth_ulp: float | None = None
    attribute_texels: float | None = None
    psnr_db: float | None = None

    def __post_init__(self) -> None:
        for name in self.named:
            limit = number("Tolerance", name, getattr(self, name))
            if limit < 0:
                raise ValueError(f"bigtri.Tolerance: {name} must not be negative, got {limit}")
            object.__setattr__(self, name, limit)
        if not self.named:
            units = ", ".join(field.name for field in fields(self))
            raise ValueError(f"bigtri.Tolerance: at least one of {units} must be a number, got none")

    @property
    def named(self) -> tuple[str, ...]:
        """The units that have a limit."""
        return tuple(field.name for field in fields(self) if getattr(self, field.name) is not None)

    def __str__(self) -> str:
        signs = {name: ">=" if name == "psnr_db" else "<=" for name in self.named}
        return ", ".join(f"{name} {sign} {getattr(self, name):g}" for name, sign in signs.items())


@dataclass(frozen=True)
class Evidence:
    """What was measured of one rung."""

    precision: str
    wrong: int  # of the pixels that were looked at
    wrong_pixels_per_million: float
    at_most_per_million: float  # wrong pixels of all, by CONFIDENCE; what a tolerance is compared with
    depth_ulp: float  # the largest error that was seen
    attribute_texels: float | None  # the largest error that was seen; None where nothing is textured
    psnr_db: float | None  # None where the tolerance does not name it
    time: Timing  # of drawing, and of interpolating uv where something is textured
    relative: float  # its median over that of exact
    meets: bool  # the tolerance


@dataclass(frozen=True)
class Suggestion:
    """The answer of ``suggest_precision``, with what it rests on; ``str`` makes a table of it."""

    precision: str  # the rung
    meets: bool  # whether it was shown to meet the tolerance; if not, no rung was, and it is exact
    tolerance: Tolerance
    evidence: tuple[Evidence, ...]  # of every rung that the device has, the fastest first
    resolution: tuple[int, int]  # height, width
    device: str  # "cpu" or "cuda"
    machine: str  # what it is called
    pixels: int  # that were looked at for their triangle; height * width where it was all
    values: int  # of these, how many were looked at for depth and attributes
    seed: int  # of the choice of pixels
    supersample: int | None  # samples along each side of a pixel in the true picture; None where there was no need of it

    def of(self, precision: str) -> Evidence:
        """What was measured of a rung.

        Raises:
            ValueError: the device does not have it.
        """
        by_name = {one.precision: one for one in self.evidence}
        arguments.check_choice("Suggestion.of", "precision", precision, tuple(by_name))
        return by_name[precision]

    def __str__(self) -> str:
        height, width = self.resolution
        everything = height * width
        if self.meets:
            answer = f"{self.precision}: the cheapest rung that meets {self.tolerance}"
        else:
            answer = f"{self.precision}: no rung was shown to meet {self.tolerance}"
        lines = [answer, f"{width}x{height} px, {self.device} ({self.machine})", _looked_at(self.pixels, everything, self.seed)]
        if self.values < everything:
            beyond = 1e6 * _at_most(0, self.values, everything) / everything
            lines.append(
                f"depth and texels: the largest errors of {self.values} pixels; "
                f"at most {beyond:.4g} per million are off by more ({CONFIDENCE:.0%} confidence)"
            )
        if self.supersample is not None:
            lines.append(f"PSNR: against {self.supersample}x{self.supersample} samples a pixel")
        header = ("rung", "ms", "/ exact", "wrong/million", "at most", "depth ulp", "texels", "PSNR dB", "meets")
        rows = [
            (
                one.precision,
                f"{one.time.median:.3f}",
                f"{one.relative:.2f}",
                f"{one.wrong_pixels_per_million:.4g}",
                f"{one.at_most_per_million:.4g}",
                f"{one.depth_ulp:.3g}",
                "" if one.attribute_texels is None else f"{one.attribute_texels:.3g}",
                "" if one.psnr_db is None else f"{one.psnr_db:.2f}",
                "yes" if one.meets else "no",
            )
            for one in self.evidence
        ]
        widths = [max(map(len, column)) for column in zip(header, *rows, strict=True)]
        for name, *cells in (header, *rows):
            lines.append("  ".join([name.ljust(widths[0]), *map(str.rjust, cells, widths[1:])]))
        return "\n".join(lines)


def suggest_precision(
    scene: Scene,
    camera: Camera,
    resolution: tuple[int, int],
    tolerance: Tolerance,
    *,
    device: str = "cpu",
    samples: int = 1 << 20,
    seed: int = 0,
    seconds: float = 2.0,
    times: Mapping[str, Timing] | None = None,
) -> Suggestion:
    """Name the cheapest rung that is good enough, for ``precision=``, with the evidence.

    Every rung that the device has draws the scene. Its errors are measured against rational arithmetic (``bigtri.study.truth``),
    which knows the scene as it was given, and its time on this machine, as ``variant="auto"`` runs it. Of the rungs that meet the
    tolerance the fastest is suggested; of those whose times the spread of the measurement does not tell apart from that one's,
    the most accurate, and ``exact`` before others that are as accurate to a tenth of the tolerance. ``depth_reversed`` is no
    candidate, since a camera's depth is not reversed.

    Where there are more pixels than ``samples``, so many are chosen at random, and a rung must be shown by them, with 95 %
    confidence, to have no more wrong pixels in all than the tolerance allows: n samples without an error show 3/n of all pixels.
    Of depth and attributes the largest error of up to 4096 of them counts.

    Args:
        scene: what is drawn.
        camera: from where.
        resolution: (height, width), px, 1 to 16384 each.
        tolerance: what is good enough.
        device: "cpu" or "cuda", where the rungs are timed: on "cuda" the device's own time, without the host's. The errors are
            those of either, as the bits are the same.
        samples: pixels to look at, at least 1; all of an image that has no more. A million takes some seconds.
        seed: which pixels. The answer is the same for the same seed, but for times.
        seconds: how long to measure times for, all rungs together, at least five calls of each.
        times: milliseconds of each candidate, instead of a measurement.

    Returns:
        Suggestion: ``precision``, the rung's name; ``meets``, whether it was shown to meet the tolerance, and if not, no rung
        was, and it is "exact"; ``evidence`` of every candidate. ``print`` it for a table.

    Raises:
        TypeError, ValueError: an argument of another type or value, or a tolerance of attributes for a scene without a texture,
            or of PSNR for a picture that is smaller than 7x7 px or larger than 4 Mpx; the text names it.
    """
    op = "suggest_precision"
    _check_type("scene", scene, Scene)
    _check_type("camera", camera, Camera)
    _check_type("tolerance", tolerance, Tolerance)
    height, width = arguments.check_image_size(op, "resolution", resolution)
    arguments.check_choice(op, "device", device, tuple(native.devices()) or ("cpu",))
    for name, value, least in (("samples", samples, 1), ("seed", seed, 0)):
        if not (isinstance(value, int) and value >= least):
            raise ValueError(f"bigtri.{op}: {name} must be a whole number of at least {least}, got {value!r}")
    if not number(op, "seconds", seconds) > 0:
        raise ValueError(f"bigtri.{op}: seconds must be positive, got {seconds!r}")
    candidates = _candidates(device)
    if times is not None:
        _check_times(times, candidates)
    subject = _Subject.of(scene, camera, height, width)
    if tolerance.attribute_texels is not None and not subject.textures:
        raise ValueError(f"bigtri.{op}: tolerance must not name attribute_texels for a scene without uvs and a texture in use")
    supersample = None if tolerance.psnr_db is None else _supersample(height, width)

    at = _choice(height * width, samples, seed)
    some = _choice(len(at), _VALUES, seed)
    found = _errors(subject, candidates, at, some, supersample)
    if times is None:
        every = interleaved({name: _call(subject, name, device) for name in candidates}, seconds, device=device)
        times = {name: summary(ms) for name, ms in every.items()}
    everything = height * width
    evidence = []
    for name, of_rung in found.items():
        most = 1e6 * _at_most(of_rung.wrong, len(at), everything) / everything
        measured = Evidence(
            precision=name,
            wrong=of_rung.wrong,
            wrong_pixels_per_million=1e6 * of_rung.wrong / len(at),
            at_most_per_million=most,
            depth_ulp=of_rung.depth_ulp,
            attribute_texels=of_rung.attribute_texels,
            psnr_db=of_rung.psnr_db,
            time=times[name],
            relative=times[name].median / times[DEFAULT].median,
            meets=_meets(tolerance, of_rung, most, allowed=found[DEFAULT].wrong),
        )
        evidence.append(measured)
    chosen = _cheapest(evidence, tolerance)
    return Suggestion(
        precision=DEFAULT if chosen is None else chosen.precision,
        meets=chosen is not None,
        tolerance=tolerance,
        evidence=tuple(sorted(evidence, key=lambda one: one.time.median)),
        resolution=(height, width),
        device=device,
        machine=provenance.device(device),
        pixels=len(at),
        values=len(some),
        seed=seed,
        supersample=supersample,
    )


# --- The choice


def _meets(tolerance: Tolerance, found: _Errors, most: float, allowed: int) -> bool:
    """Whether a rung is good enough: ``most`` wrong pixels per million, and ``allowed`` of those seen where no limit is named."""
    if tolerance.wrong_pixels_per_million is not None:
        if most > tolerance.wrong_pixels_per_million:
            return False
    elif not (tolerance.depth_ulp is None and tolerance.attribute_texels is None) and found.wrong > allowed:
        return False
    if tolerance.depth_ulp is not None and found.depth_ulp > tolerance.depth_ulp:
        return False
    if tolerance.attribute_texels is not None:
        assert found.attribute_texels is not None
        if found.attribute_texels > tolerance.attribute_texels:
            return False
    if tolerance.psnr_db is not None:
        assert found.psnr_db is not None
        return found.psnr_db >= tolerance.psnr_db
    return True


def _cheapest(evidence: list[Evidence], tolerance: Tolerance) -> Evidence | None:
    """The fastest that meets the tolerance; of those that are as fast within the spread, the most accurate.

    That is the one whose errors take up the least of the tolerance, to a tenth of it; of equals the first of the ladder.
    """
    good = [one for one in evidence if one.meets]
    if not good:
        return None
    fastest = min(good, key=lambda one: one.time.median)
    tied = [one for one in good if one.time.p25 <= fastest.time.p75]
    return min(tied, key=lambda one: (round(_share(one, tolerance), 1), PRECISIONS.index(one.precision)))


def _share(one: Evidence, tolerance: Tolerance) -> float:
    """The largest part of any limit that a rung's errors take up."""
    shares = []
    for name in tolerance.named:
        error, limit = getattr(one, name), getattr(tolerance, name)
        if name == "psnr_db":
            shares.append(limit / error if error else 1.0)
        else:
            shares.append(error / limit if error else 0.0)
    return max(shares)


@lru_cache(maxsize=256)
def _at_most(found: int, samples: int, everything: int) -> int:
    """How many there are of ``everything`` at most, by CONFIDENCE, if a random choice of ``samples`` has ``found``.

    One more would have shown only so few with a probability of at most 1 - CONFIDENCE (hypergeometric).
    """
    from scipy.stats import hypergeom

    low, high = found, everything - (samples - found)
    while low < high:
        middle = (low + high + 1) // 2
        if hypergeom.cdf(found, everything, middle, samples) > 1 - CONFIDENCE:
            low = middle
        else:
            high = middle - 1
    return low


# --- The errors


class _Subject(NamedTuple):
    """What is drawn, as ``rasterize`` takes it."""

    scene: Scene
    camera: Camera
    resolution: tuple[int, int]
    positions: NDArray[np.float32]  # [V, 4], clip space
    textures: dict[int, tuple[int, int]]  # of materials in use that have one: its height and width

    @staticmethod
    def of(scene: Scene, camera: Camera, height: int, width: int) -> _Subject:
        textures: dict[int, tuple[int, int]] = {}
        if plan_for(scene).textures:
            for index in scene.used_materials:
                texture = scene.materials[index].texture
                if texture is not None:
                    textures[index] = (texture.shape[0], texture.shape[1])
        return _Subject(scene, camera, (height, width), camera.transform(scene.positions, width / height), textures)


class _Errors(NamedTuple):
    """Of a rung; the fields are those of ``Evidence``."""

    wrong: int
    depth_ulp: float
    attribute_texels: float | None
    psnr_db: float | None


def _errors(
    subject: _Subject,
    candidates: tuple[str, ...],
    at: NDArray[np.int64],
    some: NDArray[np.int64],
    supersample: int | None,
) -> dict[str, _Errors]:
    """The errors of every candidate: of triangles at the pixels ``at``, of depth and attributes at ``some`` of them."""
    scene, height, width = subject.scene, *subject.resolution
    picture = None
    if supersample is not None:
        picture = render(scene, subject.camera, subject.resolution, supersample=supersample, backend=_backend(DEFAULT))
    pixels = np.stack([at % width, at // width], axis=1)
    true = truth.nearest_at(subject.positions, scene.triangles, height, width, pixels, scene.cull)
    values: dict[int, Seen] = {}  # by sub-pixel bits
    known: dict[tuple[object, ...], tuple[float, float | None]] = {}  # the errors of bits that another rung has too
    result = {}
    for name in candidates:
        rung = RUNGS[name]
        if rung.subpixel_bits not in values:
            grid = next(other for other in RUNGS.values() if other.subpixel_bits == rung.subpixel_bits)
            values[grid.subpixel_bits] = truth.at(
                subject.positions, scene.triangles, height, width, pixels[some], true[some], grid
            )
        triangle, depth, uv = _drawn(subject, rung, at)
        bits = rung.subpixel_bits, *(array[some].tobytes() for array in (triangle, depth, uv))
        if bits not in known:
            seen = values[rung.subpixel_bits]
            off = errors.depth_ulp(depth[some], triangle[some], seen)
            known[bits] = float(off.max(initial=0)), _texels(subject, triangle[some], uv[some], seen)
        psnr = None
        if picture is not None:
            drawn = render(scene, subject.camera, subject.resolution, precision=name, backend=_backend(name))
            psnr = errors.likeness(drawn, picture).psnr
        result[name] = _Errors(int(np.count_nonzero(triangle != true)), *known[bits], psnr)
    return result


def _choice(of: int, count: int, seed: int) -> NDArray[np.int64]:
    """int64 [N], rising: so many of the integers below ``of``, or all if there are no more."""
    if count >= of:
        return np.arange(of)
    return np.sort(np.random.default_rng(seed).choice(of, count, replace=False))


def _drawn(
    subject: _Subject, rung: Arithmetic, at: NDArray[np.int64]
) -> tuple[NDArray[np.int32], NDArray[np.float32], NDArray[np.float32]]:
    """Triangle int32 [N], depth float32 [N] and uv float32 [N, 2] (or [N, 0]) that a rung draws at the pixels ``at``."""
    scene, backend = subject.scene, _backend(rung.name)
    drawing: dict[str, Any] = {"precision": rung.name, "backend": backend}
    seen = rasterize(subject.positions, scene.triangles, subject.resolution, cull=scene.cull, **drawing)
    uv = np.empty((len(at), 0), np.float32)
    if subject.textures:
        assert scene.uvs is not None
        uv = np.asarray(interpolate(scene.uvs, seen, subject.positions, scene.triangles, **drawing)).reshape(-1, 2)[at]
    return np.asarray(seen.triangle).ravel()[at], np.asarray(seen.depth).ravel()[at], uv


def _texels(subject: _Subject, triangle: NDArray[np.int32], uv: NDArray[np.float32], seen: Seen) -> float | None:
    """The largest error of uv [N, 2], each coordinate in texels of the texture that is seen; None without textures."""
    scene = subject.scene
    if not subject.textures:
        return None
    assert scene.uvs is not None
    largest = 0.0
    material = np.where(seen.triangle == BACKGROUND, -1, scene.material[seen.triangle])
    for index, size in subject.textures.items():
        here = material == index
        seen_here = Seen(*(field[here] for field in seen))
        for channel, texels in ((0, size[1]), (1, size[0])):
            of_channel = slice(channel, channel + 1)
            off = errors.attribute_error(
                uv[here, of_channel], triangle[here], scene.uvs[:, of_channel], scene.triangles, seen_here, scale=texels
            )
            largest = max(largest, float(off.max(initial=0)))
    return largest


# --- What there is


def _candidates(device: str) -> tuple[str, ...]:
    """The rungs that a kind of device has and that take the depth of a camera; the reference, without the extension, has all."""
    return tuple(name for name in native.REGISTRY.get(device, PRECISIONS) if not RUNGS[name].reversed)


def _backend(precision: str) -> str:
    """Which backend draws a rung on the CPU."""
    return "native" if precision in native.REGISTRY.get("cpu", ()) else "reference"


def _call(subject: _Subject, precision: str, device: str) -> Callable[[], None]:
    """What is timed: drawing with one rung, and interpolating uv where something is textured."""
    scene = subject.scene
    positions, triangles = torch.from_numpy(subject.positions).to(device), torch.from_numpy(scene.triangles).to(device)
    uvs = torch.from_numpy(scene.uvs).to(device) if subject.textures and scene.uvs is not None else None
    out = torch.empty(subject.resolution, dtype=torch.int64, device=device)

    def call() -> None:
        seen = rasterize(positions, triangles, subject.resolution, precision=precision, cull=scene.cull, depth=False, out=out)
        if uvs is not None:
            interpolate(uvs, seen, positions, triangles, precision=precision)

    return call


def _supersample(height: int, width: int) -> int:
    """How many samples along each side of a pixel the true picture has.

    Raises:
        ValueError: a picture that is too small to be compared, or too large for more than one sample.
    """
    wanted = "bigtri.suggest_precision: resolution must be"
    if min(height, width) < _SMALLEST_PICTURE:
        raise ValueError(f"{wanted} at least {_SMALLEST_PICTURE} px a side where psnr_db is named, got {(height, width)}")
    found = min(_SUPERSAMPLE, math.isqrt(_PICTURE_SAMPLES // (height * width)), MAX_SIZE // max(height, width))
    if found < 2:
        most = _PICTURE_SAMPLES // 4
        raise ValueError(f"{wanted} at most {most} px, and {MAX_SIZE // 2} a side, where psnr_db is named, got {(height, width)}")
    return found


def _check_type(name: str, value: object, allowed: type) -> None:
    if not isinstance(value, allowed):
        wanted = f"a {allowed.__name__}"
        raise TypeError(f"bigtri.suggest_precision: {name} must be {wanted}, got {arguments.described(value)}")


def _check_times(times: Any, candidates: tuple[str, ...]) -> None:
    """Raise TypeError unless ``times`` maps names to ``Timing``, ValueError unless to positive ones for every candidate."""
    wanted = "bigtri.suggest_precision: times must have a positive Timing for every candidate"
    if not isinstance(times, Mapping):
        raise TypeError(f"{wanted}, got {arguments.described(times)}")
    for name in candidates:
        if name not in times:
            raise ValueError(f"{wanted}, got none for {name!r}")
        if not isinstance(times[name], Timing):
            raise TypeError(f"{wanted}, got {arguments.described(times[name])} for {name!r}")
        if not 0 < times[name].median < math.inf:
            raise ValueError(f"{wanted}, got a median of {times[name].median} for {name!r}")


def _looked_at(pixels: int, everything: int, seed: int) -> str:
    if pixels == everything:
        return "wrong pixels: of all pixels"
    return f"wrong pixels: of {pixels} pixels of {everything}, seed {seed}; 'at most' is of all, with {CONFIDENCE:.0%} confidence"

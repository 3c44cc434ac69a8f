"""What the GPU benchmarks draw, in which ways, and how an image is checked. Shared by cuda_run.py and its neighbours.

Scenes are those of `bigtri.study.scenes`. Real ones (R) and models have positions for 16:9 at every size, so that their
triangles are the same in every picture. A batch is many views of a real scene or a model from a circle around it,
positions [B, V, 4]; or of several in turns ("R4k+R16k"): positions [V, 4], and `ranges` says what each view draws.
"""

from __future__ import annotations

import argparse
import contextlib
import time
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import cuda_clock
import cuda_floor
import torch
from cuda_clock import Call, Job

import bigtri
from bigtri import native
from bigtri.app import arguments as option_types
from bigtri.reference.numerics import MAX_SIZE
from bigtri.study import meshes, scenes

ASPECT = 16 / 9
# By importance: where time runs out, the last ones are missing.
SCENES = (
    "R4k,R16k,Rcourtyard,Rterrain,Rroom,R16k-close,R16k-far,R100k,R100k-shuffled,R1M,R1M-shuffled,S1,S2,S3,S4f,S4b,S5,S6,S7,S8"
)
SIZES = "256x256,640x480,1080p,4k"
BATCH_SCENES = "R4k,R16k,R4k+R16k"
BATCHES = "64x256x256,64x512x512,8x1024x1024,1024x64x64"  # views x height x width
MOST_VIEWS = 65536
CHECKED = 3  # views of a batch that are compared with the CPU's: the first, the last, and one between them


# --- what is drawn


class Maker:
    """Makes what jobs draw; a real scene once, since a million triangles take seconds."""

    def __init__(self, models: Iterable[Path] = ()) -> None:
        self.models: dict[str, meshes.Mesh] = {}
        for path in models:
            model = bigtri.load_scene(path)
            if path.stem in {*scenes.SCENES, *self.models}:
                raise ValueError(f"--model: {path.stem} must be no scene's name and no other model's, got {path}")
            self.models[path.stem] = meshes.Mesh(model.positions.astype("float64"), model.triangles)
        self._made: dict[tuple[str, int], meshes.Batch] = {}

    def names(self) -> list[str]:
        return [*self.models, *scenes.SCENES]

    def parts(self, name: str) -> list[str]:
        """The meshes whose views a batch of that name holds."""
        return [name] if name in self.models else name.split("+")

    def batch_names(self, text: str) -> list[str]:
        """Names separated by commas, each of one mesh or of several joined by "+".

        Raises:
            SystemExit: one of them has no mesh that a circle of cameras could see.
        """
        round_ones = [*self.models, *(name for name, recipe in scenes.REAL.items() if recipe.camera == "whole")]
        names = text.split(",")
        for name in names:
            cuda_clock.listed(",".join(self.parts(name)), "batch scene", round_ones)
        return names

    def mesh(self, name: str, seed: int) -> meshes.Mesh:
        return self.models[name] if name in self.models else meshes.of(scenes.REAL[name], seed)

    def make(self, job: Job) -> meshes.Batch:
        """What a job draws; positions [V, 4] where it is no batch.

        Raises:
            ValueError: the image is too small for the scene.
        """
        if job.views > 1:
            return meshes.batch([self.mesh(name, job.seed) for name in self.parts(job.scene)], job.views, ASPECT)
        if job.scene in scenes.DRAWN:
            return meshes.Batch(*scenes.make(job.scene, job.width, job.height, job.seed), None)
        key = (job.scene, job.seed)
        if key not in self._made:
            mesh = self.mesh(*key)
            camera = scenes.REAL[job.scene].camera if job.scene in scenes.REAL else "whole"
            self._made[key] = meshes.Batch(
                meshes.CAMERAS[camera](mesh, ASPECT).transform(mesh.vertices, ASPECT), mesh.triangles, None
            )
        return self._made[key]


def differing(a: torch.Tensor, b: torch.Tensor) -> int:
    """Pixels that differ; in strips, since the comparison needs memory too."""
    return sum(int((x != y).sum()) for x, y in zip(a.split(4096), b.split(4096), strict=True))


class Target:
    """A job's tensors on a device, and the image or images [B, H, W] that it is drawn into."""

    def __init__(self, given: meshes.Batch, size: tuple[int, int], device: torch.device) -> None:
        self.given, self.size = given, size  # height, width
        self.positions = torch.from_numpy(given.positions).to(device)
        self.triangles = torch.from_numpy(given.triangles).to(device)
        self.ranges = None if given.ranges is None else torch.from_numpy(given.ranges)
        views = given.positions.shape[:-2] if given.ranges is None else given.ranges.shape[:1]
        self.packed = torch.empty((*views, *size), dtype=torch.int64, device=device)
        self.images = self.packed.view(-1, *size)
        last = len(self.images) - 1
        self.checked = sorted({last * part // (CHECKED - 1) for part in range(CHECKED)})

    def from_cpu(self) -> list[torch.Tensor]:
        """The checked views as the CPU draws them, on the device."""
        positions = torch.from_numpy(self.given.positions)
        ranges = None if self.ranges is None else self.ranges[self.checked]
        if ranges is None:
            positions = positions.view(-1, *positions.shape[-2:])[self.checked]
        triangles = torch.from_numpy(self.given.triangles)
        seen = bigtri.rasterize(positions, triangles, self.size, ranges=ranges, backend="native", depth=False)
        return [torch.as_tensor(image).to(self.packed.device) for image in seen.packed]

    def draw(self, variant: str) -> None:
        """The call that is timed: depth and triangle, 8 bytes a pixel, into memory that is there."""
        given = (self.positions, self.triangles, self.size)
        bigtri.rasterize(*given, ranges=self.ranges, depth=False, out=self.packed, variant=variant)

    def draw_plain(self) -> None:
        """The shortest call, results in memory that it finds itself."""
        bigtri.rasterize(self.positions, self.triangles, self.size, ranges=self.ranges)

    def poisoned(self, draw: Call) -> list[torch.Tensor]:
        """The checked views after `draw`, which has nothing of an earlier one's to show."""
        self.packed.fill_(cuda_clock.POISON)
        draw()
        return [self.images[view] for view in self.checked]


class Case(Target):
    """A job, and what its image has to be."""

    def __init__(self, job: Job, given: meshes.Batch, device: torch.device) -> None:
        super().__init__(given, (job.height, job.width), device)
        self.job = job
        self.expected = self.from_cpu()

    def wrong_pixels(self, draw: Call) -> int:
        """Pixels of the image that `draw` makes whose bits are not the CPU's; of a batch in the views that are checked."""
        return sum(map(differing, self.poisoned(draw), self.expected))

    def wrong_triangles(self, draw: Call) -> int:
        """Pixels that show another triangle than the CPU's: a floor has its depth in float32."""
        seen = zip(self.poisoned(draw), self.expected, strict=True)
        return sum(int(((image ^ expected) & 0xFFFFFFFF != 0).sum()) for image, expected in seen)


# --- the ways to draw it

EVERY = 1 << 62  # a limit that no number of triangles exceeds; where a parameter allows less, its highest value


class Way(NamedTuple):
    """A variant and the parameters that it runs with."""

    variant: str
    path: str  # a name for the parameters; empty where the variant chooses
    parameters: Mapping[str, int]
    most: int = EVERY  # triangles beyond which the variant would leave the path

    @property
    def name(self) -> str:
        return f"{self.variant} {self.path}".strip()

    def setting(self) -> contextlib.AbstractContextManager[None]:
        """The parameters in force."""
        return native.using_parameters(**self.parameters) if self.parameters else contextlib.nullcontext()


AUTO = Way("auto", "", {})  # the variant that the extension prefers, with its own choice of everything
# bin_owned's two paths, each for any number of triangles that it can have; and the second one with each way to share the
# triangles among blocks: drawn together, each warp its own, with others' help, or tested first.
PATHS = (
    Way("bin_owned", "few", {"few": EVERY}, 256),
    Way("bin_owned", "rows", {"few": 0}),
    Way("bin_owned", "share 32", {"few": 0, "share": 32}),
    Way("bin_owned", "share 128", {"few": 0, "share": 128}),
    Way("bin_owned", "share 256", {"few": 0, "share": 256}),
    Way("bin_owned", "share 1024", {"few": 0, "share": 1024}),
)
# Beside them what else bin_owned chooses by the scene: the blocks of few triangles, how few triangles are drawn together, and
# which triangles wait. A choice that it may have made itself is here too, so that another one would be compared with it. How
# many neighbours a block gets goes with its triangles and is no parameter: docs/cuda_tried.md compares them.
SETTINGS = (
    *PATHS,
    *(
        Way("bin_owned", f"few, {warps} warps, {region} px", {"few": EVERY, "warps": warps, "region": region}, 16 * warps)
        for warps in (8, 16)
        for region in (4, 8, 16)
    ),
    *(Way("bin_owned", f"share {share}", {"few": 0, "share": share}) for share in (2, 8, 96, 124, 192)),
    *(Way("bin_owned", f"team {team}", {"few": 0, "team": team}) for team in (1, 4)),
    Way("bin_owned", "rows, 64 px", {"few": 0, "widest": 64}),
    Way("bin_owned", "rows, 256 px", {"few": 0, "widest": 256}),
)


def cut(way: Way, variants: Mapping[str, native.Variant]) -> Way:
    """The way with parameters no higher than they may be.

    Raises:
        ValueError: there is no such variant, parameter or value; the text says which.
    """
    if way.variant not in variants:
        raise ValueError(f"{way.name}: variants are {', '.join(variants)}")
    known = variants[way.variant].parameters
    parameters = {}
    for name, wanted in way.parameters.items():
        if name not in known:
            raise ValueError(f"{way.name}: parameters of {way.variant} are {', '.join(known) or 'none'}, got {name}")
        parameters[name] = value = min(wanted, known[name].high)
        if value < known[name].low or (known[name].only and value not in known[name].only):
            raise ValueError(f"{way.name}: {name} must be {known[name].allowed()}, got {value}")
    return way._replace(parameters=parameters)


def ways(settings: Iterable[Way], variants: Mapping[str, native.Variant]) -> list[Way]:
    """The settings that the extension has; the others are named on the screen."""
    found = []
    for way in settings:
        try:
            found.append(cut(way, variants))
        except ValueError as error:
            print(f"left out: {error}")
    return found


def way(text: str) -> Way:
    """An argparse type: "VARIANT" or "VARIANT:NAME=VALUE,NAME=VALUE"."""
    variant, _, rest = text.partition(":")
    parameters = {}
    for part in rest.split(",") if rest else ():
        name, _, value = part.partition("=")
        parameters[name] = option_types.whole(0)(value)
    return Way(variant, rest, parameters)


# --- what commands share


def add_setting(parser: argparse.ArgumentParser, what: str) -> None:
    """Adds the option that names ways."""
    value = "VARIANT[:NAME=VALUE,...]"
    parser.add_argument("--setting", type=way, action="append", default=[], metavar=value, help=what)


def batch(text: str) -> tuple[int, int, int]:
    """An argparse type: (views, height, width) from "64x256x256"."""
    try:
        views, height, width = text.lower().split("x")
        side = option_types.whole(1, MAX_SIZE)
        return option_types.whole(2, MOST_VIEWS)(views), side(height), side(width)
    except (ValueError, argparse.ArgumentTypeError):
        wanted = f"VIEWSxHEIGHTxWIDTH, 2 to {MOST_VIEWS} views of 1 to {MAX_SIZE} px a side, such as 64x256x256"
        raise argparse.ArgumentTypeError(f"must be {wanted}, got {text!r}") from None


def batches(text: str) -> list[tuple[int, int, int]]:
    """An argparse type: batches separated by commas, or "none"."""
    return [] if text == "none" else option_types.listed(batch)(text)


def add_cases(parser: argparse.ArgumentParser) -> None:
    """Adds the options that say what is drawn."""
    group = parser.add_argument_group("what is drawn")
    group.add_argument("--scenes", help=f"or none; default {SCENES}, with --model the models")
    group.add_argument("--size", type=option_types.listed(option_types.size), default=SIZES, help=f"default {SIZES}")
    group.add_argument(
        "--seeds", type=option_types.listed(option_types.seed), default=str(scenes.SEED), help=f"default {scenes.SEED}"
    )
    group.add_argument("--batches", type=batches, default=BATCHES, help=f"views x height x width, or none; default {BATCHES}")
    group.add_argument(
        "--batch-scenes", metavar="NAMES", help=f"A, or A+B for views of both in turns; default {BATCH_SCENES}, or the models"
    )
    group.add_argument(
        "--model", type=Path, nargs="+", default=[], metavar="FILE", help="GLB, OBJ, PLY and so on: a scene of the file's name"
    )


def maker_for(arguments: argparse.Namespace) -> Maker:
    """
    Raises:
        SystemExit: a model cannot be read.
    """
    try:
        return Maker(arguments.model)
    except (OSError, ImportError, ValueError) as error:
        raise SystemExit(str(error)) from None


def jobs(arguments: argparse.Namespace, maker: Maker) -> list[Job]:
    """Real scenes and models, batches, then the other scenes; scenes as they were named, each with all sizes.

    Raises:
        SystemExit: a name that is not known.
    """
    own = ",".join(maker.models)
    text = arguments.scenes or own or SCENES
    names = [] if text == "none" else cuda_clock.listed(text, "scene", maker.names())
    round_ones = maker.batch_names(arguments.batch_scenes or own or BATCH_SCENES) if arguments.batches else []
    found = []
    for seed in arguments.seeds:
        single = [Job(name, width, height, seed) for name in names for width, height in arguments.size]
        found += [job for job in single if job.scene not in scenes.DRAWN]
        found += [Job(name, width, height, seed, views) for name in round_ones for views, height, width in arguments.batches]
        found += [job for job in single if job.scene in scenes.DRAWN]
    return found


def device_for(dry: bool) -> torch.device:
    """The GPU, or the CPU for a dry run.

    Raises:
        SystemExit: the extension or the GPU is missing.
    """
    if not native.available():
        raise SystemExit(f"the extension is not built: {native.load_error()}")
    if dry:
        return torch.device("cpu")
    if "cuda" not in native.devices():
        raise SystemExit("no GPU, or the extension is not built for CUDA; --dry-run does without")
    return torch.device("cuda", torch.cuda.current_device())


def start_floor(device: torch.device) -> cuda_floor.Floor | None:
    """floor.cu, or None (and why, on the screen)."""
    try:
        return cuda_floor.Floor(device)
    except cuda_floor.UnavailableError as error:
        print(f"no memset, empty kernel or floor: {error}")
        return None


def made(todo: list[Job], maker: Maker, end: float) -> Iterator[tuple[Job, meshes.Batch]]:
    """The jobs and what they draw, until ``time.perf_counter()`` is past ``end``; what is left out is said."""
    for number, job in enumerate(todo):
        if time.perf_counter() > end:
            print(f"--total is over: {len(todo) - number} left out, from {job}")
            return
        try:
            given = maker.make(job)
        except ValueError as error:  # the image is too small for it
            print(error)
            continue
        yield job, given

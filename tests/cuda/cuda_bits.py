"""What the tests of the CUDA kernels share: scenes, the CPU's picture of each, and the comparison of pictures in bits."""

from __future__ import annotations

import functools
from collections.abc import Collection, Iterable
from typing import NamedTuple

import numpy as np
import pytest
import torch
from cases import CASES, Case, from_pixels, random_corners, sized, soup

import bigtri
from bigtri import native
from bigtri.check import verify
from bigtri.ops.rasterize import Visibility
from bigtri.precision import DEFAULT
from bigtri.study import scenes

DEVICE = "cuda"
VARIANTS = native.VARIANTS.get("cuda", ())
needs_cuda = pytest.mark.skipif("cuda" not in native.devices(), reason="no CUDA build, or no CUDA device")

EVERY = 65536  # a bound on few triangles that no case has more of
# Launch settings under which a scene takes another way through the kernels.
PATHS: dict[str, dict[str, int]] = {
    "default": {},
    "few": {"few": EVERY},
    "many warps": {"few": EVERY, "warps": 16, "region": 8},
    "high regions": {"few": EVERY, "region": 16},
    "rows": {"few": 0},
    "narrow": {"few": 0, "widest": 20},
    "in teams": {"few": 0, "share": 16, "team": 4},
    "in groups": {"few": 0, "share": 124},
    "even": {"few": 0, "share": 256},
    "even, fewer": {"few": 0, "share": 192},
    "apart": {"few": 0, "share": 128},
    "tested": {"few": 0, "share": 1024, "search": 256},
    "queued": {"few": 0, "rows": 0},
    "queued, tested": {"few": 0, "rows": 0, "share": 1024},
    "in the image": {"few": 0, "patch": 0},
}
# More values of parameters than their registry names: lists and queues of one, sizes that leave work for a second turn.
VALUES: dict[str, tuple[int, ...]] = {
    "entries": (1, 2, 6, 352),
    "blocks": (0, 1, 3, 1000),
    "queue": (1, 2, 700),
    "widest": (0, 1, 64, 256),
    "share": (4, 16, 32, 96, 124, 128, 192, 256, 1024),
    "team": (0, 1, 2, 4, 8),
    "cache": (0, 400_000, 800_000),
    "few": (0, 1, 64, 65536),
    "room": (0, 1, 7),
    "tile": (16, 32, 64),
    "levels": (0, 1, 3, 11),
    "meets": (1, 4096),
}
Scissor = tuple[int, int, int, int]


def that_differ(known: Collection[str], settings: Iterable[dict[str, int]]) -> list[dict[str, int]]:
    """Of settings such as differ for a variant that has the ``known`` parameters, without the others."""
    kept = [{field: value for field, value in s.items() if field in known} for s in settings]
    return [s for n, s in enumerate(kept) if s not in kept[:n]]


def paths_of(variant: str) -> list[str]:
    """Names of ``PATHS`` that differ for a variant."""
    known, first = native.REGISTRY["cuda"][DEFAULT][variant].parameters, {}
    for name, settings in PATHS.items():
        first.setdefault(frozenset(item for item in settings.items() if item[0] in known), name)
    return [*first.values()]


def values_of(parameter: native.Parameter) -> tuple[int, ...]:
    """What the tests set a parameter to: its standard value, and those of `VALUES`, else all that it names, else its
    lowest."""
    chosen = VALUES.get(parameter.name) or parameter.only or (parameter.low,)
    return tuple(dict.fromkeys((parameter.standard, *chosen)))


def mixed(rng: np.random.Generator) -> Case:
    """Small, large, thin, clipped and far triangles, and some that are not finite: something for every kernel."""
    small = random_corners(rng, 5000, 0.8)
    small[:, 1:] = small[:, :1] + rng.normal(0, 0.02, (5000, 2, 4)) * [1, 1, 0, 0]
    needles = random_corners(rng, 150, 1.0)
    needles[:, 2, :2] = needles[:, 1, :2] + rng.normal(0, 0.003, (150, 2))
    far = random_corners(rng, 30, 1.2)
    far[..., 2] = rng.uniform(-1, 6, (30, 3)) * far[..., 3]
    broken = random_corners(rng, 20, 1.0)
    broken[:, 1, 2] = np.nan
    corners = [small, random_corners(rng, 60, 1.2), needles, far, random_corners(rng, 60, 1.5, behind=True), broken]
    return soup(rng.permutation(np.concatenate(corners)), (270, 390))


def full_screens(rng: np.random.Generator) -> Case:
    """More triangles over every pixel than are drawn together, the nearest in the middle of the list."""
    count = 300
    xy = np.tile(np.array([[-9.0, -9.0], [700.0, -9.0], [-9.0, 500.0]]), (count, 1, 1)) + rng.uniform(0, 8, (count, 3, 2))
    z = rng.permutation(np.linspace(0.1, 0.9, count))[:, None] + rng.uniform(-0.02, 0.02, (count, 3))
    return from_pixels(xy, z, (130, 200))


CONSTRUCTIONS = CASES | {
    "mixed": mixed,
    "full_screens": full_screens,
    **{f"size_{width}x{height}": sized((height, width)) for width, height in ((16384, 64), (64, 16384), (128, 67), (67, 130))},
}


class Scene(NamedTuple):
    """A name of ``CONSTRUCTIONS``, or one of ``scenes.SCENES`` and a size; with a seed, all there is to know of a picture."""

    name: str
    seed: int = 0
    size: tuple[int, int] | None = None  # height, width


@functools.lru_cache(maxsize=64)
def case_of(scene: Scene) -> Case:
    if scene.size:
        height, width = scene.size
        return Case(*scenes.make(scene.name, width, height, scenes.SEED + scene.seed), scene.size)
    return CONSTRUCTIONS[scene.name](np.random.default_rng([scene.seed, *scene.name.encode()]))


@functools.lru_cache(maxsize=64)
def uploaded(scene: Scene) -> tuple[torch.Tensor, torch.Tensor, tuple[int, int]]:
    """Arguments of ``rasterize``, on the device."""
    case = case_of(scene)
    return torch.from_numpy(case.positions).to(DEVICE), torch.from_numpy(case.triangles).to(DEVICE), case.resolution


def moved(visibility: Visibility, device: str | torch.device) -> Visibility:
    return Visibility(*(field if field is None else field.to(device) for field in visibility))


def cpu_picture(case: Case, backend: str = "native", **options) -> Visibility:
    """What must come out, on the device: drawn on the CPU."""
    positions, triangles, resolution = case
    seen = bigtri.rasterize(torch.from_numpy(positions), torch.from_numpy(triangles), resolution, backend=backend, **options)
    return moved(seen, DEVICE)


@functools.lru_cache(maxsize=64)
def expected(scene: Scene, cull: str = "none", scissor: Scissor | None = None, backend: str = "native") -> Visibility:
    return cpu_picture(case_of(scene), backend, cull=cull, scissor=scissor)


def as_bits(field: torch.Tensor) -> torch.Tensor:
    return field.contiguous().view(torch.int32) if field.dtype == torch.float32 else field.contiguous()


def assert_same(wanted: Visibility, got: Visibility, what: object = "") -> None:
    """All fields in bits; a failure names the field and the first pixel. Both on one device."""
    for name, a, b in zip(Visibility._fields, wanted, got, strict=True):
        if a is None or b is None:
            assert a is None and b is None, f"{what}: {name} is there on one side only"
            continue
        assert (a.dtype, a.shape, a.device) == (b.dtype, b.shape, b.device), f"{what}: {name}"
        if not torch.equal(as_bits(a), as_bits(b)):
            pytest.fail(f"{what}: {difference(name, a, b)}")


def difference(name: str, wanted: torch.Tensor, got: torch.Tensor) -> str:
    a, b = (np.atleast_1d(v.cpu().numpy()) for v in (wanted, got))
    count = int((~verify.same_bits(a, b)).sum())
    index = verify.first_difference(a, b)
    assert index is not None
    place = ""
    if name != "dropped":
        y, x = index[-2:]
        place = f", bin {(x // 64, y // 64)}, tile {(x % 64 // 8, y % 64 // 8)}, pixel {(x, y)}"
    values = (f"{int(v[index]):#018x}" if name == "packed" else f"{v[index]}" for v in (a, b))
    return f"{name} differs in {count} of {a.size}, first at {index}{place}: expected {next(values)}, got {next(values)}"


def draw(scene: Scene, **options) -> Visibility:
    return bigtri.rasterize(*uploaded(scene), backend="native", **options)


def poison(byte: int, *sizes: int) -> None:
    """Fill memory that the allocator will hand out next, so that what a kernel leaves unwritten is seen."""
    blocks = [torch.full((size,), byte, dtype=torch.uint8, device=DEVICE) for size in (*sizes, 8, 512, 2**20, 2**24, 2**26)]
    del blocks


def operator_arguments(variant: str, name: str = "screen_size") -> tuple:
    """Of ``torch.ops.bigtri.rasterize``."""
    positions, triangles, (height, width) = uploaded(Scene(name))
    outputs = [torch.zeros(shape, dtype=dtype, device=DEVICE) for shape, dtype in (((1, height, width), torch.int64),)]
    outputs += [torch.zeros((1, height, width), device=DEVICE), torch.zeros(1, dtype=torch.int64, device=DEVICE)]
    view = height, width, "none", [0, 0, width, height]
    return (positions[None], triangles, *view, variant, "exact", 1, [], None, None, *outputs, None)

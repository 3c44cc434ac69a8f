"""Every operator on arguments of random shape, type and content: it returns what it documents or raises, and never crashes."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from operators import call

from bigtri import fakes, native
from bigtri.precision import DEFAULT

pytestmark = pytest.mark.skipif(not native.available(), reason="the extension is not built")

SECONDS = 1.2  # per operator
I32, I64, F32, F64 = torch.int32, torch.int64, torch.float32, torch.float64
DTYPES = (I32, I64, F32, F64, torch.float16, torch.bfloat16, torch.bool, torch.uint8, torch.int8, torch.complex64)
FLOATS = np.array([0, -0.0, 1, -1, 0.5, 1e-45, -1e-40, 3.4e38, -3.4e38, 1e20, 513, np.inf, -np.inf, np.nan])
INTEGERS = np.array([0, 1, 2, 3, 63, 64, -1, -5, 2**23 - 1, -(2**23), 2**23, 16384, 2**31 - 1, -(2**31)])
WIDE = np.array([0, 1, -1, 2**31, 2**32, -(2**40), 2**62, 2**63 - 1, -(2**63)])


class Source:
    """Random arguments; sizes are small, now and then 0."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)

    def chance(self, p: float) -> bool:
        return bool(self.rng.random() < p)

    def size(self, most: int = 12) -> int:
        return 0 if self.chance(0.08) else int(self.rng.integers(1, most + 1))

    def pick(self, *choices: Any) -> Any:
        return choices[self.rng.integers(len(choices))]

    def floats(self, *shape: int, spread: float = 1.5) -> torch.Tensor:
        values = self.rng.normal(0, spread, shape)
        odd = self.rng.random(shape) < self.pick(0, 0, 0.1, 0.7)
        with np.errstate(over="ignore"):
            return torch.from_numpy(np.where(odd, self.rng.choice(FLOATS, shape), values).astype(np.float32))

    def integers(self, low: int, high: int, *shape: int, odd: bool = True) -> torch.Tensor:
        """int32, mostly in [low, high)."""
        values = self.rng.integers(low, max(high, low + 1), shape)
        odds = self.rng.random(shape) < (self.pick(0, 0, 0, 0.03, 0.5) if odd else 0)
        return torch.from_numpy(np.where(odds, self.rng.choice(INTEGERS, shape), values).astype(np.int32))

    def wide(self, *shape: int) -> torch.Tensor:
        return torch.from_numpy(
            np.where(self.rng.random(shape) < 0.5, self.rng.integers(0, 99, shape), self.rng.choice(WIDE, shape))
        )

    def xy(self, n: int) -> torch.Tensor:
        reach = self.pick(64 * 256, 300 * 256, 2**23)
        return self.integers(-reach, reach, n, 3, 2)

    def bbox(self, n: int) -> torch.Tensor:
        box = self.integers(0, self.pick(64, 200, 16385), n, 4, odd=self.chance(0.2))
        return (
            box
            if self.chance(0.2)
            else torch.cat([torch.minimum(box[:, :2], box[:, 2:]), torch.maximum(box[:, :2], box[:, 2:])], 1)
        )

    def queue(self, n: int) -> torch.Tensor:
        q = self.size(30)
        return torch.cat([self.integers(0, n, q, 1), self.integers(0, self.pick(2, 256), q, 2)], 1)

    def spans(self, n: int, height: int = 200, width: int = 300) -> torch.Tensor:
        s = self.size(30)
        ends = torch.sort(self.integers(0, width + 1, s, 2), dim=1)[0]
        return torch.cat([self.integers(0, n, s, 1), self.integers(0, height, s, 1), ends], 1)

    def view(self) -> tuple[int, int, str, list[int]]:
        height, width = self.size(64), self.size(64)
        if self.chance(0.1):
            height = self.pick(-1, 16384, 16385, 2**31, 2**63 - 1, -(2**63))
        scissor = [int(v) for v in self.pick(INTEGERS, WIDE, np.array([0, 0, 64, 64]))[: self.pick(4, 4, 4, 3)]]
        return height, width, self.pick("none", "back", "front", "both"), self.pick([0, 0, width, height], scissor)

    def mesh(self, *batch: int) -> tuple[torch.Tensor, torch.Tensor]:
        vertices = self.size(30)
        return self.floats(*batch, vertices, 4, spread=self.pick(1, 100)), self.integers(0, vertices, self.size(20), 3)

    def packed(self, *shape: int) -> torch.Tensor:
        triangle = self.integers(-1, 20, *shape).long() & 0xFFFFFFFF
        return self.pick(triangle, self.wide(*shape), torch.full(shape, 2**63 - 1))

    def spoiled(self, argument: Any) -> Any:
        """Something else in place of an argument."""
        if not isinstance(argument, torch.Tensor):
            return self.pick(None, -1, 2**63 - 1, 0, "", "nearest", [1, 2, 3], 0.5, torch.zeros(2))
        how = self.rng.integers(8)
        if how == 0:
            return argument.to(self.pick(*DTYPES))
        if how == 1:
            return argument.to("meta")
        if how == 2:
            return argument[..., ::2] if argument.dim() else argument[None]
        if how == 3:
            return argument.transpose(0, -1) if argument.dim() > 1 else argument.expand(3, *argument.shape)
        if how == 4:
            return argument[None] if self.chance(0.5) or not argument.dim() else argument[:, None].squeeze(0)
        if how == 5:
            return argument[: self.size(3)] if argument.dim() else None
        if how == 6:
            return torch.zeros([self.size(5) for _ in range(self.size(4))], dtype=self.pick(*DTYPES, argument.dtype))
        return self.pick(None, 3, "x", [], torch.empty(0), torch.tensor(1.0), argument.to_sparse() if argument.numel() else 1)


Output = tuple[tuple[int | None, ...], torch.dtype]  # shape (None: any size) and type
Call = tuple[tuple[Any, ...], list[Output]]  # arguments, outputs


COUNTS = torch.zeros(len(native.COUNTERS), dtype=I64) if native.available() else torch.zeros(0)


def rung(s: Source) -> str:
    return s.pick(DEFAULT, *native.REGISTRY.get("cpu", ()), "")


def served(s: Source) -> tuple[Any, ...]:
    """precision, samples, parameters, ranges, behind: mostly what is served."""
    values = s.pick([], [], [1], [5, 7], [2**40, 1], [0], [-1, 3])
    return rung(s), s.pick(1, 1, 1, 4, 0), values, s.pick(None, None, s.integers(0, 2, 1, 2)), s.pick(None, None, s.wide(1, 2, 2))


def rasterize(s: Source) -> Call:
    batch = s.size(3)
    height, width, cull, scissor = s.view()
    h, w = (v if 0 <= v <= 64 else 8 for v in (height, width))
    buffers = torch.empty(batch, h, w, dtype=I64), s.pick(None, torch.empty(batch, h, w)), torch.empty(batch, dtype=I64)
    return (
        *s.mesh(batch),
        height,
        width,
        cull,
        scissor,
        s.pick(*native.VARIANTS["cpu"], "auto"),
        *served(s),
        *buffers,
        s.pick(None, COUNTS),
    ), []


def map_work(s: Source) -> Call:
    height, width, cull, scissor = s.view()
    h, w = (v if 0 <= v <= 64 else 8 for v in (height, width))
    image, room = (64 * -(-h // 64), 64 * -(-w // 64)), s.size()  # of at most a bin, whose squares have 8, 16, 32 and 64 px
    shapes = (h, w), (), COUNTS.shape, image, (64 + 16 + 4 + 1,), (room,)
    variant, values = s.pick(*native.VARIANTS["cpu"], "auto"), s.pick([], [], [1], [5, 7], [2**40, 1], [0], [-1, 3])
    outputs = (torch.zeros(shape, dtype=I64) for shape in shapes)
    return (*s.mesh(), height, width, cull, scissor, variant, rung(s), values, *outputs), []


def rasterize_new(s: Source) -> Call:
    batch = s.pick((), (s.size(3),))
    height, width, cull, scissor = s.view()
    with_depth = s.chance(0.5)
    image = (*batch, height, width)
    outputs = [(image, I64), *([(image, F32)] if with_depth else []), (batch, I64)]
    return (*s.mesh(*batch), height, width, cull, s.pick(None, scissor), rung(s), with_depth), outputs


def rasterize_into(s: Source) -> Call:
    batch = s.pick((), (s.size(3),))
    height, width, cull, scissor = s.view()
    h, w = (v if 0 <= v <= 64 else 8 for v in (height, width))
    image = (*batch, h, w)
    outputs = torch.empty(image, dtype=I64), s.pick(None, torch.empty(image))
    return (*s.mesh(*batch), height, width, *outputs, cull, s.pick(None, scissor), rung(s)), [(batch, I64)]


def setup(s: Source) -> Call:
    n = None
    shapes = [((n,), I32), ((n, 3, 2), I32), ((n, 3), F32), ((n,), I64), ((n, 4), I32), ((n, 3), F64), ((n, 3), I32)]
    return (*s.mesh(), *s.view(), rung(s)), [*shapes, ((n, 3, 3), F64), ((n,), torch.bool), ((), I64)]


def binning(s: Source) -> Call:
    n = s.size(6)
    threshold = s.pick(0, 64, 4000, -1, 2**63 - 1, -(2**63))
    return (s.xy(n), s.bbox(n), threshold, rung(s)), [((None, 3), I32), ((None,), torch.bool), ((None,), I32)]


def tile_mask(s: Source) -> Call:
    n = s.size()
    queue = s.queue(n)
    return (s.xy(n), s.bbox(n), queue, rung(s)), [((len(queue),), I64)] * 2


def scanline(s: Source) -> Call:
    n = s.size(6)
    queue = s.queue(n)
    return (s.xy(n), s.bbox(n), queue, s.wide(len(queue)), s.integers(0, n, s.size(6)), rung(s)), [((None, 4), I32)]


def depth(s: Source) -> Call:
    n = s.size()
    return (s.xy(n), s.floats(n, 3), s.wide(n), s.spans(n), rung(s)), [((None,), F32)]


def visibility(s: Source) -> Call:
    n, (height, width, *_) = s.size(), s.view()
    spans = s.spans(n, *(min(max(v, 1), 64) for v in (height, width)))
    pixels = int((spans[:, 3].long() - spans[:, 2]).sum())
    z = s.floats(min(max(pixels, 0), 2**20))
    h, w = (v if 0 <= v <= 64 else 8 for v in (height, width))
    return (s.integers(0, n, n), spans, z, torch.empty(h, w, dtype=I64)), []


def attributes_of(s: Source) -> tuple[Any, ...]:
    batch = s.size(3)
    positions, triangles = s.mesh(batch)
    return s.packed(batch, s.size(40), s.size(40)), positions, triangles


def interpolate(s: Source) -> Call:
    packed, positions, triangles = attributes_of(s)
    values = s.floats(s.pick(1, len(positions)), positions.shape[1], s.size(5))
    return (packed, positions, triangles, values, rung(s), torch.empty(*packed.shape, values.shape[2])), []


def barycentrics(s: Source) -> Call:
    arguments = attributes_of(s)
    return (*arguments, rung(s), torch.empty(*arguments[0].shape, 3)), []


def sample_texture(s: Source) -> Call:
    texture, uv = s.floats(s.size(), s.size(), s.size(5)), s.floats(s.size(60), 2, spread=s.pick(1, 1e9))
    texture = s.pick(texture, s.integers(0, 256, *texture.shape).to(s.pick(torch.uint8, torch.uint16)))
    choices = s.pick("nearest", "bilinear", "linear"), s.pick("repeat", "clamp", "")
    return (texture, uv, *choices, torch.empty(len(uv), texture.shape[2])), []


def lambert(s: Source) -> Call:
    n, lights = s.size(60), s.size(4)
    return (s.floats(n, 3), s.floats(n, 3), s.floats(3), s.floats(lights, 3), s.floats(lights, 3), torch.empty(n, 3)), []


def encode_srgb(s: Source) -> Call:
    shape = [s.size(8) for _ in range(s.rng.integers(0, 5))]
    return (s.floats(*shape), s.floats(255), torch.empty(shape, dtype=torch.uint8)), []


def transform(s: Source) -> Call:
    vertices, views = s.size(60), s.size(3)
    return (s.floats(vertices, 3), s.floats(views, 4, 4).double(), torch.empty(views, vertices, 4)), []


def surface_of(s: Source, vertices: int, triangles: int) -> tuple[Any, ...]:
    """uvs to the rung's name."""
    materials, lights, textures = s.size(4), s.size(4), s.size(4)
    texels = [s.floats(s.size(4), s.size(4), s.pick(3, 3, 3, 4)) for _ in range(textures)]
    texels = [s.pick(t, s.integers(0, 256, *t.shape).to(s.pick(torch.uint8, torch.uint16))) for t in texels]
    looks = torch.cat([s.integers(0, 32, materials, 1), s.integers(-1, textures, materials, 1)], 1)
    return (
        *(s.pick(None, s.floats(vertices, n)) for n in (2, 3, 3)),
        s.pick(None, s.floats(triangles, 3)),
        *(s.integers(0, materials, triangles), looks, s.floats(materials, 3), texels),
        *(s.floats(lights, 3), s.floats(lights, 3), s.floats(3, 3), s.pick(True, False), s.floats(255), rung(s)),
    )


def picture_of(s: Source, views: int, height: int, width: int) -> tuple[Any, ...]:
    """image to linear, of so many samples; most of the time they are a whole number a pixel."""
    n = s.pick(1, 1, 2, 3)
    image = torch.empty(views, height // n, width // n, s.pick(3, 3, 4, 2), dtype=torch.uint8)
    return image, *(s.pick(None, torch.empty(views, height, width, 3)) for _ in "anl")


def shade(s: Source) -> Call:
    packed, positions, triangles = attributes_of(s)
    surface = surface_of(s, positions.shape[1], len(triangles))
    return (packed, positions, triangles, *surface, *picture_of(s, *packed.shape)), []


def draw(s: Source) -> Call:
    batch = s.size(3)
    positions, triangles = s.mesh(batch)
    height, width, cull, _ = s.view()
    h, w = (v if 0 <= v <= 64 else 8 for v in (height, width))
    surface = surface_of(s, positions.shape[1], len(triangles))
    values = s.pick([], [], [], [1], [64, 7], [0], [-1, 3])
    seen = s.pick(None, torch.empty(batch, h, w, dtype=I64)), s.pick(None, torch.empty(batch, h, w))
    made = picture_of(s, batch, h, w)
    dropped, fills = torch.empty(batch, dtype=I64), s.chance(0.5)
    return (positions, triangles, height, width, cull, *surface, values, *made, *seen, dropped, fills), []


# Each operator's arguments are made by the function of its name.
MAKERS: list[Callable[[Source], Call]] = [globals()[op] for op in fakes.OPERATORS]


@pytest.mark.parametrize("make", MAKERS, ids=lambda make: make.__name__)
@pytest.mark.filterwarnings("ignore")
def test_returns_or_raises(make: Callable[[Source], Call]):
    stop, returned, raised = time.monotonic() + SECONDS, 0, 0
    for seed in range(1500):
        source = Source(seed)
        arguments, outputs = make(source)
        valid = not source.chance(0.35)
        if not valid:
            k = source.rng.integers(len(arguments))
            arguments = (*arguments[:k], source.spoiled(arguments[k]), *arguments[k + 1 :])
        try:
            result = call(make.__name__, arguments)
        except Exception as error:
            raised += 1
            # Ours, or the dispatcher's for a kind of tensor that has no kernel; never torch's for what was not checked first.
            assert str(error).startswith("bigtri") or isinstance(error, NotImplementedError), (seed, error)
        else:
            returned += 1
            result = () if result is None else result if isinstance(result, tuple) else (result,)
            result = [tensor for tensor in result if tensor is not None]
            if valid:
                assert len(result) == len(outputs), seed
                for tensor, (shape, dtype) in zip(result, outputs, strict=True):
                    assert tensor.dtype == dtype and tensor.is_contiguous(), seed
                    assert tensor.dim() == len(shape), seed
                    assert all(wanted in (None, got) for wanted, got in zip(shape, tensor.shape, strict=True)), seed
        if time.monotonic() > stop and returned and raised:
            break
    assert returned and raised

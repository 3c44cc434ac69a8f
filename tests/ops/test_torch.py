"""The operators as torch sees them: schemas, fake kernels, torch.compile, no gradients, other threads, fork."""

from __future__ import annotations

import concurrent.futures
import itertools
import multiprocessing
import warnings
from pathlib import Path

import numpy as np
import pytest
import torch
from cases import CASES
from operators import call, split
from torch._subclasses import FakeTensorMode

import bigtri
from bigtri import native, warn
from bigtri.choices import CULLS
from bigtri.fakes import OPERATORS
from bigtri.reference.shading import encode_thresholds

pytestmark = pytest.mark.skipif(not native.available(), reason="the extension is not built")


def tensors(name: str = "screen_size") -> tuple[torch.Tensor, torch.Tensor, tuple[int, int]]:
    case = CASES[name](np.random.default_rng(3))
    return torch.from_numpy(case.positions), torch.from_numpy(case.triangles), case.resolution


def map_shapes(height: int, width: int) -> list[tuple[int, ...]]:
    """Of what map_work adds to: counters, fragments, edges and tasks."""
    rows, columns = -(-height // 64), -(-width // 64)
    squares = [-(-64 * rows // (8 << k)) * -(-64 * columns // (8 << k)) for k in range(12)]
    return [(len(native.COUNTERS),), (64 * rows, 64 * columns), (sum(squares[: squares.index(1) + 1]),), (100,)]


def arguments(op: str) -> tuple:
    """Valid arguments of every operator, each stage fed by the one before."""
    positions, triangles, (height, width) = tensors()
    triangle, xy, z, area, bbox, *_ = call("setup", (positions, triangles, height, width, "none", [0, 0, width, height], "exact"))
    candidates, kept, small = call("binning", (xy, bbox, 4000, "exact"))
    queue = candidates[kept]
    touched, _ = call("tile_mask", (xy, bbox, queue, "exact"))
    spans = call("scanline", (xy, bbox, queue, touched, small, "exact"))
    depth = call("depth", (xy, z, area, spans, "exact"))
    packed = torch.empty(1, height, width, dtype=torch.int64)
    call("visibility", (triangle, spans, depth, packed[0]))
    drawing = packed, positions[None], triangles
    count, vertices = len(triangles), len(positions)
    surface = (
        *(torch.rand(vertices, 2), torch.rand(vertices, 3), torch.rand(vertices, 3), torch.rand(count, 3)),
        *(torch.zeros(count, dtype=torch.int32), torch.tensor([[7, 0]], dtype=torch.int32), torch.rand(1, 3)),
        *([torch.rand(4, 5, 3)], torch.rand(2, 3), torch.rand(2, 3), torch.rand(3, 3), True),
        *(torch.from_numpy(np.array(encode_thresholds())), "exact"),
    )
    picture = torch.empty(1, height, width, 3, dtype=torch.uint8), *(torch.empty(*packed.shape, 3) for _ in "anl")
    return {
        "rasterize": (
            *(positions[None], triangles, height, width, "none", [0, 0, width, height], "bin_owned", "exact", 1, [], None, None),
            *(torch.empty_like(packed), torch.empty(packed.shape), torch.empty(1, dtype=torch.int64)),
            torch.zeros(len(native.COUNTERS), dtype=torch.int64),
        ),
        "map_work": (
            *(positions, triangles, height, width, "none", [0, 0, width, height], "persistent", "exact", []),
            *(torch.empty_like(packed[0]), torch.empty((), dtype=torch.int64)),
            *(torch.zeros(shape, dtype=torch.int64) for shape in map_shapes(height, width)),
        ),
        "rasterize_new": (positions[None], triangles, height, width, "none", None, "exact", True),
        "rasterize_into": (
            *(positions[None], triangles, height, width, torch.empty_like(packed), torch.empty(packed.shape)),
            *("none", None, "exact"),
        ),
        "setup": (positions, triangles, height, width, "none", [0, 0, width, height], "exact"),
        "binning": (xy, bbox, 4000, "exact"),
        "tile_mask": (xy, bbox, queue, "exact"),
        "scanline": (xy, bbox, queue, touched, small, "exact"),
        "depth": (xy, z, area, spans, "exact"),
        "visibility": (triangle, spans, depth, torch.empty_like(packed[0])),
        "interpolate": (
            packed,
            positions[None],
            triangles,
            torch.rand(1, len(positions), 5),
            "exact",
            torch.empty(*packed.shape, 5),
        ),
        "barycentrics": (*drawing, "exact", torch.empty(*packed.shape, 3)),
        "sample_texture": (torch.rand(7, 5, 3), torch.rand(20, 2), "bilinear", "repeat", torch.empty(20, 3)),
        "lambert": (*(torch.rand(n, 3) for n in (9, 9)), torch.rand(3), *(torch.rand(2, 3) for _ in "dc"), torch.empty(9, 3)),
        "encode_srgb": (torch.rand(4, 5), torch.from_numpy(np.array(encode_thresholds())), torch.empty(4, 5, dtype=torch.uint8)),
        "shade": (*drawing, *surface, *picture),
        "draw": (
            *(positions[None], triangles, height, width, "none", *surface, [], *picture),
            *(torch.empty_like(packed), torch.empty(packed.shape), torch.empty(1, dtype=torch.int64), True),
        ),
        "transform": (torch.rand(9, 3), torch.rand(2, 4, 4, dtype=torch.float64), torch.empty(2, 9, 4)),
    }[op]


@pytest.mark.parametrize("op", OPERATORS)
def test_opcheck(op):
    utilities = ("test_schema", "test_autograd_registration", "test_faketensor", "test_aot_dispatch_dynamic")
    given, named = split(op, arguments(op))
    torch.library.opcheck(getattr(torch.ops.bigtri, op), given, named, test_utils=utilities)


@pytest.mark.parametrize("dtype", [torch.uint8, torch.uint16])
def test_opcheck_of_textures_of_codes(dtype):
    texture, *others = arguments("sample_texture")
    given, named = split("sample_texture", ((texture * 255).to(dtype), *others))
    utilities = ("test_schema", "test_autograd_registration", "test_faketensor", "test_aot_dispatch_dynamic")
    torch.library.opcheck(torch.ops.bigtri.sample_texture, given, named, test_utils=utilities)
    with pytest.raises(RuntimeError, match=r"texture must be .*, float32, uint8 or uint16 \[Ht, Wt, C\], got Char \[7, 5, 3\]"):
        call("sample_texture", ((texture * 100).to(torch.int8), *others))


def test_the_operator_takes_one_view_or_several():
    batch = arguments("rasterize")
    tensor = torch.Tensor
    one = tuple(a[0] if isinstance(a, tensor) and k in (0, 12, 13, 14) else a for k, a in enumerate(batch))
    assert one[12].ndim == 2 and one[14].ndim == 0
    call("rasterize", batch)
    drawn = [a.clone() for a in batch[12:]]
    for out in batch[12:15]:
        out.fill_(0)
    call("rasterize", one)
    assert all(torch.equal(a, b) for a, b in zip(batch[12:15], drawn, strict=False)) and drawn[0].unique().numel() > 2
    for k, wanted in ((12, r"int64 \[height, width\]"), (13, r"float32 \[height, width\]"), (14, r"int64 \[\]")):
        with pytest.raises(RuntimeError, match=f"bigtri::rasterize: .* must be a contiguous CPU tensor, {wanted}, got"):
            call("rasterize", (*one[:k], batch[k], *one[k + 1 :]))
    with pytest.raises(RuntimeError, match=r"positions must be .*, float32 \[V, 4\] or \[B, V, 4\], got Float \[4\]"):
        call("rasterize", (one[0][0], *one[1:]))


def test_the_operators_with_new_and_given_memory_draw_the_same():
    positions, triangles, _ = tensors()
    for views, scissor, cull in itertools.product(
        (positions, torch.stack([positions, -positions])), (None, [3, 2, 30, 20]), CULLS
    ):
        height, width = 33, 47
        shape = (*views.shape[:-2], height, width)
        outputs = torch.empty(shape, dtype=torch.int64), torch.empty(shape), torch.empty(shape[:-2], dtype=torch.int64)
        box = scissor or [0, 0, width, height]
        call("rasterize", (views, triangles, height, width, cull, box, "bin_owned", "exact", 1, [], None, None, *outputs, None))
        packed, depth, dropped = call("rasterize_new", (views, triangles, height, width, cull, scissor, "exact", True))
        assert all(torch.equal(a, b) for a, b in zip(outputs, (packed, depth, dropped), strict=True))
        packed, depth, dropped = call("rasterize_new", (views, triangles, height, width, cull, scissor, "exact", False))
        assert torch.equal(packed, outputs[0]) and depth is None and torch.equal(dropped, outputs[2])
        for depth in (torch.full(shape, 7.0), None):
            packed = torch.full(shape, 7)
            dropped = call("rasterize_into", (views, triangles, height, width, packed, depth, cull, scissor, "exact"))
            assert torch.equal(packed, outputs[0]) and torch.equal(dropped, outputs[2])
            assert depth is None or torch.equal(depth, outputs[1])
    assert packed.unique().numel() > 2


@pytest.mark.parametrize(
    "place, value, wanted",
    [
        (0, torch.zeros(4), r"positions must be .*, float32 \[V, 4\] or \[B, V, 4\], got Float \[4\]"),
        (0, torch.zeros(3, 3), r"positions must be .*, float32 \[V, 4\], got Float \[3, 3\]"),
        (1, torch.zeros(1, 3), r"triangles must be .*, int32 \[T, 3\], got Float"),
        (2, 0, "height and width must be 1 to 16384, got 0 and 47"),
        (3, 1 << 40, "height and width must be 1 to 16384, got 33 and 1099511627776"),
        (4, "both", "cull must be 'none', 'back' or 'front', got 'both'"),
        (5, [0, 0, 1], "scissor must be 4 integers x0, y0, x1, y1, got 3"),
        (6, "good", "precision must be one of exact, .*, got 'good'"),
    ],
)
def test_the_operator_with_new_memory_checks_its_arguments(place, value, wanted):
    positions, triangles, _ = tensors()
    given = [positions, triangles, 33, 47, "none", None, "exact", True]
    given[place] = value
    with pytest.raises(RuntimeError, match=f"bigtri::rasterize: {wanted}"):
        call("rasterize_new", tuple(given))
    outputs = torch.full((33, 47), 7), torch.full((33, 47), 7.0)
    with pytest.raises(RuntimeError, match=f"bigtri::rasterize: {wanted}"):
        call("rasterize_into", (*given[:4], *outputs, *given[4:7]))
    assert all(bool((output == 7).all()) for output in outputs)


def test_the_operator_with_given_memory_checks_it():
    positions, triangles, _ = tensors()
    packed, depth = torch.full((33, 47), 7), torch.full((33, 47), 7.0)
    for outputs, wanted in (
        ((packed[:-1], depth), r"packed must be .*, int64 \[height, width\], got Long \[32, 47\]"),
        ((packed.int(), None), r"packed must be .*, got Int \[33, 47\]"),
        ((packed, depth.double()), r"depth must be .*, float32 \[height, width\], got Double"),
        ((packed, packed.view(torch.float32)[:, :47]), "depth must be"),
        ((packed, packed.view(-1).view(torch.float32)[: 33 * 47].view(33, 47)), "depth must not share memory with packed"),
    ):
        with pytest.raises(RuntimeError, match=f"bigtri::rasterize: {wanted}"):
            call("rasterize_into", (positions, triangles, 33, 47, *outputs, "none", None, "exact"))
    assert (packed == 7).all() and (depth == 7).all()


def test_the_attribute_operators_take_one_view_or_several():
    packed, positions, triangles, attributes, precision, out = arguments("interpolate")
    weights = torch.empty(*packed.shape, 3)
    call("interpolate", (packed, positions, triangles, attributes, precision, out))
    call("barycentrics", (packed, positions, triangles, precision, weights))
    assert out.unique().numel() > 100 and weights.unique().numel() > 100
    one = packed[0], positions[0], triangles
    seen, seen_weights, shared = torch.empty_like(out[0]), torch.empty_like(weights[0]), torch.empty_like(out)
    call("interpolate", (*one, attributes[0], precision, seen))
    call("barycentrics", (*one, precision, seen_weights))
    call("interpolate", (packed, positions, triangles, attributes[0], precision, shared))
    assert torch.equal(seen, out[0]) and torch.equal(seen_weights, weights[0]) and torch.equal(shared, out)
    for k, wrong, wanted in (
        (0, packed[0, 0], r"packed must be .*, int64 \[H, W\] or \[B, H, W\], got Long \["),
        (1, positions, r"positions must be .*, float32 \[V, 4\], as packed is \[H, W\], got Float \["),
        (3, attributes[0, 0], r"attributes must be .*, float32 \[V, C\] or \[B or 1, V, C\], got Float \[5\]"),
        (3, attributes[0, 1:], r"attributes must be float32 .* with B of packed and V of positions, .*, got Float \["),
        (3, attributes.expand(2, -1, -1).contiguous(), r"attributes must be float32 .* with B of packed and V of positions, "),
        (5, out, r"out must be .*, float32 \[H, W, C\], got Float \[1, "),
    ):
        given = [*one, attributes[0], precision, seen]
        given[k] = wrong
        with pytest.raises(RuntimeError, match=f"bigtri::interpolate: {wanted}"):
            call("interpolate", tuple(given))


def test_texture_and_lambert_operators_take_rows_in_any_shape():
    texture, uv, how, wrap, out = arguments("sample_texture")
    call("sample_texture", (texture, uv, how, wrap, out))
    normals, albedo, *light, lit = arguments("lambert")
    call("lambert", (normals, albedo, *light, lit))
    for part in (lambda rows: rows[0], lambda rows: rows[:8].view(2, 2, 2, -1)):
        some, shaded = torch.zeros_like(part(out)), torch.zeros_like(part(lit))
        call("sample_texture", (texture, part(uv), how, wrap, some))
        call("lambert", (part(normals), part(albedo), *light, shaded))
        assert torch.equal(some, part(out)) and torch.equal(shaded, part(lit))
    for wrong in (uv[:, :1].contiguous(), uv[0, 0]):
        with pytest.raises(RuntimeError, match=r"bigtri::sample_texture: uv must be .*, float32 \[..., 2\], got Float \["):
            call("sample_texture", (texture, wrong, how, wrap, out))
    with pytest.raises(RuntimeError, match=r"bigtri::sample_texture: out must be .*, float32 \[..., C\], got Float \["):
        call("sample_texture", (texture, uv.view(2, -1, 2), how, wrap, out))
    with pytest.raises(RuntimeError, match=r"bigtri::lambert: albedo must be .*, float32 \[..., 3\] of normals' shape, got"):
        call("lambert", (normals, albedo[1:], *light, lit))


def test_compile_full_graph():
    positions, triangles, resolution = tensors()
    texture = torch.rand(8, 8, 3)

    def picture(positions: torch.Tensor, uv: torch.Tensor) -> tuple[torch.Tensor, ...]:
        visible = bigtri.rasterize(positions, triangles, resolution)
        color = bigtri.sample_texture(texture, bigtri.interpolate(uv, visible, positions, triangles))
        return visible.packed, visible.triangle, visible.depth, visible.dropped, bigtri.encode_srgb(color)

    uv = torch.rand(len(positions), 2)
    compiled = torch.compile(picture, fullgraph=True)
    for shift in (0.0, 0.25):
        moved = positions + torch.tensor([shift, 0, 0, 0])
        for expected, got in zip(picture(moved, uv), compiled(moved, uv), strict=True):
            assert torch.equal(expected, got)


def test_compile_with_memory_of_the_caller():
    """``out``, and arguments that are looked at in Python: one graph, and the operator itself finds an output over an input."""
    positions, triangles, (height, width) = tensors()

    def draw(positions: torch.Tensor, out: torch.Tensor) -> torch.Tensor:
        options = {"cull": "back", "scissor": (0, 0, 2**64, height), "depth": False, "validate": False}
        return bigtri.rasterize(positions, triangles, (height, width), out=out, **options).packed

    compiled = torch.compile(draw, fullgraph=True, backend="aot_eager")
    out = torch.empty(height, width, dtype=torch.int64)
    expected = draw(positions, torch.empty_like(out))
    assert torch.equal(compiled(positions, out), expected) and torch.equal(out, expected)
    image = torch.empty(height, width)
    with_depth = torch.compile(
        lambda p, image: bigtri.rasterize(p, triangles, (height, width), depth_out=image).packed, fullgraph=True
    )
    assert torch.equal(with_depth(positions, image), bigtri.rasterize(positions, triangles, (height, width)).packed)
    assert torch.equal(image, bigtri.rasterize(positions, triangles, (height, width)).depth)
    over = out.view(-1).view(torch.float32)[: positions.numel()].view(positions.shape).copy_(positions)
    with pytest.raises((RuntimeError, ValueError), match="bigtri.*must not share memory with positions"):
        torch.compile(draw, fullgraph=True, backend="eager")(over, out)


def test_fake_tensors():
    positions, triangles, (height, width) = tensors()
    with FakeTensorMode() as mode:
        clip, faces = mode.from_tensor(positions), mode.from_tensor(triangles)
        seen = bigtri.rasterize(clip, faces, (height, width), out=torch.empty(height, width, dtype=torch.int64))
        values = bigtri.interpolate(clip, seen, clip, faces)
        codes = bigtri.encode_srgb(values)
        linear = bigtri.decode_srgb(codes)
    assert (values.shape, codes.dtype, linear.dtype) == ((height, width, 4), torch.uint8, torch.float32)
    packed = torch.zeros(height, width, dtype=torch.int64)
    for op, given in ((bigtri.encode_srgb, (positions,)), (bigtri.barycentrics, (packed, positions, triangles))):
        with pytest.raises(ValueError, match="must be a tensor with data, got FakeTensor"):
            op(*map(mode.from_tensor, given), backend="reference")
        with pytest.raises(ValueError, match="must be a tensor with data, got one on meta"):
            op(*(value.to("meta") for value in given), backend="reference")


@pytest.mark.parametrize("op", OPERATORS)
def test_fakes_take_one_device_and_the_right_ranks(op):
    """A call with one tensor on the meta device never reaches the real operator."""
    given = arguments(op)
    places = [k for k, value in enumerate(given) if isinstance(value, torch.Tensor)]
    for k in places:
        spoiled = given[k].to("meta")
        if (op, k) != ("encode_srgb", 0):  # its thresholds stay on the host
            with pytest.raises(RuntimeError, match=f"bigtri::{op}: .* must be on "):
                call(op, (*given[:k], spoiled, *given[k + 1 :]))
        everywhere = [value.to("meta") if isinstance(value, torch.Tensor) else value for value in given]
        if op != "encode_srgb" or k:
            everywhere[k] = spoiled[None]
            with pytest.raises(RuntimeError, match=f"bigtri::{op}: .* must have .*[0-9] dimensions"):
                call(op, tuple(everywhere))


@pytest.mark.filterwarnings("ignore:.* requires grad, but nothing")
def test_no_output_requires_grad():
    positions, triangles, resolution = tensors()
    positions.requires_grad_()
    visible = bigtri.rasterize(positions, triangles, resolution)
    colors = torch.rand(len(positions), 3, requires_grad=True)
    assert not any(t.requires_grad for t in (*visible, bigtri.interpolate(colors, visible, positions, triangles)))


def test_a_tensor_that_requires_grad_is_said_once(monkeypatch):
    monkeypatch.setattr(warn, "_said", set())
    positions, triangles, resolution = tensors()
    learning = positions.clone().requires_grad_()

    def draw(given: torch.Tensor) -> torch.Tensor:
        return bigtri.rasterize(given, triangles, resolution).packed

    with warnings.catch_warnings():
        warnings.simplefilter("error")  # none of these expects a gradient
        draw(positions)
        draw(learning.detach())
        with torch.no_grad():
            draw(learning)
    compiled = torch.compile(draw, fullgraph=True, backend="eager")(learning)
    with pytest.warns(UserWarning) as said:
        assert torch.equal(draw(learning), compiled)
        assert torch.equal(draw(learning), compiled)
        bigtri.encode_srgb(learning)
    assert [Path(one.filename) for one in said] == [Path(__file__)]
    assert str(said[0].message) == (
        "bigtri.rasterize: positions requires grad, but nothing in bigtri is differentiable yet and no gradient reaches "
        "it; pass positions.detach(), or call it under torch.no_grad()"
    )


def test_several_callers_at_once():
    """Callers share the pool: one gets it, the others go on alone, and all get the same bits."""
    positions, triangles, resolution = tensors("layers")
    expected = bigtri.rasterize(positions, triangles, resolution).packed
    with concurrent.futures.ThreadPoolExecutor(4) as pool:
        results = pool.map(lambda _: bigtri.rasterize(positions, triangles, resolution).packed, range(40))
    assert all(torch.equal(expected, r) for r in results)


def _draw_in_child(queue) -> None:
    # NumPy sums: torch's own OpenMP threads do not survive a fork.
    positions, triangles, resolution = tensors("layers")
    queue.put(int(bigtri.rasterize(positions, triangles, resolution).packed.numpy().sum()))


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="no fork on this system")
def test_works_in_a_forked_child():
    positions, triangles, resolution = tensors("layers")
    expected = int(bigtri.rasterize(positions, triangles, resolution).packed.numpy().sum())
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    child = context.Process(target=_draw_in_child, args=(queue,))
    child.start()
    assert queue.get(timeout=60) == expected
    child.join(60)
    assert child.exitcode == 0

"""What reads a visibility buffer, on CUDA against the CPU in bits: interpolation, textures, shading, and all of it together."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from cases import CASES
from cuda_bits import CONSTRUCTIONS, DEVICE, Scene, as_bits, case_of, needs_cuda, poison
from operators import Functional, split
from test_shading import awkward_lambert
from test_texture import SHAPES, awkward_coordinates

import bigtri
from bigtri.ops.texture import FILTERS, WRAPS
from bigtri.reference.shading import encode_thresholds

pytestmark = needs_cuda

BACKGROUND = 2**63 - 1
CLOCKS = 100_000_000  # some 50 ms
OPS = Functional()


def on_device(*tensors: torch.Tensor) -> list[torch.Tensor]:
    return [tensor.to(DEVICE) for tensor in tensors]


def assert_same(op, *arguments, what: object = "") -> None:
    """``op`` gives the same bits for the arguments on the CPU and on the device, where one NaN is as good as another."""
    wanted = op(*arguments)
    poison(0xCD, 4 * wanted.numel())
    got = op(*(a.to(DEVICE) if isinstance(a, torch.Tensor) else a for a in arguments))
    assert got.device.type == DEVICE and (got.dtype, got.shape) == (wanted.dtype, wanted.shape), what
    a, b = wanted, got.cpu()
    if a.is_floating_point():
        assert torch.equal(a.isnan(), b.isnan()), what
        a, b = (as_bits(torch.where(v.isnan(), torch.nan, v)) for v in (a, b))
    different = (a != b).nonzero()
    assert not len(different), f"{what}: {len(different)} of {a.numel()} differ, first at {different[0].tolist()}"


def drawing(name: str, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """packed [1, H, W], positions [1, V, 4], triangles [T, 3] of a construction, on the CPU."""
    case = case_of(Scene(name, seed))
    positions, triangles = torch.from_numpy(case.positions)[None], torch.from_numpy(case.triangles)
    return bigtri.rasterize(positions, triangles, case.resolution).packed, positions, triangles


def views_of_a_clipped_scene(count: int, resolution: tuple[int, int]) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    case = case_of(Scene("behind_camera"))
    views = [case.positions + np.float32([0.1 * k, -0.05 * k, 0, 0]) for k in range(count)]
    positions, triangles = torch.from_numpy(np.stack(views)), torch.from_numpy(case.triangles)
    return bigtri.rasterize(positions, triangles, resolution).packed, positions, triangles


def random_attributes(*shape: int) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(shape).normal(size=shape).astype(np.float32))


# --- Interpolation ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CONSTRUCTIONS)
def test_every_case(name):
    for seed in range(3 if name in CASES and not name.startswith("size") else 1):
        packed, positions, triangles = drawing(name, seed)
        assert_same(OPS.barycentrics, packed, positions, triangles, what=(name, seed))
        attributes = random_attributes(1, positions.shape[1], 3)
        assert_same(OPS.interpolate, packed, positions, triangles, attributes, what=(name, seed))


@pytest.mark.parametrize("channels", [1, 2, 5, 16, 31, 32, 33, 64, 65])
def test_any_number_of_channels(channels):
    for name in ("screen_size", "behind_camera"):
        packed, positions, triangles = drawing(name)
        assert_same(OPS.interpolate, packed, positions, triangles, random_attributes(1, positions.shape[1], channels))


@pytest.mark.parametrize("resolution", [(1, 1), (5, 7), (37, 45), (64, 64)])
def test_batches_with_shared_and_with_own_attributes(resolution):
    packed, positions, triangles = views_of_a_clipped_scene(5, resolution)
    assert_same(OPS.barycentrics, packed, positions, triangles)
    for views in (1, 5):
        attributes = random_attributes(views, positions.shape[1], 4)
        attributes[0, ::5] = torch.nan
        attributes[0, 1::7] = torch.inf
        assert_same(OPS.interpolate, packed, positions, triangles, attributes, what=views)


def test_positions_that_are_not_aligned_to_a_vertex():
    packed, positions, triangles = views_of_a_clipped_scene(2, (50, 60))
    wanted = OPS.barycentrics(packed, positions, triangles)
    memory = torch.empty(positions.numel() + 1, device=DEVICE)
    shifted = memory[1:].view(positions.shape)
    shifted.copy_(positions)
    got = OPS.barycentrics(packed.to(DEVICE), shifted, triangles.to(DEVICE))
    assert torch.equal(as_bits(got.cpu()), as_bits(wanted))


def test_buffers_that_say_anything():
    _, positions, triangles = views_of_a_clipped_scene(3, (41, 50))
    rng, count = np.random.default_rng(0), len(triangles)
    edges = [-1, -(2**63), BACKGROUND, BACKGROUND - 1, 0, 3, count - 1, count, 2**31 - 1, 2**31, 2**32 - 1, 2**32]
    shape = (3, 41, 50)
    # The last one names a triangle at every pixel, also where it is not.
    for values in (rng.choice(edges, shape), rng.integers(-(2**63), BACKGROUND, shape), rng.integers(0, count, shape)):
        packed = torch.from_numpy(values.astype(np.int64))
        assert_same(OPS.barycentrics, packed, positions, triangles)
        assert_same(OPS.interpolate, packed, positions, triangles, random_attributes(3, positions.shape[1], 2))


def test_indices_out_of_range_read_as_background():
    packed, positions, triangles = views_of_a_clipped_scene(2, (90, 110))
    vertices = positions.shape[1]
    broken = triangles.clone()
    broken[::3, 1] = vertices
    broken[1::7, 0] = -1
    broken[2::11, 2] = 2**31 - 1
    broken[3, 0] = -(2**31)
    is_broken = ((broken < 0) | (broken >= vertices)).any(dim=1)
    named = (packed & 0xFFFFFFFF).clamp(max=len(triangles) - 1)
    lost = (packed != BACKGROUND) & is_broken[named]
    assert lost.any() and (~lost & (packed != BACKGROUND)).any()
    device = on_device(packed, positions, broken)
    attributes = random_attributes(1, vertices, 3)
    for got, whole in (
        (OPS.barycentrics(*device), OPS.barycentrics(packed, positions, triangles)),
        (OPS.interpolate(*device, attributes.to(DEVICE)), OPS.interpolate(packed, positions, triangles, attributes)),
    ):
        assert torch.equal(as_bits(got.cpu()), as_bits(torch.where(lost[..., None], 0.0, whole)))
    nothing = torch.zeros(2, 0, 4, device=DEVICE)
    assert not OPS.barycentrics(device[0], nothing, device[2]).any()


def test_empty_inputs():
    for batch, height, width, triangles, channels in [(0, 5, 6, 2, 3), (2, 0, 6, 2, 3), (1, 3, 4, 2, 0), (1, 3, 4, 0, 2)]:
        packed = torch.full((batch, height, width), 7, dtype=torch.int64, device=DEVICE)
        positions = torch.ones(batch, 3, 4, device=DEVICE)
        faces = torch.zeros(triangles, 3, dtype=torch.int32, device=DEVICE)
        result = OPS.interpolate(packed, positions, faces, torch.ones(1, 3, channels, device=DEVICE))
        assert result.shape == (batch, height, width, channels) and not result.any()
        assert not OPS.barycentrics(packed, positions, faces).any()
    for channels in (1, 2, 5):  # no vertex, so no attributes in memory either
        packed, none = torch.full((1, 48, 64), 7, dtype=torch.int64, device=DEVICE), torch.zeros(1, 0, 4, device=DEVICE)
        used = torch.full((1, 48, 64, channels), torch.nan, device=DEVICE)
        del used  # the result gets its memory
        result = OPS.interpolate(packed, none, faces, torch.zeros(1, 0, channels, device=DEVICE))
        assert result.shape == (1, 48, 64, channels) and bool((result == 0).all())
    assert bigtri.sample_texture(torch.ones(2, 2, 3, device=DEVICE), torch.zeros(0, 2, device=DEVICE)).shape == (0, 3)
    none = torch.zeros(0, 3, device=DEVICE)
    assert bigtri.lambert(none, none, torch.ones(3, device=DEVICE), none, none).shape == (0, 3)
    assert bigtri.encode_srgb(none).shape == (0, 3)


# --- Textures and shading --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("wrap", WRAPS)
@pytest.mark.parametrize("how", FILTERS)
def test_textures(how, wrap):
    rng = np.random.default_rng(1)
    for shape in (*SHAPES, (3, 2, 40), (1, 65536, 1), (65536, 1, 1)):
        texture = torch.from_numpy(rng.normal(size=shape).astype(np.float32))
        uv = torch.from_numpy(awkward_coordinates(rng, 3000))
        assert_same(OPS.sample_texture, texture, uv, how, wrap, what=shape)


@pytest.mark.parametrize("lights", range(4))
def test_lambert(lights):
    normals, albedo, ambient, *both = (torch.from_numpy(a) for a in awkward_lambert(np.random.default_rng(2), 4000))
    directions, colors = (a[:lights].contiguous() for a in both)
    normals[:50] = torch.inf
    assert_same(OPS.lambert, normals, albedo, ambient, directions, colors)
    if lights:
        directions[0, 0] = torch.inf
        assert_same(OPS.lambert, normals, albedo, ambient, directions, colors)


def test_srgb():
    thresholds = encode_thresholds()
    beside = [np.nextafter(thresholds, np.float32(to)) for to in (-9, 9)]
    special = np.float32([np.nan, -np.nan, np.inf, -np.inf, -0.0, 0, 1e-45, -1e-45, 1, 2, 3.4e38])
    random = np.random.default_rng(3).normal(0.5, 0.6, 100_003).astype(np.float32)
    linear = torch.from_numpy(np.concatenate([thresholds, *beside, special, random]))
    assert_same(bigtri.encode_srgb, linear)
    assert_same(bigtri.encode_srgb, linear[:7])
    assert_same(bigtri.encode_srgb, torch.tensor(0.5))


# --- torch -----------------------------------------------------------------------------------------------------------------


def picture(positions, triangles, resolution, uvs, normals, texture, lights) -> torch.Tensor:
    """uint8 [..., H, W, 3]: every operation there is."""
    seen = bigtri.rasterize(positions, triangles, resolution)
    attributes = bigtri.interpolate(torch.cat([uvs, normals], dim=-1), seen, positions, triangles)
    weights = bigtri.barycentrics(seen, positions, triangles)
    albedo = bigtri.sample_texture(texture, attributes[..., :2]) * weights.amax(dim=-1, keepdim=True)
    return bigtri.encode_srgb(bigtri.lambert(attributes[..., 2:], albedo, *lights))


def picture_arguments(name: str = "inside_sphere") -> list:
    case = case_of(Scene(name))
    vertices = len(case.positions)
    lights = [torch.tensor((0.1, 0.2, 0.1)), random_attributes(2, 3), random_attributes(3, 2, 3)[0].abs()]
    texture = random_attributes(16, 9, 3).abs()
    positions, triangles = torch.from_numpy(case.positions), torch.from_numpy(case.triangles)
    return [
        positions,
        triangles,
        case.resolution,
        random_attributes(vertices, 2),
        random_attributes(vertices, 3),
        texture,
        lights,
    ]


def moved(arguments: list, device: str | torch.device) -> list:
    return [moved(a, device) if isinstance(a, list) else a.to(device) if isinstance(a, torch.Tensor) else a for a in arguments]


@pytest.mark.parametrize("name", ["inside_sphere", "screen_size", "many_small"])
def test_a_whole_picture(name):
    arguments = picture_arguments(name)
    wanted, got = picture(*arguments), picture(*moved(arguments, DEVICE))
    assert len(wanted.unique()) > 50
    assert torch.equal(got.cpu(), wanted)


def test_a_graph_of_a_whole_picture():
    arguments = moved(picture_arguments(), DEVICE)
    picture(*arguments)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        result = picture(*arguments)
    for shift in (0.0, 0.3, -0.4):
        changed = picture_arguments()
        changed[0][:, 0] += shift
        changed[5] += shift
        for index in (0, 5):
            arguments[index].copy_(changed[index])
        graph.replay()
        assert torch.equal(result.cpu(), picture(*changed))


def test_nothing_waits_for_the_device():
    arguments = moved(picture_arguments(), DEVICE)
    torch.cuda.synchronize()
    stream = torch.cuda.Stream()
    with torch.cuda.stream(stream):
        for _ in range(2):  # the allocator has memory of this stream then
            wanted = picture(*arguments)
        stream.synchronize()
        torch.cuda._sleep(CLOCKS)
        event = torch.cuda.Event()
        event.record()
        got = picture(*arguments)
        assert not event.query(), "the call came back after the device did"
    stream.synchronize()
    assert torch.equal(got, wanted)


@pytest.mark.skipif(torch.cuda.device_count() < 2, reason="one CUDA device")
def test_another_device_than_the_current_one():
    arguments = picture_arguments()
    got = picture(*moved(arguments, "cuda:1"))
    assert torch.cuda.current_device() == 0 and got.device == torch.device("cuda:1")
    assert torch.equal(got.cpu(), picture(*arguments))


def test_the_reference_takes_device_tensors():
    packed, positions, triangles = drawing("size_63x63")
    given = on_device(packed, positions, triangles)
    reference, native = (bigtri.barycentrics(*given, backend=backend) for backend in ("reference", "native"))
    assert reference.device == native.device and torch.equal(as_bits(reference), as_bits(native))


def test_operators_pass_torchs_own_checks():
    packed, positions, triangles = on_device(*drawing("size_63x63"))
    points, three = torch.rand(9, 3, device=DEVICE), torch.rand(3, device=DEVICE)
    attributes = random_attributes(1, positions.shape[1], 5).to(DEVICE)

    def new(*shape: int) -> torch.Tensor:
        return torch.empty(shape, device=DEVICE)

    arguments = {
        "interpolate": (packed, positions, triangles, attributes, "exact", new(*packed.shape, 5)),
        "barycentrics": (packed, positions, triangles, "exact", new(*packed.shape, 3)),
        "sample_texture": (
            torch.rand(7, 5, 3, device=DEVICE),
            torch.rand(20, 2, device=DEVICE),
            "bilinear",
            "repeat",
            new(20, 3),
        ),
        "lambert": (points, points.clone(), three, points[:2].clone(), points[:2].clone(), new(9, 3)),
        "encode_srgb": (points, torch.tensor(encode_thresholds()), torch.empty(9, 3, dtype=torch.uint8, device=DEVICE)),
    }
    for name, values in arguments.items():
        given, named = split(name, values)
        torch.library.opcheck(getattr(torch.ops.bigtri, name).default, given, named)


def test_errors_name_the_argument():
    packed, positions, triangles = drawing("size_64x64")
    with pytest.raises(ValueError, match="bigtri.interpolate: positions must be on visibility's device, cuda:0, got cpu"):
        bigtri.interpolate(positions, packed.to(DEVICE), positions, triangles.to(DEVICE))
    with pytest.raises(RuntimeError, match="barycentrics: positions must be a contiguous tensor on CUDA device 0, .* on the CPU"):
        OPS.barycentrics(packed.to(DEVICE), positions, triangles.to(DEVICE))
    with pytest.raises(RuntimeError, match="barycentrics: packed must be a contiguous tensor on CUDA device 0, .* on the CPU"):
        OPS.barycentrics(packed, positions.to(DEVICE), triangles.to(DEVICE))
    with pytest.raises(RuntimeError, match="encode_srgb: thresholds must be a contiguous CPU tensor"):
        OPS.encode_srgb(torch.rand(5, device=DEVICE), torch.rand(255, device=DEVICE))

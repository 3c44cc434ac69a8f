"""What reads a visibility buffer, on CUDA against the CPU in bits: interpolation, textures, shading, and all of it together."""

from __future__ import annotations

import pytest
import torch
from attribute_cases import (
    CHANNELS,
    OPS,
    RESOLUTIONS,
    drawing,
    of_a_case,
    of_any_buffer,
    of_batches,
    of_channels,
    of_every_code,
    of_indices_out_of_range,
    of_lights,
    of_numbers,
    of_textures,
    random_attributes,
    views_of_a_clipped_scene,
)
from cases import CASES
from cuda_bits import CONSTRUCTIONS, DEVICE, Scene, as_bits, case_of, needs_cuda, poison
from operators import split

import bigtri
from bigtri.ops.texture import FILTERS, WRAPS
from bigtri.precision import DEFAULT
from bigtri.reference.shading import encode_thresholds

pytestmark = needs_cuda

CLOCKS = 100_000_000  # some 50 ms


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


# --- Interpolation ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CONSTRUCTIONS)
def test_every_case(name):
    for seed in range(3 if name in CASES and not name.startswith("size") else 1):
        for call in of_a_case(name, seed):
            assert_same(*call, what=(name, seed))


@pytest.mark.parametrize("channels", CHANNELS)
def test_any_number_of_channels(channels):
    for call in of_channels(channels, drawing("screen_size"), drawing("behind_camera")):
        assert_same(*call)


@pytest.mark.parametrize("resolution", RESOLUTIONS)
def test_batches_with_shared_and_with_own_attributes(resolution):
    for call in of_batches(resolution):
        assert_same(*call)


def test_positions_that_are_not_aligned_to_a_vertex():
    packed, positions, triangles = views_of_a_clipped_scene(2, (50, 60))
    wanted = OPS.barycentrics(packed, positions, triangles)
    memory = torch.empty(positions.numel() + 1, device=DEVICE)
    shifted = memory[1:].view(positions.shape)
    shifted.copy_(positions)
    got = OPS.barycentrics(packed.to(DEVICE), shifted, triangles.to(DEVICE))
    assert torch.equal(as_bits(got.cpu()), as_bits(wanted))


def test_buffers_that_say_anything():
    for call in of_any_buffer():
        assert_same(*call)


def test_indices_out_of_range_read_as_background():
    for (op, *arguments), wanted in of_indices_out_of_range():
        assert torch.equal(as_bits(op(*on_device(*arguments)).cpu()), as_bits(wanted))


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
    for call in of_textures(how, wrap, 3000):
        assert_same(*call, what=call[1].shape)


def test_every_code_of_a_texture():
    for call in of_every_code():
        assert_same(*call)


@pytest.mark.parametrize("lights", range(4))
def test_lambert(lights):
    for call in of_lights(lights, 4000):
        assert_same(*call)


def test_srgb():
    for call in of_numbers(100_003):
        assert_same(*call)


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
    images = (DEFAULT, torch.empty(*packed.shape, attributes.shape[2], device=DEVICE))
    arguments = {
        "interpolate": (packed, positions, triangles, attributes, *images),
        "barycentrics": (packed, positions, triangles, DEFAULT, torch.empty(*packed.shape, 3, device=DEVICE)),
        "sample_texture": (
            torch.rand(7, 5, 3, device=DEVICE),
            torch.rand(20, 2, device=DEVICE),
            "bilinear",
            "repeat",
            torch.empty(20, 3, device=DEVICE),
        ),
        "lambert": (points, points.clone(), three, points[:2].clone(), points[:2].clone(), torch.empty_like(points)),
        "encode_srgb": (points, torch.tensor(encode_thresholds()), torch.empty_like(points, dtype=torch.uint8)),
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

"""Arguments of the operators that read a visibility buffer, for the tests that compare CUDA with the CPU: on the CPU, each with
its operator."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
from cuda_bits import Scene, case_of
from test_shading import awkward_lambert
from test_texture import SHAPES, awkward_coordinates, codes, every_code

import bigtri
from bigtri.precision import DEFAULT
from bigtri.reference.shading import encode_thresholds

BACKGROUND = 2**63 - 1
CHANNELS = (1, 2, 5, 16, 31, 32, 33, 64, 65)
RESOLUTIONS = ((1, 1), (5, 7), (37, 45), (64, 64))
Call = tuple  # an operator, then its arguments


class OPS:
    """Those of torch.ops.bigtri, which write into an output that is given, as functions that return it."""

    @staticmethod
    def interpolate(
        packed: torch.Tensor, positions: torch.Tensor, triangles: torch.Tensor, attributes: torch.Tensor
    ) -> torch.Tensor:
        out = positions.new_empty(*packed.shape, attributes.shape[2])
        torch.ops.bigtri.interpolate(packed, positions, triangles, attributes, precision=DEFAULT, out=out)
        return out

    @staticmethod
    def barycentrics(packed: torch.Tensor, positions: torch.Tensor, triangles: torch.Tensor) -> torch.Tensor:
        out = positions.new_empty(*packed.shape, 3)
        torch.ops.bigtri.barycentrics(packed, positions, triangles, precision=DEFAULT, out=out)
        return out

    @staticmethod
    def sample_texture(texture: torch.Tensor, uv: torch.Tensor, how: str, wrap: str) -> torch.Tensor:
        out = uv.new_empty(len(uv), texture.shape[2])
        torch.ops.bigtri.sample_texture(texture, uv, filter=how, wrap=wrap, out=out)
        return out

    @staticmethod
    def lambert(normals: torch.Tensor, *others: torch.Tensor) -> torch.Tensor:
        out = torch.empty_like(normals)
        torch.ops.bigtri.lambert(normals, *others, out=out)
        return out

    @staticmethod
    def encode_srgb(linear: torch.Tensor, thresholds: torch.Tensor) -> torch.Tensor:
        out = torch.empty_like(linear, dtype=torch.uint8)
        torch.ops.bigtri.encode_srgb(linear, thresholds, out=out)
        return out


def drawing(name: str, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """packed [1, H, W], positions [1, V, 4], triangles [T, 3] of a construction."""
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


def of_a_case(name: str, seed: int = 0) -> Iterator[Call]:
    packed, positions, triangles = drawing(name, seed)
    yield OPS.barycentrics, packed, positions, triangles
    yield OPS.interpolate, packed, positions, triangles, random_attributes(1, positions.shape[1], 3)


def of_channels(count: int, *drawings: tuple[torch.Tensor, torch.Tensor, torch.Tensor]) -> Iterator[Call]:
    for packed, positions, triangles in drawings:
        yield OPS.interpolate, packed, positions, triangles, random_attributes(1, positions.shape[1], count)


def of_batches(resolution: tuple[int, int]) -> Iterator[Call]:
    """Attributes that all views share and such that each has of its own, some of them not finite."""
    packed, positions, triangles = views_of_a_clipped_scene(5, resolution)
    yield OPS.barycentrics, packed, positions, triangles
    for views in (1, 5):
        attributes = random_attributes(views, positions.shape[1], 4)
        attributes[0, ::5] = torch.nan
        attributes[0, 1::7] = torch.inf
        yield OPS.interpolate, packed, positions, triangles, attributes


def of_any_buffer() -> Iterator[Call]:
    """Buffers that say anything."""
    _, positions, triangles = views_of_a_clipped_scene(3, (41, 50))
    rng, count = np.random.default_rng(0), len(triangles)
    edges = [-1, -(2**63), BACKGROUND, BACKGROUND - 1, 0, 3, count - 1, count, 2**31 - 1, 2**31, 2**32 - 1, 2**32]
    shape = (3, 41, 50)
    # The last one names a triangle at every pixel, also where it is not.
    for values in (rng.choice(edges, shape), rng.integers(-(2**63), BACKGROUND, shape), rng.integers(0, count, shape)):
        packed = torch.from_numpy(values.astype(np.int64))
        yield OPS.barycentrics, packed, positions, triangles
        yield OPS.interpolate, packed, positions, triangles, random_attributes(3, positions.shape[1], 2)


def of_indices_out_of_range() -> Iterator[tuple[Call, torch.Tensor]]:
    """Each with what it has to give: the CPU would refuse it."""
    packed, positions, triangles = views_of_a_clipped_scene(2, (90, 110))
    vertices = positions.shape[1]
    broken = triangles.clone()
    broken[::3, 1] = vertices
    broken[1::7, 0] = -1
    broken[2::11, 2] = 2**31 - 1
    broken[3, 0] = -(2**31)
    is_broken = ((broken < 0) | (broken >= vertices)).any(dim=1)
    named = (packed & 0xFFFFFFFF).clamp(max=len(triangles) - 1)
    lost = ((packed != BACKGROUND) & is_broken[named])[..., None]
    assert lost.any() and (~lost[..., 0] & (packed != BACKGROUND)).any()
    attributes = random_attributes(1, vertices, 3)
    for op, given in ((OPS.barycentrics, ()), (OPS.interpolate, (attributes,))):
        yield (op, packed, positions, broken, *given), torch.where(lost, 0.0, op(packed, positions, triangles, *given))
    nothing = torch.zeros(2, 0, 4)
    yield (OPS.barycentrics, packed, nothing, broken), torch.zeros(*packed.shape, 3)
    yield (OPS.interpolate, packed, nothing, broken, torch.zeros(1, 0, 5)), torch.zeros(*packed.shape, 5)


def of_textures(how: str, wrap: str, count: int) -> Iterator[Call]:
    """count: coordinates for each texture, and as many special ones."""
    rng = np.random.default_rng(1)
    for shape in (*SHAPES, (3, 2, 40), (1, 65536, 1), (65536, 1, 1)):
        uv = torch.from_numpy(awkward_coordinates(rng, count))
        yield OPS.sample_texture, torch.from_numpy(rng.normal(size=shape).astype(np.float32)), uv, how, wrap
        for dtype in (np.uint8, np.uint16):
            yield OPS.sample_texture, torch.from_numpy(codes(rng, dtype, *shape)), uv, how, wrap


def of_every_code() -> Iterator[Call]:
    for dtype in (np.uint8, np.uint16):
        texture, uv = every_code(dtype)
        yield OPS.sample_texture, torch.from_numpy(texture), torch.from_numpy(uv).view(-1, 2), "nearest", "repeat"


def of_lights(lights: int, count: int) -> Iterator[Call]:
    """count: points, and as many special ones."""
    normals, albedo, ambient, *both = (torch.from_numpy(a) for a in awkward_lambert(np.random.default_rng(2), count))
    directions, colors = (a[:lights].contiguous() for a in both)
    normals[:50] = torch.inf
    yield OPS.lambert, normals, albedo, ambient, directions, colors
    if lights:
        directions = directions.clone()
        directions[0, 0] = torch.inf
        yield OPS.lambert, normals, albedo, ambient, directions, colors


def of_numbers(count: int) -> Iterator[Call]:
    """count: of random ones, beside those at and next to every threshold."""
    thresholds = encode_thresholds()
    beside = [np.nextafter(thresholds, np.float32(to)) for to in (-9, 9)]
    special = np.float32([np.nan, -np.nan, np.inf, -np.inf, -0.0, 0, 1e-45, -1e-45, 1, 2, 3.4e38])
    random = np.random.default_rng(3).normal(0.5, 0.6, count).astype(np.float32)
    linear = torch.from_numpy(np.concatenate([thresholds, *beside, special, random]))
    yield bigtri.encode_srgb, linear
    yield bigtri.encode_srgb, linear[:7]
    yield bigtri.encode_srgb, torch.tensor(0.5)

"""Barycentrics and interpolation: against exact rational arithmetic, against the geometry, and backend against backend."""

from fractions import Fraction

import numpy as np
import pytest
import torch
from backends import BACKENDS, needs_native

import bigtri
from bigtri import barycentrics, interpolate, rasterize

SIZE = (48, 56)


def soup(seed: int, count: int, near: float) -> tuple[np.ndarray, np.ndarray]:
    """Random triangles; with ``near`` < 0 many reach behind the camera and are clipped."""
    rng = np.random.default_rng(seed)
    positions = rng.normal(0, 1.2, (3 * count, 4)).astype(np.float32)
    positions[:, 3] = rng.uniform(near, 3, 3 * count)
    positions[:, 2] = positions[:, 3] * rng.uniform(-0.9, 0.9, 3 * count).astype(np.float32)
    return positions, np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


def exact_weights(corners: np.ndarray, x: int, y: int, height: int, width: int) -> list[Fraction]:
    """Perspective-correct weights of three unclipped corners at a pixel centre, without any rounding after snapping."""
    snapped = []
    for cx, cy, _, cw in corners.astype(np.float64).tolist():
        snapped.append((128 * width + round(cx / cw * (128 * width)), 128 * height - round(cy / cw * (128 * height))))
    sx, sy = 256 * x + 128, 256 * y + 128
    parts = []
    for k in range(3):
        (px, py), (qx, qy) = snapped[(k + 1) % 3], snapped[(k + 2) % 3]
        parts.append(((qx - px) * (sy - py) - (qy - py) * (sx - px)) / Fraction(float(corners[k, 3])))
    return [part / sum(parts) for part in parts]


@pytest.mark.parametrize("backend", BACKENDS)
def test_weights_are_the_exact_ones_rounded(backend):
    positions, triangles = soup(0, 12, 0.4)
    seen = rasterize(positions, triangles, SIZE, backend=backend)
    weights = barycentrics(seen, positions, triangles, backend=backend)
    covered = np.argwhere(seen.triangle >= 0)
    assert len(covered) > 500
    for y, x in covered[::7].tolist():
        expected = exact_weights(positions[triangles[seen.triangle[y, x]]], x, y, *SIZE)
        for value, exact in zip(weights[y, x], expected, strict=True):
            # Half a float32 ulp, and what a handful of float64 roundings before it can add.
            bound = Fraction(float(np.spacing(value))) / 2 + Fraction(1, 2**45)
            assert abs(Fraction(float(value)) - exact) <= bound


@pytest.mark.parametrize("backend", BACKENDS)
def test_equal_w_is_affine_by_hand(backend):
    # The lower left half of a 4 x 4 px square; w = 2 at all corners.
    positions = np.array([(-2, -2, 0, 2), (2, -2, 0, 2), (-2, 2, 0, 2)], np.float32)
    triangles = np.array([(0, 1, 2)], np.int32)
    seen = rasterize(positions, triangles, (4, 4), backend=backend)
    weights = barycentrics(seen, positions, triangles, backend=backend)
    assert weights[3, 0].tolist() == [0.75, 0.125, 0.125]
    assert weights[1, 0].tolist() == [0.25, 0.125, 0.625]
    assert weights[3, 2].tolist() == [0.25, 0.625, 0.125]
    assert not weights[0, 3].any()
    value = interpolate(np.array([(8, 1), (16, 1), (24, 1)], np.float32), seen, positions, triangles, backend=backend)
    assert value[3, 0].tolist() == [0.75 * 8 + 0.125 * 16 + 0.125 * 24, 1]
    assert not value[0, 3].any()


@pytest.mark.parametrize("backend", BACKENDS)
def test_clipped_triangles_interpolate_their_own_position(backend):
    """The visible part of a floor that runs behind the camera: its interpolated x/w and y/w are the pixel's."""
    positions = np.array([(-30, -1, 40, 41), (30, -1, 40, 41), (0.5, -1, -26, -25)], np.float32)
    triangles = np.array([(2, 0, 1)], np.int32)
    height, width = 64, 96
    seen = rasterize(positions, triangles, (height, width), backend=backend)
    weights = barycentrics(seen, positions, triangles, backend=backend)
    covered = seen.triangle >= 0
    assert covered[40:].mean() > 0.9
    assert (weights[covered] >= 0).all() and (weights[covered] <= 1).all()
    # Three weights, each rounded to float32, and their sum.
    np.testing.assert_allclose(weights[covered].sum(axis=1), 1, rtol=0, atol=2e-7)
    clip = interpolate(positions, seen, positions, triangles, backend=backend).astype(np.float64)
    y, x = np.nonzero(covered)
    # 1/256 px of snapping, seen at a grazing angle and with vertices far off the screen.
    np.testing.assert_allclose(clip[covered, 0] / clip[covered, 3], (x + 0.5) / (width / 2) - 1, rtol=0, atol=2 / 256 / width)
    np.testing.assert_allclose(clip[covered, 1] / clip[covered, 3], 1 - (y + 0.5) / (height / 2), rtol=0, atol=2 / 256 / height)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("near", [0.4, -1.5])
def test_the_order_of_a_triangles_vertices_changes_no_bit(backend, near):
    # A clipped triangle's slots are turned to a fixed start, not sorted: of those only rotations are promised.
    orders = [[1, 2, 0], [2, 0, 1]] if near < 0 else [[1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0]]
    positions, triangles = soup(3, 10, near)
    attributes = np.random.default_rng(4).normal(size=(len(positions), 5)).astype(np.float32)
    seen = rasterize(positions, triangles, SIZE, backend=backend)
    expected = interpolate(attributes, seen, positions, triangles, backend=backend)
    for order in orders:
        reordered = np.ascontiguousarray(triangles[:, order])
        again = rasterize(positions, reordered, SIZE, backend=backend)
        assert np.array_equal(again.packed, seen.packed)
        assert interpolate(attributes, again, positions, reordered, backend=backend).tobytes() == expected.tobytes()
        weights = barycentrics(again, positions, reordered, backend=backend)
        assert weights.tobytes() == barycentrics(seen, positions, triangles, backend=backend)[..., order].tobytes()


@needs_native
@pytest.mark.parametrize("seed", range(6))
def test_backends_agree_in_bits(seed):
    views = [soup(10 * seed + b, 40, [-2.0, 0.1, 1.0][seed % 3]) for b in range(2)]
    positions, triangles = np.stack([v[0] for v in views]), views[0][1]
    attributes = np.random.default_rng(seed).normal(size=(2, positions.shape[1], 1 + seed)).astype(np.float32)
    seen = rasterize(positions, triangles, SIZE, backend="native")
    for function, first in ((interpolate, (attributes,)), (interpolate, (attributes[0],)), (barycentrics, ())):
        results = [function(*first, seen, positions, triangles, backend=backend) for backend in ("reference", "native")]
        assert results[0].dtype == results[1].dtype == np.float32 and results[0].shape == results[1].shape
        assert results[0].tobytes() == results[1].tobytes()


# Corners in subpx, w, and a pixel of 256x256 where float32 shows the last bit of float64: another order of the sum of weights, or
# a division by equal w and by their sum, gives another float32 there. Found by a search; one in some 10^9 does.
ONE_ROUNDING = [
    (((41297, 64529), (41903, 2053), (47242, 28035)), (10.125, 4.375, 2.375), (162, 142)),
    (((18865, 10627), (61615, 2526), (30713, 19249)), (7.25, 5.25, 5.75), (132, 46)),
    (((2049, 36550), (35865, 107), (56231, 4032)), (4.25, 5.625, 8.875), (168, 11)),
    (((10062, 11965), (43247, 20038), (10171, 17824)), (6.875, 5.375, 8.875), (77, 64)),
    (((11802, 56377), (23072, 15355), (58860, 5554)), (6.25, 6.5, 8.75), (195, 40)),
    (((16691, 9434), (44121, 6162), (36960, 24582)), (3.75, 7.125, 11), (126, 40)),
    (((119, 17356), (39287, 32527), (9040, 41823)), (2.125, 2.125, 2.125), (53, 134)),
    (((6789, 11663), (28348, 30226), (10667, 42800)), (12.25, 12.25, 12.25), (50, 158)),
    (((15275, 42921), (29734, 33431), (42327, 46798)), (5, 5, 5), (149, 178)),
    (((5571, 53078), (23848, 29940), (47755, 35479)), (5, 5, 5), (38, 195)),
]


@needs_native
@pytest.mark.parametrize(("corners", "w", "pixel"), ONE_ROUNDING)
def test_backends_agree_where_one_rounding_shows(corners, w, pixel):
    ndc = (np.array(corners) / 32768 - 1) * [1, -1]
    positions = np.concatenate([ndc, np.zeros((3, 1)), np.ones((3, 1))], axis=1) * np.array(w)[:, None]
    positions, triangles = positions.astype(np.float32), np.arange(3, dtype=np.int32)[None]
    seen = rasterize(positions, triangles, (256, 256))
    assert seen.triangle[pixel[1], pixel[0]] == 0
    expected, got = (barycentrics(seen, positions, triangles, backend=backend) for backend in ("reference", "native"))
    assert expected.tobytes() == got.tobytes()


def test_torch_in_torch_out_and_batches_are_single_views():
    positions, triangles = soup(5, 10, -0.5)
    other = np.ascontiguousarray(positions[::-1])
    clip, faces = torch.from_numpy(np.stack([positions, other])), torch.from_numpy(triangles)
    attributes = torch.randn(len(positions), 4, requires_grad=True)
    seen = rasterize(clip, faces, SIZE)
    result = interpolate(attributes, seen, clip, faces)
    assert result.shape == (2, *SIZE, 4) and not result.requires_grad
    for b in range(2):
        single = interpolate(attributes, rasterize(clip[b], faces, SIZE), clip[b], faces)
        assert torch.equal(single, result[b])
    assert torch.equal(interpolate(attributes, seen.packed, clip, faces), result)


@pytest.mark.parametrize("backend", BACKENDS)
def test_views_that_share_positions(backend):
    """Those of a batch of ranges: as if each view had a copy."""
    positions, triangles = soup(6, 30, -0.5)
    ranges = np.array([[0, 12], [7, 23], [5, 0]], np.int32)
    attributes = np.random.default_rng(6).random((len(positions), 4), np.float32)
    seen = rasterize(positions, triangles, SIZE, ranges=ranges)
    copies = np.stack([positions] * len(ranges))
    shared = interpolate(attributes, seen, positions, triangles, backend=backend)
    assert shared.tobytes() == interpolate(attributes, seen, copies, triangles, backend="reference").tobytes() and shared.any()
    weights = barycentrics(seen, positions, triangles, backend=backend)
    assert weights.tobytes() == barycentrics(seen, copies, triangles, backend="reference").tobytes()


@pytest.mark.parametrize("backend", BACKENDS)
def test_buffers_of_other_triangles_and_indices_of_other_vertices(backend):
    positions, triangles = soup(1, 2, 1.0)
    for stranger in (7, 0xFFFFFFFF, -5):
        packed = np.full((4, 4), (1 << 40) | stranger, np.int64)
        assert not barycentrics(packed, positions, triangles, backend=backend).any()
        assert not interpolate(positions, packed, positions, triangles, backend=backend).any()
    for index in (-1, 6):
        with pytest.raises(RuntimeError, match=f"triangles must index positions, 0 to 5, got .*{index}"):
            barycentrics(packed, positions, np.array([(0, 1, index)], np.int32), backend=backend)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("ndim", [0, 1, 9, 12])
def test_any_number_of_dimensions(ndim, backend):
    """Of what is documented as [...]; [] stays []."""
    shape = (1,) * ndim
    codes = bigtri.encode_srgb(torch.full(shape, 0.5), backend=backend)
    assert codes.shape == shape and codes.item() == 188
    assert bigtri.decode_srgb(codes, backend=backend).shape == shape
    assert bigtri.encode_srgb(np.full(shape, 0.5, np.float32), backend=backend).shape == shape
    normals, light = torch.ones(*shape, 3), torch.eye(3)
    assert bigtri.lambert(normals, normals, light[0], light, light, backend=backend).shape == (*shape, 3)
    assert bigtri.sample_texture(torch.ones(2, 2, 4), torch.ones(*shape, 2), backend=backend).shape == (*shape, 4)
    for wrong in (torch.tensor(1.0), torch.ones(*shape, 5)):
        with pytest.raises(ValueError, match=r"bigtri\.lambert: normals must have size 3 in dimension -1"):
            bigtri.lambert(wrong, normals, light[0], light, light, backend=backend)


@pytest.mark.parametrize("backend", BACKENDS)
def test_textures_beyond_the_limit(backend):
    for shape in ((1, 65537, 1), (65537, 1, 1)):
        with pytest.raises(ValueError, match=r"bigtri\.sample_texture: texture must be at most 65536 px a side, got"):
            bigtri.sample_texture(np.zeros(shape, np.float32), np.zeros((1, 2), np.float32), backend=backend)
    with pytest.raises(TypeError, match=r"bigtri\.sample_texture: filter must be one of 'bilinear', 'nearest', got"):
        bigtri.sample_texture(np.zeros((1, 1, 1), np.float32), np.zeros((1, 2), np.float32), filter=np.array(["nearest", ""]))


def test_empty_inputs():
    none = np.zeros((0, 4), np.float32), np.zeros((0, 3), np.int32)
    for backend in ("reference", "auto"):
        seen = rasterize(*none, (3, 5), backend=backend)
        assert interpolate(np.zeros((0, 2), np.float32), seen, *none, backend=backend).shape == (3, 5, 2)
        assert barycentrics(seen, *none, backend=backend).shape == (3, 5, 3)


@pytest.mark.parametrize(
    ("change", "error", "text"),
    [
        ({"attributes": np.zeros((6, 2))}, TypeError, r"attributes must be float32 .*got float64 \[6, 2\]"),
        ({"attributes": np.zeros(6, np.float32)}, ValueError, "attributes must be"),
        ({"attributes": np.zeros((5, 2), np.float32)}, ValueError, "attributes must have size 6"),
        ({"positions": np.zeros((6, 3), np.float32)}, ValueError, "positions must have size 4"),
        ({"positions": [[1.0]]}, TypeError, "positions must be .*got list"),
        ({"triangles": np.zeros((2, 3), np.int64)}, TypeError, "triangles must be int32"),
        ({"visibility": np.zeros((4, 4), np.int32)}, TypeError, "visibility must be int64"),
        ({"backend": "cuda"}, ValueError, "backend must be one of"),
        ({"visibility": np.full((1, 16385), -1)}, ValueError, r"visibility must be at most 16384 px a side, got \[1, 16385\]"),
        ({"visibility": np.full((16385, 1), -1)}, ValueError, "visibility must be at most 16384 px a side"),
        ({"attributes": torch.zeros(6, 2, device="meta")}, ValueError, "attributes must be on visibility's device"),
    ],
)
@pytest.mark.parametrize("backend", BACKENDS)
def test_errors_name_the_argument(change, error, text, backend):
    positions, triangles = soup(1, 2, 1.0)
    arguments = {
        "attributes": np.zeros((6, 2), np.float32),
        "visibility": rasterize(positions, triangles, (4, 4)).packed,
        "positions": positions,
        "triangles": triangles,
    }
    with pytest.raises(error, match="bigtri.interpolate: " + text):
        interpolate(**{"backend": backend, **arguments, **change})

"""The public call: what it returns, what it accepts, and what it says of what it does not."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from cases import CASES, random_corners, soup

import bigtri
from bigtri import native

BACKENDS = ["reference"] + ["native"] * native.available()
POSITIONS = np.array([[-0.5, -0.5, 0, 1], [0.5, -0.5, 0, 1], [0, 0.5, 0, 1]], np.float32)
TRIANGLES = np.array([[0, 1, 2]], np.int32)


@pytest.fixture(params=BACKENDS)
def backend(request):
    return request.param


def test_fields_of_a_visibility(backend):
    v = bigtri.rasterize(torch.from_numpy(POSITIONS), torch.from_numpy(TRIANGLES), (8, 16), backend=backend)
    assert v.packed.dtype == torch.int64 and v.packed.shape == (8, 16)
    assert v.triangle.dtype == torch.int32 and v.triangle.shape == (8, 16)
    assert v.depth.dtype == torch.float32 and v.depth.shape == (8, 16)
    assert v.dropped.dtype == torch.int64 and v.dropped.shape == ()
    background = v.triangle == -1
    assert 0 < background.sum() < background.numel()
    assert (v.packed[background] == 2**63 - 1).all() and torch.isinf(v.depth[background]).all()
    assert (v.depth[~background] == 0.5).all() and (v.triangle[~background] == 0).all()
    assert v.triangle[0, 0] == -1 and v.triangle[4, 8] == 0


def test_numpy_in_numpy_out(backend):
    v = bigtri.rasterize(POSITIONS, TRIANGLES, (8, 16), backend=backend)
    assert all(isinstance(field, (np.ndarray, np.generic)) for field in v)
    t = bigtri.rasterize(torch.from_numpy(POSITIONS), torch.from_numpy(TRIANGLES), (8, 16), backend=backend)
    assert all(np.array_equal(a, b.numpy()) for a, b in zip(v, t, strict=True))


def test_batch_equals_single_views(backend):
    views = np.stack([soup(random_corners(np.random.default_rng(k), 12, 1.2), (60, 70)).positions for k in range(3)])
    triangles = np.arange(36, dtype=np.int32).reshape(-1, 3)
    views[1, 4, 2] = np.nan
    batch = bigtri.rasterize(views, triangles, (60, 70), backend=backend)
    assert batch.packed.shape == (3, 60, 70) and batch.dropped.tolist() == [0, 1, 0]
    for k in range(3):
        single = bigtri.rasterize(views[k], triangles, (60, 70), backend=backend)
        assert all(np.array_equal(a[k], b) for a, b in zip(batch, single, strict=True))


def test_culling_is_by_winding_on_the_screen(backend):
    drawn = {
        cull: bigtri.rasterize(POSITIONS, TRIANGLES, (8, 8), backend=backend, cull=cull).triangle.max()
        for cull in ("none", "back", "front")
    }
    assert drawn == {"none": 0, "back": 0, "front": -1}


def test_depth_can_be_left_out(backend):
    assert bigtri.rasterize(POSITIONS, TRIANGLES, (8, 8), backend=backend, depth=False).depth is None


def test_out_is_written(backend):
    out = torch.zeros(8, 8, dtype=torch.int64)
    v = bigtri.rasterize(torch.from_numpy(POSITIONS), torch.from_numpy(TRIANGLES), (8, 8), backend=backend, out=out)
    assert v.packed.data_ptr() == out.data_ptr() and (out != 0).all()


@pytest.mark.parametrize("shape", [(0, 4), (2, 0, 4), (0, 3, 4)])
def test_nothing_to_draw(shape, backend):
    v = bigtri.rasterize(np.zeros(shape, np.float32), np.zeros((0, 3), np.int32), (5, 6), backend=backend)
    assert v.packed.shape == (*shape[:-2], 5, 6) and (v.packed == 2**63 - 1).all()
    assert v.dropped.shape == shape[:-2]


def test_memory_of_any_layout(backend):
    case = CASES["screen_size"](np.random.default_rng(0))
    expected = bigtri.rasterize(*case, backend=backend).packed
    strided = np.repeat(case.positions, 2, axis=0)[::2]
    column_major = np.asfortranarray(case.triangles)
    read_only = case.positions.copy()
    read_only.flags.writeable = False
    for positions, triangles in ((strided, case.triangles), (case.positions, column_major), (read_only, case.triangles)):
        assert np.array_equal(bigtri.rasterize(positions, triangles, case.resolution, backend=backend).packed, expected)


P, T = torch.from_numpy(POSITIONS), torch.from_numpy(TRIANGLES)


@pytest.mark.parametrize(
    ("argument", "arguments", "keywords"),
    [
        ("positions", (P.double(), T, (8, 8)), {}),
        ("positions", (P[:, :3], T, (8, 8)), {}),
        ("positions", (P[0], T, (8, 8)), {}),
        ("positions", ([[0.0]], T, (8, 8)), {}),
        ("positions", (None, T, (8, 8)), {}),
        ("triangles", (P, T.long(), (8, 8)), {}),
        ("triangles", (P, T[:, :2], (8, 8)), {}),
        ("triangles", (P, T[0], (8, 8)), {}),
        ("triangles", (P, T.to("meta"), (8, 8)), {}),
        ("resolution", (P, T, (0, 8)), {}),
        ("resolution", (P, T, (8, -1)), {}),
        ("resolution", (P, T, (8, 16385)), {}),
        ("resolution", (P, T, (2**70, 8)), {}),
        ("resolution", (P, T, (8.0, 8)), {}),
        ("resolution", (P, T, 8), {}),
        ("resolution", (P, T, (8, 8, 8)), {}),
        ("cull", (P, T, (8, 8)), {"cull": "both"}),
        ("backend", (P, T, (8, 8)), {"backend": "gpu"}),
        ("variant", (P, T, (8, 8)), {"variant": "fast"}),
        ("precision", (P, T, (8, 8)), {"precision": "double"}),
        ("scissor", (P, T, (8, 8)), {"scissor": (0, 0, 8)}),
        ("scissor", (P, T, (8, 8)), {"scissor": (5, 0, 2, 8)}),
        ("scissor", (P, T, (8, 8)), {"scissor": (0, 0, 2.5, 8)}),
        ("out", (P, T, (8, 8)), {"out": torch.empty(8, 9, dtype=torch.int64)}),
        ("out", (P, T, (8, 8)), {"out": torch.empty(8, 8)}),
        ("out", (P, T, (8, 8)), {"out": torch.empty(8, 16, dtype=torch.int64)[:, ::2]}),
        ("out", (P, T, (8, 8)), {"out": "memory"}),
        ("out", (P, T, (8, 8)), {"out": np.zeros((8, 8), np.int32)}),
        ("out", (P, T, (8, 8)), {"out": np.broadcast_to(np.int64(0), (8, 8))}),
        ("positions", (P.to_sparse(), T, (8, 8)), {}),
        ("positions", (P.to("meta"), T.to("meta"), (8, 8)), {"backend": "reference"}),
    ],
)
def test_errors_name_the_argument(argument, arguments, keywords):
    with pytest.raises((TypeError, ValueError), match=rf"bigtri\.rasterize: {argument} "):
        bigtri.rasterize(*arguments, **keywords)


@pytest.mark.parametrize("index", [-1, 3, 2**31 - 1, -(2**31)])
def test_an_index_out_of_range_draws_nothing(index, backend):
    out = torch.full((8, 8), 77, dtype=torch.int64)
    triangles = torch.tensor([[0, 1, 2], [0, 1, index]], dtype=torch.int32)
    with pytest.raises(RuntimeError, match="triangles must index positions, 0 to 2, got indices from"):
        bigtri.rasterize(P, triangles, (8, 8), backend=backend, out=out)
    assert (out == 77).all()


def test_read_only_memory_is_not_written(tmp_path, backend):
    """A mapping of a file opened for reading: writing through it would end the process."""
    np.zeros((8, 8), np.int64).tofile(tmp_path / "image")
    image = np.memmap(tmp_path / "image", np.int64, "r", shape=(8, 8))
    with pytest.raises(ValueError, match=r"bigtri\.rasterize: out must be writable"):
        bigtri.rasterize(POSITIONS, TRIANGLES, (8, 8), backend=backend, out=image)


@pytest.mark.parametrize("name", ["positions", "triangles"])
def test_an_output_over_an_input(name, backend):
    """Indices that change while they are read would lead anywhere; and the caller would lose them."""
    memory = torch.zeros(64, dtype=torch.int64)
    positions, triangles = P, T
    if name == "positions":
        positions = memory.view(torch.float32)[40:52].view(3, 4).copy_(P)
    else:
        triangles = memory.view(torch.int32)[40:43].view(1, 3).copy_(T)
    with pytest.raises(RuntimeError, match=f"packed must not share memory with {name}"):
        bigtri.rasterize(positions, triangles, (8, 8), backend=backend, out=memory.view(8, 8))
    assert torch.equal(positions, P) and torch.equal(triangles, T)


def test_scissor_beyond_the_image_is_cut(backend):
    whole = bigtri.rasterize(POSITIONS, TRIANGLES, (8, 8), backend=backend).packed
    for scissor in ((-100, -100, 100, 100), (-(2**40), 0, 2**40, 8)):
        assert np.array_equal(bigtri.rasterize(POSITIONS, TRIANGLES, (8, 8), backend=backend, scissor=scissor).packed, whole)

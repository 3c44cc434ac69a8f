"""The hard cases by name, on the reference and on the extension at every instruction set; and that each has its teeth."""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from exhaustive import some_of

import bigtri
from bigtri import native
from bigtri.app import cli
from bigtri.hard_cases import Backend, cases, pictures, report
from bigtri.hard_cases.constructions import MESHES

CASES = cases()
PAGE = Path(__file__).parents[2] / "docs" / "hard_cases.md"
PLACES = ["reference", *native.isa_levels(), "cuda"]
P = np.array([[-0.5, -0.5, 0, 1], [0.5, -0.5, 0, 1], [0, 0.5, 0, 1]], np.float32)
T = np.array([[0, 1, 2]], np.int32)


@pytest.fixture(params=["reference"] + ["native"] * native.available())
def backend(request):
    return request.param


# The backend varies fastest: the exact answer of one case is kept for all of them.
@pytest.mark.parametrize("where", some_of(["reference", *native.isa_levels()[-1:], "cuda"], PLACES))
@pytest.mark.parametrize("name", CASES)
def test_case(name, where):
    if where == "reference":
        assert CASES[name].wrong(Backend("reference")) == 0, CASES[name].invariant
        return
    if where == "cuda":
        if "cuda" not in native.devices():
            pytest.skip("no CUDA build, or no CUDA device")
        assert CASES[name].wrong(Backend("native", "cuda")) == 0, CASES[name].invariant
        return
    with native.using_isa(where):
        assert CASES[name].wrong(Backend("native")) == 0, CASES[name].invariant


@pytest.mark.parametrize("name", [name for name, case in CASES.items() if case.breaks])
def test_case_is_hard(name):
    """The ways that must fail do fail: else the construction tests nothing."""
    counts = CASES[name].naive()
    assert {variant for variant in CASES[name].breaks if not counts[variant]} == set()


@pytest.mark.parametrize("case", MESHES, ids=lambda case: case.name)
def test_meshes_snap_to_the_integers_they_are_made_of(case):
    """The truth is computed from integers; clip space must lead back to them, by Python's own arithmetic."""
    for mesh in case.wrong.args[0]():
        height, width = mesh.resolution
        x, y, _, w = mesh.positions[:: max(len(mesh.positions) // 500, 1)].astype(np.float64).T
        got = np.stack([128 * width + np.rint(x / w * 128 * width), 128 * height - np.rint(y / w * 128 * height)], -1)
        expected = mesh.xy.reshape(-1, 2)[:: max(len(mesh.positions) // 500, 1)]
        assert np.abs(got - expected).max() <= (0 if not mesh.slack else 4)


def test_every_case_says_what_and_why():
    numbers = {f"H{k:02}" for k in range(1, 50)}
    assert numbers <= set(CASES)
    for case in CASES.values():
        assert case.title and case.invariant and case.reason and case.family, case.name


# --- The command -------------------------------------------------------------------------------------------------------------


def test_command(capsys, tmp_path):
    assert cli.main(["hard-cases", "--only", "H01", "H27", "--csv", str(tmp_path / "x.csv")]) == 0
    printed = capsys.readouterr()
    assert printed.out.splitlines()[0].split()[:2] == ["case", "construction"]
    assert "nothing wrong" in printed.err
    with open(tmp_path / "x.csv", encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["case"] for row in rows} == {"H01", "H27"} and {row["wrong"] for row in rows} == {"0"}
    assert {row["backend"] for row in rows} == {b.name for b in report.backends()}


def test_command_names_what_it_does_not_know(capsys):
    assert cli.main(["hard-cases", "--only", "H99"]) == 2
    assert "H99" in capsys.readouterr().err


def test_a_defect_is_reported(capsys, monkeypatch):
    broken = CASES["H42"]._replace(wrong=lambda backend: 7)
    monkeypatch.setattr(report, "cases", lambda: {"H42": broken})
    assert cli.main(["hard-cases"]) == 1
    printed = capsys.readouterr()
    assert "WRONG" in printed.err and "7" in printed.out


def test_pictures(tmp_path, monkeypatch):
    monkeypatch.setattr(pictures, "PICTURES", [p for p in pictures.PICTURES if p.name in ("ties", "clipping", "depth")])
    paths = pictures.draw_all(tmp_path)
    assert [p.name for p in paths] == ["ties.png", "clipping.png", "depth.png"]
    assert all(1000 < p.stat().st_size < 150_000 for p in paths)


def test_the_page_is_of_these_cases():
    """docs/hard_cases.md has a row of zeros for every case, and all pictures."""
    page = PAGE.read_text(encoding="utf-8")
    rows = {line.split(" | ")[0][2:]: line for line in page.splitlines() if line.startswith("| ")}
    for case in CASES.values():
        assert case.title in rows[case.name] and case.reason in rows[case.name], case.name
        assert rows[case.name].endswith(" | 0 |"), case.name
    for picture in pictures.PICTURES:
        assert f"(img/hard_cases/{picture.name}.png)" in page
        assert 0 < (PAGE.parent / "img" / "hard_cases" / f"{picture.name}.png").stat().st_size < 150_000


# --- Bad input: the rows of the table in docs/hard_cases.md -------------------------------------------------------------------


def draw(positions, triangles=T, resolution=(8, 8), backend="auto", **options):
    return bigtri.rasterize(positions, triangles, resolution, backend=backend, **options)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("component", range(4))
def test_a_coordinate_that_is_not_finite(value, component, backend):
    positions = np.concatenate([P, P])
    positions[1, component] = value
    v = draw(positions, np.array([[0, 1, 2], [3, 4, 5]], np.int32), backend=backend)
    assert v.dropped == 1
    assert set(np.unique(v.triangle)) == {-1, 1} and np.array_equal(v.triangle == 1, draw(P, backend=backend).triangle == 0)


def test_a_vertex_that_no_triangle_names_may_be_anything(backend):
    positions = np.concatenate([P, np.full((1, 4), np.nan, np.float32)])
    v = draw(positions, backend=backend)
    assert v.dropped == 0 and np.array_equal(v.packed, draw(P, backend=backend).packed)


def test_denormal_coordinates(backend):
    """All four components scaled by 2^-140: the same triangle."""
    tiny = np.ldexp(P, -140).astype(np.float32)
    assert 0 < np.abs(tiny).max() < np.finfo(np.float32).tiny
    assert np.array_equal(draw(tiny, backend=backend).packed, draw(P, backend=backend).packed)


def test_the_largest_coordinates(backend):
    large = (P * np.float32(2.0**127)).astype(np.float32)
    assert np.array_equal(draw(large, backend=backend).packed, draw(P, backend=backend).packed)
    assert draw(large, backend=backend).dropped == 0


@pytest.mark.parametrize(
    "corners",
    [
        [[0, 0, 0, 1]] * 3,
        [[0, 0, 0, 0]] * 3,
        [[-1, -1, 0, 1], [1, 1, 0, 1], [0, 0, 0, 1]],
        [[-1, -1, 0, 1], [1, 1, 0, 1], [1, 1, 0, 1]],
        [[-1, -1, 0, -1], [1, -1, 0, -1], [0, 1, 0, -1]],
        [[-1, -1, -2, 1], [1, -1, -2, 1], [0, 1, -2, 1]],
    ],
    ids=["coincident", "all_zero", "collinear", "vertex_twice", "behind", "before_near"],
)
def test_nothing_to_see(corners, backend):
    v = draw(np.array(corners, np.float32), backend=backend)
    assert (v.triangle == -1).all() and v.dropped == 0


@pytest.mark.parametrize("shape", [(0, 8), (8, 0), (-1, 8), (16385, 8), (2**40, 2**40)])
def test_sizes_that_are_no_image(shape, backend):
    with pytest.raises(ValueError, match=r"bigtri\.rasterize: resolution must be \(height, width\), 1 to 16384 each, got"):
        draw(P, resolution=shape, backend=backend)


def test_the_largest_width_and_height(backend):
    for shape in ((1, 16384), (16384, 1)):
        v = draw(np.array([[-9, -9, 0, 1], [9, -9, 0, 1], [0, 9, 0, 1]], np.float32), resolution=shape, backend=backend)
        assert (v.triangle == 0).all()


@pytest.mark.parametrize("dtype", [np.float64, np.float16, np.int32, np.bool_, np.complex64])
def test_dtype_of_positions(dtype, backend):
    with pytest.raises(TypeError, match=rf"bigtri\.rasterize: positions must be float32 .*got {np.dtype(dtype)}"):
        draw(P.astype(dtype), backend=backend)


@pytest.mark.parametrize("dtype", [np.int64, np.uint32, np.int16, np.float32, np.uint8])
def test_dtype_of_triangles(dtype, backend):
    with pytest.raises(TypeError, match=rf"bigtri\.rasterize: triangles must be int32 .*got {np.dtype(dtype)}"):
        draw(P, T.astype(dtype), backend=backend)


def test_strides_of_torch_tensors(backend):
    """Transposed, expanded and stepped memory gives what contiguous memory gives."""
    expected = draw(torch.from_numpy(P), torch.from_numpy(T), backend=backend).packed
    transposed = torch.from_numpy(P).t().contiguous().t()
    stepped = torch.from_numpy(np.repeat(P, 3, axis=0))[::3]
    assert not transposed.is_contiguous() and not stepped.is_contiguous()
    for positions in (transposed, stepped):
        assert torch.equal(draw(positions, torch.from_numpy(T), backend=backend).packed, expected)
    batch = torch.from_numpy(P)[None].expand(3, -1, -1)
    assert torch.equal(draw(batch, torch.from_numpy(T), backend=backend).packed, expected.expand(3, -1, -1))
    assert np.array_equal(
        draw(P[::-1], T[:, ::-1], backend=backend).packed, draw(P[::-1].copy(), T[:, ::-1].copy(), backend=backend).packed
    )


def test_requires_grad_is_not_kept(backend):
    positions = torch.from_numpy(P).clone().requires_grad_()
    v = draw(positions, torch.from_numpy(T), backend=backend)
    assert not any(field.requires_grad for field in v) and torch.equal(
        v.packed, draw(torch.from_numpy(P), torch.from_numpy(T)).packed
    )
    assert positions.grad is None and positions.requires_grad


def test_another_byte_order(backend):
    with pytest.raises(TypeError, match=r"bigtri\.rasterize: positions must be float32 .*got >f4"):
        draw(P.astype(">f4"), backend=backend)


def test_read_only_input(backend):
    positions, triangles = P.copy(), T.copy()
    positions.flags.writeable = triangles.flags.writeable = False
    assert np.array_equal(draw(positions, triangles, backend=backend).packed, draw(P, backend=backend).packed)


def test_an_empty_batch(backend):
    v = draw(np.zeros((0, 3, 4), np.float32), backend=backend)
    assert v.packed.shape == (0, 8, 8) and v.dropped.shape == (0,)


def test_another_device(backend):
    for positions, triangles in ((P, torch.from_numpy(T).to("meta")), (torch.from_numpy(P).to("meta"), T)):
        with pytest.raises(ValueError, match=r"bigtri\.rasterize: triangles must be on positions's device"):
            draw(positions, triangles, backend=backend)


def test_triangles_without_positions(backend):
    with pytest.raises(RuntimeError, match="triangles must be empty where positions is"):
        draw(np.zeros((0, 4), np.float32), backend=backend)


@pytest.mark.skipif(
    not native.available() or sys.platform != "linux", reason="the extension is not built, or memory is counted otherwise"
)
def test_more_than_2_to_24_triangles():
    """The last of 2^24 + 1 triangles comes back by its own index; all others have no area. Under 2 GB."""
    import resource

    count = 2**24 + 1
    triangles = torch.zeros(count, 3, dtype=torch.int32)
    triangles[-1] = torch.tensor([0, 1, 2])
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    v = draw(torch.from_numpy(P), triangles, backend="native")
    assert v.triangle.unique().tolist() == [-1, count - 1] and v.dropped == 0
    assert (v.packed[4, 4] & 0xFFFFFFFF) == count - 1
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 2 * 10**6  # kB

"""bench/fragments.py: the four ways end in the same picture, which is the one that bigtri's own operators make."""

from __future__ import annotations

import importlib
import os
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

import bigtri
from bigtri import native
from bigtri.study import benchmark

BENCH = Path(__file__).parents[2] / "bench"
if not BENCH.exists():
    pytest.skip("bench/ is not here", allow_module_level=True)
if str(BENCH) not in sys.path:
    sys.path.append(str(BENCH))
fragments = importlib.import_module("fragments")

pytestmark = [
    pytest.mark.skipif(not native.available(), reason="the extension is not built"),
    pytest.mark.skipif(not (shutil.which("c++") or shutil.which("g++")), reason="no C++ compiler"),
]


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory):
    patch = pytest.MonkeyPatch()
    patch.setenv("TORCH_EXTENSIONS_DIR", str(tmp_path_factory.mktemp("extensions")))
    patch.setenv("PATH", str(Path(sys.executable).parent), prepend=os.pathsep)  # ninja lies beside Python
    yield fragments.library("cpu")
    patch.undo()


@pytest.mark.parametrize("name", ["R4k", "S2", "S4b"])
def test_all_ways_end_in_the_same_picture(built, name: str):
    scene = fragments.Scene(built, "cpu", name, *((96, 64) if name == "S4b" else (320, 240)))
    rows = scene.rows(0, fragments.whence("cpu"))
    assert [(row.way, row.differing_px) for row in rows] == [(way, 0) for way in fragments.WAYS]
    assert all(row.draw_ms > 0 and row.image_ms > 0 and row.fragments >= row.covered_px > 500 for row in rows)
    assert not scene.tensors["locks"].any()


def test_the_picture_is_what_the_operators_make(built):
    scene = fragments.Scene(built, "cpu", "R4k", 320, 240)
    scene.picture("packed")
    given = {key: torch.from_numpy(array) for key, array in scene.given.items()}
    seen = bigtri.rasterize(given["positions"], given["triangles"], scene.size)
    normals = bigtri.interpolate(given["normals"], seen, given["positions"], given["triangles"])
    albedo = torch.tensor([0.8, 0.7, 0.6]).expand(*scene.size, 3).contiguous()
    lights = bigtri.lambert(normals, albedo, torch.full((3,), 0.1), given["directions"], given["colors"])
    expected = np.where(np.asarray(seen.triangle >= 0)[..., None], np.asarray(bigtri.encode_srgb(lights)), 0)
    image = scene.tensors["image"].numpy().view(np.uint8).reshape(*scene.size, 4)
    assert (image[..., :3] == expected).all() and expected.any()


def test_another_picture_is_noticed(built):
    scene = fragments.Scene(built, "cpu", "S2", 320, 240)
    scene.arguments.count -= 1
    with pytest.raises(RuntimeError, match="S2: the packed minimum's bits are not those of bigtri's scanline"):
        scene.check()


def test_the_command(built, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(fragments, "library", lambda device: built)
    page, kept = tmp_path / "page.md", tmp_path / "rows.csv"
    page.write_text("<!-- fragments cpu: begin -->\n<!-- fragments cpu: end -->\n")
    what = ["--scenes", "R4k,S5", "--size", "320x240", "--seconds", "0", "--csv", str(kept)]
    assert fragments.main([*what, "--docs", str(page)]) == 0
    assert "S5: bigtri.study.scenes: size must have room" in capsys.readouterr().out
    text = page.read_text()
    assert "| R4k, 320x240 |" in text and text.count("|\n") == 3
    assert fragments.main(["--rows", str(kept), "--docs", str(page)]) == 0 and page.read_text() != ""
    rows = benchmark.read_csv(kept)
    assert [row["way"] for row in rows] == list(fragments.WAYS)
    broken = [row | {"differing_px": "3"} if row["way"] == "locked" else row for row in rows]
    monkeypatch.setattr(benchmark, "read_csv", lambda path: broken)
    assert fragments.main(["--rows", str(kept)]) == 1
    assert "NOT EQUAL: R4k: with a lock 3 px have other bits" in capsys.readouterr().out


def test_ratios_of_the_table():
    row = {"scene": "R", "width": "8", "height": "4", "fragments": "2000", "covered_px": "9", "differing_px": "0"}
    row |= {"device": "a", "how": "b", "versions": "c", "commit": "d", "command": "e"}
    times = {"packed": (2, 4), "locked": (3, 9), "coloured": (9, 5), "coloured all": (9, 8)}
    rows = [row | {"way": way, "draw_ms": str(draw), "image_ms": str(image)} for way, (draw, image) in times.items()]
    assert fragments.table(rows).splitlines()[-1] == "| R, 8x4 | 2 k | 9 | 2 | 1.50 | 4 | 1.25 | 2.00 | 0 |"

"""bench/before_after.py. Nothing here asserts a time."""

from __future__ import annotations

import csv
import importlib
import json
import sys
from pathlib import Path

import pytest

from bigtri import native

ROOT = Path(__file__).resolve().parents[2]
if not (ROOT / "bench").exists():
    pytest.skip("bench/ is not here", allow_module_level=True)
if str(ROOT / "bench") not in sys.path:
    sys.path.append(str(ROOT / "bench"))
before_after = importlib.import_module("before_after")

pytestmark = pytest.mark.skipif(not native.available(), reason="the extension is not built")


def test_a_checkout_beside_itself(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Every way on a scene and a model, a table of their ratios in a page, and the same table from the file."""
    (tmp_path / "square.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n")
    page, rows = tmp_path / "page.md", tmp_path / "rows.csv"
    page.write_text("<!-- turns: begin -->\n<!-- turns: end -->\n")
    ways = ["--setting", "bin_owned", "--setting", "scanline:share=64"]
    drawn = ["--scenes", "R4k,square", "--model", str(tmp_path / "square.obj"), "--size", "40x30,64x48", "--seconds", "0"]
    kept = ["--csv", str(rows), "--docs", str(page), "--name", "turns", "--commits", "old", "new"]
    before_after.main([str(ROOT), *drawn, *ways, *kept])
    found = [*csv.DictReader(rows.open())]
    cases = [(scene, size) for scene in ("R4k", "square") for size in ("40x30", "64x48")]
    names = ("bin_owned", "scanline share=64")
    assert [(r["scene"], r["size"], r["variant"]) for r in found] == [(*case, name) for case in cases for name in names]
    assert all(float(r[name]) > 0 for r in found for name in ("before_ms", "after_ms", "ratio", "control"))
    assert {(r["before"], r["after"], int(r["rounds"]) >= 5) for r in found} == {("old", "new", True)}
    text = page.read_text()
    assert "| scanline share=64 |" in text and "R4k, 40x30" in text
    page.write_text("<!-- turns: begin -->\n<!-- turns: end -->\n")
    before_after.main(["--rows", str(rows), "--docs", str(page), "--name", "turns"])
    assert page.read_text() == text and text.split("\n")[2] in capsys.readouterr().out


def test_what_it_refuses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="--setting scanline rows=1: parameters of scanline are share, got rows"):
        before_after.main([str(ROOT), "--setting", "scanline:rows=1"])
    with pytest.raises(SystemExit, match="--setting other: variants are bin_owned"):
        before_after.main([str(ROOT), "--setting", "other"])
    for arguments in ([], [str(ROOT), "--rows", str(tmp_path / "rows.csv")]):
        with pytest.raises(SystemExit):
            before_after.main(arguments)
        assert "name an old checkout, or --rows" in capsys.readouterr().err


def test_a_process_that_ends_is_said() -> None:
    drawing = before_after.Drawing(ROOT, "cpu", 1)
    drawing.begin(json.dumps([str(ROOT / "no such file"), "bin_owned", 8, 8, {}]))
    with pytest.raises(SystemExit, match="has ended with 1"):
        drawing.ms()

"""`bigtri bench` and the argument types that the command lines share. Nothing here asserts a time."""

from __future__ import annotations

import argparse
import csv
import dataclasses
from pathlib import Path

import pytest

from bigtri import native
from bigtri.app import arguments, bench
from bigtri.ops.rasterize import rasterize
from bigtri.precision import PRECISIONS
from bigtri.reference.numerics import BACKGROUND
from bigtri.study import benchmark, scenes

needs_extension = pytest.mark.skipif(not native.available(), reason="the extension is not built")


@pytest.mark.parametrize("text, value", [("1920x1080", (1920, 1080)), ("4K", (3840, 2160)), ("16k", (15360, 8640))])
def test_size(text: str, value: tuple[int, int]) -> None:
    assert arguments.size(text) == value


@pytest.mark.parametrize("text", ["80", "0x9", "9x0", "16385x9", "9x99999", "-1x9", "1x2x3", "x", "1.5x2", "", "9" * 5000 + "x1"])
def test_sizes_that_are_none(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match="must be WIDTHxHEIGHT, 1 to 16384 each"):
        arguments.size(text)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["--size", "10x10", "--scenes", "S3,S1"], "size must have room for triangles of 4000 to 40000 px, got 10x10 px"),
        (["--size", "0x0", "--scenes", "S3"], "argument --size: must be WIDTHxHEIGHT"),
        (["--size", "99999x10"], "argument --size: must be WIDTHxHEIGHT"),
        (["--seed", "-9999"], "argument --seed: must be a whole number of at least 0, got '-9999'"),
        (["--threads", "100000000000"], "argument --threads: must be a whole number from 1 to 1024"),
        (["--threads", "two"], "argument --threads: must be a whole number from 1 to 1024"),
        (["--seconds", "nan"], "argument --seconds: must be a number of seconds of at least 0"),
        (["--csv", "{folder}"], "argument --csv: must be a file, got the folder"),
        (["--csv", "{folder}/file/x.csv"], "argument --csv: must be in a folder"),
        (["--variant", "none"], "variant must be one of"),
        (["--precision", "none"], "precision must be one of exact, "),
    ],
)
@needs_extension
def test_a_wrong_command_line_measures_nothing(
    options: list[str], text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setattr(benchmark, "measure", lambda *_: pytest.fail("measured"))
    with pytest.raises(SystemExit) as stopped:
        bench.main([option.format(folder=tmp_path) for option in options])
    assert stopped.value.code == 2
    assert text in capsys.readouterr().err


@needs_extension
def test_command_writes_a_row_for_each_case(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "rows.csv"
    isa = native.isa()
    options = ["--scenes", "S1,S2", "--size", "640x360,512x512", "--threads", "1,2", "--seconds", "0", "--isa", "all"]
    assert bench.main([*options, "--csv", str(path)]) == 0
    assert native.isa() == isa
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * 2 * 2 * len(native.isa_levels())
    assert list(rows[0]) == [field.name for field in dataclasses.fields(benchmark.Row)]
    assert all(float(row["ms_min"]) <= float(row["ms_median"]) for row in rows)
    # the same scene covers the same pixels whatever the setting
    assert len({(row["scene"], row["width"], row["covered_px"]) for row in rows}) == 4
    assert "S2" in capsys.readouterr().out


@needs_extension
def test_each_rung_draws_its_own_pixels(tmp_path: Path) -> None:
    path = tmp_path / "rows.csv"
    options = ["--scenes", "S2", "--size", "640x360", "--seconds", "0", "--precision", "all"]
    assert bench.main([*options, "--csv", str(path)]) == 0
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["precision"] for row in rows] == [name for name in PRECISIONS if name in native.REGISTRY["cpu"]]
    scene = scenes.make("S2", 640, 360)
    for row in rows:
        packed = rasterize(scene.positions, scene.triangles, (360, 640), precision=row["precision"], backend="native").packed
        assert int(row["covered_px"]) == int((packed != BACKGROUND).sum())
    fragments = {row["precision"]: row["fragments"] for row in rows}
    assert fragments["exact"] != fragments["subpixel4"]


def test_command_names_the_scenes_there_are(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        bench.main(["--scenes", "S9"])
    assert "S9" in capsys.readouterr().err

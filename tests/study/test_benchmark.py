"""The benchmark's bookkeeping. Nothing here asserts a time."""

from __future__ import annotations

import argparse
import csv
import dataclasses
from pathlib import Path

import numpy as np
import pytest

from bigtri import native
from bigtri.study import benchmark, scenes

needs_extension = pytest.mark.skipif(not native.available(), reason="the extension is not built")


def test_clock_counts_only_what_is_warm() -> None:
    calls = []
    ms = benchmark.clock(lambda: calls.append(None), seconds=0, warm=3, at_least=7)
    assert len(calls) == 10 and len(ms) == 7 and min(ms) >= 0


def test_clock_stops_at_most() -> None:
    assert len(benchmark.clock(lambda: None, seconds=60, at_most=20)) == 20


def test_summary() -> None:
    assert benchmark.summary([4, 1, 3, 2, 5]) == benchmark.Timing(median=3, minimum=1, p25=2, p75=4, repeats=5)


@pytest.mark.parametrize("text, value", [("1920x1080", (1920, 1080)), ("4K", (3840, 2160)), ("16k", (15360, 8640))])
def test_size(text: str, value: tuple[int, int]) -> None:
    assert benchmark.size(text) == value


@pytest.mark.parametrize("text", ["80", "0x9", "9x0", "16385x9", "9x99999", "-1x9", "1x2x3", "x", "1.5x2", "", "9" * 5000 + "x1"])
def test_sizes_that_are_none(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match="must be WIDTHxHEIGHT, 1 to 16384 each"):
        benchmark.size(text)


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
    ],
)
@needs_extension
def test_a_wrong_command_line_measures_nothing(
    options: list[str], text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setattr(benchmark, "measure", lambda *_: pytest.fail("measured"))
    with pytest.raises(SystemExit) as stopped:
        benchmark.main([option.format(folder=tmp_path) for option in options])
    assert stopped.value.code == 2
    assert text in capsys.readouterr().err


def test_csv_has_the_digits_asked_for(tmp_path: Path) -> None:
    @dataclasses.dataclass
    class Row:
        name: str
        ms: float | None

    benchmark.write_csv(tmp_path / "new" / "rows.csv", [Row("a", 1 / 3), Row("b", None)], digits=3)
    assert (tmp_path / "new" / "rows.csv").read_text() == "name,ms\na,0.333\nb,\n"
    assert benchmark.read_csv(tmp_path / "new" / "rows.csv")[0] == {"name": "a", "ms": "0.333"}


def test_ids() -> None:
    packed = np.array([[benchmark.BACKGROUND, 5, (7 << 32) | 3]])
    assert benchmark.ids(packed).tolist() == [[-1, 5, 3]] and benchmark.ids(packed).dtype == np.int32


@needs_extension
def test_fragments_are_covered_samples() -> None:
    scene = scenes.to_clip(scenes.full_screen(3, 100, 70, seed=1, back_to_front=True), 100, 70)
    job = benchmark.Job("three", 100, 70, scene)
    job.draw()
    assert job.fragments() == 3 * 100 * 70
    assert job.covered_px() == 100 * 70


@needs_extension
def test_command_writes_a_row_for_each_case(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "rows.csv"
    isa = native.isa()
    options = ["--scenes", "S1,S2", "--size", "640x360,512x512", "--threads", "1,2", "--seconds", "0", "--isa", "all"]
    assert benchmark.main([*options, "--csv", str(path)]) == 0
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
def test_command_names_the_scenes_there_are(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        benchmark.main(["--scenes", "S9"])
    assert "S9" in capsys.readouterr().err


def test_scene_reaches_the_grid_of_the_reference() -> None:
    """What scenes.py promises about snapping holds for the rasterizer's own setup."""
    from bigtri.check import stages

    scene = scenes.make("S2", 1920, 1080)
    records, dropped = stages.setup(scene.positions, scene.triangles, 1080, 1920, backend="reference")
    wanted = np.sort(np.floor(scenes.pixels("S2", 1920, 1080)[..., :2].astype(np.float64) * 256).astype(np.int64), axis=1)
    assert dropped == 0
    np.testing.assert_array_equal(np.sort(records.xy.astype(np.int64), axis=1), wanted)

"""The benchmark's bookkeeping. Nothing here asserts a time."""

from __future__ import annotations

import csv
import dataclasses
from pathlib import Path

import numpy as np
import pytest

from bigtri import benchmark, native, scenes

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
    from bigtri import stages

    scene = scenes.make("S2", 1920, 1080)
    records, dropped = stages.setup(scene.positions, scene.triangles, 1080, 1920, backend="reference")
    wanted = np.sort(np.floor(scenes.pixels("S2", 1920, 1080)[..., :2].astype(np.float64) * 256).astype(np.int64), axis=1)
    assert dropped == 0
    np.testing.assert_array_equal(np.sort(records.xy.astype(np.int64), axis=1), wanted)

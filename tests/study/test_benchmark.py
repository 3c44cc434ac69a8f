"""The benchmark's bookkeeping. Nothing here asserts a time."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from bigtri import native
from bigtri.reference.numerics import BACKGROUND
from bigtri.study import benchmark, clock, scenes

needs_extension = pytest.mark.skipif(not native.available(), reason="the extension is not built")


def test_clock_counts_only_what_is_warm() -> None:
    calls = []
    ms = clock.clock(lambda: calls.append(None), seconds=0, warm=3, at_least=7)
    assert len(calls) == 10 and len(ms) == 7 and min(ms) >= 0


def test_clock_stops_at_most() -> None:
    assert len(clock.clock(lambda: None, seconds=60, at_most=20)) == 20


@needs_extension
def test_thread_load_draws_the_same_and_ends() -> None:
    """One thread has all the work; sixteen share it, and the picture and later calls are the usual ones."""
    job = benchmark.Job("R4k", 256, 256, scenes.make("R4k", 256, 256))
    job.draw()
    expected = job.packed.clone()
    one, many = clock.thread_load(job.draw, 1, calls=1), clock.thread_load(job.draw, 16, calls=3)
    assert torch.equal(job.packed, expected)
    assert one.longest == one.mean > 0 and 0 < many.mean <= many.longest <= 16 * many.mean
    job.draw()
    assert tuple(torch.ops.bigtri.thread_load(0)) == (0, 0) and torch.equal(job.packed, expected)
    with pytest.raises(RuntimeError, match="threads must be 0 to 1024, got -1"):
        torch.ops.bigtri.thread_load(-1)


def test_summary() -> None:
    assert clock.summary([4, 1, 3, 2, 5]) == clock.Timing(median=3, minimum=1, p25=2, p75=4, repeats=5)


def test_csv_has_the_digits_asked_for(tmp_path: Path) -> None:
    @dataclasses.dataclass
    class Row:
        name: str
        ms: float | None

    benchmark.write_csv(tmp_path / "new" / "rows.csv", [Row("a", 1 / 3), Row("b", None)], digits=3)
    assert (tmp_path / "new" / "rows.csv").read_text() == "name,ms\na,0.333\nb,\n"
    assert benchmark.read_csv(tmp_path / "new" / "rows.csv")[0] == {"name": "a", "ms": "0.333"}


def test_ids() -> None:
    packed = np.array([[BACKGROUND, 5, (7 << 32) | 3]])
    assert benchmark.ids(packed).tolist() == [[-1, 5, 3]] and benchmark.ids(packed).dtype == np.int32


@needs_extension
def test_fragments_are_covered_samples() -> None:
    scene = scenes.to_clip(scenes.full_screen(3, 100, 70, seed=1, back_to_front=True), 100, 70)
    job = benchmark.Job("three", 100, 70, scene)
    job.draw()
    assert job.fragments() == 3 * 100 * 70
    assert job.covered_px() == 100 * 70


def test_scene_reaches_the_grid_of_the_reference() -> None:
    """What scenes.py promises about snapping holds for the rasterizer's own setup."""
    from bigtri.check import stages

    scene = scenes.make("S2", 1920, 1080)
    records, dropped = stages.setup(scene.positions, scene.triangles, 1080, 1920, backend="reference")
    wanted = np.sort(np.floor(scenes.pixels("S2", 1920, 1080)[..., :2].astype(np.float64) * 256).astype(np.int64), axis=1)
    assert dropped == 0
    np.testing.assert_array_equal(np.sort(records.xy.astype(np.int64), axis=1), wanted)

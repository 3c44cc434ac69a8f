"""Pictures of variants' work show what the build that counts says, no more and no less."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import bigtri
from bigtri import native
from bigtri.check.work_map import WorkMap, map_work
from bigtri.study import accuracy
from bigtri.study.compare import Job

pytest.importorskip("matplotlib")
from bigtri.study import work_plots

pytestmark = pytest.mark.skipif(not native.available(), reason="the extension is not built")
VARIANTS = native.VARIANTS.get("cpu", ())
NAMES = ("work", "overdraw", "load")


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    """Draws a job; returns the panels of each picture, by its name and their titles."""

    def draw(job: Job, variants: tuple[str, ...] = VARIANTS) -> dict[str, dict[str, Any]]:
        panels: dict[str, dict[str, Any]] = {}
        real = work_plots._saved

        def keep(figure: Any, path: Path, caption: str) -> Path:
            panels[path.stem] = {axes.get_title(): axes for axes in figure.axes if axes.get_title()}
            return real(figure, path, caption)

        monkeypatch.setattr(work_plots, "_saved", keep)
        paths = work_plots.draw_all(job, "a scene", variants, tmp_path / "new")
        assert [path.stem for path in paths] == [*NAMES]
        assert all(path.read_bytes().startswith(b"\x89PNG") for path in paths)
        return panels

    return draw


def job_of(name: str, width: int, height: int) -> Job:
    case = accuracy.case(name, width, height, 0)
    return Job(case.positions, case.triangles, (case.height, case.width))


def values_of(axes: Any) -> Any:
    return np.ma.filled(axes.images[0].get_array(), 0)


def test_heat_maps_add_up_to_the_counters(drawn: Any) -> None:
    job = job_of("S3", 256, 192)  # whole bins: nothing lies beyond the image
    first, *panels = drawn(job)["work"].items()
    assert first[0].startswith("what is drawn")
    assert [title.partition("\n")[0] for title, _ in panels] == [*VARIANTS]
    assert len({(axes.images[0].norm.vmin, axes.images[0].norm.vmax) for _, axes in panels}) == 1, "one colour scale"
    for title, axes in panels:
        variant, _, says = title.partition("\n")
        work = map_work(job.positions, job.triangles, job.resolution, variant=variant)
        if variant != "recursive_descent":  # there threads decide how much is left out
            counts = work.counters
            total = sum(counts.get(name, 0) for name in ("edges_64", "edges_32", "fragments"))
            assert (64 * values_of(axes)).sum() == pytest.approx(total, rel=1e-12)
            assert says.endswith(f"{work_plots._short(counts['fragments'])} fragments")
        assert values_of(axes).max() <= axes.images[0].norm.vmax


def test_overdraw_with_and_without_early_reject(drawn: Any) -> None:
    job = job_of("S3", 256, 192)
    panels = drawn(job)["overdraw"]
    without = [title for title in panels if "nothing rejected" in title]
    assert len(without) == 1, "all that reject nothing offer the same fragments"
    named = without[0].replace("\n", " ").replace("\xa0", " ")
    assert "scanline, two_stage" in named and "recursive_descent early_z=0" in named and "hierarchical_tiles early_z=0" in named
    covered = (bigtri.rasterize(job.positions, job.triangles, job.resolution).triangle >= 0).sum()
    for title, axes in panels.items():
        image = values_of(axes)
        mean = float(re.search(r"mean ([\d.]+), most", title)[1])  # type: ignore[index]
        assert mean == pytest.approx(image.sum() / covered, rel=5e-3)
        assert (image <= values_of(panels[without[0]])).all()
        assert title == without[0] or (image < values_of(panels[without[0]])).any()
    everything = " ".join(panels)
    assert all(variant in everything for variant in VARIANTS)


def test_the_load_of_each_task(drawn: Any) -> None:
    job = job_of("S2", 256, 256)
    for title, axes in drawn(job, ("batched", "tile_queues"))["load"].items():
        work = map_work(job.positions, job.triangles, job.resolution, variant=title.partition("\n")[0])
        values, edges, _ = axes.patches[0].get_data()
        assert np.allclose(values, work.tasks / work.tasks.mean())
        assert np.array_equal(edges, np.arange(1, len(work.tasks) + 2))
        assert f"{len(work.tasks)} tasks, load {values[0]:.3g}" in title


def test_fragments_alone_as_cuda_counts_them(drawn: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The CPU's fragments, with what kernels for CUDA do not count left out."""

    def on_cuda(*mesh: Any, device: str, **how: Any) -> WorkMap:
        assert device == "cuda"
        counters, fragments, _, tasks = map_work(*mesh, **how)
        return WorkMap({name: counters[name] for name in ("fragments", "tasks", "work", "most_work")}, fragments, None, tasks)

    monkeypatch.setattr(work_plots, "map_work", on_cuda)
    monkeypatch.setitem(native.REGISTRY, "cuda", native.REGISTRY["cpu"])
    job = job_of("S3", 256, 192)._replace(device="cuda")
    panels = drawn(job, ("scanline", "recursive_descent"))
    offered = map_work(job.positions, job.triangles, job.resolution, variant="scanline").fragments
    title = f"scanline\n{work_plots._short(offered.sum())} fragments"
    assert (64 * values_of(panels["work"][title])).sum() == pytest.approx(offered.sum(), rel=1e-12)
    without, rejecting = panels["overdraw"]
    assert without.startswith("scanline, recursive_descent\xa0early_z=0\nnothing rejected by depth")
    assert rejecting.startswith("recursive_descent\xa0early_z=1\nearly reject by depth")
    assert np.array_equal(values_of(panels["overdraw"][without]), offered)
    assert all("block" in title for title in panels["load"])


@pytest.mark.filterwarnings("error")
def test_a_picture_of_nothing(drawn: Any) -> None:
    nothing = Job(np.zeros((3, 4), np.float32), np.array([[0, 1, 2]], np.int32), (30, 50))
    panels = drawn(nothing, ("scanline",))
    assert "scanline\n0 edge values, 0 fragments" in panels["work"] and "scanline\n0 tasks, load 0" in panels["load"]

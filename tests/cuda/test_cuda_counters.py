"""Counters of work on CUDA against the reference, where the extension was built with BIGTRI_CUDA_COUNTING=1; and the tuner."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TypeVar

import counted_work
import numpy as np
import pytest
import torch
from cuda_bits import DEVICE, EVERY, Scene, case_of, needs_cuda

import bigtri
from bigtri import native, reference
from bigtri.app import cli
from bigtri.check import counters
from bigtri.check.work_map import map_work
from bigtri.precision import EXACT
from bigtri.reference.work import without_empty
from bigtri.study import tune

pytestmark = needs_cuda

COUNTED = tuple(native.VARIANTS.get("cuda", ()))  # those of exact
HIDE = ("bin_owned", "persistent")  # what an entry covers hides what lies behind, in an order that the device decides
RECORD_BYTES = 104  # of csrc/core/record.h's Record on a GPU
Counted = TypeVar("Counted")


def of_the_build(ask: Callable[..., Counted], name: str, variant: str, parameters: dict[str, int]) -> Counted:
    """What ``count`` or ``map_work`` says of a scene."""
    try:
        return ask(*case_of(Scene(name)), variant=variant, device=DEVICE, backend="native", parameters=parameters)
    except RuntimeError as error:
        if "built with BIGTRI_CUDA_COUNTING=1" in str(error):
            pytest.skip(str(error))
        raise


counted = partial(of_the_build, counters.count)
mapped = partial(of_the_build, map_work)


@pytest.mark.parametrize("name", ["many_small", "guard_band", "mixed"])
@pytest.mark.parametrize("variant", COUNTED)
def test_work_is_the_reference_s(variant: str, name: str) -> None:
    """What depends on nothing: records, and the pixels that they cover, each offered its depth once; where depth hides some,
    and where records are drawn by rows before it is known that they cover nothing, the bounds."""
    has = native.REGISTRY[DEVICE]["exact"][variant].parameters
    found = counted(name, variant, {setting: 0 for setting in ("early_z", "rows") if setting in has})
    case = case_of(Scene(name))
    every, _ = reference.setup(case.positions, case.triangles, *case.resolution)
    records = len(without_empty(every, EXACT).xy)
    offered = counters.count(*case, variant="scanline", backend="reference")["fragments"]
    assert found["records"] == found.get("by_rows", 0) + found.get("by_tiles", 0)
    assert found["records"] == records or (variant == "bin_owned" and records < found["records"] <= len(every.xy))
    assert found["fragments"] == offered or (variant in HIDE and found["fragments"] < offered)
    if variant in counted_work.SAME:
        counted_work.check(variant, found, case, RECORD_BYTES)
    if variant == "persistent":
        counted_work.check_persistent(found, case, RECORD_BYTES)
    if "early_z" in has:
        assert counted(name, variant, {"early_z": 1})["fragments"] <= found["fragments"]


@pytest.mark.parametrize("name", ["many_small", "guard_band", "mixed"])
@pytest.mark.parametrize("share", [32, 124, 128, 192])
@pytest.mark.parametrize("variant", ["two_stage", "bin_owned"])
def test_rows_are_counted(variant: str, share: int, name: str) -> None:
    """By blocks that draw their triangles together, and by others; of what waits beside rows, what bins and patches test."""
    rows = {"few": 0} if variant == "bin_owned" else {"rows": 1}
    found, case = counted(name, variant, {**rows, "share": share, "widest": 64}), case_of(Scene(name))
    every, _ = reference.setup(case.positions, case.triangles, *case.resolution)
    counted_work.check_rows(variant, found, case, every, 64, share <= 124, RECORD_BYTES)


@pytest.mark.parametrize("name", ["behind_camera", "guard_band", "slivers_across"])
@pytest.mark.parametrize(("warps", "region"), [(8, 4), (16, 16)])
def test_patches_are_counted(warps: int, region: int, name: str) -> None:
    found, case = counted(name, "bin_owned", {"few": EVERY, "warps": warps, "region": region}), case_of(Scene(name))
    every, _ = reference.setup(case.positions, case.triangles, *case.resolution)
    counted_work.check_few(found, case, every, warps, region)


@pytest.mark.parametrize("variant", COUNTED)
def test_the_map_is_the_reference_s(variant: str) -> None:
    """Fragments pixel by pixel. Of blocks, whose number and share the device decides, the sum."""
    has = native.REGISTRY[DEVICE]["exact"][variant].parameters
    early = "early_z" in has
    case = case_of(Scene("mixed"))
    work = mapped("mixed", variant, {"early_z": 0} if early else {})
    offered = map_work(*case, variant="scanline", backend="reference").fragments
    assert variant in HIDE or np.array_equal(work.fragments, offered)
    assert work.edges is None
    of = work.counters
    assert work.tasks.sum() == of["work"] == of["fragments"] == work.by_tile().sum()
    assert (len(work.tasks), work.tasks[0]) == (of["tasks"], of["most_work"])
    assert (np.diff(work.tasks) <= 0).all() and work.tasks[-1] > 0
    rejecting = mapped("mixed", variant, {"early_z": 1}).fragments if early else work.fragments
    height, width = case.resolution
    seen = bigtri.rasterize(*case).triangle >= 0
    assert (rejecting <= offered).all() and (rejecting[:height, :width][seen] > 0).all()


def test_a_map_of_many_blocks() -> None:
    """More than there is room for at first: a block for each triangle."""
    case = case_of(Scene("mixed"))
    records, _ = reference.setup(case.positions, case.triangles, *case.resolution)
    all_small = np.zeros((0, 3), np.int32), np.zeros(0, np.int64), np.arange(len(records.xy), dtype=np.int32)
    record, _, lower, upper = reference.scanline(records, *all_small).T
    wanted = np.bincount(records.triangle[record], upper - lower, len(case.triangles)).astype(np.int64)
    work = mapped("mixed", "batched", {"batch": 1, "search": 32})
    assert len(work.tasks) > 1024 and np.array_equal(work.tasks, np.sort(wanted[wanted > 0])[::-1])


def test_views_are_counted_together() -> None:
    one, case = counted("mixed", "scanline", {}), case_of(Scene("mixed"))
    views = np.stack([case.positions] * 3)
    three = counters.count(views, *case[1:], variant="scanline", device=DEVICE, backend="native")
    fixed = [name for name, counter in native.COUNTERS.items() if counter.depends != "order"]
    assert {name: three.get(name, 0) for name in fixed} == {name: 3 * one.get(name, 0) for name in fixed}
    counted_work.check_order("scanline", three, case, views=3)


def test_what_is_not_counted_is_named() -> None:
    counted("mixed", "scanline", {})
    assert native.counting_on_cuda() == [*COUNTED]
    with pytest.raises(RuntimeError, match="precision must be 'exact' on CUDA, .* got 'fast'"):
        counters.count(*case_of(Scene("mixed")), variant="bin_owned", precision="fast", device=DEVICE, backend="native")


def test_pictures_of_the_work(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of variants whose kernels count."""
    pytest.importorskip("matplotlib")
    counted("mixed", "scanline", {})
    options = ["--device", DEVICE, "--size", "96x64", "--seconds", "0", "--variants", "bin_owned,scanline,tile_owned"]
    assert cli.main(["compare", "S3", *options, "--plots", str(tmp_path)]) == 0
    assert capsys.readouterr().out.splitlines()[-3:] == [str(tmp_path / f"{name}.png") for name in ("work", "overdraw", "load")]


def test_a_graph_cannot_capture_the_map() -> None:
    counted("mixed", "scanline", {})
    case, graph = case_of(Scene("mixed")), torch.cuda.CUDAGraph()
    (height, width), names = case.resolution, native.COUNTERS
    given = [torch.from_numpy(array).to(DEVICE) for array in (case.positions, case.triangles)]
    padded = 64 * -(-height // 64), 64 * -(-width // 64)
    shapes = (height, width), (), (len(names),), padded, (0,), (9,)
    to = [torch.zeros(shape, dtype=torch.int64, device=DEVICE) for shape in shapes]
    how = height, width, "none", [0, 0, width, height], "scanline", "exact", []
    with pytest.raises(RuntimeError, match="bigtri::map_work: a CUDA graph cannot capture it"), torch.cuda.graph(graph):
        to[0].zero_()  # which it can
        torch.ops.bigtri.map_work.default(*given, *how, *to)


def test_the_tuner_draws_the_same_bits() -> None:
    """It raises where a way that it tries draws others."""
    case = case_of(Scene("mixed"))
    positions, triangles = (torch.from_numpy(array).to(DEVICE) for array in (case.positions, case.triangles))
    found = tune.tune(tune.Job("mixed", positions, triangles, case.resolution), 0.05)
    assert found.ways[0].variant == next(iter(native.REGISTRY[DEVICE]["exact"])) and found.ways[0].ratio == 1
    assert len(found.ways) > 1 and {way.variant for way in found.ways} <= {*native.REGISTRY[DEVICE]["exact"]}
    assert found.threads == 0 and found.isa == ""

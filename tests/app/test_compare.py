"""``bigtri compare``: what it shows of variants that agree, and of one that is broken on purpose."""

from __future__ import annotations

import re

import numpy as np
import pytest
import torch
import trimesh

import bigtri
from bigtri import native
from bigtri.app import cli
from bigtri.app import compare as command
from bigtri.check import counters, verify
from bigtri.reference.numerics import BACKGROUND
from bigtri.study import accuracy, compare

pytestmark = pytest.mark.skipif(not native.available(), reason="the extension is not built")
VARIANTS = native.VARIANTS.get("cpu", ())


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "box.glb"
    trimesh.creation.box().export(path)
    return path


def column(text: str, name: str) -> dict[str, str]:
    """Of the table of times, what stands under a word of its header, by variant."""
    header, *lines = [line for line in text.splitlines() if line.partition(" ")[0] in ("variant", *VARIANTS)]
    return {line.split()[0]: line.split()[header.replace("median ms", "median").split().index(name)] for line in lines}


def test_every_variant_is_in_the_table(capsys):
    assert cli.main(["compare", "ties", "--seconds", "0"]) == 0
    printed = capsys.readouterr().out
    assert column(printed, "equal") == dict.fromkeys(VARIANTS, "yes")
    assert "ties, 24 triangles, 256x256 px, exact" in printed and native.isa() in printed
    for low, middle, high in zip(*(column(printed, name).values() for name in ("min", "median", "p75")), strict=True):
        assert 0 < float(low) <= float(middle) <= float(high)
    case = accuracy.case("ties", 0, 0)
    for variant in VARIANTS:
        for name, n in counters.count(*case[3:5], (256, 256), variant=variant).items():
            assert re.search(rf"^{name} .*\b{n:,}\b", printed, re.M), (variant, name)


def test_those_that_are_named_alone(capsys):
    options = ["--variants", "two_stage,bin_owned", "--precision", "subpixel4", "--isa", "baseline", "--threads", "1"]
    assert cli.main(["compare", "S3", "--size", "96x64", "--seconds", "0", *options]) == 0
    printed = capsys.readouterr().out
    assert column(printed, "equal") == {"two_stage": "yes", "bin_owned": "yes"}
    assert "S3, 32 triangles, 96x64 px, subpixel4, 1 threads, baseline" in printed


def test_variants_of_one_s_own(tmp_path, capsys):
    """A file registers them; one agrees, one does not, and both stand beside the extension's."""
    (tmp_path / "own.py").write_text(
        "import bigtri\n"
        "from bigtri import reference\n"
        "bigtri.register_stage('depth', variant='right')(reference.depth)\n"
        "bigtri.register_stage('scanline', variant='wrong')(lambda *given: reference.scanline(*given)[1:])\n"
    )
    try:
        options = ["S3", "--size", "96x64", "--seconds", "0", "--load", str(tmp_path / "own.py")]
        assert cli.main(["compare", *options]) == 1
        printed = capsys.readouterr().out
        assert cli.main(["compare", *options, "--variants", "right"]) == 0
    finally:
        for name in bigtri.registered_variants():
            bigtri.unregister_variant(name)
    table = [line for line in printed.splitlines() if re.match(r"(right|wrong) ", line)]
    assert [(line.split()[0], line.split()[-1]) for line in table] == [("right", "yes"), ("wrong", "NO")]
    assert re.search(r"^wrong:\n  stage scanline, pixels? .*: not covered by triangle \d+, covered expected$", printed, re.M)
    assert column(printed, "equal") == dict.fromkeys(VARIANTS, "yes")


def test_a_model_is_seen_as_render_sees_it(model, capsys, monkeypatch):
    jobs = []
    monkeypatch.setattr(compare, "compare", lambda job, *_: jobs.append(job) or [])
    monkeypatch.setattr(command, "table", lambda rows: "")
    for options in (
        [],
        ["--azimuth", "80", "--elevation", "-10", "--orthographic"],
        ["--tight", "--near", "1", "--cull", "back"],
    ):
        assert cli.main(["compare", str(model), "--size", "64x48", *options]) == 0
    assert len({job.positions.tobytes() for job in jobs}) == 3
    assert all((job.positions.shape[1], job.resolution, len(job.triangles)) == (4, (48, 64), 12) for job in jobs)
    orthographic = jobs[1].positions[:, 3]
    assert (orthographic == orthographic[0]).all() and jobs[2].cull == "back"


def broken(monkeypatch, variant, change):
    """From now on the study gets another picture of one variant."""
    real = compare.rasterize

    def drawn(*given, **how):
        seen = real(*given, **how)
        if how.get("variant") == variant:
            change(seen)
        return seen

    monkeypatch.setattr(compare, "rasterize", drawn)


CHANGES = {
    "a pixel is lost": (
        lambda seen: seen.packed[70, 131].fill_(BACKGROUND),
        r"stage rasterize, pixel \(131, 70\) in tile \(0, 0\) of bin \(2, 1\): background, triangle \d+ at depth \S+ expected",
    ),
    "a triangle is counted as dropped": (
        lambda seen: seen.dropped.add_(1),
        "stage rasterize, 1 triangle dropped, 0 expected",
    ),
    "the depth image alone is wrong": (
        lambda seen: seen.depth[70, 131].fill_(0.75),
        r"stage rasterize, pixel \(131, 70\) in tile .*, but 0.75 in the depth image, \S+ expected",
    ),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_broken_variant_is_named_with_the_place(name, monkeypatch, capsys):
    change, sentence = CHANGES[name]
    broken(monkeypatch, "scanline", change)
    assert cli.main(["compare", "ties", "--seconds", "0"]) == 1
    printed = capsys.readouterr().out
    assert column(printed, "equal") == {v: "NO" if v == "scanline" else "yes" for v in VARIANTS}
    says = printed.partition("\nscanline:\n")[2]
    assert re.match(rf"  {sentence}\n", says), says
    assert "every stage by itself agrees, so the schedule of variant 'scanline' is at fault" in says


def test_the_stage_at_fault_comes_before_the_pixel(monkeypatch, capsys):
    """A bin that is rejected wrongly, and the picture that comes of it."""
    real = verify.one_stage.binning

    def binning(*given, backend, **how):
        bins = real(*given, backend=backend, **how)
        kept = bins.kept.copy()
        kept[np.flatnonzero(kept)[:1]] = backend == "reference"
        return bins._replace(kept=kept)

    monkeypatch.setattr(verify.one_stage, "binning", binning)
    broken(monkeypatch, "two_stage", lambda seen: seen.packed[:64, :64].fill_(BACKGROUND))
    assert cli.main(["compare", "S3", "--size", "200x150", "--variants", "bin_owned,two_stage", "--seconds", "0"]) == 1
    says = capsys.readouterr().out.partition("\ntwo_stage:\n")[2].splitlines()
    assert re.match(r"  stage binning, triangle \d+, bin \(\d, \d\): rejected, kept expected$", says[0])
    assert re.match(r"  stage rasterize, pixel \(\d+, \d+\) in tile \(\d, \d\) of bin \(0, 0\): background", says[1])
    assert len(says) == 2  # no schedule is blamed


def test_a_pixel_that_is_not_written_shows(monkeypatch):
    """Memory holds no earlier picture that would hide it."""
    real = compare.rasterize

    def drawn(*given, out=None, depth_out=None, **how):
        seen = real(*given, **how)
        if out is None:
            return seen
        out[1:], depth_out[1:] = seen.packed[1:], seen.depth[1:]
        return seen._replace(packed=out, depth=depth_out)

    monkeypatch.setattr(compare, "rasterize", drawn)
    case = accuracy.case("ties", 0, 0)
    (row,) = compare.compare(compare.Job(case.positions, case.triangles, (256, 256)), ["scanline"], 0)
    assert "pixel (0, 0) in tile (0, 0) of bin (0, 0): 0xffffffffffffffff (no triangle with a depth)" in row.differences[0]


def test_a_rung_that_is_not_counted_has_no_counters(monkeypatch):
    def refuse(*_, **__):
        raise RuntimeError("counters must be None")

    monkeypatch.setattr(compare.counters, "count", refuse)
    case = accuracy.case("ties", 0, 0)
    (row,) = compare.compare(compare.Job(case.positions, case.triangles, (256, 256)), ["two_stage"], 0)
    assert row.counters == {} and row.differences == [] and "records" not in command.table([row])


def test_plots(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    options = ["--size", "96x64", "--seconds", "0", "--variants", "scanline,recursive_descent", "--plots", str(tmp_path / "new")]
    assert cli.main(["compare", "S3", *options]) == 0
    paths = [str(tmp_path / "new" / f"{name}.png") for name in ("work", "overdraw", "load")]
    assert capsys.readouterr().out.splitlines()[-3:] == paths
    assert sorted(map(str, (tmp_path / "new").iterdir())) == sorted(paths)


@pytest.mark.usefixtures("no_matplotlib")
def test_plots_without_matplotlib(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(compare, "compare", lambda *_: pytest.fail("drawn"))
    assert cli.main(["compare", "ties", "--plots", str(tmp_path)]) == 1
    assert "bigtri compare: --plots needs matplotlib, which is not installed: pip install" in capsys.readouterr().err


def test_plots_where_nothing_counts_on_cuda(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(native.REGISTRY, "cuda", native.REGISTRY["cpu"])
    monkeypatch.setattr(native, "counting_on_cuda", lambda: [])
    with pytest.raises(SystemExit):
        cli.main(["compare", "ties", "--device", "cuda", "--plots", str(tmp_path)])
    assert "--plots with --device cuda needs the extension built with BIGTRI_CUDA_COUNTING=1" in capsys.readouterr().err


def test_plots_of_what_is_not_counted(tmp_path, capsys, monkeypatch):
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(compare, "compare", lambda *_: pytest.fail("timed"))
    (tmp_path / "own.py").write_text("import bigtri\nbigtri.register_variant('mine')(lambda *_, **__: None)\n")
    options = ["compare", "ties", "--plots", str(tmp_path / "new")]
    try:
        with pytest.raises(SystemExit):
            cli.main([*options, "--load", str(tmp_path / "own.py"), "--variants", "mine"])
    finally:
        for name in bigtri.registered_variants():
            bigtri.unregister_variant(name)
    assert "--plots must be given with a variant of the extension, which counts its work" in capsys.readouterr().err
    for rung in native.REGISTRY["cpu"]:
        if len(native.REGISTRY["cpu"][rung]) == 1:  # of the ladder, where it is built
            assert cli.main([*options, "--precision", rung]) == 1
            assert f"precision must be one whose variants count, got '{rung}'" in capsys.readouterr().err
            break
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["S9"], "SCENE must be a model file or one of R4k, "),
        (["S2", "--azimuth", "3"], "--azimuth must be given with a model file, got the scene S2"),
        (["S1", "--size", "8x8"], "size must have room for"),
        (["ties", "--variants", "fast"], "variant must be one of bin_owned, "),
        (["ties", "--isa", "mmx"], "instruction set must be one of "),
        (["ties", "--precision", "best"], "argument --precision: invalid choice: 'best'"),
        (["{model}", "--tight", "--distance", "2"], "--distance must not be given with --tight"),
        (["{model}", "--camera", "0"], "--camera must be one of the file's 0, from 0, got 0"),
    ],
)
def test_a_wrong_command_line_draws_nothing(model, options, text, capsys, monkeypatch):
    monkeypatch.setattr(compare, "compare", lambda *_: pytest.fail("drawn"))
    with pytest.raises(SystemExit) as stopped:
        cli.main(["compare", *(option.format(model=model) for option in options)])
    assert stopped.value.code == 2
    assert text in capsys.readouterr().err


def test_a_file_that_is_not_there(capsys):
    assert cli.main(["compare", "nowhere.glb"]) == 2
    assert "no such file: nowhere.glb" in capsys.readouterr().err


@pytest.mark.skipif("cuda" in native.REGISTRY and torch.cuda.is_available(), reason="there is CUDA")
def test_no_device(capsys):
    with pytest.raises(SystemExit):
        cli.main(["compare", "ties", "--device", "cuda"])
    assert "--device must be one of cpu, as the extension is built here, got cuda" in capsys.readouterr().err

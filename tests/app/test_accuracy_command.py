"""`bigtri accuracy`: what it writes, what it says, and how it fails. Nothing here asserts a time."""

from __future__ import annotations

import csv
import dataclasses
from pathlib import Path

import pytest
import trimesh

from bigtri import native
from bigtri.app import accuracy as command
from bigtri.app import cli
from bigtri.study import accuracy

needs_extension = pytest.mark.skipif(not native.available(), reason="the extension is not built")
FEW = ["--quick", "--seconds", "0", "--precision", "subpixel4"]


@needs_extension
def test_rows_in_a_file_and_on_the_screen(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, model = tmp_path / "rows.csv", tmp_path / "box.ply"
    trimesh.creation.box().export(model)
    options = [*FEW, "--scenes", "ties,R4k", "--model", str(model), "--size", "96x64,64x64", "--csv", str(path)]
    assert cli.main(["accuracy", *options]) == 0
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == [field.name for field in dataclasses.fields(accuracy.Row)]
    cases = ["ties 256x256", "R4k 96x64", "box.ply 96x64", "R4k 64x64", "box.ply 64x64"]
    assert list(dict.fromkeys(f"{row['scene']} {row['width']}x{row['height']}" for row in rows)) == cases
    assert [row["precision"] for row in rows[:3]] == ["exact", accuracy.CONTROL, "subpixel4"]
    assert float(rows[0]["wrong_ppm"]) == 0 and rows[1]["wrong_ppm"] == "" and rows[0]["isa"] == native.isa()
    printed = capsys.readouterr().out
    assert "box.ply, 12 triangles, 96x64 px, two_stage, 1 threads" in printed and "subpixel4" in printed


@needs_extension
def test_errors_of_an_earlier_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """They are taken from the rows of the same scenes, and rows that have none are counted."""
    first, second = tmp_path / "first.csv", tmp_path / "second.csv"
    size = ["--size", "96x64"]
    assert cli.main(["accuracy", *FEW, *size, "--scenes", "R4k", "--csv", str(first)]) == 0
    assert cli.main(["accuracy", *FEW, *size, "--scenes", "R4k,R16k", "--errors", str(first), "--csv", str(second)]) == 0
    with first.open(newline="") as one, second.open(newline="") as two:
        wanted, got = list(csv.DictReader(one)), list(csv.DictReader(two))
    for a, b in zip(wanted, got, strict=False):
        assert [a[name] for name in accuracy.ERRORS] == [b[name] for name in accuracy.ERRORS]
    assert any(row["wrong_ppm"] for row in wanted) and not any(row["wrong_ppm"] for row in got[len(wanted) :])
    assert f"{first} has no errors of {len(wanted)} rows of R16k, 96x64 px" in capsys.readouterr().err
    for text in ("a,b\n1,2\n", ""):
        second.write_text(text)
        with pytest.raises(SystemExit):
            cli.main(["accuracy", *FEW, "--errors", str(second)])
        assert "--errors must be a CSV that bigtri accuracy wrote, got" in capsys.readouterr().err


@pytest.mark.parametrize("options", [[], ["--quick"]])
def test_what_is_drawn_unless_told_fits_the_size_that_it_has_unless_told(options: list[str]) -> None:
    parser = command.parser("bigtri accuracy")
    assert command._cases(parser, parser.parse_args(options))


@needs_extension
def test_rungs_that_are_not_built_are_named(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(accuracy.Setting, "rungs", lambda _: ["exact", "subpixel4"])
    assert command.main(["--quick", "--seconds", "0", "--scenes", "ties"]) == 0
    said = capsys.readouterr()
    assert "not measured, as the extension is built here: " in said.err and "coverage_float32" in said.err
    assert "BIGTRI_LADDER=1" in said.err and "coverage_float32" not in said.out


@needs_extension
@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["--scenes", "S99"], "scene must be one of ties, "),
        (["--scenes", "S1", "--size", "10x10"], "which is too small"),
        (["--precision", "none"], "precision must be one of exact, "),
        (["--variant", "none"], "--variant must be one that 'exact' has on cpu, got 'none'"),
        (
            ["--variant", "bin_owned", "--precision", "depth_stored16"],
            "precision must be one of exact, balanced, fast, subpixel4",
        ),
        (["--isa", "none"], "instruction set must be one of"),
        (["--device", "none"], "argument --device: invalid choice"),
        (["--errors", "{folder}/none"], "--errors: [Errno 2] No such file"),
        (["--csv", "{folder}"], "argument --csv: must be a file, got the folder"),
    ],
)
def test_a_wrong_command_line_measures_nothing(
    options: list[str], text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(accuracy, "study", lambda *_: pytest.fail("measured"))
    with pytest.raises(SystemExit) as stopped:
        command.main([option.format(folder=tmp_path) for option in options])
    assert stopped.value.code == 2
    assert text in capsys.readouterr().err


def test_a_device_that_is_not_built(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(native, "REGISTRY", {"cpu": native.REGISTRY.get("cpu", {})})
    monkeypatch.setattr(native, "available", lambda: True)
    with pytest.raises(SystemExit):
        command.main(["--device", "cuda"])
    assert "--device must be one of cpu, as the extension is built here, got cuda" in capsys.readouterr().err


@pytest.mark.usefixtures("no_matplotlib")
def test_plots_without_matplotlib(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(accuracy, "study", lambda *_: pytest.fail("measured"))
    assert cli.main(["accuracy", "--quick", "--plots", str(tmp_path)]) == 1
    assert capsys.readouterr().err == (
        "bigtri accuracy: --plots needs matplotlib, which is not installed: pip install 'bigtri[bench]' brings it\n"
    )


@needs_extension
def test_plots(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    rungs = "subpixel4,depth_stored16,attributes_affine"
    if not set(rungs.split(",")) <= set(native.REGISTRY["cpu"]):
        pytest.skip("the ladder is not built")
    options = ["--quick", "--seconds", "0", "--scenes", "floor", "--precision", rungs, "--plots", str(tmp_path / "plots")]
    assert command.main(options) == 0
    drawn = {path.stem for path in (tmp_path / "plots").iterdir()}
    assert {"costs", "wrong_pixels", "depth", "attributes"} <= drawn <= {"costs", "wrong_pixels", "cracks", "depth", "attributes"}


@needs_extension
def test_breaks(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    from bigtri.study import breaks

    monkeypatch.setattr(breaks, "BREAKS", {"subpixel4": breaks.BREAKS["subpixel4"]})
    assert command.main(["--breaks", str(tmp_path / "new")]) == 0
    assert capsys.readouterr().out.split() == [str(tmp_path / "new" / "subpixel4.png")]

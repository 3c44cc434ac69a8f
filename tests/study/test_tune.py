"""`bigtri tune`: what is tried, what is kept where, and how it goes."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from backends import needs_native
from cases import CASES

import bigtri
from bigtri import machine, native
from bigtri.app import cli
from bigtri.ops import tuned
from bigtri.study import tune

pytestmark = needs_native
STANDARD = next(iter(native.VARIANTS.get("cpu", ("",))))
CASE = CASES["screen_size"](np.random.default_rng(1))


def job(**changes) -> tune.Job:
    return tune.Job("case", torch.from_numpy(CASE.positions), torch.from_numpy(CASE.triangles), CASE.resolution)._replace(
        **changes
    )


def parameter(standard: int, low: int, high: int, only: tuple[int, ...] = ()) -> native.Parameter:
    return native.Parameter("p", "", "", standard, low, high, only)


@pytest.mark.parametrize(
    ("which", "here", "values"),
    [
        (parameter(64, 1, 4096), 64, [[256, 1024, 4096], [16, 4, 1]]),
        (parameter(100, 10, 300), 100, [[], [25]]),
        (parameter(3, 2, 3), 3, [[2]]),  # all, where there are few
        (parameter(0, 0, 16, (0, 4, 8, 16)), 8, [[0], [4], [16]]),
        (parameter(0, 0, 1 << 20), 0, [[64], [256], [1024]]),
        (parameter(0, 0, 100), 0, [[64]]),
    ],
)
def test_values_that_are_tried(which, here, values):
    assert tune.lines(which, here) == values


def test_every_way_that_is_tried_may_be_given():
    for name, variant in native.REGISTRY["cpu"]["exact"].items():
        start = tune.Setting(name)
        for each in variant.parameters.values():
            for value in sum(tune.lines(each, start.given(each)), []):
                there = start.changed(each, value)
                assert native.parameter_values("tune", variant, dict(there.parameters))
                assert there.given(each) == value and there.changed(each, each.standard) == start


@pytest.fixture
def clock(monkeypatch):
    """Times by a formula in place of a clock; a way draws once for each time."""
    cost = {}

    def interleaved(calls, seconds, at_least, device):
        times = {}
        for name, call in calls.items():
            call()
            setting = call.args[0]
            times[name] = [cost["of"](setting.variant, dict(setting.parameters))] * at_least
        return times

    monkeypatch.setattr(tune, "interleaved", interleaved)
    return cost


def test_steps_go_on_for_as_long_as_they_gain(clock):
    clock["of"] = lambda variant, given: (
        {"two_stage": 0.8}.get(variant, 1.0 if variant == STANDARD else 3.0)
        * (1 + abs(np.log2(given.get("share", 256) / 4096)) / 4 * (variant == "two_stage"))
    )
    found = tune.tune(job(), 0)
    assert found.ways[0] == tuned.Way(STANDARD, {}, 1000.0, 1.0)
    two_stage = [way for way in found.ways if way.variant == "two_stage"]
    assert min(two_stage, key=lambda way: way.us).parameters["share"] == 4096
    assert "scanline" in {way.variant for way in found.ways}  # the time of it, though it has lost
    assert not any(way.parameters for way in found.ways if way.variant == "scanline")


def test_the_standard_way_is_there_although_it_is_slowest(clock):
    clock["of"] = lambda variant, given: 3.0 if (variant, given) == (STANDARD, {}) else 1.0
    found = tune.tune(job(), 0)
    assert found.ways[0][:2] == (STANDARD, {})
    assert len(found.ways) == max(1 + tune.FINALISTS, len(native.VARIANTS["cpu"]))
    assert all(way.ratio == pytest.approx(1 / 3) for way in found.ways[1:])


def test_three_of_four_rounds_count(monkeypatch):
    """A way that is ahead in every second round has gained nothing: its neighbours have rested."""

    def interleaved(calls, seconds, at_least, device):
        now_and_then = np.array([0.5, 1.0, 0.5, 1.0, 0.5, 1.0, 0.5, 1.0, 0.5])
        times = {}
        for name, call in calls.items():
            call()
            other = call.args[0] != tune.Setting(STANDARD)
            times[name] = now_and_then if other else np.ones(9)
        return times

    monkeypatch.setattr(tune, "interleaved", interleaved)
    found = tune.tune(job(), 0)
    assert {way.ratio for way in found.ways} == {1.0} and {way.us for way in found.ways[1:]} == {500.0}
    assert tuned.best([found]) is None


def test_a_way_that_draws_other_bits_is_a_defect(clock, monkeypatch):
    clock["of"] = lambda variant, given: 1.0
    real = tune._Search.picture

    def picture(search, setting):
        image = real(search, setting)
        if setting.variant == "scanline":
            image[0, 0] += 1
        return image

    monkeypatch.setattr(tune._Search, "picture", picture)
    with pytest.raises(RuntimeError, match="variant 'scanline' with .* has drawn other bits, which is a defect"):
        tune.tune(job(), 0)


def test_a_way_that_finds_no_memory_is_left_out(clock, monkeypatch):
    clock["of"] = lambda variant, given: 1.0
    real = tune._Search.picture

    def picture(search, setting):
        if setting.variant == "two_stage":
            raise RuntimeError("out of memory")
        return real(search, setting)

    monkeypatch.setattr(tune._Search, "picture", picture)
    assert "two_stage" not in {way.variant for way in tune.tune(job(), 0).ways}


def test_what_is_kept_says_what_was_measured(clock):
    clock["of"] = lambda variant, given: 1.0
    views = torch.from_numpy(np.stack([CASE.positions] * 3))
    found = tune.tune(job(positions=views), 0)
    height, width = CASE.resolution
    assert found[:-2] == (
        "case", "exact", width, height, 3, len(CASE.triangles), torch.get_num_threads(), native.isa(),
    )  # fmt: skip


@pytest.fixture
def path(tmp_path, monkeypatch):
    monkeypatch.setenv("BIGTRI_TUNING", str(tmp_path / "tuning.json"))
    yield tmp_path / "tuning.json"
    bigtri.stop_tuning()


def test_the_command(clock, path, capsys):
    """Measures, keeps, shows, is used, forgets."""
    clock["of"] = lambda variant, given: 0.5 if variant == "scanline" and not given else 1.0
    assert cli.main(["tune", "S1", "R4k", "--size", "320x240,640x480", "--seconds", "0"]) == 0
    said = capsys.readouterr().out
    assert "a view has 8 records, 8 of them large, in " in said
    assert "S1, 8 triangles, 640x480 px, 1 view, exact" in said and "0.500  scanline  <- taken" in said
    assert f"kept in {path}; bigtri.use_tuning() reads it, bigtri tune --forget removes it" in said
    (measured,) = tuned.read(path).measured.values()
    assert [(each.scene, each.width) for each in measured] == [("S1", 320), ("S1", 640), ("R4k", 320), ("R4k", 640)]
    assert bigtri.use_tuning() == 4

    # The same again takes the place of the first; another scene is added.
    assert cli.main(["tune", "S1", "--size", "320x240", "--seconds", "0"]) == 0
    assert cli.main(["tune", "S1", "--size", "320x240", "--seconds", "0", "--views", "2"]) == 0
    (measured,) = tuned.read(path).measured.values()
    assert [(each.scene, each.width, each.views) for each in measured][3:] == [("S1", 320, 1), ("S1", 320, 2)]
    capsys.readouterr()

    assert cli.main(["tune", "--list", "R4k"]) == 0
    said = capsys.readouterr().out
    assert machine.cpu_name() in said and "R4k, 4072 triangles, 640x480 px" in said and "S1" not in said
    assert cli.main(["tune", "--forget", "R4k"]) == 0
    assert "2 measurements removed" in capsys.readouterr().out
    assert len(tuned.read(path).measured[machine.cpu_name()]) == 3
    assert cli.main(["tune", "--forget"]) == cli.main(["tune", "--forget"]) == 0
    assert not path.exists()
    assert cli.main(["tune", "--list"]) == 0
    assert "is not there" in capsys.readouterr().out


def test_another_build_s_measurements_are_dropped(clock, path, capsys):
    clock["of"] = lambda variant, given: 1.0
    assert cli.main(["tune", "S1", "--size", "320x240", "--seconds", "0"]) == 0
    file = tuned.read(path)
    tuned.write(path, file._replace(builds={machine.cpu_name(): "old", "other": "older"}, measured=file.measured | {"other": []}))
    assert cli.main(["tune", "S2", "--size", "320x240", "--seconds", "0"]) == 0
    assert "of another build is dropped" in capsys.readouterr().out
    assert [each.scene for each in tuned.read(path).measured[machine.cpu_name()]] == ["S2"]
    assert tuned.read(path).builds == {machine.cpu_name(): tuned.build("cpu"), "other": "older"}


def test_a_broken_file_is_not_written_over(path, capsys):
    path.write_text("{")
    for words in (["S1"], ["--list"], ["--forget", "S1"]):
        assert cli.main(["tune", *words]) == 2
        assert "remove it by --forget" in capsys.readouterr().err
    assert path.read_text() == "{"
    assert cli.main(["tune", "--forget"]) == 0


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ([], "give a SCENE, --list or --forget"),
        (["--list", "--forget"], "give one of them"),
        (["S99"], "SCENE must be a model file or one of"),
        (["S1", "--azimuth", "3"], "--azimuth must be given with a model file"),
        (["S1", "--views", "0"], "must be a whole number from 1"),
        (["S1", "--device", "gpu"], "invalid choice: 'gpu'"),
    ],
)  # fmt: skip
def test_what_cannot_be_measured(path, words, text, capsys):
    with pytest.raises(SystemExit, match="2"):
        cli.main(["tune", *words])
    assert text in capsys.readouterr().err
    assert not path.exists()


def test_it_measures_with_the_real_clock(path, capsys):
    assert cli.main(["tune", "S1", "--size", "320x240", "--seconds", "0.01", "--threads", "1"]) == 0
    (measured,) = tuned.read(path).measured[machine.cpu_name()]
    assert measured.threads == 1 and measured.ways[0].variant == STANDARD and all(way.us > 0 for way in measured.ways)

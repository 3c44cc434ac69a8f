"""What ``use_tuning`` reads: which call is drawn in which way, what file is not used, and that no bit changes."""

from __future__ import annotations

import json
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
import torch
from backends import needs_native
from cases import CASES

import bigtri
from bigtri import machine, native, warn
from bigtri.ops import rasterize as module
from bigtri.ops import tuned
from bigtri.ops.tuned import File, Measured, Way

pytestmark = needs_native
STANDARD, *OTHERS = native.VARIANTS.get("cpu", ("", ""))
CASE = CASES["screen_size"](np.random.default_rng(1))
HEIGHT, WIDTH = CASE.resolution
FAST = Way("scanline", {"share": 64}, 50.0, 0.5)
SLOW = Way(STANDARD, {}, 100.0, 1.0)


@pytest.fixture(autouse=True)
def nothing_stays():
    threads = torch.get_num_threads()
    warn._said.clear()
    yield
    bigtri.stop_tuning()
    torch.set_num_threads(threads)


def measured(ways=(SLOW, FAST), **changes) -> Measured:
    return Measured(
        **{
            "scene": "a",
            "precision": "exact",
            "width": WIDTH,
            "height": HEIGHT,
            "views": 1,
            "triangles": len(CASE.triangles),
            "threads": torch.get_num_threads(),
            "isa": native.isa(),
            "date": "2026-01-02",
            "ways": list(ways),
        }
        | changes
    )


def written(path: Path, *scenes: Measured, name: str | None = None, build: str | None = None) -> Path:
    name = name or machine.cpu_name()
    tuned.write(path, File({name: build or tuned.build("cpu")}, {name: list(scenes)}))
    return path


@pytest.fixture
def drawn(monkeypatch):
    """The variant and the values of its parameters of every call of the operators."""
    seen = []
    real, real_new, real_into = torch.ops.bigtri.rasterize.default, module._rasterize_new, module._rasterize_into

    class Operator:
        @staticmethod
        def default(*given):
            seen.append((given[6], given[9]))
            return real(*given)

    def new(*given):
        seen.append((STANDARD, []))
        return real_new(*given)

    def into(*given):
        seen.append((STANDARD, []))
        return real_into(*given)

    class Operators:
        rasterize = Operator

    class Torch:
        class ops:  # noqa: N801
            bigtri = Operators

        def __getattr__(self, name):
            return getattr(torch, name)

    monkeypatch.setattr(module, "torch", Torch())
    monkeypatch.setattr(module, "_rasterize_new", new)
    monkeypatch.setattr(module, "_rasterize_into", into)
    return seen


def draw(positions=CASE.positions, resolution=CASE.resolution, **options):
    return bigtri.rasterize(positions, CASE.triangles, resolution, backend="native", **options)


def test_auto_takes_what_was_found_and_draws_the_same_bits(tmp_path, drawn):
    expected = draw()
    assert bigtri.use_tuning(written(tmp_path / "tuning.json", measured())) == 1
    for out in (None, np.empty(CASE.resolution, np.int64)):
        seen = draw(out=out)
        assert np.array_equal(seen.packed, expected.packed) and np.array_equal(seen.depth, expected.depth)
    draw(validate=True)  # another way through the function
    bigtri.stop_tuning()
    draw()
    assert drawn == [(STANDARD, []), *[("scanline", [64])] * 3, (STANDARD, [])]


def test_nothing_is_read_unless_it_is_asked_for(tmp_path, monkeypatch, drawn):
    monkeypatch.setenv("BIGTRI_TUNING", str(written(tmp_path / "tuning.json", measured())))
    draw()
    assert bigtri.use_tuning() == 1
    draw()
    assert drawn == [(STANDARD, []), ("scanline", [64])]


def test_calls_that_are_not_like_what_was_measured(tmp_path, drawn):
    bigtri.use_tuning(written(tmp_path / "tuning.json", measured()))
    draw(resolution=(2 * HEIGHT, 2 * WIDTH))
    draw(np.stack([CASE.positions] * 2))
    bigtri.rasterize(CASE.positions, np.tile(CASE.triangles, (4, 1)), CASE.resolution)
    draw(precision="subpixel4")
    draw(variant=STANDARD)
    draw(parameters={})
    torch.set_num_threads(torch.get_num_threads() + 1)
    draw()
    assert {variant for variant, _ in drawn} == {STANDARD} and len(drawn) == 7


def test_batches_have_classes_of_their_own(tmp_path, drawn):
    assert bigtri.use_tuning(written(tmp_path / "tuning.json", measured(views=3))) == 1
    views = np.stack([CASE.positions] * 2)
    expected = draw(variant=STANDARD).packed
    assert np.array_equal(draw(views).packed, np.stack([expected] * 2))
    ranges = np.array([[0, len(CASE.triangles)]] * 3, np.int32)
    draw(ranges=ranges)
    assert [variant for variant, _ in drawn] == [STANDARD, "scanline", "scanline"]


def test_parameters_set_by_hand_win(tmp_path, drawn):
    bigtri.use_tuning(written(tmp_path / "tuning.json", measured()))
    with native.using_parameters(records=1000):
        draw()
    assert drawn[0][0] == STANDARD and 1000 in drawn[0][1]


def test_a_class_takes_what_is_best_at_worst():
    one = measured([SLOW, Way("scanline", {}, 30, 0.3), Way("two_stage", {}, 60, 0.6)])
    other = measured([SLOW, Way("scanline", {}, 90, 0.9), Way("two_stage", {}, 70, 0.7)])
    assert tuned.best([one]).variant == "scanline"
    assert tuned.best([other]).variant == "two_stage"
    assert max(way.ratio for way in [tuned.best([one, other])]) == 0.6
    assert tuned.best([one, measured([SLOW])]) is None  # not measured there
    assert tuned.best([one, measured([SLOW, Way("scanline", {}, 110, 1.1)])]) is None


@pytest.mark.parametrize(("us", "ratio", "worth"), [(90, 0.9, True), (96, 0.96, False), (5, 0.9, False), (12, 0.9, True)])
def test_a_gain_must_be_worth_it(us, ratio, worth):
    """Below 5 % or 1 us it is noise."""
    assert (tuned.best([measured([SLOW, Way("scanline", {}, us, ratio)])]) is not None) == worth


def content(**changes):
    one = measured()._asdict() | {"ways": [SLOW._asdict(), FAST._asdict()]} | changes
    return json.dumps({"format": 1, "machines": {machine.cpu_name(): {"build": tuned.build("cpu"), "measured": [one]}}})


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (None, "No such file or directory"),
        ("", "it is no file of bigtri tune's"),
        ("[]", "it is no file of bigtri tune's"),
        ('{"format": 2}', "its format is 2, 1 expected"),
        ('{"format": 1, "machines": {"x": {"build": 3, "measured": []}}}', "3 is not of its type"),
        (content(width="wide"), "'wide' is not of its type"),
        (content(views=True), "True is not of its type"),
        (content(ways=[SLOW._asdict(), FAST._asdict() | {"us": 0}]), "times must be above 0"),
        (content(ways=[SLOW._asdict(), FAST._asdict() | {"variant": "warp"}]), "there is no variant 'warp'"),
        (content(ways=[SLOW._asdict(), FAST._asdict() | {"parameters": {"share": 0}}]), "parameter share"),
        (content(ways=[SLOW._asdict(), FAST._asdict() | {"parameters": {"size": 1}}]), "got 'size'"),
        (content(ways=[SLOW._asdict(), FAST._asdict() | {"parameters": {"share": 1.5}}]), "1.5 is not of its type"),
    ],
)  # fmt: skip
def test_a_broken_file_is_ignored_with_one_warning(tmp_path, text, why, drawn):
    path = tmp_path / "tuning.json"
    if text is not None:
        path.write_text(text)
    with pytest.warns(RuntimeWarning) as caught:
        assert bigtri.use_tuning(path) == 0
    assert len(caught) == 1 and why in str(caught[0].message)
    assert str(caught[0].message).startswith(f"bigtri.use_tuning: {path} is not used, so everything is drawn in the standard way")
    assert caught[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert bigtri.use_tuning(path) == 0
        draw()
    assert drawn == [(STANDARD, [])]


@pytest.mark.parametrize(
    ("name", "build", "why"),
    [("another", None, "it is about another, here is"), (None, "0.0.1 (0123)", r"it was measured with bigtri 0.0.1 \(0123\)")],
)
def test_another_machine_s_or_build_s_file_is_ignored(tmp_path, name, build, why):
    path = written(tmp_path / "tuning.json", measured(), name=name, build=build)
    with pytest.warns(RuntimeWarning, match=why):
        assert bigtri.use_tuning(path) == 0


def test_another_instruction_set_s_measurements_are_not_used(tmp_path):
    path = written(tmp_path / "tuning.json", measured(isa="none"))
    assert bigtri.use_tuning(path) == 0


def test_a_second_file_takes_the_place_of_the_first(tmp_path, drawn):
    first = written(tmp_path / "first.json", measured())
    second = written(tmp_path / "second.json", measured([SLOW, Way("two_stage", {}, 50, 0.5)]))
    assert bigtri.use_tuning(first) == bigtri.use_tuning(second) == 1
    draw()
    with pytest.warns(RuntimeWarning):
        bigtri.use_tuning(tmp_path / "none.json")
    draw()
    assert [variant for variant, _ in drawn] == ["two_stage", STANDARD]


def test_a_file_comes_back_as_it_was(tmp_path):
    file = File({"a": "1", "b": "2"}, {"a": [measured(), measured(scene="b")], "b": []})
    tuned.write(tmp_path / "new" / "tuning.json", file)
    assert tuned.read(tmp_path / "new" / "tuning.json") == file
    assert [each.name for each in (tmp_path / "new").iterdir()] == ["tuning.json"]


@pytest.mark.parametrize(
    ("platform", "variables", "path"),
    [
        ("linux", {"BIGTRI_TUNING": "/there/is.json"}, "/there/is.json"),
        ("linux", {"XDG_CACHE_HOME": "/cache"}, "/cache/bigtri/tuning.json"),
        ("linux", {}, "/home/me/.cache/bigtri/tuning.json"),
        ("darwin", {}, "/home/me/Library/Caches/bigtri/tuning.json"),
        ("win32", {"LOCALAPPDATA": "/local"}, "/local/bigtri/tuning.json"),
        ("win32", {}, "/home/me/AppData/Local/bigtri/tuning.json"),
    ],
)
def test_where_the_file_is(monkeypatch, platform, variables, path):
    for name in ("BIGTRI_TUNING", "XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(sys, "platform", platform)
    monkeypatch.setattr(Path, "home", lambda: Path("/home/me"))
    assert tuned.default_path() == Path(path)


def test_torch_compile_draws_in_the_standard_way(tmp_path):
    bigtri.use_tuning(written(tmp_path / "tuning.json", measured()))
    positions, triangles = torch.from_numpy(CASE.positions), torch.from_numpy(CASE.triangles)
    graphs = []

    def backend(graph, _):
        graphs.append(graph)
        return graph.forward

    seen = torch.compile(lambda p, t: bigtri.rasterize(p, t, CASE.resolution).packed, backend=backend)(positions, triangles)
    bigtri.stop_tuning()
    assert torch.equal(seen, bigtri.rasterize(positions, triangles, CASE.resolution).packed)
    (call,) = [node for node in graphs[0].graph.nodes if node.target is torch.ops.bigtri.rasterize.default]
    assert STANDARD in call.args and "scanline" not in call.args

"""bench/variants.py: rows that come back as they were, costs that are found again, tables, and predictions that come first."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from bigtri import native
from bigtri.study import clock, meshes, tune

BENCH = Path(__file__).parents[2] / "bench"
if not BENCH.exists():
    pytest.skip("bench/ is not here", allow_module_level=True)
if str(BENCH) not in sys.path:
    sys.path.append(str(BENCH))
variants, rows_of, costs_of, cases_of, tables = map(
    importlib.import_module, ("variants", "variant_rows", "variant_costs", "variant_cases", "variant_tables")
)

pytestmark = pytest.mark.skipif(not native.available(), reason="the extension is not built")
WHERE = {"device": "a CPU", "how": "2 threads", "versions": "1", "commit": "abc", "command": "variants.py"}
PRICES = {"a": {"pixels": 0.5, "fragments": 2.0}, "b": {"triangles": 300.0, "entries": 40.0}}  # ns


def row(
    scene: str, variant: str, us: float, counts: dict[str, int], triangles: int = 10, setting: str = "", part: str = "scenes"
) -> rows_of.Row:
    timing = clock.Timing(us / 1e3, us / 2e3, us / 1e3, us / 1e3, 7)
    return rows_of.Row(part, rows_of.Key(scene, 64, 32), triangles, variant, setting, timing, True, counts, None, WHERE)


def of_prices(seed: int, scenes: int) -> list[rows_of.Row]:
    """Rows of two variants whose times are what `PRICES` says."""
    rng = np.random.default_rng(seed)
    rows = []
    for number in range(scenes):
        triangles = int(rng.integers(10, 1000))
        for variant, prices in PRICES.items():
            counts = {name: int(rng.integers(1, 10_000)) for name in ("fragments", "entries", "atomics")}
            known = {"pixels": 64 * 32, "triangles": triangles} | counts
            ns = sum(price * known[name] for name, price in prices.items())
            rows.append(row(f"R{number}", variant, ns / 1e3, counts, triangles))
    return rows


def test_rows_come_back(tmp_path):
    rows = [row("S1", "a", 5, {"entries": 3, "fragments": 2}), row("S1", "b", 7, {}, setting="share=4", part="parameters")]
    rows[1] = rows[1]._replace(equal=False, scratch=4096)
    rows_of.write(tmp_path / "rows.csv", rows)
    assert rows_of.read(tmp_path / "rows.csv") == rows
    (tmp_path / "other.csv").write_text("scene,width\nS1,3\n")
    with pytest.raises(SystemExit, match="no rows of this script"):
        rows_of.read(tmp_path / "other.csv")


def test_costs_are_found_again():
    rows = of_prices(1, 20)
    for variant, of_it in rows_of.by_variant(rows).items():
        costs = costs_of.fit(of_it)
        for name, ns in zip(costs_of.PAID, costs.ns, strict=True):
            assert ns == pytest.approx(PRICES[variant].get(name, 0), rel=1e-6, abs=1e-9)
        assert all(costs.us(one) == pytest.approx(one.us) for one in of_it)
    tried = costs_of.check(rows)
    assert tried.winners == tried.cases == 20 and tried.ordered == tried.pairs > 10
    assert tried.errors == {"a": pytest.approx(1), "b": pytest.approx(1)}


def test_a_time_that_the_costs_do_not_explain():
    rows = of_prices(2, 20)
    slow = rows[0]._replace(timing=rows[0].timing._replace(median=1e3))
    tried = costs_of.check([slow, *rows[1:]])
    assert tried.winners < 20 and tried.ordered < tried.pairs


def test_a_scene_alone_is_not_tried():
    """Without another one there are no costs that it could be tried with."""
    assert costs_of.check([row("S1", "a", 5, {"entries": 3})]) == costs_of.Check({}, 0, 0, 0, 0)


def test_steps_are_allowed():
    for name, variant in native.REGISTRY["cpu"]["exact"].items():
        for parameter in variant.parameters.values():
            values = cases_of.steps(parameter)
            assert parameter.standard in values and len(values) > 1
            assert all(native.parameter_values("test", variant, {parameter.name: value}) for value in values)
        assert tune.Setting(name) in cases_of.sweep(native.REGISTRY["cpu"]["exact"])


def test_tables_of_scenes():
    rows = [row("S1", "a", 2500, {"entries": 1500}), row("S1", "b", 1000, {"entries": 7, "tasks": 2, "work": 10, "most_work": 8})]
    assert tables.times_table(rows, 64, 32).splitlines()[-1] == "| S1 | 1 | 2.5 | **1** |"
    assert tables.times_table(rows, 64, 32).splitlines()[0] == "| 64x32 | fastest, ms | a | b |"
    a, b = tables.work_table(rows).splitlines()[-2:]
    assert a.startswith("| a | 2.5 | 1.5 k | 0 |") and a.endswith("| 0 |  |")
    assert b.startswith("| b | 1 | 7 |") and b.endswith("| 0 | 1.6 |")
    rows = [
        row("S2", "a", 5, {"bytes": 12_000}),
        row("S2", "b", 5, {"rows": 1}),
        row("S3", "a", 5, {"bytes": 9}),
        row("S9", "a", 5, {}),
    ]
    text = tables.memory_table(rows)
    assert text.splitlines()[-2:] == ["| S2, 64x32 | 12 k | 0 |", "| S3, 64x32 | 9 | - |"] and "that a call stores" in text
    assert tables.memory_table([*rows, row("S5", "a", 5, {})]) == text  # where nobody has counted there is no line
    text = tables.memory_table([one._replace(scratch=2000) for one in rows])
    assert "| S2, 64x32 | 2 k | 2 k |" in text and "the device's allocator" in text


def test_where_the_time_goes(monkeypatch):
    """By the costs that the rows were made of."""
    monkeypatch.setattr(tables, "SIZE", (64, 32))
    monkeypatch.setattr(tables, "SHOWN", "R0,R1")
    rows = of_prices(3, 20)
    lines = tables.shares_table(rows).splitlines()[-2:]
    shares = []
    for one in rows[0], rows[2]:
        parts = {"pixels": 0.5 * 64 * 32, "fragments": 2.0 * one.counters["fragments"]}
        shares.append({name: round(100 * ns / sum(parts.values())) for name, ns in parts.items()})
    wanted = [", ".join(f"{name} {n}" for name, n in sorted(of.items(), key=lambda item: -item[1]) if n >= 5) for of in shares]
    assert lines[0] == f"| a | {wanted[0]} | {wanted[1]} |" and lines[1].startswith("| b | ")
    assert tables.largest(np.array([0, 0, 1.0, 97, 2] + [0] * 6)) == "entries 97"


def test_tables_of_settings():
    def swept(scene: str, us: float, setting: str, stored: int) -> rows_of.Row:
        return row(scene, "a", us, {"bytes": stored}, setting=setting, part="parameters")

    rows = [swept("S1", *each) for each in ((10, "standard", 50), (15, "x=9", 50), (5, "x=10", 2000), (9, "x=11", 3))]
    rows += [swept("S2", *each) for each in ((10, "standard", 50), (11, "x=9", 50))]
    rows += [swept("S1", 11, "y=1", 50)]  # matters little
    few, every = (part.splitlines() for part in tables.parameters(rows).split("\n\n")[3::2])
    assert few == [
        "| variant, 64x32 | parameter | S1 | S2 |",
        "| --- | --: | --: | --: |",
        "| a | `x` | 10: 0.5, 9: 1.5 | 9: 1.1 |",
        "| a | `y` | 1: 1.1 | - |",
    ]
    assert every[2:] == ["| a | `x` | 9 | 1.5 | 1.1 |", "| a | `x` | 10 | 0.5 (2 kB) | - |", "| a | `x` | 11 | 0.9 (3 B) | - |"]
    assert len(tables.parameters([rows[0], rows[-1]]).split("\n\n")) == 4


def test_table_of_global_and_shared_memory():
    def one(scene, setting, us):
        return row(scene, "persistent", us, {}, setting=setting, part="parameters")

    both = [
        one(scene, setting, us)
        for scene, us in (("S2", 50), ("R100k", 80))
        for setting, us in (("standard", us), ("patch=0", 100))
    ]
    table = tables.parameters(both).split("\n\n")[-1].splitlines()
    assert table[0] == "| a bin's pixels | S2 | R100k |"
    assert table[2:] == ["| in shared memory, us | 50 | 80 |", "| in the image, us | 100 | 100 |", "| ratio | 2 | 1.25 |"]
    assert "shared" not in tables.parameters(both[:1] + [one("S2", "room=4", 9)])


def test_tables_of_two_designs():
    us = {"bin_owned": 1, "two_stage": 10, "persistent": 5, "scanline": 8, "tile_owned": 4}
    rows = [row("S1", name, each, {}) for name, each in us.items()] + [
        row("S2", "bin_owned", 1, {}),
        row("S2", "scanline", 1, {}),
    ]
    assert tables.versus(rows).splitlines()[-2:] == ["| S1 | 0.5 | 0.5 |", "| S2 | - | - |"]
    assert "`bin_owned` left out" in tables.versus(rows)


def test_tables_of_distances():
    us = {"0.5": {"a": 10, "b": 20, "c": 10.5}, "2": {"a": 10, "b": 10, "c": 10.6}, "16": {"a": 10, "b": 5, "c": 10}}
    rows = [row(f"R@{at}", name, each, {"fragments": 5}, part="distance") for at, of in us.items() for name, each in of.items()]
    text = tables.distance(list(reversed(rows)))
    assert "| 2 | 0.5 | 0.01 | 1.06 | **1** | **1** |" in text.splitlines()
    assert [line.split(" ")[1] for line in text.splitlines() if line.startswith("|")][2:] == ["0.5", "2", "16"]
    assert "farther away: `c` behind b from 16 on; `a` behind b from 16 on." in text  # a and c are never 10 % apart
    assert "farther away: none." in tables.distance(rows[:3])
    assert "| - |" in tables.distance([one._replace(counters={}) for one in rows])


def test_tables_of_motion_and_stages():
    rows = [row("R", "a", us, {}, setting=motion, part="motion") for us, motion in ((10, "still"), (15, "moving"))]
    rows += [row("R2", "a", 10, {}, setting="still", part="motion")]
    assert tables.motion(rows).splitlines()[-1] == "| a | 0.01 | 1.500 | - | - |"
    named = (("stages", "setup", "setup"), ("a", "draw <4>", "a: draw <4>"))
    for variant, stage, shown in named:
        rows = [
            row("R", variant, us, {}, setting=f"{each} {stage}", part="stages") for us, each in ((10, "still"), (15, "moving"))
        ]
        assert tables.stages(rows).splitlines()[-1] == f"| {shown} | 10 | 15 |"


def test_tables_of_predictions():
    def case(scene: str, setting: str, *us: float) -> list[rows_of.Row]:
        return [row(scene, name, each, {}, setting=setting, part="prediction") for name, each in zip("abc", us, strict=True)]

    rows = case("R", "predicted", 1000, 2000, 3000) + case("R", "measured", 2000, 1000, 1050)
    rows += case("Q", "predicted", 1000, 2000, 3000) + case("Q", "measured", 3000, 4000, 5000)
    text = tables.prediction(rows)
    assert text.splitlines()[-4:-2] == ["| R, 64x32, predicted | 1 | 2 | 3 |", "| R, 64x32, measured | 2 | 1 | 1.05 |"]
    assert "in 1 of 2 cases" in text and "in 3 of 5 pairs" in text


def test_a_camera_goes_around():
    bounds = [[-1.0, -1, -1], [1, 1, 1]]
    camera = meshes.Camera.framing(bounds)
    once = cases_of.turned(camera, 40.0)
    assert once.eye == pytest.approx(meshes.Camera.framing(bounds, 30.0 + 40.0).eye)
    assert once.target == camera.target and cases_of.turned(once, 320.0).eye == pytest.approx(camera.eye)


def test_both_motions_draw_the_same(monkeypatch):
    """What is drawn after another camera's frame, and after its like, is the same list of pictures."""
    case = cases_of.Moving(rows_of.Key("R4k", 64, 48), "cpu")
    drawn: list[tuple[str, bytes]] = []
    draw = cases_of.Case.draw

    def watched(self, setting):
        draw(self, setting)
        drawn.append((setting.variant, self.packed.numpy().tobytes()))

    monkeypatch.setattr(cases_of.Case, "draw", watched)
    rows = case.motion(["bin_owned", "scanline"], 0, WHERE)
    assert [(one.variant, one.setting) for one in rows] == [
        (v, m) for v in ("bin_owned", "scanline") for m in ("moving", "still")
    ]
    assert all(one.equal and one.timing.repeats == 2 * cases_of.FRAMES for one in rows)
    of_bins = [image for variant, image in drawn if variant == "bin_owned"][2:]  # the first one is able()'s, then a warm one
    moving, still = of_bins[0 : 2 * cases_of.FRAMES : 2], of_bins[1 : 2 * cases_of.FRAMES : 2]
    assert moving == still and len(set(moving)) == cases_of.FRAMES


def test_kernels_by_frame(monkeypatch):
    """What the profiler saw: the copy of the positions begins a frame, frames are moving and still in turns."""
    monkeypatch.setattr(cases_of, "FRAMES", 2)
    copy = ("Memcpy DtoD (Device -> Device)", 1.0)
    events = [("before", 9.0)]
    for frame in range(4):
        events += [copy, ("set_up", 1.0 + frame), ("draw", 2.0), ("draw", 3.0)]
    found = cases_of.stages_of(events)
    assert found == {
        ("moving", "set_up"): [1, 3],
        ("still", "set_up"): [2, 4],
        ("moving", "draw"): [5, 5],
        ("still", "draw"): [5, 5],
    }
    with pytest.raises(RuntimeError, match="saw 3 copies of positions, not 4"):
        cases_of.stages_of(events[:-4])


def test_kernels_that_nobody_saw_are_said(monkeypatch, capsys):
    case = cases_of.Moving(rows_of.Key("R4k", 64, 48), "cpu")
    case.device = "cuda"
    monkeypatch.setattr(torch.cuda, "synchronize", lambda: None)

    def kernels(setting):
        if setting.variant == "scanline":
            raise RuntimeError("no copies")
        return {("still", "draw"): [1.0, 3.0], ("moving", "draw"): [5.0]}

    monkeypatch.setattr(case, "kernels", kernels)
    rows = case.stages(["bin_owned", "scanline"], WHERE)
    assert [(one.variant, one.setting, one.timing.median) for one in rows] == [
        ("bin_owned", "still draw", 2.0),
        ("bin_owned", "moving draw", 5.0),
    ]
    assert capsys.readouterr().out == "R4k 64x48: scanline: kernels left out: no copies\n"


def test_what_the_device_refuses_is_said(monkeypatch, capsys):
    case = cases_of.Case(rows_of.Key("S1", 320, 240), "cpu")
    draw = case.draw

    def picky(setting):
        if setting.variant == "scanline":
            raise RuntimeError("no memory\nat all")
        draw(setting)
        if setting.variant == "batched":
            case.packed[5, 5] -= 1

    monkeypatch.setattr(case, "draw", picky)
    settings = [tune.Setting(name) for name in ("bin_owned", "scanline", "batched")]
    assert case.able(settings) == {settings[0]: True, settings[2]: False}
    assert capsys.readouterr().out == "S1 320x240: scanline left out: no memory\n"


def test_the_whole(tmp_path, monkeypatch, capsys):
    """Small scenes: measured, kept, tables pasted; then the tables from the file, and a prediction before its measurement."""
    monkeypatch.setattr(variants, "SIZE", (320, 240))
    monkeypatch.setattr(tables, "SIZE", (320, 240))
    monkeypatch.setattr(tables, "SHOWN", "S2")
    page, kept = tmp_path / "page.md", tmp_path / "rows.csv"
    page.write_text("before\n<!-- variants cpu: begin -->\n<!-- variants cpu: end -->\nafter\n")
    what = ["--scenes", "R4k,S2,S5", "--size", "320x240", "--sweep", "R4k", "--seconds", "0"]
    what += ["--approach", "R4k", "--distances", "0.5,10.0", "--move", "R4k"]
    assert variants.main([*what, "--csv", str(kept), "--docs", str(page)]) == 0
    assert "S5: bigtri.study.scenes: size must have room for slivers" in capsys.readouterr().out
    rows, text = rows_of.read(kept), page.read_text()
    names = list(native.VARIANTS["cpu"])
    assert [one.variant for one in rows[: len(names)]] == names and all(one.equal for one in rows)
    assert {one.part for one in rows} == set(rows_of.PARTS)
    assert all(one.counters for one in rows if one.part in ("scenes", "parameters", "distance"))
    assert {one.setting for one in rows if one.variant == "scanline"} >= {"", "standard", "share=64", "share=1024", "still"}
    assert {one.key.scene for one in rows if one.part == "distance"} == {"R4k@0.5", "R4k@10"}
    stages = ("setup", "binning", "tile_mask", "scanline", "depth", "visibility")
    assert {one.setting for one in rows if one.part == "stages"} == {f"{m} {s}" for m in ("still", "moving") for s in stages}
    assert text.startswith("before\n<!--") and text.endswith("-->\nafter\n")
    for part in (
        "| R4k |",
        "S2, 320x240",
        "What a unit of work costs",
        "| scanline | `share` |",
        "| 0.5 |",
        "| tile_mask |",
    ):
        assert part in text
    page.write_text("<!-- variants cpu: begin -->\n<!-- variants cpu: end -->\n")
    options = ["--rows", str(kept), "--predict", "R16k-far", "--size", "96x64", "--seconds", "0"]
    options += ["--csv", str(tmp_path / "more.csv"), "--docs", str(page)]
    monkeypatch.setattr(cases_of.Case, "measure", lambda *_, **__: pytest.fail("measured before it was predicted"))
    with pytest.raises(pytest.fail.Exception):
        variants.main(options)
    assert "R16k-far 96x64, predicted: " in capsys.readouterr().out
    monkeypatch.undo()
    assert variants.main(options) == 0
    predicted, measured = capsys.readouterr().out.splitlines()
    assert all(f"{name} " in predicted and f"{name} " in measured for name in names)
    assert "| R16k-far, 96x64, predicted |" in page.read_text()
    more = rows_of.read(tmp_path / "more.csv")
    assert more[: len(rows)] == rows and [one.setting for one in more[len(rows) :: len(names)]] == ["predicted", "measured"]
    options[1] = str(tmp_path / "more.csv")
    assert variants.main(options) == 0 and len(rows_of.read(tmp_path / "more.csv")) == len(more)  # in place of the one before
    capsys.readouterr()
    with pytest.raises(SystemExit, match="S2 is in the report"):
        variants.main(["--rows", str(kept), "--predict", "S2"])
    rows_of.write(kept, [one for one in rows if one.part == "distance"])
    with pytest.raises(SystemExit, match="R4k is in the report"):
        variants.main(["--rows", str(kept), "--predict", "R4k"])


def test_the_time_is_over(tmp_path, capsys):
    what = ["--parts", "scenes", "--scenes", "S1,S2", "--size", "320x240", "--total", "0", "--csv", str(tmp_path / "rows.csv")]
    with pytest.raises(SystemExit):
        variants.main(what)
    seen = capsys.readouterr()
    assert "--total is over: 2 cases left out, from S1 320x240" in seen.out and "nothing was measured" in seen.err


def test_a_case_that_fails_does_not_stop_the_others(tmp_path, monkeypatch, capsys):
    measure = cases_of.Case.measure

    def failing(self, *given, **how):
        if self.key.scene == "S1":
            raise RuntimeError("no memory\nat all")
        return measure(self, *given, **how)

    monkeypatch.setattr(cases_of.Case, "measure", failing)
    what = ["--parts", "scenes", "--scenes", "S1,S2", "--size", "320x240", "--seconds", "0", "--csv", str(tmp_path / "rows.csv")]
    assert variants.main(what) == 1
    assert {one.key.scene for one in rows_of.read(tmp_path / "rows.csv")} == {"S2"}
    assert "FAILED S1 320x240: no memory\n" in capsys.readouterr().out


@pytest.mark.parametrize(
    "what, error",
    [
        (["--parts", "scene"], "part must be one of scenes, parameters, distance, motion, stages, got 'scene'"),
        (["--approach", "S1"], "mesh must be one of R4k"),
        (["--distances", "1,0"], "must be a positive number, got '0'"),
        (["--predict", "S1"], "--predict needs --rows"),
    ],
)
def test_wrong_options(capsys, what: list[str], error: str):
    with pytest.raises(SystemExit):
        variants.main(what)
    assert error in capsys.readouterr().err


def test_a_picture_that_differs_is_reported(tmp_path, capsys):
    rows = [row("S1", "a", 5, {"entries": 3}), row("S1", "b", 7, {"entries": 3})._replace(equal=False)]
    for number, one in enumerate(rows):
        rows_of.write(tmp_path / f"{number}.csv", [one])
    assert variants.main(["--rows", str(tmp_path / "0.csv"), str(tmp_path / "1.csv"), "--csv", str(tmp_path / "both.csv")]) == 1
    assert rows_of.read(tmp_path / "both.csv") == rows
    assert "NOT EQUAL: Key(scene='S1', width=64, height=32) b" in capsys.readouterr().out

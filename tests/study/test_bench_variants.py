"""bench/variants.py: rows that come back as they were, costs that are found again, tables, and predictions that come first."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

from bigtri import native
from bigtri.study import clock, tune

BENCH = Path(__file__).parents[2] / "bench"
if not BENCH.exists():
    pytest.skip("bench/ is not here", allow_module_level=True)
if str(BENCH) not in sys.path:
    sys.path.append(str(BENCH))
variants = importlib.import_module("variants")

pytestmark = pytest.mark.skipif(not native.available(), reason="the extension is not built")
WHERE = {"device": "a CPU", "how": "2 threads", "versions": "1", "commit": "abc", "command": "variants.py"}
PRICES = {"a": {"pixels": 0.5, "fragments": 2.0}, "b": {"triangles": 300.0, "entries": 40.0}}  # ns


def row(scene: str, variant: str, us: float, counts: dict[str, int], triangles: int = 10, parameters: str = "") -> variants.Row:
    timing = clock.Timing(us / 1e3, us / 2e3, us / 1e3, us / 1e3, 7)
    return variants.Row(variants.Key(scene, 64, 32), triangles, variant, parameters, timing, True, counts, WHERE)


def of_prices(seed: int, scenes: int) -> list[variants.Row]:
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
    rows = [row("S1", "a", 5, {"entries": 3, "fragments": 2}), row("S1", "b", 7, {}, parameters="share=4")]
    rows[1] = rows[1]._replace(equal=False)
    variants.write(tmp_path / "rows.csv", rows)
    assert variants.read(tmp_path / "rows.csv") == rows
    (tmp_path / "other.csv").write_text("scene,width\nS1,3\n")
    with pytest.raises(SystemExit, match="no rows of this script"):
        variants.read(tmp_path / "other.csv")


def test_costs_are_found_again():
    rows = of_prices(1, 20)
    for variant, of_it in variants.by_variant(rows).items():
        costs = variants.fit(of_it)
        for name, ns in zip(variants.PAID, costs.ns, strict=True):
            assert ns == pytest.approx(PRICES[variant].get(name, 0), rel=1e-6, abs=1e-9)
        assert all(costs.us(one) == pytest.approx(one.us) for one in of_it)
    tried = variants.check(rows)
    assert tried.winners == tried.cases == 20 and tried.ordered == tried.pairs > 10
    assert tried.errors == {"a": pytest.approx(1), "b": pytest.approx(1)}


def test_a_time_that_the_costs_do_not_explain():
    rows = of_prices(2, 20)
    slow = rows[0]._replace(timing=rows[0].timing._replace(median=1e3))
    tried = variants.check([slow, *rows[1:]])
    assert tried.winners < 20 and tried.ordered < tried.pairs


def test_steps_are_allowed():
    for name, variant in native.REGISTRY["cpu"]["exact"].items():
        for parameter in variant.parameters.values():
            values = variants.steps(parameter)
            assert parameter.standard in values and len(values) > 1
            assert all(native.parameter_values("test", variant, {parameter.name: value}) for value in values)
        assert tune.Setting(name) in variants.sweep(native.REGISTRY["cpu"]["exact"])


def test_tables():
    rows = [row("S1", "a", 2500, {"entries": 1500}), row("S1", "b", 1000, {"entries": 7, "tasks": 2, "work": 10, "most_work": 8})]
    assert variants.times_table(rows, 64, 32).splitlines()[-1] == "| S1 | 1 | 2.5 | **1** |"
    assert variants.times_table(rows, 64, 32).splitlines()[0] == "| 64x32 | fastest, ms | a | b |"
    a, b = variants.work_table(rows).splitlines()[-2:]
    assert a.startswith("| a | 2.5 | 1.5 k | 0 |") and a.endswith("| 0 |  |")
    assert b.startswith("| b | 1 | 7 |") and b.endswith("| 0 | 1.6 |")
    swept = [row("S1", "a", us, {}, parameters=text) for us, text in ((10, "standard"), (15, "x=9"), (5, "x=10"))]
    assert variants.sweep_table(swept).splitlines()[-2:] == ["| a | `x` | 9 | 1.5 |", "| a | `x` | 10 | 0.5 |"]


def test_the_whole(tmp_path, monkeypatch, capsys):
    """Small scenes: measured, kept, tables pasted; then the tables from the file, and a prediction before its measurement."""
    monkeypatch.setattr(variants, "SIZE", (320, 240))
    monkeypatch.setattr(variants, "SHOWN", "S2")
    page, kept = tmp_path / "page.md", tmp_path / "rows.csv"
    page.write_text("before\n<!-- variants cpu: begin -->\n<!-- variants cpu: end -->\nafter\n")
    what = ["--scenes", "R4k,S2,S5", "--size", "320x240", "--sweep", "R4k", "--seconds", "0"]
    assert variants.main([*what, "--csv", str(kept), "--docs", str(page)]) == 0
    assert "S5: bigtri.study.scenes: size must have room for slivers" in capsys.readouterr().out
    rows, text = variants.read(kept), page.read_text()
    names = list(native.VARIANTS["cpu"])
    assert [one.variant for one in rows[: len(names)]] == names and all(one.equal for one in rows)
    assert all(one.counters for one in rows if not one.parameters)
    assert {one.parameters for one in rows if one.variant == "scanline"} >= {"", "standard", "share=64", "share=1024"}
    assert text.startswith("before\n<!--") and text.endswith("-->\nafter\n")
    for part in ("| R4k |", "S2, 320x240", "What a unit of work costs", "| scanline | `share` | 64 |"):
        assert part in text
    page.write_text("<!-- variants cpu: begin -->\n<!-- variants cpu: end -->\n")
    options = ["--rows", str(kept), "--docs", str(page), "--predict", "R16k-far", "--size", "96x64", "--seconds", "0"]
    monkeypatch.setattr(variants.Case, "measure", lambda *_: pytest.fail("measured before it was predicted"))
    with pytest.raises(pytest.fail.Exception):
        variants.main(options)
    assert "R16k-far 96x64, predicted: " in capsys.readouterr().out
    monkeypatch.undo()
    assert variants.main(options) == 0
    predicted, measured = capsys.readouterr().out.splitlines()
    assert all(f"{name} " in predicted and f"{name} " in measured for name in names)
    with pytest.raises(SystemExit, match="S2 is in the report"):
        variants.main(["--rows", str(kept), "--predict", "S2"])


def test_a_picture_that_differs_is_reported(tmp_path, capsys):
    rows = [row("S1", "a", 5, {"entries": 3}), row("S1", "b", 7, {"entries": 3})._replace(equal=False)]
    for number, one in enumerate(rows):
        variants.write(tmp_path / f"{number}.csv", [one])
    assert variants.main(["--rows", str(tmp_path / "0.csv"), str(tmp_path / "1.csv"), "--csv", str(tmp_path / "both.csv")]) == 1
    assert variants.read(tmp_path / "both.csv") == rows
    assert "NOT EQUAL: Key(scene='S1', width=64, height=32) b" in capsys.readouterr().out

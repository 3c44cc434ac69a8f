"""The GPU benchmark's parts that need no GPU: the floor's lists, bookkeeping, limits, tables. Nothing here asserts a time."""

from __future__ import annotations

import argparse
import contextlib
import csv
import dataclasses
import functools
import importlib
import math
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

import bigtri
from bigtri import native
from bigtri.study import benchmark, meshes, scenes
from bigtri.study import clock as study_clock

BENCH = Path(__file__).parents[2] / "bench"
CSRC = Path(bigtri.__file__).parent / "csrc"
if not BENCH.exists():
    pytest.skip("bench/ is not here", allow_module_level=True)
if str(BENCH) not in sys.path:
    sys.path.append(str(BENCH))
# What some variant on CUDA has as a parameter, where it is built or not.
PARAMETERS = set(re.findall(r'\bX\((\w+), "', "".join(f.read_text() for f in sorted(CSRC.glob("cuda/*")))))

MODULES = ("best", "cuda_cases", "cuda_clock", "cuda_floor", "cuda_run", "cuda_scaling", "gpu_tables", "sanitize", "unchosen")
best, cuda_cases, cuda_clock, cuda_floor, cuda_run, cuda_scaling, gpu_tables, sanitize, unchosen = map(
    importlib.import_module, MODULES
)

pytestmark = pytest.mark.skipif(not native.available(), reason="the extension is not built")
needs_compiler = pytest.mark.skipif(not (shutil.which("c++") or shutil.which("g++")), reason="no C++ compiler")
CPU = torch.device("cpu")
HERE = cuda_clock.Machine("some GPU", "1", "2", "3", "abc", "test")


def case_of(scene: scenes.Triangles, width: int, height: int, name: str = "S1"):
    """A case of a scene that is there."""
    return cuda_cases.Case(cuda_clock.Job(name, width, height, scenes.SEED), meshes.Batch(*scene, None), CPU)


@pytest.fixture(scope="module")
def floor(tmp_path_factory: pytest.TempPathFactory):
    return cuda_floor.Floor(CPU, tmp_path_factory.mktemp("floor"))


# --- the floor


@needs_compiler
@pytest.mark.parametrize("name, width, height", [("S1", 640, 360), ("S3", 203, 151), ("S4f", 64, 8), ("S6-200k", 333, 97)])
def test_floor_shows_the_same_triangles(floor, name: str, width: int, height: int) -> None:
    scene = scenes.make(name, width, height)
    case = case_of(scene, width, height)
    lists = floor.lists(scene, width, height)
    for kind in cuda_floor.KINDS:
        assert case.wrong_triangles(lambda kind=kind: floor.fill(kind, lists, case.packed)) == 0


@needs_compiler
def test_floor_of_clipped_triangles(floor) -> None:
    """Several records of one triangle, and triangles that touch no pixel."""
    scene = sanitize.clip_space(3, 40, (-0.5, 2))
    scene.positions[:, 2] = 0  # the floor does not know the far plane
    case = case_of(scene, 121, 67)
    lists = floor.lists(scene, 121, 67)
    covered = int(lists.first[-1])
    assert covered == len(lists.items) > 0
    case.packed.fill_(cuda_clock.POISON)
    floor.fill("floor list", lists, case.packed)
    background = 2**63 - 1
    assert torch.equal(case.packed == background, case.expected[0] == background)


@needs_compiler
def test_floor_says_what_the_compiler_said(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    broken = tmp_path / "broken.cu"
    broken.write_text("no program")
    monkeypatch.setattr(cuda_floor, "SOURCE", broken)
    with pytest.raises(cuda_floor.UnavailableError, match="does not compile"):
        cuda_floor.library(True, tmp_path)


@pytest.mark.skipif(not shutil.which("nvcc"), reason="no nvcc")
def test_floor_compiles_for_a_gpu(tmp_path: Path) -> None:
    output = tmp_path / "floor.so"
    subprocess.run(cuda_floor.build_command(False, (9, 0), output), check=True, timeout=300)
    assert output.exists()


# --- clock and rows


def test_repeats() -> None:
    assert cuda_clock.repeats_for(10, 0.1) == cuda_clock.AT_MOST
    assert cuda_clock.repeats_for(5_000, 0.1) == cuda_clock.AT_LEAST
    assert cuda_clock.repeats_for(1_000, 0.1) == 100
    assert cuda_clock.repeats_for(1e6, 0.1) == cuda_clock.SLOW_REPEATS


@pytest.mark.parametrize(
    "kernel, name",
    [
        ("void bigtri::(anonymous namespace)::draw_few<8>(bigtri::Frame, int)", "draw_few<8>"),
        ("bigtri::<unnamed>::draw_many(bigtri::Frame, bigtri::Queues)", "draw_many"),
        ("void bigtri::(anonymous namespace)::draw_some<(int)8>(bigtri::Frame)", "draw_some<8>"),
        (
            "void bigtri::(anonymous namespace)::draw_all<16, (bigtri::(anonymous namespace)::Output)1>(bigtri::Frame)",
            "draw_all<16, 1>",
        ),
        ("Memset (Device)", "Memset "),
    ],
)
def test_short_kernel_names(kernel: str, name: str) -> None:
    assert cuda_clock.short_name(kernel) == name


def test_commit_comes_from_the_environment_without_git(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cuda_clock.provenance, "commit", lambda: "")
    monkeypatch.setenv("BIGTRI_COMMIT", "1234567")
    assert cuda_clock.machine().commit == "1234567"


class FakeCuda:
    """Stands in for torch.cuda: counts, and every frame that is drawn takes 10 us."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.frames = self.sleeps = 0
        self.captured: int | None = None
        outer = self

        class Event:
            def __init__(self, enable_timing: bool) -> None:
                assert enable_timing

            def record(self) -> None:
                self.at = outer.frames * 1e-2  # ms

            def elapsed_time(self, end: Event) -> float:
                return end.at - self.at

        class Graph:
            frames = 0

            def replay(self) -> None:
                outer.frames += self.frames

        class Capture:
            def __init__(self, graph: Graph, pool: object, stream: object) -> None:
                self.graph = graph

            def __enter__(self) -> None:
                outer.captured = 0

            def __exit__(self, *exc: object) -> None:
                self.graph.frames, outer.captured = outer.captured, None

        class Stream:
            def wait_stream(self, other: object) -> None: ...

        stand_ins = {"Event": Event, "CUDAGraph": Graph, "graph": Capture, "Stream": Stream, "current_stream": Stream}
        stand_ins |= {"stream": lambda stream: contextlib.nullcontext(), "synchronize": lambda: None, "_sleep": self.sleep}
        stand_ins |= {"graph_pool_handle": lambda: (0, 0)}
        for name, value in stand_ins.items():
            monkeypatch.setattr(torch.cuda, name, value)

    def sleep(self, cycles: int) -> None:
        assert cycles > 0
        self.sleeps += 1

    def draw(self) -> None:
        if self.captured is None:
            self.frames += 1
        else:
            self.captured += 1


@pytest.mark.parametrize("method", cuda_clock.METHODS)
def test_clock_times_a_frame_by_every_method(monkeypatch: pytest.MonkeyPatch, method: str) -> None:
    cuda = FakeCuda(monkeypatch)
    clock = cuda_clock.CudaClock()
    clock.buffer = torch.ones(8)  # of 256 MB otherwise
    us, again = clock.measure(cuda.draw, method, 0.0)
    assert us == pytest.approx([10.0] * len(us)) and len(us) == cuda.sleeps >= (
        20 if method == "graph20" else cuda_clock.AT_LEAST
    )
    assert (clock.buffer == (0 if method == "cold" else 1)).all()
    before = cuda.frames
    again()
    assert cuda.frames - before == (cuda_clock.IN_A_ROW if method == "graph20" else 1)


def test_calls_take_turns_on_the_device(monkeypatch: pytest.MonkeyPatch) -> None:
    """Milliseconds of the device for each call, whatever the host takes and however many calls are replayed at once."""
    cuda = FakeCuda(monkeypatch)
    calls = {"one": cuda.draw, "five": lambda: [cuda.draw() for _ in range(5)]}
    ms = study_clock.interleaved(calls, seconds=0, at_least=6, device="cuda")
    assert ms == {"one": pytest.approx([0.01] * 6), "five": pytest.approx([0.05] * 6)}
    assert cuda.sleeps == 2 * 5 + 2 * 7  # five each to see how long it takes, and one each of every round


def test_replays_and_the_host(monkeypatch: pytest.MonkeyPatch) -> None:
    cuda = FakeCuda(monkeypatch)
    clock = cuda_clock.CudaClock()
    replay = clock.replay(cuda.draw)
    before = cuda.frames
    assert clock.times(replay, 4) == pytest.approx([10.0] * 4) and cuda.sleeps == 4
    assert cuda.frames == before + 3 + 4  # three warm up
    waits: list[int] = []
    monkeypatch.setattr(torch.cuda, "synchronize", lambda: waits.append(cuda.frames))
    before = cuda.frames
    assert len(clock.host(cuda.draw, 0)) == cuda_clock.AT_LEAST == cuda.frames - before - 1  # the first one does not count
    assert waits[0] == before + 1 and waits[-1] == cuda.frames and waits[1] - waits[0] == 8  # a queue never grows long


class FakeClock:
    """Takes as long as it is told."""

    def __init__(self, us: float) -> None:
        self.us = us

    def once(self, call) -> float:
        return self.us

    def measure(self, call, method: str, seconds: float, at_least: int = 50):
        call()
        return cuda_clock.Measurement([self.us, self.us * 2, self.us * 3], call)

    def replay(self, call):
        return call

    def times(self, replay, count: int) -> list[float]:
        return [self.us] * count

    def host(self, call, seconds: float) -> list[float]:
        return [self.us / 2] * 2


def test_rows_and_wrong_pixels() -> None:
    case = case_of(scenes.make("S2", 1280, 720), 320, 240)
    bench = cuda_run.Bench(FakeClock(10), None, HERE, ["graph", "cold"], 0.1)
    bench.case(case, ["auto"])
    bench.measure(case, "broken", lambda: case.packed.zero_(), case.wrong_pixels)
    assert [(row.variant, row.method, row.wrong_pixels) for row in bench.rows[:2]] == [("auto", "graph", 0), ("auto", "cold", 0)]
    assert [row.wrong_pixels for row in bench.rows[2:]] == [320 * 240] * 2
    assert bench.wrong() == 2 * 320 * 240
    assert (bench.rows[0].us_median, bench.rows[0].us_min, bench.rows[0].repeats, bench.rows[0].commit) == (20, 10, 3, "abc")


def test_what_is_not_drawn_is_wrong() -> None:
    """The image is poisoned first, so a frame that writes nothing cannot pass with the last one's pixels."""
    case = case_of(scenes.make("S2", 1280, 720), 320, 240)
    case.draw("auto")
    assert case.wrong_pixels(lambda: None) == 320 * 240
    assert case.wrong_triangles(lambda: None) == 320 * 240


def test_failures_are_kept() -> None:
    def fail() -> None:
        raise RuntimeError("no room\nand more")

    case = case_of(scenes.Triangles(*sanitize.pictures(200, 150)["one"]), 32, 24)
    bench = cuda_run.Bench(FakeClock(10), None, HERE, ["graph"], 0.1)
    bench.measure(case, "auto", fail)
    assert not bench.rows and bench.failures == ["S1 32x24 auto graph: no room"]


def row(variant: str, us: float, seed: int = scenes.SEED, method: str = "graph", scene: str = "S1"):
    return cuda_clock.Row(scene, 1920, 1080, seed, 1, variant, 8, method, us, us, us, us, 50, 0, *HERE)


def test_peers_are_there_for_the_default_seed() -> None:
    peers = cuda_run.read_peers()
    assert {name for name, *_ in peers} == {"CuRast", "nvdiffrast", "OpenGL"}
    assert len(peers) == 3 * 8 * 2 and all(us > 0 for us in peers.values())
    times = cuda_run.Times([], peers)
    assert times.get(cuda_clock.Job("S1", 1920, 1080, scenes.SEED), "CuRast") == 51.7
    assert times.get(cuda_clock.Job("S1", 1920, 1080, 7), "CuRast") is None
    assert times.get(cuda_clock.Job("S1", 1000, 1080, scenes.SEED), "CuRast") is None


def test_tables() -> None:
    rows = [
        row("memset", 7),
        row("floor list", 9),
        row("floor shuffle", 8),
        row("bin_owned", 10),
        row("bin_owned", 9.5, method="cold"),
    ]
    times = cuda_run.Times(rows, {("CuRast", "S1", 1920, 1080): 50.0})
    assert times.get(cuda_clock.Job("S1", 1920, 1080, scenes.SEED), "floor") == 8
    last = cuda_run.case_lines(rows, times)[-1]
    assert last.split()[:4] == ["S1", "1920x1080", str(scenes.SEED), "bin_owned"]
    assert last.split()[-5:] == [
        "1.43",
        "1.25",
        "5.00",
        "-",
        "0",
    ]  # times memset and the floor; the peers' over ours; wrong pixels
    _, header, line = cuda_run.summary_lines(rows, times)
    assert header.split()[-2:] == ["bin_owned", "CuRast"] and line.split() == ["S1", "7.00", "9.00", "8.00", "10.0", "50.0"]


def test_batches_say_how_many_images_a_second() -> None:
    rows = [dataclasses.replace(row("auto", 50), views=64), dataclasses.replace(row("memset", 5), views=64)]
    auto, memset = cuda_run.case_lines(rows, cuda_run.Times(rows, {("CuRast", "S1", 1920, 1080): 50.0}))
    assert auto.endswith("1,280,000 images/s") and "images" not in memset
    assert auto.split()[:3] == ["S1", "64x1080x1920", str(scenes.SEED)] and " - " in auto  # a peer drew one view
    assert cuda_run.summary_lines(rows, cuda_run.Times(rows, {}))[1].startswith("64x1080x1920, seed")


def test_host_lines() -> None:
    rows = [row("auto", 10), row("auto", 30, method="host"), row("auto", 20, method="host out")]
    rows[1].us_median = 35
    *_, last = cuda_run.case_lines(rows, cuda_run.Times(rows, {}))
    assert last.endswith("us of the host, best (median): host 30.0 (35.0), host out 20.0 (20.0)")


def test_host_rows() -> None:
    case = case_of(scenes.make("S2", 1280, 720), 320, 240)
    bench = cuda_run.Bench(FakeClock(10), None, HERE, ["host"], 0.1)
    bench.case(case, ["auto"])
    assert [(r.variant, r.method, r.us_median, r.wrong_pixels) for r in bench.rows] == [
        ("auto", "host", 5, None),
        ("auto", "host out", 5, None),
    ]
    case.packed.zero_()
    case.draw_plain()
    assert not case.packed.any()  # a plain call writes into memory of its own


@needs_compiler
def test_dry_run(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cuda_floor, "FOLDER", tmp_path)
    path = tmp_path / "rows.csv"
    options = ["--dry-run", "--scenes", "S1,S5", "--size", "640x361", "--seeds", "1000,5", "--seconds", "0", "--csv", str(path)]
    assert cuda_run.main([*options, "--batches", "2x16x24", "--batch-scenes", "R4k+R16k"]) == 0
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    variants = {*native.VARIANTS["cpu"], "auto"}
    assert {r["variant"] for r in rows if r["views"] == "1"} == variants | {*cuda_run.YARDSTICKS}
    assert {r["variant"] for r in rows if r["views"] == "2"} == variants | {"memset", "empty kernel"}
    methods = len(cuda_clock.METHODS)
    singles = 2 * (methods * len(variants | {*cuda_run.YARDSTICKS}) + 2)  # two seeds; S5 does not fit the image; two of the host
    assert len(rows) == singles + 2 * (methods * (len(variants) + 2) + 2)
    assert {r["wrong_pixels"] for r in rows if r["variant"] in variants | {*cuda_floor.KINDS}} == {"0", ""}
    assert {r["method"] for r in rows if r["wrong_pixels"] == "" and r["variant"] in variants} == {"host", "host out"}
    assert "0 wrong pixels" in capsys.readouterr().out


def test_total_ends_a_run(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--dry-run", "--scenes", "S1,R4k", "--size", "300x200", "--batches", "none", "--total", "0", "--no-floor"]
    assert cuda_run.main(arguments) == 1  # no row
    assert "2 left out, from R4k 300x200" in capsys.readouterr().out  # real scenes come first


def test_without_a_gpu_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(native, "devices", lambda: ["cpu"])
    with pytest.raises(SystemExit, match="no GPU"):
        cuda_run.main([])


# --- what is drawn, and in which ways


def parsed(*texts: str):
    parser = argparse.ArgumentParser()
    cuda_cases.add_cases(parser)
    arguments = parser.parse_args([*texts])
    return [str(job) for job in cuda_cases.jobs(arguments, cuda_cases.maker_for(arguments))]


def test_jobs_are_ordered_by_importance() -> None:
    few = ("--scenes", "S1,R4k", "--size", "256x256,1080p", "--batches", "64x256x512", "--batch-scenes", "R4k,R4k+R16k")
    singles = ["R4k 256x256", "R4k 1920x1080"], ["S1 256x256", "S1 1920x1080"]
    assert parsed(*few) == [*singles[0], "R4k 64x256x512", "R4k+R16k 64x256x512", *singles[1]]
    everything = parsed()
    assert len(everything) == 4 * (len(scenes.SCENES) - 1) + 3 * 4  # S6-200k is for CPUs
    assert parsed("--scenes", "none", "--batches", "none") == []


@pytest.mark.parametrize("text", ["64x256", "1x256x256", "64x256x0", "64x256x20000", "64x1080p", "ax2x2", ""])
def test_batches_that_are_none(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match="VIEWSxHEIGHTxWIDTH"):
        cuda_cases.batches(text)


@pytest.mark.parametrize("name", ["S1", "Rroom", "R4k+S1", "R4k+", "R16k-close"])
def test_a_circle_of_cameras_sees_only_some(name: str) -> None:
    with pytest.raises(SystemExit, match="batch scene must be one of R4k, R16k"):
        parsed("--batch-scenes", name)


def test_models_are_scenes_of_their_own(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    path = tmp_path / "a+b.ply"
    trimesh.creation.icosphere(2).export(path)
    assert parsed("--model", str(path), "--size", "64x48", "--batches", "4x8x8") == ["a+b 64x48", "a+b 4x8x8"]
    assert parsed("--model", str(path), "--scenes", "S1", "--size", "64x48", "--batches", "none") == ["S1 64x48"]
    maker = cuda_cases.Maker([path])
    small, large = (maker.make(cuda_clock.Job("a+b", *size, 1)) for size in ((64, 48), (1920, 1080)))
    assert small is large and small.triangles.shape == (320, 3)  # 16:9 at every size, and made once
    given = maker.make(cuda_clock.Job("R16k-far", 64, 64, scenes.SEED))
    np.testing.assert_array_equal(given.positions, scenes.make("R16k-far", 1920, 1080).positions)
    visible = bigtri.rasterize(small.positions, small.triangles, (90, 160), backend="native").triangle >= 0
    rows, columns = np.nonzero(visible)
    assert np.ptp(rows) == pytest.approx(np.ptp(columns), abs=1)  # a ball is round in a picture of 16:9
    with pytest.raises(SystemExit, match="no such file|No such file"):
        parsed("--model", str(tmp_path / "nothing.ply"))
    (tmp_path / "R4k.ply").write_bytes(path.read_bytes())
    with pytest.raises(SystemExit, match="R4k must be no scene's name"):
        parsed("--model", str(tmp_path / "R4k.ply"))


def test_a_batch_is_what_its_views_are() -> None:
    kinds = [meshes.body(4, 1), meshes.body(6, 2)]
    one, mixed = meshes.batch(kinds[:1], 3, 16 / 9), meshes.batch(kinds, 3, 16 / 9)
    assert one.positions.shape == (3, len(kinds[0].vertices), 4) and one.ranges is None
    single = meshes.whole(kinds[0], 16 / 9).transform(kinds[0].vertices, 16 / 9)
    np.testing.assert_array_equal(one.positions[0], single)  # the first camera is the default one
    assert not np.array_equal(one.positions[1], one.positions[0])
    counts = [len(kinds[b % 2].triangles) for b in range(3)]
    assert mixed.ranges is not None and mixed.ranges.tolist() == [[sum(counts[:b]), counts[b]] for b in range(3)]
    np.testing.assert_array_equal(mixed.positions[: one.positions.shape[1]], one.positions[0])
    first, count = mixed.ranges[1]
    corners = mixed.positions[mixed.triangles[first : first + count]]
    alone = meshes.batch([kinds[1]], 3, 16 / 9)
    np.testing.assert_array_equal(corners, alone.positions[1][alone.triangles])


@pytest.mark.parametrize("kinds", [("R4k",), ("R4k", "R16k")])
def test_some_views_of_a_batch_are_checked(kinds: tuple[str, ...]) -> None:
    job = cuda_clock.Job("+".join(kinds), 24, 16, scenes.SEED, 8)
    case = cuda_cases.Case(job, cuda_cases.Maker().make(job), CPU)
    assert case.packed.shape == (8, 16, 24) and case.checked == [0, 3, 7]
    assert case.wrong_pixels(lambda: case.draw("auto")) == 0
    assert case.wrong_pixels(lambda: None) == 3 * 16 * 24

    def one_pixel_off() -> None:
        case.draw("auto")
        case.packed[7, 5, 5] += 1
        case.packed[6] = 0  # is not looked at

    assert case.wrong_pixels(one_pixel_off) == 1


def variant(name: str, **parameters: tuple[int, int]) -> native.Variant:
    """As a registry has it; parameters: lowest and highest value."""
    only = {
        "warps": (0, 8, 16),
        "region": (0, 4, 8, 16),
        "share": (0, 2, 4, 8, 16, 32, 64, 96, 124, 128, 192, 256, 1024),
        "team": (0, 1, 2, 4, 8),
    }
    known = {p: native.Parameter(p, "", "", low, low, high, only.get(p, ())) for p, (low, high) in parameters.items()}
    return native.Variant(name, "", known)


TODAY = {
    v.name: v
    for v in (
        variant("bin_owned", few=(0, 65536), warps=(0, 16), region=(0, 16), widest=(0, 256), share=(0, 1024), team=(0, 8)),
        variant("two_stage", widest=(0, 256), share=(0, 1024)),
        variant("persistent"),
    )
}


def test_settings_are_those_of_the_registry(capsys: pytest.CaptureFixture[str]) -> None:
    found = cuda_cases.ways(cuda_cases.SETTINGS, TODAY)
    assert found[0].parameters == {"few": 65536}  # the highest there is
    highest = [{name: min(value, 65536) for name, value in way.parameters.items()} for way in cuda_cases.SETTINGS]
    assert [way.parameters for way in found] == highest and capsys.readouterr().out == ""
    assert {name for way in cuda_cases.SETTINGS for name in way.parameters} <= PARAMETERS
    assert len({tuple(way.parameters.items()) for way in found}) == len({way.name for way in found}) == len(found)
    no_share = {"bin_owned": variant("bin_owned", few=(0, 65536), warps=(0, 16), region=(0, 16), widest=(0, 256))}
    assert cuda_cases.ways(cuda_cases.SETTINGS, no_share) == [way for way in found if not {"share", "team"} & {*way.parameters}]
    left_out = "left out: bin_owned share 32: parameters of bin_owned are few, warps, region, widest, got share"
    assert left_out in capsys.readouterr().out
    for text, message in (
        ("other:few=1", "variants are bin_owned, two_stage, persistent"),
        ("bin_owned:warps=5", "warps must be 0, 8, 16, got 5"),
        ("bin_owned:share=63", "share must be 0, 2, 4, 8, 16, 32, 64, 96, 124, 128, 192, 256, 1024, got 63"),
        ("persistent:few=0", "parameters of persistent are none, got few"),
    ):
        assert cuda_cases.ways([cuda_cases.way(text)], TODAY) == []
        assert message in capsys.readouterr().out


def test_a_setting_from_the_command_line() -> None:
    assert cuda_cases.way("two_stage:widest=64,queue=7") == cuda_cases.Way(
        "two_stage", "widest=64,queue=7", {"widest": 64, "queue": 7}
    )
    assert cuda_cases.way("persistent").name == "persistent"
    for text in ("two_stage:widest", "two_stage:widest=-1", "two_stage:widest=x"):
        with pytest.raises(argparse.ArgumentTypeError, match="whole number"):
            cuda_cases.way(text)


def test_a_setting_is_in_force() -> None:
    name, parameter = next(iter(native.REGISTRY["cpu"]["exact"]["bin_owned"].parameters.items()))
    given = cuda_cases.Way("bin_owned", "", {name: parameter.high})
    assert native.parameter_values("rasterize", native.REGISTRY["cpu"]["exact"]["bin_owned"], None) == []
    with given.setting():
        assert native.parameter_values("rasterize", native.REGISTRY["cpu"]["exact"]["bin_owned"], None)[0] == parameter.high


# --- auto against the best


class PacedClock(FakeClock):
    """Each call takes as long as its variant is told to."""

    def __init__(self, us: dict[str, float]) -> None:
        super().__init__(1)
        self.us_of = us

    def times(self, replay, count: int) -> list[float]:
        replay()
        return [self.us_of[replay.args[0]]] * count


class SettlingClock(PacedClock):
    """Auto takes twice as long in the first turns."""

    def __init__(self, us: dict[str, float]) -> None:
        super().__init__(us)
        self.turns = 0

    def times(self, replay, count: int) -> list[float]:
        self.turns += replay.args[0] == "auto"
        return [
            us * (1 + (replay.args[0] == "auto" and self.turns <= 1 + cuda_clock.ROUNDS)) for us in super().times(replay, count)
        ]


class SlowingClock(SettlingClock):
    """All take twice as long in the second turns."""

    def times(self, replay, count: int) -> list[float]:
        self.turns += replay.args[0] == "auto"
        return [us * (1 + (self.turns > 1 + cuda_clock.ROUNDS)) for us in PacedClock.times(self, replay, count)]


def contest(us: dict[str, float], kind=PacedClock):
    case = case_of(scenes.make("S2", 1280, 720), 320, 240)
    every = [cuda_cases.AUTO, *(cuda_cases.Way(name, "", {}) for name in us if name != "auto")]
    found = best.Contest(kind(us), None, HERE, every, 0)
    found.case(case)
    return found


def test_auto_against_the_best() -> None:
    found = contest({"auto": 20, "bin_owned": 15, "scanline": 40})
    assert [(r.variant, r.us_median, r.repeats, r.wrong_pixels) for r in found.rows] == [
        ("auto", 20, best.AGAIN * cuda_clock.ROUNDS * cuda_clock.TURN, 0),  # those that are ahead, and auto, once more
        ("bin_owned", 15, best.AGAIN * cuda_clock.ROUNDS * cuda_clock.TURN, 0),
        ("scanline", 40, 1, 0),  # more than twice the fastest: it takes no turns
    ]
    [verdict] = found.verdicts
    assert (verdict.name, verdict.auto, verdict.best, verdict.ratio) == ("bin_owned", 20, 15, pytest.approx(4 / 3))
    assert verdict.marked and verdict.line().endswith("NOT THE BEST")
    assert not found.failures and found.wrong() == 0
    [ahead] = contest({"auto": 5, "bin_owned": 30, "scanline": 90}).verdicts  # the best rival runs, far behind as it is
    assert (ahead.name, ahead.ratio, ahead.marked) == ("bin_owned", pytest.approx(1 / 6), False)


def test_ahead_by_chance() -> None:
    """What is ahead in the first turns alone is not; the others keep the times of theirs."""
    found = contest({"auto": 20, "bin_owned": 21, "scanline": 50, "two_stage": 38}, SettlingClock)
    [verdict] = found.verdicts
    assert (verdict.name, verdict.auto, verdict.ratio, verdict.marked) == ("bin_owned", 20, pytest.approx(20 / 21), False)
    assert [(row.variant, row.us_median, row.ratio, row.turns) for row in found.rows] == [
        ("auto", 20, None, 2),
        ("bin_owned", 21, pytest.approx(20 / 21), 2),
        ("scanline", 50, None, None),
        ("two_stage", 38, pytest.approx(40 / 38), 1),
    ]


def test_only_the_second_turns_count(tmp_path: Path) -> None:
    """Neither is what took no second turns the best, though its first ones were shorter, nor in the rows."""
    found = contest({"auto": 23, "bin_owned": 20, "two_stage": 21.5}, kind=SlowingClock)
    [verdict] = found.verdicts
    assert (verdict.name, verdict.auto, verdict.best, verdict.marked) == ("bin_owned", 46, 40, True)
    assert [row.turns for row in found.rows] == [2, 2, 1]
    benchmark.write_csv(tmp_path / "best.csv", found.rows)
    [read] = best.from_rows(benchmark.read_csv(tmp_path / "best.csv"))
    assert (read.name, read.auto, read.ratio, read.marked) == ("bin_owned", 46, 1.15, True)


@pytest.mark.parametrize(
    "auto, rival, marked", [(11.2, 10, True), (10.9, 10, False), (3.9, 3, False), (4.1, 3, True), (9, 10, False)]
)
def test_what_is_marked(auto: float, rival: float, marked: bool) -> None:
    job = cuda_clock.Job("S1", 64, 64, 1)
    times = {"auto": [[auto] * 3] * 3, "x": [[rival] * 3] * 3, "memset": [[1.0]] * 3}
    found = best.verdict(job, times)
    assert found is not None and found.marked is marked and found.memset == 1.0
    assert best.ratios({"x": [[rival]]}) == {} and best.verdict(job, {"x": [[rival]]}) is None
    assert best.verdict(job, {"auto": [[auto]], "memset": [[1.0]]}) is None


def test_the_best_on_a_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From the rows of a file: the verdicts of the run that wrote them; without the ratios those of the medians."""
    found = contest({"auto": 20, "bin_owned": 15, "scanline": 40})
    benchmark.write_csv(tmp_path / "best.csv", found.rows)
    as_text = benchmark.read_csv(tmp_path / "best.csv")
    assert best.from_rows(as_text) == [found.verdicts[0]._replace(**{n: 1.3333 for n in ("ratio", "low", "high")})]
    drifted = [row | {"us_median": str(2 * float(row["us_median"]))} if row["variant"] == "auto" else row for row in as_text]
    assert best.from_rows(drifted)[0].ratio == 1.3333
    assert best.from_rows([row | {"ratio": ""} for row in drifted])[0].ratio == pytest.approx(8 / 3)
    page = tmp_path / "page.md"
    page.write_text("<!-- best cuda: begin -->\n<!-- best cuda: end -->\n")
    assert best.main(["--device", "cuda", "--rows", str(tmp_path / "best.csv"), "--docs", str(page)]) == 0
    text = page.read_text()
    assert "in 0 of 1 cases. The others, us: S1 320x240: 20.0 against 15.0 (bin_owned, 1.33)." in text.replace("\n", " ")
    assert "| S1 | 20.0 (1.33) |" in text and "NOT THE BEST" in capsys.readouterr().out
    assert best.from_rows([row for row in as_text if row["variant"] != "auto"]) == []
    with pytest.raises(SystemExit, match="no rows of this script"):
        best.from_rows([{"scene": "S1"}])


def test_auto_is_not_its_own_rival() -> None:
    names = [way.name for way in best.all_ways("cpu", [])]
    assert names[0] == "auto" and native.VARIANTS["cpu"][0] not in names and set(native.VARIANTS["cpu"][1:]) <= {*names}


def test_turns_reverse(monkeypatch: pytest.MonkeyPatch) -> None:
    order: list[str] = []
    monkeypatch.setattr(cuda_clock.WallClock, "once", lambda self, call: call() or 10_000.0 * (call.args == ("b",)))
    calls = {name: functools.partial(order.append, name) for name in "abc"}
    times = cuda_clock.take_turns(cuda_clock.WallClock(), calls, 0)
    lengths = {"a": cuda_clock.TURN, "b": cuda_clock.SLOW_TURN, "c": cuda_clock.TURN}
    assert "".join(order) == "abc" + "".join(
        name * (1 + lengths[name]) for name in "abccbaabc"
    )  # the first of a turn does not count
    assert {name: [len(us) for us in rounds] for name, rounds in times.items()} == {n: [k] * 3 for n, k in lengths.items()}


def test_best_on_the_cpu(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cuda_floor, "FOLDER", tmp_path)
    path = tmp_path / "best.csv"
    options = ["--scenes", "R4k", "--size", "64x48", "--batches", "2x8x8", "--seconds", "0", "--csv", str(path)]
    assert best.main(["--device", "cpu", *options, "--batch-scenes", "R4k+R4k", "--setting", "bin_owned:records=1000"]) == 0
    rows = benchmark.read_csv(path)
    steps = {"bin_owned records=1048576", "bin_owned candidates=2097152", "two_stage share=64", "two_stage pairs=256"}
    ways = {row["variant"] for row in rows} - {"memset"}
    assert {"auto", *native.VARIANTS["cpu"][1:], "bin_owned records=1000", *steps} <= ways
    assert native.VARIANTS["cpu"][0] not in ways
    assert {(row["scene"], row["views"]) for row in rows} == {("R4k", "1"), ("R4k+R4k", "2")}
    assert {row["wrong_pixels"] for row in rows if row["variant"] != "memset"} == {"0"}
    assert "2 cases; 0 wrong pixels; 0 failures" in capsys.readouterr().out


# --- cases that nobody chose


def test_unchosen_cases_are_of_many_kinds_and_within_limits() -> None:
    low, high = unchosen.SIDES
    made = [unchosen.case(number, 5, {"ball": meshes.body(12, 3)}) for number in range(24)]
    for job, given in made:
        assert low <= min(job.width, job.height) and max(job.width, job.height) <= high
        assert max(job.width, job.height) <= unchosen.LONGEST * min(job.width, job.height)
        assert given.positions.shape[:-2] == ((job.views,) if job.views > 1 else ())
        assert given.triangles.dtype == np.int32 and given.triangles.min() >= 0
        assert given.triangles.max() < given.positions.shape[-2]
        assert job.views == 1 or job.views * job.width * job.height <= unchosen.MOST_PIXELS
        assert job.views == 1 or job.views * len(given.triangles) <= unchosen.MOST_TRIANGLES
    assert {"terrain", "room", "courtyard", "ball"} <= {re.sub(r"[\d*]+", " ", job.scene).split()[0] for job, _ in made}
    assert any("*" in job.scene for job, _ in made) and any("soup" in job.scene for job, _ in made)
    assert 0.1 < sum(job.views > 1 for job, _ in made) / len(made) < 0.6


def test_unchosen_cases_are_the_same_again() -> None:
    job, given = unchosen.case(2, 5, {})
    again_job, again = unchosen.case(2, 5, {})
    assert job == again_job
    assert np.array_equal(given.positions, again.positions) and np.array_equal(given.triangles, again.triangles)
    assert not np.array_equal(given.positions, unchosen.case(2, 6, {})[1].positions)


def test_copies_and_soup_show_the_same_triangles() -> None:
    body = meshes.body(8, 1)
    many = unchosen.copies(body, 3, np.random.default_rng(0))
    edges = np.diff(many.vertices[many.triangles], axis=1)  # those of each copy are the body's
    assert np.allclose(edges, np.tile(np.diff(body.vertices[body.triangles], axis=1), (3, 1, 1)))
    alone = unchosen.soup(body)
    assert np.array_equal(alone.vertices[alone.triangles], body.vertices[body.triangles])
    assert np.array_equal(np.sort(alone.triangles, axis=None), np.arange(len(alone.vertices)))


def test_best_of_unchosen_cases(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cuda_floor, "FOLDER", tmp_path)
    monkeypatch.setattr(unchosen, "SIDES", (16, 64))
    monkeypatch.setattr(unchosen, "KINDS", ("copies", "soup"))
    path = tmp_path / "best.csv"
    assert best.main(["--device", "cpu", "--unchosen", "1", "--seeds", "3,4", "--seconds", "0", "--csv", str(path)]) == 0
    assert {(row["scene"].split()[0], row["seed"]) for row in benchmark.read_csv(path)} == {("0", "3"), ("0", "4")}
    assert "2 cases; 0 wrong pixels; 0 failures" in capsys.readouterr().out
    assert best.main(["--device", "cpu", "--unchosen", "2", "--total", "0.0001"]) == 1
    assert "2 left out" in capsys.readouterr().out


# --- scaling


def test_ways() -> None:
    todo = cuda_scaling.ways(TODAY)
    paths = [f"bin_owned {path}" for path in ("few", "rows", "share 32", "share 128", "share 256", "share 1024")]
    assert [way.name for way in todo] == [*TODAY, *paths, "auto"]

    def on(curve: str) -> list[str]:
        return [way.name for way in cuda_scaling.ways_on(curve, todo, TODAY)]

    assert on("count") == [*TODAY, *paths] and on("body_count") == ["auto"]
    assert on("rows") == ["bin_owned", "two_stage"]  # persistent does not have it


def test_points_of_rows_set_the_parameter(monkeypatch: pytest.MonkeyPatch) -> None:
    points = [*cuda_scaling.rows_points()]
    assert {point.x for point in points} == {*cuda_scaling.WIDEST} and all(point.widest == point.x for point in points)
    assert cuda_scaling.WIDEST[0] == 1 and cuda_scaling.WIDEST[-1] == 256
    assert min(len(point.given().triangles) for point in points[:: len(cuda_scaling.WIDEST)]) > 256  # else bin_owned draws few
    given: list[dict[str, int]] = []
    monkeypatch.setattr(native, "using_parameters", lambda **values: given.append(values) or contextlib.nullcontext())
    way = cuda_cases.Way("bin_owned", "", {"queue": 7})
    for point in (points[0], points[0]._replace(widest=None)):
        with cuda_scaling.setting(way, point):
            pass
    assert given == [{"queue": 7, "widest": 1}, {"queue": 7}]


def test_limits() -> None:
    few, other, rows = (
        cuda_cases.Way("bin_owned", path, {}, most) for path, most in (("few", 256), ("other", 4096), ("rows", cuda_cases.EVERY))
    )
    point = cuda_scaling.Point("count", "mesh", 10, 8, 8, lambda: None)
    limits = cuda_scaling.Limits()
    assert limits.allows(point, rows, 10**7)  # nothing is known
    assert limits.allows(point, few, 256) and not limits.allows(point, few, 257) and not limits.allows(point, other, 4097)
    limits.saw(point, rows, 1000, 1_000.0)
    assert limits.allows(point, rows, 100_000) and not limits.allows(point, rows, 10**6)
    limits.saw(point, other, 1000, cuda_scaling.LIMIT + 1)
    assert not limits.allows(point, other, 1000)
    assert limits.allows(point._replace(kind="other"), other, 1000)
    limits.saw(point._replace(curve="rows"), rows, 1000, cuda_scaling.LIMIT + 1)  # the next point may be faster
    assert limits.allows(point._replace(curve="rows"), rows, 1000)


def test_scattered_triangles_have_the_area_asked_for() -> None:
    mesh = cuda_scaling.scattered(300, 1920, 1080, 1, (500, 5000))
    a, b, c = (mesh.vertices[mesh.triangles[:, k], :2] for k in range(3))
    area = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
    assert len(area) == 300 and area.min() > 490 and area.max() < 5050  # vertices are moved to the grid


def test_layers_cover_the_image_so_often() -> None:
    width, height = 97, 61
    mesh = cuda_scaling.layers_of(30, width, height, 3)
    a, b, c = (mesh.vertices[mesh.triangles[:, k], :2] for k in range(3))
    area = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
    assert area.sum() == pytest.approx(3 * (width - 1) * (height - 1), rel=0.01)  # meshes end half a pixel within


def test_every_curve_grows() -> None:
    """What `Limits` relies on: the number of triangles, or of pixels, never falls along a curve."""
    for name, points in (cuda_scaling.CURVES | cuda_scaling.SWEEPS).items():
        last: dict[str, float] = {}
        for point in points():
            size = 1 / point.x if name == "area" else point.x
            assert size >= last.get(point.kind, 0), (name, point.kind, point.x)
            last[point.kind] = size
            assert cuda_scaling.fits(point, 16384)


def test_shuffled_keeps_the_triangles() -> None:
    mesh = scenes.full_screen(50, 64, 64, 1, False)
    other = cuda_scaling.shuffled(mesh)
    assert not np.array_equal(mesh.triangles, other.triangles)
    np.testing.assert_array_equal(np.sort(mesh.triangles, axis=0), np.sort(other.triangles, axis=0))


def test_scaling_rows() -> None:
    point = cuda_scaling.Point("count", "mesh", 50, 96, 64, lambda: scenes.small_mesh(50, 96, 64, 1))
    scaling = cuda_scaling.Scaling(FakeClock(100), HERE, CPU, 0.01)
    todo = [cuda_cases.Way(name, "", {}) for name in native.VARIANTS["cpu"]]
    scaling.point(point, point.given(), todo)
    assert [cuda_scaling.name_of(r) for r in scaling.rows] == [way.name for way in todo]
    assert {(r.wrong_pixels, r.against, r.us_median, r.triangles) for r in scaling.rows} == {(0, "cpu", 200, 50)}
    slow = cuda_scaling.Scaling(FakeClock(cuda_scaling.LIMIT * 2), HERE, CPU, 0.01)
    slow.point(point, point.given(), todo)
    assert not slow.rows and not slow.failures


def test_large_images_are_compared_with_the_first_way(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cuda_scaling, "CPU_PIXELS", 10)
    point = cuda_scaling.Point("count", "mesh", 50, 96, 64, lambda: scenes.small_mesh(50, 96, 64, 1))
    scaling = cuda_scaling.Scaling(FakeClock(100), HERE, CPU, 0.01)
    scaling.point(point, point.given(), [cuda_cases.Way(name, "", {}) for name in native.VARIANTS["cpu"]])
    assert {(r.wrong_pixels, r.against) for r in scaling.rows} == {(0, "bin_owned")}


def test_sweeps_have_what_they_say() -> None:
    assert cuda_scaling.steps(10, 1_000_000, 1.5)[:4] == [10, 15, 22, 33]
    for low, high, factor in ((10, 1_000_000, 1.5), (1, 200, 1.5), (64, 4096, 2**0.5), (2, 1024, 1.5)):
        found = cuda_scaling.steps(low, high, factor)
        assert (found[0], found[-1]) == (low, high)
        assert all(a < b <= factor * a + 1 for a, b in zip(found, found[1:], strict=False))
    for count in (10, 33, 1000):
        given = cuda_scaling.first_of(count)
        assert len(given.triangles) == count and given.triangles.max() == len(given.positions) - 1
    point = next(p for p in cuda_scaling.body_views_points() if p.x == 10)
    assert point.given().positions.shape[0] == point.views == 10 and cuda_scaling.bytes_of(point) == 10 * 128 * 128 * 17


@pytest.mark.parametrize("percent", [10, 50, 100])
def test_a_body_is_as_high_as_it_says(percent: int) -> None:
    given = cuda_scaling.as_high(4000, percent)
    high = np.ptp(given.positions[:, 1] / given.positions[:, 3]) / 2 * 100  # percent of the picture
    assert 0.7 * percent < high <= percent  # the body fills most of the ball around it


def test_cliffs() -> None:
    x = [10 * 2**k for k in range(8)]
    smooth = [5 + count / 10 for count in x]
    assert cuda_scaling.cliffs(x, smooth) == []
    assert cuda_scaling.cliffs(x, [us + 20 * (count > 100) for us, count in zip(smooth, x, strict=True)]) == [3]
    assert cuda_scaling.cliffs(x, [us + 20 * (count < 100) for us, count in zip(smooth, x, strict=True)]) == [3]
    low = [us / 20 + 0.5 * (count > 100) for us, count in zip(smooth, x, strict=True)]
    assert cuda_scaling.cliffs(x, low) == []  # less than 1 us is none
    assert cuda_scaling.cliffs([2, 3, 6, 7], [2.0, 3.0, 6.0, 7.0]) == []  # steps need not be alike
    assert cuda_scaling.cliffs([1], [1.0]) == []


def test_cliffs_are_reported() -> None:
    def at(x: int, us: float, curve: str = "body_count"):
        return cuda_scaling.Row(curve, "8 x 8", x, 8, 8, "auto", "", None, x, "graph", us, us, us, us, 9, 0, "cpu", 1.0, *HERE)

    rows = [at(10, 5), at(15, 5.1), at(22, 15), at(33, 15.2), at(10, 1, "count"), at(15, 99, "count")]
    assert cuda_scaling.cliff_lines(rows) == [
        "body_count 8 x 8: from 5.10 us at 15 to 15.0 at 22",
        "body_count 8 x 8: 1 cliffs in 4 points",
    ]


def test_sweep_dry_run(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cuda_floor, "FOLDER", tmp_path)
    path = tmp_path / "sweeps.csv"
    options = ["--dry-run", "--curves", "body_count,rows", "--most", "100", "--largest", "256", "--seconds", "0"]
    assert cuda_scaling.main([*options, "--csv", str(path)]) == 0
    rows = benchmark.read_csv(path)
    assert [int(row["x"]) for row in rows] == [10, 15, 22, 33, 49, 73] and {row["variant"] for row in rows} == {"auto"}
    said = capsys.readouterr().out
    assert "rows: left out, it compares none of the ways" in said and "cliffs in 6 points" in said


# --- pictures


def test_crossovers() -> None:
    plot = pytest.importorskip("matplotlib") and importlib.import_module("cuda_plot")
    x = [1, 10, 100, 1000]
    [(at, before, after)] = plot.crossovers(x, {"a": [1, 10, 100, 1000], "b": [30, 30, 30, 30]})
    assert (before, after) == ("a", "b") and at == pytest.approx(30)
    assert plot.crossovers(x, {"a": [1, 1, 1, 1], "b": [1.01, 1, 0.99, 0.99]}) == []  # within 3 %
    [(at, before, after)] = plot.crossovers(x, {"a": [1, 1, None, None], "b": [2, 2, 2, 2]})  # "a" cannot go on
    assert (before, after) == ("a", "b") and at == pytest.approx(math.sqrt(1000))
    assert plot.crossovers([1], {"a": [None]}) == []


def test_a_panel_has_no_more_kinds_than_line_styles() -> None:
    plot = pytest.importorskip("matplotlib") and importlib.import_module("cuda_plot")
    assert [kind for _, kind in plot.styled([{"kind": kind} for kind in "abcda"])] == list("abcd")
    with pytest.raises(ValueError, match="4 line styles, not one for each of a, b, c, d, e"):
        plot.styled([{"kind": kind} for kind in "abcde"])


def test_pictures_are_made(tmp_path: Path) -> None:
    plot = pytest.importorskip("matplotlib") and importlib.import_module("cuda_plot")
    rows = [
        row(name, us, scene=scene)
        for scene in ("S1", "a model")
        for name, us in (("memset", 7), ("floor list", 9), ("bin_owned", 10))
    ]
    rows += [dataclasses.replace(rows[0], scene="R4k+R16k", views=64)]  # a batch has no bar
    benchmark.write_csv(tmp_path / "run.csv", rows, cuda_clock.DIGITS)
    plot.scene_bars(benchmark.read_csv(tmp_path / "run.csv"), tmp_path)
    assert (tmp_path / "cuda_scenes_1920x1080.png").stat().st_size > 1000
    points = [
        cuda_scaling.Row(curve, "10 px", x, 8, 8, w.variant, w.path, None, x, "graph", x, x, x, x, 9, 0, "cpu", 1.0, *HERE)
        for curve in (*cuda_scaling.CURVES, *cuda_scaling.SWEEPS)
        for x in (1, 16)
        for w in cuda_scaling.ways(TODAY)
    ]
    benchmark.write_csv(tmp_path / "scaling.csv", points, cuda_clock.DIGITS)
    plot.scaling(benchmark.read_csv(tmp_path / "scaling.csv"), tmp_path)
    plot.widest(benchmark.read_csv(tmp_path / "scaling.csv"), tmp_path)
    assert (tmp_path / "cuda_scaling.png").exists() and (tmp_path / "cuda_rows.png").exists()
    plot.sweeps(benchmark.read_csv(tmp_path / "scaling.csv"), tmp_path)
    assert (tmp_path / "cuda_sweeps.png").stat().st_size > 1000


# --- the script for a GPU machine


def test_sanitize_draws_what_it_says() -> None:
    pictures = sanitize.pictures(200, 150)
    clipped = pictures["clipped"]
    records, _ = bigtri.stages.setup(*clipped, 150, 200, backend="native")
    assert records.clipped.any() and not records.clipped.all()
    assert bigtri.rasterize(*pictures["bad values"], (150, 200)).dropped > 0
    assert all(set(tuning) <= PARAMETERS for tuning in sanitize.PATHS.values())


@pytest.mark.skipif(not shutil.which("bash"), reason="no bash")
def test_gpu_script_goes_on_after_a_failure(tmp_path: Path) -> None:
    subprocess.run(["bash", "-n", str(BENCH / "gpu.sh")], check=True)
    environment = {"PATH": "/usr/bin:/bin", "OUT": str(tmp_path), "PYTHON": "false"}
    steps = ["quick", "bench", "best", "sweep"]
    done = subprocess.run(["bash", str(BENCH / "gpu.sh"), *steps], capture_output=True, text=True, env=environment)
    assert done.returncode == 1
    summary = (tmp_path / "summary.txt").read_text()
    assert summary.count("FAILED") == len(steps) and done.stdout.endswith(summary)


def test_tables_from_rows() -> None:
    def row(scene: str, variant: str, us: float, views: int = 1) -> dict[str, str]:
        size = {"width": "256", "height": "256", "views": str(views)}
        return {"scene": scene, "variant": variant, "triangles": "4072", "us_median": str(us), **size}

    rows = [row("R4k", "auto", 8.5), row("R4k", "memset", 3.0), row("R4k", "two_stage", 11.0), row("R4k", "auto", 40.0, 64)]
    times = gpu_tables.Times(rows)
    lines = times.real(["R4k", "R1M"], "64 of 256x256").splitlines()
    assert len(lines) == 4 and lines[2:] == [
        "| R4k: a body, seen whole | 4,072 | 8.50 |  |  |  | 40.0 |",
        "| a memset of the image |  | 3.00 |  |  |  |  |",
    ]
    assert "| R4k | 40.0, 1.60M |" in times.batches()

"""The GPU benchmark's parts that need no GPU: the floor's lists, bookkeeping, limits, tables. Nothing here asserts a time."""

from __future__ import annotations

import contextlib
import csv
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
from bigtri.study import benchmark, scenes

BENCH = Path(__file__).parents[2] / "bench"
CSRC = Path(bigtri.__file__).parent / "csrc"
if not BENCH.exists():
    pytest.skip("bench/ is not here", allow_module_level=True)
if str(BENCH) not in sys.path:
    sys.path.append(str(BENCH))
# What some variant on CUDA has as a parameter, where it is built or not.
PARAMETERS = set(re.findall(r'\bX\((\w+), "', "".join(f.read_text() for f in sorted(CSRC.glob("cuda/*")))))

cuda_clock, cuda_floor, cuda_run, cuda_scaling, sanitize = (
    importlib.import_module(name) for name in ("cuda_clock", "cuda_floor", "cuda_run", "cuda_scaling", "sanitize")
)

pytestmark = pytest.mark.skipif(not native.available(), reason="the extension is not built")
needs_compiler = pytest.mark.skipif(not (shutil.which("c++") or shutil.which("g++")), reason="no C++ compiler")
CPU = torch.device("cpu")
HERE = cuda_clock.Machine("some GPU", "1", "2", "3", "abc", "test")


@pytest.fixture(scope="module")
def floor(tmp_path_factory: pytest.TempPathFactory):
    return cuda_floor.Floor(CPU, tmp_path_factory.mktemp("floor"))


# --- the floor


@needs_compiler
@pytest.mark.parametrize("name, width, height", [("S1", 640, 360), ("S3", 203, 151), ("S4f", 64, 8), ("S6-200k", 333, 97)])
def test_floor_shows_the_same_triangles(floor, name: str, width: int, height: int) -> None:
    scene = scenes.make(name, width, height)
    case = cuda_run.Case(name, width, height, scenes.SEED, scene, CPU)
    lists = floor.lists(scene, width, height)
    for kind in cuda_floor.KINDS:
        assert case.wrong_triangles(lambda kind=kind: floor.fill(kind, lists, case.packed)) == 0


@needs_compiler
def test_floor_of_clipped_triangles(floor) -> None:
    """Several records of one triangle, and triangles that touch no pixel."""
    scene = sanitize.clip_space(3, 40, (-0.5, 2))
    scene.positions[:, 2] = 0  # the floor does not know the far plane
    case = cuda_run.Case("clipped", 121, 67, 0, scene, CPU)
    lists = floor.lists(scene, 121, 67)
    covered = int(lists.first[-1])
    assert covered == len(lists.items) > 0
    case.packed.fill_(cuda_clock.POISON)
    floor.fill("floor list", lists, case.packed)
    background = 2**63 - 1
    assert torch.equal(case.packed == background, case.expected == background)


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
            def __init__(self, graph: Graph, stream: object) -> None:
                self.graph = graph

            def __enter__(self) -> None:
                outer.captured = 0

            def __exit__(self, *exc: object) -> None:
                self.graph.frames, outer.captured = outer.captured, None

        class Stream:
            def wait_stream(self, other: object) -> None: ...

        stand_ins = {"Event": Event, "CUDAGraph": Graph, "graph": Capture, "Stream": Stream, "current_stream": Stream}
        stand_ins |= {"stream": lambda stream: contextlib.nullcontext(), "synchronize": lambda: None, "_sleep": self.sleep}
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


class FakeClock:
    """Takes as long as it is told."""

    def __init__(self, us: float) -> None:
        self.us = us

    def once(self, call) -> float:
        return self.us

    def measure(self, call, method: str, seconds: float, at_least: int = 50):
        call()
        return cuda_clock.Measurement([self.us, self.us * 2, self.us * 3], call)


def test_rows_and_wrong_pixels() -> None:
    case = cuda_run.Case("S1", 320, 240, 1000, scenes.make("S2", 1280, 720), CPU)
    bench = cuda_run.Bench(FakeClock(10), None, HERE, ["graph", "cold"], 0.1)
    bench.case(case, ["auto"])
    bench.measure(case, "broken", lambda: case.packed.zero_(), case.wrong_pixels)
    assert [(row.variant, row.method, row.wrong_pixels) for row in bench.rows[:2]] == [("auto", "graph", 0), ("auto", "cold", 0)]
    assert [row.wrong_pixels for row in bench.rows[2:]] == [320 * 240] * 2
    assert bench.wrong() == 2 * 320 * 240
    assert (bench.rows[0].us_median, bench.rows[0].us_min, bench.rows[0].repeats, bench.rows[0].commit) == (20, 10, 3, "abc")


def test_what_is_not_drawn_is_wrong() -> None:
    """The image is poisoned first, so a frame that writes nothing cannot pass with the last one's pixels."""
    case = cuda_run.Case("S1", 320, 240, 1000, scenes.make("S2", 1280, 720), CPU)
    case.draw("auto")
    assert case.wrong_pixels(lambda: None) == 320 * 240
    assert case.wrong_triangles(lambda: None) == 320 * 240


def test_failures_are_kept() -> None:
    def fail() -> None:
        raise RuntimeError("no room\nand more")

    case = cuda_run.Case("S1", 32, 24, 1000, sanitize.pictures(200, 150)["one"], CPU)
    bench = cuda_run.Bench(FakeClock(10), None, HERE, ["graph"], 0.1)
    bench.measure(case, "auto", fail)
    assert not bench.rows and bench.failures == ["S1 32x24 auto graph: no room"]


def row(variant: str, us: float, seed: int = scenes.SEED, method: str = "graph", scene: str = "S1"):
    return cuda_clock.Row(scene, 1920, 1080, seed, variant, 8, method, us, us, us, us, 50, 0, *HERE)


def test_peers_are_there_for_the_default_seed() -> None:
    peers = cuda_run.read_peers()
    assert {name for name, *_ in peers} == {"CuRast", "nvdiffrast", "OpenGL"}
    assert len(peers) == 3 * 8 * 2 and all(us > 0 for us in peers.values())
    times = cuda_run.Times([], peers)
    assert times.get(("S1", 1920, 1080, scenes.SEED), "CuRast") == 51.7
    assert times.get(("S1", 1920, 1080, 7), "CuRast") is None
    assert times.get(("S1", 1000, 1080, scenes.SEED), "CuRast") is None


def test_tables() -> None:
    rows = [
        row("memset", 7),
        row("floor list", 9),
        row("floor shuffle", 8),
        row("bin_owned", 10),
        row("bin_owned", 9.5, method="cold"),
    ]
    times = cuda_run.Times(rows, {("CuRast", "S1", 1920, 1080): 50.0})
    assert times.get(("S1", 1920, 1080, scenes.SEED), "floor") == 8
    last = cuda_run.case_lines(rows, times)[-1]
    assert last.split()[:4] == ["S1", "1920x1080", str(scenes.SEED), "bin_owned"]
    assert last.split()[-5:] == [
        "1.43",
        "1.25",
        "5.00",
        "-",
        "0",
    ]  # times memset and the floor; the peers' over ours; wrong pixels
    assert any(line.startswith("CuRast") and line.endswith("50.0") for line in cuda_run.summary_lines(rows, times))


@needs_compiler
def test_dry_run(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cuda_floor, "FOLDER", tmp_path)
    path = tmp_path / "rows.csv"
    assert cuda_run.main(["--dry-run", "--scenes", "S1,S5", "--size", "640x361", "--seeds", "1000,5", "--csv", str(path)]) == 0
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    variants = {*cuda_run.YARDSTICKS, *native.VARIANTS["cpu"], "auto"}
    assert {r["variant"] for r in rows} == variants
    assert len(rows) == 2 * len(variants) * len(cuda_clock.METHODS)  # two seeds; S5 does not fit the image
    assert {r["wrong_pixels"] for r in rows if r["variant"] in (*native.VARIANTS["cpu"], *cuda_floor.KINDS)} == {"0"}
    assert "0 wrong pixels" in capsys.readouterr().out


def test_without_a_gpu_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(native, "devices", lambda: ["cpu"])
    with pytest.raises(SystemExit, match="no GPU"):
        cuda_run.main([])


# --- scaling


def test_ways() -> None:
    names = [way.name for way in cuda_scaling.ways(("bin_owned", "persistent"))]
    assert names == ["bin_owned", "persistent", "bin_owned few", "bin_owned some", "bin_owned many"]
    assert all(set(way.tuning) <= PARAMETERS for way in cuda_scaling.ways(("bin_owned",)))


def test_limits() -> None:
    few, some, many = (cuda_scaling.Way("bin_owned", path, {}) for path in ("few", "some", "many"))
    point = cuda_scaling.Point("count", "mesh", 10, 8, 8, lambda: None)
    limits = cuda_scaling.Limits()
    assert limits.allows(point, many, 10**7)  # nothing is known
    assert not limits.allows(point, few, 257) and not limits.allows(point, some, 65537)
    limits.saw(point, many, 1000, 1_000.0)
    assert limits.allows(point, many, 100_000) and not limits.allows(point, many, 10**6)
    limits.saw(point, some, 1000, cuda_scaling.LIMIT + 1)
    assert not limits.allows(point, some, 1000)
    assert limits.allows(point._replace(kind="other"), some, 1000)
    threshold = point._replace(curve="threshold")
    assert limits.allows(threshold, many, 1000) and not limits.allows(threshold, few, 1000)


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
    for name, points in cuda_scaling.CURVES.items():
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
    todo = cuda_scaling.ways(("bin_owned",))
    scaling.point(point, scenes.to_clip(point.make(), 96, 64), todo)
    assert [cuda_scaling.name_of(r) for r in scaling.rows] == [way.name for way in todo]
    assert {(r.wrong_pixels, r.against, r.us_median, r.triangles) for r in scaling.rows} == {(0, "cpu", 200, 50)}
    slow = cuda_scaling.Scaling(FakeClock(cuda_scaling.LIMIT * 2), HERE, CPU, 0.01)
    slow.point(point, scenes.to_clip(point.make(), 96, 64), todo)
    assert not slow.rows and not slow.failures


def test_large_images_are_compared_with_the_first_way(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cuda_scaling, "CPU_PIXELS", 10)
    point = cuda_scaling.Point("count", "mesh", 50, 96, 64, lambda: scenes.small_mesh(50, 96, 64, 1))
    scaling = cuda_scaling.Scaling(FakeClock(100), HERE, CPU, 0.01)
    scaling.point(point, scenes.to_clip(point.make(), 96, 64), cuda_scaling.ways(("bin_owned",)))
    assert {(r.wrong_pixels, r.against) for r in scaling.rows} == {(0, "bin_owned")}


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


def test_pictures_are_made(tmp_path: Path) -> None:
    plot = pytest.importorskip("matplotlib") and importlib.import_module("cuda_plot")
    rows = [
        row(name, us, scene=scene) for scene in ("S1", "S3") for name, us in (("memset", 7), ("floor list", 9), ("bin_owned", 10))
    ]
    benchmark.write_csv(tmp_path / "run.csv", rows, cuda_clock.DIGITS)
    plot.scene_bars(benchmark.read_csv(tmp_path / "run.csv"), tmp_path)
    assert (tmp_path / "cuda_scenes_1920x1080.png").stat().st_size > 1000
    todo = cuda_scaling.ways(("bin_owned",))
    points = [
        cuda_scaling.Row(curve, "kind 1", x, 8, 8, w.variant, w.path, None, x, "graph", x, x, x, x, 9, 0, "cpu", 1.0, *HERE)
        for curve in cuda_scaling.CURVES
        for x in (1, 10)
        for w in todo
    ]
    for point in points:
        point.kind = "10 px"
    benchmark.write_csv(tmp_path / "scaling.csv", points, cuda_clock.DIGITS)
    plot.scaling(benchmark.read_csv(tmp_path / "scaling.csv"), tmp_path)
    plot.threshold(benchmark.read_csv(tmp_path / "scaling.csv"), tmp_path)
    assert (tmp_path / "cuda_scaling.png").exists() and (tmp_path / "cuda_threshold.png").exists()


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
    done = subprocess.run(["bash", str(BENCH / "gpu.sh"), "quick", "bench"], capture_output=True, text=True, env=environment)
    assert done.returncode == 1
    summary = (tmp_path / "summary.txt").read_text()
    assert summary.count("FAILED") == 2 and done.stdout.endswith(summary)

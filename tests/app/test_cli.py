"""The command line: what it writes, what it says, and how it fails."""

import subprocess
import sys

import gltf_files
import numpy as np
import pytest
import trimesh
from skimage import io

from bigtri import __version__, warn
from bigtri.app import bench, cli
from bigtri.choices import VIEWS


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "box.glb"
    trimesh.creation.box().export(path)
    return path


def test_render(model, tmp_path, capsys):
    out = tmp_path / "box.png"
    assert cli.main(["render", str(model), "-o", str(out), "--size", "80x60", "--azimuth", "45", "--threads", "1"]) == 0
    printed = capsys.readouterr()
    assert printed.out.split() == [str(out)]
    assert "12 triangles" in printed.err and "drawing shaded" in printed.err
    image = io.imread(out)
    assert image.shape == (60, 80, 3)
    assert not np.array_equal(image[30, 40], image[30, 2])


def test_render_all_views(model, tmp_path):
    assert (
        cli.main(["render", str(model), "-o", str(tmp_path / "v.png"), "--size", "64x48", "--view", "all", "--supersample", "1"])
        == 0
    )
    assert sorted(path.name for path in tmp_path.glob("v-*.png")) == sorted(f"v-{view}.png" for view in VIEWS)


def test_backends_draw_the_same(model, tmp_path):
    images = []
    for backend in ("reference", "auto"):
        assert cli.main(["render", str(model), "-o", str(tmp_path / "x.png"), "--size", "64x48", "--backend", backend]) == 0
        images.append(io.imread(tmp_path / "x.png"))
    assert np.array_equal(*images)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["nowhere.glb", "-o", "x.png"], "no such file: nowhere.glb"),
        (["{model}", "-o", "x.svg"], "--out must end in .png"),
        (["{model}", "-o", "no/such/folder/x.png"], "make it first"),
        (["{model}", "-o", "{folder}/folder.png"], "--out must be a file"),
        (["{folder}/two.obj", "-o", "{folder}/x.png"], "line 1: v must have 3 numbers or more, got '0 0'"),
        (["{model}", "-o", "{folder}/x.png", "--fov", "200"], "fov_y must be in"),
        (["{model}", "-o", "{folder}/x.png", "--azimuth", "inf"], "azimuth must be a finite number"),
        (["{model}", "-o", "{folder}/x.png", "--size", "4096x9", "--supersample", "5"], "--supersample must be at most 4"),
        (["{model}", "-o", "{folder}/x.png", "--elevation", "95"], "elevation must be in"),
    ],
)
def test_wrong_input_exits_with_2(model, tmp_path, capsys, arguments, text):
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "two.obj").write_text("v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n")
    assert cli.main(["render", *(a.format(model=model, folder=tmp_path) for a in arguments)]) == 2
    error = capsys.readouterr().err
    assert text in error and error.splitlines()[-1].startswith("bigtri render: ") and "Traceback" not in error


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["paint"],
        ["render"],
        ["render", "m.glb", "-o", "x.png", "--size", "80"],
        ["render", "m.glb", "-o", "x.png", "--size", "0x9"],
        ["render", "m.glb", "-o", "x.png", "--view", "none"],
        ["render", "m.glb", "-o", "x.png", "--supersample", "0"],
        ["render", "m.glb", "-o", "x.png", "--threads", "100000000000"],
        ["bench", "--scenes", "S1", "--size", "10x10"],
        ["hard-cases", "--csv", "."],
    ],
)
def test_a_wrong_command_line_exits_with_2(arguments, capsys):
    with pytest.raises(SystemExit) as stopped:
        cli.main(arguments)
    assert stopped.value.code == 2
    assert "usage: bigtri" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "code"), [(ValueError("a\nb"), 2), (OSError("x"), 2), (RuntimeError("x"), 1), (MemoryError(), 1)]
)
def test_errors_are_one_line(monkeypatch, capsys, error, code):
    def fail(argv):
        raise error

    monkeypatch.setattr(bench, "main", fail)
    assert cli.main(["bench"]) == code
    assert capsys.readouterr().err in ("bigtri bench: a b\n", "bigtri bench: x\n", "bigtri bench: MemoryError\n")


def test_every_view_of_few_pixels(model, tmp_path):
    assert cli.main(["render", str(model), "-o", str(tmp_path / "v.png"), "--size", "18x40", "--view", "all"]) == 0
    assert io.imread(tmp_path / "v-overdraw.png").shape == (40, 18, 3)


def test_warnings_are_one_line(tmp_path, capsys):
    (tmp_path / "one.obj").write_text("mtllib gone.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    assert cli.main(["render", str(tmp_path / "one.obj"), "-o", str(tmp_path / "x.png"), "--size", "32x32"]) == 0
    warning = [line for line in capsys.readouterr().err.splitlines() if "gone.mtl" in line]
    assert len(warning) == 1 and warning[0].startswith("bigtri: warning: ")


def lamp(folder):
    """A square whose material emits light, beside a line."""
    file = gltf_files.quad(material=0)
    file.material(emissiveFactor=[1, 1, 1], name="lamp")
    file.node(file.primitive({"POSITION": gltf_files.QUAD[:2]}, mode=1))
    return file.write(folder / "lamp.glb")


def test_strict(tmp_path, capsys):
    arguments = ["render", str(lamp(tmp_path)), "-o", str(tmp_path / "x.png"), "--size", "32x32"]
    assert cli.main([*arguments, "--strict"]) == 2
    assert not (tmp_path / "x.png").exists()
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("bigtri render: ") and "emits light" in error and "lines (primitive mode 1) are not drawn" in error
    assert cli.main(arguments) == 0
    assert sum(line.startswith("bigtri: warning: ") for line in capsys.readouterr().err.splitlines()) == 2


def test_info_of_a_model(tmp_path, capsys):
    path = lamp(tmp_path)
    assert cli.main(["info", str(path)]) == 0
    lines = dict(line.split(":", 1) for line in capsys.readouterr().out.splitlines())
    assert {name: value.strip() for name, value in lines.items()} == {
        "file": f"{path}, {path.stat().st_size} bytes",
        "meshes": "1, placed 1 times",
        "triangles": "2",
        "vertices": "4, with positions alone",
        "materials": "1",
        "images": "0",
        "points and lines": "1",
        "drawn": "2 triangles, 4 vertices",
        "drawn with": "1 materials, 0 with a texture, 1 lit from both sides",
        "drawn from": "-1 -1 0 to 1 1 0 (x y z)",
        "not drawn, emission": "a material emits light (emissiveFactor): it is drawn without it (found: 1)",
        "not drawn, lines": "lines (primitive mode 1) are not drawn (found: 1)",
    }


def test_info_of_a_model_without_triangles(tmp_path, capsys):
    path = gltf_files.quad(mode=0).write(tmp_path / "points.gltf")
    assert cli.main(["info", str(path)]) == 0
    assert "nothing: there are no triangles in it" in capsys.readouterr().out
    assert cli.main(["info", str(tmp_path / "nowhere.glb")]) == 2
    assert "no such file" in capsys.readouterr().err


def test_info_of_a_model_that_is_drawn_whole(model, capsys):
    assert cli.main(["info", str(model)]) == 0
    printed = capsys.readouterr()
    assert "not drawn:  nothing is left out" in printed.out
    assert printed.err == f"reading {model}\n"  # before what may take seconds


def test_explain(model, capsys):
    assert cli.main(["explain", str(model)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == ["effect", "why", "costs"]
    rows = {line[:16].strip(): line for line in lines[1:]}
    assert "on" in rows["lights"].split() and "2 lights" in rows["lights"]
    assert "off" in rows["textures"].split() and "triangles cross a plane" in rows["clipping"]


def test_radians_on_the_command_line(model, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(warn, "_said", set())
    out = str(tmp_path / "x.png")
    assert cli.main(["render", str(model), "-o", out, "--size", "32x32", "--fov", "0.7"]) == 0
    said = [line for line in capsys.readouterr().err.splitlines() if "warning" in line]
    assert said == [
        "bigtri: warning: bigtri.Camera.framing: fov_y is in degrees, got 0.7, which looks like radians; "
        "0.7 radians are 40.107 degrees"
    ]


def test_info(capsys):
    assert cli.main(["info"]) == 0
    lines = capsys.readouterr().out.splitlines()
    names = {line.partition(":")[0] for line in lines}
    assert {"bigtri", "python", "torch", "numpy", "system", "processor", "instruction sets", "extension", "torch CUDA"} <= names
    assert __version__ in lines[0]


def test_bench_hands_its_arguments_on(monkeypatch):
    received = []
    monkeypatch.setattr(bench, "main", lambda argv: received.append(argv) or 0)
    assert cli.main(["bench", "--quick", "--help"]) == 0
    assert received == [["--quick", "--help"]]


@pytest.mark.parametrize("arguments", [["--help"], ["render", "--help"], ["demo", "--help"], ["--version"]])
def test_help_as_a_module(arguments):
    done = subprocess.run([sys.executable, "-m", "bigtri", *arguments], capture_output=True, text=True, check=True)
    assert "bigtri" in done.stdout and not done.stderr
    assert "--version" in arguments or "example" in done.stdout


HEAVY = ("torch", "trimesh", "skimage", "PIL")


def imported(*arguments):
    """Which of HEAVY a Python with these arguments imports: its own list of imports, which goes to stderr, is read."""
    done = subprocess.run([sys.executable, "-X", "importtime", *arguments], capture_output=True, text=True)
    names = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines() if line.startswith("import time:")}
    assert "bigtri" in names
    return done, [name for name in HEAVY if name in names]


@pytest.mark.parametrize(
    "arguments",
    [
        ["--version"],
        ["--help"],
        *([command, "--help"] for command in ("render", "info", "bench", "compare", "accuracy", "demo", "hard-cases")),
    ],
    ids=" ".join,
)
def test_help_imports_no_torch(arguments):
    done, heavy = imported("-m", "bigtri", *arguments)
    assert done.returncode == 0 and done.stdout
    assert not heavy


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["paint"],
        ["render", "m.glb", "-o", "x.png", "--size", "0x9"],
        ["render", "m.glb", "-o", "x.png", "--cull", "all"],
        ["bench", "--size", "0x9"],
        ["bench", "--scenes", "S9"],
        ["compare", "S2", "--precision", "none"],
        ["demo", "--threads", "0"],
        ["hard-cases", "--csv", "."],
    ],
    ids=" ".join,
)
def test_a_wrong_command_line_imports_no_torch(arguments):
    done, heavy = imported("-m", "bigtri", *arguments)
    assert done.returncode == 2 and "usage: bigtri" in done.stderr
    assert not heavy


def test_the_package_imports_nothing_heavy():
    done, heavy = imported("-c", "import bigtri, bigtri.reference, bigtri.choices")
    assert done.returncode == 0
    assert not heavy


def test_an_operation_imports_torch_alone():
    """The other way round: what is looked for would be found, and an operation needs no reader of files."""
    done, heavy = imported("-c", "import bigtri; bigtri.rasterize")
    assert done.returncode == 0
    assert heavy == ["torch"]


def test_demo(tmp_path, capsys):
    assert cli.main(["demo", "--out", str(tmp_path / "pictures"), "--size", "320x180"]) == 0
    printed = capsys.readouterr()
    written = [path.name for path in (tmp_path / "pictures").iterdir()]
    expected = ["shaded", "normals", "depth", "ids", "overdraw", "bins", "bins_one_triangle"]
    assert sorted(written) == sorted(f"{name}.png" for name in expected)
    assert len(printed.out.split()) == len(expected)
    for step in ("setup", "binning", "tile mask", "scanline", "depth", "visibility", "fused", "transform", "draw"):
        assert step in printed.err
    assert "the same bits" in printed.err
    shaded = io.imread(tmp_path / "pictures" / "shaded.png")
    assert shaded.shape == (180, 320, 3) and 60 < shaded.mean() < 200

"""bigtri render: its cameras, numbered pictures, animations, depth files and the view of the bins."""

from types import SimpleNamespace

import gltf_files
import numpy as np
import PIL.Image
import pytest
import trimesh
from skimage import io

from bigtri import Camera, load_scene, render
from bigtri.app import cli, pictures
from bigtri.reference.shading import decode_table
from bigtri.rendering import depth_file, views


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "box.ply"
    trimesh.creation.box((2, 1, 1)).export(path)
    return path


def run(capsys, *arguments):
    """The files that the command says it has written, and what it said besides."""
    assert cli.main(["render", *map(str, arguments), "--size", "48x32"]) == 0
    printed = capsys.readouterr()
    return printed.out.split(), printed.err


def decode(code):
    """The linear value of an sRGB code."""
    return float(decode_table()[code])


def read(path):
    return np.asarray(PIL.Image.open(path))


def test_several_azimuths_are_numbered_files(model, tmp_path, capsys):
    files, _ = run(capsys, model, "-o", tmp_path / "b.png", "--azimuth", -10, 80, "--supersample", 1)
    assert files == [str(tmp_path / name) for name in ("b-0.png", "b-1.png")]
    scene = load_scene(model)
    for file, azimuth in zip(files, (-10, 80), strict=True):
        camera = Camera.framing(scene.bounds, azimuth, 20, 1, 48 / 32, 40)
        assert np.array_equal(io.imread(file), render(scene, camera, (32, 48)))


def test_a_turntable_is_numbered_files(model, tmp_path, capsys):
    files, _ = run(capsys, model, "-o", tmp_path / "b.png", "--turntable", 11, "--view", "ids")
    assert files == [str(tmp_path / f"b-{i:02}.png") for i in range(11)]
    assert len({io.imread(file).tobytes() for file in files}) == 11
    scene = load_scene(model)
    camera = Camera.framing(scene.bounds, 30 + 360 * 7 / 11, 20, 1, 48 / 32, 40)
    assert np.array_equal(io.imread(files[7]), views.picture("ids", scene, camera, (32, 48)))


@pytest.mark.parametrize("kind", ["gif", "webp", "apng"])
def test_a_turntable_is_an_animation(model, tmp_path, capsys, kind):
    files, _ = run(capsys, model, "-o", tmp_path / f"b.{kind}", "--turntable", 4, "--fps", 20, "--azimuth", 10)
    assert files == [str(tmp_path / f"b.{kind}")]
    with PIL.Image.open(files[0]) as animation:
        assert (animation.size, animation.n_frames, animation.info["loop"]) == ((48, 32), 4, 0)
        animation.seek(1)
        animation.load()
        assert animation.info["duration"] == 50
        frame = np.asarray(animation.convert("RGB"))
    scene = load_scene(model)
    camera = Camera.framing(scene.bounds, 100, 20, 1, 48 / 32, 40)
    expected = render(scene, camera, (32, 48), supersample=2)
    if kind != "gif":  # which has 256 colours
        assert np.array_equal(frame, expected)


def test_all_views_of_several_azimuths(model, tmp_path, capsys):
    files, _ = run(capsys, model, "-o", tmp_path / "b.png", "--azimuth", 0, 90, "--view", "all")
    assert len(files) == 2 * len(views.VIEWS) and str(tmp_path / "b-1-depth.png") in files
    files, _ = run(capsys, model, "-o", tmp_path / "b.gif", "--azimuth", 0, 90, "--view", "all")
    assert len(files) == len(views.VIEWS) and str(tmp_path / "b-depth.gif") in files


@pytest.mark.parametrize("orthographic", [False, True])
def test_tight(model, tmp_path, capsys, orthographic):
    arguments = ["--tight", "--view", "ids", "--elevation", 90, "--azimuth", 0, *["--orthographic"] * orthographic]
    (file,), _ = run(capsys, model, "-o", tmp_path / "b.png", *arguments)
    covered = (io.imread(file) != views._BACKGROUND).any(axis=-1)
    # 2 x 1 in 48 x 32 px: the width decides, less a margin of 5 % at each side.
    assert np.flatnonzero(covered.any(axis=0)).tolist() == list(range(2, 46))
    if orthographic:
        assert np.flatnonzero(covered.any(axis=1)).tolist() == list(range(5, 27))


def test_a_tight_turntable_keeps_its_size(model, tmp_path, capsys, monkeypatch):
    seen = []

    def picture(view, scene, camera, *_, **__):
        seen.append(camera)
        return np.zeros((8, 8, 3), np.uint8)

    monkeypatch.setattr(views, "picture", picture)
    for orthographic in (False, True):
        seen.clear()
        run(capsys, model, "-o", tmp_path / "b.gif", "--turntable", 7, "--tight", *["--orthographic"] * orthographic)
        points = load_scene(model).points
        distances = [camera.distance for camera in seen]
        # Each eye is rounded for its own azimuth, to 2^-53 of its coordinates; the distance is a sum of three squares.
        np.testing.assert_allclose(distances, distances[0], rtol=1e-12)
        reached = []
        for camera in seen:
            clip = camera.transform(points, 48 / 32)
            reached.append(np.abs(clip[:, :2] / clip[:, 3:]).max())
        # Clip coordinates are float32, and so is their quotient: to 2^-24 each.
        assert max(reached) <= 0.9 + 3 * 2**-24 and max(reached) > 0.8


def test_orthographic(model, tmp_path, capsys):
    (file,), _ = run(capsys, model, "-o", tmp_path / "b.png", "--orthographic", "--distance", 2, "--supersample", 1)
    scene = load_scene(model)
    camera = Camera.framing(scene.bounds, 30, 20, 2, 48 / 32, orthographic=True)
    assert np.array_equal(io.imread(file), render(scene, camera, (32, 48)))


def test_a_camera_of_the_file(tmp_path, capsys):
    file = gltf_files.below_a_camera()
    file.json["nodes"][0]["translation"] = [0, 0, -4]
    file.json["cameras"][0] = {"type": "orthographic", "orthographic": {"xmag": 9, "ymag": 4, "znear": 0, "zfar": 20}}
    path = file.write(tmp_path / "seen.glb")
    (picture,), _ = run(capsys, path, "-o", tmp_path / "s.png", "--camera", 0, "--view", "ids")
    covered = (io.imread(picture) != views._BACKGROUND).any(axis=-1)
    assert covered.sum() == 16 * 16 and covered[8:24, 16:32].all()  # 4 units of 8 in 32 px
    for arguments, text in (
        (["--camera", 1], "--camera must be one of the file's 1, from 0, got 1"),
        (["--camera", 0, "--tight"], "--tight must not be given with --camera"),
        (["--camera", 0, "--azimuth", 5], "--azimuth must not be given with --camera"),
        (["--camera", 0, "--fov", 40], "--fov must not be given with --camera, beside which it means nothing"),
    ):
        assert cli.main(["render", str(path), "-o", str(tmp_path / "s.png"), *map(str, arguments)]) == 2
        assert text in capsys.readouterr().err


def test_near_and_far(model, tmp_path, capsys):
    """A near plane in front of the far half: what is nearer is cut away."""
    scene, depth = load_scene(model), tmp_path / "d.npy"
    camera = Camera.framing(scene.bounds, 30, 20, 1, 48 / 32, 40)
    run(capsys, model, "-o", tmp_path / "b.png", "--near", camera.distance, "--depth", depth)
    distance = np.load(depth)
    assert distance.min() > camera.distance - 1e-3
    run(capsys, model, "-o", tmp_path / "b.png", "--far", camera.distance, "--depth", depth)
    distance = np.load(depth)
    assert distance[np.isfinite(distance)].max() < camera.distance + 1e-3
    assert cli.main(["render", str(model), "-o", str(tmp_path / "b.png"), "--near", "5", "--far", "2"]) == 2
    assert "near and far must satisfy 0 < near < far < inf, got 5.0 and 2.0" in capsys.readouterr().err


def wall(folder, distance):
    """An orthographic view from above of a square ``distance`` below the eye's near plane."""
    path = folder / "wall.ply"
    corners = np.array([(-1, -1, -distance), (1, -1, -distance), (1, 1, -distance), (-1, 1, -distance)], float)
    trimesh.Trimesh(corners, [(0, 1, 2), (0, 2, 3)], process=False).export(path)
    return path


def test_depth_files(model, tmp_path, capsys):
    scene = load_scene(model)
    camera = Camera.framing(scene.bounds, 30, 20, 1, 48 / 32, 40)
    expected = depth_file.distances(scene, camera, (32, 48))
    assert expected.dtype == np.float32 and np.isinf(expected[0, 0])
    nearest, farthest = expected.min(), expected[np.isfinite(expected)].max()
    assert camera.distance - 1.3 < nearest < camera.distance < farthest < camera.distance + 1.3
    for kind in ("npy", "tiff", "tif", "png"):
        files, said = run(capsys, model, "-o", tmp_path / "b.png", "--depth", tmp_path / f"d.{kind}")
        assert files == [str(tmp_path / "b.png"), str(tmp_path / f"d.{kind}")] and "warning" not in said
    assert np.load(tmp_path / "d.npy").tobytes() == expected.tobytes()
    assert read(tmp_path / "d.tiff").dtype == np.float32 and read(tmp_path / "d.tiff").tobytes() == expected.tobytes()
    assert read(tmp_path / "d.tif").tobytes() == expected.tobytes()
    counts = np.where(np.isinf(expected), 0, np.rint(1000 * expected.astype(np.float64))).astype(np.uint16)
    assert read(tmp_path / "d.png").dtype == np.uint16 and np.array_equal(read(tmp_path / "d.png"), counts)
    run(capsys, model, "-o", tmp_path / "b.png", "--depth", tmp_path / "d.png", "--depth-scale", 100, "--azimuth", 0, 30)
    assert np.array_equal(read(tmp_path / "d-1.png"), np.where(counts > 0, np.rint(100 * expected.astype(np.float64)), 0))


def test_what_a_png_cannot_hold_is_said(tmp_path):
    distance = np.array([[0.0001, 0.0005, 0.0006, 65.535, 65.6, 900, np.inf]], np.float32)
    text = "d.png: 3 pixels are not from 0.001 to 65.535 units away, but 0.0001 to 900: they are 1 or 65535"
    with pytest.warns(UserWarning, match=text):
        depth_file.save(tmp_path / "d.png", distance)
    assert read(tmp_path / "d.png").tolist() == [[1, 1, 1, 65535, 65535, 65535, 0]]


@pytest.mark.parametrize("distance", [0.25, 3.0, 100.0])
def test_depth_in_the_models_units(tmp_path, capsys, distance):
    """Straight down on a square: all of it is as far away as the camera is."""
    arguments = ["-o", tmp_path / "w.png", "--depth", tmp_path / "w.npy", "--up", "z", "--elevation", 90]
    for more in ([], ["--orthographic"], ["--tight"]):
        run(capsys, wall(tmp_path, distance), *arguments, *more)
        seen = np.load(tmp_path / "w.npy")
        scene = load_scene(tmp_path / "wall.ply")
        settings = {"aspect": 1.5, "up_axis": "z", "orthographic": "--orthographic" in more}
        if "--tight" in more:
            camera = Camera.tight_framing(scene.points, 30, 90, fov_y=40, **settings)
        else:
            camera = Camera.framing(scene.bounds, 30, 90, fov_y=40, **settings)
        # Distances from float32 window depth are 2^-24 far / near of them apart at most.
        near, far = camera.depth_range
        np.testing.assert_allclose(seen[16, 24], camera.eye[2] + distance, rtol=2**-24 * far / near)


def test_bins_of_small_triangles(tmp_path, capsys):
    """A model whose triangles are all small: nothing to see, unless the threshold is lower or a triangle is chosen."""
    path = tmp_path / "ball.ply"
    trimesh.creation.icosphere(subdivisions=3).export(path)
    drawn = []
    for more in ([], ["--threshold", 0], ["--triangle", 3], ["--triangle", 4]):
        arguments = ["--view", "bins", "--size", "200x200", *more]
        assert cli.main(["render", str(path), "-o", str(tmp_path / "b.png"), *map(str, arguments)]) == 0
        drawn.append(io.imread(tmp_path / "b.png")[:150].tobytes())
    assert len(set(drawn)) == 4
    capsys.readouterr()
    for arguments, text in (
        (["--view", "bins", "--triangle", 5000], "triangle must be one of the 1280, from 0, got 5000"),
        (["--threshold", 5], "--threshold must be given with --view bins, got --view shaded"),
        (["--triangle", 5, "--view", "ids"], "--triangle must be given with --view bins"),
    ):
        assert cli.main(["render", str(path), "-o", str(tmp_path / "b.png"), *map(str, arguments)]) == 2
        assert text in capsys.readouterr().err


def test_how_far_it_is_is_said_once_a_second(model, tmp_path, capsys, monkeypatch):
    clock = iter(0.4 * i for i in range(1000))
    monkeypatch.setattr(pictures, "time", SimpleNamespace(perf_counter=lambda: next(clock)))
    _, said = run(capsys, model, "-o", tmp_path / "b.gif", "--turntable", 8, "--view", "ids")
    assert [line.strip() for line in said.splitlines() if " of " in line] == ["2 of 8", "5 of 8"]


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--depth", "x.exr"], "--depth must end in .npy, .tif, .tiff, .png, got 'x.exr'"),
        (["--depth", "no/such/folder/x.npy"], "--depth must be in a folder that is there"),
        (["--depth", "{folder}/x.npy", "--depth-scale", "10"], "--depth-scale must be given with --depth FILE.png"),
        (["--depth-scale", "10"], "--depth-scale must be given with --depth FILE.png"),
        (["--depth", "{folder}/x.png", "--depth-scale", "0"], "--depth-scale must be positive"),
        (["--tight", "--distance", "2"], "--distance must not be given with --tight"),
        (["--orthographic", "--fov", "20"], "--fov must not be given with --orthographic"),
        (["--camera", "0"], "--camera must be one of the file's 0, from 0, got 0"),
    ],
)
def test_options_that_do_not_go_together(model, tmp_path, capsys, arguments, text):
    given = [argument.format(folder=tmp_path) for argument in arguments]
    assert cli.main(["render", str(model), "-o", str(tmp_path / "b.png"), *given]) == 2
    assert text in capsys.readouterr().err
    assert not (tmp_path / "b.png").exists()


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ([], {}),
        (["--background", "white"], {"background": ((1.0, 1.0, 1.0), (1.0, 1.0, 1.0))}),
        (["--background", "0,0,0", "#fff"], {"background": ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))}),
        (["--background", "#00ff80"], {"background": ((0.0, 1.0, decode(128)), (0.0, 1.0, decode(128)))}),
        (["--transparent"], {"transparent": True}),
    ],
)
def test_what_is_behind_the_model(model, tmp_path, capsys, monkeypatch, arguments, expected):
    asked = []

    def draw(scene, camera, resolution, *, backend, supersample, **behind):
        asked.append({name: value for name, value in behind.items() if value not in (None, False)})
        return np.zeros((*resolution, 4 if behind.get("transparent") else 3), np.uint8)

    monkeypatch.setattr(views, "render", draw)
    (file,), _ = run(capsys, model, "-o", tmp_path / "b.png", *arguments)
    assert asked == [expected]
    assert read(file).shape == (32, 48, 4 if "transparent" in expected else 3)
    if "transparent" in expected:
        for kind in ("gif", "webp", "apng"):
            (file,), _ = run(capsys, model, "-o", tmp_path / f"b.{kind}", *arguments, "--turntable", 2)
            with PIL.Image.open(file) as animation:
                assert np.asarray(animation.convert("RGBA"))[..., 3].max() == 0


def test_what_is_behind_the_model_is_drawn(model, tmp_path, capsys):
    (file,), _ = run(capsys, model, "-o", tmp_path / "b.png", "--transparent")
    assert read(file)[0, 0, 3] == 0 and read(file)[16, 24, 3] == 255
    (file,), _ = run(capsys, model, "-o", tmp_path / "b.png", "--background", "#0080ff")
    assert read(file)[[0, -1], 0].tolist() == [[0, 128, 255]] * 2


@pytest.mark.parametrize(
    ("out", "arguments", "text"),
    [
        ("b.jpg", ["--transparent"], "--out must not end in .jpg, .jpeg, .bmp with --transparent, got 'b.jpg'"),
        ("b.png", ["--transparent", "--background", "white"], "--background must not be given with --transparent"),
        ("b.png", ["--background", "white", "red", "blue"], "--background must be one colour, or two, got 3"),
        ("b.png", ["--background", "white", "--view", "ids"], "--background must be given with --view shaded, got --view ids"),
        ("b.png", ["--transparent", "--view", "depth"], "--transparent must be given with --view shaded"),
    ],
)
def test_backgrounds_that_do_not_go_together(model, tmp_path, capsys, out, arguments, text):
    assert cli.main(["render", str(model), "-o", str(tmp_path / out), *arguments]) == 2
    assert text in capsys.readouterr().err


@pytest.mark.parametrize("color", ["nocolour", "1,2", "256,0,0", "1,2,x", "#12", "#11223344"])
def test_what_is_no_colour(model, tmp_path, capsys, color):
    with pytest.raises(SystemExit) as stopped:
        cli.main(["render", str(model), "-o", str(tmp_path / "b.png"), "--background", color])
    assert stopped.value.code == 2
    assert "argument --background: must be" in capsys.readouterr().err

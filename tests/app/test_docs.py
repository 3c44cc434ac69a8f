"""The Python of the pages for people runs as it is printed, and the names that they have are there."""

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

import bigtri

DOCS = Path(__file__).parents[2] / "docs"


def blocks(page: str) -> str:
    return "\n".join(re.findall(r"^```python\n(.*?)^```", (DOCS / page).read_text(), re.M | re.S))


def test_pictures(tmp_path, monkeypatch):
    trimesh.creation.box().export(tmp_path / "model.glb")
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    exec(blocks("pictures.md"), names)
    assert names["image"].shape == (480, 640, 3)
    assert np.unique(names["ids"]).tolist() == [-1, 0] and not names["mask"].any()  # the half-size box is inside of the other
    covered = np.isfinite(names["distance"])
    assert covered.any() and np.array_equal(covered, names["exact"] > 0)
    # The page says how far apart distances from window depth are: 2^-24 s / near of a distance s. The box is at 4.5.
    np.testing.assert_allclose(
        names["distance"][covered], names["exact"][covered], rtol=2**-24 * 4.5 / names["camera"].depth_range[0]
    )
    middle = names["same_kind"].transform([(0, 0, 0)], 640 / 480)[0]
    assert middle[3] == 5 and (middle[:2] == 0).all()


def test_robotics(capsys):
    names: dict = {}
    exec(blocks("robotics.md").replace("FRAMES = 480, 640, 100", "FRAMES = 480, 640, 2"), names)
    assert re.fullmatch(r"[\d.]+ ms a frame; 2[01] instances, 0\.\d+ to 0\.\d+ m\n", capsys.readouterr().out)
    assert names["depth"].dtype == np.float32 and names["instance"].dtype == np.int32
    # The table's top is 1 cm above the world's origin, 0.89 m below the camera. Distances from float32 window depth are
    # 2^-24 s / near of a distance s apart.
    np.testing.assert_allclose(names["depth"][names["instance"] == 0].max(), 0.89, rtol=2**-24 * 0.89 / names["camera"].near)


def test_validate(capsys):
    """What the page says is printed is what is printed."""
    try:
        exec(blocks("validate.md"), {})
    finally:
        for name in bigtri.registered_variants():
            bigtri.unregister_variant(name)
    printed = re.findall(r"^```text\n(.*?)^```", (DOCS / "validate.md").read_text(), re.M | re.S)
    assert capsys.readouterr().out == "".join(printed)


@pytest.mark.parametrize("page", ["coming_from.md", "pictures.md", "robotics.md", "validate.md"])
def test_names_of_bigtri(page):
    for name in set(re.findall(r"\bbigtri\.([A-Za-z_]+(?:\.\w+)?)\(", (DOCS / page).read_text())):
        thing = bigtri
        for part in name.split("."):
            thing = getattr(thing, part)
        assert callable(thing)


def test_conversions_of_other_libraries_poses():
    """docs/coming_from.md: a pose of pyrender, and R and T of PyTorch3D, as R and t of OpenCV."""
    pose = trimesh.transformations.random_rotation_matrix(np.random.default_rng(1).random(3))
    pose[:3, 3] = 0.5, -2, 3
    points = np.random.default_rng(2).normal(0, 1, (9, 3))
    flip = np.diag([1, -1, -1])
    R = flip @ pose[:3, :3].T
    t = -R @ pose[:3, 3]
    # Both ways are sums of a few float64 products below 10, rounded in other places: far less than 1e-12 apart.
    in_camera = (points - pose[:3, 3]) @ pose[:3, :3]  # OpenGL's axes
    np.testing.assert_allclose(points @ R.T + t, in_camera * (1, -1, -1), atol=1e-12)
    camera = bigtri.Camera(pose[:3, 3], pose[:3, 3] - pose[:3, 2], pose[:3, 1], 60)
    K = np.array([[100 * np.sqrt(3), 0, 100], [0, 100 * np.sqrt(3), 100], [0, 0, 1]])
    same = bigtri.Camera.from_opencv(K, R, t, (200, 200), *camera.depth_range, pixel_centre=0.5)
    np.testing.assert_allclose(same.matrix(1), camera.matrix(1), atol=1e-12)
    R3, T3 = pose[:3, :3] * (-1, 1, -1), -pose[:3, 3] @ (pose[:3, :3] * (-1, 1, -1))  # x left, y up, z forward, of rows
    turn = np.diag([-1, -1, 1])
    np.testing.assert_allclose(turn @ R3.T, R, atol=1e-12)
    np.testing.assert_allclose(turn @ T3, t, atol=1e-12)

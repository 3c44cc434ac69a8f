"""The camera against textbook matrices, by hand, and its errors."""

import math
import warnings
from pathlib import Path

import numpy as np
import pytest

from bigtri import Camera, Scene, warn
from bigtri.study import courtyard

CAMERA = Camera(eye=(3, 2, 5), target=(-1, 0.5, 0.25), fov_y=50, near=0.5, far=80)


def textbook(camera: Camera, aspect: float) -> np.ndarray:
    """gluPerspective times gluLookAt."""
    eye, target, up = (np.array(v) for v in (camera.eye, camera.target, camera.up))
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    view = np.eye(4)
    view[:3, :3] = right, np.cross(right, forward), -forward
    view[:3, 3] = -view[:3, :3] @ eye
    f, (near, far) = 1 / math.tan(math.radians(camera.fov_y) / 2), camera.depth_range
    projection = np.zeros((4, 4))
    projection[0, 0], projection[1, 1] = f / aspect, f
    projection[2, 2:] = (far + near) / (near - far), 2 * far * near / (near - far)
    projection[3, 2] = -1
    return projection @ view


def test_matrix_is_the_textbooks():
    for aspect in (0.5, 1.0, 16 / 9):
        np.testing.assert_allclose(CAMERA.matrix(aspect), textbook(CAMERA, aspect), rtol=1e-12, atol=1e-12)
    assert CAMERA.matrix(1).dtype == np.float64


def test_transform_applies_the_matrix_in_the_written_order():
    points = np.random.default_rng(0).normal(0, 10, (200, 3)).astype(np.float32)
    clip = CAMERA.transform(points, 1.25)
    assert clip.dtype == np.float32 and clip.shape == (200, 4)
    matrix = CAMERA.matrix(1.25).tolist()
    for point, result in zip(points.tolist(), clip, strict=True):
        expected = [((m[0] * point[0] + m[1] * point[1]) + m[2] * point[2]) + m[3] for m in matrix]
        assert result.tobytes() == np.array(expected, np.float32).tobytes()


def test_where_things_land():
    camera = Camera(eye=(0, 0, 4), target=(0, 0, 0), fov_y=90, near=1, far=9)
    on_axis = camera.transform([(0, 0, 0), (0, 0, 3), (0, 0, -5)], 2.0).astype(np.float64)
    assert np.abs(on_axis[:, :2]).max() < 1e-12
    np.testing.assert_allclose(on_axis[:, 3], [4, 1, 9])  # w is the distance along the view direction
    np.testing.assert_allclose(on_axis[1:, 2] / on_axis[1:, 3], [-1, 1], atol=1e-6)  # the near and the far plane
    corner = camera.transform([(8, 4, 0)], 2.0)[0]  # x right, y up: the picture's upper right corner
    np.testing.assert_allclose(corner[:2] / corner[3], [1, 1], rtol=1e-6)


def test_orbit():
    def eye(*angles, **how):
        return np.array(Camera.orbit((1, 2, 3), 2, *angles, **how).eye) - (1, 2, 3)

    np.testing.assert_allclose(eye(0, 0), (0, 0, 2), atol=1e-12)
    np.testing.assert_allclose(eye(90, 0), (2, 0, 0), atol=1e-12)
    np.testing.assert_allclose(eye(0, 90), (0, 2, 0), atol=1e-12)
    np.testing.assert_allclose(eye(0, 0, up_axis="z"), (0, -2, 0), atol=1e-12)
    np.testing.assert_allclose(eye(0, 90, up_axis="z"), (0, 0, 2), atol=1e-12)
    for elevation in (-90, 90):  # straight from above and below there is a right way up, too
        matrix = Camera.orbit((0, 0, 0), 5, 30, elevation).matrix(1)
        assert np.isfinite(matrix).all()
        above = Camera.orbit((0, 0, 0), 5, 30, elevation * 0.9999).matrix(1)
        np.testing.assert_allclose(matrix, above, atol=0.05)


@pytest.mark.parametrize("aspect", [0.4, 1.0, 2.5])
def test_framing_shows_all_of_the_bounds(aspect):
    bounds = np.array([(-1, -2, 10), (5, 0, 11)], float)
    corners = np.array([[bounds[i, 0], bounds[j, 1], bounds[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    for azimuth in (0, 77, 200):
        clip = Camera.framing(bounds, azimuth, 35, aspect=aspect).transform(corners, aspect)
        assert (np.abs(clip[:, :3]) <= clip[:, 3:]).all()


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"eye": (1, 1, 1), "target": (1, 1, 1)}, "target must be a finite distance away from eye"),
        ({"up": (0, 0, 0)}, "up must not be zero or parallel"),
        ({"up": (0, 0, -3)}, "up must not be zero or parallel"),
        ({"fov_y": 0}, "fov_y must be in"),
        ({"fov_y": 180}, "fov_y must be in"),
        ({"near": 0}, "near and far must satisfy"),
        ({"near": 2, "far": 1}, "near and far must satisfy"),
        ({"eye": (0, 0)}, "eye must be three finite numbers"),
        ({"eye": (0, 0, math.nan)}, "eye must be three finite numbers"),
        ({"fov_y": math.nan}, "fov_y must be a finite number"),
        ({"fov_y": 5e-324}, "fov_y must be in"),
        ({"far": math.inf}, "far must be a finite number"),
        ({"near": 10**400}, "near must be a finite number"),
    ],
)
def test_degenerate_cameras(arguments, text):
    with pytest.raises(ValueError, match="bigtri.Camera: " + text):
        Camera(**{"eye": (0, 0, 5), "target": (0, 0, 0), **arguments})


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"fov_y": "40"}, "fov_y must be a finite number, got '40'"),
        ({"near": "1"}, "near must be a finite number"),
        ({"far": [9, 9]}, "far must be a finite number"),
        ({"eye": None}, "eye must be three finite numbers"),
        ({"up": ("0", "1", "0")}, "up must be three finite numbers"),
    ],
)
def test_what_is_no_number(arguments, text):
    with pytest.raises(TypeError, match="bigtri.Camera: " + text):
        Camera(**{"eye": (0, 0, 5), "target": (0, 0, 0), **arguments})


def test_numbers_of_numpy_are_numbers():
    camera = Camera(np.array([0, 0, 5]), (0, 0, 0), fov_y=np.float32(40), near=np.int64(1), far=np.float32(9))
    assert camera == Camera((0, 0, 5), (0, 0, 0), fov_y=40, near=1, far=9)


BOUNDS = np.array([(-1, -1, -1), (1, 1, 1)])


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (
            lambda: Camera((0, 0, 5), (0, 0, 0), fov_y=math.pi / 4),
            "Camera: fov_y is in degrees, got 0.785398, which looks like radians; 0.785398 radians are 45 degrees",
        ),
        (lambda: Camera.orbit((0, 0, 0), 2, fov_y=1.0), "Camera: fov_y is in degrees, got 1, "),
        (lambda: Camera.framing(BOUNDS, fov_y=np.float32(0.8)), "Camera.framing: fov_y is in degrees, got 0.8, "),
        (lambda: Camera.orbit((0, 0, 0), 2, -math.pi / 6), "Camera.orbit: azimuth is in degrees, got -0.523599, "),
        (lambda: Camera.framing(BOUNDS, 2 * math.pi), "Camera.orbit: azimuth is in degrees, got 6.28319, "),
        (
            lambda: Camera.framing(BOUNDS, elevation=np.radians(np.float32(35))),
            "Camera.orbit: elevation is in degrees, got 0.610865, ",
        ),
    ],
)
def test_radians_are_warned_of_once(make, text, monkeypatch):
    monkeypatch.setattr(warn, "_said", set())
    with pytest.warns(UserWarning) as said:
        assert make() == make()
    assert [Path(one.filename) for one in said] == [Path(__file__)]
    assert str(said[0].message).startswith("bigtri." + text)


def test_small_angles_in_degrees_are_taken_as_they_are(monkeypatch):
    monkeypatch.setattr(warn, "_said", set())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Camera((0, 0, 5), (0, 0, 0), fov_y=3.2)
        for angle in (0, 7, 8.5, *(k / 1000 for k in range(-6300, 6301))):
            Camera.orbit((0, 0, 0), 2, angle, angle)


def test_errors_of_methods():
    for azimuth, error in ((math.inf, ValueError), ("30", TypeError)):
        with pytest.raises(error, match="bigtri.Camera.orbit: azimuth must be a finite number"):
            Camera.orbit((0, 0, 0), 1, azimuth)
    with pytest.raises(TypeError, match="radius must be a finite number"):
        Camera.orbit((0, 0, 0), "1")
    with pytest.raises(TypeError, match="elevation must be a finite number"):
        Camera.orbit((0, 0, 0), 1, 0, None)
    with pytest.raises(TypeError, match="aspect must be a finite number"):
        CAMERA.matrix("1")
    with pytest.raises(TypeError, match="points must be an array of numbers"):
        CAMERA.transform([("a", "b", "c")], 1)
    for bounds, error, text in (
        (None, TypeError, "an array of numbers"),
        ([(0, 0, 0), (1, 1)], TypeError, "an array of numbers"),
        ([(0, 0, 0)], ValueError, r"\[2, 3\], got \[1, 3\]"),
        ([(0, 0, 0), (1, 1, math.inf)], ValueError, "three finite numbers"),
        ([(0, 0, 0), (1e200, 0, 0)], ValueError, "a diagonal below"),
    ):
        with pytest.raises(error, match="bigtri.Camera.framing: bounds must (be|have) " + text):
            Camera.framing(bounds)
    with pytest.raises(ValueError, match="aspect must be positive"):
        CAMERA.matrix(0)
    with pytest.raises(ValueError, match=r"points must be \[V, 3\], got \[3\]"):
        CAMERA.transform((1, 2, 3), 1)
    with pytest.raises(ValueError, match="radius must be positive"):
        Camera.orbit((0, 0, 0), 0)
    with pytest.raises(ValueError, match="elevation must be in"):
        Camera.orbit((0, 0, 0), 1, 0, 91)
    with pytest.raises(ValueError, match="up_axis"):
        Camera.orbit((0, 0, 0), 1, up_axis="x")
    with pytest.raises(ValueError, match="distance must be positive"):
        Camera.framing([(0, 0, 0), (1, 1, 1)], distance=-1)


def test_what_fills_a_picture():
    scene = courtyard.courtyard()
    tensors, aspect = scene.on("cpu"), 16 / 9

    def fills(*cameras: Camera) -> bool:
        return tensors.fills_picture(np.stack([camera.matrix(aspect, scene.origin) for camera in cameras]))

    middle = tuple(scene.bounds.mean(axis=0))
    within, far = Camera(eye=middle, target=scene.bounds[1]), Camera(eye=(900, 500, 700), target=middle)
    assert fills(courtyard.camera()) and fills(within)
    assert not fills(far) and not fills(within, far, far)
    assert not fills(Camera.framing(scene.bounds, aspect=aspect))
    assert fills(Camera(eye=(90, 50, 70), target=middle, fov_y=5))


def test_what_fills_a_picture_far_from_the_origin():
    moved = np.eye(4)
    moved[0, 3] = 7e6
    near = Scene(np.eye(3, dtype=np.float32), np.array([[0, 1, 2]], np.int32))
    for scene in (near, near.moved(moved)):
        matrix = Camera.framing(scene.bounds, aspect=1.0).matrix(1.0, scene.origin)[None]
        assert not scene.on("cpu").fills_picture(matrix)
        assert scene.on("cpu").fills_picture(matrix * np.array([9, 9, 1, 1])[:, None])

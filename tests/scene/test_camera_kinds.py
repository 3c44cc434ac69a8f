"""Cameras of every kind: where points land, to the pixel, what their depths mean, and what is refused."""

import copy
import inspect
import math
import pickle
import warnings

import numpy as np
import pytest
import torch

from bigtri import Camera, rasterize, warn
from bigtri.scene.matrix_camera import MatrixCamera
from bigtri.scene.orthographic_camera import OrthographicCamera
from bigtri.scene.perspective_camera import PerspectiveCamera
from bigtri.scene.pinhole_camera import PinholeCamera

HEIGHT, WIDTH = 480, 640
ASPECT = WIDTH / HEIGHT
# An off-centre principal point, two focal lengths and skew.
K = np.array([[612.5, 3.25, 301.75], [0, 598.0, 251.5], [0, 0, 1]])


def rotation(x: float, y: float, z: float) -> np.ndarray:
    """By angles in degrees around the three axes."""
    result = np.eye(3)
    for axis, angle in enumerate((x, y, z)):
        c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
        turn = np.eye(3)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        turn[i, i], turn[i, j], turn[j, i], turn[j, j] = c, -s, s, c
        result = turn @ result
    return result


R, T = rotation(20, -35, 170), np.array([0.2, -0.1, 1.5])
CALIBRATED = Camera.from_opencv(K, R, T, (HEIGHT, WIDTH), near=0.1, far=20)

KINDS = {
    "perspective": Camera((3, 2, 5), (-1, 0.5, 0.25), fov_y=50, near=0.5, far=80),
    "orthographic": Camera.orthographic((3, 2, 5), (-1, 0.5, 0.25), height=4, near=-2, far=9),
    "opencv": CALIBRATED,
    "matrix": Camera.from_matrix(Camera((3, 2, 5), (-1, 0.5, 0.25), near=0.5, far=80).matrix(ASPECT)),
}


def test_the_kinds_are_cameras():
    kinds = (PerspectiveCamera, OrthographicCamera, PinholeCamera, MatrixCamera)
    for camera, kind in zip(KINDS.values(), kinds, strict=True):
        assert type(camera) is kind and isinstance(camera, Camera)
        for same in (copy.deepcopy(camera), pickle.loads(pickle.dumps(camera))):
            assert same == camera and hash(same) == hash(camera)
        with pytest.raises(AttributeError):
            camera.near = 1


def test_the_signature_of_camera():
    """What help() and editors show is what a PerspectiveCamera takes; kinds show their own."""
    shown, taken = (inspect.signature(made).parameters.values() for made in (Camera, PerspectiveCamera))
    assert [(p.name, p.kind, p.default) for p in shown] == [(p.name, p.kind, p.default) for p in taken]
    assert [*inspect.signature(PinholeCamera).parameters][:3] == ["K", "R", "t"]


def pixels_of(points: np.ndarray, centre: float) -> np.ndarray:
    """int [N, 2], (column, row): by K, R and t, where K has the centre of pixel (0, 0) at (centre, centre)."""
    x, y, z = (R @ points.T + T[:, None]).tolist()
    pixels = []
    for a, b, c in zip(x, y, z, strict=True):
        u = K[0, 0] * a / c + K[0, 1] * b / c + K[0, 2]
        v = K[1, 1] * b / c + K[1, 2]
        pixels.append((math.floor(u + 0.5 - centre), math.floor(v + 0.5 - centre)))
    return np.array(pixels)


def in_the_world(u: np.ndarray, v: np.ndarray, z: np.ndarray) -> np.ndarray:
    """The points that K, R and t project to (u, v) at depth z."""
    rays = np.linalg.solve(K, np.stack([u, v, np.ones_like(u)]))
    return ((rays * z).T - T) @ R


@pytest.mark.parametrize("centre", [0.0, 0.5])
def test_points_land_in_the_pixels_that_k_r_and_t_say(centre):
    """A square of 0.8 px around each point covers the centre of its pixel and of no other."""
    rng = np.random.default_rng(7)
    count = 400
    column, row = rng.integers(0, WIDTH, count), rng.integers(0, HEIGHT, count)
    corners = []
    z = rng.uniform(0.5, 9, count)
    for right, down in ((-0.4, -0.4), (0.4, -0.4), (0.4, 0.4), (-0.4, 0.4)):
        corners.append(in_the_world(column + centre + right, row + centre + down, z))
    assert np.array_equal(pixels_of(in_the_world(column + centre + 0.1, row + centre - 0.2, z), centre), np.c_[column, row])
    positions = np.concatenate(corners)
    first = np.arange(count)
    triangles = np.concatenate([np.stack([first, first + count, first + 2 * count], axis=1)])
    triangles = np.concatenate([triangles, np.stack([first, first + 2 * count, first + 3 * count], axis=1)]).astype(np.int32)
    camera = Camera.from_opencv(K, R, T[:, None], (HEIGHT, WIDTH), 0.1, 20, pixel_centre=centre)
    seen = rasterize(camera.transform(positions, ASPECT), triangles, (HEIGHT, WIDTH))
    covered = np.argwhere(seen.triangle >= 0)[:, ::-1]
    assert {tuple(pixel) for pixel in covered.tolist()} == set(zip(column.tolist(), row.tolist(), strict=True))
    # The upper left pixel's centre is (0.5, 0.5) in bigtri: half a pixel beside it, every square would be at the next one.
    shifted = Camera.from_opencv(K, R, T, (HEIGHT, WIDTH), 0.1, 20, pixel_centre=0.5 - centre)
    moved = rasterize(shifted.transform(positions, ASPECT), triangles, (HEIGHT, WIDTH))
    assert not np.array_equal(moved.triangle, seen.triangle)


def test_what_opencv_calls_right_down_and_forward():
    camera = Camera.from_opencv(
        [[100, 0, 50], [0, 100, 40], [0, 0, 1]], np.eye(3), np.zeros(3), (80, 100), 1, 10, pixel_centre=0.5
    )
    clip = camera.transform([(0, 0, 2), (1, 0.8, 2), (-1, -0.8, 2)], 1.25)
    assert clip[:, 3].tolist() == [2, 2, 2]
    assert (clip[:, :2] / 2).tolist() == [[0, 0], [1, -1], [-1, 1]]  # the middle, lower right, upper left


def test_a_calibrated_camera_far_from_the_origin():
    """Positions counted from an origin in the millions: the same bits as at home, since all that is added cancels exactly."""
    points = np.random.default_rng(3).normal(0, 0.3, (50, 3)).astype(np.float32)
    origin = np.array([2.0**22, -(2.0**23), 2.0**10])
    turned = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
    home = Camera.from_opencv(K, turned, (0, 0, 2), (HEIGHT, WIDTH), 0.5, 9)
    away = Camera.from_opencv(K, turned, np.array([0, 0, 2]) - turned @ origin, (HEIGHT, WIDTH), 0.5, 9)
    assert away.transform(points, ASPECT, origin).tobytes() == home.transform(points, ASPECT).tobytes()
    assert away.eye == tuple(origin + np.array(home.eye))


def test_a_view_matrix_and_an_eye_say_the_same():
    """docs/pictures.md: how a camera is made of a world-to-camera matrix."""
    camera = KINDS["perspective"]
    right, upward, forward = camera._axes()
    view = np.eye(4)
    view[:3, :3] = right, upward, -np.array(forward)
    view[:3, 3] = -view[:3, :3] @ camera.eye
    place = np.linalg.inv(view)
    again = Camera(place[:3, 3], place[:3, 3] - place[:3, 2], place[:3, 1], 50, 0.5, 80)
    np.testing.assert_allclose(again.matrix(ASPECT), camera.matrix(ASPECT), rtol=1e-12, atol=1e-12)


def test_a_matrix_is_what_it_was_made_of():
    perspective = KINDS["perspective"]
    matrix = Camera.from_matrix(perspective.matrix(ASPECT))
    points = np.random.default_rng(2).normal(0, 1, (40, 3)).astype(np.float32)
    assert matrix.transform(points, 7.0).tobytes() == perspective.transform(points, ASPECT).tobytes()
    np.testing.assert_allclose(matrix.matrix(1, (5, 6, 7)), perspective.matrix(ASPECT, (5, 6, 7)), rtol=1e-12)
    np.testing.assert_allclose(matrix.depth_range, (0.5, 80), rtol=1e-12)
    flat = Camera.from_matrix(KINDS["orthographic"].matrix(ASPECT))
    np.testing.assert_allclose(flat.depth_range, (0, 11), rtol=1e-12, atol=1e-12)  # from its near plane
    endless = perspective.matrix(ASPECT)
    endless[2] = endless[3] - np.array([0, 0, 0, 2 * 0.5])
    assert Camera.from_matrix(endless).depth_range == (pytest.approx(0.5, rel=1e-12), math.inf)


def test_orthographic():
    camera = Camera.orthographic((0, 0, 5), (0, 0, 0), height=4, near=1, far=9)
    clip = camera.transform([(0, 0, 0), (4, 2, 3), (-4, -2, -4)], 2.0)
    assert clip.tolist() == [[0, 0, 0, 1], [1, 1, -0.75, 1], [-1, -1, 1, 1]]
    assert camera.depth_range == (1, 9) and camera.distance == 5
    orbit = OrthographicCamera.orbit((0, 0, 0), 5, height=4, near=1, far=9)
    assert orbit.transform([(1, 2, 3)], 2.0).tolist() == camera.transform([(1, 2, 3)], 2.0).tolist()


def test_fields_of_view():
    def slopes(aspect, **view):
        """The tangents of half the fields of view, across and upwards."""
        matrix = Camera((0, 0, 0), (0, 0, -1), **view).matrix(aspect)
        return 1 / matrix[0, 0], 1 / matrix[1, 1]

    for aspect in (0.5, 1, 16 / 9):
        across, upwards = slopes(aspect, fov_x=70)
        assert across == pytest.approx(math.tan(math.radians(35))) and across == pytest.approx(upwards * aspect)
        across, upwards = slopes(aspect, fov_diagonal=70)
        assert math.hypot(across, upwards) == pytest.approx(math.tan(math.radians(35)))
        assert across == pytest.approx(upwards * aspect)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_depth_in_scene_units_and_back(kind, dtype):
    camera = KINDS[kind]
    near, far = camera.depth_range
    distance = np.array([[near, 0.5 * (near + far), far], [near + 0.25, near + 1e-3, math.inf]], dtype)
    window = camera.depth_from_distance(distance)
    assert window.dtype == dtype and window[1, 2] == math.inf
    assert window[0, 0] == pytest.approx(0, abs=1e-7) and window[0, 2] == pytest.approx(1, rel=1e-6)
    back = camera.distance_from_depth(window)
    np.testing.assert_allclose(back, distance, rtol=1e-4 if dtype == np.float32 else 1e-11)
    assert back.dtype == dtype and back[1, 2] == math.inf
    tensor = camera.distance_from_depth(torch.from_numpy(window))
    assert tensor.dtype == torch.from_numpy(window).dtype and tensor.numpy().tobytes() == back.tobytes()


@pytest.mark.parametrize("kind", KINDS)
def test_depth_of_what_is_drawn(kind):
    """A wall across the view: the depth image is its distance, to what float32 holds of window depth."""
    camera = KINDS[kind]
    eye, ahead = np.array(KINDS["perspective"].eye), np.array(KINDS["perspective"].forward)
    if kind == "opencv":
        eye, ahead = np.array(camera.eye), R[2]
    wall = 4.0
    middle = eye + wall * ahead
    side = np.cross(ahead, (0.3, 0.5, 0.7))
    side /= np.linalg.norm(side)
    up = np.cross(side, ahead)
    corners = [middle + 40 * (a * side + b * up) for a, b in ((-1, -1), (3, -1), (-1, 3))]
    seen = rasterize(camera.transform(np.array(corners), ASPECT), np.array([(0, 1, 2)], np.int32), (48, 64))
    assert (seen.triangle == 0).all()
    np.testing.assert_allclose(camera.distance_from_depth(seen.depth), wall, rtol=1e-5)


def test_an_endless_far_plane():
    endless = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, -0.5], [0, 0, -1, 0]])
    camera = Camera.from_matrix(endless)
    assert camera.depth_range == (0.25, math.inf)
    distance = np.array([0.25, 1, 1000, math.inf])
    assert camera.depth_from_distance(distance).tolist() == [0, 0.75, 0.99975, math.inf]
    assert camera.distance_from_depth(np.array([0, 0.75, math.inf])).tolist() == [0.25, 1, math.inf]


def test_depths_that_are_none():
    camera = KINDS["perspective"]
    with pytest.raises(
        TypeError, match=r"distance_from_depth: depth must be a float32 or float64 array or tensor, got int32 \[2\]"
    ):
        camera.distance_from_depth(np.zeros(2, np.int32))
    with pytest.raises(TypeError, match="depth_from_distance: distance must be .*, got 3"):
        camera.depth_from_distance(3)
    oblique = camera.matrix(1)
    oblique[2, 0] += 0.5
    with pytest.raises(ValueError, match="from_matrix: matrix must have z depend on w alone"):
        Camera.from_matrix(oblique).distance_from_depth(np.zeros(2, np.float32))


def cloud(seed: int, far: float = 0.0) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, (1, 0.3, 2), (300, 3)) + far


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("aspect", [0.4, 1.0, 2.5])
@pytest.mark.parametrize("margin", [0.0, 0.1])
def test_tight_framing_fills_the_picture_up_to_the_margin(orthographic, aspect, margin):
    for seed, (azimuth, elevation, up_axis) in enumerate([(0, 0, "y"), (77, 35, "y"), (200, -90, "z")]):
        points = cloud(seed, 5.0e6 * seed)
        camera = Camera.tight_framing(points, azimuth, elevation, margin, aspect, 40, up_axis, orthographic)
        middle = points.mean(axis=0)
        clip = camera.transform(points - middle, aspect, middle).astype(np.float64)
        assert (np.abs(clip[:, 2]) <= clip[:, 3]).all()
        x, y = (clip[:, i] / clip[:, 3] for i in (0, 1))
        reached = [(-x).max(), x.max(), (-y).max(), y.max()]
        most = 1 - 2 * margin
        np.testing.assert_allclose(max(reached), most, rtol=1e-5)
        # Two opposite sides are reached; between the other two it is in the middle, in the picture if without perspective.
        assert sum(value > most - 1e-5 for value in reached) == 2 and max(reached) < most + 1e-5
        if orthographic:
            np.testing.assert_allclose(reached[::2], reached[1::2], rtol=1e-4)
        sphere = Camera.framing(
            [points.min(axis=0), points.max(axis=0)], azimuth, elevation, 1, aspect, 40, up_axis, orthographic
        )
        if orthographic:
            assert camera.height * most < sphere.height


def test_tight_framing_of_little():
    for points in ([(1, 2, 3)], [(0, 0, 0), (0, 0, -5)], [(0, 0, 0), (math.nan, 0, 0), (0, 4, 0)]):
        for orthographic in (False, True):
            camera = Camera.tight_framing(points, 0, 0, orthographic=orthographic)
            finite = np.array(points)[np.isfinite(points).all(axis=1)]
            clip = camera.transform(finite, 1.0)
            assert (np.abs(clip[:, :3]) <= clip[:, 3:]).all()


def test_framing_without_perspective_shows_all_of_the_bounds():
    bounds = np.array([(-1, -2, 10), (5, 0, 11)], float)
    corners = np.array([[bounds[i, 0], bounds[j, 1], bounds[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    for aspect in (0.4, 1.0, 2.5):
        clip = Camera.framing(bounds, 77, 35, aspect=aspect, orthographic=True).transform(corners, aspect)
        assert (np.abs(clip[:, :3]) <= clip[:, 3:]).all()
    assert Camera.framing(bounds, distance=3, orthographic=True).height == 3 * Camera.framing(bounds, orthographic=True).height


BOUNDS = np.array([(-1, -1, -1), (1, 1, 1)], float)


def test_near_and_far_of_what_is_seen():
    camera = Camera((0, 0, 9), (0, 0, 0)).fitted(BOUNDS)
    assert camera == Camera((0, 0, 9), (0, 0, 0), near=8 * (1 - 2**-6), far=10 * (1 + 2**-6))
    assert camera.fitted(100 * BOUNDS) is camera  # it has both
    assert Camera((0, 0, 9), (0, 0, 0), far=50).fitted(BOUNDS).depth_range == (8 * (1 - 2**-6), 50)
    inside = Camera((0, 0, 0), (0, 0, -1)).fitted(BOUNDS)
    assert inside.depth_range == ((1 + 2**-6) * 1e-4, 1 + 2**-6)  # near is not behind the eye
    flat = Camera.orthographic((0, 0, 9), (0, 0, 0)).fitted(BOUNDS)
    assert flat.depth_range == (8 - 2**-5, 10 + 2**-5)
    assert Camera.orthographic((0, 0, 0), (0, 0, -1)).fitted(BOUNDS).depth_range == (-1 - 2**-5, 1 + 2**-5)
    calibrated = Camera.from_opencv(K, np.eye(3), (0, 0, 4), (HEIGHT, WIDTH))
    assert calibrated.fitted(BOUNDS).depth_range == (3 * (1 - 2**-6), 5 * (1 + 2**-6))
    with pytest.raises(ValueError, match=r"from_opencv: near and far must be given, or chosen .* camera.fitted\(scene.bounds\)"):
        calibrated.transform([(0, 0, 0)], ASPECT)
    with pytest.raises(ValueError, match="Camera.fitted: bounds must be before the camera and its near plane, got -8 at most"):
        Camera((0, 0, 9), (0, 0, 20)).fitted(BOUNDS)
    with pytest.raises(ValueError, match="bounds must be before"):
        Camera((0, 0, 9), (0, 0, 0), near=11).fitted(BOUNDS)
    with pytest.raises(ValueError, match=r"Camera.fitted: bounds must be \[2, 3\]"):
        camera.fitted([1, 2])
    assert KINDS["matrix"].fitted(BOUNDS) is KINDS["matrix"]
    with pytest.raises(ValueError, match="near and far must be those of the matrix"):
        KINDS["matrix"].with_depth_range(1, 2)


def test_near_and_far_too_far_apart_are_warned_of_once(monkeypatch):
    monkeypatch.setattr(warn, "_said", set())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Camera((0, 0, 1), (0, 0, 0), near=2.0**-6, far=2.0**10).transform(BOUNDS, 1)
        Camera.orthographic((0, 0, 1), (0, 0, 0), near=1e-9, far=1e9).transform(BOUNDS, 1)
    camera = Camera((0, 0, 1), (0, 0, 0), near=0.001, far=1000)
    with pytest.warns(UserWarning) as said:
        for _ in range(3):
            camera.transform(BOUNDS, 1)
    assert [str(one.message) for one in said] == [
        "bigtri.Camera: near and far should be at most 65536 times apart, got 0.001 and 1000: at far, "
        "steps of window depth are 6 % of the distance; take nearer ones, or "
        'rasterize(precision="depth_reversed") with positions in reversed clip depth'
    ]


@pytest.mark.parametrize(
    ("make", "error", "text"),
    [
        (lambda: Camera.orthographic((0, 0, 1), (0, 0, 0), height=0), ValueError, "Camera.orthographic: height must be positive"),
        (
            lambda: Camera.orthographic((0, 0, 1), (0, 0, 0), near=3, far=3),
            ValueError,
            "must satisfy near < far < inf, got 3.0 and",
        ),
        (lambda: Camera.orthographic((0, 0, 1), (0, 0, 1)), ValueError, "Camera.orthographic: target must be a finite distance"),
        (lambda: Camera.orthographic((0, 0, 1), (0, 0, 0), up=(0, 0, 1)), ValueError, "Camera.orthographic: up must not be zero"),
        (lambda: Camera((0, 0, 1), (0, 0, 0), fov_x=60, fov_diagonal=70), ValueError, "fov_diagonal must be None where fov_x"),
        (lambda: Camera((0, 0, 1), (0, 0, 0), fov_x=180), ValueError, r"Camera: fov_x must be in \(0, 180\) degrees, got 180"),
        (lambda: Camera((0, 0, 1), (0, 0, 0), fov_diagonal="7"), TypeError, "fov_diagonal must be a finite number"),
        (lambda: Camera.from_matrix(np.eye(3)), ValueError, r"from_matrix: matrix must be \[4, 4\], got \[3, 3\]"),
        (lambda: Camera.from_matrix(np.full((4, 4), np.nan)), ValueError, "from_matrix: matrix must be finite"),
        (lambda: Camera.from_matrix("m"), TypeError, "from_matrix: matrix must be an array of numbers"),
        (lambda: Camera.tight_framing([(0, 0)]), ValueError, r"tight_framing: points must be \[N, 3\], got \[1, 2\]"),
        (lambda: Camera.tight_framing([(0, 0, math.inf)]), ValueError, "points must hold at least one point that is finite"),
        (lambda: Camera.tight_framing(BOUNDS, margin=0.5), ValueError, r"margin must be in \[0, 0.5\), got 0.5"),
        (lambda: Camera.tight_framing(BOUNDS, elevation=91), ValueError, "tight_framing: elevation must be in"),
        (lambda: Camera.tight_framing(BOUNDS, up_axis="x"), ValueError, "tight_framing: up_axis must be 'y' or 'z'"),
    ],
)
def test_what_is_refused(make, error, text):
    with pytest.raises(error, match=text):
        make()


@pytest.mark.parametrize(
    ("change", "error", "text"),
    [
        ({"K": np.eye(4)}, ValueError, r"K must be \[3, 3\], got \[4, 4\]"),
        ({"K": K.T}, ValueError, r"K must be \[\[fx, skew, cx\], \[0, fy, cy\], \[0, 0, 1\]\]"),
        ({"K": np.diag([-1, 1, 1])}, ValueError, "K must be"),
        ({"R": 2 * R}, ValueError, "R must be a rotation"),
        ({"R": np.diag([1, 1, -1])}, ValueError, "R must be a rotation"),
        ({"R": (0.1, 0.2, 0.3)}, ValueError, r"R must be \[3, 3\], got \[3\]"),
        ({"t": np.zeros(4)}, ValueError, r"t must be \[3\] or \[3, 1\], got \[4\]"),
        ({"t": (0, 0, math.nan)}, ValueError, "t must be three finite numbers"),
        ({"resolution": (480,)}, ValueError, "resolution must be"),
        ({"resolution": (0, 640)}, ValueError, "resolution must be"),
        ({"near": 0}, ValueError, "near must be positive"),
        ({"near": 5, "far": 5}, ValueError, "near and far must satisfy 0 < near < far < inf, got 5.0 and 5.0"),
        ({"pixel_centre": 320}, ValueError, r"pixel_centre must be in \[0, 1\]"),
    ],
)
def test_calibrations_that_are_none(change, error, text):
    given = {"K": K, "R": R, "t": T, "resolution": (HEIGHT, WIDTH), **change}
    with pytest.raises(error, match="bigtri.Camera.from_opencv: " + text):
        Camera.from_opencv(**given)


def test_a_picture_of_another_aspect_is_refused():
    assert np.isfinite(CALIBRATED.matrix(320 / 240)).all()
    with pytest.raises(ValueError, match="aspect must be that of resolution, 640 / 480, got 1.0"):
        CALIBRATED.matrix(1.0)


def test_rows_of_four_decimals_are_a_rotation():
    Camera.from_opencv(K, np.round(R, 4), T, (HEIGHT, WIDTH), 1, 2)

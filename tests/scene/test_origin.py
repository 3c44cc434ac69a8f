"""Scenes far from (0, 0, 0): the same pictures as at home, in bits where float64 has the coordinates exactly."""

import numpy as np
import pytest
import trimesh
from backends import BACKENDS

from bigtri import Camera, Scene, load_scene, render
from bigtri.scene import Light, Material, merge
from bigtri.scene.normals import split_normals
from bigtri.scene.origin import origin_for, relative

# Metres. Each is a multiple of 2, the step in which the origin of a ball of 2 m is chosen.
PLACES = {
    "UTM": (500_000.0, 5_400_000.0, 120.0),
    "ECEF": (4_177_328.0, 855_104.0, -4_728_096.0),
    "far in one axis": (0.0, 0.0, 2.0**30),
}
CAMERAS = [Camera((2.5, 1.25, 1.5), (0.125, 0, -0.25), up=(0.1, 1, 0)), Camera((0.25, -0.5, 0.75), (1, 0, 0), near=0.01, far=10)]


def ball() -> tuple[np.ndarray, np.ndarray]:
    """float64 [V, 3] of radius 1, in steps of 2^-20, which float64 has in the millions too and float32 here; int32 [T, 3]."""
    shape = trimesh.creation.icosphere(3)
    return np.rint(np.asarray(shape.vertices) * 2**20) / 2**20, shape.faces.astype(np.int32)


def scene_of(vertices: np.ndarray, triangles: np.ndarray, **settings) -> Scene:
    """Smooth and flat halves, from world-space positions."""
    origin, (positions,) = relative([vertices])
    source, triangles, normals = split_normals(positions, triangles)
    material = (np.arange(len(triangles)) % 2).astype(np.int32)
    looks = (Material(base_color=(1, 0.8, 0.5)), Material(smooth=False))
    light = (Light((1, 2, 3)),)
    return Scene(
        positions[source], triangles, normals, material=material, materials=looks, lights=light, origin=origin, **settings
    )


def moved(camera: Camera, by: tuple[float, ...]) -> Camera:
    eye, target = (tuple(np.add(point, by).tolist()) for point in (camera.eye, camera.target))
    return Camera(eye, target, camera.up, camera.fov_y, camera.near, camera.far)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("place", PLACES)
def test_a_ball_is_drawn_as_at_home(place, backend):
    vertices, triangles = ball()
    home, away = scene_of(vertices, triangles), scene_of(vertices + PLACES[place], triangles)
    assert home.origin == (0, 0, 0) and away.origin == PLACES[place]
    assert np.array_equal(away.bounds, home.bounds + PLACES[place])
    cameras = [moved(camera, PLACES[place]) for camera in CAMERAS]
    one, two = (
        render(scene, seen_by, (60, 80), backend=backend, return_buffers=True)
        for scene, seen_by in ((home, CAMERAS), (away, cameras))
    )
    assert two[0].tobytes() == one[0].tobytes() and two[1].positions.tobytes() == one[1].positions.tobytes()
    assert np.array_equal(two[1].visibility.packed, one[1].visibility.packed) and (one[1].visibility.triangle >= 0).mean() > 0.3


@pytest.mark.parametrize("place", [(400_000.25, 4_080_000.75, 120.3), (4_177_327.91, 855_103.17, 4_728_096.33)])
def test_what_framing_sees_of_map_coordinates(place):
    """No coordinate is exact, but positions are within 2^-23 m of where they are at home, and so is what follows from them."""
    vertices, triangles = ball()
    home, away = scene_of(vertices, triangles), scene_of(vertices + place, triangles)
    error = away.positions.astype(np.float64) + away.origin - place - home.positions
    assert np.abs(error).max() <= 2.0**-23
    frames = [Camera.framing(scene.bounds, azimuth=20, elevation=10) for scene in (home, away)]
    assert np.abs(np.subtract(frames[1].eye, place) - frames[0].eye).max() <= 2.0**-22
    assert frames[1].depth_range == pytest.approx(frames[0].depth_range, abs=2.0**-21)
    drawn = [
        render(scene, camera, (256, 256), return_buffers=True)[1] for scene, camera in zip((home, away), frames, strict=True)
    ]
    # In clip space 1 is some hundred pixels; a vertex may still be snapped to another 1/256 px.
    assert np.abs(drawn[0].positions - drawn[1].positions).max() <= 2.0**-20
    assert ((drawn[0].visibility.triangle >= 0) != (drawn[1].visibility.triangle >= 0)).sum() <= 4


def test_models_within_8_times_their_size_keep_the_origin():
    size = np.array([(0, 0, 0), (1, 2, 0.5)])
    for low, origin in (
        ((0, 0, 0), (0, 0, 0)),
        ((14, 0, 0), (0, 0, 0)),  # up to 15
        ((0, -16, 0), (0, 0, 0)),
        ((15.5, 0, 0), (16, 0, 0)),
        ((0, 14.5, 0), (0, 16, 0)),
        ((-17, 3, 3), (-16, 4, 4)),
        ((500_000, 5_400_000, 0.25), (500_000, 5_400_000, 0)),
    ):
        assert origin_for(size + low) == origin, low
    for bounds in ([(5, 5, 5)] * 2, [(-1e308,) * 3, (1e308,) * 3], [(0, 0, 0)] * 2):
        assert origin_for(np.array(bounds, float)) == (0, 0, 0)


def test_positions_near_home_keep_their_bits():
    rng = np.random.default_rng(0)
    parts = [rng.normal(size=(50, 3)) + (3, 0, 0), np.array([(-0.0, 0, 1e-45), (1e300, 0, np.nan)]), np.zeros((0, 3))]
    origin, rounded = relative(parts)
    assert origin == (0, 0, 0)
    with np.errstate(over="ignore"):
        assert [part.tobytes() for part in rounded] == [part.astype(np.float32).tobytes() for part in parts]


def test_what_is_not_finite_has_no_say_in_the_origin():
    vertices, _ = ball()
    broken = np.array([(np.nan, 0, 0), (0, np.inf, 0)])
    origin, (whole, rest, none) = relative([vertices + PLACES["UTM"], broken, broken[:0]])
    assert origin == PLACES["UTM"] and np.array_equal(whole, vertices) and none.shape == (0, 3)
    assert np.isnan(rest[0, 0]) and rest[1, 1] == np.inf
    assert relative([broken])[0] == relative([])[0] == (0, 0, 0)


@pytest.mark.parametrize("kind", ["obj", "glb", "glb of two"])
def test_files_with_map_coordinates(kind, tmp_path):
    vertices, triangles = ball()
    place, path = np.array(PLACES["UTM"]), tmp_path / f"far.{kind[:3]}"
    if kind == "obj":  # in the file itself
        lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in (vertices + place).tolist()]
        path.write_text("\n".join([*lines, *(f"f {i} {j} {k}" for i, j, k in (triangles + 1).tolist())]))
    else:  # by the nodes of the file
        scene, matrix = trimesh.Scene(), np.eye(4)
        for name, at in (("one", place), ("two", place + (4, 0, 0)))[: 2 if kind.endswith("two") else 1]:
            matrix[:3, 3] = at
            scene.add_geometry(trimesh.Trimesh(vertices, triangles, process=False), node_name=name, transform=matrix.copy())
        scene.export(path)
    loaded = load_scene(path)
    assert np.abs(np.array(loaded.origin) - place).max() <= 4
    far = np.concatenate([vertices, vertices + (4, 0, 0)]) if kind.endswith("two") else vertices
    world = loaded.positions.astype(np.float64) + loaded.origin
    assert np.array_equal(np.unique(world, axis=0), np.unique(far + place, axis=0))
    assert np.array_equal(loaded.bounds, [far.min(axis=0) + place, far.max(axis=0) + place])


def test_a_file_near_home_has_no_origin(tmp_path):
    vertices, triangles = ball()
    trimesh.Trimesh(vertices + (13, -15, 0), triangles, process=False).export(tmp_path / "near.ply")
    loaded = load_scene(tmp_path / "near.ply")
    assert loaded.origin == (0, 0, 0) and loaded.positions[:, 1].max() == -14


def test_merging_brings_origins_together():
    vertices, triangles = ball()
    east, south = np.add(PLACES["UTM"], (4, 0, 0)), np.add(PLACES["UTM"], (0, -8, 0))
    parts = [scene_of(vertices + place, triangles, ambient=(0.5, 0, 0)) for place in (east, south)]
    assert parts[0].origin != parts[1].origin
    together = merge(parts)
    assert together.ambient == (0.5, 0, 0) and np.array_equal(together.bounds, [south - 1, east + 1])
    world = together.positions.astype(np.float64) + together.origin
    wanted = np.concatenate([part.positions.astype(np.float64) + part.origin for part in parts])
    assert np.array_equal(world, wanted)
    # The same origin stays, and so does every bit.
    twice = merge([parts[0], parts[0].with_(positions=-parts[0].positions)])
    assert twice.origin == parts[0].origin
    assert twice.positions.tobytes() == np.concatenate([parts[0].positions, -parts[0].positions]).tobytes()
    # What lies at home and far away cannot both be near.
    home = scene_of(vertices, triangles)
    assert merge([home, parts[0]]).bounds == pytest.approx(np.array([(-1, -1, -1), east + 1]), abs=0.5)


def test_an_empty_scene_is_at_its_origin():
    nothing = Scene(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32), origin=(1, 2, 3))
    assert nothing.bounds.tolist() == [[1, 2, 3]] * 2


def test_the_sign_of_a_zero_bound_stays():
    low = np.array([(-0.0, 0, 1), (1, 0, 1), (1, 1, 1)], np.float32)
    assert np.signbit(Scene(low, np.array([(0, 1, 2)], np.int32)).bounds[0, 0])


@pytest.mark.parametrize("origin", [(1, 2), (1, 2, np.nan), "here", None])
def test_an_origin_is_three_numbers(origin):
    with pytest.raises((TypeError, ValueError), match="bigtri.Scene: origin must be three finite numbers"):
        scene_of(*ball()).with_(origin=origin)
    with pytest.raises((TypeError, ValueError), match="bigtri.Camera: origin must be three finite numbers"):
        CAMERAS[0].transform(np.zeros((1, 3)), 1.0, origin)

"""Objects that stay told apart in a merged scene, and scenes at other poses."""

import gltf_files
import numpy as np
import pytest
import torch
import trimesh

from bigtri import Camera, Scene, from_trimesh, instance_ids, load_scene, merge, rasterize, render
from bigtri.scene.carried import Marks
from bigtri.scene.normals import face_normals


def square(z: float = 0.0, half: float = 1.0) -> Scene:
    """Two triangles that face +z."""
    corners = np.array([(-half, -half, z), (half, -half, z), (half, half, z), (-half, half, z)], np.float32)
    return Scene(corners, np.array([(0, 1, 2), (0, 2, 3)], np.int32), normals=np.tile(np.float32((0, 0, 1)), (4, 1)))


def translation(x: float, y: float, z: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def drawn(scene: Scene):
    camera = Camera.orthographic((0, 0, 5), (0, 0, 0), height=8)
    return rasterize(camera.transform(scene.positions, 1.0, scene.origin), scene.triangles, (64, 64))


def test_merge_numbers_instances_one_after_the_other():
    one, two = square(), square().with_(instance=np.array([1, 0], np.int32))
    assert one.instance is None and one.instance_count == 1 and two.instance_count == 2
    empty = Scene(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32))
    merged = merge([one, two, empty, one])
    assert merged.instance.tolist() == [0, 0, 2, 1, 4, 4] and merged.instance_count == 5
    assert merge([merged, one]).instance.tolist() == [0, 0, 2, 1, 4, 4, 5, 5]
    assert merged.with_(cull="back").instance is merged.instance


def test_instance_ids_of_a_picture():
    front, behind = square(1, 0.5).moved(translation(-1, 0, 0)), square(-1, 2)
    scene = merge([behind, front])
    seen = drawn(scene)
    ids = instance_ids(scene, seen)
    assert ids.dtype == np.int32 and ids.shape == (64, 64)
    assert np.unique(ids).tolist() == [-1, 0, 1]
    assert (ids == 1).sum() == 8 * 8 and (ids >= 0).sum() == 32 * 32
    assert ids[32, 32 - 8] == 1 and ids[32, 32 + 8] == 0 and ids[0, 0] == -1
    clip = Camera.orthographic((0, 0, 5), (0, 0, 0), height=8).transform(scene.positions, 1.0)
    tensors = rasterize(torch.from_numpy(np.stack([clip, clip])), torch.from_numpy(scene.triangles), (64, 64))
    both = instance_ids(scene, tensors)
    assert both.dtype == torch.int32 and np.array_equal(both.numpy(), np.stack([ids, ids]))
    _, buffers = render(scene, Camera((0, 0, 9), (0, 0, 0)), (32, 32), return_buffers=True)
    assert np.unique(instance_ids(scene, buffers.visibility)).tolist() == [-1, 0, 1]
    alone = square()
    assert np.array_equal(instance_ids(alone, drawn(alone)), np.where(drawn(alone).triangle < 0, -1, 0))


def test_instance_ids_of_another_scene_are_refused():
    scene = square()
    seen = drawn(merge([scene, scene.moved(translation(2, 0, 0))]))
    with pytest.raises(ValueError, match="instance_ids: visibility must be of the 2 triangles of scene, got 3"):
        instance_ids(scene, seen)
    with pytest.raises(TypeError, match="instance_ids: scene must be a Scene"):
        instance_ids(None, seen)
    with pytest.raises(TypeError, match=r"instance_ids: visibility must be a Visibility, got int32 \[64, 64\]"):
        instance_ids(scene, seen.triangle)


def test_what_an_instance_must_be():
    with pytest.raises(ValueError, match=r"bigtri.Scene: instance must be int32 \[2\], got \[3\]"):
        square().with_(instance=np.zeros(3, np.int32))
    with pytest.raises(TypeError, match="bigtri.Scene: instance must be a NumPy array int32"):
        square().with_(instance=np.zeros(2, np.int64))
    with pytest.raises(ValueError, match="bigtri.Scene: instance must be at least 0, got -1"):
        square().with_(instance=np.array([0, -1], np.int32))


def test_nodes_of_a_gltf_are_instances(tmp_path):
    """Both primitives of a node belong to one, with positions of their own or shared; a repeated mesh is one at each place."""
    shared = gltf_files.shared_accessors(2).write(tmp_path / "shared.glb")
    assert load_scene(shared).instance.tolist() == [0] * 4
    nodes = gltf_files.shared_accessors(3, nodes=True).write(tmp_path / "nodes.glb")
    assert load_scene(nodes).instance.tolist() == [0, 0, 1, 1, 2, 2]
    file = gltf_files.instanced()
    file.node(*(file.primitive({"POSITION": gltf_files.QUAD + np.float32((0, 0, z))}, gltf_files.QUAD_INDICES) for z in (1, 2)))
    assert load_scene(file.write(tmp_path / "places.glb")).instance.tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 3, 3]


def test_objects_of_a_trimesh_scene_and_of_the_glb_that_it_becomes(tmp_path):
    made = trimesh.Scene()
    made.add_geometry(trimesh.creation.box(), geom_name="box", node_name="a")
    made.graph.update(frame_to="b", matrix=translation(3, 0, 0), geometry="box")
    made.add_geometry(trimesh.creation.icosphere(subdivisions=1), node_name="c", transform=translation(0, 3, 0))
    made.export(tmp_path / "three.glb")
    for scene in (from_trimesh(made), load_scene(tmp_path / "three.glb")):
        assert np.bincount(scene.instance).tolist() == [12, 12, 80]
        centres = [scene.positions[scene.triangles[scene.instance == i]].mean(axis=(0, 1)).round(2).tolist() for i in range(3)]
        assert centres == [[0, 0, 0], [3, 0, 0], [0, 3, 0]]


OBJ = """v 0 0 0
v 1 0 0
v 0 1 0
{}
f 1 2 3
{}
{}
f 1 2 3
usemtl other
f 1 2 3
{}
f 1 2 3
"""


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (("o a", "g x", "o b", "o c"), [0, 1, 1, 2]),
        (("g a", "g none", "g b", "g a"), [0, 1, 1, 2]),
        (("g a", "o b", "g c", "s 1"), [0, 1, 1, 1]),
        (("s 1", "#", "#", "#"), None),
        (("o all", "#", "#", "#"), [0, 0, 0, 0]),
    ],
)
@pytest.mark.filterwarnings("ignore::bigtri.ModelWarning")
def test_objects_of_an_obj(tmp_path, lines, expected):
    (tmp_path / "some.obj").write_text(OBJ.format(*lines))
    scene = load_scene(tmp_path / "some.obj")
    assert (None if scene.instance is None else scene.instance.tolist()) == expected


def test_solids_of_an_stl(tmp_path):
    facet = "facet normal 0 0 1\nouter loop\nvertex 0 0 {0}\nvertex 1 0 {0}\nvertex 0 1 {0}\nendloop\nendfacet\n"
    (tmp_path / "two.stl").write_text(
        "solid a\n" + facet.format(0) + "endsolid\nsolid b\n" + facet.format(1) + facet.format(2) + "endsolid\n"
    )
    assert load_scene(tmp_path / "two.stl").instance.tolist() == [0, 1, 1]


def test_a_file_of_one_mesh_is_one_instance(tmp_path):
    trimesh.creation.box().export(tmp_path / "box.ply")
    assert load_scene(tmp_path / "box.ply").instance is None


def test_moved_is_what_the_matrix_says():
    matrix = np.array([[0.0, -2, 0, 5], [1, 0, 0, -3], [0, 0, 1, 0.25], [0, 0, 0, 1]])
    scene = square().with_(normals=np.tile(np.float32((0.6, 0, 0.8)), (4, 1)))
    moved = scene.moved(matrix)
    assert moved.positions.tolist() == [[7, -4, 0.25], [7, -2, 0.25], [3, -2, 0.25], [3, -4, 0.25]]
    assert np.array_equal(moved.triangles, scene.triangles)
    np.testing.assert_allclose(moved.normals, np.tile((0, 0.6, 0.8), (4, 1)), atol=1e-7)
    tilted = scene.moved(np.diag([2.0, 1, 1, 1]))  # normals go by the inverse transpose
    np.testing.assert_allclose(tilted.normals, np.tile(np.array((0.3, 0, 0.8)) / np.hypot(0.3, 0.8), (4, 1)), atol=1e-7)
    assert np.array_equal(scene.moved(np.eye(4)).positions, scene.positions)
    flat = scene.with_(normals=None).moved(matrix)
    assert flat.normals is None


def test_a_mirror_keeps_fronts_in_front():
    mirrored = square().moved(np.diag([-1.0, 1, 1, 1]))
    assert face_normals(mirrored.positions, mirrored.triangles).tolist() == [[0, 0, 1]] * 2
    assert mirrored.normals.tolist() == [[0, 0, 1]] * 4
    through = square().moved(np.diag([1.0, 1, -1, 1]))
    assert face_normals(through.positions, through.triangles).tolist() == [[0, 0, -1]] * 2
    assert through.normals.tolist() == [[0, 0, -1]] * 4


def test_moved_far_away_keeps_its_form():
    """Positions are counted from an origin of their own there, and cameras are none the wiser."""
    shape = from_trimesh(trimesh.creation.icosphere(subdivisions=2))
    away = translation(2.0**22, 2.0**23, 0)
    moved = shape.moved(away)
    assert moved.origin != (0, 0, 0)
    assert np.array_equal(moved.moved(np.linalg.inv(away)).positions, shape.positions)
    marked = shape.with_(marks=(Marks(np.float32([(1, 2, 3)]), np.int32([[0]])),)).moved(away)
    assert (marked.marks[0].positions + np.array(marked.origin)).tolist() == [[2**22 + 1, 2**23 + 2, 3]]
    camera = Camera((2.0**22, 2.0**23, 5), (2.0**22, 2.0**23, 0))
    here = Camera((0, 0, 5), (0, 0, 0))
    assert np.array_equal(render(moved, camera, (40, 40)), render(shape, here, (40, 40)))


def test_matrices_that_move_nothing():
    for matrix, error, text in (
        (np.eye(3), ValueError, r"matrix must be \[4, 4\], got \[3, 3\]"),
        (np.full((4, 4), np.nan), ValueError, "matrix must be finite with a last row of 0 0 0 1"),
        (2 * np.eye(4), ValueError, "a last row of 0 0 0 1"),
        ("here", TypeError, "matrix must be an array of numbers"),
    ):
        with pytest.raises(error, match="bigtri.Scene.moved: .*" + text):
            square().moved(matrix)


def test_points_are_those_that_are_drawn():
    scene = square().with_(triangles=np.array([(0, 1, 2), (0, 1, 2)], np.int32), origin=(10, 0, 0))
    assert scene.points.dtype == np.float64
    assert scene.points.tolist() == [[9, -1, 0], [11, -1, 0], [11, 1, 0]]
    assert np.array_equal(np.stack([scene.points.min(axis=0), scene.points.max(axis=0)]), scene.bounds)

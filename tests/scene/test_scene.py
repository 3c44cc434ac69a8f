"""Scenes from files that the tests write themselves, merging, and normals."""

import json
import warnings

import numpy as np
import pytest
import trimesh
from PIL import Image

from bigtri import Camera, ModelWarning, Scene, load_scene, render
from bigtri.reference.shading import decode_table
from bigtri.scene import Light, Material, from_trimesh, merge
from bigtri.scene.carried import Lamp, Marks
from bigtri.scene.normals import face_normals, is_closed, split_normals
from bigtri.scene.readers import assemble

# Red, green above blue, white: every corner of a texture is told from the others.
CORNERS = np.array([[(255, 0, 0), (0, 255, 0)], [(0, 0, 255), (255, 255, 255)]], np.uint8)


POINT, INDEX = np.zeros((1, 3), np.float32), np.zeros((1, 1), np.int32)


def textured_quad() -> trimesh.Trimesh:
    """In the x-y plane, facing +z, the texture upright on it."""
    uv = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], float)
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=Image.fromarray(CORNERS), baseColorFactor=(255, 128, 255, 255)
    )
    return trimesh.Trimesh(
        np.column_stack([2 * uv - 1, np.zeros(4)]),
        [(0, 1, 2), (0, 2, 3)],
        visual=trimesh.visual.TextureVisuals(uv=uv, material=material),
        process=False,
    )


def unit(v):
    return np.asarray(v) / np.linalg.norm(v)


def test_glb_with_texture_and_transforms(tmp_path):
    scene = trimesh.Scene()
    scene.add_geometry(textured_quad(), node_name="plain")
    mirror = np.diag([-1.0, 2, 1, 1])
    mirror[:3, 3] = (10, 0, 0)
    scene.add_geometry(textured_quad(), node_name="mirrored", transform=mirror)
    scene.export(tmp_path / "two.glb")

    loaded = load_scene(tmp_path / "two.glb")
    assert loaded.positions.dtype == np.float32 and loaded.triangles.dtype == np.int32
    assert len(loaded.triangles) == 4
    np.testing.assert_allclose(loaded.bounds, [(-1, -2, 0), (11, 2, 0)])
    # uv (0, 0) is the lower left corner, where the image is blue.
    first = loaded.positions[:, 0] < 5
    at = {tuple(uv): tuple(p) for uv, p in zip(loaded.uvs[first].tolist(), loaded.positions[first].tolist(), strict=True)}
    assert at == {(0, 0): (-1, -1, 0), (1, 0): (1, -1, 0), (1, 1): (1, 1, 0), (0, 1): (-1, 1, 0)}
    material = loaded.materials[loaded.material[0]]
    assert material.texture.shape == (2, 2, 3) and material.two_sided
    assert material.texture.dtype == np.uint8 and np.array_equal(material.texture, CORNERS)
    np.testing.assert_allclose(material.base_color, (1, 128 / 255, 1))
    # A mirrored node still shows its front.
    np.testing.assert_allclose(face_normals(loaded.positions, loaded.triangles), [(0, 0, 1)] * 4)
    np.testing.assert_allclose(loaded.normals, [(0, 0, 1)] * len(loaded.normals))


def test_normals_from_the_file_go_by_the_inverse_transpose(tmp_path):
    mesh = trimesh.Trimesh([(0, 0, 0), (1, 0, -1), (0, 1, 0)], [(0, 1, 2)], vertex_normals=[unit((1, 0, 1))] * 3, process=False)
    scene = trimesh.Scene()
    scene.add_geometry(mesh, transform=np.diag([2.0, 1, 1, 1]))
    scene.export(tmp_path / "stretched.glb")
    loaded = load_scene(tmp_path / "stretched.glb")
    np.testing.assert_allclose(loaded.normals, [unit((1, 0, 2))] * 3, atol=1e-6)
    np.testing.assert_allclose(face_normals(loaded.positions, loaded.triangles), [unit((1, 0, 2))], atol=1e-6)


OBJ = """mtllib colors.mtl
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
vt 0 0
vt 1 0
vt 1 1
vt 0 1
usemtl painted
f 1/1 2/2 3/3
usemtl plain
f 1/1 3/3 4/4
"""


def test_obj_with_materials(tmp_path):
    (tmp_path / "two.obj").write_text(OBJ)
    with pytest.warns(ModelWarning) as warned:
        load_scene(tmp_path / "two.obj")
    assert [str(one.message).partition("two.obj: ")[2] for one in warned] == [
        "the material library colors.mtl is not there: it is drawn without",
        "the material painted is in no material library: it is drawn grey (2 times)",
    ]
    (tmp_path / "colors.mtl").write_text("newmtl painted\nKd 1 1 1\nmap_Kd paint.png\nnewmtl plain\nKd 0 0.5 1\n")
    Image.fromarray(CORNERS).save(tmp_path / "paint.png")
    loaded = load_scene(tmp_path / "two.obj")
    painted, plain = sorted((loaded.materials[m] for m in loaded.material), key=lambda material: material.texture is None)
    assert np.array_equal(painted.texture, CORNERS) and plain.texture is None
    np.testing.assert_allclose(plain.base_color, decode_table()[[0, 127, 255]], atol=0.005)  # Kd is sRGB


@pytest.mark.parametrize("kind", ["vertex", "face"])
def test_ply_colors(tmp_path, kind):
    mesh = trimesh.creation.icosahedron()
    count = len(mesh.vertices) if kind == "vertex" else len(mesh.faces)
    codes = np.random.default_rng(0).integers(0, 256, (count, 4)).astype(np.uint8)
    codes[:, 3] = 255
    mesh.visual = trimesh.visual.ColorVisuals(mesh, **{f"{kind}_colors": codes})
    mesh.export(tmp_path / "colored.ply")
    loaded = load_scene(tmp_path / "colored.ply")
    assert loaded.materials[0].vertex_colors and not loaded.materials[0].two_sided
    if kind == "vertex":
        places = {tuple(np.float32(p)): c for p, c in zip(mesh.vertices, codes[:, :3], strict=True)}
        expected = np.array([decode_table()[places[tuple(p)]] for p in loaded.positions])
        assert np.array_equal(loaded.colors, expected)
    else:
        assert np.array_equal(loaded.colors[loaded.triangles], np.repeat(decode_table()[codes[:, None, :3]], 3, axis=1))


def test_files_that_cannot_be_drawn(tmp_path):
    with pytest.raises(FileNotFoundError, match="no such file"):
        load_scene(tmp_path / "nowhere.glb")
    (tmp_path / "picture.png").write_bytes(b"")
    with pytest.raises(ValueError, match="path must end in .glb, .*got picture.png: convert it"):
        load_scene(tmp_path / "picture.png")
    (tmp_path / "broken.glb").write_bytes(b"not a model")
    with pytest.raises(ValueError, match=r'broken.glb: the file must begin with "glTF", .* got b\'not a mo\''):
        load_scene(tmp_path / "broken.glb")
    trimesh.PointCloud(np.zeros((4, 3))).export(tmp_path / "points.ply")
    with pytest.raises(ValueError, match="no triangles in it"):
        load_scene(tmp_path / "points.ply")


def test_a_box_keeps_its_edges_and_a_sphere_is_smooth():
    box = trimesh.creation.box()
    source, triangles, normals = split_normals(box.vertices.astype(np.float32), box.faces.astype(np.int32))
    assert len(source) == 24 and np.array_equal(np.sort(np.abs(normals), axis=1), np.tile([0, 0, 1], (24, 1)))
    assert np.array_equal(box.vertices[source][triangles], box.vertices[box.faces])
    sphere = trimesh.creation.icosphere(subdivisions=3)
    source, _, normals = split_normals(sphere.vertices.astype(np.float32), sphere.faces.astype(np.int32))
    assert len(source) == len(sphere.vertices)
    np.testing.assert_allclose(normals, sphere.vertices[source], atol=0.02)


def test_a_seam_of_the_texture_is_none_of_the_surface():
    sphere = trimesh.creation.icosphere(subdivisions=3)
    apart = sphere.vertices[sphere.faces].reshape(-1, 3).astype(np.float32)
    _, triangles, normals = split_normals(apart, np.arange(len(apart), dtype=np.int32).reshape(-1, 3))
    np.testing.assert_allclose(normals[triangles].reshape(-1, 3), apart, atol=0.02)


def test_a_fan_of_many_triangles_gets_one_normal_at_its_centre():
    angle = np.linspace(0, 2 * np.pi, 300, endpoint=False)
    positions = np.concatenate([[(0, 0, 0.1)], np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)]).astype(np.float32)
    triangles = np.stack([np.zeros(300), 1 + np.arange(300), 1 + (np.arange(300) + 1) % 300], axis=1).astype(np.int32)
    source, _, normals = split_normals(positions, triangles)
    assert (source == 0).sum() == 1
    np.testing.assert_allclose(normals[source == 0], [(0, 0, 1)], atol=1e-6)


def test_closed():
    box = trimesh.creation.box()
    positions, triangles = box.vertices.astype(np.float32), box.faces.astype(np.int32)
    assert is_closed(positions, triangles)
    assert is_closed(positions[triangles].reshape(-1, 3), np.arange(36, dtype=np.int32).reshape(-1, 3))
    assert not is_closed(positions, triangles[1:])  # a hole
    assert not is_closed(positions, triangles[:, ::-1])  # inside out
    flipped = triangles.copy()
    flipped[0] = flipped[0, ::-1]
    assert not is_closed(positions, flipped)
    assert not is_closed(positions, triangles[:0])


def test_merge():
    shared = Material("shared")
    a = Scene(np.zeros((3, 3), np.float32), np.array([(0, 1, 2)], np.int32), materials=(shared,))
    colored = {"colors": np.ones((4, 3), np.float32), "normals": np.ones((4, 3), np.float32)}
    painted = Material("painted", texture=np.ones((1, 1, 3), np.float32), vertex_colors=True)
    b = Scene(np.ones((4, 3), np.float32), np.array([(1, 2, 3)], np.int32), **colored, materials=(painted,))
    both = merge([a, b, a.with_(normals=np.ones((3, 3), np.float32)), b])
    assert both.triangles.tolist() == [[0, 1, 2], [4, 5, 6], [7, 8, 9], [11, 12, 13]]
    assert len(both.positions) == len(both.colors) == len(both.normals) == 14 and both.uvs is None
    assert not both.colors[:3].any() and both.colors[3:7].all()
    drawn = [both.materials[m] for m in both.material]
    # What had no data is not drawn with somebody else's, and what is shared is kept once where it means the same.
    assert [m.smooth for m in drawn] == [False, True, True, True]
    assert [m.texture is None for m in drawn] == [True] * 4
    assert [m.vertex_colors for m in drawn] == [False, True, False, True]
    with pytest.raises(ValueError, match="at least one scene"):
        merge([])


def test_merge_keeps_what_is_carried():
    triangle = Scene(np.zeros((3, 3), np.float32), np.array([(0, 1, 2)], np.int32), cameras=[Camera((0, 0, 1), (0, 0, 0))])
    point = Marks(np.ones((1, 3), np.float32), np.zeros((1, 1), np.int32))
    far = Scene(
        np.eye(3, dtype=np.float32), np.array([(0, 1, 2)], np.int32), origin=(4096, 0, 0), marks=[point], lamps=[Lamp("point")]
    )
    both = merge([triangle, far])
    assert both.cameras == triangle.cameras and both.lamps == far.lamps
    (moved,) = both.marks
    assert (moved.positions + np.array(both.origin)).tolist() == [[4097, 1, 1]]
    assert merge([far, far]).marks == (point, point)


def test_from_trimesh_takes_a_mesh():
    scene = from_trimesh(trimesh.creation.torus(2, 1))
    assert scene.normals is not None and not scene.materials[0].two_sided
    assert scene.used_materials == (0,)


@pytest.mark.parametrize(
    ("change", "error", "text"),
    [
        ({"positions": np.zeros((3, 3))}, TypeError, "positions must be a NumPy array float32"),
        ({"positions": np.zeros((3, 4), np.float32)}, ValueError, r"positions must be float32 \[V, 3\], got \[3, 4\]"),
        (
            {"triangles": np.array([(0, 1, 3)], np.int32)},
            ValueError,
            "triangles must index the 3 positions, got indices from 0 to 3",
        ),
        (
            {"triangles": np.array([(0, 1, -1)], np.int32)},
            ValueError,
            "triangles must index the 3 positions, got indices from -1",
        ),
        ({"normals": np.zeros((2, 3), np.float32)}, ValueError, r"normals must be float32 \[3, 3\]"),
        ({"material": np.array([1], np.int32)}, ValueError, "material must index the 1 materials"),
        ({"marks": [1]}, TypeError, "marks must be a sequence of Marks, got 1 in it"),
        ({"cull": "both"}, ValueError, "cull must be one of"),
        ({"cull": None}, TypeError, "cull must be one of"),
        ({"positions": None}, TypeError, r"positions must be a NumPy array float32 \[V, 3\], got NoneType"),
        ({"triangles": None}, TypeError, "triangles must be a NumPy array int32"),
        ({"materials": ()}, ValueError, "materials must hold at least one Material"),
        ({"materials": ["red"]}, TypeError, "materials must be a sequence of Material, got 'red' in it"),
        ({"lights": None}, TypeError, "lights must be a sequence of Light"),
        ({"lights": ((0, 0, 1),)}, TypeError, "lights must be a sequence of Light"),
        ({"ambient": None}, TypeError, "ambient must be three finite numbers"),
        ({"ambient": (1, 2)}, ValueError, "ambient must be three finite numbers"),
        ({"background": (1, 2)}, TypeError, "background must be three finite numbers"),
        ({"background": ((1, 2, 3),) * 4}, ValueError, "background must be a colour, or two"),
        ({"background": 1}, TypeError, "background must be a colour, or two"),
        ({"background": ((1, 2, 3), (1, 2, np.nan))}, ValueError, "background must be three finite numbers"),
    ],
)
def test_scene_errors(change, error, text):
    with pytest.raises(error, match="bigtri.Scene: " + text):
        Scene(**{"positions": np.zeros((3, 3), np.float32), "triangles": np.array([(0, 1, 2)], np.int32), **change})


@pytest.mark.parametrize(
    ("make", "error", "text"),
    [
        (lambda: Light((0, 0, 0)), ValueError, "Light: direction must be finite and not zero"),
        (lambda: Light(None), TypeError, "Light: direction must be three finite numbers"),
        (lambda: Light((0, 0, 1), (1, 1)), ValueError, "Light: color must be three finite numbers"),
        (lambda: Material(wrap="mirror"), ValueError, "Material: wrap"),
        (lambda: Material(filter="cubic"), ValueError, "Material: filter"),
        (lambda: Material(base_color="red"), TypeError, "Material: base_color must be three finite numbers"),
        (lambda: Material(base_color=(1, 1, np.inf)), ValueError, "Material: base_color must be three finite numbers"),
        (lambda: Material(smooth=None), TypeError, "Material: smooth must be True or False"),
        (lambda: Material(name=1), TypeError, "Material: name must be text"),
        (
            lambda: Material(texture=np.zeros((2, 2, 3), np.int16)),
            TypeError,
            r"Material: texture must be a NumPy array float32, uint8 or uint16 \[Ht, Wt, 3\], got int16 \[2, 2, 3\]",
        ),
        (
            lambda: Material(texture=np.zeros((2, 2, 4), np.uint8)),
            ValueError,
            r"Material: texture must be float32, uint8 or uint16 \[Ht",
        ),
        (lambda: Material(texture=np.zeros((0, 2, 3), np.float32)), ValueError, "Material: texture must have at least one texel"),
        (
            lambda: Material(texture=np.zeros((3, 8, 9), np.float32)),
            ValueError,
            r"Material: texture must be .* got \[3, 8, 9\], which looks like \[C, Ht, Wt\]: pass texture.transpose",
        ),
        (lambda: Material(alpha_mode="glass"), ValueError, "Material: alpha_mode must be one of 'opaque', 'mask', 'blend'"),
        (lambda: Material(alpha=None), TypeError, "Material: alpha must be a finite number"),
        (lambda: Material(emissive=1), TypeError, "Material: emissive must be three finite numbers"),
        (lambda: Material(unlit=1), TypeError, "Material: unlit must be True or False"),
        (
            lambda: Marks(np.zeros((1, 2), np.float32), INDEX),
            ValueError,
            r"Marks: positions must be float32 \[V, 3\], got \[1, 2\]",
        ),
        (lambda: Marks(POINT, INDEX + 1), ValueError, "Marks: indices must index the 1 positions, got indices from 1 to 1"),
        (lambda: Marks(POINT, np.zeros((1, 3), np.int32)), ValueError, r"Marks: indices must be int32 \[N, 1\] or \[N, 2\], got"),
        (lambda: Marks(POINT, INDEX, POINT[:0]), ValueError, r"Marks: colors must be float32 \[1, 3\], got \[0, 3\]"),
        (lambda: Lamp("sun"), ValueError, "Lamp: kind must be one of 'directional', 'point', 'spot'"),
        (lambda: Lamp("spot", cone=(0, np.nan)), ValueError, "Lamp: cone must be a finite number"),
        (lambda: merge([1]), TypeError, "merge: scenes must hold Scene alone, got int"),
        (lambda: from_trimesh(1), TypeError, "from_trimesh: loaded must be a trimesh.Scene or trimesh.Trimesh"),
        (lambda: load_scene(None), TypeError, "load_scene: path must be a path"),
    ],
)
def test_other_errors(make, error, text):
    with pytest.raises(error, match="bigtri." + text):
        make()


def test_arrays_of_any_strides_are_drawn():
    """What torch cannot share memory with is copied."""
    positions = np.array([(-1, -1, 0), (1, -1, 0), (0, 1, 0)], np.float32)
    triangles, uvs = np.array([(2, 1, 0)], np.int32), positions[:, :2].copy()
    texture = np.random.default_rng(0).random((4, 5, 3), np.float32)
    camera = Camera((0, 0, 3), (0, 0, 0))
    read_only = positions.copy()
    read_only.flags.writeable = False
    plain = Scene(positions, triangles[:, ::-1].copy(), uvs=uvs, materials=(Material(texture=texture[::-1].copy()),))
    strided = Scene(read_only, triangles[:, ::-1], uvs=positions[:, :2], materials=(Material(texture=texture[::-1]),))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.array_equal(render(strided, camera, (30, 40)), render(plain, camera, (30, 40)))
    assert plain.positions is positions and plain.uvs is uvs  # what can be shared is


PLY = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
3 0 1 {index}
"""


@pytest.mark.parametrize("index", [7, -1])
def test_an_index_out_of_range_in_a_ply(tmp_path, index):
    (tmp_path / "bad.ply").write_text(PLY.format(index=index))
    with pytest.raises(ValueError, match=r"bigtri.load_scene: .*bad.ply: .*faces must index the 3 vertices, got indices from"):
        load_scene(tmp_path / "bad.ply")


def test_an_index_out_of_range_in_a_glb(tmp_path):
    data = bytearray(trimesh.creation.box().export(file_type="glb"))
    length = int.from_bytes(data[12:16], "little")
    head = json.loads(data[20 : 20 + length])
    indices = head["accessors"][head["meshes"][0]["primitives"][0]["indices"]]
    start = 20 + length + 8 + head["bufferViews"][indices["bufferView"]].get("byteOffset", 0)
    data[start : start + 4] = (9999).to_bytes(4, "little")
    (tmp_path / "bad.glb").write_bytes(data)
    with pytest.raises(ValueError, match="bigtri.load_scene: .*indices must index the 8 vertices, got indices from 0 to 9999"):
        load_scene(tmp_path / "bad.glb")


def test_vertices_of_two_coordinates_in_an_obj(tmp_path):
    (tmp_path / "flat.obj").write_text("v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n")
    with pytest.raises(ValueError, match=r"bigtri.load_scene: .*flat.obj: line 1: v must have 3 numbers or more, got '0 0'"):
        load_scene(tmp_path / "flat.obj")


@pytest.mark.parametrize(
    ("owner", "name"),
    [
        (trimesh.Trimesh, "faces"),
        (trimesh.Trimesh, "vertices"),
        (trimesh.scene.transforms.SceneGraph, "nodes_geometry"),
        (trimesh.visual.ColorVisuals, "kind"),
    ],
)
def test_whatever_trimesh_raises_is_a_value_error(monkeypatch, owner, name):
    """Also when it is asked for what it has not worked out yet."""

    def fail(_):
        raise KeyError("accessors")

    created = trimesh.Scene(trimesh.creation.box())
    monkeypatch.setattr(owner, name, property(fail))
    with pytest.raises(ValueError, match="bigtri.from_trimesh: KeyError: 'accessors'"):
        from_trimesh(created)


@pytest.mark.parametrize("function", ["split_normals", "is_closed", "placed_from", "Scene"])
@pytest.mark.parametrize("error", [KeyError("bug"), ValueError("bug")])
def test_faults_of_our_own_are_not_blamed_on_the_file(tmp_path, monkeypatch, function, error):
    def fail(*_, **__):
        raise error

    trimesh.creation.box().export(tmp_path / "box.ply")
    monkeypatch.setattr(assemble, function, fail)
    for read in (lambda: load_scene(tmp_path / "box.ply"), lambda: from_trimesh(trimesh.creation.box())):
        with pytest.raises(type(error)) as raised:
            read()
        assert raised.value is error


def test_arrays_of_the_wrong_shape():
    """What trimesh hands on of a file that says so."""
    box = trimesh.creation.box()
    box.visual = trimesh.visual.TextureVisuals(uv=np.zeros((8, 1)))
    with pytest.raises(ValueError, match=r"from_trimesh: mesh: texture coordinates must be \[8, 2\], got \[8, 1\]"):
        from_trimesh(box)
    box.visual = trimesh.visual.TextureVisuals()
    box.visual.vertex_attributes["color"] = np.zeros((7, 4), np.uint8)
    with pytest.raises(ValueError, match=r"from_trimesh: mesh: colors must be \[8, 3\], got \[7, 3\]"):
        from_trimesh(box)

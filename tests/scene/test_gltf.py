"""The glTF reader, file by file: what is in each stands in gltf_files.py."""

import sys
import types
import warnings

import gltf_files
import numpy as np
import pytest
from gltf_files import QUAD, QUAD_INDICES, QUAD_UVS, File, data_uri, encoded, quad, quarters, textured_quad
from PIL import Image

import bigtri
from bigtri import Camera, ModelWarning, load_scene, render
from bigtri.scene.carried import Lamp
from bigtri.scene.normals import face_normals
from bigtri.scene.readers.gltf.accessors import Accessors
from bigtri.scene.readers.gltf.document import Document

SQUARE = [[-1, -1, 0], [1, 1, 0]]
RED, GREEN, BLUE, WHITE = (255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 255, 255)


@pytest.fixture
def load(tmp_path):
    """Writes a file and loads it; a warning is an error unless a kind of it is expected."""

    def write_and_load(file, ending=".glb", said=(), **settings):
        path = file.write(tmp_path / f"file{ending}")
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            scene = load_scene(path, **settings)
        texts = [str(one.message) for one in caught]
        assert all(one.category is ModelWarning for one in caught), texts
        assert len(texts) == len(said) and all(part in text for part, text in zip(said, texts, strict=True)), texts
        return scene

    return write_and_load


def seen(scene):
    """The buffers of a picture from (0, 0, 3)."""
    return render(scene, Camera((0, 0, 3), (0, 0, 0)), (64, 64), return_buffers=True)[1]


def quarter_colors(scene):
    """sRGB codes in the middle of the four quarters of a square, upper left and right, lower left and right."""
    albedo = bigtri.encode_srgb(seen(scene).albedo)
    return [tuple(albedo[y, x].tolist()) for y, x in ((24, 24), (24, 40), (40, 24), (40, 40))]


def error_of(file, tmp_path, ending=".glb"):
    with pytest.raises(ValueError, match=f"^bigtri.load_scene: .*file{ending}: ") as raised:
        load_scene(file.write(tmp_path / f"file{ending}"))
    text = str(raised.value)
    assert "\n" not in text
    return text.partition(f"file{ending}: ")[2]


@pytest.mark.parametrize("ending", [".glb", ".gltf"])
def test_a_square(load, ending):
    scene = load(quad(), ending)
    assert scene.bounds.tolist() == SQUARE and scene.triangles.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert scene.normals.tolist() == [[0, 0, 1]] * 4
    assert (seen(scene).visibility.triangle >= 0).sum() == 52 * 52
    (material,) = scene.materials
    assert material.two_sided and material.base_color == (0.6, 0.6, 0.6) and material.texture is None


@pytest.mark.parametrize(
    ("make", "bounds"),
    [
        (gltf_files.sparse_accessor, SQUARE),
        (gltf_files.partly_sparse_accessor, [[-1, -1, 0], [3, 1, 0]]),
        (gltf_files.strided_accessors, SQUARE),
        (gltf_files.strip, SQUARE),
        (gltf_files.fan, SQUARE),
        (gltf_files.normalized_positions, [[-3, -3, 0], [3, 3, 0]]),
        (gltf_files.skin_at_rest, [[4, -1, 0], [6, 1, 0]]),
        (gltf_files.bent_skin, [[-1, -1, 0], [3, 1, 0]]),
        (gltf_files.morphed, [[1, -1, 0], [3, 1, 0]]),
        (lambda: gltf_files.morphed(of_node=[0.5, 0.25]), [[0, 1, 0], [2, 3, 0]]),
        (gltf_files.instanced, [[-1, -1, 0], [12, 13, 0]]),
        (lambda: quad(node={"translation": [1, 2, 3], "scale": [2, 1, 1]}), [[-1, 1, 3], [3, 3, 3]]),
        (lambda: quad(node={"matrix": [2, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 1, 2, 3, 1]}), [[-1, 1, 3], [3, 3, 3]]),
        (lambda: quad(node={"rotation": [0.5, 0.5, 0.5, 0.5]}), [[0, -1, -1], [0, 1, 1]]),
        (lambda: quad(node={"rotation": [2, 2, 2, 2]}), [[0, -1, -1], [0, 1, 1]]),
    ],
)
def test_where_the_corners_are(load, make, bounds):
    scene = load(make())
    assert scene.bounds.tolist() == bounds
    # Whatever turns or mirrors them, squares keep their front.
    corners = scene.positions[scene.triangles].astype(np.float64)
    drawn = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("ij,ij->i", drawn, scene.normals[scene.triangles[:, 0]]) > 0).all()


def test_below_a_camera(load):
    scene = load(gltf_files.below_a_camera(), said=["a camera is in Scene.cameras: a picture is seen from it only if"])
    assert scene.bounds.tolist() == [[0, -2, 2], [4, 2, 2]]
    assert scene.cameras == (Camera((2, 0, 0), (2, 0, -1), (0, 2, 0), 45, 0.5, 9),)


def test_orthographic_cameras(load):
    file = gltf_files.below_a_camera()
    file.json["cameras"][0] = {"type": "orthographic", "orthographic": {"xmag": 3, "ymag": 1.5, "znear": 0, "zfar": 2}}
    scene = load(file, said=["a camera is in Scene.cameras: a picture is seen from it only if"])
    assert scene.cameras == (Camera.orthographic((2, 0, 0), (2, 0, -1), (0, 2, 0), 3, 0, 2),)
    file.json["cameras"][0]["orthographic"]["ymag"] = "1"
    with pytest.raises(ValueError, match="cameras\\[0\\].orthographic.ymag must be a finite number"):
        load(file)


def test_cameras_that_are_left_out(load):
    file = gltf_files.below_a_camera()
    file.json["cameras"][0] = {"type": "orthographic", "orthographic": {"xmag": 1, "ymag": 0, "znear": 1, "zfar": 2}}
    said = "cameras[0] is left out: bigtri.Camera.orthographic: height must be positive"
    assert load(file, said=[said]).cameras == ()
    file.json["cameras"][0] = {"type": "perspective", "perspective": {"yfov": 4, "znear": 0.1}}
    assert load(file, said=["cameras[0] is left out: bigtri.Camera: fov_y must be in (0, 180) degrees, got 229"]).cameras == ()


def test_without_a_farthest_distance_the_scene_has_it(load):
    file = gltf_files.below_a_camera()
    file.json["cameras"][0] = {"type": "perspective", "perspective": {"yfov": 1, "znear": 2}}
    (camera,) = load(file, said=["Scene.cameras"]).cameras
    assert camera.near == 2 and camera.far is None  # all is behind the near plane
    file.json["nodes"][0]["translation"] = [0, 0, -8]  # and its parent makes twice that of it
    (camera,) = load(file, said=["Scene.cameras"]).cameras
    assert camera.near == 2 and camera.far == 16.25


def test_lights_are_carried(load):
    file = quad()
    spot = {"type": "spot", "color": [1, 0.5, 0], "intensity": 7, "range": 3, "spot": {"outerConeAngle": np.pi / 3}}
    lights = [spot, {"type": "directional"}, {"type": "lava"}]
    file.json["extensions"] = {"KHR_lights_punctual": {"lights": lights}}
    for light in range(3):
        # Turned by a half about y: it shines along +z.
        turned = {"rotation": [0, 1, 0, 0], "translation": [0, light, 0]}
        file.node(extensions={"KHR_lights_punctual": {"light": light}}, **turned)
    scene = load(file, said=["is in Scene.lamps, but the picture is lit by others (2 times)", "lights[2] is left out: "])
    assert scene.lamps == (
        Lamp("spot", (0, 0, 0), (0, 0, 1), (1, 0.5, 0), 7, 3, (0, np.degrees(np.pi / 3))),
        Lamp("directional", (0, 1, 0), (0, 0, 1)),
    )


@pytest.mark.parametrize(
    ("mode", "indices"),
    [
        (0, [[0], [1], [2], [3], [4]]),
        (1, [[0, 1], [2, 3]]),
        (2, [[0, 1], [1, 2], [2, 3], [3, 4], [4, 0]]),
        (3, [[0, 1], [1, 2], [2, 3], [3, 4]]),
    ],
)
def test_points_and_lines_are_carried(load, mode, indices):
    """Of six vertices the first is used by nothing."""
    file = quad()
    corners = np.array([(9, 9, 9), (0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 2, 0)], np.float32)
    colors = np.linspace(0, 1, 18, dtype=np.float32).reshape(6, 3)
    strokes = file.primitive({"POSITION": corners, "COLOR_0": colors}, np.arange(1, 6, dtype=np.uint8), mode=mode, material=0)
    file.material(baseColorFactor=[0.5, 1, 1, 1])
    file.node(strokes, translation=[0, 0, 5])
    said = ["has 5 corners, which is no multiple of 2"] if mode == 1 else []
    scene = load(file, said=[f"(primitive mode {mode}) are not drawn", *said])
    (marks,) = scene.marks
    used = slice(1, 5 if mode == 1 else 6)
    assert marks.indices.tolist() == indices and np.array_equal(marks.positions, corners[used] + np.float32((0, 0, 5)))
    assert np.array_equal(marks.colors, colors[used]) and marks.base_color == (0.5, 1, 1)
    assert scene.bounds.tolist() == SQUARE


def test_what_materials_have_is_carried(load):
    file = textured_quad(alphaMode="MASK", alphaCutoff=0.25, baseColorFactor=[1, 1, 1, 0.75], emissiveFactor=[0.5, 1, 0])
    extensions = {"KHR_materials_unlit": {}, "KHR_materials_emissive_strength": {"emissiveStrength": 4}}
    file.json["materials"][0] |= {"extensions": extensions, "emissiveTexture": {"index": 0}}
    said = ["alphaMode MASK", "emits light", "KHR_materials_unlit", "KHR_materials_emissive_strength"]
    (material,) = load(file, said=said).materials
    assert (material.alpha_mode, material.alpha, material.alpha_cutoff) == ("mask", 0.75, 0.25)
    assert material.unlit and material.emissive == (2, 4, 0)
    assert material.emissive_texture is material.texture
    file.json["materials"][0]["emissiveTexture"]["texCoord"] = 1
    (material,) = load(file, said=[*said, "has a texture at other coordinates"]).materials
    assert material.emissive_texture is None


@pytest.mark.parametrize("dtype", ["int8", "uint8", "int16", "uint16", "float32"])
@pytest.mark.parametrize("normalized", [False, True])
def test_components_of_every_type(load, dtype, normalized):
    codes = np.array([(0, 0, 0), (127, 0, 0), (0, 64, 0)], dtype)
    file = File()
    file.node(file.primitive({"POSITION": file.accessor(codes, normalized=normalized)}))
    most = np.iinfo(dtype).max if normalized and dtype != "float32" else 1
    assert np.array_equal(load(file).positions, (codes / np.float64(most)).astype(np.float32))


def test_the_lowest_of_signed_integers_is_minus_one(load):
    file = File()
    codes = np.array([(-128, -127, 0), (127, 0, 0), (0, 127, 0)], np.int8)
    file.node(file.primitive({"POSITION": file.accessor(codes, normalized=True)}))
    assert load(file).bounds.tolist() == [[-1, -1, 0], [1, 1, 0]]


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "uint32"])
def test_indices_of_every_type(load, dtype):
    assert load(quad(indices=np.array([3, 0, 1], dtype))).bounds.tolist() == SQUARE


def test_columns_of_matrices_begin_at_multiples_of_four_bytes(tmp_path):
    file = quad()
    padded = np.arange(24, dtype=np.uint8).reshape(2, 3, 4)
    index = file.add("accessors", bufferView=file.view(padded.tobytes()), componentType=5121, count=2, type="MAT3")
    read = Accessors(Document(file.write(tmp_path / "file.glb"))).floats(index, ("MAT3",))
    assert np.array_equal(read, padded[:, :, :3].reshape(2, 9))


def test_strips_and_fans_keep_their_sides(load):
    file = File()
    corners = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0), (0, 2, 0), (1, 2, 0)], np.float32)
    file.node(file.primitive({"POSITION": corners}, mode=5))
    scene = load(file)
    assert len(scene.triangles) == 4 and (face_normals(scene.positions, scene.triangles) == (0, 0, 1)).all()
    file = File()
    file.node(file.primitive({"POSITION": QUAD}, np.array([1, 2, 3, 0], np.uint8), mode=6))
    scene = load(file)
    assert scene.positions[scene.triangles][..., :2].tolist() == [[[1, 1], [-1, 1], [1, -1]], [[-1, 1], [-1, -1], [1, -1]]]


def test_blended_joints(load):
    """Weights that add up to 200 of 255 are made to add up to 1; normals go with the joints."""
    scene = load(gltf_files.bent_skin())
    assert scene.positions.tolist() == [[-1, -1, 0], [1, -1, 0], [3, 1, 0], [1, 1, 0]]
    assert scene.normals.tolist() == [[0, 0, 1]] * 4


def test_skins_without_inverse_matrices_and_with_many_joints(load):
    """A vertex may have more than four: the second set has the other half of the weight."""
    file = gltf_files.skin_at_rest()
    del file.json["skins"][0]["inverseBindMatrices"]
    file.json["meshes"][0]["primitives"][0]["attributes"] |= {
        "JOINTS_1": file.accessor(np.ones((4, 4), np.uint8)),
        "WEIGHTS_1": file.accessor(np.tile(np.float32((0.5, 0, 0.5, 0)), (4, 1))),
    }
    # Half way between the joints at 6 and at -9.
    assert load(file).bounds.tolist() == [[-2.5, -1, 0], [-0.5, 1, 0]]


def test_skinned_primitives_on_shared_accessors_are_stored_once(load):
    file = gltf_files.skin_at_rest()
    primitives = file.json["meshes"][0]["primitives"]
    primitives[0]["attributes"]["NORMAL"] = file.accessor(np.tile(np.float32((0, 0, 1)), (4, 1)))
    primitives.append(primitives[0])
    scene = load(file)
    assert len(scene.positions) == 4 and len(scene.triangles) == 4


def test_diffuse_colors_of_an_older_extension(load):
    file = textured_quad()
    older = {"diffuseFactor": [0.5, 1, 1, 1], "diffuseTexture": {"index": 0}}
    file.json["materials"] = [{"extensions": {"KHR_materials_pbrSpecularGlossiness": older}}]
    (material,) = load(file, said=["KHR_materials_pbrSpecularGlossiness"]).materials
    assert material.base_color == (0.5, 1, 1) and np.array_equal(material.texture, quarters())


def test_morphed_texture_coordinates(load):
    file = textured_quad()
    primitive = file.json["meshes"][0]["primitives"][0]
    primitive["targets"] = [{"TEXCOORD_0": file.accessor(np.tile(np.float32((0.5, 0)), (4, 1)))}]
    file.json["meshes"][0]["weights"] = [1]
    assert quarter_colors(load(file)) == [GREEN, RED, WHITE, BLUE]


def test_an_emissive_texture_alone(load):
    """Then the mesh has the texture coordinates that this one asks for."""
    file = textured_quad()
    file.json["materials"] = [{"emissiveFactor": [1, 1, 1], "emissiveTexture": {"index": 0, "texCoord": 1}}]
    file.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_1"] = file.accessor(QUAD_UVS[::-1])
    scene = load(file, said=["emits light"])
    (material,) = scene.materials
    assert np.array_equal(material.emissive_texture, quarters()) and material.texture is None
    assert scene.uvs.tolist() == [[0, 1], [1, 1], [1, 0], [0, 0]]


def test_weights_that_add_up_to_nothing(load):
    file = gltf_files.skin_at_rest()
    where = file.json["accessors"][file.json["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"]]
    start = file.json["bufferViews"][where["bufferView"]]["byteOffset"]
    file.data[start : start + 64] = bytes(64)
    assert load(file).bounds.tolist() == [[4, -1, 0], [6, 1, 0]]


def test_instances_are_mirrored_one_by_one(load):
    scene = load(gltf_files.instanced())
    assert (face_normals(scene.positions, scene.triangles) == (0, 0, 1)).all()
    corners = scene.positions[scene.triangles].reshape(3, 2, 3, 3)
    assert corners[1].reshape(-1, 3).min(axis=0).tolist() == [8, -1, 0]
    assert corners[2].reshape(-1, 3).max(axis=0).tolist() == [1, 13, 0]
    assert len(scene.materials) == 1


def test_nodes_are_drawn_in_the_order_of_the_file(load):
    file = File()
    for x in (0, 10, 20):
        file.node(file.primitive({"POSITION": QUAD}, QUAD_INDICES), translation=[x, 0, 0])
    file.json["nodes"][0]["children"] = [2]
    file.json["scenes"][0]["nodes"] = [1, 0]
    centers = load(file).positions.reshape(3, 4, 3).mean(axis=1)
    assert centers[:, 0].tolist() == [10, 0, 20]


def test_without_a_scene_all_roots_are_drawn(load):
    file = quad()
    del file.json["scene"], file.json["scenes"]
    assert load(file).bounds.tolist() == SQUARE


def test_what_is_hidden_is_not_drawn(load):
    file = quad()
    file.node(file.primitive({"POSITION": QUAD}, QUAD_INDICES), translation=[9, 0, 0], children=[])
    file.json["nodes"][1] |= {"extensions": {"KHR_node_visibility": {"visible": False}}, "children": [2]}
    file.add("nodes", mesh=0, translation=[9, 0, 0])
    assert load(file).bounds.tolist() == SQUARE


@pytest.mark.parametrize(
    "make",
    [
        textured_quad,
        lambda: textured_quad((QUAD_UVS * 65535).astype(np.uint16)),
        lambda: textured_quad((QUAD_UVS * 255).astype(np.uint8)),
        lambda: textured_quad(QUAD_UVS + 3),
        lambda: textured_quad(sampler={"magFilter": 9728, "minFilter": 9728}),
        lambda: textured_quad(sampler={"wrapS": 33071, "wrapT": 33071}),
        lambda: textured_quad(QUAD_UVS * 0.5 - 7, reference=transformed(offset=[14, 14], scale=[2, 2])),
    ],
)
def test_textures(load, make):
    assert quarter_colors(load(make())) == [RED, GREEN, BLUE, WHITE]


def transformed(**settings):
    return {"extensions": {"KHR_texture_transform": settings}}


@pytest.mark.parametrize(
    ("settings", "colors"),
    [
        ({"offset": [0.5, 0]}, [GREEN, RED, WHITE, BLUE]),
        ({"offset": [0, 0.5]}, [BLUE, WHITE, RED, GREEN]),
        ({"scale": [-1, 1]}, [GREEN, RED, WHITE, BLUE]),
        # A quarter turn about the upper left corner of the image.
        ({"rotation": np.pi / 2}, [BLUE, RED, WHITE, GREEN]),
        # The order is scale, rotation, offset.
        ({"rotation": np.pi / 2, "scale": [-1, 1], "offset": [0.5, 0]}, [GREEN, WHITE, RED, BLUE]),
    ],
)
def test_texture_transforms(load, settings, colors):
    assert quarter_colors(load(textured_quad(reference=transformed(**settings)))) == colors


def test_texture_coordinates_by_their_number(load):
    """TEXCOORD_1 is upside down; the transform's own number is the one that counts."""
    for reference in ({"texCoord": 1}, {"texCoord": 0, **transformed(texCoord=1)}):
        file = textured_quad(reference=reference)
        file.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_1"] = file.accessor(QUAD_UVS[::-1])
        assert quarter_colors(load(file)) == [BLUE, WHITE, RED, GREEN]


def test_samplers(load):
    scene = load(textured_quad(sampler={"magFilter": 9728, "wrapS": 33071, "wrapT": 33071}))
    assert (scene.materials[0].filter, scene.materials[0].wrap) == ("nearest", "clamp")
    scene = load(textured_quad(sampler={"magFilter": 9729}))
    assert (scene.materials[0].filter, scene.materials[0].wrap) == ("bilinear", "repeat")


def test_a_grey_image_of_16_bits(load):
    grey = np.full((2, 2), 0x7FFF, np.uint16)
    albedo = seen(load(textured_quad(pixels=grey))).albedo[32, 32]
    assert bigtri.encode_srgb(albedo).tolist() == [127, 127, 127]


def test_base_colors_are_not_rounded_to_8_bits(load):
    file = quad(material=0)
    file.material(baseColorFactor=[0.0018, 0.0022, 0.02, 1], metallicFactor=0)
    assert load(file).materials[0].base_color == (0.0018, 0.0022, 0.02)


@pytest.mark.parametrize(
    ("codes", "expected"),
    [
        (np.array([(255, 51, 0)] * 4, np.uint8), np.array([255, 51, 0], np.float32) / np.float32(255)),
        (np.array([(255, 51, 0, 7)] * 4, np.uint8), np.array([255, 51, 0], np.float32) / np.float32(255)),
        (np.array([(65535, 51, 0)] * 4, np.uint16), np.array([65535, 51, 0], np.float32) / np.float32(65535)),
        (np.array([(1, 0.3, 0)] * 4, np.float32), np.array([1, 0.3, 0], np.float32)),
    ],
)
def test_vertex_colors_are_linear(load, codes, expected):
    file = File()
    colors = file.accessor(codes, normalized=codes.dtype.kind == "u")
    file.node(file.primitive({"POSITION": QUAD, "COLOR_0": colors}, QUAD_INDICES))
    scene = load(file)
    assert (scene.colors == expected).all() and scene.materials[0].vertex_colors
    assert scene.materials[0].base_color == (1, 1, 1)


def test_double_sided(load):
    """A solid is lit from outside alone, unless the file says otherwise."""
    corners = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], np.float32)
    indices = np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)], np.uint16).reshape(-1)
    for double_sided in (False, True):
        file = File()
        material = file.material(doubleSided=double_sided)
        file.node(file.primitive({"POSITION": corners}, indices, material=material))
        assert load(file).materials[0].two_sided == double_sided


def test_primitives_on_shared_accessors_are_stored_once(load):
    scene = load(gltf_files.shared_accessors())
    assert len(scene.positions) == 4 * 300 and len(scene.triangles) == 600
    assert len(scene.materials) == 1 and scene.bounds.tolist() == [[-1, -1, 0], [898, 1, 0]]


def test_nodes_on_shared_accessors_take_what_they_use(load):
    scene = load(gltf_files.shared_accessors(nodes=True))
    assert len(scene.positions) == 4 * 300 and len(scene.triangles) == 600
    assert scene.bounds.tolist() == [[-1, -1, 0], [898, 300, 0]]


def test_a_shared_texture_is_one_array(load):
    file = gltf_files.shared_texture()
    # Two materials with the same image as well.
    file.json["materials"].append({**file.json["materials"][0], "doubleSided": True, "name": "other"})
    file.json["meshes"][1]["primitives"] = [{**file.json["meshes"][1]["primitives"][0], "material": 1}]
    scene = load(file)
    assert len(scene.triangles) == 80 and len(scene.materials) == 2
    assert scene.materials[0].texture is scene.materials[1].texture


def image_file(uri, **settings):
    """A square with a texture of an image beside the file."""
    file = textured_quad()
    file.json["images"] = [{"uri": uri, **settings}]
    return file


@pytest.mark.parametrize(
    ("uri", "name"),
    [
        ("q4%20b.png", "q4 b.png"),
        ("q4 b.png", "q4 b.png"),
        ("q4%20b.png", "q4%20b.png"),
        ("../q4.png", "../q4.png"),
        ("sub/q4.png", "sub/q4.png"),
        ("sub\\q4.png", "sub/q4.png"),
        ("./q%C3%A4.png", "qä.png"),
    ],
)
def test_images_beside_the_file(tmp_path, uri, name):
    folder = tmp_path / "model"
    (folder / "sub").mkdir(parents=True)
    (folder / name).write_bytes(encoded(quarters()))
    assert quarter_colors(load_scene(image_file(uri).write(folder / "file.gltf"))) == [RED, GREEN, BLUE, WHITE]


def test_images_and_buffers_within_the_file(load):
    assert quarter_colors(load(image_file(data_uri(encoded(quarters()), "image/png")))) == [RED, GREEN, BLUE, WHITE]
    unpadded = (
        data_uri(encoded(quarters(), "BMP"))
        .rstrip("=")
        .replace("+", "-")
        .replace("/", "_")
        .replace("data:application_", "data:application/")
    )
    assert quarter_colors(load(image_file(unpadded))) == [RED, GREEN, BLUE, WHITE]
    file = quad()
    file.json["buffers"] = [{"byteLength": len(file.data), "uri": "data:," + "".join(f"%{byte:02x}" for byte in file.data)}]
    assert load(file).bounds.tolist() == SQUARE


def test_a_file_uri(tmp_path):
    folder = tmp_path / "a b"
    folder.mkdir()
    (folder / "q4.png").write_bytes(encoded(quarters()))
    uri = (folder / "q4.png").as_uri()
    assert "%20" in uri and quarter_colors(load_scene(image_file(uri).write(tmp_path / "file.gltf"))) == [RED, GREEN, BLUE, WHITE]


def test_a_buffer_beside_the_file(tmp_path):
    file = quad()
    (tmp_path / "a b.bin").write_bytes(bytes(file.data))
    file.json["buffers"] = [{"byteLength": len(file.data), "uri": "a%20b.bin"}]
    assert load_scene(file.write(tmp_path / "file.gltf")).bounds.tolist() == SQUARE


def test_webp_in_place_of_another_image(load):
    file = textured_quad(pixels=quarters()[::-1])
    webp = file.add("images", bufferView=file.view(encoded(quarters(), "WEBP")), mimeType="image/webp")
    file.json["textures"][0]["extensions"] = {"EXT_texture_webp": {"source": webp}}
    assert quarter_colors(load(file)) == [RED, GREEN, BLUE, WHITE]


@pytest.mark.parametrize(
    ("image", "said"),
    [
        ({"uri": "nothere.png"}, "images[0].uri: there is no file 'nothere.png' beside it"),
        (
            {"uri": "http://localhost/a.png"},
            "images[0].uri: a uri must be a data URI or the path of a file, got 'http://localhost/a.png'",
        ),
        ({"uri": data_uri(b"GIF89a")}, "images[0]: the image"),
        ({"bufferView": 1}, "images[0]: the image must be of a format that Pillow reads"),
    ],
)
def test_images_that_cannot_be_read(load, image, said):
    file = textured_quad()
    file.json["images"] = [image]
    scene = load(file, said=["an image cannot be read, and its surface is drawn without it: " + said])
    assert quarter_colors(scene) == [WHITE] * 4


class FakeDraco(types.ModuleType):
    """DracoPy as far as it is asked: the square of ``compressed_by_draco``."""

    @staticmethod
    def decode(data):
        assert data == b"DRACO of a square"
        colors = np.tile(np.array((255, 0, 51, 255), np.uint8), (4, 1))
        attributes = [{"unique_id": 9, "data": colors}, {"unique_id": 7, "data": QUAD}]
        return types.SimpleNamespace(faces=QUAD_INDICES.reshape(2, 3), attributes=attributes)


def test_draco(load, monkeypatch):
    monkeypatch.setitem(sys.modules, "DracoPy", FakeDraco("DracoPy"))
    scene = load(gltf_files.compressed_by_draco())
    assert scene.bounds.tolist() == SQUARE
    assert (scene.colors == np.array([1, 0, np.float32(51) / np.float32(255)], np.float32)).all()


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"POSITION": 3}, "attributes.POSITION must be an attribute of the compressed mesh, got 3"),
        ({"POSITION": 9}, "attributes.POSITION must be VEC3, got 4 components"),
    ],
)
def test_draco_with_other_attributes(tmp_path, monkeypatch, changes, text):
    monkeypatch.setitem(sys.modules, "DracoPy", FakeDraco("DracoPy"))
    file = gltf_files.compressed_by_draco()
    primitive = file.json["meshes"][0]["primitives"][0]
    primitive["extensions"]["KHR_draco_mesh_compression"]["attributes"] |= changes
    assert text in error_of(file, tmp_path)


def test_draco_that_is_broken(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "DracoPy", types.SimpleNamespace(decode=lambda data: None))
    text = "extensions.KHR_draco_mesh_compression cannot be decoded by DracoPy: 'NoneType' object has no attribute 'faces'"
    assert error_of(gltf_files.compressed_by_draco(), tmp_path).endswith(text)


def test_draco_without_its_package(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    text = error_of(gltf_files.compressed_by_draco(), tmp_path)
    assert "compressed by KHR_draco_mesh_compression" in text and "pip install bigtri[draco]" in text


def test_draco_that_may_be_left_out(load, monkeypatch):
    """The accessors have the same data without it."""
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    extension = {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}}
    assert load(quad(extensions=extension)).bounds.tolist() == SQUARE


def change(path, value):
    """A change of the JSON of a square: ``path`` is of keys and indices, separated by dots."""

    def changed(file):
        *parents, last = [int(key) if key.isdecimal() else key for key in path.split(".")]
        place = file.json
        for key in parents:
            place = place[key]
        if isinstance(place, list):
            place[last : last + 1] = [value]
        else:
            place[last] = value
        return file

    return changed


def with_material(**settings):
    def changed(file):
        file.json["meshes"][0]["primitives"][0]["material"] = file.material(**settings)
        return file

    return changed


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (with_material(alphaMode="BLEND"), "is transparent (alphaMode BLEND): it is drawn opaque"),
        (with_material(alphaMode="MASK", alphaCutoff=0.2), "(alphaMode MASK)"),
        (with_material(emissiveFactor=[0, 1, 0]), "emits light"),
        (with_material(normalTexture={"index": 0}), "normal map"),
        (with_material(occlusionTexture={"index": 0}), "ambient occlusion"),
        (with_material(metallicRoughnessTexture={"index": 0}), "metalness and roughness"),
        (with_material(metallicFactor=0.5), "is metallic"),
        (with_material(extensions={"KHR_materials_unlit": {}}), "without lights (KHR_materials_unlit)"),
        (with_material(extensions={"KHR_materials_clearcoat": {}}), "a material has KHR_materials_clearcoat"),
        (with_material(extensions={"KHR_materials_pbrSpecularGlossiness": {}}), "its diffuse colour is drawn, its reflections"),
        (change("meshes.1", {"primitives": []}), "meshes[1] is placed by no node: it is not drawn"),
        (change("animations", [{}]), "an animation is not played"),
        (change("extensionsUsed", ["VENDOR_fur"]), "the extension VENDOR_fur is not read"),
        (change("extensions", {"KHR_materials_variants": {"variants": []}}), "other materials to choose from"),
        (change("scenes", [{"nodes": [0]}, {"nodes": [0]}]), "of 2 scenes only scenes[0] is drawn"),
        (change("accessors.1.count", 5), "has 5 corners, which is no multiple of 3: the last 2 are not drawn"),
    ],
)
def test_what_is_not_drawn_is_said(load, tmp_path, make, said):
    file = make(quad())
    load(file, said=[said])
    with pytest.raises(ValueError, match="bigtri.load_scene: .*file.glb has what is not drawn, which strict forbids: ") as raised:
        load(file, strict=True)
    assert said in str(raised.value)


@pytest.mark.parametrize(
    ("sampler", "said"),
    [
        ({"wrapS": 33648}, "mirrored"),
        ({"wrapS": 33071}, "clamped along the other"),
        ({"minFilter": 9987}, "mipmaps"),
        ({"magFilter": 9728, "minFilter": 9729}, "reduced by another filter"),
    ],
)
def test_samplers_that_are_not_followed_are_said(load, sampler, said):
    load(textured_quad(sampler=sampler), said=[said])


@pytest.mark.parametrize("mode", range(4))
def test_points_and_lines_are_said(load, tmp_path, mode):
    file = quad()
    assert error_of(quad(mode=mode), tmp_path).startswith(
        "there are no triangles in it: point clouds and lines are not drawn; found: "
    )
    for x in (2, 4):
        file.node(file.primitive({"POSITION": QUAD}, QUAD_INDICES, mode=mode), translation=[x, 0, 0])
    assert load(file, said=[f"(primitive mode {mode}) are not drawn (2 times)"]).bounds.tolist() == SQUARE


def test_a_texture_without_coordinates_is_said(load):
    file = textured_quad(reference={"texCoord": 3})
    assert quarter_colors(load(file, said=["has a texture, but a mesh of it has no coordinates for it"])) == [WHITE] * 4


@pytest.mark.parametrize(
    "node", [{"scale": [1e300, 1e300, 1]}, {"translation": [1e308, 0, 0], "scale": [1e-3] * 3}, {"translation": [1.7e308, 0, 0]}]
)
def test_positions_beyond_float32_are_said(load, node):
    load(quad(node=node), said=["positions are not finite, or beyond float32"])


def test_strict_is_true_or_false():
    with pytest.raises(TypeError, match="bigtri.load_scene: strict must be True or False, got 'yes'"):
        load_scene("x.glb", strict="yes")


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda file: gltf_files.required_extension("VENDOR_geometry"), "the file requires VENDOR_geometry, which is not read"),
        (lambda file: gltf_files.compressed_by_meshopt(), "the file requires EXT_meshopt_compression, which is not read"),
        (
            lambda file: gltf_files.compressed_by_meshopt(required=False),
            "bufferViews[0] has its data in EXT_meshopt_compression alone, which is not read",
        ),
        (change("asset", {"version": "1.0"}), "asset.version must be 2.0, got '1.0'"),
        (change("asset", {"version": "2.1", "minVersion": "2.1"}), "asset.minVersion must be 2.0, got '2.1'"),
        (change("meshes", {}), "meshes must be a list of objects, got {}"),
        (change("meshes.0", []), "meshes[0] must be an object, got []"),
        (change("scene", 1), "scene must be an index into the 1 scenes, got 1"),
        (change("scenes.0.nodes", [-1]), "scenes[0].nodes must be an index into the 1 nodes, got -1"),
        (change("nodes.0.children", [0]), "nodes[0] must not be below itself"),
        (change("nodes.0.matrix", [1, 2]), "nodes[0].matrix must be 16 finite numbers, got [1, 2]"),
        (change("nodes.0.scale", [1, 2, "x"]), 'nodes[0].scale must be 3 finite numbers, got [1, 2, "x"]'),
        (change("nodes.0.mesh", True), "nodes[0].mesh must be an index into the 1 meshes, got true"),
        (change("nodes.0.weights", [1]), "meshes[0].primitives[0].targets must be as many as the 1 weights, got 0"),
        (change("accessors.0.componentType", 5124), "accessors[0].componentType must be one of 5120, 5121, 5122"),
        (change("accessors.0.type", "VEC2"), "accessors[0].type must be VEC3 here, got 'VEC2'"),
        (change("accessors.0.count", -4), "accessors[0].count must be a whole number of at least 0, got -4"),
        (change("accessors.0.count", 5), "accessors[0] must lie within the 48 bytes of bufferViews[0], got bytes 0 to 60"),
        (change("accessors.0.byteOffset", 8), "accessors[0] must lie within the 48 bytes of bufferViews[0], got bytes 8 to 56"),
        (
            change("accessors.0", {"componentType": 5126, "type": "VEC3", "count": 2**31 - 1}),
            "accessors[0].count must be at most",
        ),
        (change("accessors.1.componentType", 5126), "accessors[1].componentType must be one of 5121, 5123, 5125 here, got 5126"),
        (
            change("accessors.1.bufferView", 0),
            "meshes[0].primitives[0].indices must index the 4 vertices, got indices from 0 to 49",
        ),
        (change("bufferViews.0.byteStride", 4), "bufferViews[0].byteStride must be at least 12 for accessors[0], got 4"),
        (
            change("bufferViews.0.byteLength", 999),
            "bufferViews[0] must lie within the 60 bytes of buffers[0], got bytes 0 to 999",
        ),
        (change("bufferViews.0.buffer", 1), "bufferViews[0].buffer must be an index into the 1 buffers, got 1"),
        (change("buffers", [{"byteLength": 99}]), "buffers[0] is truncated: byteLength announces 99 bytes, got 60"),
        (change("buffers", [{"byteLength": 9, "uri": "no.bin"}]), "buffers[0].uri: there is no file 'no.bin' beside it"),
        (change("buffers", [{"byteLength": 9, "uri": "data:x"}]), "buffers[0].uri: a data URI must have a comma before its data"),
        (change("buffers", [{"byteLength": 9, "uri": "data:;base64,%"}]), "buffers[0].uri: a data URI is not base64: "),
        (change("nodes.0.camera", 0), "nodes[0].camera must be an index into the 0 cameras, got 0"),
        (
            change("nodes.0.extensions", {"KHR_lights_punctual": {}}),
            "KHR_lights_punctual.light must be an index into the 0 lights",
        ),
        (
            change("nodes.0.extensions", {"EXT_mesh_gpu_instancing": {"attributes": {"SCALE": 1}}}),
            "must be VEC3 here, got 'SCALAR'",
        ),
        (change("nodes.0.weights", ["x"]), 'nodes[0].weights must be a list of finite numbers, got ["x"]'),
        (change("nodes.0.weights", [10**400]), "nodes[0].weights must be a list of finite numbers"),
        (change("nodes.0.children", 1), "nodes[0].children must be a list of indices, got 1"),
        (change("extensionsRequired", "x"), 'extensionsRequired must be a list of texts, got "x"'),
        (with_material(alphaMode="GLASS"), "materials[0].alphaMode must be OPAQUE, MASK or BLEND, got 'GLASS'"),
        (with_material(baseColorTexture={"index": 3}), "baseColorTexture.index must be an index into the 0 textures, got 3"),
        (with_material(doubleSided="yes"), 'materials[0].doubleSided must be true or false, got "yes"'),
    ],
)
def test_errors(tmp_path, make, text):
    assert text in error_of(make(quad()), tmp_path)


def test_instances_of_other_numbers(tmp_path):
    file = gltf_files.instanced()
    attributes = file.json["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]
    attributes["SCALE"] = attributes["TRANSLATION"] = 0
    assert error_of(file, tmp_path).endswith("attributes must have as many of each, got 3, 4")


def test_instances_of_nothing(load):
    file = quad(node={"extensions": {"EXT_mesh_gpu_instancing": {}}})
    assert load(file).bounds.tolist() == SQUARE


def test_sparse_indices_beyond_the_elements(tmp_path):
    file = gltf_files.partly_sparse_accessor()
    file.json["accessors"][0]["sparse"]["indices"]["byteOffset"] = 0
    file.data[-4:] = (4).to_bytes(4, "little")
    assert error_of(file, tmp_path) == "accessors[0].sparse.indices must index the 4 elements, got 4"


def test_a_buffer_without_data(tmp_path):
    file = quad()
    file.json["buffers"] = [{"byteLength": 60}]
    assert error_of(file, tmp_path, ".gltf").startswith("buffers[0] must have a uri or be the first one of a GLB")


def test_targets_of_another_length(tmp_path):
    file = gltf_files.morphed()
    file.json["meshes"][0]["primitives"][0]["targets"][0]["POSITION"] = file.accessor(QUAD[:3])
    assert error_of(file, tmp_path).endswith("targets[0].POSITION must have 4 elements, got 3")


def test_skins_that_do_not_fit(tmp_path):
    file = gltf_files.skin_at_rest()
    file.json["accessors"][file.json["skins"][0]["inverseBindMatrices"]]["count"] = 1
    assert error_of(file, tmp_path) == "skins[0].inverseBindMatrices must have one for each of 2 joints, got 1"
    file = gltf_files.skin_at_rest()
    file.json["meshes"][0]["primitives"][0]["attributes"]["JOINTS_0"] = file.accessor(np.zeros((3, 4), np.uint8))
    assert "JOINTS_0 must have as many elements as POSITION, 4, got 3" in error_of(file, tmp_path)
    file = gltf_files.skin_at_rest()
    file.json["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"] = file.accessor(np.zeros((3, 4), np.float32))
    assert error_of(file, tmp_path).endswith("must have as many joints as weights, got [4, 4] and [3, 4]")


def test_primitives_without_positions_are_said(load):
    file = quad()
    file.node({"attributes": {}}, file.primitive({"POSITION": QUAD[:2]}))
    said = ["meshes[1].primitives[0] has no POSITION: it is not drawn", "the last 2 are not drawn"]
    assert load(file, said=said).bounds.tolist() == SQUARE


def test_whole_numbers_may_be_written_as_floats(load):
    file = quad()
    file.json["accessors"][0]["count"] = 4.0
    assert load(file).bounds.tolist() == SQUARE


def test_a_node_has_one_parent(tmp_path):
    file = quad()
    file.node(children=[0])
    file.node(children=[0])
    assert error_of(file, tmp_path) == "nodes[0] must have one parent, got nodes[1] and nodes[2]"


def test_attributes_of_other_lengths(tmp_path):
    file = quad({"NORMAL": QUAD[:3]})
    assert error_of(file, tmp_path).endswith("attributes: NORMAL must have as many elements as POSITION, 4, got 3")


def test_joints_beyond_the_skin(tmp_path):
    file = gltf_files.skin_at_rest()
    file.json["skins"][0]["joints"] = [1]
    file.json["meshes"][0]["primitives"][0]["attributes"]["JOINTS_0"] = file.accessor(np.ones((4, 4), np.uint8))
    assert "JOINTS_0 must index the 1 joints, got 1" in error_of(file, tmp_path)


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (b"", "the file must begin with \"glTF\", as a GLB does, or with a JSON object, got b''"),
        (b"glTF\2\0\0\0", "the header of the GLB must have 12 bytes, got 8"),
        (quad().glb()[:-9], "the GLB is truncated: its header announces"),
        (b"glTF" + bytes([1, 0, 0, 0, 20, 0, 0, 0]) + bytes(20), "the GLB must be of version 2, got 1"),
        (b"glTF" + bytes([2, 0, 0, 0, 12, 0, 0, 0]), "the first chunk of the GLB must be JSON, got none"),
        (b"glTF" + bytes([2, 0, 0, 0, 20, 0, 0, 0, 9, 0, 0, 0, 1, 0, 0, 0]) + bytes(9), "chunk 0 of the GLB is truncated"),
        (quad().gltf()[:61], "the JSON is broken or truncated at line 1, column 40: "),
        (b'{"a": \xff}', "the JSON must be UTF-8, got the byte 0xff at 6"),
        (b'{"a": NaN}', "the JSON must have finite numbers alone, got NaN"),
        (b'{"a": ' + b"[" * 100000, "the JSON is nested too deeply"),
        (b'{"a": ' + b"1" * 5000 + b"}", "the JSON is broken: "),
    ],
)
def test_broken_files(tmp_path, data, text):
    (tmp_path / "file.glb").write_bytes(data)
    with pytest.raises(ValueError, match="^bigtri.load_scene: .*file.glb: ") as raised:
        load_scene(tmp_path / "file.glb")
    assert text in str(raised.value)


def test_a_glb_is_told_by_its_bytes(tmp_path):
    (tmp_path / "json.glb").write_bytes(b"\xef\xbb\xbf\n" + quad().gltf())
    (tmp_path / "binary.gltf").write_bytes(quad().glb() + b"more than the header announces")
    for name in ("json.glb", "binary.gltf"):
        assert load_scene(tmp_path / name).bounds.tolist() == SQUARE


def test_textures_stay_as_codes(load):
    texture = load(textured_quad(pixels=quarters(4) // 2)).materials[0].texture
    assert texture.dtype == np.uint8 and np.array_equal(texture, quarters(4) // 2)


def test_far_from_the_origin(load):
    """Two squares at map coordinates keep their form: the nodes' places are added up in float64."""
    file = quad(node={"translation": [400_000.25, 4_080_000.75, 120.5]})
    file.node(file.primitive({"POSITION": QUAD}, QUAD_INDICES), translation=[400_002.25, 4_080_000.75, 120.5])
    scene = load(file)
    assert scene.bounds.tolist() == [[399_999.25, 4_079_999.75, 120.5], [400_003.25, 4_080_001.75, 120.5]]
    assert np.abs(scene.positions).max() < 8
    moved = scene.positions + np.array(scene.origin) - (400_000.25, 4_080_000.75, 120.5)
    assert sorted(map(tuple, moved.tolist())) == sorted(map(tuple, [*QUAD.tolist(), *(QUAD + (2, 0, 0)).tolist()]))


def test_an_image_of_another_size_of_alpha(load):
    """Alpha of an image does not darken its colours."""
    file = textured_quad()
    pixels = np.dstack([quarters(), np.zeros((8, 8), np.uint8)])
    file.json["images"] = [{"bufferView": file.view(encoded(pixels))}]
    assert Image.fromarray(pixels).mode == "RGBA"
    assert quarter_colors(load(file)) == [RED, GREEN, BLUE, WHITE]


def test_a_node_that_flattens_keeps_the_normal_of_its_plane(load):
    up = np.tile(np.float32((0, 0, 1)), (4, 1))
    assert load(quad({"NORMAL": up}, node={"scale": [2, 2, 0]})).normals.tolist() == up.tolist()


@pytest.mark.parametrize("lost", [(0, 0, 0), (np.nan, 0, 1), (np.inf, 0, 1)])
def test_normals_without_a_direction_are_those_of_the_surface(load, lost):
    normals = np.tile(np.float32((0, 0.6, 0.8)), (4, 1))
    normals[2] = lost
    scene = load(quad({"NORMAL": normals}), said=["1 normals have no direction"])
    assert scene.normals[2].tolist() == [0, 0, 1] and (scene.normals[[0, 1, 3]] == normals[0]).all()
    # A vertex of nothing that is drawn needs none.
    load(quad({"NORMAL": normals}, indices=np.array([0, 1, 3, 2, 2, 2], np.uint8)))


def test_a_mirrored_skin_shows_its_front(load):
    file = gltf_files.skin_at_rest()
    file.json["nodes"][1] |= {"translation": [0, 0, 0], "scale": [-1, 1, 1]}
    scene = load(file)
    assert scene.bounds.tolist() == [[0, -1, 0], [2, 1, 0]]
    assert (face_normals(scene.positions, scene.triangles) == (0, 0, 1)).all()


def test_nothing_instanced_is_nothing_drawn(tmp_path):
    file = quad()
    nowhere = file.accessor(np.zeros((0, 3), np.float32), bufferView=0)
    file.json["nodes"][0]["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": nowhere}}}
    assert error_of(file, tmp_path).startswith("there are no triangles in it")


def test_colors_in_integers_are_normalized_anyway(load):
    file = File()
    colors = file.accessor(np.tile(np.array((255, 51, 0, 255), np.uint8), (4, 1)))
    file.node(file.primitive({"POSITION": QUAD, "COLOR_0": colors}, QUAD_INDICES))
    assert load(file, said=["integers that are not normalized"]).colors.tolist() == [[1, np.float32(0.2), 0]] * 4


def test_colors_beyond_0_to_1_are_the_nearest_that_is(load):
    file = quad({"COLOR_0": np.tile(np.float32((2, -1, np.nan)), (4, 1))})
    assert load(file, said=["colours that are not from 0 to 1"]).colors.tolist() == [[1, 0, 0]] * 4
    file = quad()
    file.json["meshes"][0]["primitives"][0]["material"] = file.material(baseColorFactor=[1e300, -1, 0.25, 3])
    (material,) = load(file, said=["colours that are not from 0 to 1"]).materials
    assert material.base_color == (1, 0, 0.25) and material.alpha == 1


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_texture_coordinates_beyond_float32_are_said(load, value):
    load(textured_quad(uvs=np.full((4, 2), value, np.float32)), said=["texture coordinates are not finite"])


@pytest.mark.parametrize("name", ["KHR_texture_basisu", "EXT_texture_avif", "MSFT_texture_dds"])
def test_images_in_other_formats_beside_one_that_is_read(load, tmp_path, name):
    file = textured_quad()
    file.json["extensionsUsed"] = [name]
    file.json["textures"][0]["extensions"] = {name: {"source": file.add("images", uri="nothere.ktx2")}}
    assert quarter_colors(load(file)) == [RED, GREEN, BLUE, WHITE]
    file.json["extensionsRequired"] = [name]
    assert error_of(file, tmp_path).startswith(f"the file requires {name}")


def test_instances_without_data(tmp_path):
    file = quad()
    zeros = file.add("accessors", componentType=5126, count=2**24, type="VEC3")
    file.json["nodes"][0]["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": zeros}}}
    text = "EXT_mesh_gpu_instancing.attributes.TRANSLATION must have a bufferView or sparse values, got accessors[2] of neither"
    assert error_of(file, tmp_path).endswith(text)

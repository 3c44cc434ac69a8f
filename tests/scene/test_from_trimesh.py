"""Scenes of what trimesh created: materials, colours and normals in bigtri's conventions."""

import numpy as np
import pytest
import trimesh
from gltf_files import QUAD, quarters
from PIL import Image
from trimesh.visual.material import PBRMaterial, SimpleMaterial

from bigtri.reference.shading import decode_table
from bigtri.scene import from_trimesh

TRIANGLES = [(0, 1, 2), (0, 2, 3)]
CODES = np.array([(255, 0, 51, 255), (0, 102, 0, 255), (7, 8, 9, 255), (255, 255, 255, 255)], np.uint8)


def quad(**settings):
    return trimesh.Trimesh(QUAD, TRIANGLES, process=False, **settings)


@pytest.mark.parametrize(
    ("material", "base", "two_sided_by_itself"),
    [
        (PBRMaterial(baseColorFactor=(255, 51, 0, 255), doubleSided=True), (1, np.float32(51) / np.float32(255), 0), True),
        (PBRMaterial(), (1, 1, 1), False),
        (SimpleMaterial(diffuse=(255, 51, 0, 255)), tuple(decode_table()[[255, 51, 0]].tolist()), False),
    ],
)
def test_materials(material, base, two_sided_by_itself):
    """glTF's factors are linear, others sRGB."""
    box = trimesh.creation.box()
    box.visual = trimesh.visual.TextureVisuals(uv=np.zeros((8, 2)), material=material)
    (made,) = from_trimesh(box).materials
    assert made.base_color == base and made.two_sided == two_sided_by_itself and made.texture is None


@pytest.mark.parametrize("kind", [PBRMaterial, SimpleMaterial])
def test_textures(kind):
    image = Image.fromarray(quarters())
    material = kind(baseColorTexture=image) if kind is PBRMaterial else kind(image=image)
    uvs = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], float)
    scene = from_trimesh(quad(visual=trimesh.visual.TextureVisuals(uv=uvs, material=material)))
    assert np.array_equal(scene.materials[0].texture, quarters()) and scene.uvs.tolist() == uvs.tolist()


@pytest.mark.parametrize("linear", [False, True])
def test_vertex_colors(linear):
    scene = from_trimesh(quad(vertex_colors=CODES), linear_colors=linear)
    expected = CODES[:, :3].astype(np.float32) / np.float32(255) if linear else decode_table()[CODES[:, :3]]
    assert np.array_equal(scene.colors, expected) and scene.materials[0].vertex_colors
    assert scene.materials[0].base_color == (1, 1, 1)


def test_face_colors():
    scene = from_trimesh(quad(face_colors=CODES[:2]))
    assert len(scene.positions) == 6  # they share no vertex
    assert np.array_equal(scene.colors[scene.triangles], np.repeat(decode_table()[CODES[:2, None, :3]], 3, axis=1))


@pytest.mark.parametrize(("dtype", "most"), [(np.float64, 1), (np.uint16, 65535)])
def test_colors_of_other_types(dtype, most):
    """As attributes of vertices they come as they are, here white and black."""
    mesh = quad(visual=trimesh.visual.TextureVisuals())
    mesh.visual.vertex_attributes["color"] = np.array([(most,) * 4, (0, 0, 0, most)] * 2, dtype)
    assert from_trimesh(mesh).colors.tolist() == [[1, 1, 1], [0, 0, 0]] * 2


def test_normals_of_the_mesh_are_kept():
    normals = np.array([(0.6, 0, 0.8)] * 4)
    scene = from_trimesh(quad(vertex_normals=normals))
    assert np.array_equal(scene.normals, normals.astype(np.float32)) and np.array_equal(scene.positions, QUAD)


def test_indices_beyond_the_vertices():
    mesh = trimesh.Trimesh(QUAD, [(0, 1, 4)], process=False, validate=False)
    with pytest.raises(ValueError, match="from_trimesh: mesh: faces must index the 4 vertices, got indices from 0 to 4"):
        from_trimesh(mesh)


def test_points_are_no_triangles():
    with pytest.raises(ValueError, match="from_trimesh: there are no triangles in it"):
        from_trimesh(trimesh.Scene(trimesh.PointCloud(QUAD)))

"""Damaged OBJ, MTL, PLY, STL and OFF files: a model or one line that says what is wrong, nothing else, and soon."""

import random
import warnings

import numpy as np
import pytest
import trimesh
from formats import read, write
from gltf_files import encoded, quarters
from test_ply import FORMATS, INDICES, XYZ, ply
from test_stl_off import ASCII_STL, binary_stl

from bigtri.scene.readers.assemble import assemble
from bigtri.scene.readers.model import ModelError

OBJ = """mtllib file.mtl nothere.mtl
v -1 -1 0 1 0 0
v 1 -1 0
v 1 1 0 1 0.5 0 1
v -1 1 0 0.5
vt 0 0
vt 1 0 1
vt 1
vn 0 0 1
usemtl m
f 1/1/1 2/2/-1 3/3/1 4//1
f -4 -2 \\
-1
usemtl b
l 1 2
f 1/1 3/2 2
s 1
f 1//1 2//1 3//1
"""
MTL = """newmtl m
Kd 1 0.5 0
d 0.5
map_Kd -s 2 2 -o 0.5 0.5 -clamp on -mm 0 1 q4.png
newmtl b
Kd 1
map_Bump -bm 1 nothere.png
Ke 1 1 1
"""
SQUARE = ((-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0))
OFF = "STCNOFF\n4 2 0\n" + "".join(f"{x} {y} {z} 0 0 1 255 0 0 255 0 1\n" for x, y, z in SQUARE) + "4 0 1 2 3 1 0 0\n3 0 1 2\n"


def everything_of_ply(form):
    vertex = (*XYZ, "double nx", "float ny", "float nz", "ushort red", "ushort green", "ushort blue", "uchar alpha")
    vertices = [(*corner, 0, 0, 1, 65535, 0, 9, 200) for corner in SQUARE]
    face = (*INDICES, "list uchar float texcoord", "short texnumber")
    faces = [([0, 1, 2, 3], (0, 0, 1, 0, 1, 1, 0, 1), 1), ([0, 1, 2], (0, 0, 1, 0, 1, 1), 0)]
    strips = ("tristrips", INDICES, [([0, 1, 2, -1, 3, 2, 1],)])
    comments = ("comment TextureFile q4.png", "comment TextureFile nothere.png")
    return ply(
        form,
        ("vertex", vertex, vertices),
        ("face", face, faces),
        strips,
        ("edge", ("int a", "int b"), [(0, 1)]),
        comments=comments,
    )


FILES = {
    "obj": OBJ.encode(),
    "mtl": MTL.encode(),
    **{form: everything_of_ply(form) for form in FORMATS},
    "binary stl": binary_stl((0x8000, 31), b"COLOR=\0\xff\0\xff"),
    "ascii stl": ASCII_STL.encode(),
    "off": OFF.encode(),
}


def check(folder, kind, data):
    """Reads a file of this kind; whether there is a model. MTL files are those of an OBJ file that is well."""
    if kind == "mtl":
        write(folder, "file.mtl", data)
        path = write(folder, "file.obj", OBJ)
    else:
        path = write(folder, "file." + {"obj": "obj", "off": "off"}.get(kind, "stl" if kind.endswith("stl") else "ply"), data)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            model = read(path)
            assemble(model)
        except ModelError as error:
            assert "\n" not in str(error) and str(error)
            return False
    for mesh in model.meshes:
        assert mesh.triangles.dtype == np.int32 and mesh.triangles.shape[1:] == (3,)
    return True


@pytest.fixture
def folder(tmp_path):
    write(tmp_path, "q4.png", encoded(quarters()))
    write(tmp_path, "file.mtl", MTL)
    return tmp_path


@pytest.mark.parametrize("kind", FILES)
def test_the_undamaged_files_are_read(folder, kind):
    assert check(folder, kind, FILES[kind])


@pytest.mark.parametrize("kind", FILES)
def test_truncated(folder, kind):
    data = FILES[kind]
    for end in range(0, len(data), max(len(data) // 80, 1)):
        check(folder, kind, data[:end])


@pytest.mark.parametrize("kind", FILES)
@pytest.mark.parametrize("seed", range(2))
def test_bytes_replaced(folder, kind, seed):
    chance, data = random.Random(seed), FILES[kind]
    for _ in range(80):
        damaged = bytearray(data)
        for _ in range(chance.choice((1, 1, 4, 16))):
            damaged[chance.randrange(len(damaged))] = chance.randrange(256)
        check(folder, kind, bytes(damaged))


WORDS = (
    b"-1",
    b"0",
    b"7",
    b"3",
    b"nan",
    b"inf",
    b"1e300",
    b"-1e300",
    b"99999999999999999999",
    b"4294967295",
    b"x",
    b"#",
    b"\\",
    b"\0",
    b"",
)


@pytest.mark.parametrize("kind", [kind for kind in FILES if not kind.startswith("binary")])
def test_words_replaced(folder, kind):
    chance, data = random.Random(0), FILES[kind]
    for _ in range(120):
        words = data.replace(b"\n", b" \n ").split(b" ")
        for _ in range(chance.choice((1, 1, 2, 4))):
            words[chance.randrange(len(words))] = chance.choice(WORDS)
        check(folder, kind, b" ".join(words))


@pytest.mark.parametrize("kind", FILES)
def test_noise(folder, kind):
    chance = random.Random(0)
    for size in range(60):
        check(folder, kind, chance.randbytes(size))
        check(folder, kind, FILES[kind][:20] + chance.randbytes(size))


def test_what_trimesh_writes_is_read_as_by_trimesh(tmp_path):
    """Positions and triangles, in their order."""
    for seed, name in enumerate(("file.obj", "file.ply", "file.stl", "file.off")):
        body = trimesh.creation.icosphere(2)
        body.apply_transform(trimesh.transformations.random_rotation_matrix(np.random.default_rng(seed).random(3)))
        body.export(tmp_path / name)
        theirs = trimesh.load(tmp_path / name, process=False)
        (ours,) = read(tmp_path / name).meshes
        assert np.array_equal(ours.positions, theirs.vertices) and np.array_equal(ours.triangles, theirs.faces)

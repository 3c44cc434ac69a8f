"""The STL and OFF readers, file by file."""

import struct

import numpy as np
import pytest
from formats import SQUARE, SQUARE_PIXELS, middle_color, pixels, read, scene_of, write

from bigtri.reference.shading import decode_table
from bigtri.scene.readers.model import ModelError

CORNERS = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], np.float32)
TRIANGLES = CORNERS[[[0, 1, 2], [0, 2, 3]]]
RED, GREEN, BLUE, GREY = [1, 0, 0], [0, 1, 0], [0, 0, 1], [np.float32(0.6)] * 3


def binary_stl(attributes=(0, 0), header=b"made by hand", announced=2):
    records = [
        np.float32((0, 0, 1)).tobytes() + t.tobytes() + struct.pack("<H", a) for t, a in zip(TRIANGLES, attributes, strict=True)
    ]
    return header.ljust(80, b"\0") + struct.pack("<I", announced) + b"".join(records)


def facet(triangle):
    vertices = "".join(f"vertex {x} {y} {z}\n" for x, y, z in triangle.tolist())
    return f"facet normal 0 0 1\nouter loop\n{vertices}endloop\nendfacet\n"


ASCII_STL = "solid x\n" + facet(TRIANGLES[0]) + facet(TRIANGLES[1])


@pytest.fixture
def scene(tmp_path):
    def written(name, content, *findings):
        return scene_of(write(tmp_path, name, content), *findings)

    return written


@pytest.mark.parametrize(
    "content",
    [
        binary_stl(),
        binary_stl() + b"\0\0",
        binary_stl(header=b"solid not text"),
        binary_stl(header=b"solid not text either") + b"more",
        ASCII_STL + "endsolid x\n",
        ASCII_STL,
        ASCII_STL.upper().replace("\n", "\r\n"),
        ASCII_STL.replace("\n", "\r"),
        ASCII_STL.replace("solid x", "solid").replace(" ", "\t  "),
        ASCII_STL.replace("solid x", "solid b\u00e4r").encode("latin-1"),
        ASCII_STL.partition("\n")[2],  # without the first line
        ASCII_STL.replace("normal 0 0 1", "normal -nan(ind) 0 0") + "endsolid vertex 1 2 3\n",
        ASCII_STL + "endsolid x\n\0\0",
        ASCII_STL.replace("solid x", "solid solid x") + "endsolid solid x\n",
        ASCII_STL.replace("\n", " ") + "endsolid x",  # all on one line
        "\ufeff" + ASCII_STL.replace("1.0", "1e0").replace("-1e0", "-1.0E+00"),
    ],
)
def test_stl(scene, content):
    made = scene("file.stl", content)
    assert len(made.triangles) == 2 and pixels(made) == SQUARE_PIXELS
    assert middle_color(made) == GREY and made.normals.tolist() == [[0, 0, 1]] * len(made.normals)


def test_solids_are_meshes(tmp_path):
    text = "solid one\n" + facet(TRIANGLES[0]) + "endsolid one\nsolid\n" + facet(TRIANGLES[1]) + "endsolid\n"
    model = read(write(tmp_path, "file.stl", text))
    assert [mesh.name for mesh in model.meshes] == ["one", "file.stl"]
    assert [mesh.positions.tolist() for mesh in model.meshes] == TRIANGLES.tolist()


def test_the_names_of_solids_mean_nothing(tmp_path):
    text = "solid solid facet normal\n" + facet(TRIANGLES[0]) + "endsolid solid facet normal\n"
    assert len(read(write(tmp_path, "file.stl", text)).meshes) == 1


def test_colors_of_stl(scene):
    # 15 bits; the highest one says that there is a colour. Blue is lowest.
    made = scene("file.stl", binary_stl((0x8000 | 31 << 10, 0x8000 | 31)))
    assert made.colors[made.triangles].tolist() == [[RED] * 3, [BLUE] * 3]
    made = scene("file.stl", binary_stl((0x8000 | 31 << 5, 31)))
    assert made.colors[made.triangles].tolist() == [[GREEN] * 3, [GREY] * 3]
    assert scene("file.stl", binary_stl((31, 0))).colors is None
    # A header with a colour: it is that of triangles with the bit. Red is lowest.
    made = scene("file.stl", binary_stl((0x8000, 31), b"COLOR=\0\xff\0\xff,MATERIAL="))
    assert made.colors[made.triangles].tolist() == [[GREEN] * 3, [RED] * 3]
    scene("file.stl", binary_stl((0x8000, 31), b"COLOR=\0\xff\0\x80"), "transparency")


@pytest.mark.parametrize(
    ("content", "count", "text"),
    [
        (binary_stl(announced=3), 2, "3 triangles are announced, 2 are there and drawn"),
        (binary_stl()[:-1], 1, "2 triangles are announced, 1 are there and drawn"),
        (ASCII_STL[:-40], 1, "2 triangles begin, 1 are complete and drawn"),
    ],
)
def test_truncated_stl(tmp_path, content, count, text):
    model = read(write(tmp_path, "file.stl", content))
    assert model.findings["truncated file"].text == text
    assert sum(len(mesh.triangles) for mesh in model.meshes) == count


@pytest.mark.parametrize(
    ("content", "error"),
    [
        (b"x" * 83, "a binary STL file must have a header of 84 bytes, got 83 bytes"),
        (ASCII_STL.replace("vertex 1.0", "vertex one", 1), "the coordinates of vertices must be numbers, got 'one'"),
    ],
)
def test_broken_stl(tmp_path, content, error):
    with pytest.raises(ModelError) as raised:
        read(write(tmp_path, "file.stl", content))
    assert str(raised.value) == error


OFF = f"OFF\n4 2 0\n{SQUARE}3 0 1 2\n3 0 2 3\n"


@pytest.mark.parametrize(
    "content",
    [
        OFF,
        OFF.replace("OFF\n", "OFF "),
        OFF.replace("OFF\n", "OFF"),
        OFF.replace("OFF\n", ""),
        OFF.replace("OFF\n", "off\n"),
        OFF.replace("\n", "\r\n"),
        OFF.replace("\n", "\r"),
        OFF.replace("4 2 0", "4 2"),
        OFF.replace("\n", " # \u00fc\n\n  ").encode("latin-1"),
        "\ufeff# first\n" + OFF + "trailing words\n",
        f"OFF\n4 1 4\n{SQUARE}4 0 1 2 3\n",
        "NOFF\n4 1 0\n" + SQUARE.replace("\n", " 0 0 1\n") + "4 0 1 2 3\n",
        "STOFF\n4 1 0\n" + SQUARE.replace("\n", " 0 0\n") + "4 0 1 2 3\n",
    ],
)
def test_off(scene, content):
    made = scene("file.off", content)
    assert len(made.triangles) == 2 and pixels(made) == SQUARE_PIXELS
    assert middle_color(made) == GREY and made.normals.tolist() == [[0, 0, 1]] * 4


def test_a_concave_face_of_off(scene):
    assert pixels(scene("file.off", "OFF\n4 1 0\n1 -1 0\n0 1 0\n-1 -1 0\n0 0 0\n4 0 1 2 3\n")) == 676


@pytest.mark.parametrize("keyword", ["OFF", "COFF", "CNOFF", "STCNOFF"])
@pytest.mark.parametrize("color", ["255 128 0", "255 128 0 255", "1.0 0.50196078 0.0", "1.0 0.50196078 0.0 1.0"])
def test_colors_of_off(scene, keyword, color):
    linear = decode_table()[[255, 128, 0]].tolist()
    own = (" 0 0 1" if "N" in keyword else "") + f" {color}" + (" 0.5 0.25" if "ST" in keyword else "")
    made = scene("file.off", f"{keyword}\n4 1 0\n" + SQUARE.replace("\n", own + "\n") + "4 0 1 2 3\n")
    assert made.colors.tolist() == [linear] * 4
    assert made.uvs is None if "ST" not in keyword else made.uvs.tolist() == [[0.5, 0.25]] * 4
    made = scene("file.off", f"OFF\n4 2 0\n{SQUARE}3 0 1 2 {color}\n3 0 2 3\n")
    assert made.colors[made.triangles].tolist() == [[linear] * 3, [GREY] * 3]


@pytest.mark.parametrize("first", ["1 0 0", "1 0 0 1", "1e0 0 0", "1.0 0 0"])
def test_floating_point_is_told_by_all_colors(scene, first):
    """A colour that is written in whole numbers, beside others."""
    for second in ("5e-1 1 0", "0.5 1 0", "1 1 0"):
        made = scene("file.off", f"OFF\n4 2 0\n{SQUARE}3 0 1 2 {first}\n3 0 2 3 {second}\n")
        assert made.colors[made.triangles[0]].tolist() == [RED] * 3
        assert made.colors[made.triangles[1, 0], 1] == 1
    made = scene("file.off", f"OFF\n4 2 0\n{SQUARE}3 0 1 2 1 1 1\n3 0 2 3 255 0 0\n")
    assert made.colors[made.triangles[0]].tolist() == [[decode_table()[1]] * 3] * 3


def test_findings_of_off(scene):
    scene("file.off", f"OFF\n4 1 0\n{SQUARE}4 0 1 2 3 255 0 0 128\n", "transparency")
    scene("file.off", f"OFF\n4 1 0\n{SQUARE}4 0 1 2 3 0.5 0 0 0.5\n", "transparency")
    assert middle_color(scene("file.off", f"OFF\n4 1 0\n{SQUARE}4 0 1 2 3 7\n", "color maps")) == GREY
    scene("file.off", f"OFF\n4 2 0\n{SQUARE}4 0 1 2 3\n2 0 1\n", "faces of one or two corners")


@pytest.mark.parametrize("cut", ["3 0 2", "3 0 2 -", "3", "-"])
def test_a_face_of_off_that_the_end_of_the_file_cuts(scene, cut):
    assert len(scene("file.off", OFF.replace("3 0 2 3\n", cut), "truncated file").triangles) == 1


def test_truncated_off(tmp_path):
    assert not read(write(tmp_path, "file.off", OFF.replace("3 0 2 3\n", "3.0 0 2 3"))).findings
    model = read(write(tmp_path, "file.off", OFF.replace("3 0 2 3\n", "")))
    assert model.findings["truncated file"].text == "2 faces are announced, 1 are there and drawn"
    assert len(model.meshes[0].triangles) == 1


@pytest.mark.parametrize(
    ("content", "error"),
    [
        ("", "an OFF file must begin with OFF, got ''"),
        ("PFF\n4 2 0\n", "an OFF file must begin with OFF, got 'PFF'"),
        ("4OFF\n4 2 0\n", "an OFF file must be text and of three dimensions, got '4OFF'"),
        ("nOFF\n4 2 0\n", "an OFF file must be text and of three dimensions, got 'nOFF'"),
        ("OFF BINARY\n", "an OFF file must be text and of three dimensions, got 'OFF BINARY'"),
        ("OFF\n4\n", "an OFF file must give the numbers of vertices, faces and edges, got '4'"),
        ("OFF\n", "an OFF file must give the numbers of vertices, faces and edges, got ''"),
        ("OFF\n9 2 0\n0 0 0\n", "the file ends within the vertices: 9 are announced, 1 are there"),
        (OFF.replace("1 1 0", "1 1"), "vertices must have 3 numbers or more, got '1 1'"),
        (OFF.replace("1 1 0", "1 x 0"), "vertices must be numbers, got 'x'"),
        (OFF.replace("3 0 1 2", "3 0 1"), "a face must be the number of its corners, then as many indices, got '3 0 1'"),
        (OFF.replace("3 0 1 2", "nan 0 1 2"), "a face must be the number of its corners, then as many indices"),
        (OFF.replace("3 0 1 2", "3 0 1 4"), "faces must index the 4 vertices, got indices from 0 to 4"),
        ("NOFF\n1 1 0\n0 0 0\n1 0\n", "vertices must have 6 numbers or more, got 3"),
    ],
)
def test_broken_off(tmp_path, content, error):
    with pytest.raises(ModelError) as raised:
        read(write(tmp_path, "file.off", content))
    assert str(raised.value).startswith(error)

"""The OBJ reader, file by file."""

import numpy as np
import pytest
from formats import SQUARE_PIXELS, middle_color, pixels, quarter_colors, read, scene_of, write
from gltf_files import encoded, quarters

from bigtri.reference.shading import decode_table
from bigtri.scene.readers import obj_lines
from bigtri.scene.readers.assemble import assemble
from bigtri.scene.readers.model import ModelError

CORNERS = "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\n"
SQUARE = CORNERS + "f 1 2 3\nf 1 3 4\n"
UVS = "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
TEXTURED = CORNERS + UVS + "usemtl m\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"
QUARTERS = [(255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 255, 255)]
RED, GREEN, GREY = [1, 0, 0], [0, 1, 0], [np.float32(0.6)] * 3


@pytest.fixture
def scene(tmp_path):
    """Writes an OBJ file, and others by their paths; the scene of it."""

    def written(text, *findings, name="file.obj", others=()):
        for other, content in dict(others).items():
            write(tmp_path, other, content)
        return scene_of(write(tmp_path, name, text), *findings)

    return written


@pytest.fixture
def painted(scene):
    """The square with the material m of a library; q4.png, which the library may name, has four colours."""

    def written(library, *findings, obj=TEXTURED, texture="q4.png"):
        return scene("mtllib file.mtl\n" + obj, *findings, others={"file.mtl": library, texture: encoded(quarters())})

    return written


@pytest.mark.parametrize(
    "text",
    [
        SQUARE,
        CORNERS + "f 1 2 3 4\n",
        SQUARE.replace("\n", "\r\n"),
        SQUARE.replace("\n", "\r"),
        SQUARE.replace(" ", "\t"),
        SQUARE.replace(" ", "  \t ").replace("\n", " \t\n"),
        SQUARE.replace("v", "  v").replace("f", "\tf"),
        "\ufeff" + SQUARE,
        SQUARE.rstrip("\n"),
        SQUARE.replace("f 1 3 4", "f 1 \\\n3\\\r\n4"),
        "# C:\\folder\\\n" + SQUARE,  # a comment is not continued
        SQUARE.replace("\n", " # v 9 9 9 #\n"),
        b"# f\xfcr\xff\x00\n" + SQUARE.encode(),
        SQUARE.replace("v 1 1 0", "v 1.0E+0 1e-0 -0"),
        SQUARE.replace("v -1 -1 0", "v -1 -1 0 1"),  # a weight
        # Negative indices count from the line that they stand in.
        "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nf -3 -2 -1\nv -1 1 0\nv 5 5 5\nf -5 -3 -2\n",
        "f 1 2 3\nf 1 3 4\n" + CORNERS,  # an index may come before what it is of
        "o a\ng b c\ns 1\nmg 1 2\nusemtl\n" + SQUARE,
        CORNERS + UVS + "vn 0 0 1\nf 1 2/2 3//1 4/4/1\n",  # corners that have different things
        CORNERS + "f 1/ 2/0 3// 4\n",
        SQUARE + "\0\0\x1a",
    ],
)
def test_a_square(scene, text):
    made = scene(text)
    assert len(made.triangles) == 2 and pixels(made) == SQUARE_PIXELS
    assert (made.normals == (0, 0, 1)).all()
    assert middle_color(made) == GREY


def test_the_size_of_chunks_means_nothing(tmp_path, monkeypatch):
    """Lines of several kinds mixed, negative indices among them, read a few at a time."""
    blocks = [f"v {i} 0 0 1 0 0\nv {i} 1 0\nvt 0.5 {i}\nvn 0 0 {i}\nv {i} 2 1\nf -3/-1/-1 -2//1 -1/1\n" for i in range(1, 40)]
    path = write(tmp_path, "file.obj", "".join(blocks) + "f 1 2 3 6 5\n")
    (whole,) = read(path).meshes
    monkeypatch.setattr(obj_lines, "_CHUNK", 64)
    (in_parts,) = read(path).meshes
    for name in ("positions", "triangles", "uvs", "colors"):
        assert np.array_equal(getattr(whole, name), getattr(in_parts, name)), name
    assert whole.positions[whole.triangles[38]].tolist() == [[39, 0, 0], [39, 1, 0], [39, 2, 1]]
    assert whole.uvs[whole.triangles[38]].tolist() == [[0.5, 39], [0, 0], [0.5, 1]]


@pytest.mark.parametrize(
    ("corners", "count"),
    [
        ([(1, -1), (1, 0), (0, 0), (0, 1), (-1, 1), (-1, -1)], 2028),  # an L
        ([(1, -1), (0, 1), (-1, -1), (0, 0)], 676),  # an arrowhead
        ([(1, -1), (0, 1), (-1, -1), (0, 0), (0, 0)], 676),  # its concave corner is there twice
    ],
)
def test_concave_polygons(scene, corners, count):
    for turned in range(len(corners)):
        around = corners[turned:] + corners[:turned]
        text = "".join(f"v {x} {y} 0\n" for x, y in around) + "f " + " ".join(str(i + 1) for i in range(len(around)))
        assert pixels(scene(text)) == count


def test_normals_of_the_file(scene):
    text = CORNERS + "vn 0 0 2\nvn 0 1 1\nf 1//1 2//1 3//1\nf 1//2 3//-2 4//1\n"
    made = scene(text)
    at = {(tuple(p), tuple(n)) for p, n in zip(made.positions[:, :2].tolist(), made.normals.round(3).tolist(), strict=True)}
    up, tilted = (0.0, 0.0, 1.0), tuple(np.float32((0, 0.707, 0.707)).tolist())
    assert at == {((-1, -1), up), ((-1, -1), tilted), ((1, -1), up), ((1, 1), up), ((-1, 1), up)}


def test_colors_of_vertices(scene):
    text = CORNERS.replace(" 0\n", " 0 1 0.5 0\n") + "f 1 2 3 4\n"
    assert middle_color(scene(text)) == pytest.approx([1, 0.21404, 0], abs=1e-5)
    codes = "v -1 -1 0 255 0 0\nv 1 -1 0 255 0 0\nv 1 1 0 255 0 0\nf 1 2 3\n"
    assert middle_color(scene(codes, "colors beyond 0 to 1")) == RED


@pytest.mark.parametrize(
    "library",
    [
        "newmtl m\nKd 1 1 1\nmap_Kd q4.png\n",
        "newmtl m\nmap_Kd q4.png\n",
        "newmtl m\nKd 1.0 1.0 1.0  # white\nmap_Kd q4.png # four colours\n",
        "newmtl m\nKd 1\nmap_Kd q4.png\n",
        "\ufeffnewmtl m\r\n\tKd\t1 1 1\r\n\tmap_Kd\tq4.png\r\n",
        "NEWMTL m\nkd 1 1 1\nMAP_KD q4.png\n",
        b"# \xff\nnewmtl other\nKd 0 0 0\nnewmtl m\nmap_Kd q4.png\n",
        "newmtl m\nmap_Kd -blendu on -blendv on -cc off q4.png\n",
        "newmtl m\nmap_Kd -s 1 1 1 -o 0 0 0 -clamp on q4.png\n",
        "newmtl m\nmap_Kd -o 1 2 q4.png\n",  # whole periods
        "newmtl m\nmap_Kd -s 2 2 -o 0.5 0 q4.png\nmap_Kd q4.png\n",  # the options of a map are its own
        "newmtl m\nKd 1 \\\n1 1\nmap_Kd \\\nq4.png\n",
        "# C:\\folder\\\nnewmtl m\nmap_Kd q4.png\n",
        "newmtl m\nTr 1\nd 1\nmap_Kd q4.png\n",  # of both, d says it
        "newmtl m\nmap_Kd C:\\models\\q4.png\n",  # of another machine
        'newmtl m\nmap_Kd "q4.png"\n',
        "newmtl m\nd 1\nTr 0\nKe 0 0 0.0\nKs 1 1 1\nNs 10\nillum 2\nmap_Kd q4.png\n",
    ],
)
def test_textures(painted, library):
    assert quarter_colors(painted(library)) == QUARTERS


@pytest.mark.parametrize(
    ("name", "texture"),
    [
        ("my texture.png", "my texture.png"),
        ("tex\\q4.png", "tex/q4.png"),
        ("./tex/q4.png", "tex/q4.png"),
        ("a#b.png", "a#b.png"),
        ("-s 1 1 -1.png", "-1.png"),
    ],
)
def test_names_of_textures(painted, name, texture):
    assert quarter_colors(painted(f"newmtl m\nmap_Kd {name}\n", texture=texture)) == QUARTERS


def test_folders_above(scene):
    others = {"tex/q4.png": encoded(quarters()), "tex/file.mtl": "newmtl m\nmap_Kd ../tex/q4.png\n"}
    for reference in ("../tex/file.mtl", "..\\tex\\file.mtl"):
        made = scene(f"mtllib {reference}\n" + TEXTURED, name="model/file.obj", others=others)
        assert quarter_colors(made) == QUARTERS


def test_textures_beside_the_library_or_the_model(scene):
    others = {"lib/file.mtl": "newmtl m\nmap_Kd tex/q4.png\n", "tex/q4.png": encoded(quarters())}
    assert quarter_colors(scene("mtllib lib/file.mtl\n" + TEXTURED, others=others)) == QUARTERS
    white = encoded(np.full((1, 1, 3), 255, np.uint8))
    beside = scene("mtllib lib/file.mtl\n" + TEXTURED, others={"lib/tex/q4.png": white})
    assert quarter_colors(beside) == [(255, 255, 255)] * 4


def test_a_map_that_is_scaled_and_moved(painted):
    made = painted("newmtl m\nmap_Kd -s 0.5 0.5 -o 0.5 0 q4.png\n")
    assert made.uvs.tolist() == [[0.5, 0], [1, 0], [1, 0.5], [0.5, 0.5]]
    (material,) = made.materials
    assert material.wrap == "repeat"
    (material,) = painted("newmtl m\nmap_Kd -clamp on q4.png\n").materials
    assert material.wrap == "clamp"


@pytest.mark.parametrize(
    ("library", "finding"),
    [
        ("newmtl m\nmap_Kd -mm 0 2 q4.png\n", "options of maps"),
        ("newmtl m\nd 0.5\nmap_Kd q4.png\n", "transparency"),
        ("newmtl m\nTr 0.5\nmap_Kd q4.png\n", "transparency"),
        ("newmtl m\nmap_d q4.png\nmap_Kd q4.png\n", "transparency"),
        ("newmtl m\nKe 1 0 0\nmap_Kd q4.png\n", "emission"),
        ("newmtl m\nmap_Ke q4.png\nmap_Kd q4.png\n", "emission"),
        ("newmtl m\nmap_Bump -bm 2 q4.png\nmap_Kd q4.png\n", "bump maps"),
        ("newmtl m\nKd 2 2 2\nmap_Kd q4.png\n", "colors beyond 0 to 1"),
        ("newmtl m\nKd spectral file.rfl\nmap_Kd q4.png\n", "unknown colors"),
    ],
)
def test_what_is_drawn_without(painted, library, finding):
    assert quarter_colors(painted(library, finding)) == QUARTERS


def test_kd_is_srgb(painted):
    for kd, code in (("1 0 0", (255, 0, 0)), ("0 0.2 0.6", (0, 51, 153)), ("0.2", (51, 51, 51)), ("0.6 0.2", (153, 51, 153))):
        (material,) = painted(f"newmtl m\nKd {kd}\n").materials
        assert material.base_color == tuple(decode_table()[list(code)].tolist())


def test_several_libraries(scene):
    others = {"a.mtl": "newmtl a\nKd 0 1 0\n", "b.mtl": "newmtl m\nKd 1 0 0\n", "c d.mtl": "newmtl m\nKd 0 1 0\n"}
    assert middle_color(scene("mtllib a.mtl\nmtllib b.mtl\n" + TEXTURED, others=others)) == RED
    assert middle_color(scene("mtllib a.mtl b.mtl\n" + TEXTURED)) == RED
    assert middle_color(scene("mtllib b.mtl\nmtllib c d.mtl\n" + TEXTURED)) == RED  # the first that has it
    assert middle_color(scene("mtllib c d.mtl\n" + TEXTURED)) == GREEN
    assert middle_color(scene(TEXTURED + "mtllib b.mtl\n")) == RED
    for names in ("c d.mtl b.mtl", '"c d.mtl" "b.mtl"', "a.mtl c d.mtl"):
        assert middle_color(scene(f"mtllib {names}\n" + TEXTURED)) == GREEN


def test_materials_keep_the_order_of_the_file(tmp_path):
    write(tmp_path, "file.mtl", "newmtl a\nKd 1 0 0\nnewmtl b\nKd 0 1 0\nnewmtl b\nKd 0 0 1\n")
    text = "mtllib file.mtl\n" + CORNERS + "usemtl b\nf 1 2 3\nusemtl a\nf 1 3 4\nusemtl b\nf 2 3 4\n"
    model = read(write(tmp_path, "file.obj", text))
    assert [mesh.name for mesh in model.meshes] == ["b", "a"]
    assert [mesh.paint.base_color for mesh in model.meshes] == [(0, 0, 1), (1, 0, 0)]
    assert [mesh.positions[mesh.triangles][:, :, 0].tolist() for mesh in model.meshes] == [
        [[-1, 1, 1], [1, 1, -1]],
        [[-1, 1, -1]],
    ]
    assert [len(mesh.positions) for mesh in model.meshes] == [4, 3]  # those alone that are used


def test_a_texture_of_several_materials_is_one_array(tmp_path):
    write(tmp_path, "q4.png", encoded(quarters()))
    write(tmp_path, "file.mtl", "newmtl a\nmap_Kd q4.png\nnewmtl b\nKd 1 0 0\nmap_Kd q4.png\n")
    text = "mtllib file.mtl\n" + CORNERS + "usemtl a\nf 1 2 3\nusemtl b\nf 1 3 4\n"
    a, b = read(write(tmp_path, "file.obj", text)).meshes
    assert a.paint.texture is b.paint.texture and a.paint.texture.dtype == np.uint8


@pytest.mark.parametrize(
    ("text", "others", "finding", "part"),
    [
        ("mtllib nothere.mtl\n" + SQUARE, {}, "missing material libraries", "nothere.mtl"),
        ("mtllib not here.mtl\n" + SQUARE, {}, "missing material libraries", "library not here.mtl"),
        ("usemtl nothere\n" + SQUARE, {}, "missing materials", "nothere"),
        ("mtllib f.mtl\n" + TEXTURED, {"f.mtl": "newmtl m\nmap_Kd nothere.png\n"}, "missing textures", "nothere.png"),
        ("mtllib f.mtl\n" + TEXTURED, {"f.mtl": "newmtl m\nmap_Kd f.mtl\n"}, "broken textures", "f.mtl"),
        ("p 1 2\np 3\n" + SQUARE, {}, "points", "points"),
        ("l 1 2\n" + SQUARE, {}, "lines", "lines"),
        ("cstype bspline\ncurv 0 1 1 2 3\n" + SQUARE, {}, "free-form curves", "curves"),
        ("f 1 2\n" + SQUARE, {}, "faces of one or two corners", "1 faces"),
        (CORNERS + "f 1/5 2/6 3/7\nf 1//8 3 4\n", {}, "dangling indices", "4 indices"),
        (CORNERS, {}, "points", "4 points"),
        (SQUARE + "ff 1 2 3\ncall other.obj\n", {}, "unknown lines", "line 7 begins with 'ff'"),
        ("USEMTL m\n" + SQUARE, {}, "unknown lines", "line 1 begins with 'USEMTL'"),
    ],
)
def test_findings(tmp_path, text, others, finding, part):
    for name, content in others.items():
        write(tmp_path, name, content)
    model = read(write(tmp_path, "file.obj", text))
    assert list(model.findings) == [finding] and part in model.findings[finding].text


def test_texture_coordinates_without_a_material(scene):
    assert middle_color(scene(TEXTURED.replace("usemtl m\n", ""))) == GREY


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n", "line 1: v must have 3 numbers or more, got '0 0'"),
        (CORNERS + "v 1 x 0\n", "line 5: v must be numbers, got 'x'"),
        (CORNERS + "f 1 2 3\nf 1 2 5\n", "line 6: f must have indices of the 4 vertices, got '1 2 5'"),
        (CORNERS + "f 0 1 2\n", "line 5: f must have indices of the 4 vertices, got '0 1 2'"),
        (CORNERS + "f -5 1 2\n", "line 5: f must have indices of the 4 vertices, got '-5 1 2'"),
        (CORNERS + "f 1 2 99999999999999999999\n", "line 5: f must have indices of the 4 vertices"),
        (CORNERS + "f 1 2 3.5\n", "line 5: f must be whole numbers, got '3.5'"),
        (CORNERS + "f 1/1/1/1 2 3\n", "line 5: f must have corners of the form 1, 1/2, 1//3 or 1/2/3, got '1/1/1/1 2 3'"),
        (CORNERS + "f /1 2 3\n", "line 5: f must have indices of the 4 vertices, got '/1 2 3'"),
    ],
)
def test_broken_files(tmp_path, text, error):
    with pytest.raises(ModelError) as raised:
        read(write(tmp_path, "file.obj", text))
    assert str(raised.value).startswith(error)


def test_texts_of_two_encodings(scene):
    """Each line of a library is text of its own: one that is not UTF-8 leaves the others as they are."""
    library = b"# \xfc\nnewmtl gr\xc3\xbcn\nKd 0 1 0\n"
    text = "mtllib file.mtl\nusemtl gr\u00fcn\n" + CORNERS + "f 1 2 3 4\n"
    assert middle_color(scene(text, others={"file.mtl": library})) == GREEN


def test_transparency_and_emission_are_carried(painted):
    (material,) = painted("newmtl m\nd 0.25\nTr 0.5\nKe 0 1 0\n", "emission", "transparency").materials
    assert material.alpha_mode == "blend" and material.alpha == 0.25 and material.emissive == (0, 1, 0)
    (material,) = painted("newmtl m\nTr 0.75\n", "transparency").materials
    assert material.alpha_mode == "blend" and material.alpha == 0.25
    (material,) = painted("newmtl m\nd -halo 0\n", "transparency").materials
    assert material.alpha_mode == "blend" and material.alpha == 0


def test_textures_without_coordinates(tmp_path):
    """All faces of a material lack them, or some."""
    write(tmp_path, "q4.png", encoded(quarters()))
    write(tmp_path, "file.mtl", "newmtl m\nmap_Kd q4.png\n")
    for faces, finding in (("f 1 2 3\n", "textures without coordinates"), ("f 1/1 2 3\n", "faces without texture coordinates")):
        path = write(tmp_path, "file.obj", "mtllib file.mtl\nusemtl m\n" + CORNERS + UVS + faces)
        model = read(path)
        assemble(model)
        assert list(model.findings) == [finding]


def test_normals_without_a_length(tmp_path):
    model = read(write(tmp_path, "file.obj", CORNERS + "vn 0 0 0\nf 1//1 2//1 3//1 4//1\n"))
    assert assemble(model).normals.tolist() == [[0, 0, 1]] * 4 and list(model.findings) == ["normals without a direction"]


def test_an_empty_file(tmp_path):
    assert not read(write(tmp_path, "file.obj", "")).findings

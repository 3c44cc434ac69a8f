"""The PLY reader, file by file: the same contents as text and in both orders of bytes."""

import struct

import numpy as np
import pytest
from formats import SQUARE_PIXELS, middle_color, pixels, quarter_colors, read, scene_of, write
from gltf_files import encoded, quarters

from bigtri.reference.shading import decode_table
from bigtri.scene.readers.model import ModelError

FORMATS = ("ascii", "binary_little_endian", "binary_big_endian")
QUARTERS = [(255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 255, 255)]
GREY = [np.float32(0.6)] * 3
LETTERS = {"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d"}

XYZ = ("float x", "float y", "float z")
INDICES = ("list uchar int vertex_indices",)
SQUARE = ((-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0))
UVS = ((0, 0), (1, 0), (1, 1), (0, 1))


def ply(form, *elements, comments=(), end_of_line="\n", announced=()):
    """A file of elements, each a name, its properties and its rows; a list in a row is a list."""
    announced = dict(announced)
    lines = ["ply", f"format {form} 1.0", *comments]
    body = b""
    for name, properties, rows in elements:
        lines.append(f"element {name} {announced.get(name, len(rows))}")
        lines += [f"property {line}" for line in properties]
        for row in rows:
            words = []
            for line, value in zip(properties, row, strict=True):
                kinds = line.split()[:-1]
                values = [len(value), *value] if kinds[0] == "list" else [value]
                letters = "".join(LETTERS[kind] for kind in kinds[-1:] * len(values))
                if kinds[0] == "list":
                    letters = LETTERS[kinds[1]] + letters[1:]
                if form == "ascii":
                    words += [str(v) for v in values]
                else:
                    body += struct.pack((">" if form.endswith("big_endian") else "<") + letters, *values)
            if form == "ascii":
                body += (" ".join(words) + end_of_line).encode()
    return (end_of_line.join([*lines, "end_header"]) + end_of_line).encode() + body


def square(form, *faces, properties=INDICES, vertex=XYZ, more=((),) * 4, **settings):
    vertices = [(*position, *own) for position, own in zip(SQUARE, more, strict=True)]
    return ply(form, ("vertex", vertex, vertices), ("face", properties, faces), **settings)


@pytest.fixture(params=FORMATS)
def form(request):
    return request.param


@pytest.fixture
def scene(tmp_path):
    def written(data, *findings):
        return scene_of(write(tmp_path, "file.ply", data), *findings)

    return written


@pytest.mark.parametrize("faces", [[[0, 1, 2, 3]], [[0, 1, 2], [0, 2, 3]], [[0, 1, 2], [], [0, 2, 3]]])
@pytest.mark.parametrize("end_of_line", ["\n", "\r\n", "\r"])
def test_a_square(scene, form, faces, end_of_line):
    findings = ["faces of one or two corners"] if [] in faces else []
    made = scene(square(form, *[(face,) for face in faces], end_of_line=end_of_line), *findings)
    assert len(made.triangles) == 2 and pixels(made) == SQUARE_PIXELS
    assert middle_color(made) == GREY and (made.normals == (0, 0, 1)).all()


@pytest.mark.parametrize("kind", ["uchar", "ushort", "uint", "int", "short", "char"])
@pytest.mark.parametrize("length", ["uchar", "ushort", "int"])
def test_types_of_indices(scene, form, kind, length):
    properties = (f"list {length} {kind} vertex_index",)
    assert pixels(scene(square(form, ([0, 1, 2],), ([0, 2, 3],), properties=properties))) == SQUARE_PIXELS
    assert pixels(scene(square(form, ([0, 1, 2, 3],), ([0, 1, 2],), properties=properties))) == SQUARE_PIXELS


@pytest.mark.parametrize("kind", ["float", "double", "int", "short"])
def test_types_of_coordinates(tmp_path, form, kind):
    (mesh,) = read(write(tmp_path, "file.ply", square(form, ([0, 1, 2],), vertex=[f"{kind} {c}" for c in "xyz"]))).meshes
    assert mesh.positions.tolist() == [list(p) for p in SQUARE]
    assert mesh.positions.dtype == (np.float32 if kind == "float" and form != "ascii" else np.float64)


def test_polygons_mixed_with_numbers_and_other_lists(scene, form):
    """Rows whose lengths differ, in two lists, with numbers before, between and after them."""
    properties = ("uchar flags", "list uchar int vertex_indices", "double area", "list ushort float weights", "short group")
    faces = [(1, [0, 1, 2, 3], 0.5, [], 7), (2, [0, 1, 2], 1.5, [1, 2, 3], -1), (3, [1, 2, 3, 0], 2.5, [0.5], 9)]
    made = scene(square(form, *faces, properties=properties))
    assert made.triangles.tolist() == [[0, 1, 2], [2, 3, 0], [0, 1, 2], [1, 2, 3], [3, 0, 1]]


def test_a_concave_polygon(scene, form):
    corners = [(1, -1), (1, 0), (0, 0), (0, 1), (-1, 1), (-1, -1)]
    data = ply(form, ("vertex", XYZ, [(*c, 0) for c in corners]), ("face", INDICES, [(list(range(6)),)]))
    assert pixels(scene(data)) == 2028


def test_other_elements_before_and_after(scene, form):
    camera = ("camera", ("float view_px", "list uchar int extra"), [(1, [1, 2, 3]), (2, [])])
    edges = ("edge", ("int vertex1", "int vertex2"), [(0, 1)])
    vertices, faces = ("vertex", XYZ, SQUARE), ("face", INDICES, [([0, 1, 2, 3],)])
    made = scene(ply(form, camera, vertices, edges, faces, ("empty", (), [])), "other elements", "lines")
    assert pixels(made) == SQUARE_PIXELS


def test_comments_and_trailing_bytes(scene, form):
    comments = ("comment made by hand", "obj_info \xfc", "comment")
    data = square(form, ([0, 1, 2, 3],), comments=comments)
    assert pixels(scene(data)) == SQUARE_PIXELS
    assert pixels(scene(data + (b" 0 0\n" if form == "ascii" else b"\0\0\0"))) == SQUARE_PIXELS


@pytest.mark.parametrize("names", [("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b")])
@pytest.mark.parametrize(
    ("kind", "codes"), [("uchar", (255, 128, 0)), ("ushort", (65535, 128 * 257, 0)), ("float", (1, np.float32(128 / 255), 0))]
)
def test_colors(scene, form, names, kind, codes):
    linear = decode_table()[[255, 128, 0]].tolist()
    properties = tuple(f"{kind} {name}" for name in names)
    made = scene(square(form, ([0, 1, 2, 3],), vertex=XYZ + properties, more=[codes] * 4))
    assert made.colors.tolist() == [linear] * 4
    made = scene(square(form, ([0, 1, 2], *codes), ([0, 2, 3], *codes), properties=INDICES + properties))
    assert made.colors.tolist() == [linear] * 6


def test_a_color_for_each_face(scene, form):
    """Also where faces become several triangles."""
    corners = [*SQUARE, (3, -1, 0), (3, 1, 0)]
    properties = (*INDICES, "uchar red", "uchar green", "uchar blue")
    faces = [([0, 1, 2, 3], 255, 0, 0), ([1, 4, 5], 0, 255, 0), ([1, 5, 2], 0, 0, 255)]
    made = scene(ply(form, ("vertex", XYZ, corners), ("face", properties, faces)))
    assert made.colors[made.triangles].tolist() == [[c] * 3 for c in ([1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1])]


def test_16_bits_of_color_are_kept(scene, form):
    vertex = (*XYZ, "ushort red", "ushort green", "ushort blue")
    made = scene(square(form, ([0, 1, 2, 3],), vertex=vertex, more=[(65535, 32768, 0)] * 4))
    assert middle_color(made) == pytest.approx([1, 0.21405, 0], abs=1e-5)


def test_transparency(scene, form):
    vertex = (*XYZ, "uchar red", "uchar green", "uchar blue", "uchar alpha")
    scene(square(form, ([0, 1, 2, 3],), vertex=vertex, more=[(9, 9, 9, 255)] * 4))
    scene(square(form, ([0, 1, 2, 3],), vertex=vertex, more=[(9, 9, 9, 254)] * 4), "transparency")


def test_normals_of_the_file(scene, form):
    made = scene(square(form, ([0, 1, 2, 3],), vertex=(*XYZ, "float nx", "float ny", "float nz"), more=[(0, 0, 2)] * 4))
    assert made.normals.tolist() == [[0, 0, 1]] * 4


TEXTURE = ("comment TextureFile q4.png",)


@pytest.mark.parametrize("names", [("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("texture_s", "texture_t")])
def test_texture_coordinates_of_vertices(scene, tmp_path, form, names):
    vertex = (*XYZ, f"float {names[0]}", f"float {names[1]}")
    data = square(form, ([0, 1, 2, 3],), vertex=vertex, more=UVS, comments=TEXTURE)
    made = scene(data, "missing textures")
    assert middle_color(made) == GREY
    write(tmp_path, "q4.png", encoded(quarters()))
    assert quarter_colors(scene(data)) == QUARTERS
    made = scene(square(form, ([0, 1, 2, 3],), vertex=vertex, more=UVS))
    assert middle_color(made) == GREY and made.uvs.tolist() == [list(uv) for uv in UVS]


def test_texture_coordinates_of_faces(scene, tmp_path, form):
    write(tmp_path, "q4.png", encoded(quarters()))
    properties = (*INDICES, "list uchar float texcoord")
    flat = [sum((UVS[i] for i in face), ()) for face in ([0, 1, 2, 3], [0, 1, 2], [0, 2, 3])]
    whole = square(form, ([0, 1, 2, 3], flat[0]), properties=properties, comments=TEXTURE)
    parts = square(form, ([0, 1, 2], flat[1]), ([0, 2, 3], flat[2]), properties=properties, comments=TEXTURE)
    mirrored = square(form, ([0, 1, 2], flat[1]), ([0, 2, 3], (1, 0, 1, 1, 0, 1)), properties=properties, comments=TEXTURE)
    for data in (whole, parts):
        made = scene(data)
        assert quarter_colors(made) == QUARTERS and len(made.positions) == 4
    assert len(scene(mirrored).positions) == 5  # a seam
    made = scene(square(form, ([0, 1, 2], flat[1]), ([0, 2, 3], ()), properties=properties), "texture coordinates of faces")
    assert made.uvs[made.triangles].tolist() == [[[0, 0], [1, 0], [1, 1]], [[0, 0]] * 3]


def test_several_textures(scene, tmp_path, form):
    write(tmp_path, "red.png", encoded(np.full((1, 1, 3), (255, 0, 0), np.uint8)))
    write(tmp_path, "a b.png", encoded(np.full((1, 1, 3), (0, 0, 255), np.uint8)))
    comments = ("comment TextureFile red.png", "comment TextureFile a b.png")
    properties = (*INDICES, "list uchar float texcoord", "int texnumber")
    faces = [([0, 1, 2], (0, 0, 1, 0, 1, 1), 1), ([0, 2, 3], (0, 0, 1, 1, 0, 1), 0)]
    made = scene(square(form, *faces, properties=properties, comments=comments))
    red, blue = (255, 0, 0), (0, 0, 255)
    colors = quarter_colors(made)
    assert colors[0] == red and colors[3] == blue
    made = scene(square(form, *[face[:2] for face in faces], properties=properties[:2], comments=comments), "several textures")
    assert quarter_colors(made) == [red] * 4
    strips = ply(form, ("vertex", XYZ, SQUARE), ("tristrips", INDICES, [([0, 1, 3, 2],)]), comments=comments)
    assert middle_color(scene(strips, "several textures", "textures without coordinates")) == GREY


@pytest.mark.parametrize("files", [1, 2])
def test_faces_without_a_texture_among_others(scene, tmp_path, form, files):
    """Their texnumber is -1."""
    write(tmp_path, "red.png", encoded(np.full((1, 1, 3), (255, 0, 0), np.uint8)))
    properties = (*INDICES, "list uchar float texcoord", "int texnumber")
    faces = [([0, 1, 2], (0,) * 6, -1), ([0, 2, 3], (0,) * 6, 0)]
    made = scene(square(form, *faces, properties=properties, comments=("comment TextureFile red.png",) * files))
    upper_left, _, _, lower_right = quarter_colors(made)
    assert upper_left == (255, 0, 0) and lower_right == (203, 203, 203)


def test_a_texture_without_coordinates(scene, tmp_path, form):
    write(tmp_path, "q4.png", encoded(quarters()))
    made = scene(square(form, ([0, 1, 2, 3],), comments=("comment TextureFile q4.png",)), "textures without coordinates")
    assert middle_color(made) == GREY


def test_triangle_strips(scene, form):
    strips = ("tristrips", INDICES, [([0, 1, 3, 2, -1, 0, 1, 2],), ([-1, 3, 2],), ([1, 2, 0],)])
    made = scene(ply(form, ("vertex", XYZ, SQUARE), strips))
    assert made.triangles.tolist() == [[0, 1, 3], [3, 1, 2], [0, 1, 2], [1, 2, 0]]
    assert pixels(made) == SQUARE_PIXELS


def test_headers_in_other_spacing(scene, form):
    data = square(form, ([0, 1, 2, 3],), comments=("comment end_header",))
    header, end, body = data.partition(b"end_header\n")[0], b"end_header\n", data.rpartition(b"end_header\n")[2]
    header = data[: len(data) - len(body) - len(end)]
    for other in (header.replace(b" ", b"\t"), header.replace(b"\n", b"\r\n", 1), header.replace(b"\n", b" \r\n")):
        assert pixels(scene(other + end + body)) == SQUARE_PIXELS


@pytest.mark.parametrize("trailing", ["\0\0", "\x1a", "# made by hand\n", "1 2 x"])
def test_what_follows_the_numbers_of_an_ascii_file(scene, trailing):
    data = square("ascii", ([0, 1, 2, 3],))
    assert pixels(scene(data + trailing.encode())) == SQUARE_PIXELS


def test_a_word_that_the_end_of_the_file_cuts(scene):
    for word in ("-", "3 0 2 -", "1e"):
        data = square("ascii", ([0, 1, 2],), announced={"face": 2})
        assert len(scene(data + word.encode(), "truncated file").triangles) == 1


def test_after_the_end_nothing_is_read(tmp_path):
    """Faces come first and are not all there: what is left of them is no vertex."""
    data = ply("ascii", ("face", INDICES, [([0, 1, 2],)]), ("vertex", XYZ, SQUARE), announced={"face": 3, "vertex": 1})
    text = "the file ends within element face: 3 rows are announced, 1 are there"
    with pytest.raises(ModelError, match="a list must have 0 entries or more|" + text):
        read(write(tmp_path, "file.ply", data))
    data = ply("ascii", ("face", INDICES, [([0, 1, 2],)]), ("vertex", XYZ, ()), announced={"face": 2, "vertex": 1}) + b"9 7 7 7"
    with pytest.raises(ModelError, match=text.replace("3 rows", "2 rows")):
        read(write(tmp_path, "file.ply", data))


def test_colors_of_vertices_and_of_faces(scene, form):
    properties = ("uchar red", "uchar green", "uchar blue")
    faces = [([0, 1, 2, 3], 0, 255, 0)]
    data = square(form, *faces, properties=INDICES + properties, vertex=XYZ + properties, more=[(255, 0, 0)] * 4)
    assert middle_color(scene(data, "colors of faces")) == [1, 0, 0]


def test_points(tmp_path, form):
    for data in (ply(form, ("vertex", XYZ, SQUARE)), square(form)):
        model = read(write(tmp_path, "file.ply", data))
        assert list(model.findings) == ["points"] and not sum(len(mesh.triangles) for mesh in model.meshes)


def test_a_file_that_ends_early(scene, tmp_path, form):
    faces = [([0, 1, 2],), ([0, 2, 3],), ([0, 1, 2, 3],)]
    made = scene(square(form, *faces, announced={"face": 5}), "truncated file")
    assert len(made.triangles) == 4
    whole = square(form, *faces)
    cut = whole.rstrip()[:-2] if form == "ascii" else whole[:-1]
    model = read(write(tmp_path, "file.ply", cut))
    text = "the file ends within element face: 3 rows are announced, 2 are there and drawn"
    assert model.findings["truncated file"].text == text and len(model.meshes[0].triangles) == 2
    early = ply(form, ("vertex", XYZ, SQUARE), announced={"vertex": 6})
    with pytest.raises(ModelError, match="the file ends within element vertex: 6 rows are announced, 4 are there"):
        read(write(tmp_path, "file.ply", early))


@pytest.mark.parametrize(
    ("change", "error"),
    [
        (("ply\n", "plx\n"), "a PLY file must begin with the line ply, got b'plx"),
        (("ascii", "text"), "the format must be one of ascii, binary_little_endian, binary_big_endian, got 'text'"),
        (("element face 1", "element face"), "line 7 of the header cannot be read, got 'element face'"),
        (("element face 1", "element face -1"), "line 7 of the header cannot be read"),
        (("float x", "real x"), "line 4 of the header cannot be read, got 'property real x'"),
        (("element vertex 4\n", ""), "line 3 of the header cannot be read, got 'property float x'"),
        (("format", "formal"), "line 2 of the header cannot be read, got 'formal ascii 1.0'"),
        (("end_header", "end"), "line 9 of the header cannot be read, got 'end'"),
        (("float x", "float w"), "element vertex must have the properties x, y and z, got w, y, z"),
        (("vertex_indices", "indexes"), None),  # the only list
        (("list uchar int vertex_indices", "int vertex"), "element face must have the list vertex_indices, got vertex"),
        (("0 1 2 3", "0 1 2 7"), "faces must index the 4 vertices, got indices from 0 to 7"),
        (("0 1 2 3", "0 1 2 -1"), "faces must index the 4 vertices, got indices from -1 to 2"),
        (("0 1 2 3", "0 1 2 nan"), "faces must index the 4 vertices, got indices from nan to nan"),
        (("0 1 2 3", "0 1 2 2.5"), "faces must index the vertices by whole numbers, got 2.5"),
        (("4 0 1", "-4 0 1"), "a list must have 0 entries or more, got -4"),
        (("0 1 2 3", "0 1 2 # 3"), "the body of an ASCII file must be numbers, got '#'"),
        (("-1 -1 0", "-1 one 0"), "the body of an ASCII file must be numbers, got 'one'"),
    ],
)
def test_broken_files(tmp_path, change, error):
    text = square("ascii", ([0, 1, 2, 3],)).decode()
    assert text.count(change[0]) == 1
    path = write(tmp_path, "file.ply", text.replace(*change))
    if error is None:
        assert len(read(path).meshes[0].triangles) == 2
        return
    with pytest.raises(ModelError) as raised:
        read(path)
    assert str(raised.value).startswith(error)


def test_colors_beyond_their_bits(tmp_path):
    vertex = (*XYZ, "uchar red", "uchar green", "uchar blue")
    path = write(tmp_path, "file.ply", square("ascii", ([0, 1, 2],), vertex=vertex, more=[(256, 0, 0)] * 4))
    with pytest.raises(ModelError, match="colours of 8 bits must be from 0 to 255, got 0 to 256"):
        read(path)


def test_colors_that_are_no_integers(tmp_path):
    vertex = (*XYZ, "uchar red", "uchar green", "uchar blue")
    with pytest.raises(ModelError, match="colours of 8 bits must be whole numbers, got 0.9"):
        read(write(tmp_path, "file.ply", square("ascii", ([0, 1, 2, 3],), vertex=vertex, more=[(0.9, 1, 0)] * 4)))

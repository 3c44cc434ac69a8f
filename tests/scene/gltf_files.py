"""glTF files for the tests, written here so that it can be seen what is in them.

A file begins as ``quad()``: a square from (-1, -1) to (1, 1) in the plane z = 0, facing +z. Seen from (0, 0, 3) with a field of
view of 45 degrees it covers 52 x 52 of 64 x 64 px.
"""

import base64
import io
import json
import struct

import numpy as np
from PIL import Image

QUAD = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], np.float32)
# glTF's texture coordinates begin at the upper left.
QUAD_UVS = np.array([(0, 1), (1, 1), (1, 0), (0, 0)], np.float32)
QUAD_INDICES = np.array([0, 1, 2, 0, 2, 3], np.uint16)
COMPONENTS = {"int8": 5120, "uint8": 5121, "int16": 5122, "uint16": 5123, "uint32": 5125, "float32": 5126}
KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


def quarters(size=8):
    """uint8 [size, size, 3]: red and green above blue and white."""
    rows = np.array([[(255, 0, 0), (0, 255, 0)], [(0, 0, 255), (255, 255, 255)]], np.uint8)
    return np.repeat(np.repeat(rows, size // 2, axis=0), size // 2, axis=1)


def encoded(pixels, kind="PNG"):
    """The bytes of an image file; uint16 [H, W] is a grey PNG of 16 bits."""
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, kind, **({"lossless": True} if kind == "WEBP" else {}))
    return file.getvalue()


def data_uri(data, kind="application/octet-stream"):
    return f"data:{kind};base64," + base64.b64encode(data).decode()


class File:
    """A glTF file that grows: ``json`` is what will be written, ``data`` its one buffer.

    The methods that add something return its index.
    """

    def __init__(self):
        self.data = bytearray()
        self.json = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": []}]}

    def add(self, kind, **entry):
        self.json.setdefault(kind, []).append(entry)
        return len(self.json[kind]) - 1

    def view(self, data, **settings):
        """A buffer view of bytes of its own."""
        self.data += b"\0" * (-len(self.data) % 4)
        start = len(self.data)
        self.data += data
        return self.add("bufferViews", buffer=0, byteOffset=start, byteLength=len(data), **settings)

    def accessor(self, values, **settings):
        """An accessor of an array [count] or [count, n]."""
        values = np.asarray(values)
        kind = KINDS[1 if values.ndim == 1 else values.shape[1]]
        entry = {"componentType": COMPONENTS[str(values.dtype)], "count": len(values), "type": kind, **settings}
        if "bufferView" not in settings:
            entry["bufferView"] = self.view(values.tobytes())
        return self.add("accessors", **entry)

    def primitive(self, attributes, indices=None, **settings):
        """{"attributes": ...} of arrays, or of the indices of accessors."""
        named = {name: value if isinstance(value, int) else self.accessor(value) for name, value in attributes.items()}
        if indices is not None:
            settings["indices"] = indices if isinstance(indices, int) else self.accessor(indices)
        return {"attributes": named, **settings}

    def node(self, *primitives, **settings):
        """A node of the scene, with a mesh of the primitives if there are any."""
        if primitives:
            settings["mesh"] = self.add("meshes", primitives=list(primitives))
        index = self.add("nodes", **settings)
        self.json["scenes"][0]["nodes"].append(index)
        return index

    def texture(self, pixels, **settings):
        """A texture of an image within the file."""
        source = self.add("images", bufferView=self.view(encoded(pixels)), mimeType="image/png")
        return self.add("textures", source=source, **settings)

    def material(self, **settings):
        """A material; keys of pbrMetallicRoughness may be given as they are."""
        inner = {key: settings.pop(key) for key in list(settings) if key.startswith(("base", "metallic", "roughness"))}
        return self.add("materials", **({"pbrMetallicRoughness": inner} if inner else {}), **settings)

    def write(self, path):
        """Writes a GLB, or glTF with its buffer as a data URI, by the ending of the path."""
        path.write_bytes(self.glb() if path.suffix == ".glb" else self.gltf())
        return path

    def gltf(self):
        buffers = [{"byteLength": len(self.data), "uri": data_uri(self.data)}]
        return json.dumps({"buffers": buffers, **self.json}).encode()

    def glb(self):
        root = json.dumps({"buffers": [{"byteLength": len(self.data)}], **self.json}).encode()
        root, data = root + b" " * (-len(root) % 4), bytes(self.data) + b"\0" * (-len(self.data) % 4)
        chunks = struct.pack("<II", len(root), 0x4E4F534A) + root + struct.pack("<II", len(data), 0x004E4942) + data
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def quad(attributes=(), indices=QUAD_INDICES, node=(), **settings):
    """A file of one square.

    Args:
        attributes: (name, array) of more attributes, or of others in place of POSITION.
        indices: of its two triangles.
        node: (key, value) of the node.
        settings: of the primitive.
    """
    file = File()
    file.node(file.primitive({"POSITION": QUAD, **dict(attributes)}, indices, **settings), **dict(node))
    return file


def textured_quad(uvs=QUAD_UVS, pixels=None, reference=(), sampler=None, **material):
    """A square with a texture of four colours.

    Args:
        uvs: of TEXCOORD_0: an array, or the settings of an accessor beside it.
        reference: (key, value) of the textureInfo.
        sampler: of the texture.
        material: settings of the material.
    """
    file = File()
    settings = {} if sampler is None else {"sampler": file.add("samplers", **sampler)}
    texture = file.texture(quarters() if pixels is None else pixels, **settings)
    painted = file.material(baseColorTexture={"index": texture, **dict(reference)}, metallicFactor=0, **material)
    coordinates = file.accessor(uvs, normalized=uvs.dtype.kind == "u")
    file.node(file.primitive({"POSITION": QUAD, "TEXCOORD_0": coordinates}, QUAD_INDICES, material=painted))
    return file


def sparse_accessor():
    """All four corners are zeros, of which the sparse part replaces all."""
    file = quad()
    entry = file.json["accessors"][0]
    values, where = file.view(QUAD[::-1].tobytes()), file.view(np.array([3, 2, 1, 0], np.uint8).tobytes())
    del entry["bufferView"]
    entry["sparse"] = {
        "count": 4,
        "indices": {"bufferView": where, "componentType": 5121},
        "values": {"bufferView": values},
    }
    return file


def partly_sparse_accessor():
    """The corner at (1, 1) is moved to (3, 1)."""
    file = quad()
    values, where = file.view(np.array([3, 1, 0], np.float32).tobytes()), file.view(np.array([2], np.uint32).tobytes())
    file.json["accessors"][0]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": where, "componentType": 5125},
        "values": {"bufferView": values},
    }
    return file


def strided_accessors():
    """Positions and normals take turns in one buffer view, after 8 bytes of something else."""
    file = File()
    rows = np.concatenate([QUAD, np.tile(np.float32((0, 0, 1)), (4, 1))], axis=1)
    view = file.view(b"\1" * 8 + rows.tobytes(), byteStride=24)
    places = {"POSITION": 8, "NORMAL": 20}
    attributes = {name: file.accessor(QUAD, bufferView=view, byteOffset=start) for name, start in places.items()}
    file.node(file.primitive(attributes, QUAD_INDICES))
    return file


def required_extension(name):
    file = quad()
    file.json["extensionsUsed"] = file.json["extensionsRequired"] = [name]
    return file


def compressed_by_draco():
    """The accessors have no data: they are in the extension."""
    file = required_extension("KHR_draco_mesh_compression")
    for entry in file.json["accessors"]:
        del entry["bufferView"]
    extension = {"bufferView": file.view(b"DRACO of a square"), "attributes": {"POSITION": 7, "COLOR_0": 9}}
    primitive = file.json["meshes"][0]["primitives"][0]
    primitive["attributes"]["COLOR_0"] = file.add("accessors", componentType=5121, count=4, type="VEC4", normalized=True)
    primitive["extensions"] = {"KHR_draco_mesh_compression": extension}
    return file


def compressed_by_meshopt(required=True):
    """The second buffer has no bytes: they are in the first one, compressed."""
    file = required_extension("EXT_meshopt_compression") if required else quad()
    view = file.json["bufferViews"][0]
    packed = {"buffer": 0, "byteOffset": 0, "byteLength": 30, "byteStride": 12, "count": 4, "mode": "ATTRIBUTES"}
    view |= {"buffer": 1, "extensions": {"EXT_meshopt_compression": packed}}
    size = len(file.data)
    file.json["buffers"] = [
        {"byteLength": size, "uri": data_uri(file.data)},
        {"byteLength": 48, "extensions": {"EXT_meshopt_compression": {"fallback": True}}},
    ]
    return file


def strip():
    file = File()
    file.node(file.primitive({"POSITION": QUAD[[0, 1, 3, 2]]}, mode=5))
    return file


def fan():
    file = File()
    file.node(file.primitive({"POSITION": QUAD}, mode=6))
    return file


def normalized_positions():
    """int16: -32767 is -1 and 32767 is 1; the node makes it three times as wide and high."""
    codes = (QUAD * 32767).astype(np.int16)
    file = File()
    file.node(file.primitive({"POSITION": file.accessor(codes, normalized=True)}, QUAD_INDICES), scale=[3, 3, 1])
    return file


def skin_at_rest():
    """Two joints, of which the first is at (5, 0, 0) and has all weights. The node of the mesh is somewhere else."""
    file = File()
    joints, weights = np.zeros((4, 4), np.uint8), np.tile(np.float32((1, 0, 0, 0)), (4, 1))
    primitive = file.primitive({"POSITION": QUAD, "JOINTS_0": joints, "WEIGHTS_0": weights}, QUAD_INDICES)
    file.node(primitive, translation=[0, 50, 0], skin=0)
    inverse = np.tile(np.eye(4, dtype=np.float32), (2, 1, 1))
    inverse[0, 3, :3] = (-1, 0, 0)  # column by column: moves by -1 along x
    bones = [file.node(translation=[6, 0, 0]), file.node(translation=[-9, 0, 0])]
    file.add("skins", joints=bones, inverseBindMatrices=file.accessor(inverse.reshape(2, 16)))
    return file


def bent_skin():
    """The lower two corners follow a joint that stays, the upper ones half of one that is moved by (4, 0, 0) and turned."""
    file = File()
    joints = np.tile(np.array((0, 1, 0, 0), np.uint16), (4, 1))
    weights = np.array([(255, 0, 0, 0), (255, 0, 0, 0), (100, 100, 0, 0), (100, 100, 0, 0)], np.uint8)
    attributes = {"POSITION": QUAD, "NORMAL": np.tile(np.float32((0, 0, 1)), (4, 1)), "JOINTS_0": joints}
    attributes["WEIGHTS_0"] = file.accessor(weights, normalized=True)
    file.node(file.primitive(attributes, QUAD_INDICES), skin=0)
    file.add("skins", joints=[file.node(), file.node(translation=[4, 0, 0])])
    return file


def morphed(of_node=None):
    """Two targets; by default all of the first one, which moves the square by (2, 0, 0), and half of none."""
    file = File()
    moves = [file.accessor(np.tile(np.float32(move), (4, 1))) for move in ((2, 0, 0), (0, 8, 0))]
    file.node(file.primitive({"POSITION": QUAD}, QUAD_INDICES, targets=[{"POSITION": move} for move in moves]))
    file.json["meshes"][0]["weights"] = [1, 0]
    if of_node is not None:
        file.json["nodes"][0]["weights"] = of_node
    return file


def instanced():
    """The square three times: as it is, moved and mirrored, turned by half a turn about z and moved."""
    file = quad()
    attributes = {
        "TRANSLATION": file.accessor(np.array([(0, 0, 0), (10, 0, 0), (0, 10, 0)], np.float32)),
        "ROTATION": file.accessor(np.array([(0, 0, 0, 127), (0, 0, 0, 127), (0, 0, 127, 0)], np.int8), normalized=True),
        "SCALE": file.accessor(np.array([(1, 1, 1), (-2, 1, 1), (1, 3, 1)], np.float32)),
    }
    file.json["nodes"][0]["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": attributes}}
    return file


def below_a_camera():
    """A node with a camera has a child with a square."""
    file = quad(node={"translation": [0, 0, 1]})
    file.add("cameras", type="perspective", perspective={"yfov": np.pi / 4, "znear": 0.5, "zfar": 9})
    file.json["scenes"][0]["nodes"] = [file.add("nodes", camera=0, translation=[2, 0, 0], scale=[2, 2, 2], children=[0])]
    return file


def shared_accessors(count=300, nodes=False):
    """``count`` squares with normals in one accessor, a primitive for each: all in one mesh, or each in a node of its own."""
    file = File()
    corners = np.concatenate([QUAD + np.float32((3 * i, 0, 0)) for i in range(count)])
    shared = {"POSITION": file.accessor(corners), "NORMAL": file.accessor(np.tile(np.float32((0, 0, 1)), (4 * count, 1)))}
    primitives = [file.primitive(shared, (QUAD_INDICES + 4 * i).astype(np.uint16)) for i in range(count)]
    if nodes:
        for i, primitive in enumerate(primitives):
            file.node(primitive, translation=[0, i, 0])
    else:
        file.node(*primitives)
    return file


def shared_texture(count=40):
    """``count`` squares, each a mesh of its own, all of one material with a texture."""
    file = textured_quad()
    primitive = file.json["meshes"][0]["primitives"][0]
    for i in range(1, count):
        file.node(primitive, translation=[0, 0, -i])
    return file

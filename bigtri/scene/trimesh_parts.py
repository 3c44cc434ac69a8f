"""trimesh's geometry as scenes of one material each: transforms, colours, textures and normals in bigtri's conventions."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..reference.shading import decode_table
from .camera import Vector, affine
from .normals import is_closed, split_normals
from .scene import Material, Scene

# For geometry that says nothing about its colour: linear, a light grey.
_GREY: Vector = (0.6, 0.6, 0.6)


class ModelError(ValueError):
    """What a model holds cannot be drawn, or trimesh cannot work it out. Never a fault of bigtri's own code."""


@contextmanager
def asking_trimesh() -> Iterator[None]:
    """Turn whatever is raised into a ModelError, for code that reads from trimesh and does nothing else.

    trimesh works much out only when it is asked for, and a broken file breaks that in any way.
    """
    try:
        yield
    except ModelError:
        raise
    except Exception as error:
        raise ModelError(_reason(error)) from error


def _reason(error: Exception) -> str:
    """What an error says in one line; its kind, where it says nothing that a reader would understand."""
    text = " ".join(str(error).split())
    if isinstance(error, ValueError | OSError) and text:
        return text
    return f"{type(error).__name__}: {text}".removesuffix(": ")


class _Paint(NamedTuple):
    """A material of trimesh's."""

    name: str | None
    factor: NDArray[np.uint8] | None  # [3], the base colour
    is_linear: bool  # whether the factor is; otherwise it is sRGB
    image: NDArray[np.uint8] | None  # [Ht, Wt, 3], sRGB
    double_sided: bool


class _Mesh(NamedTuple):
    """All that is read of a mesh of trimesh's, of the shapes given here."""

    name: str
    transform: NDArray[np.float64]  # [4, 4]
    vertices: NDArray[np.float64]  # [V, 3]
    faces: NDArray[np.int64]  # [T, 3], indices into the vertices; T > 0
    normals: NDArray[np.float64] | None  # [V, 3], those of the file
    uvs: NDArray[np.float32] | None  # [V, 2]
    colors: NDArray[np.uint8] | None  # [V, 3], or [T, 3] with colors_of_faces
    colors_of_faces: bool
    paint: _Paint | None


def parts_of(loaded: Any, linear_colors: bool) -> list[Scene]:
    """One scene per node that holds triangles, in the order of the scene graph; see ``scene.from_trimesh``.

    Raises:
        ModelError: trimesh fails, or gives what cannot be drawn.
    """
    return [_part(mesh, linear_colors) for mesh in _meshes(loaded)]


def _meshes(loaded: Any) -> Iterator[_Mesh]:
    import trimesh

    with asking_trimesh():
        if isinstance(loaded, trimesh.Trimesh):
            nodes = [("mesh", np.eye(4), loaded)]
        else:
            placed = [loaded.graph[node] for node in loaded.graph.nodes_geometry]
            nodes = [(str(name), np.asarray(matrix, np.float64), loaded.geometry[name]) for matrix, name in placed]
        meshes = [node for node in nodes if isinstance(node[2], trimesh.Trimesh) and len(node[2].faces)]
    for name, transform, mesh in meshes:
        with asking_trimesh():
            read = _read(name, transform, mesh)
        yield read


def _read(name: str, transform: NDArray[np.float64], mesh: Any) -> _Mesh:
    vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces)
    # trimesh hands on what a file says.
    _check_shape(name, "vertices", vertices, "V", 3)
    _check_shape(name, "faces", faces, "T", 3)
    if not (faces.min() >= 0 and faces.max() < len(vertices)):
        raise ModelError(
            f"{name}: faces must index the {len(vertices)} vertices, got indices from {faces.min()} to {faces.max()}"
        )
    uvs = _uvs(mesh)
    colors, of_faces = _colors(mesh)
    paint = _paint(mesh)
    normals = None
    # trimesh computes normals on demand and keeps them in the same place as those from the file. Nothing has asked for
    # them yet.
    if "vertex_normals" in mesh._cache.cache:
        normals = np.asarray(mesh.vertex_normals, np.float64)
    _check_shape(name, "transform", transform, 4, 4)
    _check_shape(name, "texture coordinates", uvs, len(vertices), 2)
    _check_shape(name, "colors", colors, len(faces) if of_faces else len(vertices), 3)
    _check_shape(name, "vertex normals", normals, len(vertices), 3)
    if paint is not None:
        _check_shape(name, "the base color", paint.factor, 3)
        _check_shape(name, "the texture", paint.image, "Ht", "Wt", 3)
    return _Mesh(name, transform, vertices, faces, normals, uvs, colors, of_faces, paint)


def _check_shape(owner: str, name: str, value: NDArray[Any] | None, *shape: int | str) -> None:
    """Raise ModelError unless an array, where there is one, has the shape; a letter stands for any size but 0."""
    if value is None:
        return
    fits = value.ndim == len(shape) and all(
        size > 0 if isinstance(wanted, str) else size == wanted for wanted, size in zip(shape, value.shape, strict=True)
    )
    if not fits:
        raise ModelError(f"{owner}: {name} must be [{', '.join(map(str, shape))}], got {list(value.shape)}")


def _part(mesh: _Mesh, linear_colors: bool) -> Scene:
    transform = mesh.transform
    positions = np.stack([affine(row, mesh.vertices) for row in transform[:3]], axis=1).astype(np.float32)
    triangles = mesh.faces.astype(np.int32)
    # A mirrored node would show its back faces.
    mirrored = np.linalg.det(transform[:3, :3]) < 0
    if mirrored:
        triangles = np.ascontiguousarray(triangles[:, ::-1])
    uvs = mesh.uvs
    colors = None if mesh.colors is None else _linear(mesh.colors, linear_colors)
    material = _material(mesh, two_sided=not is_closed(positions, triangles))

    per_face = colors is not None and mesh.colors_of_faces
    if colors is not None and per_face:
        # Faces of different colours share no vertex.
        corners = triangles.reshape(-1)
        positions, uvs = positions[corners], None if uvs is None else uvs[corners]
        colors = np.repeat(colors, 3, axis=0)
        triangles = np.arange(len(corners), dtype=np.int32).reshape(-1, 3)

    source: Any = slice(None)
    if mesh.normals is not None and not per_face:
        normals = _transformed_normals(mesh.normals, transform)
    else:
        source, triangles, normals = split_normals(positions, triangles)
    return Scene(
        positions=positions[source],
        triangles=triangles,
        normals=normals,
        uvs=None if uvs is None else uvs[source],
        colors=None if colors is None else colors[source],
        materials=(material,),
    )


def _transformed_normals(normals: NDArray[np.float64], transform: NDArray[np.float64]) -> NDArray[np.float32]:
    """By the inverse transpose: the cofactors over the determinant, of which only the sign matters, for the length is made 1."""
    a, b, c = transform[:3, 0], transform[:3, 1], transform[:3, 2]
    cofactors = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
    cofactors = cofactors * np.sign(np.dot(a, cofactors[:, 0]))
    x, y, z = normals[:, 0], normals[:, 1], normals[:, 2]
    turned = np.stack([(row[0] * x + row[1] * y) + row[2] * z for row in cofactors], axis=1)
    length = np.sqrt((turned[:, 0] * turned[:, 0] + turned[:, 1] * turned[:, 1]) + turned[:, 2] * turned[:, 2])[:, None]
    return np.divide(turned, length, out=np.zeros_like(turned), where=length > 0).astype(np.float32)


def _uvs(mesh: Any) -> NDArray[np.float32] | None:
    """trimesh hands out (0, 0) at the lower left whatever the file's own convention, glTF's included."""
    uv = getattr(mesh.visual, "uv", None)
    if uv is None or len(uv) != len(mesh.vertices):
        return None
    return np.ascontiguousarray(np.asarray(uv)[:, :2], np.float32)


def _colors(mesh: Any) -> tuple[NDArray[np.uint8] | None, bool]:
    """Colours [V, 3], or [T, 3] and True where they belong to faces; None where there are none."""
    visual = mesh.visual
    kind = getattr(visual, "kind", None)
    if kind == "vertex":
        codes = visual.vertex_colors
    elif kind == "face":
        codes = visual.face_colors
    else:
        codes = getattr(visual, "vertex_attributes", {}).get("color")
    if codes is None or len(codes) == 0:
        return None, False
    codes = np.asarray(codes)[:, :3]
    if codes.dtype.kind == "f":
        codes = np.rint(np.clip(codes, 0, 1) * 255)
    elif codes.dtype == np.uint16:
        codes = codes >> 8
    return codes.astype(np.uint8), kind == "face"


def _paint(mesh: Any) -> _Paint | None:
    source = getattr(mesh.visual, "material", None)
    if source is None:
        return None
    if hasattr(source, "baseColorFactor"):
        # glTF's factors are linear; trimesh keeps them as 8 bits.
        factor, image, is_linear = source.baseColorFactor, source.baseColorTexture, True
        double_sided = bool(source.doubleSided)
    else:
        factor, image, is_linear, double_sided = source.diffuse, source.image, False, False
    return _Paint(
        str(source.name) if source.name else None,
        None if factor is None else np.asarray(factor, np.uint8)[:3],
        is_linear,
        None if image is None else np.asarray(image.convert("RGB")),
        double_sided,
    )


def _material(mesh: _Mesh, two_sided: bool) -> Material:
    paint, has_colors = mesh.paint, mesh.colors is not None
    if paint is None:
        base = (1.0, 1.0, 1.0) if has_colors else _GREY
        return Material(mesh.name, base, vertex_colors=has_colors, two_sided=two_sided)
    base_color = np.ones(3, np.float32) if paint.factor is None else _linear(paint.factor, paint.is_linear)
    return Material(
        paint.name or mesh.name,
        tuple(base_color.tolist()),
        texture=paint.image,
        vertex_colors=has_colors,
        two_sided=two_sided or paint.double_sided,
    )


def _linear(codes: NDArray[np.uint8], linear: bool) -> NDArray[np.float32]:
    return codes.astype(np.float32) / np.float32(255) if linear else decode_table()[codes]

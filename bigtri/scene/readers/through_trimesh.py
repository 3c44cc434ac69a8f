"""trimesh's geometry as a ``Model``, in bigtri's conventions: what trimesh created, or loaded of formats that bigtri does not."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...reference.shading import decode_table
from .model import Mesh, Model, ModelError, Paint


def model_of(loaded: Any, linear_colors: bool) -> Model:
    """One mesh for every node that holds triangles, in the order of the scene graph; see ``scene.from_trimesh``.

    Raises:
        ModelError: trimesh fails, or gives what cannot be drawn.
    """
    import trimesh

    with asking_trimesh():
        if isinstance(loaded, trimesh.Trimesh):
            nodes = [("mesh", np.eye(4), loaded)]
        else:
            placed = [loaded.graph[node] for node in loaded.graph.nodes_geometry]
            nodes = [(str(name), np.asarray(matrix, np.float64), loaded.geometry[name]) for matrix, name in placed]
        meshes = [node for node in nodes if isinstance(node[2], trimesh.Trimesh) and len(node[2].faces)]
        return Model([_read(number, *node, linear_colors) for number, node in enumerate(meshes)])


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


def _read(number: int, name: str, transform: NDArray[np.float64], mesh: Any, linear_colors: bool) -> Mesh:
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
    normals = None
    # trimesh computes normals on demand and keeps them in the same place as those from the file. Nothing has asked for
    # them yet.
    if "vertex_normals" in mesh._cache.cache:
        normals = np.asarray(mesh.vertex_normals, np.float64)
    _check_shape(name, "transform", transform, 4, 4)
    _check_shape(name, "texture coordinates", uvs, len(vertices), 2)
    _check_shape(name, "colors", colors, len(faces) if of_faces else len(vertices), 3)
    _check_shape(name, "vertex normals", normals, len(vertices), 3)
    return Mesh(
        name,
        vertices,
        faces.astype(np.int32),
        normals,
        uvs,
        None if colors is None else _linear(colors, linear_colors),
        of_faces,
        _paint(name, mesh),
        transform[None],
        np.array([number], np.int32),
    )


def _check_shape(owner: str, name: str, value: NDArray[Any] | None, *shape: int | str) -> None:
    """Raise ModelError unless an array, where there is one, has the shape; a letter stands for any size but 0."""
    if value is None:
        return
    fits = value.ndim == len(shape) and all(
        size > 0 if isinstance(wanted, str) else size == wanted for wanted, size in zip(shape, value.shape, strict=True)
    )
    if not fits:
        raise ModelError(f"{owner}: {name} must be [{', '.join(map(str, shape))}], got {list(value.shape)}")


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


def _paint(name: str, mesh: Any) -> Paint | None:
    source = getattr(mesh.visual, "material", None)
    if source is None:
        return None
    if hasattr(source, "baseColorFactor"):
        # glTF's factors are linear; trimesh keeps them as 8 bits.
        factor, image, is_linear = source.baseColorFactor, source.baseColorTexture, True
        double_sided = bool(source.doubleSided)
    else:
        factor, image, is_linear, double_sided = source.diffuse, source.image, False, False
    base_color = np.ones(3, np.float32)
    if factor is not None:
        codes = np.asarray(factor, np.uint8)[:3]
        _check_shape(name, "the base color", codes, 3)
        base_color = _linear(codes, is_linear)
    texture = None if image is None else np.array(image.convert("RGB"))
    _check_shape(name, "the texture", texture, "Ht", "Wt", 3)
    red, green, blue = base_color.tolist()
    return Paint(str(source.name) if source.name else "", (red, green, blue), texture, double_sided=double_sided)


def _linear(codes: NDArray[np.uint8], linear: bool) -> NDArray[np.float32]:
    return codes.astype(np.float32) / np.float32(255) if linear else decode_table()[codes]

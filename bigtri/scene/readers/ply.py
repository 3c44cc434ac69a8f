"""PLY, ASCII and binary, as a ``Model``."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..rows import unify
from .colors import linear_colors
from .files import read_texture
from .model import Mesh, Model, ModelError, Paint
from .ply_elements import Element, Lists, read_elements
from .polygons import indices_of, triangulate

# Names that exporters give to the same thing, the most usual ones first.
_INDICES = ("vertex_indices", "vertex_index")
_UVS = (("texture_u", "texture_v"), ("u", "v"), ("s", "t"), ("texture_s", "texture_t"))
_COLORS = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
# Elements that are read, or noted by what they are.
_KNOWN = ("vertex", "face", "tristrips", "edge")


@np.errstate(over="ignore", invalid="ignore")
def read(path: Path) -> Model:
    """The faces of a PLY file, or else its triangle strips.

    Raises:
        ModelError: the file is broken; the text says where.
    """
    model = Model()
    elements, comments = read_elements(path.read_bytes())
    named = {element.name: element for element in reversed(elements)}
    vertex, face, strips = (named.get(name, Element(name, 0)) for name in ("vertex", "face", "tristrips"))
    _note_what_is_not_drawn(model, elements)
    positions = _stacked(vertex, [("x", "y", "z")])
    if positions is None:
        raise ModelError(f"element vertex must have the properties x, y and z, got {', '.join(vertex.columns) or 'none'}")
    normals, uvs, colors = _stacked(vertex, [("nx", "ny", "nz")]), _stacked(vertex, _UVS), _colors(model, vertex)
    of_face: Any = slice(None)  # the face that each triangle is a part of
    if face.count:
        triangles, of_face, texcoords = _faces(model, face, positions)
        if texcoords is not None:
            # Vertices are told apart by their texture coordinates, too.
            corners = triangles.reshape(-1)
            first, kinds = unify([corners, *(texcoords.T + np.float32(0)).copy().view(np.int32)])
            source = corners[first]
            positions, triangles, uvs = positions[source], kinds.reshape(-1, 3), texcoords[first]
            normals, colors = (None if values is None else values[source] for values in (normals, colors))
    else:
        triangles = _strips(strips, len(positions))
    if not len(triangles) and len(positions):
        model.found("points", f"there are {len(positions)} points and no faces: points are not drawn")
    face_colors = _colors(model, face)
    if colors is not None and face_colors is not None:
        model.found("colors of faces", "vertices and faces have colours: those of vertices are drawn")
        face_colors = None

    paints = [_paint(model, path.parent, name) for name in _texture_files(comments)] or [None]
    texture = _texture_numbers(model, face, len(paints))
    parts: list[tuple[Paint | None, Any]] = [(paints[0], slice(None))]
    if texture is not None:
        parts = [(paint, texture[of_face] == number) for number, paint in (*enumerate(paints), (-1, None))]
    for paint, here in parts:
        model.meshes.append(
            Mesh(
                path.name,
                positions,
                triangles[here],
                normals,
                None if uvs is None else uvs.astype(np.float32, copy=False),
                colors if face_colors is None else face_colors[of_face][here],
                face_colors is not None,
                paint,
            )
        )
    return model


def _faces(model: Model, face: Element, positions: NDArray[Any]) -> tuple[NDArray[np.int32], Any, NDArray[np.float32] | None]:
    """Triangles [T, 3]; the index of the face of each, [T] or all of them; float32 [3T, 2] of their corners, or None."""
    indices = _indices(face)
    corners = indices_of("faces", indices.values, len(positions))
    texcoords = _texcoords(model, face, indices.lengths)
    if (indices.lengths == 3).all():
        return corners.reshape(-1, 3), slice(None), texcoords
    corner, of_face = triangulate(model, positions, corners, indices.lengths)
    return corners[corner], of_face, None if texcoords is None else texcoords[corner.reshape(-1)]


def _indices(element: Element) -> Lists:
    lists = {name: column for name, column in element.columns.items() if isinstance(column, Lists)}
    for name in (*_INDICES, *(lists if len(lists) == 1 else ())):
        if name in lists:
            return lists[name]
    raise ModelError(f"element {element.name} must have the list vertex_indices, got {', '.join(element.columns) or 'none'}")


def _texcoords(model: Model, face: Element, count: NDArray[np.int64]) -> NDArray[np.float32] | None:
    """float32 [C, 2], of each corner of each face."""
    lists = face.columns.get("texcoord")
    if not isinstance(lists, Lists) or not lists.lengths.any():
        return None
    if np.array_equal(lists.lengths, 2 * count):
        return lists.values.astype(np.float32).reshape(-1, 2)
    fits = lists.lengths == 2 * count
    model.found(
        "texture coordinates of faces",
        f"{int((~fits).sum())} faces do not have two texture coordinates for each corner: 0 is taken for theirs",
    )
    texcoords = np.zeros((int(count.sum()), 2), np.float32)
    texcoords[np.repeat(fits, count)] = lists.values[np.repeat(fits, lists.lengths)].reshape(-1, 2)
    return texcoords


def _strips(strips: Element, size: int) -> NDArray[np.int32]:
    """Triangles [T, 3] of strips of indices, which -1 ends; every other triangle of a strip is turned round."""
    if not strips.count:
        return np.zeros((0, 3), np.int32)
    lists = _indices(strips)
    # Each list ends a strip as well.
    values = np.insert(lists.values.astype(np.int64), np.cumsum(lists.lengths), -1)
    indices_of("tristrips", values[values != -1], size)
    begin = np.maximum.accumulate(np.where(values == -1, np.arange(len(values)) + 1, 0))
    triangles = np.stack([values[:-2], values[1:-1], values[2:]], axis=1) if len(values) > 2 else np.zeros((0, 3), np.int64)
    odd = (np.arange(len(triangles)) - begin[: len(triangles)]) % 2 == 1
    triangles[odd] = triangles[odd][:, (1, 0, 2)]
    return triangles[(triangles >= 0).all(axis=1)].astype(np.int32)


def _stacked(element: Element, choices: Any) -> NDArray[Any] | None:
    """[count, n] of the first names of which the element has all: float32 where the file has that, else float64; or None."""
    for names in choices:
        columns = [element.columns.get(name) for name in names]
        if all(isinstance(column, np.ndarray) for column in columns):
            single = all(column.dtype.newbyteorder("=") == np.float32 for column in columns)  # type: ignore[union-attr]
            stacked = np.empty((element.count, len(columns)), np.float32 if single else np.float64)
            for i, column in enumerate(columns):
                stacked[:, i] = column
            return stacked
    return None


def _colors(model: Model, element: Element) -> NDArray[np.float32] | None:
    """float32 [count, 3], linear."""
    for names in _COLORS:
        columns = [element.columns.get(name) for name in names]
        if all(isinstance(column, np.ndarray) for column in columns):
            _note_transparency(model, element)
            return linear_colors(model, np.stack(columns, axis=1), element.type_of(names[0]))  # type: ignore[arg-type]
    return None


def _note_transparency(model: Model, element: Element) -> None:
    alpha = element.columns.get("alpha")
    if not isinstance(alpha, np.ndarray) or not len(alpha):
        return
    opaque = {"u1": 255, "u2": 65535}.get(element.type_of("alpha"), 1)
    if alpha.min() < opaque:
        model.found("transparency", "colours have an alpha below 1: they are drawn opaque")


def _texture_numbers(model: Model, face: Element, size: int) -> NDArray[np.int64] | None:
    """[count]: the number of the texture of each face, of ``size`` textures, -1 for none; or None: all have the first one."""
    numbers = face.columns.get("texnumber")
    if not isinstance(numbers, np.ndarray) or not len(numbers):
        if size > 1:
            model.found("several textures", f"there are {size} textures and no texnumber: the first one is drawn")
        return None
    if not (numbers.min() >= -1 and numbers.max() < size):
        got = f"{numbers.min():.0f} to {numbers.max():.0f}"
        raise ModelError(f"texnumber must be that of one of the {size} textures, or -1 for none, got {got}")
    return numbers.astype(np.int64)


def _texture_files(comments: list[str]) -> list[str]:
    found = (re.match(r"texturefile\s+(.*)", comment, re.IGNORECASE) for comment in comments)
    return [match.group(1).strip() for match in found if match]


def _paint(model: Model, folder: Path, name: str) -> Paint | None:
    texture = read_texture(model, folder, name)
    return None if texture is None else Paint(name, texture=texture)


def _note_what_is_not_drawn(model: Model, elements: list[Element]) -> None:
    cut = [element for element in elements if element.count < element.announced]
    if cut:
        where = f"the file ends within element {cut[0].name}"
        what = f"{where}: {cut[0].announced} rows are announced, {cut[0].count} are there"
        if any(element.name == "vertex" for element in cut):
            raise ModelError(what)
        model.found("truncated file", f"{what} and drawn")
    for element in elements:
        if element.name == "edge" and element.count:
            model.found("lines", f"there are {element.count} edges: lines are not drawn")
        elif element.name not in _KNOWN and element.count:
            model.found("other elements", f"element {element.name} is not read")

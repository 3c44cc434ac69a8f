"""Wavefront OBJ, with its material libraries, as a ``Model``."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..rows import unify
from .colors import linear_colors
from .files import find
from .model import Mesh, Model
from .mtl import Library, Look
from .obj_lines import Lines
from .polygons import triangulate

# By keyword, what is not drawn.
_NOT_DRAWN = {"p": "points", "l": "lines", "curv": "free-form curves", "surf": "free-form surfaces"}
# What belongs to curves and surfaces, or changes nothing of polygons. All others are named.
_WITHOUT_EFFECT = (
    *("vp", "cstype", "deg", "bmat", "step", "parm", "trim", "hole", "scrv", "sp", "end", "con", "curv2", "ctech", "stech"),
    *("mg", "bevel", "c_interp", "d_interp", "lod", "shadow_obj", "trace_obj"),
)
# The names of libraries on one line, which may have spaces in them.
_LIBRARY_NAME = re.compile(r'"[^"]+"|\S.*?\.mtl(?!\S)|\S+', re.IGNORECASE)


class _Vertices(NamedTuple):
    """What the lines of a file give, before faces refer to it."""

    positions: NDArray[np.float64]  # [V, 3]
    colors: NDArray[np.float32] | None  # [V, 3], linear
    uvs: NDArray[np.float64]  # [*, 2]
    normals: NDArray[np.float64]  # [*, 3]


@np.errstate(over="ignore", invalid="ignore")
def read(path: Path) -> Model:
    """The faces of an OBJ file: one mesh for each material, in the order in which the file first uses them.

    Every object is an instance, or every group where there are no objects. Smoothing groups are not told apart. Faces of one
    material share a vertex where all their indices are the same. Where one of them lacks normals, they have none.

    Raises:
        ModelError: the file is broken; the text says where.
    """
    model = Model()
    lines = Lines(path.read_bytes())
    vertices = _vertices(model, lines)
    sizes = {"v": len(vertices.positions), "vt": len(vertices.uvs), "vn": len(vertices.normals)}
    corners, count, dangling = lines.corners(sizes)
    if dangling:
        model.found("dangling indices", f"{dangling} indices of texture coordinates or normals lead nowhere: they are left out")
    corner, polygon = triangulate(model, vertices.positions, corners[:, 0], count)
    names, looks, of_face = _materials(model, lines, path.parent)
    material = of_face[polygon]
    instance = _instances(lines)
    used, first = np.unique(material, return_index=True)
    for number in used[np.argsort(first)].tolist():
        own = material == number
        mesh = _mesh(model, names[number] or path.name, looks[number], vertices, corners[corner[own].reshape(-1)])
        model.meshes.append(mesh if instance is None else replace(mesh, instances=instance[polygon[own]][None]))
    if not len(material) and len(vertices.positions):
        model.found("points", f"there are {len(vertices.positions)} points and no faces: points are not drawn")
    return model


def _vertices(model: Model, lines: Lines) -> _Vertices:
    numbers, count = lines.floats("v", 3)
    begin = np.cumsum(count) - count
    positions = numbers[begin[:, None] + np.arange(3)]
    colors = None
    # x y z w has a weight, which polygons do not use; x y z r g b a colour.
    colored = count >= 6
    if colored.any():
        codes = np.ones((len(count), 3))
        codes[colored] = numbers[begin[colored, None] + np.arange(3, 6)]
        colors = linear_colors(model, codes, "f8")
    uvs, count = lines.floats("vt", 1)
    begin = np.cumsum(count) - count
    # Of u alone, v is 0.
    uvs = np.stack([uvs[begin], np.where(count > 1, uvs[np.minimum(begin + 1, len(uvs) - 1)], 0)], axis=1)
    normals, count = lines.floats("vn", 3)
    begin = np.cumsum(count) - count
    return _Vertices(positions, colors, uvs, normals[begin[:, None] + np.arange(3)])


def _materials(model: Model, lines: Lines, folder: Path) -> tuple[list[str], list[Look | None], NDArray[np.int64]]:
    """Names of materials, "" where none is named; how they look, as far as known; int64 [F], the material of each face.

    Notes what stands in other lines and is not drawn.
    """
    library = Library(model, folder)
    numbers, begins, of_line = {"": 0}, [-1], [0]
    known: dict[str, Look] = {}
    for line in lines.kinds[""].tolist():
        keyword, _, rest = lines.words(line).replace("\t", " ").partition(" ")
        rest = rest.strip()
        if keyword == "usemtl":
            begins.append(line)
            of_line.append(numbers.setdefault(rest, len(numbers)))
        elif keyword == "mtllib":
            # One name with spaces in it, or several names. What an earlier library has stays.
            for name in [rest] if find(folder, rest) else _LIBRARY_NAME.findall(rest):
                path = find(folder, name)
                if path is None:
                    model.found("missing material libraries", f"the material library {name} is not there: it is drawn without")
                else:
                    known = {**library.read(path), **known}
        elif keyword in _NOT_DRAWN:
            model.found(_NOT_DRAWN[keyword], f"there are {_NOT_DRAWN[keyword]}: they are not drawn")
        elif keyword not in _WITHOUT_EFFECT:
            model.found("unknown lines", f"line {line + 1} begins with {keyword[:40]!r}, which is not read")
    for name in numbers:
        if name and name not in known:
            model.found("missing materials", f"the material {name} is in no material library: it is drawn grey")
    # The material of a face is the one named last before it.
    of_face = np.array(of_line)[np.searchsorted(begins, lines.kinds["f"]) - 1]
    return list(numbers), [known.get(name) for name in numbers], of_face


def _instances(lines: Lines) -> NDArray[np.int32] | None:
    """int32 [F], the object of each face, numbered by those that have any; None where no two are told apart."""
    if len(lines.objects) == 0:
        return None
    begun = np.searchsorted(lines.objects, lines.kinds["f"])
    return np.concatenate([[0], np.cumsum(begun[1:] != begun[:-1])]).astype(np.int32)


def _mesh(model: Model, name: str, look: Look | None, vertices: _Vertices, corners: NDArray[np.int32]) -> Mesh:
    """The mesh of corners [3 T, 3]: the position, texture coordinates and normal of each, -1 where there are none."""
    has_uvs, has_normals = bool((corners[:, 1] >= 0).any()), bool((corners[:, 2] >= 0).all())
    columns = [corners[:, i].copy() for i, wanted in enumerate((True, has_uvs, has_normals)) if wanted]
    if len(columns) > 1:
        first, triangles = unify(columns)
    else:
        first, triangles = _first_uses(columns[0], len(vertices.positions))
    position, uv, normal = corners[first].T
    uvs = None
    if has_uvs:
        uvs = vertices.uvs[uv]
        if look is not None:
            uvs = uvs * look.scale + look.offset
        uvs = uvs.astype(np.float32)
        uvs[uv < 0] = 0
        if look is not None and look.paint.texture is not None and (uv < 0).any():
            text = f"faces of the material {name} have no coordinates for its texture: 0 is taken for them"
            model.found("faces without texture coordinates", text)
    return Mesh(
        name,
        vertices.positions[position],
        triangles.reshape(-1, 3),
        vertices.normals[normal] if has_normals else None,
        uvs,
        None if vertices.colors is None else vertices.colors[position],
        paint=None if look is None else look.paint,
    )


def _first_uses(vertices: NDArray[np.int32], size: int) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """What ``unify`` gives of one column of numbers below ``size``, without sorting."""
    use = np.full(size, -1, np.int64)
    use[vertices] = np.arange(len(vertices))
    used = use >= 0
    return use[used], (np.cumsum(used, dtype=np.int32) - np.int32(1))[vertices]

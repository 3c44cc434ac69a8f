"""A ``Model`` as a ``Scene``: everything placed in world space, with normals and materials."""

from __future__ import annotations

from collections import Counter
from itertools import groupby, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..camera import Vector
from ..normals import is_closed, split_normals
from ..origin import WORLD_ORIGIN, bounds_of, origin_for
from ..scene import Material, Scene, merge
from .model import Mesh, Model, ModelError, Paint
from .transforms import mirrors, placed, turned

# For geometry that says nothing about its colour: linear, a light grey.
_GREY: Vector = (0.6, 0.6, 0.6)
_WHITE: Vector = (1.0, 1.0, 1.0)
_MOST = 2**31 - 1  # int32 counts vertices and triangles


# A point beyond float32's range becomes an infinity, and rasterize drops and counts its triangles.
@np.errstate(over="ignore", invalid="ignore")
def assemble(model: Model) -> Scene:
    """The scene of a model: every mesh at every place.

    Vertex normals are computed where the model has none, with a crease of 50 degrees. Surfaces that do not enclose a solid,
    or that the model calls double-sided, are lit from both sides. Meshes with the same vertices in the same place share
    them, and an image is one array however many materials have it. Positions are counted from an origin that ``origin_for``
    chooses by the boxes around the meshes, so that a model with map coordinates keeps its form.

    Raises:
        ModelError: there are no triangles, or more than int32 counts.
    """
    meshes = [mesh for mesh in model.meshes if len(mesh.triangles)]
    if not meshes:
        others = f"; found: {', '.join(model.findings)}" if model.findings else ""
        raise ModelError(f"there are no triangles in it: point clouds and lines are not drawn{others}")
    if (count := sum(len(mesh.triangles) * len(mesh.transforms) for mesh in meshes)) > _MOST:
        raise ModelError(f"there must be at most {_MOST} triangles in it, got {count}")
    materials = _Materials()
    groups = [list(group) for _, group in groupby(meshes, _shared_vertices)]
    places = Counter(id(group[0].positions) for group in groups for _ in group[0].transforms)
    origin = _origin(meshes)
    parts = []
    for group in groups:
        # What a vertex array has for others is left out.
        several = places[id(group[0].positions)] > 1
        parts += [_part(group, transform, origin, several, materials) for transform in group[0].transforms]
    for part in parts:
        if not np.isfinite(part.positions).all():
            model.found("positions beyond float32", "positions are not finite, or beyond float32: their triangles are not drawn")
    return parts[0] if len(parts) == 1 else merge(parts)


def _origin(meshes: list[Mesh]) -> Vector:
    """Where positions are counted from: ``origin_for`` the boxes around the meshes, each at all its places."""
    boxes: dict[int, NDArray[np.float64] | None] = {}
    corners = [np.zeros((0, 3))]
    for mesh in meshes:
        if id(mesh.positions) not in boxes:
            boxes[id(mesh.positions)] = bounds_of(mesh.positions)
        box = boxes[id(mesh.positions)]
        if box is not None:
            eight = np.array(list(product(*box.T)))
            corners.append(placed(np.repeat(mesh.transforms, 8, axis=0), np.tile(eight, (len(mesh.transforms), 1))))
    bounds = bounds_of(np.concatenate(corners))
    return WORLD_ORIGIN if bounds is None else origin_for(bounds)


def _shared_vertices(mesh: Mesh) -> tuple[Any, ...]:
    """Equal for meshes that can share vertices, arrays and places being the same."""
    if mesh.normals is None or mesh.colors_of_faces:
        return (id(mesh),)  # they get vertices of their own
    return (*(id(array) for array in (mesh.positions, mesh.normals, mesh.uvs, mesh.colors)), mesh.transforms.tobytes())


def _part(group: list[Mesh], transform: NDArray[np.float64], origin: Vector, only_used: bool, materials: _Materials) -> Scene:
    """Meshes that share vertices, or a single one, at one place."""
    first = group[0]
    triangles = [mesh.triangles for mesh in group]
    used: Any = slice(None)
    if only_used or first.normals is None:
        used, triangles = _used(triangles, len(first.positions))
    from_origin = transform.copy()
    from_origin[:3, 3] -= origin
    positions = placed(from_origin, first.positions[used], np.float32)
    # A mirrored mesh would show its back faces.
    if mirrors(transform):
        triangles = [np.ascontiguousarray(some[:, ::-1]) for some in triangles]
    looks = [materials.of(mesh, two_sided=not _encloses(positions, some)) for mesh, some in zip(group, triangles, strict=True)]
    uvs = None if first.uvs is None else first.uvs[used]
    colors = first.colors
    if colors is not None and not first.colors_of_faces:
        colors = colors[used]
    if colors is not None and first.colors_of_faces:
        # Faces of different colours share no vertex.
        corners = triangles[0].reshape(-1)
        positions, uvs = positions[corners], None if uvs is None else uvs[corners]
        colors = np.repeat(colors, 3, axis=0)
        triangles = [np.arange(len(corners), dtype=np.int32).reshape(-1, 3)]
    joined = triangles[0] if len(group) == 1 else np.concatenate(triangles)
    number = {id(look): i for i, look in enumerate(dict.fromkeys(looks))}
    material = np.repeat(np.array([number[id(look)] for look in looks], np.int32), [len(some) for some in triangles])
    if first.normals is not None and not first.colors_of_faces:
        normals = turned(transform, first.normals[used])
    else:
        source, joined, normals = split_normals(positions, joined)
        positions, uvs = positions[source], None if uvs is None else uvs[source]
        colors = None if colors is None else colors[source]
    return Scene(positions, joined, normals, uvs, colors, material, tuple(dict.fromkeys(looks)), origin=origin)


def _used(triangles: list[NDArray[np.int32]], count: int) -> tuple[Any, list[NDArray[np.int32]]]:
    """Which of ``count`` vertices the triangles use, and the triangles over these alone, their order kept."""
    used = np.zeros(count, bool)
    for some in triangles:
        used[some] = True
    if used.all():
        return slice(None), triangles
    number = np.cumsum(used, dtype=np.int32) - np.int32(1)
    return used, [number[some] for some in triangles]


def _encloses(positions: NDArray[np.float32], triangles: NDArray[np.int32]) -> bool:
    """``is_closed``, which looks at all vertices, of those alone that the triangles use."""
    used, (own,) = _used([triangles], len(positions))
    return is_closed(positions[used], own)


class _Materials:
    """Makes materials; meshes of one paint and look get the same, textures of one image the same array."""

    def __init__(self) -> None:
        self._known: dict[tuple[Any, ...], Material] = {}

    def of(self, mesh: Mesh, two_sided: bool) -> Material:
        paint = mesh.paint or Paint()
        two_sided = two_sided or bool(paint.double_sided)
        colored, textured = mesh.colors is not None, paint.texture is not None and mesh.uvs is not None
        # Without a paint there is only the mesh's name to tell materials apart by.
        key = (mesh.name if mesh.paint is None else id(paint), two_sided, colored, textured)
        if key not in self._known:
            base = paint.base_color or (_WHITE if colored or textured else _GREY)
            texture = paint.texture if textured else None
            name = paint.name or mesh.name
            self._known[key] = Material(name, base, texture, paint.wrap, paint.filter, colored, two_sided=two_sided)
        return self._known[key]

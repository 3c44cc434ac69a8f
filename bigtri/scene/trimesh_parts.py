"""trimesh's geometry as scenes of one material each: transforms, colours, textures and normals in bigtri's conventions."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..reference.shading import decode_table
from .camera import Vector, affine
from .normals import is_closed, split_normals
from .scene import Material, Scene

# For geometry that says nothing about its colour: linear, a light grey.
_GREY: Vector = (0.6, 0.6, 0.6)


def parts_of(loaded: Any, linear_colors: bool) -> list[Scene]:
    """One scene per node that holds triangles, in the order of the scene graph; see ``scene.from_trimesh``."""
    import trimesh

    if isinstance(loaded, trimesh.Trimesh):
        return [_part("mesh", loaded, np.eye(4), linear_colors)] if len(loaded.faces) else []
    parts = []
    for node in loaded.graph.nodes_geometry:
        transform, name = loaded.graph[node]
        mesh = loaded.geometry[name]
        if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces):
            parts.append(_part(str(name), mesh, np.asarray(transform, np.float64), linear_colors))
    return parts


def _part(name: str, mesh: Any, transform: NDArray[np.float64], linear_colors: bool) -> Scene:
    vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces)
    # trimesh hands on what a file says.
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise ValueError(f"{name}: vertices must be [V, 3], got {list(vertices.shape)}")
    if faces.ndim != 2 or faces.shape[1] != 3:
        raise ValueError(f"{name}: faces must be [T, 3], got {list(faces.shape)}")
    if not (faces.min() >= 0 and faces.max() < len(vertices)):
        raise ValueError(
            f"{name}: faces must index the {len(vertices)} vertices, got indices from {faces.min()} to {faces.max()}"
        )
    positions = np.stack([affine(row, vertices) for row in transform[:3]], axis=1).astype(np.float32)
    triangles = faces.astype(np.int32)
    # A mirrored node would show its back faces.
    mirrored = np.linalg.det(transform[:3, :3]) < 0
    if mirrored:
        triangles = np.ascontiguousarray(triangles[:, ::-1])
    uvs = _uvs(mesh)
    colors, per_face = _colors(mesh, linear_colors)
    material = _material(name, mesh, has_colors=colors is not None, two_sided=not is_closed(positions, triangles))

    if colors is not None and per_face:
        # Faces of different colours share no vertex.
        corners = triangles.reshape(-1)
        positions, uvs = positions[corners], None if uvs is None else uvs[corners]
        colors = np.repeat(colors, 3, axis=0)
        triangles = np.arange(len(corners), dtype=np.int32).reshape(-1, 3)

    source: Any = slice(None)
    # trimesh computes normals on demand and keeps them in the same place as those from the file. Nothing has asked for them yet.
    if "vertex_normals" in mesh._cache.cache and not per_face:
        normals = _transformed_normals(np.asarray(mesh.vertex_normals, np.float64), transform)
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


def _colors(mesh: Any, linear: bool) -> tuple[NDArray[np.float32] | None, bool]:
    """Linear colours float32 [V, 3], or [T, 3] and True where they belong to faces; None where there are none."""
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
    return _linear(codes.astype(np.uint8), linear), kind == "face"


def _material(name: str, mesh: Any, has_colors: bool, two_sided: bool) -> Material:
    source = getattr(mesh.visual, "material", None)
    if source is None:
        base = (1.0, 1.0, 1.0) if has_colors else _GREY
        return Material(name, base, vertex_colors=has_colors, two_sided=two_sided)
    if hasattr(source, "baseColorFactor"):
        # glTF's factors are linear; trimesh keeps them as 8 bits.
        factor, image, linear = source.baseColorFactor, source.baseColorTexture, True
        two_sided = two_sided or bool(source.doubleSided)
    else:
        factor, image, linear = source.diffuse, source.image, False
    base_color = np.ones(3, np.float32) if factor is None else _linear(np.asarray(factor, np.uint8)[:3], linear)
    return Material(
        str(source.name or name),
        tuple(base_color.tolist()),
        texture=None if image is None else _linear(np.asarray(image.convert("RGB")), False),
        vertex_colors=has_colors,
        two_sided=two_sided,
    )


def _linear(codes: NDArray[np.uint8], linear: bool) -> NDArray[np.float32]:
    return codes.astype(np.float32) / np.float32(255) if linear else decode_table()[codes]

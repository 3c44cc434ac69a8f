"""Model files to scenes."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Any

from .scene import Scene, merge
from .trimesh_parts import ModelError, asking_trimesh, parts_of

FILE_KINDS = (".glb", ".gltf", ".obj", ".ply", ".stl", ".off")


def load_scene(path: str | os.PathLike[str]) -> Scene:
    """A scene from a GLB, glTF, OBJ (with MTL), PLY, STL or OFF file, through trimesh.

    Nodes are placed by their transforms; vertex normals are computed where the file has none, with a crease of 50 degrees.
    Surfaces that do not enclose a solid, or that glTF calls double-sided, are lit from both sides. Base colour, base colour
    texture and vertex colours are read; transparency, emission, metalness, normal maps and texture samplers are not.

    Raises:
        FileNotFoundError: no such file.
        ImportError: trimesh is not installed.
        TypeError: path is none.
        ValueError: the file is of another kind, cannot be read, or holds no triangles.
    """
    try:
        path = Path(path)
    except TypeError:
        raise TypeError(f"bigtri.load_scene: path must be a path, got {path!r}") from None
    kind = path.suffix.lower()
    if not os.path.isfile(path):  # Path.is_file raises for a name that is too long
        raise FileNotFoundError(f"bigtri.load_scene: no such file: {path}")
    if kind not in FILE_KINDS:
        kinds = ", ".join(FILE_KINDS)
        raise ValueError(f"bigtri.load_scene: path must end in {kinds}, got {path.name}: convert it to .glb, for example")
    try:
        import trimesh
    except ImportError as error:
        raise ImportError("bigtri.load_scene: reading models needs trimesh: pip install trimesh pillow") from error
    try:
        with asking_trimesh():
            # Processing would merge vertices that differ in texture coordinates or normals.
            loaded = trimesh.load_scene(str(path), process=False)
    except ModelError as error:
        raise ValueError(f"bigtri.load_scene: {path} cannot be read as {kind[1:]}: {error}") from error
    if kind == ".obj":
        _warn_of_missing_materials(path)
    try:
        return _merged_parts(loaded, linear_colors=kind in (".glb", ".gltf"))
    except ModelError as error:
        raise ValueError(f"bigtri.load_scene: {path}: {error}") from error


def from_trimesh(loaded: Any, linear_colors: bool = False) -> Scene:
    """A scene from a trimesh.Scene or trimesh.Trimesh, as ``load_scene`` makes it.

    Args:
        loaded: what trimesh loaded or created; points and lines are left out.
        linear_colors: whether vertex colours are linear, as in glTF, instead of sRGB.

    Raises:
        TypeError: something else.
        ValueError: no triangles, or some that do not index the vertices.
    """
    import trimesh

    if not isinstance(loaded, trimesh.Scene | trimesh.Trimesh):
        raise TypeError(f"bigtri.from_trimesh: loaded must be a trimesh.Scene or trimesh.Trimesh, got {type(loaded).__name__}")
    try:
        return _merged_parts(loaded, linear_colors)
    except ModelError as error:
        raise ValueError(f"bigtri.from_trimesh: {error}") from error


def _merged_parts(loaded: Any, linear_colors: bool) -> Scene:
    parts = parts_of(loaded, linear_colors)
    if not parts:
        raise ModelError("there are no triangles in it: point clouds and lines are not drawn")
    return merge(parts)


def _warn_of_missing_materials(path: Path) -> None:
    with open(path, errors="replace") as lines:
        names = [line.split(None, 1)[1].strip() for line in lines if line.startswith("mtllib ") and len(line.split()) > 1]
    for name in names:
        if not os.path.isfile(path.parent / name):
            warnings.warn(f"{path} refers to {name}, which is not beside it: its materials are drawn grey", stacklevel=3)

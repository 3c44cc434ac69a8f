"""Model files to scenes."""

from __future__ import annotations

import importlib
import os
import warnings
from pathlib import Path
from typing import Any

from .readers import through_trimesh
from .readers.assemble import assemble
from .readers.model import Finding, Model, ModelError, ModelWarning
from .scene import Scene

# The module of each kind of file; its read(path) gives a Model.
_READERS = {
    ".glb": "gltf",
    ".gltf": "gltf",
    ".obj": "obj",
    ".ply": "ply",
    ".stl": "stl",
    ".off": "off",
}
FILE_KINDS = tuple(_READERS)


def load_scene(path: str | os.PathLike[str], strict: bool = False) -> Scene:
    """A scene from a GLB, glTF, OBJ (with MTL), PLY, STL or OFF file; docs/models.md says what is read of each.

    Meshes are placed by their nodes; vertex normals are computed where the file has none, with a crease of 50 degrees.
    Surfaces that do not enclose a solid, or that the file calls double-sided, are lit from both sides. Positions are counted
    from ``Scene.origin``, which is (0, 0, 0) unless a coordinate is more than 8 times the model's size.

    What the file has and the picture does not show is a ``ModelWarning``, one for each kind of it.

    Args:
        path: the file; its ending says what it is.
        strict: whether such a warning is an error instead.

    Raises:
        FileNotFoundError: no such file.
        TypeError: path is none, or strict is neither True nor False.
        ValueError: the file is of another kind, cannot be read, or holds no triangles; or a warning, if ``strict``.
    """
    if not isinstance(strict, bool):
        raise TypeError(f"bigtri.load_scene: strict must be True or False, got {strict!r}")
    model = read_model(path)
    try:
        scene = assemble(model)
    except ModelError as error:
        raise ValueError(f"bigtri.load_scene: {os.fspath(path)}: {error}") from error
    texts = [_sentence(finding) for finding in model.findings.values()]
    if strict and texts:
        raise ValueError(f"bigtri.load_scene: {os.fspath(path)} has what is not drawn, which strict forbids: {'; '.join(texts)}")
    for text in texts:
        warnings.warn(f"{os.fspath(path)}: {text}", ModelWarning, stacklevel=2)
    return scene


def read_model(path: str | os.PathLike[str]) -> Model:
    """What a file holds, as its reader hands it over. Raises what ``load_scene`` raises, but not for want of triangles."""
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
    reader = importlib.import_module(f".readers.{_READERS[kind]}", __package__)
    try:
        return reader.read(path)
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
        return assemble(through_trimesh.model_of(loaded, linear_colors))
    except ModelError as error:
        raise ValueError(f"bigtri.from_trimesh: {error}") from error


def _sentence(finding: Finding) -> str:
    return finding.text if finding.count == 1 else f"{finding.text} ({finding.count} times)"

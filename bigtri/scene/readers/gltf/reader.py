"""A glTF file as a ``Model``: what its default scene shows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..model import Mesh, Model, Strokes
from ..transforms import placed, product, turned
from .accessors import Accessors
from .document import Document
from .extensions import check_extensions
from .json_values import JsonObject
from .nodes import Nodes, instances
from .primitives import Primitive, Primitives
from .skins import blended, joint_matrices
from .viewpoints import add_camera, add_lamp


# What is beyond the range of floats is an infinity here, and named when the model is assembled.
@np.errstate(over="ignore", invalid="ignore")
def read(path: Path) -> Model:
    """The meshes of a GLB or glTF 2.0 file, placed by its nodes; skins at rest, morph targets by their default weights.

    Raises:
        ModelError: the file is broken, or cannot be drawn without an extension that is not read.
        OSError: it cannot be read at all.
    """
    document = Document(path)
    check_extensions(document)
    reader = _Reader(document)
    for node in reader.nodes.drawn:
        reader.add(node)
    reader.note_what_is_left_out()
    return document.model


class _Reader:
    def __init__(self, document: Document) -> None:
        self._document = document
        self._accessors = Accessors(document)
        self._primitives = Primitives(document, self._accessors)
        self._objects = 0
        self.nodes = Nodes(document)

    def add(self, index: int) -> None:
        """Adds to the model what a node has."""
        node, matrix = self._document.all("nodes")[index], self.nodes.matrices[index]
        add_camera(self._document, node, matrix)
        add_lamp(self._document, node, matrix)
        if "mesh" in node:
            self._add_mesh(node, matrix)

    def _add_mesh(self, node: JsonObject, matrix: NDArray[np.float64]) -> None:
        document, model = self._document, self._document.model
        mesh = document.index(node, "mesh", "meshes")
        name = document.all("meshes")[mesh].text("name") or f"meshes[{mesh}]"
        local = instances(node, self._accessors, len(document.all("accessors")))
        transforms = matrix[None] if local is None else product(matrix[None], local)
        skin = document.follow(node, "skin", "skins")
        joints = None if skin is None else joint_matrices(document, self._accessors, skin, self.nodes.matrices)
        posed = _Posed(joints)
        # Every place of a node's mesh is an object.
        numbers = np.arange(self._objects, self._objects + len(transforms), dtype=np.int32)
        self._objects += len(transforms)
        for primitive in self._primitives.of_mesh(mesh, node.weights("weights")):
            paint = None if primitive.surface is None else primitive.surface.paint
            # Joints place it in world space.
            positions, normals, mirrored = posed.vertices(primitive)
            where = transforms if positions is primitive.positions else np.eye(4)[None]
            elements, colors = primitive.elements, primitive.colors
            if elements.shape[1] == 3:
                elements = np.ascontiguousarray(elements[:, ::-1]) if mirrored else elements
                vertices = (positions, elements, normals, primitive.uvs, colors)
                model.meshes.append(Mesh(name, *vertices, False, paint, where, numbers[: len(where)]))
            else:
                model.strokes.append(Strokes(positions, elements, colors, paint, where))

    def note_what_is_left_out(self) -> None:
        """Findings of what belongs to no node."""
        document, found = self._document, self._document.model.found
        for _ in document.all("animations"):
            found("animations", "an animation is not played: the model is drawn at rest")
        with_a_place = {document.index(node, "mesh", "meshes") for node in document.all("nodes") if "mesh" in node}
        for i in range(len(document.all("meshes"))):
            if i not in with_a_place:
                found("meshes without a place", f"meshes[{i}] is placed by no node: it is not drawn")
        if document.root.extension("KHR_materials_variants") is not None:
            found("material variants", "meshes have other materials to choose from: the default ones are drawn")


class _Posed:
    """The vertices of primitives as the joints of a skin place them; those that several primitives share are placed once."""

    def __init__(self, joints: NDArray[np.float64] | None) -> None:
        """
        Args:
            joints: float64 [J, 4, 4], or None: without a skin vertices stay where they are.
        """
        self._joints = joints
        self._known: dict[tuple[int, ...], tuple[NDArray[Any], NDArray[Any] | None, bool]] = {}

    def vertices(self, primitive: Primitive) -> tuple[NDArray[Any], NDArray[Any] | None, bool]:
        """(positions, normals, whether most vertices are mirrored, so that triangles show their back faces)"""
        positions, normals = primitive.positions, primitive.normals
        if self._joints is None or primitive.joints is None or primitive.weights is None:
            return positions, normals, False
        key = tuple(id(array) for array in (positions, normals, primitive.joints, primitive.weights))
        if key not in self._known:
            matrices = blended(self._joints, primitive.joints, primitive.weights, primitive.place)
            mirrored = bool(2 * np.count_nonzero(np.linalg.det(matrices[:, :3, :3]) < 0) > len(matrices))
            self._known[key] = placed(matrices, positions), None if normals is None else turned(matrices, normals), mirrored
        return self._known[key]

"""A glTF file as a ``Model``: what its default scene shows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..model import Mesh, Model
from ..transforms import placed, product, turned
from .accessors import Accessors
from .document import Document
from .extensions import LIGHTS, check_extensions
from .nodes import Nodes, instances
from .primitives import Primitive, Primitives
from .skins import blended, joint_matrices


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
        document.model.meshes += reader.meshes_of(node)
    reader.note_what_is_left_out()
    return document.model


class _Reader:
    def __init__(self, document: Document) -> None:
        self._document = document
        self._accessors = Accessors(document)
        self._primitives = Primitives(document, self._accessors)
        self.nodes = Nodes(document)

    def meshes_of(self, index: int) -> list[Mesh]:
        """What a node shows."""
        node = self._document.all("nodes")[index]
        if "mesh" not in node:
            return []
        mesh = self._document.index(node, "mesh", "meshes")
        name = self._document.all("meshes")[mesh].text("name") or f"meshes[{mesh}]"
        primitives = self._primitives.of_mesh(mesh, node.weights("weights"))
        skin = self._document.follow(node, "skin", "skins")
        transforms = self.nodes.matrices[index][None]
        local = instances(node, self._accessors, len(self._document.all("accessors")))
        if local is not None:
            transforms = product(transforms, local)
        joints = None if skin is None else joint_matrices(self._document, self._accessors, skin, self.nodes.matrices)
        meshes = []
        for primitive in primitives:
            if joints is not None and primitive.joints is not None:
                meshes.append(_posed(name, primitive, joints))
            else:
                meshes.append(_as_mesh(name, primitive, transforms))
        return meshes

    def note_what_is_left_out(self) -> None:
        """Findings of what belongs to no mesh that is drawn."""
        root, found = self._document.root, self._document.model.found
        for _ in self._document.all("animations"):
            found("animations", "an animation is not played: the model is drawn at rest")
        nodes = [self._document.all("nodes")[i] for i in self.nodes.drawn]
        for node in nodes:
            if "camera" in node:
                found("cameras", "a camera is not used: the picture has one of its own")
            if node.extension(LIGHTS) is not None:
                found("lights", f"a light ({LIGHTS}) is not used: the picture has lights of its own")
        if root.extension("KHR_materials_variants") is not None:
            found("material variants", "meshes have other materials to choose from: the default ones are drawn")


def _as_mesh(name: str, primitive: Primitive, transforms: NDArray[np.float64]) -> Mesh:
    return Mesh(
        name,
        primitive.positions,
        primitive.triangles,
        primitive.normals,
        primitive.uvs,
        primitive.colors,
        paint=None if primitive.surface is None else primitive.surface.paint,
        transforms=transforms,
    )


def _posed(name: str, primitive: Primitive, joints: NDArray[np.float64]) -> Mesh:
    """A mesh in world space, as its joints place it."""
    assert primitive.joints is not None and primitive.weights is not None
    matrices = blended(joints, primitive.joints, primitive.weights, primitive.place)
    return Mesh(
        name,
        placed(matrices, primitive.positions),
        primitive.triangles,
        None if primitive.normals is None else turned(matrices, primitive.normals),
        primitive.uvs,
        primitive.colors,
        paint=None if primitive.surface is None else primitive.surface.paint,
    )

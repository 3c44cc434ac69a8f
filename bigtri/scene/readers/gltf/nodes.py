"""The tree of nodes: where every mesh is placed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..model import ModelError
from ..transforms import product, trs
from .accessors import Accessors
from .document import Document
from .extensions import INSTANCING, VISIBILITY
from .json_values import JsonObject

_QUATERNION = (0.0, 0.0, 0.0, 1.0)
_IDENTITY = tuple(np.eye(4).reshape(-1).tolist())


class Nodes:
    """The nodes of the scene to be drawn, and the place of all.

    Attributes:
        drawn: indices of the visible nodes of the default scene, parents first, in the order of the file.
        matrices: float64 [N, 4, 4], every node's own space to that of the world.
    """

    def __init__(self, document: Document) -> None:
        self._nodes = document.all("nodes")
        self._children = [node.indices("children", len(self._nodes), "nodes") for node in self._nodes]
        parents = self._parents()
        roots = [i for i in range(len(self._nodes)) if i not in parents]
        order = self._below(roots)
        if len(order) < len(self._nodes):
            circle = min(set(range(len(self._nodes))) - set(order))
            raise ModelError(f"nodes[{circle}] must not be below itself")
        self.matrices = np.empty((len(self._nodes), 4, 4))
        for i in order:
            local = _local_matrix(self._nodes[i])
            self.matrices[i] = product(self.matrices[parents[i]], local) if i in parents else local
        self.drawn = self._below(self._scene_roots(document, roots), only_visible=True)

    def _parents(self) -> dict[int, int]:
        parents: dict[int, int] = {}
        for i, children in enumerate(self._children):
            for child in children:
                if parents.setdefault(child, i) != i:
                    raise ModelError(f"nodes[{child}] must have one parent, got nodes[{parents[child]}] and nodes[{i}]")
        return parents

    def _below(self, roots: list[int], only_visible: bool = False) -> list[int]:
        """The roots and all below them, parents first."""
        order: dict[int, None] = {}
        waiting = roots[::-1]
        while waiting:
            node = waiting.pop()
            if node not in order and not (only_visible and self._hidden(node)):
                order[node] = None
                waiting += self._children[node][::-1]
        return list(order)

    def _hidden(self, node: int) -> bool:
        visibility = self._nodes[node].extension(VISIBILITY)
        return visibility is not None and not visibility.flag("visible", True)

    @staticmethod
    def _scene_roots(document: Document, roots: list[int]) -> list[int]:
        scenes = document.all("scenes")
        if not scenes:
            return roots
        chosen = document.index(document.root, "scene", "scenes") if "scene" in document.root else 0
        for i, scene in enumerate(scenes):
            if i != chosen and "nodes" in scene:
                text = f"of {len(scenes)} scenes only scenes[{chosen}] is drawn, which the file names or has first"
                document.model.found("other scenes", text)
        return scenes[chosen].indices("nodes", len(document.all("nodes")), "nodes")


def instances(node: JsonObject, accessors: Accessors, count: int) -> NDArray[np.float64] | None:
    """float64 [N, 4, 4]: where a node's mesh is repeated, in the node's own space; None where the node asks for no such thing.

    Args:
        count: how many accessors there are.
    """
    extension = node.extension(INSTANCING)
    if extension is None:
        return None
    attributes = extension.object("attributes")
    parts = {}
    for name, kind in (("TRANSLATION", "VEC3"), ("ROTATION", "VEC4"), ("SCALE", "VEC3")):
        if name in attributes:
            index = attributes.index(name, count, "accessors")
            if not accessors.has_data(index):  # a few bytes would announce millions of places
                wanted = f"{attributes.at(name)} must have a bufferView or sparse values"
                raise ModelError(f"{wanted}, got accessors[{index}] of neither")
            parts[name] = accessors.floats(index, (kind,), np.float64)
    if not parts:
        return np.eye(4)[None]
    sizes = {len(values) for values in parts.values()}
    if len(sizes) > 1:
        raise ModelError(f"{attributes.place} must have as many of each, got {', '.join(map(str, sorted(sizes)))}")
    size = sizes.pop()
    standard = {"TRANSLATION": np.zeros(3), "ROTATION": np.array(_QUATERNION), "SCALE": np.ones(3)}
    return trs(*(parts.get(name, np.tile(value, (size, 1))) for name, value in standard.items()))


def _local_matrix(node: JsonObject) -> NDArray[np.float64]:
    if "matrix" in node:
        return np.array(node.numbers("matrix", _IDENTITY)).reshape(4, 4).T  # column by column in the file
    parts = (
        node.numbers("translation", (0.0, 0.0, 0.0)),
        node.numbers("rotation", _QUATERNION),
        node.numbers("scale", (1.0, 1.0, 1.0)),
    )
    return trs(*(np.array([part]) for part in parts))[0]

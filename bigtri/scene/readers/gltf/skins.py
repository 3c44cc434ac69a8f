"""Skins at rest: the joints place a mesh, its own node does not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..model import ModelError
from ..transforms import product
from .accessors import Accessors
from .document import Document
from .json_values import JsonObject


def joint_matrices(document: Document, accessors: Accessors, skin: JsonObject, nodes: NDArray[np.float64]) -> NDArray[np.float64]:
    """float64 [J, 4, 4]: from a mesh's own space to that of the world, as each joint of a skin would have it.

    Args:
        nodes: float64 [N, 4, 4], the matrices of all nodes.
    """
    joints = skin.indices("joints", len(nodes), "nodes")
    if "inverseBindMatrices" not in skin:
        return nodes[joints]
    index = document.index(skin, "inverseBindMatrices", "accessors")
    inverse = accessors.floats(index, ("MAT4",), np.float64)
    if len(inverse) < len(joints):
        raise ModelError(f"{skin.at('inverseBindMatrices')} must have one for each of {len(joints)} joints, got {len(inverse)}")
    return product(nodes[joints], inverse[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1))


def blended(
    matrices: NDArray[np.float64], joints: NDArray[np.int64], weights: NDArray[np.floating], place: str
) -> NDArray[np.float64]:
    """float64 [V, 4, 4]: the matrix of each vertex.

    Args:
        matrices: float64 [J, 4, 4], of the joints.
        joints: int64 [V, n], indices into them.
        weights: float [V, n]; those of a vertex are made to add up to 1. Where they add up to nothing the first joint has all.
        place: of the primitive, for error texts.
    """
    if joints.shape != weights.shape:
        raise ModelError(f"{place} must have as many joints as weights, got {list(joints.shape)} and {list(weights.shape)}")
    if joints.size and joints.max() >= len(matrices):
        raise ModelError(f"{place}.attributes.JOINTS_0 must index the {len(matrices)} joints, got {joints.max()}")
    weights = weights.astype(np.float64)
    total = np.zeros(len(weights))
    for column in weights.T:
        total += column
    nothing = ~(total > 0)
    weights[nothing], total[nothing] = 0, 1
    weights[nothing, 0] = 1
    weights /= total[:, None]
    result = np.zeros((len(joints), 4, 4))
    for joint, weight in zip(joints.T, weights.T, strict=True):
        result += weight[:, None, None] * matrices[joint]
    return result

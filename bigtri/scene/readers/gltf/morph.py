"""Morph targets: what a mesh's weights add to its vertices."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..model import ModelError
from .accessors import Accessors
from .json_values import JsonObject


class Morph:
    """The targets of a primitive with weights that are not 0."""

    def __init__(self, primitive: JsonObject, weights: Sequence[float], accessors: Accessors, count: int) -> None:
        """
        Args:
            weights: one for each target.
            count: how many accessors there are.
        """
        targets = primitive.objects("targets")
        if weights and len(weights) != len(targets):
            raise ModelError(f"{primitive.at('targets')} must be as many as the {len(weights)} weights, got {len(targets)}")
        self._accessors, self._count = accessors, count
        self._moving = [(target, weight) for target, weight in zip(targets, weights, strict=False) if weight]

    def __call__(self, name: str, values: NDArray[np.floating]) -> NDArray[np.floating]:
        """Values [V, n] of an attribute, plus what the targets add; float64 if they add anything."""
        for target, weight in self._moving:
            if name in target:
                index = target.index(name, self._count, "accessors")
                added = self._accessors.floats(index, (f"VEC{values.shape[1]}", f"VEC{min(3, values.shape[1])}"), np.float64)
                if len(added) != len(values):
                    raise ModelError(f"{target.at(name)} must have {len(values)} elements, got {len(added)}")
                values = values.astype(np.float64)
                values[:, : added.shape[1]] += weight * added
        return values

"""Meshes compressed by Draco, decoded by DracoPy, which is an optional extra of bigtri."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..model import ModelError
from .document import Document
from .extensions import DRACO
from .json_values import JsonObject


class DracoMesh:
    """The decoded mesh of a primitive.

    Attributes:
        indices: int64 [T, 3].
    """

    def __init__(self, document: Document, extension: JsonObject) -> None:
        try:
            import DracoPy
        except ImportError as error:
            needed = "pip install bigtri[draco] (the package DracoPy)"
            raise ModelError(f"{extension.place} is compressed by {DRACO}: reading it needs {needed}") from error
        data = bytes(document.view_bytes(document.index(extension, "bufferView", "bufferViews")))
        try:
            self._mesh = DracoPy.decode(data)
            self.indices = np.asarray(self._mesh.faces, np.int64).reshape(-1, 3)
        except Exception as error:  # a point cloud has no faces, and a broken mesh breaks in any way
            raise ModelError(f"{extension.place} cannot be decoded by DracoPy: {' '.join(str(error).split())}") from error
        self._attributes = extension.object("attributes")

    def __contains__(self, name: str) -> bool:
        return name in self._attributes

    def values(self, name: str) -> NDArray[Any]:
        """[V, n] of the attribute's own dtype."""
        key = self._attributes.whole(name)
        found = next((one for one in self._mesh.attributes if one["unique_id"] == key), None)
        if found is None:
            raise ModelError(f"{self._attributes.at(name)} must be an attribute of the compressed mesh, got {key}")
        values = np.asarray(found["data"])
        return values.reshape(len(values), -1)

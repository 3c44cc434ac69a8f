"""Primitives: triangles and what their vertices have."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ..model import ModelError
from .accessors import Accessors, as_floats
from .document import Document
from .draco import DracoMesh
from .extensions import DRACO
from .json_values import JsonObject
from .materials import Materials, Surface
from .morph import Morph

_MODES = ("points", "lines", "line loops", "line strips", "triangles", "triangle strips", "triangle fans")
_TRIANGLES, _STRIP = 4, 5


@dataclass(frozen=True, eq=False)
class Primitive:
    """A primitive with triangles, in the mesh's own space. Attributes as in ``Mesh``."""

    place: str
    positions: NDArray[Any]
    triangles: NDArray[np.int32]
    normals: NDArray[np.float32] | None
    uvs: NDArray[np.float32] | None
    colors: NDArray[np.float32] | None
    joints: NDArray[np.int64] | None  # [V, n], indices into the joints of a skin
    weights: NDArray[np.float32] | None  # [V, n], of the same joints
    surface: Surface | None


class Primitives:
    """Reads the primitives of meshes; those that share accessors share arrays."""

    def __init__(self, document: Document, accessors: Accessors) -> None:
        self._document = document
        self._accessors = accessors
        self._count = len(document.all("accessors"))
        self._materials = Materials(document)
        self._known: dict[tuple[int, tuple[float, ...]], list[Primitive]] = {}
        self._turned: dict[tuple[int, bytes], NDArray[np.float32]] = {}

    def of_mesh(self, index: int, weights: tuple[float, ...] | None) -> list[Primitive]:
        """The primitives of a mesh that have triangles; those that have none are noted.

        Args:
            weights: of the morph targets, as the node has them; None: as the mesh has them.
        """
        mesh = self._document.all("meshes")[index]
        weights = weights or mesh.weights("weights") or ()
        if (index, weights) not in self._known:
            read = [self._read(primitive, weights) for primitive in mesh.objects("primitives")]
            self._known[index, weights] = [primitive for primitive in read if primitive is not None]
        return self._known[index, weights]

    def _read(self, primitive: JsonObject, weights: tuple[float, ...]) -> Primitive | None:
        mode = primitive.chosen("mode", tuple(range(7)), _TRIANGLES)
        found = self._document.model.found
        if mode < _TRIANGLES:
            found(_MODES[mode], f"{_MODES[mode]} (primitive mode {mode}) are not drawn")
            return None
        attributes = primitive.object("attributes")
        source = _Attributes(self._document, self._accessors, primitive)
        if "POSITION" not in source:
            found("primitives without positions", f"{primitive.place} has no POSITION: it is not drawn")
            return None
        morph = Morph(primitive, weights, self._accessors, self._count)
        # Quotients of 16-bit integers need more than float32 to be placed without a further rounding.
        positions = morph("POSITION", source.floats("POSITION", ("VEC3",), np.float32, np.float64))
        size = len(positions)
        triangles = self._triangles(source, primitive, mode, size)
        if len(triangles) == 0:
            return None
        surface = None
        if "material" in primitive:
            surface = self._materials.read(self._document.index(primitive, "material", "materials"))
        normals = colors = joints = joint_weights = None
        if "NORMAL" in source:
            normals = morph("NORMAL", source.floats("NORMAL", ("VEC3",))).astype(np.float32, copy=False)
        if "COLOR_0" in source:
            colors = morph("COLOR_0", source.floats("COLOR_0", ("VEC3", "VEC4")))[:, :3].astype(np.float32, copy=False)
        if "JOINTS_0" in source:
            sets = [n for n in range(len(list(attributes))) if f"JOINTS_{n}" in source]
            joints = _side_by_side([source.integers(f"JOINTS_{n}", ("VEC4",)) for n in sets])
            joint_weights = _side_by_side([source.floats(f"WEIGHTS_{n}", ("VEC4",)) for n in sets])
        uvs = self._uvs(source, morph, surface)
        for name, values in (("NORMAL", normals), ("TEXCOORD", uvs), ("COLOR_0", colors), ("JOINTS_0", joints)):
            if values is not None and len(values) != size:
                raise ModelError(f"{attributes.place}: {name} must have as many elements as POSITION, {size}, got {len(values)}")
        return Primitive(primitive.place, positions, triangles, normals, uvs, colors, joints, joint_weights, surface)

    def _triangles(self, source: _Attributes, primitive: JsonObject, mode: int, size: int) -> NDArray[np.int32]:
        """int32 [T, 3]."""
        indices = source.indices(size)
        if source.is_compressed:
            mode = _TRIANGLES
        elif len(indices) and indices.max() >= size:
            got = f"got indices from {indices.min()} to {indices.max()}"
            raise ModelError(f"{primitive.at('indices')} must index the {size} vertices, {got}")
        if mode == _TRIANGLES:
            left = len(indices) % 3
            if left:
                text = f"{primitive.place} has {len(indices)} corners, which is no multiple of 3: the last {left} are not drawn"
                self._document.model.found("incomplete triangles", text)
            return indices[: len(indices) - left].reshape(-1, 3).astype(np.int32)
        first = np.arange(max(len(indices) - 2, 0))
        if mode == _STRIP:
            # Every other triangle goes round the other way.
            odd = first % 2
            order = np.stack([first, first + 1 + odd, first + 2 - odd], axis=1)
        else:
            order = np.stack([first + 1, first + 2, np.zeros_like(first)], axis=1)
        return indices[order].astype(np.int32)

    def _uvs(self, source: _Attributes, morph: Morph, surface: Surface | None) -> NDArray[np.float32] | None:
        """The texture coordinates that the material asks for, (0, 0) at the lower left."""
        name = f"TEXCOORD_{surface.set if surface else 0}"
        if name not in source:
            if surface is not None and surface.paint.texture is not None:
                text = f"a material has a texture, but its mesh has no {name}: it is drawn without the texture"
                self._document.model.found("textures without coordinates", text)
            return None
        values = source.floats(name, ("VEC2",))
        moved = morph(name, values)
        transform = None if surface is None else surface.transform
        key = (id(values), b"" if transform is None else transform.tobytes())
        if moved is not values:
            return _upright(moved, transform)
        if key not in self._turned:
            self._turned[key] = _upright(values, transform)
        return self._turned[key]


class _Attributes:
    """The attributes of a primitive: from accessors, or from a compressed mesh if they are nowhere else."""

    def __init__(self, document: Document, accessors: Accessors, primitive: JsonObject) -> None:
        self._document, self._accessors = document, accessors
        self._primitive, self._attributes = primitive, primitive.object("attributes")
        self._mesh: DracoMesh | None = None
        extension = primitive.extension(DRACO)
        if extension is not None and "POSITION" in self._attributes and not accessors.has_data(self._index("POSITION")):
            self._mesh = DracoMesh(document, extension)

    @property
    def is_compressed(self) -> bool:
        return self._mesh is not None

    def __contains__(self, name: str) -> bool:
        return name in self._attributes

    def floats(
        self, name: str, kinds: tuple[str, ...], dtype: DTypeLike = np.float32, normalized_dtype: DTypeLike | None = None
    ) -> NDArray[Any]:
        """As ``Accessors.floats``; with ``normalized_dtype`` for those that are divided."""
        index = self._index(name)
        normalized = self._accessors.entry(index).flag("normalized")
        if normalized and normalized_dtype is not None:
            dtype = normalized_dtype
        if self._mesh is None or name not in self._mesh:
            return self._accessors.floats(index, kinds, dtype)
        return as_floats(self._decoded(self._mesh, name, kinds), normalized, dtype)

    def integers(self, name: str, kinds: tuple[str, ...]) -> NDArray[np.int64]:
        """As ``Accessors.integers``."""
        if self._mesh is None or name not in self._mesh:
            return self._accessors.integers(self._index(name), kinds)
        return self._decoded(self._mesh, name, kinds).astype(np.int64)

    def indices(self, size: int) -> NDArray[np.int64]:
        """int64 [n]: the vertices of ``size`` in the order in which they are drawn."""
        if self._mesh is not None:
            return self._mesh.indices.reshape(-1)
        if "indices" not in self._primitive:
            return np.arange(size)
        return self._accessors.integers(self._document.index(self._primitive, "indices", "accessors"), ("SCALAR",)).reshape(-1)

    def _index(self, name: str) -> int:
        return self._document.index(self._attributes, name, "accessors")

    def _decoded(self, mesh: DracoMesh, name: str, kinds: tuple[str, ...]) -> NDArray[Any]:
        values = mesh.values(name)
        if f"VEC{values.shape[1]}" not in kinds:
            raise ModelError(f"{self._attributes.at(name)} must be {' or '.join(kinds)}, got {values.shape[1]} components")
        return values


def _side_by_side(arrays: list[NDArray[Any]]) -> NDArray[Any]:
    """Arrays [V, n] as one; a single one as it is, since others may share it."""
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays, axis=1)


def _upright(values: NDArray[np.floating], transform: NDArray[np.float64] | None) -> NDArray[np.float32]:
    """glTF's texture coordinates with their transform [2, 3], turned from (0, 0) at the upper left to the lower left."""
    u, v = values[:, 0], values[:, 1]
    if transform is not None:
        u, v = u.astype(np.float64), v.astype(np.float64)
        u, v = ((row[0] * u + row[1] * v) + row[2] for row in transform)
    return np.stack([u, 1 - v], axis=1).astype(np.float32)

"""Primitives: triangles and what their vertices have."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ..colors import within_0_to_1
from ..model import ModelError
from .accessors import Accessors, as_floats
from .document import Document
from .draco import DracoMesh
from .extensions import DRACO
from .json_values import JsonObject
from .materials import Materials, Surface
from .morph import Morph

_MODES = ("points", "lines", "line loops", "line strips", "triangles", "triangle strips", "triangle fans")
_POINTS, _LINES, _LOOP, _LINE_STRIP, _TRIANGLES, _STRIP = range(6)


@dataclass(frozen=True, eq=False)
class Primitive:
    """A primitive in the mesh's own space. Attributes as in ``Mesh``."""

    place: str
    positions: NDArray[Any]
    elements: NDArray[np.int32]  # [N, 1] points, [N, 2] line segments or [N, 3] triangles: indices into the positions
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
        # By identity and transform of the file's own; these are kept, so that no other array gets their identity.
        self._turned: dict[tuple[int, bytes], tuple[NDArray[Any], NDArray[np.float32]]] = {}

    def of_mesh(self, index: int, weights: tuple[float, ...] | None) -> list[Primitive]:
        """The primitives of a mesh, less those that have nothing in them.

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
        attributes = primitive.object("attributes")
        source = _Attributes(self._document, self._accessors, primitive)
        if "POSITION" not in source:
            found("primitives without positions", f"{primitive.place} has no POSITION: it is not drawn")
            return None
        morph = Morph(primitive, weights, self._accessors, self._count)
        # Quotients of 16-bit integers need more than float32 to be placed without a further rounding.
        positions = morph("POSITION", source.floats("POSITION", ("VEC3",), np.float32, np.float64))
        size = len(positions)
        elements = self._elements(source, primitive, mode, size)
        if len(elements) == 0:
            return None
        surface = None
        if "material" in primitive:
            surface = self._materials.read(self._document.index(primitive, "material", "materials"))
        normals = colors = joints = joint_weights = None
        if "NORMAL" in source:
            normals = morph("NORMAL", source.floats("NORMAL", ("VEC3",))).astype(np.float32, copy=False)
        if "COLOR_0" in source:
            colors = self._colors(source, primitive, morph)
        if "JOINTS_0" in source:
            sets = [n for n in range(len(list(attributes))) if f"JOINTS_{n}" in source]
            joints = _side_by_side([source.integers(f"JOINTS_{n}", ("VEC4",)) for n in sets])
            joint_weights = _side_by_side([source.floats(f"WEIGHTS_{n}", ("VEC4",)) for n in sets])
        uvs = self._uvs(source, morph, surface)
        for name, values in (("NORMAL", normals), ("TEXCOORD", uvs), ("COLOR_0", colors), ("JOINTS_0", joints)):
            if values is not None and len(values) != size:
                raise ModelError(f"{attributes.place}: {name} must have as many elements as POSITION, {size}, got {len(values)}")
        return Primitive(primitive.place, positions, elements, normals, uvs, colors, joints, joint_weights, surface)

    def _elements(self, source: _Attributes, primitive: JsonObject, mode: int, size: int) -> NDArray[np.int32]:
        """int32 [N, 1], [N, 2] or [N, 3]."""
        indices = source.indices(size)
        if source.is_compressed:
            mode = _TRIANGLES
        if len(indices) and indices.max() >= size:
            got = f"got indices from {indices.min()} to {indices.max()}"
            raise ModelError(f"{primitive.at('indices')} must index the {size} vertices, {got}")
        together = {_LINES: 2, _TRIANGLES: 3}.get(mode)
        if together is not None:
            left = len(indices) % together
            if left:
                what = f"{primitive.place} has {len(indices)} corners, which is no multiple of {together}"
                self._document.model.found(f"incomplete {_MODES[mode]}", f"{what}: the last {left} are not drawn")
            return indices[: len(indices) - left].reshape(-1, together).astype(np.int32)
        return indices[_orders(mode, len(indices))].astype(np.int32)

    def _colors(self, source: _Attributes, primitive: JsonObject, morph: Morph) -> NDArray[np.float32]:
        """float32 [V, 3], linear, from 0 to 1."""
        if source.has_plain_integers("COLOR_0"):
            text = f"{primitive.place} has colours in integers that are not normalized: they are drawn as if they were"
            self._document.model.found("colors that are not normalized", text)
        colors = source.floats("COLOR_0", ("VEC3", "VEC4"), normalized=True)
        return within_0_to_1(self._document.model, morph("COLOR_0", colors)[:, :3]).astype(np.float32, copy=False)

    def _uvs(self, source: _Attributes, morph: Morph, surface: Surface | None) -> NDArray[np.float32] | None:
        """The texture coordinates that the material asks for, (0, 0) at the lower left."""
        name = f"TEXCOORD_{surface.set if surface else 0}"
        if name not in source:
            return None
        values = source.floats(name, ("VEC2",))
        moved = morph(name, values)
        transform = None if surface is None else surface.transform
        if moved is not values:
            return _upright(moved, transform)
        key = (id(values), b"" if transform is None else transform.tobytes())
        if key not in self._turned:
            self._turned[key] = values, _upright(values, transform)
        return self._turned[key][1]


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

    def has_plain_integers(self, name: str) -> bool:
        """Whether an attribute is integers that stand for themselves."""
        index = self._index(name)
        return not (self._accessors.is_normalized(index) or self._accessors.has_floats(index))

    def floats(
        self,
        name: str,
        kinds: tuple[str, ...],
        dtype: DTypeLike = np.float32,
        normalized_dtype: DTypeLike | None = None,
        normalized: bool | None = None,
    ) -> NDArray[Any]:
        """As ``Accessors.floats``; with ``normalized_dtype`` for those that are divided."""
        index = self._index(name)
        normalized = self._accessors.is_normalized(index) if normalized is None else normalized
        if normalized and normalized_dtype is not None:
            dtype = normalized_dtype
        if self._mesh is None or name not in self._mesh:
            return self._accessors.floats(index, kinds, dtype, normalized)
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


def _orders(mode: int, count: int) -> NDArray[np.int64]:
    """int64 [N, k]: which of ``count`` corners belong together, for points and what goes on from its last element."""
    if mode == _POINTS:
        return np.arange(count)[:, None]
    if mode in (_LOOP, _LINE_STRIP):
        first = np.arange(count if mode == _LOOP else max(count - 1, 0))
        return np.stack([first, (first + 1) % max(count, 1)], axis=1)
    first = np.arange(max(count - 2, 0))
    if mode == _STRIP:
        # Every other triangle goes round the other way.
        odd = first % 2
        return np.stack([first, first + 1 + odd, first + 2 - odd], axis=1)
    return np.stack([first + 1, first + 2, np.zeros_like(first)], axis=1)


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

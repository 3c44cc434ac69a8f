"""Accessors: typed arrays over the bytes of buffer views."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ..model import ModelError
from .document import Document
from .json_values import JsonObject

_COMPONENTS: dict[int, np.dtype[Any]] = {
    5120: np.dtype("i1"),
    5121: np.dtype("u1"),
    5122: np.dtype("<i2"),
    5123: np.dtype("<u2"),
    5125: np.dtype("<u4"),
    5126: np.dtype("<f4"),
}
_FLOAT = 5126
_INDEX_COMPONENTS = (5121, 5123, 5125)
# (columns, rows): a vector is one column.
_SHAPES = {
    "SCALAR": (1, 1),
    "VEC2": (1, 2),
    "VEC3": (1, 3),
    "VEC4": (1, 4),
    "MAT2": (2, 2),
    "MAT3": (3, 3),
    "MAT4": (4, 4),
}
# An accessor without a buffer view is all zeros, however many it announces. Beyond this they are no model.
_MOST_ZEROS = 2**24


class Accessors:
    """Reads accessors by their indices. Asked twice for the same, it gives the same array, which nobody may write to."""

    def __init__(self, document: Document) -> None:
        self._document = document
        self._known: dict[tuple[int, str, bool], NDArray[Any]] = {}

    def entry(self, index: int) -> JsonObject:
        return self._document.all("accessors")[index]

    def has_data(self, index: int) -> bool:
        entry = self.entry(index)
        return "bufferView" in entry or "sparse" in entry

    def is_normalized(self, index: int) -> bool:
        return self.entry(index).flag("normalized")

    def has_floats(self, index: int) -> bool:
        return self.entry(index).whole("componentType") == _FLOAT

    def floats(
        self, index: int, kinds: tuple[str, ...], dtype: DTypeLike = np.float32, normalized: bool | None = None
    ) -> NDArray[Any]:
        """float [count, rows]; [count, columns * rows] of matrices, column by column.

        Integers are divided by their largest value where the accessor is normalized, or where ``normalized`` says so.

        Args:
            kinds: the types that are allowed here, of "SCALAR", "VEC2" to "VEC4" and "MAT2" to "MAT4".
            dtype: what to give and to divide in: float32 holds 16-bit integers, but not their quotients.

        Raises:
            ModelError: another type, or data that are not there.
        """
        self._check_kind(index, kinds)
        normalized = self.is_normalized(index) if normalized is None else normalized
        key = (index, np.dtype(dtype).name, normalized)
        if key not in self._known:
            self._known[key] = as_floats(self._raw(index), normalized, dtype)
        return self._known[key]

    def integers(self, index: int, kinds: tuple[str, ...]) -> NDArray[np.int64]:
        """int64 [count, rows].

        Raises:
            ModelError: another type, floats, or data that are not there.
        """
        self._check_kind(index, kinds)
        entry = self.entry(index)
        if entry.chosen("componentType", tuple(_COMPONENTS)) not in _INDEX_COMPONENTS:
            wanted = ", ".join(map(str, _INDEX_COMPONENTS))
            raise ModelError(f"{entry.at('componentType')} must be one of {wanted} here, got {entry.whole('componentType')}")
        key = (index, "int64", False)
        if key not in self._known:
            self._known[key] = self._raw(index).astype(np.int64)
        return self._known[key]

    def _check_kind(self, index: int, kinds: tuple[str, ...]) -> None:
        entry = self.entry(index)
        if (kind := entry.text("type")) not in kinds:
            raise ModelError(f"{entry.at('type')} must be {' or '.join(kinds)} here, got {kind!r}")

    def _raw(self, index: int) -> NDArray[Any]:
        """[count, columns * rows] of the component's own dtype."""
        entry = self.entry(index)
        columns, rows = _SHAPES[entry.text("type")]
        component = _COMPONENTS[entry.chosen("componentType", tuple(_COMPONENTS))]
        count = entry.whole("count")
        if "bufferView" in entry:
            values = self._strided(entry, count, columns, rows, component)
        elif count <= _MOST_ZEROS:
            values = np.zeros((count, columns, rows), component)
        else:
            raise ModelError(f"{entry.at('count')} must be at most {_MOST_ZEROS} without a bufferView, got {count}")
        if "sparse" in entry:
            values = self._replaced(entry.object("sparse"), values)
        return values.reshape(count, columns * rows)

    def _replaced(self, sparse: JsonObject, values: NDArray[Any]) -> NDArray[Any]:
        """A copy with some of the elements replaced."""
        count, shape = sparse.whole("count"), values.shape
        indices, replacements = sparse.object("indices"), sparse.object("values")
        component = _COMPONENTS[indices.chosen("componentType", _INDEX_COMPONENTS)]
        where = self._strided(indices, count, 1, 1, component).reshape(count).astype(np.int64)
        if count and where.max() >= len(values):
            raise ModelError(f"{indices.place} must index the {len(values)} elements, got {where.max()}")
        result = values.copy()
        result[where] = self._strided(replacements, count, shape[1], shape[2], values.dtype)
        return result

    def _strided(self, entry: JsonObject, count: int, columns: int, rows: int, component: np.dtype[Any]) -> NDArray[Any]:
        """[count, columns, rows], where the bytes lie."""
        index = self._document.index(entry, "bufferView", "bufferViews")
        view, data = self._document.all("bufferViews")[index], self._document.view_bytes(index)
        # Every column of a matrix begins at a multiple of 4 bytes.
        column = -(-rows * component.itemsize // 4) * 4 if columns > 1 else rows * component.itemsize
        size = column * columns
        stride = view.whole("byteStride", size, low=1)
        if stride < size:
            raise ModelError(f"{view.at('byteStride')} must be at least {size} for {entry.place}, got {stride}")
        start = entry.whole("byteOffset", 0)
        end = start + (stride * (count - 1) + size if count else 0)
        if end > len(data):
            raise ModelError(f"{entry.place} must lie within the {len(data)} bytes of {view.place}, got bytes {start} to {end}")
        return np.ndarray((count, columns, rows), component, data, start, (stride, column, component.itemsize))


def as_floats(values: NDArray[Any], normalized: bool, dtype: DTypeLike) -> NDArray[Any]:
    """The numbers that components stand for; integers in [-1, 1] or [0, 1] where they are normalized."""
    result = values.astype(dtype, copy=False)
    if normalized and values.dtype.kind in "iu":
        result = result / np.dtype(dtype).type(np.iinfo(values.dtype).max)
        # The lowest of signed integers would give a little less than -1.
        return np.maximum(result, -1) if values.dtype.kind == "i" else result
    return result

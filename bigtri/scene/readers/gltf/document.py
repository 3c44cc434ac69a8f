"""A glTF file's lists of objects and its bytes, read when they are asked for."""

from __future__ import annotations

from pathlib import Path

from ..model import Model, ModelError
from .container import unpack
from .json_values import JsonObject
from .uris import resolve

# Extensions that put compressed bytes where a plain reader finds none.
_COMPRESSED_VIEWS = ("EXT_meshopt_compression", "KHR_meshopt_compression", "MESHOPT_compression")


class Document:
    """A glTF file.

    Attributes:
        root: the whole JSON.
        model: what is being made of it; findings go there.
    """

    def __init__(self, path: Path) -> None:
        self._folder = path.parent
        self.root, self._binary = unpack(path.read_bytes())
        self.model = Model()
        self._lists: dict[str, list[JsonObject]] = {}
        self._buffers: dict[int, memoryview] = {}

    def all(self, kind: str) -> list[JsonObject]:
        """A list of the root, such as "meshes"."""
        if kind not in self._lists:
            self._lists[kind] = self.root.objects(kind)
        return self._lists[kind]

    def index(self, owner: JsonObject, key: str, kind: str) -> int:
        """An index that an object has under a key, into a list of the root."""
        return owner.index(key, len(self.all(kind)), kind)

    def follow(self, owner: JsonObject, key: str, kind: str) -> JsonObject | None:
        """What such an index stands for; None where there is none."""
        return self.all(kind)[self.index(owner, key, kind)] if key in owner else None

    def source(self, uri: str) -> Path | bytes:
        """The file that a URI names, or its data."""
        return resolve(uri, self._folder)

    def view_bytes(self, index: int) -> memoryview:
        """The bytes of a buffer view.

        Raises:
            ModelError: it lies beyond its buffer, or the buffer has no data.
        """
        view = self.all("bufferViews")[index]
        buffer = self.index(view, "buffer", "buffers")
        compression = next((name for name in _COMPRESSED_VIEWS if view.extension(name) is not None), None)
        if compression is not None and not self._has_data(buffer):
            raise ModelError(f"{view.place} has its data in {compression} alone, which is not read")
        data = self._buffer(buffer)
        start, size = view.whole("byteOffset", 0), view.whole("byteLength")
        if start + size > len(data):
            raise ModelError(
                f"{view.place} must lie within the {len(data)} bytes of buffers[{buffer}], got bytes {start} to {start + size}"
            )
        return data[start : start + size]

    def _has_data(self, index: int) -> bool:
        return "uri" in self.all("buffers")[index] or (index == 0 and self._binary is not None)

    def _buffer(self, index: int) -> memoryview:
        if index in self._buffers:
            return self._buffers[index]
        buffer = self.all("buffers")[index]
        if not self._has_data(index):
            raise ModelError(f"{buffer.place} must have a uri or be the first one of a GLB with a binary chunk, got neither")
        if "uri" in buffer:
            data = self._loaded(buffer)
        else:
            assert self._binary is not None
            data = self._binary
        size = buffer.whole("byteLength")
        if size > len(data):
            raise ModelError(f"{buffer.place} is truncated: byteLength announces {size} bytes, got {len(data)}")
        self._buffers[index] = data[:size]
        return self._buffers[index]

    def _loaded(self, buffer: JsonObject) -> memoryview:
        try:
            source = self.source(buffer.text("uri"))
            return memoryview(source if isinstance(source, bytes) else source.read_bytes())
        except (ModelError, OSError) as error:
            raise ModelError(f"{buffer.at('uri')}: {error}") from None

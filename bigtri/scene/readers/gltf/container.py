"""The outermost layer of a glTF file: a GLB's chunks, or the JSON by itself."""

from __future__ import annotations

import json
import struct
from typing import Any

from ..model import ModelError
from .json_values import JsonObject

_MAGIC = b"glTF"
_HEADER = struct.Struct("<4sII")  # magic, version, length of the whole, bytes
_CHUNK = struct.Struct("<II")  # length of the data that follows, bytes, and its type
_JSON_TYPE, _BINARY_TYPE = 0x4E4F534A, 0x004E4942


def unpack(data: bytes) -> tuple[JsonObject, memoryview | None]:
    """The JSON, and the binary chunk if there is one.

    Whether it is a GLB is told from its first bytes, not from the name of the file.

    Raises:
        ModelError: neither a GLB nor JSON, truncated, or not of version 2.
    """
    if data[:4] != _MAGIC:
        if data.lstrip(b"\xef\xbb\xbf \t\r\n")[:1] != b"{":
            raise ModelError(f'the file must begin with "glTF", as a GLB does, or with a JSON object, got {data[:8]!r}')
        root, binary = _parsed(data), None
    else:
        chunks = _chunks(data)
        if not chunks or chunks[0][0] != _JSON_TYPE:
            raise ModelError("the first chunk of the GLB must be JSON, got " + (f"type {chunks[0][0]:#x}" if chunks else "none"))
        root = _parsed(bytes(chunks[0][1]))
        binary = next((content for kind, content in chunks[1:] if kind == _BINARY_TYPE), None)
    asset = root.object("asset")
    for key in ("version", "minVersion"):
        version = asset.text(key, "2.0")
        if version.partition(".")[0] != "2" or (key == "minVersion" and version != "2.0"):
            raise ModelError(f"{asset.at(key)} must be 2.0, got {version!r}: convert the file to glTF 2.0")
    return root, binary


def _chunks(data: bytes) -> list[tuple[int, memoryview]]:
    """(type, content) of every chunk of a GLB."""
    if len(data) < _HEADER.size:
        raise ModelError(f"the header of the GLB must have {_HEADER.size} bytes, got {len(data)}")
    _, version, length = _HEADER.unpack_from(data)
    if version != 2:
        raise ModelError(f"the GLB must be of version 2, got {version}")
    if length > len(data):
        raise ModelError(f"the GLB is truncated: its header announces {length} bytes, got {len(data)}")
    chunks: list[tuple[int, memoryview]] = []
    content, start = memoryview(data)[:length], _HEADER.size
    while start + _CHUNK.size <= length:
        size, kind = _CHUNK.unpack_from(content, start)
        start += _CHUNK.size
        if start + size > length:
            raise ModelError(f"chunk {len(chunks)} of the GLB is truncated: it announces {size} bytes, got {length - start}")
        chunks.append((kind, content[start : start + size]))
        start += size
    return chunks


def _parsed(data: bytes) -> JsonObject:
    try:
        # A GLB's JSON is padded with spaces, by some writers with zeros.
        return JsonObject(json.loads(data.rstrip(b"\0 ").decode("utf-8-sig"), parse_constant=_refuse_constant))
    except UnicodeDecodeError as error:
        raise ModelError(f"the JSON must be UTF-8, got the byte {data[error.start]:#x} at {error.start}") from None
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}"
        raise ModelError(f"the JSON is broken or truncated at {where}: {error.msg}") from None
    except RecursionError:
        raise ModelError("the JSON is nested too deeply") from None
    except ModelError:
        raise
    except ValueError as error:  # a number of thousands of digits
        raise ModelError(f"the JSON is broken: {error}") from None


def _refuse_constant(name: str) -> Any:
    raise ModelError(f"the JSON must have finite numbers alone, got {name}")

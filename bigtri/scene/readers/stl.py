"""STL, binary and ASCII, as a ``Model``."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .colors import linear_colors
from .files import decoded
from .model import Mesh, Model, ModelError
from .text import numbers

_HEADER = 84  # bytes: 80 of text, then the number of triangles
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_UNCOLORED = 0.6  # linear, as surfaces without a colour are
_ASCII = re.compile(rb"(\xef\xbb\xbf)?\s*(solid|facet)\b", re.IGNORECASE)
# Where a solid begins, or ends: the word and the name, which goes to the end of the line or to the first facet.
_SOLID = re.compile(rb"solid\b(.*?)(?=[\r\n]|\Z|\bfacet\s+normal\s+[-+.\dn])")


@np.errstate(over="ignore", invalid="ignore")
def read(path: Path) -> Model:
    """The triangles of an STL file: one mesh for each solid. Normals are not read: they are those of the triangles.

    Raises:
        ModelError: the file is broken; the text says where.
    """
    data = path.read_bytes()
    model = Model()
    # Binary files may begin with "solid" too, but have zero bytes soon, and no words after it.
    if _ASCII.match(data) and (b"\0" not in data[:256] or re.search(rb"\bvertex\s", data[:1024], re.IGNORECASE)):
        _read_ascii(model, path.name, data)
    else:
        _read_binary(model, path.name, data)
    return model


def _read_binary(model: Model, name: str, data: bytes) -> None:
    if len(data) < _HEADER:
        raise ModelError(f"a binary STL file must have a header of {_HEADER} bytes, got {len(data)} bytes")
    announced = int.from_bytes(data[80:_HEADER], "little")
    count = min(announced, (len(data) - _HEADER) // _TRIANGLE.itemsize)
    if count < announced:
        model.found("truncated file", f"{announced} triangles are announced, {count} are there and drawn")
    records = np.frombuffer(data, _TRIANGLE, count, _HEADER) if count else np.empty(0, _TRIANGLE)
    colors = _colors(model, data[:80], records["attribute"])
    model.meshes.append(_mesh(name, records["corners"].astype(np.float32), colors))


def _colors(model: Model, header: bytes, attribute: NDArray[np.uint16]) -> NDArray[np.float32] | None:
    """float32 [T, 3], linear, of 5 bits a channel, in either of the two ways that programs have added them to the format."""
    codes = np.stack([(attribute >> shift) & 31 for shift in (0, 5, 10)], axis=1) / 31
    is_set = attribute >> 15 == 1
    _, given, color = header.partition(b"COLOR=")
    if given and len(color) >= 4:
        # Materialise Magics: a colour of the whole, in bytes; the bit says that a triangle has none of its own. Red is lowest.
        codes[is_set] = np.frombuffer(color, np.uint8, 3) / 255
        if color[3] < 255:
            model.found("transparency", "the colour has an alpha below 255: it is drawn opaque")
        return linear_colors(model, codes, "f8")
    if not is_set.any():
        return None
    # VisCAM and SolidView: the bit says that a triangle has a colour. Blue is lowest.
    colors = linear_colors(model, codes[:, ::-1], "f8")
    colors[~is_set] = _UNCOLORED
    return colors


def _read_ascii(model: Model, name: str, data: bytes) -> None:
    text = data.lower()
    begins = (match for match in _SOLID.finditer(text) if text[max(match.start() - 3, 0) : match.start()] != b"end")
    solids = [match.span(1) for match in begins] or [(0, 0)]
    for (begin, after_name), end in zip(solids, [begin for begin, _ in solids[1:]] + [len(data)], strict=True):
        corners, facets = _ascii_corners(text[after_name:end].partition(b"endsolid")[0])
        if len(corners) != 3 * facets:
            complete = min(len(corners) // 3, facets)
            model.found("truncated file", f"{facets} triangles begin, {complete} are complete and drawn")
            corners = corners[: 3 * complete]
        own = decoded(data[begin:after_name]).strip()
        mesh = _mesh(own if own and len(solids) > 1 else name, corners.reshape(-1, 3, 3), None)
        model.meshes.append(replace(mesh, instances=np.array([len(model.meshes)], np.int32)))


def _ascii_corners(text: bytes) -> tuple[NDArray[np.float64], int]:
    """(float64 [C, 3], the vertices of a solid in lower case; how many triangles begin in it)."""
    facets = text.count(b"facet") - text.count(b"endfacet")
    loops = [part.partition(b"endloop")[0] for part in text.split(b"outer loop")[1:]]
    try:
        values = numbers(b" ".join(loops).replace(b"vertex", b""), np.float64, "")
        if len(values) == 9 * facets:
            return values.reshape(-1, 3), facets
    except ModelError:
        pass
    # Spaced in another way, or incomplete.
    vertices = re.findall(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", text)
    corners = numbers(b" ".join(map(b" ".join, vertices)), np.float64, "the coordinates of vertices")
    return corners.reshape(-1, 3), facets


def _mesh(name: str, corners: NDArray[np.floating], colors: NDArray[np.float32] | None) -> Mesh:
    """A mesh of triangles [T, 3, 3] that share no vertex."""
    triangles = np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3)
    return Mesh(name, corners.reshape(-1, 3), triangles, colors=colors, colors_of_faces=colors is not None)

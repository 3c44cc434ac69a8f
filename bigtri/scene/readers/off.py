"""OFF, with colours, normals and texture coordinates, as a ``Model``."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .colors import linear_colors
from .model import Mesh, Model, ModelError
from .polygons import indices_of, triangulate
from .text import numbers

_UNCOLORED = 0.6  # linear, as surfaces without a colour are


class _Rows(NamedTuple):
    """Lines of numbers."""

    lines: list[bytes]
    values: NDArray[np.float64]  # all numbers, one after the other
    begin: NDArray[np.int64]  # [lines], where those of a line begin
    lengths: NDArray[np.int64]  # [lines], how many it has


@np.errstate(over="ignore", invalid="ignore")
def read(path: Path) -> Model:
    """The faces of an OFF file.

    Raises:
        ModelError: the file is broken, binary or of other dimensions; the text says where.
    """
    model = Model()
    data = path.read_bytes().removeprefix(b"\xef\xbb\xbf")
    lines = [line for line in (line.partition(b"#")[0].strip() for line in re.split(rb"[\r\n]+", data)) if line]
    has_uvs, has_normals = _header(lines)
    vertex_count, face_count = _counts(lines)
    if len(lines) < vertex_count:
        raise ModelError(f"the file ends within the vertices: {vertex_count} are announced, {len(lines)} are there")
    face_lines = lines[vertex_count : vertex_count + face_count]
    if data[-1:] not in (b"\n", b"\r") and len(lines) <= vertex_count + face_count and not _is_whole(face_lines):
        del face_lines[-1]
    faces = _rows("faces", face_lines, 1)
    vertices = _rows("vertices", lines[:vertex_count], 3)
    if len(faces.lines) < face_count:
        model.found("truncated file", f"{face_count} faces are announced, {len(faces.lines)} are there and drawn")

    positions = vertices.values[vertices.begin[:, None] + np.arange(3)]
    normals = _column(vertices, 3, 3) if has_normals else None
    uvs = _column(vertices, -2, 2) if has_uvs else None
    before = 3 + 3 * has_normals
    colors = _colors(model, vertices, np.full(len(vertices.lines), before), vertices.lengths - before - 2 * has_uvs)

    size = faces.values[faces.begin].astype(np.int64)
    short = faces.lengths < 1 + np.maximum(size, 0)
    if short.any() or (size < 0).any():
        line = faces.lines[int(np.argmax(short | (size < 0)))][:60].decode("latin-1")
        raise ModelError(f"a face must be the number of its corners, then as many indices, got {line!r}")
    offset = np.arange(size.sum()) - np.repeat(np.cumsum(size) - size, size)
    corners = indices_of("faces", faces.values[np.repeat(faces.begin + 1, size) + offset], len(positions))
    corner, of_face = triangulate(model, positions, corners, size)
    face_colors = _colors(model, faces, 1 + size, faces.lengths - 1 - size) if colors is None else None
    if not len(corner):
        model.found("points", f"there are {len(positions)} points and no faces: points are not drawn")
    model.meshes.append(
        Mesh(
            path.name,
            positions,
            corners[corner],
            normals,
            None if uvs is None else uvs.astype(np.float32),
            colors if face_colors is None else face_colors[of_face],
            face_colors is not None,
        )
    )
    return model


def _header(lines: list[bytes]) -> tuple[bool, bool]:
    """Whether vertices have texture coordinates, and normals. Takes the keyword, which may be missing, off the lines."""
    match = re.match(rb"(ST)?C?(N)?(4)?(n)?(?:OFF|off)(?![A-Za-z])\s*(.*)", lines[0]) if lines else None
    if match is None:
        if not lines or not re.match(rb"\d+\s+\d", lines[0]):
            got = lines[0][:16].decode("latin-1") if lines else ""
            raise ModelError(f"an OFF file must begin with OFF, got {got!r}")
        return False, False
    uvs, normals, homogeneous, dimensions, rest = match.groups()
    if homogeneous or dimensions or rest.upper().startswith(b"BINARY"):
        raise ModelError(f"an OFF file must be text and of three dimensions, got {lines[0][:40].decode('latin-1')!r}")
    lines[:1] = [rest] if rest else []
    return uvs is not None, normals is not None


def _counts(lines: list[bytes]) -> tuple[int, int]:
    """How many vertices and faces there are. Takes them off the lines."""
    line = lines.pop(0) if lines else b""
    try:
        vertices, faces = (int(word) for word in line.split()[:2])
        if min(vertices, faces) < 0:
            raise ValueError
    except ValueError:
        got = line[:40].decode("latin-1")
        raise ModelError(f"an OFF file must give the numbers of vertices, faces and edges, got {got!r}") from None
    return vertices, faces


def _is_whole(faces: list[bytes]) -> bool:
    """Whether the last line of faces has all its corners; where a file ends early it may not."""
    words = faces[-1].split() if faces else [b"0"]
    try:
        return len([float(word) for word in words]) > float(words[0])
    except ValueError:
        return False


def _rows(what: str, lines: list[bytes], least: int) -> _Rows:
    count = np.array([len(line.split()) for line in lines], np.int64)
    if (count < least).any():
        line = lines[int(np.argmax(count < least))][:40].decode("latin-1")
        raise ModelError(f"{what} must have {least} numbers or more, got {line!r}")
    return _Rows(lines, numbers(b" ".join(lines), np.float64, what), np.cumsum(count) - count, count)


def _column(rows: _Rows, at: int, size: int) -> NDArray[np.float64]:
    """[lines, size]: numbers from ``at`` on, which may count from the end."""
    if (rows.lengths < 3 + size).any():
        raise ModelError(f"vertices must have {3 + size} numbers or more, got {rows.lengths.min()}")
    begin = rows.begin + (at if at >= 0 else rows.lengths + at)
    return rows.values[begin[:, None] + np.arange(size)]


def _colors(model: Model, rows: _Rows, at: Any, count: NDArray[np.int64]) -> NDArray[np.float32] | None:
    """float32 [lines, 3], linear, of the ``count`` numbers [lines] from ``at`` [lines] on: three, or four with alpha.

    The format has integers to 255 and floating point to 1 and does not say which. Whole numbers that are all at most 1 are the
    latter: as integers they would all be black.
    """
    colored = (count == 3) | (count == 4)
    if not colored.any():
        if (count == 1).any():
            model.found("color maps", "colours are indices into a colour map, which is not read: they are drawn grey")
        return None
    codes = rows.values[(rows.begin + at)[colored, None] + np.arange(3)]
    alpha = rows.values[(rows.begin + at)[count == 4] + 3]
    both = np.concatenate([codes.reshape(-1), alpha])
    is_float = bool((both <= 1).all() or (both != np.rint(both)).any())
    if (alpha < (1 if is_float else 255)).any():
        model.found("transparency", "colours have an alpha below 1: they are drawn opaque")
    colors = np.full((len(count), 3), _UNCOLORED, np.float32)
    colors[colored] = linear_colors(model, codes, "f8" if is_float else "u1")
    return colors

"""The container of PLY: a header that declares elements, and their rows, ASCII or binary, as columns."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .files import decoded
from .model import ModelError
from .text import leading_numbers

_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4", "double": "f8"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8"},
    **{"float16": "f2", "float32": "f4", "float64": "f8"},
}
_FORMATS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}


class Property(NamedTuple):
    name: str
    type: str  # of NumPy, without the order of bytes
    count_type: str | None  # that of the length, where the property is a list


@dataclass
class Element:
    """What is declared, and once it is read what is there.

    Attributes:
        name: such as "vertex".
        announced: the number of rows that the header says.
        properties: in the order of the file.
        count: rows that are there, all of them whole.
        columns: by the property's name, an array [count] or lists. Numbers of an ASCII file are float64, whatever their type.
    """

    name: str
    announced: int
    properties: list[Property] = field(default_factory=list)
    count: int = 0
    columns: dict[str, Any] = field(default_factory=dict)

    def type_of(self, name: str) -> str:
        return next(p.type for p in self.properties if p.name == name)


class Lists(NamedTuple):
    values: NDArray[Any]  # [C], those of a row after each other
    lengths: NDArray[np.int64]  # [rows], how many of them each row has


class Header(NamedTuple):
    format: str
    comments: list[str]
    elements: list[Element]
    size: int  # bytes


def read_elements(data: bytes) -> tuple[list[Element], list[str]]:
    """All elements of a file, and its comments.

    A file that ends early has fewer rows in the element where it ends, and none in those after it. A word of an ASCII file that
    its end has cut counts as missing. What follows the last element is left alone.

    Raises:
        ModelError: the header or a row is broken.
    """
    header = _header(data)
    rest = b""
    if header.format == "ascii":
        # As if it were binary, each number a float64.
        values, rest = leading_numbers(data[header.size :])
        rows, at, order = memoryview(values.tobytes()), 0, None
    else:
        rows, at, order = memoryview(data), header.size, _FORMATS[header.format]
    for element in header.elements:
        at = _read_rows(rows, at, element, _parts(element, order))
        if element.count < element.announced:
            words = rest.split(maxsplit=1)
            if len(words) > 1:
                raise ModelError(f"the body of an ASCII file must be numbers, got {words[0][:40].decode('latin-1')!r}")
            break
    return header.elements, header.comments


def _header(data: bytes) -> Header:
    # The first line shows whether lines end in a carriage return alone.
    opening = re.match(rb"\s*ply[ \t]*(\r\n|\n|\r)", data)
    if opening is None:
        raise ModelError(f"a PLY file must begin with the line ply, got {data[:16]!r}")
    end_of_line = b"\r" if opening.group(1) == b"\r" else b"\n"
    form, comments, elements, at, number = "", [], [], opening.end(), 1
    while True:
        end = data.find(end_of_line, at)
        if end < 0:
            raise ModelError(f"the header must end with the line end_header; the file ends after line {number}")
        line, at, number = decoded(data[at:end]).strip(), end + len(end_of_line), number + 1
        keyword, rest = (*line.split(maxsplit=1), "", "")[:2]
        try:
            if keyword == "end_header":
                break
            elif keyword == "format":
                form = rest.split()[0]
            elif keyword in ("comment", "obj_info"):
                comments.append(rest.strip())
            elif keyword == "element":
                name, announced = rest.split()
                elements.append(Element(name, int(announced)))
                if elements[-1].announced < 0:
                    raise ValueError
            elif keyword == "property":
                elements[-1].properties.append(_property(rest.split()))
            elif keyword:
                raise ValueError
        except (ValueError, IndexError, KeyError):
            raise ModelError(f"line {number} of the header cannot be read, got {line[:80]!r}") from None
    if form not in _FORMATS:
        raise ModelError(f"the format must be one of {', '.join(_FORMATS)}, got {form!r}")
    return Header(form, comments, elements, at)


def _property(words: list[str]) -> Property:
    if words[0] == "list":
        _, count_type, kind, name = words
        return Property(name, _TYPES[kind], _TYPES[count_type])
    kind, name = words
    return Property(name, _TYPES[kind], None)


class _Part(NamedTuple):
    """Properties of a row that lie together: numbers, then a list, except at the end of the row, where there may be none."""

    numbers: list[str]  # their names
    list_name: str | None
    fields: np.dtype[Any]  # the numbers, by their index, and "length", that of the list
    entry: np.dtype[Any]  # of the list


def _parts(element: Element, order: str | None) -> list[_Part]:
    """The parts of a row; ``order`` is that of the bytes, None where every number is a float64."""

    def dtype(kind: str) -> str:
        return "f8" if order is None else order + kind

    parts: list[_Part] = []
    names: list[str] = []
    fields: list[tuple[str, str]] = []
    for name, kind, length_kind in element.properties:
        if length_kind is None:
            fields.append((str(len(names)), dtype(kind)))
            names.append(name)
        else:
            parts.append(_Part(names, name, np.dtype([*fields, ("length", dtype(length_kind))]), np.dtype(dtype(kind))))
            names, fields = [], []
    if names:
        parts.append(_Part(names, None, np.dtype(fields), np.dtype("V0")))
    return parts


def _read_rows(data: memoryview, at: int, element: Element, parts: list[_Part]) -> int:
    """Fills in the rows of an element that begins at byte ``at``; returns where they end."""
    if not parts:
        element.count = element.announced
        return at
    records = _rows_of_one_length(data, at, element, parts)
    if records is not None:
        element.count = len(records)
        for i, part in enumerate(parts):
            _keep_numbers(element, part, records[f"fields {i}"])
            if part.list_name is not None:
                entries = records[f"list {i}"]
                lengths = np.broadcast_to(np.int64(entries.shape[1]), len(records))
                element.columns.setdefault(part.list_name, Lists(entries.reshape(-1), lengths))
        return at + records.nbytes
    starts, end = _starts(data, at, element, parts)
    element.count = len(starts)
    for part, start in zip(parts, starts.T, strict=True):
        fields = _gathered(data, start, part.fields, 1)[:, 0]
        _keep_numbers(element, part, fields)
        if part.list_name is not None:
            lengths = fields["length"].astype(np.int64)
            entries = _gathered_lists(data, start + part.fields.itemsize, lengths, part.entry)
            element.columns.setdefault(part.list_name, Lists(entries, lengths))
    return end


def _keep_numbers(element: Element, part: _Part, fields: NDArray[Any]) -> None:
    for i, name in enumerate(part.numbers):
        element.columns.setdefault(name, fields[str(i)])


def _rows_of_one_length(data: memoryview, at: int, element: Element, parts: list[_Part]) -> NDArray[Any] | None:
    """The rows as records, if all are there and have lists as long as the first row has; else None."""
    first = list(_walk(data, at, min(element.announced, 1), parts))
    is_whole = len(first) == len(parts) + 1 and first[-1] >= 0
    layout: list[Any] = []
    lengths = {}
    for i, part in enumerate(parts):
        layout.append((f"fields {i}", part.fields))
        if part.list_name is not None:
            size = first[i + 1] - first[i] - part.fields.itemsize if is_whole else 0
            lengths[i] = size // part.entry.itemsize
            layout.append((f"list {i}", part.entry, (lengths[i],)))
    dtype = np.dtype(layout)
    if element.announced == 0:
        return np.empty(0, dtype)
    if not is_whole or element.announced > (len(data) - at) // dtype.itemsize:
        return None
    records = np.frombuffer(data, dtype, element.announced, at)
    return records if all((records[f"fields {i}"]["length"] == length).all() for i, length in lengths.items()) else None


def _starts(data: memoryview, at: int, element: Element, parts: list[_Part]) -> tuple[NDArray[np.int64], int]:
    """int64 [rows, parts], the byte at which each part of each whole row begins, and where the rows end."""
    walked = np.fromiter(_walk(data, at, element.announced, parts), np.int64)
    if walked[-1] < 0:
        walked = walked[:-1]  # the last row that it knows the beginning of is not whole
    rows = (len(walked) - 1) // len(parts)
    return walked[: rows * len(parts)].reshape(rows, len(parts)), int(walked[rows * len(parts)])


def _walk(data: memoryview, at: int, rows: int, parts: list[_Part]) -> Iterator[int]:
    """Yields where each part of each row begins, then where the rows end; or -1 once a row does not fit."""
    steps = []
    for part in parts:
        last = part.fields[-1]  # the length, where there is a list
        # struct has the same letters for types as NumPy; "|" is NumPy's order of a single byte.
        length = struct.Struct(last.byteorder.replace("|", "=") + last.char)
        steps.append((part.fields.itemsize, part.entry.itemsize, part.fields.itemsize - last.itemsize, length))
    for _ in range(rows):
        for size, entry, length_at, length_type in steps:
            yield at
            if at + size > len(data):
                yield -1
                return
            if entry:
                (length,) = length_type.unpack_from(data, at + length_at)
                if not length >= 0:
                    raise ModelError(f"a list must have 0 entries or more, got {length} of them")
                if length > len(data):
                    yield -1
                    return
                at += int(length) * entry
            at += size
        if at > len(data):
            yield -1
            return
    yield at


def _gathered(data: memoryview, start: NDArray[np.int64], dtype: np.dtype[Any], length: int) -> NDArray[Any]:
    """[N, length] of what begins at the bytes ``start`` [N]."""
    size = dtype.itemsize * length
    if len(start) == 0 or size == 0:
        return np.empty((len(start), length), dtype)
    windows = np.lib.stride_tricks.sliding_window_view(np.frombuffer(data, np.uint8), size)
    return windows[start].view(dtype)


def _gathered_lists(data: memoryview, start: NDArray[np.int64], count: NDArray[np.int64], dtype: np.dtype[Any]) -> NDArray[Any]:
    """The entries of lists that begin at the bytes ``start`` and have ``count``, after each other."""
    begin = np.cumsum(count) - count
    values = np.empty(int(count.sum()), dtype)
    for length in np.unique(count).tolist():
        which = np.flatnonzero(count == length)
        values[begin[which, None] + np.arange(length)] = _gathered(data, start[which], dtype, length)
    return values

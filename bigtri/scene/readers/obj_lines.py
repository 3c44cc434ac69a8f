"""The lines of an OBJ file, sorted out by their keyword, and their numbers as arrays."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .files import decoded
from .model import ModelError
from .text import lines_joined, numbers

# Bytes of text whose numbers are read at a time.
_CHUNK = 1 << 22
_NEW_LINE, _SPACE, _TAB, _HASH, _SLASH = b"\n \t#/"


class Lines:
    """A file, without its continuation lines and comments.

    Attributes:
        kinds: by keyword, of "v", "vt", "vn", "f": int64, the lines that have it, rising; of "", all others that mean something.
        objects: int64, the lines that begin an object, rising; where there are none, those that begin a group.
    """

    def __init__(self, data: bytes) -> None:
        self._text = np.frombuffer(bytearray(lines_joined(data) + b"\n"), np.uint8)
        self._ends = np.flatnonzero(self._text == _NEW_LINE)
        self._begins = np.concatenate([[0], self._ends[:-1] + 1])
        first = self._begins.copy()
        indented = np.arange(len(first))
        while len(indented := indented[np.isin(self._text[first[indented]], (_SPACE, _TAB))]):
            first[indented] += 1
        a, b, c = (self._text[np.minimum(first + i, len(self._text) - 1)] for i in range(3))
        self.kinds = {word: np.flatnonzero((a == ord(word)) & (b <= _SPACE)) for word in ("v", "f")}
        for word in ("vt", "vn"):
            self.kinds[word] = np.flatnonzero((a == ord("v")) & (b == ord(word[1])) & (c <= _SPACE))
        # Objects, groups and smoothing groups may be as many as faces: their names are not read.
        self.objects = next((lines for word in "og" if len(lines := np.flatnonzero((a == ord(word)) & (b <= _SPACE)))), first[:0])
        known = np.isin(a, (_NEW_LINE, _HASH)) | (np.isin(a, [*b"ogs"]) & (b <= _SPACE))
        for word, lines in self.kinds.items():
            known[lines] = True
            for i in range(len(word)):
                self._text[first[lines] + i] = _SPACE
        self.kinds[""] = np.flatnonzero(~known)
        self._blank_comments(known)

    def _blank_comments(self, of: NDArray[np.bool_]) -> None:
        hashes = np.flatnonzero(self._text == _HASH)
        lines = np.searchsorted(self._ends, hashes)
        is_first = np.concatenate([np.ones(min(len(lines), 1), bool), lines[1:] != lines[:-1]])
        begin = hashes[is_first & of[lines]]
        length = self._ends[lines[is_first & of[lines]]] - begin
        self._text[np.repeat(begin + length - np.cumsum(length), length) + np.arange(length.sum())] = _SPACE

    def words(self, line: int) -> str:
        """A line as text, without a comment: what follows a space and #."""
        text = self._text[self._begins[line] : self._ends[line]].tobytes()
        return re.split(r"(?:^|\s)#", decoded(text), maxsplit=1)[0].strip()

    def floats(self, keyword: str, least: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """(all numbers of the lines with this keyword, how many each line has).

        Raises:
            ModelError: there is something else, or a line has fewer than ``least``.
        """
        values, counts = [np.zeros(0)], [np.zeros(0, np.int64)]
        for lines, text, ends in self._chunks(keyword):
            begins = np.flatnonzero(_run_starts(text > _SPACE))
            count = np.diff(np.searchsorted(begins, ends), prepend=0)
            if count.min() < least:
                raise self._refusal(keyword, int(lines[np.argmax(count < least)]), f"{least} numbers or more")
            values.append(self._parsed(keyword, lines, text, len(begins), np.float64))
            counts.append(count)
        return np.concatenate(values), np.concatenate(counts)

    def corners(self, sizes: dict[str, int]) -> tuple[NDArray[np.int32], NDArray[np.int64], int]:
        """The corners of all faces.

        Returns:
            corners: int32 [C, 3], the vertex, texture coordinates and normal, counted from 0; -1 is what a corner does not have,
            which is never its vertex; count: int64 [F], how many corners each face has; dangling: how many indices of texture
            coordinates or normals lead nowhere, and are -1 for that.

        Args:
            sizes: how many there are of "v", "vt" and "vn".

        Raises:
            ModelError: something is no index.
        """
        corners, counts, dangling = [np.zeros((0, 3), np.int32)], [np.zeros(0, np.int64)], 0
        for lines, text, ends in self._chunks("f"):
            is_slash = text == _SLASH
            starts = _run_starts(text > _SPACE)
            parts = np.flatnonzero(_run_starts((text > _SPACE) & ~is_slash))
            tokens = np.flatnonzero(starts)
            token = np.cumsum(starts, dtype=np.int32)[parts] - 1
            slashes = np.cumsum(is_slash, dtype=np.int32)
            field = slashes[parts] - (slashes - is_slash)[tokens][token]
            count = np.diff(np.searchsorted(tokens, ends), prepend=0)
            line = np.repeat(lines, count)  # of each token
            if (field > 2).any():
                raise self._refusal("f", int(line[token[np.argmax(field > 2)]]), "corners of the form 1, 1/2, 1//3 or 1/2/3")
            text[is_slash] = _SPACE
            index = np.zeros((len(tokens), 3), np.int64)
            index[token, field] = self._parsed("f", lines, text, len(parts), np.int64)
            for own, (kind, size) in zip(index.T, sizes.items(), strict=True):
                missing = own == 0
                if (own < 0).any():
                    # Counted back from the last one before this line.
                    own += np.where(own < 0, np.repeat(np.searchsorted(self.kinds[kind], lines), count) + 1, 0)
                own -= 1
                outside = (own < 0) | (own >= size)
                if kind == "v" and outside.any():
                    raise self._refusal("f", int(line[np.argmax(outside)]), f"indices of the {size} vertices")
                dangling += int(np.count_nonzero(outside & ~missing))
                own[outside | missing] = -1
            corners.append(index.astype(np.int32))
            counts.append(count)
        return np.concatenate(corners), np.concatenate(counts), dangling

    def _chunks(self, keyword: str) -> Iterator[tuple[NDArray[np.int64], NDArray[np.uint8], NDArray[np.int64]]]:
        """(some of the lines with this keyword, a copy of their text without it, where each ends in that)."""
        lines = self.kinds[keyword]
        lengths = self._ends[lines] + 1 - self._begins[lines]
        part = np.cumsum(lengths) // _CHUNK
        for some in np.split(np.arange(len(lines)), np.flatnonzero(np.diff(part)) + 1):
            if len(some):
                region = slice(self._begins[lines[some[0]]], self._ends[lines[some[-1]]] + 1)
                between = np.zeros(lines[some[-1]] - lines[some[0]] + 1, bool)
                between[lines[some] - lines[some[0]]] = True
                every = slice(lines[some[0]], lines[some[-1]] + 1)
                text = self._text[region][np.repeat(between, self._ends[every] + 1 - self._begins[every])]
                yield lines[some], text, np.cumsum(lengths[some])

    def _parsed(
        self,
        keyword: str,
        lines: NDArray[np.int64],
        text: NDArray[np.uint8],
        count: int,
        kind: type[np.float64] | type[np.int64],
    ) -> NDArray[Any]:
        """The ``count`` numbers in the text of lines."""
        try:
            values = numbers(text.tobytes(), kind, keyword)
            if len(values) == count:
                return values
        except ModelError:
            pass
        for line in lines.tolist():  # which one it was
            try:
                numbers(self.words(line).replace("/", " ").encode(), kind, keyword)
            except ModelError as error:
                raise ModelError(f"line {line + 1}: {error}") from None
        raise ModelError(f"{keyword} must have numbers")

    def _refusal(self, keyword: str, line: int, wanted: str) -> ModelError:
        return ModelError(f"line {line + 1}: {keyword} must have {wanted}, got {self.words(line)[:60]!r}")


def _run_starts(inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Where a run of True begins."""
    starts = inside.copy()
    starts[1:] &= ~inside[:-1]
    return starts

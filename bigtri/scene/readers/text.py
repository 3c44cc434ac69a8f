"""Numbers in text, many at a time."""

from __future__ import annotations

import re
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .model import ModelError


def lines_joined(data: bytes) -> bytes:
    """Lines that end in a backslash and the ones that go on with them as one, as OBJ and MTL have them; all end in a newline."""
    # Some editors mark the end of a file.
    data = data.removeprefix(b"\xef\xbb\xbf").rstrip(b"\0\x1a").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if b"\\\n" not in data:
        return data
    # A comment may end in a backslash, as paths do.
    return re.sub(rb"(?m)^([^#\n]*)\\\n", rb"\1 ", data)


def numbers(text: bytes, kind: type[np.float64] | type[np.int64], what: str) -> NDArray[Any]:
    """All numbers of a text of nothing else, with white space between them.

    Raises:
        ModelError: a word is no number, or no whole one for np.int64; the text begins with ``what``.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # that is how NumPy says that it met something else
        try:
            return np.fromstring(text, kind, sep=" ")
        except (DeprecationWarning, ValueError):
            pass
    convert, wanted = (float, "numbers") if kind is np.float64 else (int, "whole numbers")
    for word in text.split():
        try:
            convert(word)
        except ValueError:
            raise ModelError(f"{what} must be {wanted}, got {word[:40].decode('latin-1')!r}") from None
    raise ModelError(f"{what} must be {wanted}")


def leading_numbers(text: bytes) -> tuple[NDArray[np.float64], bytes]:
    """The numbers at the beginning of a text, and what follows them from the first word on that is none."""
    try:
        return numbers(text, np.float64, ""), b""
    except ModelError:
        end = next((match.start() for match in re.finditer(rb"\S+", text) if not _is_number(match[0])), len(text))
        return numbers(text[:end], np.float64, ""), text[end:]


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True

"""What a URI of a glTF file stands for: a file beside it, or data within it."""

from __future__ import annotations

import base64
import binascii
import os
import re
from pathlib import Path
from urllib.parse import unquote, unquote_to_bytes

from ..model import ModelError

_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):")  # two letters at least: C: is a drive


def resolve(uri: str, folder: Path) -> Path | bytes:
    """The file that a URI names, relative to the folder, or the bytes of a data URI.

    Raises:
        ModelError: no such file, data that are not base64, or a URI of the network, of which nothing is fetched.
    """
    scheme = _SCHEME.match(uri)
    if scheme is None:
        return _file(uri, folder)
    if scheme[1].lower() == "data":
        return _data(uri[scheme.end() :])
    if scheme[1].lower() == "file":
        return _file(uri[scheme.end() :].removeprefix("//"), folder)
    raise ModelError(f"a uri must be a data URI or the path of a file, got {_short(uri)}")


def _file(uri: str, folder: Path) -> Path:
    # Many writers do not quote the names of files: then %41 may be a name's own characters.
    for name in (unquote(uri), uri, unquote(uri).replace("\\", "/")):
        path = os.path.join(folder, name)
        if os.path.isfile(path):  # false as well for names that no file can have
            return Path(path)
    raise ModelError(f"there is no file {_short(unquote(uri))} beside it")


def _data(rest: str) -> bytes:
    kind, comma, content = rest.partition(",")
    if not comma:
        raise ModelError(f"a data URI must have a comma before its data, got {_short('data:' + rest)}")
    if not kind.strip().lower().endswith(";base64"):
        return unquote_to_bytes(content)
    packed = b"".join(unquote_to_bytes(content).split()).rstrip(b"=").translate(bytes.maketrans(b"-_", b"+/"))
    try:
        return base64.b64decode(packed + b"=" * (-len(packed) % 4), validate=True)
    except binascii.Error as error:
        raise ModelError(f"a data URI is not base64: {error}") from None


def _short(uri: str) -> str:
    return repr(uri if len(uri) <= 200 else f"{uri[:197]}...")

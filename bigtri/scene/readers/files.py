"""Files that a model file refers to, and text of no known encoding."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from ..images import read_image
from .model import Model, ModelError


def find(folder: Path, name: str) -> Path | None:
    """The file called ``name`` by a model file in ``folder``; None if there is none.

    Backslashes separate folders as well. A path that leads nowhere, such as an absolute one of another machine, stands for a file
    of the same name beside the model.
    """
    with_slashes = name.replace("\\", "/")
    for candidate in (name, with_slashes, with_slashes.strip('"'), with_slashes.strip('"').rpartition("/")[2]):
        # A name may be too long for a file, or have a zero byte in it.
        try:
            if candidate and os.path.isfile(folder / candidate):
                return folder / candidate
        except ValueError:
            continue
    return None


def read_texture(model: Model, folder: Path, name: str) -> NDArray[Any] | None:
    """The texture called ``name`` by a model file in ``folder``. One that is missing or broken is a finding, and None."""
    path = find(folder, name)
    if path is None:
        model.found("missing textures", f"the texture {name} is not there: what it covers is drawn without it")
        return None
    try:
        return read_image(path, f"the texture {name}")
    except ModelError as error:
        model.found("broken textures", f"{error}: what it covers is drawn without it")
        return None


def decoded(text: bytes) -> str:
    """UTF-8, else Latin-1, of which any byte is a character."""
    try:
        return text.decode()
    except UnicodeDecodeError:
        return text.decode("latin-1")

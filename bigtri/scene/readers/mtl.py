"""MTL, the material libraries of OBJ, as paints."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..vectors import Vector
from .colors import linear_colors
from .files import decoded, find, read_texture
from .model import Model, Paint
from .text import lines_joined

# The options of a map, and the most words that follow each.
_OPTIONS = {
    **{"-o": 3, "-s": 3, "-t": 3, "-mm": 2, "-blendu": 1, "-blendv": 1, "-boost": 1, "-texres": 1, "-clamp": 1, "-bm": 1},
    **{"-imfchan": 1, "-type": 1, "-cc": 1, "-colorspace": 1},
}
# What a material may have beyond its colour, by keyword, in the words of the finding.
_NOT_DRAWN = {
    **{"map_bump": "bump maps", "bump": "bump maps", "norm": "normal maps", "disp": "displacement maps"},
    **{"map_ke": "emission", "map_ks": "maps of highlights", "refl": "reflections"},
    **{"map_d": "transparency", "map_tr": "transparency"},
}


@dataclass
class Look:
    """A material.

    Attributes:
        paint: all of it that a ``Mesh`` has.
        scale, offset: what its map does to texture coordinates, ``uv * scale + offset``.
        dissolve, transparency: d and Tr as they stand in the file, NaN where they do not.
    """

    paint: Paint
    scale: list[float] = field(default_factory=lambda: [1.0, 1.0])
    offset: list[float] = field(default_factory=lambda: [0.0, 0.0])
    dissolve: float = math.nan
    transparency: float = math.nan


class Library:
    """Reads material libraries; textures of one name once."""

    def __init__(self, model: Model, folder: Path) -> None:
        """``model`` gets as findings what is not drawn; ``folder`` is where its file is."""
        self._model, self._folder = model, folder
        self._textures: dict[tuple[Path, str], NDArray[Any] | None] = {}

    def read(self, path: Path) -> dict[str, Look]:
        """The materials of a file by name; of several of one name the last."""
        looks: dict[str, Look] = {}
        look = Look(Paint())  # what stands before the first material is lost
        for line in lines_joined(path.read_bytes()).split(b"\n"):
            # A comment begins the line, or follows a space: # may be part of a name.
            words = re.split(r"(?:^|\s)#", decoded(line), maxsplit=1)[0].strip()
            keyword, _, rest = re.sub(r"\s", " ", words, count=1).partition(" ")
            keyword, rest = keyword.lower(), rest.strip()
            if keyword == "newmtl":
                look = looks[rest] = Look(Paint(rest))
            elif keyword == "kd":
                look.paint = replace(look.paint, base_color=self._color(look, "Kd", rest))
            elif keyword == "map_kd":
                self._read_map(look, rest, path.parent)
            elif keyword == "d":
                look.dissolve = _number(rest)
            elif keyword == "tr":
                look.transparency = _number(rest)
            elif keyword in _NOT_DRAWN or (keyword == "ke" and rest.strip("0. ")):
                kind = _NOT_DRAWN.get(keyword, "emission")
                self._model.found(kind, f"the material {look.paint.name} has {keyword}, {kind}: it is drawn without")
                if keyword == "ke" and (emissive := self._color(look, keyword, rest)) is not None:
                    look.paint = replace(look.paint, emissive=emissive)
        for look in looks.values():
            self._set_alpha(look)
        return looks

    def _set_alpha(self, look: Look) -> None:
        """Where a material has both d and Tr, programs differ in what they mean by Tr: d is taken."""
        alpha = look.dissolve if not math.isnan(look.dissolve) else 1 - look.transparency
        if alpha < 1:
            self._model.found("transparency", f"the material {look.paint.name} is transparent: it is drawn opaque")
            look.paint = replace(look.paint, alpha=max(alpha, 0.0), alpha_mode="blend")

    def _color(self, look: Look, keyword: str, rest: str) -> Vector | None:
        """Three numbers from 0 to 1, sRGB; those that are missing are as the first."""
        try:
            codes = [float(word) for word in rest.split()[:3]]
            if not all(map(math.isfinite, codes)):
                raise ValueError
            red, green, blue = linear_colors(self._model, np.array((codes + codes[:1] * 3)[:3]), "f8").tolist()
            return red, green, blue
        except ValueError:  # spectra and XYZ colours, too
            name = look.paint.name
            self._model.found(
                "unknown colors", f"the material {name} has {keyword} {rest[:40]!r}, which is not numbers: it is drawn without"
            )
            return None

    def _read_map(self, look: Look, rest: str, folder: Path) -> None:
        """A texture: options, then the name of its file, which may have spaces in it."""
        wrap, look.scale, look.offset = "repeat", [1.0, 1.0], [0.0, 0.0]
        while match := re.match(r"(-[a-z_]+)\s+", rest, re.IGNORECASE):
            option = match.group(1).lower()
            words: list[str] = []
            if option not in _OPTIONS:
                break
            rest = rest[match.end() :]
            while len(words) < _OPTIONS[option] and (match := re.match(r"(\S+)\s+", rest)):
                if _OPTIONS[option] > 1 and not math.isfinite(_number(match.group(1))):
                    break
                words.append(match.group(1))
                rest = rest[match.end() :]
            if option == "-clamp" and words:
                wrap = "clamp" if words[0].lower() == "on" else "repeat"
            elif option in ("-o", "-s"):
                target = look.offset if option == "-o" else look.scale
                target[: len(words)] = [_number(word) for word in words[:2]]
            elif words not in ([], ["off"]) and not (option.startswith("-blend") and words == ["on"]):
                self._model.found(
                    "options of maps", f"the material {look.paint.name} has the option {option}: it is drawn without"
                )
        if find(folder, rest) is None:  # some programs mean the folder of the model, not that of the library
            folder = self._folder
        if (folder, rest) not in self._textures:
            self._textures[folder, rest] = read_texture(self._model, folder, rest)
        look.paint = replace(look.paint, texture=self._textures[folder, rest], wrap=wrap)


def _number(words: str) -> float:
    """The last word as a number; NaN, which compares to nothing, if it is none."""
    try:
        return float(words.split()[-1])
    except (ValueError, IndexError):
        return math.nan

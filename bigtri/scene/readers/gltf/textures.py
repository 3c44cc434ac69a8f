"""Textures of glTF: images, samplers, and which texture coordinates they are read at."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...images import read_image
from ..model import ModelError
from .document import Document
from .extensions import TEXTURE_TRANSFORM, WEBP
from .json_values import JsonObject

_NEAREST, _LINEAR = 9728, 9729
_MIPMAPPED = (9984, 9985, 9986, 9987)
_REPEAT, _CLAMP, _MIRRORED = 10497, 33071, 33648


@dataclass(frozen=True, eq=False)
class Texture:
    """A texture as a material refers to it.

    Attributes:
        image: sRGB codes, uint8 or uint16 [Ht, Wt, 3]; None where it cannot be read.
        wrap, filter: as in ``Paint``.
        set: n of the TEXCOORD_n that it is read at.
        transform: float64 [2, 3], of those coordinates as they stand in the file; None: as they are.
    """

    image: NDArray[Any] | None
    wrap: str
    filter: str
    set: int
    transform: NDArray[np.float64] | None

    def has_coordinates_of(self, other: Texture) -> bool:
        """Whether both are read at the same place."""
        one, two = (np.eye(2, 3) if texture.transform is None else texture.transform for texture in (self, other))
        return self.set == other.set and np.array_equal(one, two)


class Textures:
    """Reads textures; an image that several share is one array."""

    def __init__(self, document: Document) -> None:
        self._document = document
        self._images: dict[int, NDArray[Any] | None] = {}

    def read(self, reference: JsonObject) -> Texture:
        """The texture that a textureInfo names."""
        texture = self._document.all("textures")[self._document.index(reference, "index", "textures")]
        coordinates, transform = reference.whole("texCoord", 0), None
        if (extension := reference.extension(TEXTURE_TRANSFORM)) is not None:
            coordinates = extension.whole("texCoord", coordinates)
            transform = _transform(extension)
        wrap, filter = self._sampling(texture)
        return Texture(self._pixels(texture), wrap, filter, coordinates, transform)

    def _sampling(self, texture: JsonObject) -> tuple[str, str]:
        """(wrap, filter), as near to the sampler as there is."""
        sampler = self._document.follow(texture, "sampler", "samplers") or JsonObject({})
        wraps = [sampler.chosen(key, (_REPEAT, _CLAMP, _MIRRORED), _REPEAT) for key in ("wrapS", "wrapT")]
        found = self._document.model.found
        if _MIRRORED in wraps:
            found("mirrored textures", "a texture is to be mirrored beyond its borders (MIRRORED_REPEAT): it is repeated instead")
        elif wraps[0] != wraps[1]:
            found(
                "wraps of two kinds",
                "a texture is to be repeated along one axis and clamped along the other (wrapS, wrapT): it is repeated",
            )
        enlarged = sampler.chosen("magFilter", (_NEAREST, _LINEAR), _LINEAR)
        reduced = sampler.chosen("minFilter", (_NEAREST, _LINEAR, *_MIPMAPPED), enlarged)
        if reduced in _MIPMAPPED:
            found(
                "mipmaps", "a texture is to be reduced by mipmaps (minFilter): it is drawn without them, as where it is enlarged"
            )
        elif reduced != enlarged:
            found(
                "two filters",
                "a texture is to be reduced by another filter (minFilter) than enlarged: the one for enlarging is used",
            )
        return "clamp" if wraps == [_CLAMP, _CLAMP] else "repeat", "nearest" if enlarged == _NEAREST else "bilinear"

    def _pixels(self, texture: JsonObject) -> NDArray[Any] | None:
        webp = texture.extension(WEBP)
        for owner in (webp, texture):
            if owner is not None and "source" in owner:
                return self._image(self._document.index(owner, "source", "images"))
        names = ", ".join(texture.object("extensions")) or "no extension"
        text = f"{texture.place} has no image that is read, but {names}: the surface is drawn without it"
        self._document.model.found("textures without an image", text)
        return None

    def _image(self, index: int) -> NDArray[Any] | None:
        if index not in self._images:
            entry = self._document.all("images")[index]
            try:
                self._images[index] = self._decoded(entry)
            except ModelError as error:
                text = f"an image cannot be read, and its surface is drawn without it: {error}"
                self._document.model.found("images that cannot be read", text)
                self._images[index] = None
        return self._images[index]

    def _decoded(self, entry: JsonObject) -> NDArray[Any]:
        if "uri" not in entry:
            data = bytes(self._document.view_bytes(self._document.index(entry, "bufferView", "bufferViews")))
            return read_image(data, entry.place)
        try:
            source = self._document.source(entry.text("uri"))
        except ModelError as error:
            raise ModelError(f"{entry.at('uri')}: {error}") from None
        return read_image(source, entry.place if isinstance(source, bytes) else f"{entry.place}, {source.name}")


def _transform(extension: JsonObject) -> NDArray[np.float64] | None:
    """float64 [2, 3]: first the scale, then the rotation, then the offset."""
    x, y = extension.numbers("offset", (0.0, 0.0))
    width, height = extension.numbers("scale", (1.0, 1.0))
    angle = extension.number("rotation", 0.0)
    cosine, sine = np.cos(angle), np.sin(angle)
    matrix = np.array([(cosine * width, sine * height, x), (-sine * width, cosine * height, y)])
    return None if np.array_equal(matrix, np.eye(2, 3)) else matrix

"""Materials of glTF: base colour and its texture. What else they have is named."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...vectors import Vector
from ..colors import within_0_to_1
from ..model import ModelError, Paint
from .document import Document
from .extensions import EMISSIVE_STRENGTH, SPECULAR_GLOSSINESS, UNLIT
from .json_values import JsonObject
from .textures import Texture, Textures

_NO_TEXTURE = Texture(None, "repeat", "bilinear", 0, None)
# Maps that are no colour of the surface under the lights.
_OTHER_MAPS = {
    "normalTexture": ("normal maps", "a material has a normal map (normalTexture): its surface is lit by the mesh's own normals"),
    "occlusionTexture": ("occlusion maps", "a material has a map of ambient occlusion (occlusionTexture): it is left out"),
}


@dataclass(frozen=True, eq=False)
class Surface:
    """A material, and the texture coordinates that it asks for.

    Attributes:
        paint: what is drawn of it.
        set: n of the TEXCOORD_n of its texture.
        transform: float64 [2, 3] or None, as in ``Texture``.
    """

    paint: Paint
    set: int = 0
    transform: NDArray[np.float64] | None = None


class Materials:
    """Reads materials by their indices. Asked twice for the same, it gives the same."""

    def __init__(self, document: Document) -> None:
        self._document = document
        self._textures = Textures(document)
        self._known: dict[int, Surface] = {}

    def read(self, index: int) -> Surface:
        if index not in self._known:
            self._known[index] = self._surface(self._document.all("materials")[index])
        return self._known[index]

    def _surface(self, material: JsonObject) -> Surface:
        self._name_what_is_left_out(material)
        owner, factor, texture = material.object("pbrMetallicRoughness"), "baseColorFactor", "baseColorTexture"
        if (older := material.extension(SPECULAR_GLOSSINESS)) is not None:
            owner, factor, texture = older, "diffuseFactor", "diffuseTexture"
        base = self._textures.read(owner.object(texture)) if texture in owner else _NO_TEXTURE
        factors = np.array(owner.numbers(factor, (1.0, 1.0, 1.0, 1.0)))
        red, green, blue, alpha = within_0_to_1(self._document.model, factors).tolist()
        emissive, emissive_texture, base = self._emission(material, base)
        paint = Paint(
            material.text("name"),
            (red, green, blue),
            base.image,
            base.wrap,
            base.filter,
            material.flag("doubleSided"),
            alpha_mode=material.text("alphaMode", "OPAQUE").lower(),
            alpha=alpha,
            alpha_cutoff=material.number("alphaCutoff", 0.5),
            unlit=material.extension(UNLIT) is not None,
            emissive=emissive,
            emissive_texture=emissive_texture,
        )
        return Surface(paint, base.set, base.transform)

    def _emission(self, material: JsonObject, base: Texture) -> tuple[Vector, NDArray[Any] | None, Texture]:
        """The colour that is emitted, its texture, and ``base``: where that has no image, with the other one's coordinates."""
        red, green, blue = material.numbers("emissiveFactor", (0.0, 0.0, 0.0))
        strength = material.extension(EMISSIVE_STRENGTH) or JsonObject({})
        times = strength.number("emissiveStrength", 1.0)
        emissive = (red * times, green * times, blue * times)
        if "emissiveTexture" not in material or not any(emissive):
            return emissive, None, base
        texture = self._textures.read(material.object("emissiveTexture"))
        if base.image is None:
            base = replace(texture, image=None)
        if not base.has_coordinates_of(texture):
            text = "what a material emits has a texture at other coordinates than its colour: it is left out"
            self._document.model.found("emission at other coordinates", text)
            return emissive, None, base
        return emissive, texture.image, base

    def _name_what_is_left_out(self, material: JsonObject) -> None:
        found = self._document.model.found
        mode = material.text("alphaMode", "OPAQUE")
        if mode == "BLEND":
            found("alpha blending", "a material is transparent (alphaMode BLEND): it is drawn opaque")
        elif mode == "MASK":
            found("alpha masks", "a material has holes where its alpha is low (alphaMode MASK): it is drawn without them")
        elif mode != "OPAQUE":
            raise ModelError(f"{material.at('alphaMode')} must be OPAQUE, MASK or BLEND, got {mode!r}")
        if any(material.numbers("emissiveFactor", (0.0, 0.0, 0.0))):
            found("emission", "a material emits light (emissiveFactor): it is drawn without it")
        for key, (kind, text) in _OTHER_MAPS.items():
            if key in material:
                found(kind, text)
        metallic = material.object("pbrMetallicRoughness")
        if "metallicRoughnessTexture" in metallic:
            found(
                "metallic-roughness maps",
                "a material has a map of metalness and roughness (metallicRoughnessTexture): it is drawn rough",
            )
        # 1 is what a file has that says nothing; then it is not what anybody asked for.
        elif metallic.number("metallicFactor", 0.0) > 0:
            found("metal", "a material is metallic (metallicFactor): it is drawn as if it were rough and no metal")
        for name in material.object("extensions"):
            if name == UNLIT:
                found(name, f"a material is to be drawn without lights ({name}): it is lit as the others are")
            elif name == SPECULAR_GLOSSINESS:
                found(name, f"a material has {name}: its diffuse colour is drawn, its reflections are not")
            elif name.startswith("KHR_materials_"):
                found(name, f"a material has {name}: it is drawn without it")

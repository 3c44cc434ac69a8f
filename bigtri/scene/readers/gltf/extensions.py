"""Extensions of glTF: which are read, which change nothing, and what is said about the others."""

from __future__ import annotations

from ..model import ModelError
from .document import Document

EMISSIVE_STRENGTH = "KHR_materials_emissive_strength"
DRACO = "KHR_draco_mesh_compression"
INSTANCING = "EXT_mesh_gpu_instancing"
LIGHTS = "KHR_lights_punctual"
QUANTIZATION = "KHR_mesh_quantization"
SPECULAR_GLOSSINESS = "KHR_materials_pbrSpecularGlossiness"
TEXTURE_TRANSFORM = "KHR_texture_transform"
UNLIT = "KHR_materials_unlit"
VISIBILITY = "KHR_node_visibility"
WEBP = "EXT_texture_webp"

# These are followed. Any integer is taken for a coordinate, so that quantization asks for nothing more.
_READ = (DRACO, INSTANCING, QUANTIZATION, SPECULAR_GLOSSINESS, TEXTURE_TRANSFORM, VISIBILITY, WEBP)
# What they say is found where it stands, and named there.
_NAMED = (LIGHTS, "KHR_animation_pointer")
_MATERIALS = "KHR_materials_"
# Images in other formats; a texture that has none in a format that is read is named where it stands.
_OTHER_IMAGES = ("EXT_texture_avif", "KHR_texture_basisu", "MSFT_texture_dds")
# They add what no picture shows, or another way to the same.
_WITHOUT_EFFECT = (
    "EXT_instance_features",
    "EXT_mesh_features",
    "EXT_meshopt_compression",
    "EXT_structural_metadata",
    "FB_ngon_encoding",
    "KHR_meshopt_compression",
    "KHR_node_hoverability",
    "KHR_node_selectability",
    "KHR_xmp",
    "KHR_xmp_json_ld",
    "MSFT_lod",
)
# Without effect as long as a reader may leave them out.
_NOT_IF_REQUIRED = ("EXT_meshopt_compression", "KHR_meshopt_compression", *_OTHER_IMAGES)


def check_extensions(document: Document) -> None:
    """Notes extensions that are not read.

    Raises:
        ModelError: the file cannot be drawn without one of them.
    """
    required = document.root.texts("extensionsRequired")
    if unknown := [name for name in required if name in _NOT_IF_REQUIRED or not _is_known(name)]:
        names = ", ".join(dict.fromkeys(unknown))
        allowed = ", ".join((*_READ, *_NAMED))
        raise ModelError(f"the file requires {names}, which is not read; what it may require is {allowed} and {_MATERIALS}*")
    for name in dict.fromkeys(document.root.texts("extensionsUsed")):
        if not _is_known(name):
            document.model.found(f"extension {name}", f"the extension {name} is not read: what it adds is left out")


def _is_known(name: str) -> bool:
    return name in (*_READ, *_NAMED, *_OTHER_IMAGES, *_WITHOUT_EFFECT) or name.startswith(_MATERIALS)

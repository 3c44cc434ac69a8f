"""bigtri: exact, fast software rasterization of large triangles for torch and NumPy.

What is listed here is imported when it is first used, so that `bigtri --help` does not wait for torch.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

__version__ = "0.1.0"  # the one place: pyproject.toml reads it from here

# Where each public name lives.
_HOMES = {
    "Camera": ".scene.camera",
    "Light": ".scene.scene",
    "Material": ".scene.scene",
    "ModelWarning": ".scene.readers.model",
    "Precision": ".precision",
    "Scene": ".scene.scene",
    "Tolerance": ".study.suggest",
    "Visibility": ".ops.rasterize",
    "barycentrics": ".ops.interpolate",
    "decode_srgb": ".ops.shading",
    "encode_srgb": ".ops.shading",
    "from_trimesh": ".scene.load",
    "instance_ids": ".scene.instances",
    "interpolate": ".ops.interpolate",
    "lambert": ".ops.shading",
    "load_scene": ".scene.load",
    "merge": ".scene.scene",
    "rasterize": ".ops.rasterize",
    "register_stage": ".check.registered",
    "register_variant": ".check.registered",
    "registered_variants": ".check.registered",
    "render": ".rendering.render",
    "sample_texture": ".ops.texture",
    "stop_tuning": ".ops.tuned",
    "suggest_precision": ".study.suggest",
    "unregister_variant": ".check.registered",
    "use_tuning": ".ops.tuned",
}
_MODULES = {"memory": ".ops.memory", "stages": ".check.stages", "verify": ".check.verify", "views": ".rendering.views"}

if TYPE_CHECKING:
    from .check import stages, verify
    from .check.registered import register_stage, register_variant, registered_variants, unregister_variant
    from .ops import memory
    from .ops.interpolate import barycentrics, interpolate
    from .ops.rasterize import Visibility, rasterize
    from .ops.shading import decode_srgb, encode_srgb, lambert
    from .ops.texture import sample_texture
    from .ops.tuned import stop_tuning, use_tuning
    from .precision import Precision
    from .rendering import views
    from .rendering.render import render
    from .scene.camera import Camera
    from .scene.instances import instance_ids
    from .scene.load import from_trimesh, load_scene
    from .scene.readers.model import ModelWarning
    from .scene.scene import Light, Material, Scene, merge
    from .study.suggest import Tolerance, suggest_precision

__all__ = [
    "Camera",
    "Light",
    "Material",
    "ModelWarning",
    "Precision",
    "Scene",
    "Tolerance",
    "Visibility",
    "barycentrics",
    "decode_srgb",
    "encode_srgb",
    "from_trimesh",
    "instance_ids",
    "interpolate",
    "lambert",
    "load_scene",
    "memory",
    "merge",
    "rasterize",
    "register_stage",
    "register_variant",
    "registered_variants",
    "render",
    "sample_texture",
    "stages",
    "stop_tuning",
    "suggest_precision",
    "unregister_variant",
    "use_tuning",
    "verify",
    "views",
]


def __getattr__(name: str) -> object:
    if name in _HOMES:
        value = getattr(importlib.import_module(_HOMES[name], __name__), name)
    elif name in _MODULES:
        value = importlib.import_module(_MODULES[name], __name__)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})

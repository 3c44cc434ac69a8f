"""bigtri: exact, fast software rasterization of large triangles for torch and NumPy."""

__version__ = "0.1.0"

from .camera import Camera
from .interpolate import barycentrics, interpolate
from .rasterize import Visibility, rasterize
from .render import render
from .scene import Scene, load_scene
from .shading import decode_srgb, encode_srgb, lambert
from .texture import sample_texture

__all__ = [
    "Camera",
    "Scene",
    "Visibility",
    "barycentrics",
    "decode_srgb",
    "encode_srgb",
    "interpolate",
    "lambert",
    "load_scene",
    "rasterize",
    "render",
    "sample_texture",
]

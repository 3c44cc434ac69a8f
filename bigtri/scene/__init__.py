"""Models, cameras, materials and lights: what a picture is made of."""

from . import matrix_camera, orthographic_camera, perspective_camera, pinhole_camera  # noqa: F401 - Camera knows them then
from .camera import Camera
from .instances import instance_ids
from .load import from_trimesh, load_scene
from .readers.model import ModelWarning
from .scene import Light, Material, Scene, merge

__all__ = ["Camera", "Light", "Material", "ModelWarning", "Scene", "from_trimesh", "instance_ids", "load_scene", "merge"]

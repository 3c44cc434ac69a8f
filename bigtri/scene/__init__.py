"""Models, cameras, materials and lights: what a picture is made of."""

from .camera import Camera
from .instances import instance_ids
from .load import from_trimesh, load_scene
from .readers.model import ModelWarning
from .scene import Light, Material, Scene, merge

__all__ = ["Camera", "Light", "Material", "ModelWarning", "Scene", "from_trimesh", "instance_ids", "load_scene", "merge"]

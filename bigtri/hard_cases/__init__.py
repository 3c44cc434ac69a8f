"""Named constructions on which rasterizers fail: what plain float32 makes of them, and what this build makes of them.

``mesh`` holds what a construction is and the exact answer, ``naive`` the usual float32 code, ``constructions`` the meshes,
``rules`` the cases that are a rule rather than a mesh, ``depths`` those about depth, ``report`` and ``pictures`` what
``bigtri hard-cases`` writes.
"""

from .mesh import Backend, Case, Mesh
from .report import cases, meshes

__all__ = ["Backend", "Case", "Mesh", "cases", "meshes"]

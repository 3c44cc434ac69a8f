"""A scene as tensors on one device, as the operators take it: uploaded once, drawn many times."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from ..reference.shade import Look, Surface
from .fit import corners_of, fills_picture
from .normals import face_normals
from .plan import RenderPlan

if TYPE_CHECKING:
    from .scene import Material, Scene


class SceneTensors:
    """What ``Scene.on`` returns. Later changes of the scene's arrays are not seen on another device than the CPU.

    Attributes:
        scene: where it is from.
        device: where the tensors are.
        positions: float32 [V, 3], counted from the scene's origin.
        triangles: int32 [T, 3].
    """

    def __init__(self, scene: Scene, device: torch.device) -> None:
        self.scene = scene
        self.device = device
        self.positions = self._tensor(scene.positions)
        self.triangles = self._tensor(scene.triangles)
        self._attributes = {name: getattr(scene, name) for name in ("uvs", "colors", "normals")}
        self._attributes = {name: None if a is None else self._tensor(a) for name, a in self._attributes.items()}
        textured = [m.texture for m in scene.materials if m.texture is not None]
        self._textures = [self._tensor(texture) for texture in textured]
        self._material = self._tensor(scene.material)
        self._looks = self._tensor(_looks(scene.materials))
        self._base_colors = self._floats([m.base_color for m in scene.materials])
        self._directions = self._floats([light.direction for light in scene.lights])
        self._colors = self._floats([light.color for light in scene.lights])

    @cached_property
    def _face_normals(self) -> torch.Tensor:
        return self._tensor(face_normals(self.scene.positions, self.scene.triangles))

    @cached_property
    def _corners(self) -> NDArray[np.float64]:
        low, high = (tuple(corner) for corner in self.scene.bounds - np.array(self.scene.origin))
        return corners_of(low, high)

    def fills_picture(self, matrices: NDArray[np.float64]) -> bool:
        """Whether the scene probably touches most of the pictures of cameras with these matrices, [B, 4, 4]."""
        return fills_picture(matrices, self._corners)

    def surface(self, plan: RenderPlan, background: Sequence[Sequence[float]]) -> Surface[torch.Tensor]:
        """What the shading pass reads, with the effects that the plan runs.

        Args:
            plan: the effects.
            background: linear colours at the top and at the bottom of the picture.
        """
        lit = plan.lights
        return Surface(
            uvs=self._attributes["uvs"] if plan.textures else None,
            colors=self._attributes["colors"] if plan.vertex_colors else None,
            normals=self._attributes["normals"] if plan.smooth_normals and lit else None,
            face_normals=self._face_normals if plan.flat_normals and lit else None,
            material=self._material,
            looks=self._looks,
            base_colors=self._base_colors,
            textures=tuple(self._textures),
            light_directions=self._directions if lit else self._directions[:0],
            light_colors=self._colors if lit else self._colors[:0],
            constants=torch.from_numpy(np.array([self.scene.ambient, *background], np.float32)),
            two_sided=plan.two_sided and lit,
        )

    def _tensor(self, array: NDArray[Any]) -> torch.Tensor:
        return torch.from_numpy(array).to(self.device)

    def _floats(self, triples: Sequence[Sequence[float]]) -> torch.Tensor:
        """float32 [N, 3]."""
        return self._tensor(np.array(triples, np.float32).reshape(-1, 3))


def _looks(materials: Sequence[Material]) -> NDArray[np.int32]:
    """int32 [M, 2]: bits of ``Look``, and the texture's place among those that there are, or -1."""
    rows, textures = [], 0
    for material in materials:
        asked = {
            Look.VERTEX_COLORS: material.vertex_colors,
            Look.SMOOTH: material.smooth,
            Look.TWO_SIDED: material.two_sided,
            Look.NEAREST: material.filter == "nearest",
            Look.CLAMP: material.wrap == "clamp",
        }
        rows.append((sum(int(bit) for bit, on in asked.items() if on), -1 if material.texture is None else textures))
        textures += material.texture is not None
    return np.array(rows, np.int32).reshape(-1, 2)

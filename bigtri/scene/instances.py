"""Which object is seen at every pixel."""

from __future__ import annotations

import numpy as np
import torch

from ..ops.arguments import Array, described
from ..ops.rasterize import Visibility
from .scene import Scene


def instance_ids(scene: Scene, visibility: Visibility) -> Array:
    """The object of ``Scene.instance`` that is seen at every pixel.

    Args:
        scene: what was drawn.
        visibility: of ``rasterize`` with the scene's triangles, or ``Buffers.visibility`` of ``render``.

    Returns:
        int32 [H, W] or [B, H, W], -1 on the background; of the kind and on the device of the visibility.

    Raises:
        TypeError: an argument of another type.
        ValueError: triangles that the scene does not have; on CUDA that is torch's own error.
    """
    if not isinstance(scene, Scene):
        raise TypeError(f"bigtri.instance_ids: scene must be a Scene, got {described(scene)}")
    if not isinstance(visibility, Visibility):
        raise TypeError(f"bigtri.instance_ids: visibility must be a Visibility, got {described(visibility)}")
    of_triangle = np.zeros(len(scene.triangles), np.int32) if scene.instance is None else scene.instance
    # Index -1, the background, reads the last one.
    table, triangle = np.append(of_triangle, np.int32(-1)), visibility.triangle
    try:
        if isinstance(triangle, torch.Tensor):
            return torch.from_numpy(table).to(triangle.device)[triangle]
        return table[triangle]
    except IndexError:
        raise ValueError(
            f"bigtri.instance_ids: visibility must be of the {len(of_triangle)} triangles of scene, got {int(triangle.max())}"
        ) from None

"""Points to clip space, in every view at once."""

from __future__ import annotations

import torch

from ..reference import transform as reference
from . import arguments, memory


def transform(points: torch.Tensor, matrices: torch.Tensor, backend: str = "auto") -> torch.Tensor:
    """Every component is ``((m0*x + m1*y) + m2*z) + m3`` in float64, rounded once, as ``Camera.transform`` has it.

    Args:
        points: float32 [V, 3], contiguous.
        matrices: float64 [B, 4, 4], contiguous, on the points' device; for column vectors.
        backend: "auto", "reference" or "native"; the bits are the same.

    Returns:
        float32 [B, V, 4], new memory on the points' device. What lies beyond float32 is an infinity there.

    Raises:
        RuntimeError: the operator refuses a tensor; the text names it.
    """
    if arguments.choose_backend("transform", backend) == "reference":
        return arguments.on_reference(reference.transform, points, matrices)
    out = memory.new(points, (len(matrices), len(points), 4), torch.float32)
    torch.ops.bigtri.transform.default(points, matrices, out)
    return out

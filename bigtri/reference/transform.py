"""Points to clip space, by an affine map in float64 that is rounded once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .float_mode import default_float_mode


@default_float_mode
def transform(points: NDArray[np.float32], matrices: NDArray[np.float64]) -> NDArray[np.float32]:
    """Points in every view, each component ``((m0*x + m1*y) + m2*z) + m3``: the order of the sums is part of the result.

    Args:
        points: float32 [V, 3].
        matrices: float64 [B, 4, 4], for column vectors.

    Returns:
        float32 [B, V, 4]. What lies beyond float32 becomes an infinity.
    """
    x, y, z = points.astype(np.float64).T
    clip = np.empty((len(matrices), len(points), 4), np.float32)
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        for view, matrix in enumerate(matrices):
            for i, m in enumerate(matrix):
                clip[view, :, i] = ((m[0] * x + m[1] * y) + m[2] * z) + m[3]
    return clip

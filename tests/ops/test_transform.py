"""Points to clip space: the operator, the reference and Camera.transform, in bits."""

import numpy as np
import pytest
import torch
from backends import BACKENDS

from bigtri import Camera
from bigtri.ops.transform import transform

ASPECT = 1.5


def awkward(count: int) -> np.ndarray:
    """float32 [2 * count, 3]: ordinary points, and what overflows, cancels or is no number."""
    rng = np.random.default_rng(3)
    special = [0, -0.0, 1, 1e19, 3e38, -3e38, 1e-45, np.inf, -np.inf, np.nan]
    return np.concatenate([rng.normal(size=(count, 3)), rng.choice(special, (count, 3))]).astype(np.float32)


def cameras() -> list[Camera]:
    return [Camera((3, 2, 4), (0, 0, 0)), Camera((0, 1, -2), (0.5, 0, 0), fov_y=20), Camera.orbit((0, 0, 0), 1e-3, 250)]


@pytest.mark.parametrize("backend", BACKENDS)
def test_all_views_are_what_the_camera_says(backend):
    points = awkward(10_000)  # more than a thread takes at a time
    matrices = np.stack([camera.matrix(ASPECT) for camera in cameras()])
    result = transform(torch.from_numpy(points), torch.from_numpy(matrices), backend)
    assert result.shape == (3, 20_000, 4) and result.dtype == torch.float32
    for camera, clip in zip(cameras(), result.numpy(), strict=True):
        expected = camera.transform(points, ASPECT)
        assert np.array_equal(np.isnan(expected), np.isnan(clip)) and np.isnan(clip).any() and np.isinf(clip).any()
        assert np.array_equal(
            np.where(np.isnan(clip), 0, clip).view(np.int32), np.where(np.isnan(clip), 0, expected).view(np.int32)
        )


@pytest.mark.parametrize("backend", BACKENDS)
def test_the_sum_is_rounded_once_and_in_order(backend):
    matrix = torch.tensor(
        [[1.0, 1, 1, 0], [0, 0, 0, 2.0**-30 + 1], [2.0**30, 1, -(2.0**80), 0], [1e300, 0, 0, 0]], dtype=torch.float64
    )
    result = transform(torch.tensor([[1.0, 2.0**-24, 2.0**-50]]), matrix[None], backend)[0, 0]
    # 1 + 2^-24 would be 1 if it were rounded before 2^-50 is added; and 2^-24 is lost beside 2^30 before that is subtracted.
    assert result.tolist() == [1 + 2.0**-23, 1, 0, np.inf]


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(("views", "points"), [(0, 4), (2, 0)])
def test_nothing_to_transform(views, points, backend):
    assert transform(torch.zeros(points, 3), torch.zeros(views, 4, 4, dtype=torch.float64), backend).shape == (views, points, 4)

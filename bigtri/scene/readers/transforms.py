"""Affine maps of points and normals. float64 in a fixed order, so that every machine gets the same bits."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..origin import bounds_of, joined
from ..vectors import Vector, affine

# Points that are worked on at a time, so that float64 is not needed of all at once.
_CHUNK = 1 << 16


def placed(matrix: NDArray[np.float64], points: NDArray[Any]) -> NDArray[np.float64]:
    """float64 [V, 3]: points [V, 3] by one matrix [4, 4], or by one each [V, 4, 4]."""
    points = points.astype(np.float64, copy=False)
    return np.stack([affine(matrix[..., i, :].T, points) for i in range(3)], axis=1)


def placed_from(origin: Vector, matrix: NDArray[np.float64], points: NDArray[Any]) -> NDArray[np.float32]:
    """float32 [V, 3]: points [V, 3] by a matrix [4, 4], counted from ``origin``; rounded once, at the end."""
    result = np.empty((len(points), 3), np.float32)
    for chunk in _chunks(len(points)):
        result[chunk] = placed(matrix, points[chunk]) - np.array(origin)
    return result


def bounds_of_placed(matrix: NDArray[np.float64], points: NDArray[Any]) -> NDArray[np.float64] | None:
    """float64 [2, 3]: the lowest and the highest corner of points [V, 3] by a matrix [4, 4], None where none is finite."""
    boxes = [bounds_of(placed(matrix, points[chunk])) for chunk in _chunks(len(points))]
    return joined([box for box in boxes if box is not None])


def turned(matrix: NDArray[np.float64], normals: NDArray[Any]) -> NDArray[np.float32]:
    """float32 [V, 3]: normals [V, 3] by the inverse transpose of one matrix [4, 4], or of one each [V, 4, 4], of unit length.

    The inverse transpose is the cofactors over the determinant, of which only the sign matters, for the length is made 1. So a
    matrix that flattens, whose determinant is 0, has the normals of the plane that it flattens to.
    """
    result = np.empty((len(normals), 3), np.float32)
    for chunk in _chunks(len(normals)):
        some, rows = normals[chunk].astype(np.float64), _of(matrix, chunk)
        a, b, c = rows[..., :3, 0], rows[..., :3, 1], rows[..., :3, 2]
        cofactors = np.stack([_cross(b, c), _cross(c, a), _cross(a, b)], axis=-1)
        cofactors = cofactors * np.where(_dot(a, cofactors[..., 0]) < 0, -1.0, 1.0)[..., None, None]
        vectors = np.stack([_dot(cofactors[..., i, :], some) for i in range(3)], axis=1)
        length = np.sqrt(_dot(vectors, vectors))[:, None]
        result[chunk] = np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)
    return result


def product(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """float64 [..., 4, 4]: what first does ``b`` and then ``a``."""
    terms = [a[..., :, k, None] * b[..., None, k, :] for k in range(4)]
    return ((terms[0] + terms[1]) + terms[2]) + terms[3]


def rotations(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """float64 [N, 3, 3] of quaternions [N, 4] in the order x, y, z, w, of any length but 0; 0 turns nothing."""
    x, y, z, w = np.moveaxis(quaternions, -1, 0)
    square = ((x * x + y * y) + z * z) + w * w
    scale = np.divide(2.0, square, out=np.zeros_like(square), where=square > 0)
    rows = [
        [1 - scale * (y * y + z * z), scale * (x * y - z * w), scale * (x * z + y * w)],
        [scale * (x * y + z * w), 1 - scale * (x * x + z * z), scale * (y * z - x * w)],
        [scale * (x * z - y * w), scale * (y * z + x * w), 1 - scale * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def trs(translations: NDArray[np.float64], quaternions: NDArray[np.float64], scales: NDArray[np.float64]) -> NDArray[np.float64]:
    """float64 [N, 4, 4]: first scales [N, 3], then quaternions [N, 4], then translations [N, 3]."""
    matrices = np.tile(np.eye(4), (len(translations), 1, 1))
    matrices[:, :3, :3] = rotations(quaternions) * scales[:, None, :]
    matrices[:, :3, 3] = translations
    return matrices


def mirrors(matrix: NDArray[np.float64]) -> bool:
    """Whether a matrix [4, 4] turns left hands into right ones, and front faces into back faces."""
    return bool(np.linalg.det(matrix[:3, :3]) < 0)


def _chunks(count: int) -> Iterator[slice]:
    return (slice(start, start + _CHUNK) for start in range(0, count, _CHUNK))


def _of(matrix: NDArray[np.float64], chunk: slice) -> NDArray[np.float64]:
    """Those of a chunk's points, where each has its own."""
    return matrix if matrix.ndim == 2 else matrix[chunk]


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """What np.cross has of [..., 3], which of a few vectors takes ten times as long."""
    result = np.empty_like(a)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        result[..., i] = a[..., j] * b[..., k] - a[..., k] * b[..., j]
    return result


def _dot(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return (a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]) + a[..., 2] * b[..., 2]

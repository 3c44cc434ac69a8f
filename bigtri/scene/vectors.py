"""Numbers and vectors in float64, in a fixed order of operations, so that every machine gets the same bits; and their checks."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Vector = tuple[float, float, float]


def number(owner: str, name: str, value: Any) -> float:
    """``value`` as a float.

    Args:
        owner, name: the function or class and its argument, for the error text.
        value: a number of Python, NumPy or torch; text that reads as one is none.

    Raises:
        TypeError: not a number.
        ValueError: a NaN or an infinity.
    """
    wanted = f"bigtri.{owner}: {name} must be a finite number"
    if not (hasattr(value, "__float__") or hasattr(value, "__index__")):
        raise TypeError(f"{wanted}, got {value!r}")
    try:
        result = float(value)
    except OverflowError:  # an integer beyond float64
        result = math.inf
    except (TypeError, ValueError, RuntimeError):  # an array of several
        raise TypeError(f"{wanted}, got {value!r}") from None
    if not math.isfinite(result):
        raise ValueError(f"{wanted}, got {value!r}")
    return result


def vector(owner: str, name: str, value: Any) -> Vector:
    """``value`` as three floats; arguments as for ``number``.

    Raises:
        TypeError: not a sequence, or not of numbers.
        ValueError: not three, or one is a NaN or an infinity.
    """
    wanted = f"bigtri.{owner}: {name} must be three finite numbers"
    try:
        x, y, z = (number(owner, name, component) for component in value)
    except TypeError:
        raise TypeError(f"{wanted}, got {value!r}") from None
    except ValueError:  # another number of them, too
        raise ValueError(f"{wanted}, got {value!r}") from None
    return x, y, z


def numbers(owner: str, name: str, value: ArrayLike) -> NDArray[np.float64]:
    """``value`` as float64 of any shape."""
    try:
        array = np.asarray(value)
        if array.dtype.kind in "biuf":
            return array.astype(np.float64, copy=False)
    except (TypeError, ValueError, RuntimeError):  # rows of different lengths, or a tensor that NumPy cannot see
        pass
    raise TypeError(f"bigtri.{owner}: {name} must be an array of numbers, got {value!r}")


def positive(owner: str, name: str, value: Any) -> float:
    """``value`` as a float above 0; arguments and errors as for ``number``."""
    result = number(owner, name, value)
    if not result > 0:
        raise ValueError(f"bigtri.{owner}: {name} must be positive and finite, got {value!r}")
    return result


def affine(row: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """float64 [V]: one row [4] of an affine map at points [V, 3], in the order that ``Camera.transform`` says."""
    x, y, z = points[:, 0], points[:, 1], points[:, 2]
    return ((row[0] * x + row[1] * y) + row[2] * z) + row[3]


def affine_row(direction: Vector, eye: Vector, scale: float) -> list[float]:
    """The row [4] of an affine map that gives ``scale * dot(direction, point - eye)``."""
    return [scale * direction[0], scale * direction[1], scale * direction[2], -scale * dot(direction, eye)]


def corners(owner: str, name: str, value: ArrayLike) -> tuple[Vector, Vector]:
    """The lowest and the highest corner of bounds [2, 3].

    Raises:
        TypeError, ValueError: something else; the text names it.
    """
    array = numbers(owner, name, value)
    if array.shape != (2, 3):
        raise ValueError(f"bigtri.{owner}: {name} must be [2, 3], got {list(array.shape)}")
    low, high = (vector(owner, name, corner) for corner in array.tolist())
    return low, high


def subtract(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def dot(a: Vector, b: Vector) -> float:
    return (a[0] * b[0] + a[1] * b[1]) + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def length(v: Vector) -> float:
    return math.sqrt(dot(v, v))


def unit(v: Vector) -> Vector:
    size = length(v)
    return v[0] / size, v[1] / size, v[2] / size


def square_matrix(owner: str, name: str, value: ArrayLike, size: int) -> Any:
    """A matrix [size, size] of finite numbers, as tuples."""
    array = numbers(owner, name, value)
    if array.shape != (size, size):
        raise ValueError(f"bigtri.{owner}: {name} must be [{size}, {size}], got {list(array.shape)}")
    if not np.isfinite(array).all():
        raise ValueError(f"bigtri.{owner}: {name} must be finite, got {array.tolist()}")
    return tuple(map(tuple, array.tolist()))

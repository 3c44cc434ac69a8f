"""Checks of what materials and scenes are given."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..ops import arguments


def check_choice(owner: str, name: str, value: Any, allowed: tuple[str, ...]) -> None:
    if not isinstance(value, str):
        raise TypeError(f"bigtri.{owner}: {name} must be one of {', '.join(map(repr, allowed))}, got {value!r}")
    arguments.check_choice(owner, name, value, allowed)


def check_array(owner: str, name: str, value: Any, dtypes: tuple[type[np.generic], ...], *shape: int | str) -> NDArray[Any]:
    """``value``, or a copy of it where torch could not share its memory: contiguous and writable."""
    if not isinstance(value, np.ndarray) or value.dtype not in dtypes:
        got = f"{value.dtype} {list(value.shape)}" if isinstance(value, np.ndarray) else type(value).__name__
        raise TypeError(f"bigtri.{owner}: {name} must be a NumPy array {_described(dtypes, shape)}, got {got}")
    fits = value.ndim == len(shape) and all(isinstance(s, str) or s == n for s, n in zip(shape, value.shape, strict=True))
    if not fits:
        raise ValueError(f"bigtri.{owner}: {name} must be {_described(dtypes, shape)}, got {list(value.shape)}")
    return np.require(value, requirements=("C", "A", "W"))


def _described(dtypes: tuple[type[np.generic], ...], shape: tuple[int | str, ...]) -> str:
    *others, last = (str(np.dtype(dtype)) for dtype in dtypes)
    return f"{', '.join(others)}{' or ' * bool(others)}{last} [{', '.join(map(str, shape))}]"

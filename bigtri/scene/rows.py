"""Rows of integers, given as columns of int32: sorted, and the same ones found."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def sorted_rows(columns: list[NDArray[np.int32]]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Rows in rising order, the first column deciding first. Those that are the same come in any order.

    Two columns make one key of 64 bits, which sorts far faster than a structure. The others are asked only where rows still tie.

    Args:
        columns: two or more, int32 [N].

    Returns:
        order: int64 [N], the row in each place; is_first: bool [N], whether the row in this place differs from the one before.
    """
    key = _pair(columns[0], columns[1])
    order = np.argsort(key)
    is_first = changes(key[order])
    for column in columns[2:]:
        tied = ~is_first
        tied[:-1] |= tied[1:]
        if not tied.any():
            break
        rows = order[tied]
        key = _pair(np.cumsum(is_first)[tied], column[rows])
        within = np.argsort(key)
        order[tied] = rows[within]
        is_first[tied] = changes(key[within])
    return order, is_first


def unify(columns: list[NDArray[np.int32]]) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """(int64 [U], a row of each kind, the kinds rising; int32 [N], the kind of each row)."""
    order, is_first = sorted_rows(columns)
    kind = np.empty(len(order), np.int32)
    kind[order] = np.cumsum(is_first, dtype=np.int32) - np.int32(1)
    return order[is_first], kind


def changes(values: NDArray[Any]) -> NDArray[np.bool_]:
    """bool [N]: whether a value is the first or differs from the one before it."""
    return np.concatenate([np.ones(min(len(values), 1), bool), values[1:] != values[:-1]])


def _pair(high: NDArray[Any], low: NDArray[np.int32]) -> NDArray[np.int64]:
    """One number of two of 32 bits, in the order of the first, then of the second."""
    return (high.astype(np.int64) << 32) + low

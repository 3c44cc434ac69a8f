"""Where the models of variants do their work; csrc/cpu/work_map.h computes the same."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .numerics import BIN, TILE

Integers = int | NDArray[np.integer]


def levels_of(height: int, width: int) -> list[tuple[int, int]]:
    """Squares down and across: tiles of 8 px, squares twice as wide, and so on up to one that holds all of an image's bins."""
    height, width = -(-height // BIN) * BIN, -(-width // BIN) * BIN
    levels = [(height // TILE, width // TILE)]
    while levels[-1] != (1, 1):
        size = TILE << len(levels)
        levels.append((-(-height // size), -(-width // size)))
    return levels


class Places:
    """The work of a view by its place. What a model adds comes back as a sum, which it counts."""

    def __init__(self, height: int, width: int) -> None:
        levels = levels_of(height, width)
        self.fragments = np.zeros([TILE * size for size in levels[0]], np.int64)  # by pixel, as far as the bins reach
        self.edges = tuple(np.zeros(shape, np.int64) for shape in levels)  # by square
        self.tasks = np.zeros(0, np.int64)  # work of each that drew

    def add_edges(self, n: Integers, x: Integers, y: Integers, size: int = TILE) -> int:
        """Edge values of squares of ``size`` px, a power of 2, with first pixels (x, y): ``n`` of all, or of each its own.

        Those that are smaller than a tile count as their tile, and those beyond the bins as the last that is none.
        """
        level = min(max(size // TILE, 1).bit_length() - 1, len(self.edges) - 1)
        wide, (height, width) = TILE << level, self.fragments.shape
        row, column = np.minimum(y, height - 1) // wide, np.minimum(x, width - 1) // wide
        np.add.at(self.edges[level], (row, column), n)
        return n * row.size if isinstance(n, int) else int(n.sum(dtype=np.int64))

    def add_bins(self, n: Integers, queue: NDArray[np.integer], size: int = BIN) -> int:
        """The same of the bins of queue entries (record, column, row), [Q, 3]."""
        return self.add_edges(n, size * queue[:, 1], size * queue[:, 2], size)

    def add_fragments(self, x: NDArray[np.integer], y: NDArray[np.integer]) -> int:
        """One at each of the pixels (x, y)."""
        np.add.at(self.fragments, (y, x), 1)
        return x.size

    def add_box(self, x0: int, y0: int, x1: int, y1: int) -> int:
        """A fragment at each pixel of a box, which may be empty."""
        box = self.fragments[y0 : max(y0, y1), x0 : max(x0, x1)]
        box += 1
        return box.size

    def add_spans(self, spans: NDArray[np.integer]) -> None:
        """A fragment at each pixel of spans (record, y, lower, upper), [S, 4]."""
        height, width = self.fragments.shape
        steps = np.zeros((height, width + 1), np.int64)
        np.add.at(steps, (spans[:, 1], spans[:, 2]), 1)
        np.add.at(steps, (spans[:, 1], spans[:, 3]), -1)
        self.fragments += np.cumsum(steps, axis=1)[:, :width]

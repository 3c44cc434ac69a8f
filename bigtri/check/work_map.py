"""Where a variant does its work: edge values by the square that they were computed for, fragments by pixel, work by task."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from .. import native
from ..choices import CULLS
from ..ops import arguments
from ..ops.arguments import Array
from ..ops.rasterize import check_indices
from ..precision import DEFAULT, Precision
from ..reference.numerics import BIN, TILE
from .counters import Scissor


class WorkMap(NamedTuple):
    """The work of one view. It reaches as far as the view's bins do: a variant may compute what lies beyond the image."""

    counters: dict[str, int]  # of csrc/core/counters.h, those that are not 0, of the same drawing
    fragments: NDArray[np.int64]  # [64 rows, 64 columns], of bins: the fragments offered to each pixel
    # Edge values by the square that they were computed for: tiles of 8 px, squares twice as wide, and so on up to one that
    # holds all bins; [down, across] each.
    edges: tuple[NDArray[np.int64], ...]
    tasks: NDArray[np.int64]  # [N]: edge values and fragments of each task that drew, the most first

    def by_tile(self) -> NDArray[np.float64]:
        """float64 [8 rows, 8 columns]: edge values and fragments in each tile of 8x8 px.

        What was computed for a wider square is spread evenly over its tiles, so the sum is that of the counters.
        """
        down, across = (size // TILE for size in self.fragments.shape)
        work = self.fragments.reshape(down, TILE, across, TILE).sum(axis=(1, 3)).astype(np.float64)
        for level, edges in enumerate(self.edges):
            wide = 1 << level  # tiles
            rows, columns = (np.minimum(wide, n - wide * np.arange(-(-n // wide))) for n in (down, across))
            even = edges / np.outer(rows, columns)
            work += np.repeat(np.repeat(even, rows, axis=0), columns, axis=1)
        return work


def map_work(
    positions: Array,
    triangles: Array,
    resolution: tuple[int, int],
    *,
    variant: str,
    precision: str | Precision = DEFAULT,
    cull: str = "none",
    scissor: Scissor | None = None,
    parameters: Mapping[str, int] | None = None,
) -> WorkMap:
    """Draw one view with the build that counts, on the CPU, and keep the place of everything that is counted there.

    Args:
        positions, triangles, resolution, cull, scissor, precision: as for ``rasterize``; positions [V, 4], on the CPU.
        variant: one of ``bigtri.native.VARIANTS["cpu"]``.
        parameters: values of the variant's parameters by name, instead of the standard ones.

    Raises:
        TypeError, ValueError: an argument of another dtype, shape or value; the text names it.
        RuntimeError: the extension is not built; an index in ``triangles`` is out of range; the rung's work is not counted.
    """
    op = "map_work"
    arguments.choose_backend(op, "native")
    arithmetic = arguments.check_precision(op, precision)
    arguments.check_compiled(op, arithmetic, "cpu")
    known = native.REGISTRY["cpu"][arithmetic.name]
    arguments.check_choice(op, "variant", variant, tuple(known))
    arguments.check_choice(op, "cull", cull, CULLS)
    height, width = arguments.check_image_size(op, "resolution", resolution)
    box = arguments.check_scissor(op, scissor, height, width)
    clip = arguments.check_tensor(op, "positions", positions, torch.float32, "[V, 4]", 2).cpu()
    faces = arguments.check_tensor(op, "triangles", triangles, torch.int32, "[T, 3]", 2).cpu()
    arguments.check_size(op, "positions", clip, -1, 4, "x, y, z, w")
    arguments.check_size(op, "triangles", faces, 1, 3, "corners")
    check_indices(op, faces, len(clip))
    values = native.parameter_values(op, known[variant], parameters)
    drawing = (clip, faces, height, width, cull, box, variant, arithmetic.name, values)
    rows, columns = -(-height // BIN), -(-width // BIN)
    levels = _levels(rows * BIN, columns * BIN)
    room = 1
    # Threads decide how many tasks draw, in some variants, so the second drawing may have more than the first.
    while True:
        packed, dropped = torch.empty((height, width), dtype=torch.int64), torch.empty((), dtype=torch.int64)
        shapes = (len(native.COUNTERS),), (rows * BIN, columns * BIN), (sum(h * w for h, w in levels),), (room,)
        counters, fragments, edges, tasks = (torch.zeros(shape, dtype=torch.int64) for shape in shapes)
        torch.ops.bigtri.map_work(*drawing, packed, dropped, counters, fragments, edges, tasks)
        counts = {name: int(n) for name, n in zip(native.COUNTERS, counters, strict=True) if n}
        if counts.get("tasks", 0) <= room:
            break
        room = counts["tasks"]
    by_level = np.split(edges.numpy(), np.cumsum([h * w for h, w in levels])[:-1])
    squares = tuple(part.reshape(shape) for part, shape in zip(by_level, levels, strict=True))
    return WorkMap(counts, fragments.numpy(), squares, np.sort(tasks.numpy()[: counts.get("tasks", 0)])[::-1])


def _levels(height: int, width: int) -> list[tuple[int, int]]:
    """Squares down and across, of tiles and of everything above; ``WorkMap`` of csrc/cpu/work_map.h."""
    levels = [(height // TILE, width // TILE)]
    while levels[-1] != (1, 1):
        size = TILE << len(levels)
        levels.append((-(-height // size), -(-width // size)))
    return levels

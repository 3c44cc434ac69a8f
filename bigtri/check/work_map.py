"""Where a variant does its work: edge values by the square that they were computed for, fragments by pixel, work by task."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from .. import native
from ..ops.arguments import Array
from ..precision import DEFAULT, Precision
from ..reference.numerics import TILE
from ..reference.work_map import levels_of
from .counters import Scene, Scissor, by_name, choose_where, chosen_values, drawn_on_cuda, modelled


class WorkMap(NamedTuple):
    """The work of one view. It reaches as far as the view's bins do: a variant may compute what lies beyond the image."""

    counters: dict[str, int]  # of csrc/core/counters.h, those that are not 0, of the same drawing
    fragments: NDArray[np.int64]  # [64 rows, 64 columns], of bins: the fragments offered to each pixel
    # Edge values by the square that they were computed for: tiles of 8 px, squares twice as wide, and so on up to one that
    # holds all bins; [down, across] each. None: of CUDA, which counts them without their place.
    edges: tuple[NDArray[np.int64], ...] | None
    # [N]: edge values and fragments of each task that drew, the most first; on CUDA fragments alone, of each block that
    # offered any.
    tasks: NDArray[np.int64]

    def by_tile(self) -> NDArray[np.float64]:
        """float64 [8 rows, 8 columns]: edge values, where they are counted, and fragments in each tile of 8x8 px.

        What was computed for a wider square is spread evenly over its tiles, so the sum is that of the counters.
        """
        down, across = (size // TILE for size in self.fragments.shape)
        work = self.fragments.reshape(down, TILE, across, TILE).sum(axis=(1, 3)).astype(np.float64)
        for level, edges in enumerate(self.edges or ()):
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
    backend: str = "auto",
    device: str = "cpu",
    precision: str | Precision = DEFAULT,
    cull: str = "none",
    scissor: Scissor | None = None,
    parameters: Mapping[str, int] | None = None,
) -> WorkMap:
    """Where a variant does what ``counters.count`` counts, in one view.

    Args:
        positions, triangles, resolution, cull, scissor, precision: as for ``rasterize``; positions [V, 4], on the CPU.
        variant: one of ``bigtri.native.VARIANTS[device]``.
        backend: "native" draws with the build that counts, "reference" works it out from the stages; "auto". With one thread
            both have the same.
        device: where the native backend draws: "cpu", or "cuda", if it was built with ``BIGTRI_CUDA_COUNTING=1``. There
            fragments have a place, and edge values are in ``counters`` alone (docs/variants.md).
        parameters: values of the variant's parameters by name, instead of the standard ones.

    Raises:
        TypeError, ValueError: an argument of another dtype, shape or value; the text names it.
        RuntimeError: the extension is not built; an index in ``triangles`` is out of range; the rung's work is not counted;
            there is no CUDA device, or none that counts.
    """
    op = "map_work"
    backend, device = choose_where(op, backend, device, variant)
    scene = Scene.checked(op, positions, triangles, resolution, precision, cull, scissor, 2)
    if backend == "reference":
        counts, places = modelled(op, scene, variant, parameters)
        return WorkMap(counts, places.fragments, places.edges, np.sort(places.tasks)[::-1])
    return (_drawn_on_cuda if device == "cuda" else _drawn)(op, scene, variant, parameters)


def _drawn_on_cuda(op: str, scene: Scene, variant: str, parameters: Mapping[str, int] | None) -> WorkMap:
    """The map of kernels that count. A task is a block."""
    counts, fragments, blocks = drawn_on_cuda(op, scene, variant, parameters)
    tasks = np.sort(blocks[blocks > 0])[::-1]
    if len(tasks):
        counts |= {"tasks": len(tasks), "work": int(tasks.sum()), "most_work": int(tasks[0])}
    return WorkMap(counts, fragments, None, tasks)


def _drawn(op: str, scene: Scene, variant: str, parameters: Mapping[str, int] | None) -> WorkMap:
    """The map of the CPU's build that counts."""
    clip, faces, (height, width), arithmetic, cull, box = scene
    drawing = (clip, faces, height, width, cull, box, variant, arithmetic.name)
    values = chosen_values(op, scene, variant, parameters, "cpu")
    levels = levels_of(height, width)
    sizes = [down * across for down, across in levels]
    image = [TILE * size for size in levels[0]]
    room = 1
    # Threads decide how many tasks draw, in some variants, so the second drawing may have more than the first.
    while True:
        packed, dropped = torch.empty((height, width), dtype=torch.int64), torch.empty((), dtype=torch.int64)
        shapes = [len(native.COUNTERS)], image, [sum(sizes)], [room]
        counters, fragments, edges, tasks = (torch.zeros(shape, dtype=torch.int64) for shape in shapes)
        torch.ops.bigtri.map_work(*drawing, values, packed, dropped, counters, fragments, edges, tasks)
        counts = by_name(counters)
        if (count := counts.get("tasks", 0)) <= room:
            break
        room = count
    parts = np.split(edges.numpy(), np.cumsum(sizes)[:-1])
    by_level = tuple(part.reshape(shape) for part, shape in zip(parts, levels, strict=True))
    return WorkMap(counts, fragments.numpy(), by_level, np.sort(tasks.numpy()[:count])[::-1])

"""The work of csrc/cpu/tile_queues.cpp: queues of 128 px bins, of 8 px tiles, and the pixels of each tile."""

from __future__ import annotations

import numpy as np

from ..binning import binning
from ..numerics import TILE
from ..work import (
    POINTER_BYTES,
    Job,
    check_one_round,
    in_bins,
    load,
    passing,
    pixels_in,
    record_bytes,
    squares_in_boxes,
    squares_of,
    sums_by,
    tile_entry_bytes,
    tiles_of,
    touched_tiles,
)

STANDARD = {"share": 256, "room": 1024}  # of the variant's parameters
REJECTS_BY_DEPTH = ""
OWNS_PIXELS = True
_WIDE_BIN = 128  # px; kWideBin of csrc/cpu/tile_queues.h


def count(job: Job) -> dict[str, int]:
    """Records, the wide bins that no edge rejects, the tiles of these, and the pixels that they cover.

    Raises:
        ValueError: the view's records are not all set up at once.
    """
    check_one_round(job)
    records = job.records
    candidates, kept = squares_of(job, _WIDE_BIN)
    wide = candidates[kept]
    boxes = in_bins(records.bbox[wide[:, 0]], wide[:, 1:], _WIDE_BIN)
    of_boxed = squares_in_boxes(boxes, TILE)
    boxed = np.bincount(of_boxed.of, minlength=len(wide))
    # A tile that no edge rejects lies in a 64 px bin that none rejects, and that in such a wide one.
    bins = binning(records, -1, job.arithmetic)
    queue = bins.candidates[bins.kept]
    tiles = tiles_of(job, queue, of_touched=3, of_partly=3 * TILE * TILE)
    touched, full = int(tiles.touched.sum()), int(tiles.full.sum())
    column, row = touched_tiles(job, queue)
    columns = job.width // _WIDE_BIN + 1
    of_wide = np.concatenate([wide[:, 2] * columns + wide[:, 1], queue[:, 2] // 2 * columns + queue[:, 1] // 2])
    lengths = np.unique(of_wide[: len(wide)], return_counts=True)[1]
    passed = passing(job)
    edges_64 = job.places.add_bins(3, candidates, _WIDE_BIN) + job.places.add_edges(3, *of_boxed[1:])
    stored = record_bytes(job.arithmetic) * len(records.xy) + POINTER_BYTES * len(wide)
    return {
        "records": len(records.xy),
        "by_tiles": len(records.xy),
        "candidates": len(candidates),
        "entries": len(wide) + touched,
        "overflows": int(np.maximum(lengths - job.parameters["room"], 0).sum()),
        "bytes": stored + tile_entry_bytes(job.arithmetic) * touched,
        "bins_tested": len(candidates),
        "bins_rejected": len(candidates) - len(wide),
        "tiles_tested": int(boxed.sum()),
        "tiles_rejected": int(boxed.sum()) - touched,
        "tiles_accepted": full,
        "tiles_empty": int((tiles.touched - tiles.covered).sum()),
        "edges_64": edges_64 + 3 * touched,
        "edges_32": int(tiles.edges.sum()) - 3 * touched,
        "fragments": int(tiles.fragments.sum()),
        "passed": passed,
        "written": pixels_in(job, column, row, TILE),
        "atomics": len(wide),
        **load(job, sums_by(of_wide, np.concatenate([3 * boxed, tiles.edges + tiles.fragments]))),
    }

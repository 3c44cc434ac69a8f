"""The work of csrc/cpu/coverage_masks.cpp: queues of bins and of their tiles, and masks of the tiles' pixels."""

from __future__ import annotations

from ..numerics import TILE, TILES
from ..work import Job, check_one_round, load, passing, pixels_in, queued_bins, sums_by, tile_entry_bytes, touched_tiles

STANDARD = {"share": 256, "room": 256}  # of the variant's parameters
REJECTS_BY_DEPTH = ""
OWNS_PIXELS = True
_OF_BIN = 6 * TILES * TILES  # edge values, two corners of each of its tiles


def count(job: Job) -> dict[str, int]:
    """Records, the bins that no edge rejects, the tiles of these, and the pixels that they cover.

    Raises:
        ValueError: the view's records are not all set up at once.
    """
    check_one_round(job)
    queue, tiles, counts = queued_bins(job)
    touched = int(tiles.touched.sum())
    of_bin = queue[:, 2] * (job.width + 1) + queue[:, 1]
    return {
        **counts,
        "entries": len(queue) + touched,
        "bytes": counts["bytes"] + tile_entry_bytes(job.arithmetic) * touched,
        "edges_64": counts["edges_64"] + job.places.add_bins(3, queue),
        "edges_32": job.places.add_bins(_OF_BIN, queue) + int(tiles.edges.sum()),
        "passed": passing(job),
        "written": pixels_in(job, *touched_tiles(job, queue), TILE),
        **load(job, sums_by(of_bin, 3 + _OF_BIN + tiles.edges + tiles.fragments)),
    }

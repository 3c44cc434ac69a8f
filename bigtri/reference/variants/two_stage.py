"""The work of csrc/cpu/two_stage.cpp: a list of pairs of a record and a bin."""

from __future__ import annotations

import numpy as np

from ..binning import binning
from ..numerics import TILE
from ..work import Job, load, passing, record_bytes, sums_by, tiles_of

STANDARD = {"share": 256, "pairs": 64}  # of the variant's parameters
REJECTS_BY_DEPTH = ""
OWNS_PIXELS = False
_PAIR_BYTES = 8


def count(job: Job) -> dict[str, int]:
    """Records, the bins that their bounding boxes touch, those bins that no edge rejects, and what their tiles hold."""
    records = job.records
    bins = binning(records, -1, job.arithmetic)
    queue = bins.candidates[bins.kept]
    tiles = tiles_of(job, queue, of_boxed=3, of_touched=3 + 3 * TILE * TILE)
    passed = passing(job)
    edges_64 = job.places.add_bins(3, bins.candidates) + job.places.add_bins(6, queue)
    share = records.triangle[queue[:, 0]] // job.parameters["share"]
    within = np.arange(len(queue)) - np.searchsorted(share, share)  # the pair's place in its share
    task = share.astype(np.int64) * (len(queue) + 1) + within // job.parameters["pairs"]
    return {
        "records": len(records.xy),
        "by_tiles": len(records.xy),
        "candidates": len(bins.kept),
        "entries": len(queue),
        "bytes": record_bytes(job.arithmetic) * len(records.xy) + _PAIR_BYTES * len(queue),
        "bins_tested": len(bins.kept),
        "bins_rejected": len(bins.kept) - len(queue),
        "tiles_tested": int(tiles.boxed.sum()),
        "tiles_rejected": int((tiles.boxed - tiles.touched).sum()),
        "tiles_accepted": int(tiles.full.sum()),
        "tiles_empty": int((tiles.touched - tiles.covered).sum()),
        "edges_64": edges_64,
        "edges_32": int(tiles.edges.sum()),
        "fragments": int(tiles.fragments.sum()),
        "passed": passed,
        "written": passed,
        "atomics": passed,
        **load(job, sums_by(task, 6 + tiles.edges + tiles.fragments)),
    }

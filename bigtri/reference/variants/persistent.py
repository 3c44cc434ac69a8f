"""The work of csrc/cpu/persistent.cpp: a queue for each bin, drawn into a patch whenever it has got long, and at the end."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..numerics import BIN, TILES
from ..work import Job, check_one_round, load, passing, pixels_in, queued_bins, sums_by

STANDARD = {"share": 256, "room": 256, "batch": 1024}  # of the variant's parameters
REJECTS_BY_DEPTH = ""
OWNS_PIXELS = True
_OF_BIN = 6 * TILES * TILES  # edge values, two corners of each of its tiles


def count(job: Job) -> dict[str, int]:
    """Records, the bins that no edge rejects, and what one worker draws each time that it owns a bin.

    Raises:
        ValueError: the view's records are not all set up at once.
    """
    check_one_round(job)
    queue, tiles, counts = queued_bins(job)
    turn = _turns(job, queue)
    of_turn = (queue[:, 2].astype(np.int64) * (job.width + 1) + queue[:, 1]) * (len(queue) + 1) + turn
    _, column, row = queue[np.unique(of_turn, return_index=True)[1]].T
    return {
        **counts,
        "edges_64": counts["edges_64"] + job.places.add_bins(3, queue),
        "edges_32": job.places.add_bins(_OF_BIN, queue) + int(tiles.edges.sum()),
        "passed": passing(job),
        "written": pixels_in(job, column, row, BIN),
        **load(job, sums_by(of_turn, 3 + _OF_BIN + tiles.edges + tiles.fragments)),
    }


def _turns(job: Job, queue: NDArray[np.int32]) -> NDArray[np.int64]:
    """int64 [Q]: how often the entry's bin has been drawn before the entry is.

    One worker draws a bin after each share in which the length of its queue passed a multiple of the batch, with all that the
    queue holds by then.
    """
    share = job.records.triangle[queue[:, 0]] // job.parameters["share"]
    bins = queue[:, 2].astype(np.int64) * (job.width + 1) + queue[:, 1]
    order = np.lexsort((np.arange(len(queue)), bins))  # by bin, then as they are pushed
    bins, share = bins[order], share[order]
    starts = np.searchsorted(bins, bins)
    full = (np.arange(len(bins)) - starts + 1) % job.parameters["batch"] == 0
    drawn_after = np.unique(np.stack([bins[full], share[full]], axis=1), axis=0)  # bins, and shares after which they are drawn
    key = bins * (len(job.triangles) + 1)
    turns = np.empty(len(queue), np.int64)
    earlier = drawn_after[:, 0] * (len(job.triangles) + 1) + drawn_after[:, 1]
    turns[order] = np.searchsorted(earlier, key + share) - np.searchsorted(earlier, key)
    return turns

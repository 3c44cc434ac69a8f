"""The work of csrc/cpu/batched.cpp: every pixel of every bounding box."""

from __future__ import annotations

import numpy as np

from ..binning import bbox_pixels
from ..numerics import TILE
from ..work import Job, fragments_of, in_bins, load, passing, squares_in_boxes, sums_by

STANDARD = {"batch": 32}  # of the variant's parameters
REJECTS_BY_DEPTH = ""
OWNS_PIXELS = False
_DIRECT_EXTENT = 1024  # px; kDirectExtent of csrc/core/record.h


def count(job: Job) -> dict[str, int]:
    """Records, the pixels of their bounding boxes, and those that they cover, each with an atomic minimum if it is nearer."""
    records = job.records
    pixels = bbox_pixels(records).astype(np.int64)
    extent = (records.xy.max(axis=1, initial=-(2**31)) - records.xy.min(axis=1, initial=2**31 - 1)).max(axis=1, initial=0)
    wide = extent > _DIRECT_EXTENT * job.arithmetic.subpixel
    # A tile has as many edge values as pixels that it shares with the box, times three.
    record, x, y = squares_in_boxes(records.bbox, TILE)
    boxes = in_bins(records.bbox[record], np.stack([x, y], axis=1) // TILE, TILE)
    edges = 3 * (boxes[:, 2:] - boxes[:, :2]).prod(axis=1)
    of_wide = wide[record]
    fragments = fragments_of(job)
    passed = passing(job)
    return {
        "records": len(pixels),
        "by_rows": len(pixels),
        "wide": int(wide.sum()),
        "edges_64": job.places.add_edges(edges[of_wide], x[of_wide], y[of_wide]),
        "edges_32": job.places.add_edges(edges[~of_wide], x[~of_wide], y[~of_wide]),
        "fragments": int(fragments.sum()),
        "passed": passed,
        "written": passed,
        "atomics": passed,
        **load(job, sums_by(records.triangle // job.parameters["batch"], 3 * pixels + fragments)),
    }

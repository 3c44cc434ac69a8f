"""The work of csrc/cpu/batched.cpp: every pixel of every bounding box."""

from __future__ import annotations

import numpy as np

from ..binning import bbox_pixels
from ..work import Job, fragments_of, load, passing, sums_by

STANDARD = {"batch": 32}  # of the variant's parameters
REJECTS_BY_DEPTH = False
OWNS_PIXELS = False
_DIRECT_EXTENT = 1024  # px; kDirectExtent of csrc/core/record.h


def count(job: Job) -> dict[str, int]:
    """Records, the pixels of their bounding boxes, and those that they cover, each with an atomic minimum if it is nearer."""
    records = job.records
    pixels = bbox_pixels(records).astype(np.int64)
    extent = (records.xy.max(axis=1, initial=-(2**31)) - records.xy.min(axis=1, initial=2**31 - 1)).max(axis=1, initial=0)
    wide = extent > _DIRECT_EXTENT * job.arithmetic.subpixel
    fragments = fragments_of(job)
    passed = passing(job)
    return {
        "records": len(pixels),
        "by_rows": len(pixels),
        "wide": int(wide.sum()),
        "edges_64": 3 * int(pixels[wide].sum()),
        "edges_32": 3 * int(pixels[~wide].sum()),
        "fragments": int(fragments.sum()),
        "passed": passed,
        "written": passed,
        "atomics": passed,
        **load(sums_by(records.triangle // job.parameters["batch"], 3 * pixels + fragments)),
    }

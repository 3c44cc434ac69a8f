"""The work of csrc/cpu/scanline.cpp: every row of every bounding box, every covered pixel."""

from __future__ import annotations

import numpy as np

from ..numerics import ramp
from ..work import Job, fragments_of, load, passing, sums_by

STANDARD = {"share": 256}  # of the variant's parameters
REJECTS_BY_DEPTH = ""
OWNS_PIXELS = False


def count(job: Job) -> dict[str, int]:
    """Records, rows of their bounding boxes, and the pixels that they cover, each with an atomic minimum if it is nearer."""
    records = job.records
    rows = (records.bbox[:, 3] - records.bbox[:, 1]).astype(np.int64)
    y = np.repeat(records.bbox[:, 1], rows) + ramp(rows)
    fragments = fragments_of(job)
    passed = passing(job)
    return {
        "records": len(rows),
        "by_rows": len(rows),
        "edges_64": job.places.add_edges(3, np.repeat(records.bbox[:, 0], rows), y),
        "rows": int(rows.sum()),
        "fragments": int(fragments.sum()),
        "passed": passed,
        "written": passed,
        "atomics": passed,
        **load(job, sums_by(records.triangle // job.parameters["share"], 3 * rows + fragments)),
    }

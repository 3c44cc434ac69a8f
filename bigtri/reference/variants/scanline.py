"""The work of csrc/cpu/scanline.cpp: every row of every bounding box, every covered pixel."""

from __future__ import annotations

import numpy as np

from ..work import Job, fragments_of, load, passing, sums_by

STANDARD = {"share": 256}  # of the variant's parameters
REJECTS_BY_DEPTH = False
OWNS_PIXELS = False


def count(job: Job) -> dict[str, int]:
    """Records, rows of their bounding boxes, and the pixels that they cover, each with an atomic minimum if it is nearer."""
    records = job.records
    rows = (records.bbox[:, 3] - records.bbox[:, 1]).astype(np.int64)
    fragments = fragments_of(job)
    passed = passing(job)
    return {
        "records": len(rows),
        "by_rows": len(rows),
        "edges_64": 3 * int(rows.sum()),
        "rows": int(rows.sum()),
        "fragments": int(fragments.sum()),
        "passed": passed,
        "written": passed,
        "atomics": passed,
        **load(sums_by(records.triangle // job.parameters["share"], 3 * rows + fragments)),
    }

"""The work of csrc/cpu/scanline.cpp: every row of every bounding box, every covered pixel."""

from __future__ import annotations

import numpy as np

from ..scanline import scanline
from ..work import NO_QUEUE, Job, load, passing, sums_by

STANDARD = {"share": 256}  # of the variant's parameters
REJECTS_BY_DEPTH = ""
OWNS_PIXELS = False


def count(job: Job) -> dict[str, int]:
    """Records, rows of their bounding boxes, and the pixels that they cover, each with an atomic minimum if it is nearer."""
    records = job.records
    spans = scanline(records, *NO_QUEUE, np.arange(len(records.xy), dtype=np.int32), job.arithmetic)
    rows = (records.bbox[:, 3] - records.bbox[:, 1]).astype(np.int64)
    fragments = np.zeros(len(rows), np.int64)
    np.add.at(fragments, spans[:, 0], spans[:, 3] - spans[:, 2])
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

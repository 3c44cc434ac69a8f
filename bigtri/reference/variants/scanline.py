"""The work of csrc/cpu/scanline.cpp: every row of every bounding box, every covered pixel."""

from __future__ import annotations

import numpy as np

from ...precision import Arithmetic
from ..records import Records
from ..scanline import scanline


def count(records: Records, arithmetic: Arithmetic) -> dict[str, int]:
    """Records, rows of their bounding boxes, and the pixels that they cover."""
    nothing = np.zeros((0, 3), np.int32), np.zeros(0, np.int64)
    spans = scanline(records, *nothing, np.arange(len(records.xy), dtype=np.int32), arithmetic)
    return {
        "records": len(records.xy),
        "rows": int((records.bbox[:, 3] - records.bbox[:, 1]).sum(dtype=np.int64)),
        "fragments": int((spans[:, 3] - spans[:, 2]).sum(dtype=np.int64)),
    }

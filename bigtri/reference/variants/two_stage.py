"""The work of csrc/cpu/two_stage.cpp: a list of pairs of a record and a bin."""

from __future__ import annotations

import numpy as np

from ...precision import Arithmetic
from ..binning import bbox_bins, binning
from ..records import Records


def count(records: Records, arithmetic: Arithmetic) -> dict[str, int]:
    """Records, the bins that their bounding boxes touch, and those bins that no edge rejects."""
    return {
        "records": len(records.xy),
        "candidates": int(bbox_bins(records).sum()),
        "entries": int(np.count_nonzero(binning(records, -1, arithmetic).kept)),
    }

"""The work of csrc/cpu/bin_owned.cpp: a list of records for each bin."""

from __future__ import annotations

import numpy as np

from ...precision import Arithmetic
from ..binning import bbox_bins, bbox_pixels, binning
from ..records import Records

_DIRECT_PIXELS = 384  # px of bbox; kDirectPixels of csrc/cpu/bin_owned.h
_DIRECT_EXTENT = 1024  # px; kDirectExtent of csrc/core/record.h


def count(records: Records, arithmetic: Arithmetic) -> dict[str, int]:
    """Records, the bins that their bounding boxes touch, and of large ones only those bins that no edge rejects."""
    extent = (records.xy.max(axis=1, initial=-(2**31)) - records.xy.min(axis=1, initial=2**31 - 1)).max(axis=1, initial=0)
    large = (bbox_pixels(records) > _DIRECT_PIXELS) | (extent > _DIRECT_EXTENT * arithmetic.subpixel)
    kept = binning(Records(*(field[large] for field in records)), -1, arithmetic).kept
    touched = bbox_bins(records)
    return {
        "records": len(records.xy),
        "candidates": int(touched.sum()),
        "entries": int(np.count_nonzero(kept) + touched[~large].sum()),
    }

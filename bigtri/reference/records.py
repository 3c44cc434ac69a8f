"""What setup hands to every later stage: one record per (sub)triangle."""

from __future__ import annotations

from typing import Any, NamedTuple


class Records(NamedTuple):
    """One entry per (sub)triangle that may cover a pixel, in the order of (triangle, fan position); docs/numerics.md 2.4.

    The fields are NumPy arrays, whichever backend made them. "subpx" is the rung's sub-pixel unit,
    1/256 px of `exact`.
    """

    triangle: Any  # int32 [N], index of the parent triangle
    xy: Any  # int32 [N, 3, 2], snapped vertices, subpx
    z: Any  # float32 [N, 3], window depth, 0 = near, 1 = far
    area: Any  # int64 [N], twice the area, subpx^2, > 0
    bbox: Any  # int32 [N, 4], x0, y0, x1, y1, px, half-open
    w: Any  # float64 [N, 3], clip-space w of the record's vertices
    corner: Any  # int32 [N, 3], corner of the parent that record vertex k (not clipped) or slot k (clipped) is
    weights: Any  # float64 [N, 3, 3], row k: homogeneous weights of record vertex k over the slots
    clipped: Any  # bool [N]
    # float32 [N, 3, 2], vertices in px, not snapped, of a rung whose coverage needs them; of any other [N, 0, 2]. A set-up of
    # one's own, which makes records of `exact`, may leave it out.
    place: Any = None


class Bins(NamedTuple):
    """What binning hands out; the queue of (record, bin column, bin row) is ``candidates[kept]``."""

    candidates: Any  # int32 [C, 3], every bin that a large record's bbox touches
    kept: Any  # bool [C], not rejected by an edge
    small: Any  # int32 [M], records that take the direct path

"""The work of csrc/cpu/bin_owned.cpp: a list of records for each bin, whose pixels one worker draws, the hidden ones left out."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..binning import bbox_pixels, binning
from ..clip import clip_planes
from ..coverage import fills, is_inside, sides_of
from ..depth import bound_depth, depth
from ..numerics import BIN, TILE, TILES
from ..tile_mask import tile_mask
from ..work import Job, Pixels, boxed_tiles, extent, load, pack, record_bytes

# Of the variant's parameters; kStandardRecords and kStandardCandidates of csrc/cpu/bin_owned.cpp.
STANDARD = {"records": 1 << 18, "candidates": 1 << 23}
REJECTS_BY_DEPTH = ""  # it does, in an order that threads do not decide: that of the triangles
OWNS_PIXELS = True
_DIRECT_PIXELS = 384  # px of bbox; kDirectPixels of csrc/cpu/setup.h
_DIRECT_EXTENT = 1024  # px; kDirectExtent of csrc/core/record.h
_BLOCK = 96  # large records; kBlock of csrc/cpu/bin_owned.inl
_MOST_PARTS = 26  # of a clipped triangle; kMaxSubTriangles of csrc/core/clip.h
_ENTRY_BYTES = 8 + 4  # a pair, and its place in the bin's list
_LANES = 8  # px that the direct path tests at a time


def count(job: Job) -> dict[str, int]:
    """Records, the bins that their bounding boxes touch, of large ones only those that no edge rejects; and each bin's work.

    Raises:
        ValueError: the view takes more than one pass.
    """
    records, arithmetic = job.records, job.arithmetic
    everything = binning(records, -1, arithmetic)
    large = (bbox_pixels(records) > _DIRECT_PIXELS) | (extent(records) > _DIRECT_EXTENT * arithmetic.subpixel)
    of_large = large[everything.candidates[:, 0]]
    _check_one_pass(job, len(of_large))
    queue = everything.candidates[~of_large | everything.kept]  # by record
    of_large_queued = large[queue[:, 0]]
    full = of_large_queued & fills(sides_of(records, queue[:, 0], arithmetic), BIN * queue[:, 1], BIN * queue[:, 2], BIN)
    tested = int(of_large.sum())
    total = {
        "records": len(records.xy),
        "by_rows": int(np.count_nonzero(~large)),
        "by_tiles": int(np.count_nonzero(large)),
        "candidates": len(of_large),
        "entries": len(queue),
        "bytes": record_bytes(arithmetic) * len(records.xy) + _ENTRY_BYTES * len(queue),
        "bins_tested": tested,
        "bins_rejected": tested - int(of_large_queued.sum()),
        "bins_accepted": int(full.sum()),
        "edges_64": job.places.add_bins(3, everything.candidates[of_large]) + job.places.add_bins(3, queue[of_large_queued]),
    }
    work = []
    for column, row in np.unique(queue[:, 1:], axis=0):
        here = (queue[:, 1:] == (column, row)).all(axis=1)
        found = _Bin(job, queue[here], full[here], of_large_queued[here]).drawn()
        work.append(found["edges_64"] + found["edges_32"] + found["fragments"])
        for name, n in found.items():
            total[name] = total.get(name, 0) + n
    return {**total, **load(job, np.array(work, np.int64))}


def _check_one_pass(job: Job, candidates: int) -> None:
    corners = job.positions[job.triangles].astype(np.float64)
    planes = clip_planes(job.height, job.width, job.arithmetic)
    with np.errstate(invalid="ignore"):  # of triangles that are dropped
        cut = np.any([~(plane.distance(corners) >= 0) for plane in planes], axis=(0, 2))
    slots = len(cut) + (_MOST_PARTS - 1) * int(cut.sum())
    for name, needed in (("records", slots), ("candidates", candidates)):
        if needed > job.parameters[name]:
            raise ValueError(
                f"bigtri.count: the reference counts what bin_owned does in one pass; with parameter {name} ="
                f" {job.parameters[name]} this view takes more, since it needs {needed}"
            )


class _Bin:
    """A bin and its list."""

    def __init__(self, job: Job, queue: NDArray[np.int32], full: NDArray[np.bool_], large: NDArray[np.bool_]) -> None:
        self.job, self.queue, self.full, self.large = job, queue, full, large
        records, arithmetic = job.records, job.arithmetic
        record = queue[:, 0].astype(np.int64)
        self.left, self.top = BIN * int(queue[0, 1]), BIN * int(queue[0, 2])
        self.sides = sides_of(records, record, arithmetic)
        self.zmin, self.zmax = records.z[record].min(axis=1), records.z[record].max(axis=1)
        self.far = self.zmax > 1
        self.touched, self.filled = (self._tiles(masks) for masks in tile_mask(records, queue, arithmetic))  # [Q, 64]
        place = np.stack([record, np.full_like(record, self.left), np.full_like(record, self.top)], axis=1)
        tiles = TILE * np.stack([np.arange(TILES * TILES) % TILES, np.arange(TILES * TILES) // TILES], axis=1)
        of_tiles = np.repeat(place, len(tiles), axis=0)
        of_tiles[:, 1:] += np.tile(tiles, (len(place), 1))
        self.nearest, self.farthest = (bound_depth(records, place, BIN, farthest, arithmetic) for farthest in (False, True))
        self.tile_nearest, self.tile_farthest = (
            bound_depth(records, of_tiles, TILE, farthest, arithmetic).reshape(-1, len(tiles)) for farthest in (False, True)
        )
        self.bin_far = np.float32(np.inf)  # the bin's depth bound
        self.tile_far = np.full(len(tiles), np.inf, np.float32)
        self.bounded = np.zeros(len(tiles), np.bool_)
        self.offered: list[NDArray[np.int64]] = []  # [F, 3] each: entry, x, y
        names = "bins_hidden tiles_tested tiles_rejected tiles_accepted tiles_empty tiles_hidden edges_64 edges_32 fragments"
        self.counts = dict.fromkeys(names.split(), 0)

    @staticmethod
    def _tiles(masks: NDArray[np.int64]) -> NDArray[np.bool_]:
        return (masks[:, None] >> np.arange(TILES * TILES) & 1).astype(np.bool_)

    def drawn(self) -> dict[str, int]:
        """What is counted while the list is drawn: large records first, in blocks, then small ones."""
        gives_bound = self.full & ~self.far
        self.bin_far = self.zmax[gives_bound].min(initial=np.inf)
        block: list[int] = []
        for e in np.flatnonzero(self.large).tolist():
            if self.nearest[e] > self.bin_far:  # no nearer than zmin, which is tested first
                self.counts["bins_hidden"] += 1
                continue
            if gives_bound[e]:
                self.bin_far = min(self.bin_far, self.farthest[e])
            if not self.full[e]:
                boxed = int(boxed_tiles(self.job.records.bbox[self.queue[e : e + 1, 0]], *self.queue[e : e + 1, 1:].T)[0])
                touched = int(self.touched[e].sum())
                self.counts["edges_64"] += self.job.places.add_edges(6, self.left, self.top, BIN)
                self.counts["edges_32"] += self.job.places.add_edges(6 * TILES * TILES, self.left, self.top, BIN)
                self.counts["tiles_tested"] += boxed
                self.counts["tiles_rejected"] += boxed - touched
                self.counts["tiles_accepted"] += int(self.filled[e].sum())
            block.append(e)
            if len(block) == _BLOCK:
                self._draw_block(block)
                block = []
        self._draw_block(block)
        for e in np.flatnonzero(~self.large).tolist():
            self._draw_small(e)
        return {**self.counts, **self._pixels()}

    def _draw_block(self, block: list[int]) -> None:
        """Gathers the bounds of all, then draws the tiles that are behind none."""
        seen = [e for e in block if self.nearest[e] <= self.bin_far]
        self.counts["bins_hidden"] += len(block) - len(seen)
        for e in seen:
            if self.touched[e].any() and not self.far[e]:
                self.bounded |= self.filled[e]
                self.tile_far = np.where(self.filled[e], np.minimum(self.tile_far, self.tile_farthest[e]), self.tile_far)
        for e in seen:
            hidden = self.touched[e] & self.bounded & (self.tile_nearest[e] > self.tile_far)
            self.counts["tiles_hidden"] += int(hidden.sum())
            visible = self.touched[e] & ~hidden
            partly = visible & ~self.filled[e]
            covered = self._of_tiles(visible) & (self._of_tiles(self.filled[e]) | self._inside(e))
            some = covered.reshape(TILES, TILE, TILES, TILE).any(axis=(1, 3)).reshape(-1)
            tile = np.flatnonzero(partly)
            place = self.left + TILE * (tile % TILES), self.top + TILE * (tile // TILES)
            self.counts["edges_32"] += self.job.places.add_edges(3 * TILE * TILE, *place)
            self.counts["tiles_empty"] += int((partly & ~some).sum())
            self._offer(e, covered)

    def _draw_small(self, e: int) -> None:
        x0, y0, x1, y1 = self.job.records.bbox[self.queue[e, 0]] - [self.left, self.top] * 2
        x0, y0, x1, y1 = max(x0, 0), max(y0, 0), min(x1, BIN), min(y1, BIN)
        boxed = np.zeros((BIN, BIN), np.bool_)
        boxed[y0:y1, x0:x1] = True
        tiles = boxed.reshape(TILES, TILE, TILES, TILE).any(axis=(1, 3)).reshape(-1)
        if self.zmin[e] > self.bin_far or (self.bounded.any() and (self.zmin[e] > self.tile_far[tiles]).all()):
            self.counts["bins_hidden"] += 1
            return
        self.counts["edges_64"] += self.job.places.add_edges(3, self.left + x0, self.top + y0)
        lanes = np.meshgrid(self.left + np.arange(x0, x1, _LANES), self.top + np.arange(y0, y1))
        self.counts["edges_32"] += self.job.places.add_edges(3 * _LANES, *lanes)
        self._offer(e, boxed & self._inside(e))

    def _inside(self, e: int) -> NDArray[np.bool_]:
        """bool [64, 64]: the pixels of the bin that entry e covers, wherever its bounding box ends."""
        one = self.sides._replace(
            edges=type(self.sides.edges)(*(field[e] for field in self.sides.edges)),
            rises_x=self.sides.rises_x[e],
            rises_y=self.sides.rises_y[e],
        )
        at = np.arange(BIN)
        return np.all(is_inside(one, *np.broadcast_arrays(self.left + at, self.top + at[:, None])), axis=-1)

    @staticmethod
    def _of_tiles(tiles: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """bool [64, 64]: the pixels of tiles [64]."""
        return tiles.reshape(TILES, TILES).repeat(TILE, axis=0).repeat(TILE, axis=1)

    def _offer(self, e: int, covered: NDArray[np.bool_]) -> None:
        y, x = np.nonzero(covered)
        self.offered.append(np.stack([np.full_like(x, e), x, y], axis=1))
        self.counts["fragments"] += self.job.places.add_fragments(self.left + x, self.top + y)

    def _pixels(self) -> dict[str, Any]:
        """What passes, in the order in which it was offered; and what is stored."""
        entry, x, y = np.concatenate([np.zeros((0, 3), np.int64), *self.offered]).T
        record = self.queue[entry, 0].astype(np.int64)
        left, top = self.left + x, self.top + y
        spans = np.stack([record, top, left, left + 1], axis=1)
        packed = pack(self.job.records.triangle[record], depth(self.job.records, spans, self.job.arithmetic))
        width, height = min(BIN, self.job.width - self.left), min(BIN, self.job.height - self.top)
        return {"passed": int(Pixels(BIN * BIN).offer(BIN * y + x, packed).sum()), "written": width * height}

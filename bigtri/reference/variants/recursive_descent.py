"""The work of csrc/cpu/recursive_descent.cpp: squares of 64, 16 and 4 px, each rejected, accepted or cut further."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..coverage import fills, is_inside, sides_of, touches
from ..numerics import BIN
from ..work import Job, load, passing, sums_by

STANDARD = {"share": 16, "early_z": 1, "separate": 1}  # of the variant's parameters
REJECTS_BY_DEPTH = "early_z"
OWNS_PIXELS = False
_MIDDLE, _BLOCK = 16, 4  # px
_NARROW_EXTENT = 1984  # px; kNarrowExtent of csrc/cpu/recursive_descent.h

Squares = NDArray[np.int64]  # [N, 2], x and y of the first pixel, px


def count(job: Job) -> dict[str, int]:
    """What all records of a view take, one after the other."""
    descent = _Descent(job)
    work = np.zeros(len(job.records.xy), np.int64)
    for record in range(len(work)):
        before = descent.work()
        descent.draw(record)
        work[record] = descent.work() - before
    # What is left out lies behind what a record before it has drawn, so it would not have passed.
    passed = passing(job)
    descent.counts["atomics"] += passed
    tasks = load(job, sums_by(job.records.triangle // job.parameters["share"], work))
    return {**descent.counts, "records": len(work), "passed": passed, "written": passed, **tasks}


class _Descent:
    def __init__(self, job: Job) -> None:
        self.job = job
        names = (
            "by_tiles within_16 within_4 wide candidates bins_tested bins_rejected bins_accepted bins_empty bins_hidden"
            " tiles_tested tiles_rejected tiles_accepted separations tiles_separated tiles_empty tiles_hidden"
            " edges_64 edges_32 fragments atomics"
        )
        self.counts = dict.fromkeys(names.split(), 0)
        # Depths behind which nothing of a bin, or of a square of 16x16 px, can be seen.
        columns, rows = (-(-size // BIN) for size in (job.width, job.height))
        self.far = {size: np.full((rows * BIN // size, columns * BIN // size), np.inf, np.float32) for size in (BIN, _MIDDLE)}
        self.record, self.bbox = 0, np.zeros(4, np.int64)
        self.nearest, self.farthest = np.float32(0), np.float32(0)

    def work(self) -> int:
        return self.counts["edges_64"] + self.counts["edges_32"] + self.counts["fragments"]

    def _edges(self, n: int | NDArray[np.int64], squares: Squares, size: int) -> int:
        x, y = squares.T
        return self.job.places.add_edges(n, x, y, size)

    def draw(self, record: int) -> None:
        records, arithmetic = self.job.records, self.job.arithmetic
        self.record, self.bbox = record, records.bbox[record].astype(np.int64)
        self.sides = sides_of(records, np.array([record]), arithmetic)
        self.nearest, self.farthest = records.z[record].min(), records.z[record].max()
        narrow = np.ptp(records.xy[record], axis=0).max() <= _NARROW_EXTENT * arithmetic.subpixel
        x0, y0, x1, y1 = self.bbox
        first = np.array([[x0 // _BLOCK, y0 // _BLOCK]]) * _BLOCK
        self.counts["edges_64"] += self._edges(3, first, _BLOCK)
        extent = max(x1 - first[0, 0], y1 - first[0, 1])
        if narrow and extent <= _MIDDLE:
            self.counts["within_4" if extent <= _BLOCK else "within_16"] += 1
            corners = np.array([[x, y] for x in (x0, x1 - 1) for y in (y0, y1 - 1)])
            if (self._behind(corners, BIN) | self._behind(corners, _MIDDLE)).all():
                self.counts["tiles_hidden"] += 1
            elif extent <= _BLOCK:
                self._draw_pixels(first)
            else:
                self._draw_blocks(first)
            return
        self.counts["by_tiles"] += 1
        self.counts["wide"] += not narrow
        self._draw_bins("edges_32" if narrow else "edges_64")

    # Depth bounds of the squares [N, 2] of `size` px that pixels [N, 2] lie in.

    def _behind(self, at: Squares, size: int) -> NDArray[np.bool_]:
        x, y = at.T // size
        return (self.job.parameters["early_z"] != 0) & (self.nearest > self.far[size][y, x])

    def _give_bound(self, at: Squares, size: int) -> None:
        if self.job.parameters["early_z"] and self.farthest <= 1:
            x, y = at.T // size
            self.counts["atomics"] += int((self.farthest < self.far[size][y, x]).sum())
            self.far[size][y, x] = np.minimum(self.far[size][y, x], self.farthest)

    # The descent. Each returns whether a pixel of each square [N, 2] is covered, bool [N].

    def _draw_bins(self, edges: str) -> None:
        low, high = self.bbox[:2] // BIN, (self.bbox[2:] - 1) // BIN
        bins = BIN * np.stack(np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(low, high, strict=True))), axis=-1).reshape(-1, 2)
        kept, full = self._test(bins, BIN)
        self.counts["candidates"] += len(bins)
        self.counts["bins_tested"] += len(bins)
        self.counts["bins_rejected"] += int((~kept).sum())
        self.counts["bins_accepted"] += int(full.sum())
        self.counts[edges] += self._edges(np.where(kept, 6, 3), bins, BIN)
        hidden = kept & self._behind(bins, BIN)
        self.counts["bins_hidden"] += int(hidden.sum())
        filled = bins[full & ~hidden]
        self._give_bound(filled, BIN)
        self._fill(filled, BIN)
        rest = bins[kept & ~full & ~hidden]
        self.counts["bins_empty"] += int((~self._draw_middles(rest)).sum())

    def _draw_middles(self, bins: Squares) -> NDArray[np.bool_]:
        owner, parts, full = self._parts(bins, _MIDDLE)
        hidden = self._behind(parts, _MIDDLE)
        self.counts["tiles_hidden"] += int(hidden.sum())
        filled, partly = full & ~hidden, ~full & ~hidden
        self._give_bound(parts[filled], _MIDDLE)
        some = hidden.copy()  # of which nobody knows
        some[filled] = self._fill(parts[filled], _MIDDLE)
        some[partly] = self._draw_blocks(parts[partly])
        return np.bincount(owner, some, len(bins)) > 0

    def _draw_blocks(self, squares: Squares) -> NDArray[np.bool_]:
        owner, parts, full = self._parts(squares, _BLOCK)
        some = np.zeros(len(parts), np.bool_)
        some[full] = self._fill(parts[full], _BLOCK)
        some[~full] = self._draw_pixels(parts[~full])
        covered: NDArray[np.bool_] = np.bincount(owner, some, len(squares)) > 0
        self.counts["tiles_empty"] += int((~covered).sum())
        return covered

    def _draw_pixels(self, blocks: Squares) -> NDArray[np.bool_]:
        pixels = self._cut(blocks, 1)
        inside = is_inside(self.sides, pixels[..., 0], pixels[..., 1]).all(axis=-1)
        self.counts["edges_32"] += self._edges(3 * 16, blocks, _BLOCK)
        inside &= ((pixels >= self.bbox[:2]) & (pixels < self.bbox[2:])).all(axis=-1)
        self.counts["fragments"] += self.job.places.add_fragments(*pixels[inside].T)
        covered = np.any(inside, axis=1)
        self.counts["tiles_empty"] += int((~covered).sum())
        return covered

    def _fill(self, squares: Squares, size: int) -> NDArray[np.bool_]:
        boxed = np.minimum(squares + size, self.bbox[2:]) - np.maximum(squares, self.bbox[:2])
        pixels = np.maximum(boxed, 0).prod(axis=1)
        for x, y in squares:
            box = max(x, self.bbox[0]), max(y, self.bbox[1]), min(x + size, self.bbox[2]), min(y + size, self.bbox[3])
            self.counts["fragments"] += self.job.places.add_box(*box)
        return pixels > 0

    def _parts(self, squares: Squares, size: int) -> tuple[NDArray[np.int64], Squares, NDArray[np.bool_]]:
        """The parts of squares that are neither rejected nor separated: whose they are, where, and whether they are full."""
        parts = self._cut(squares, size).reshape(-1, 2)
        kept, full = self._test(parts, size)
        self.counts["tiles_tested"] += len(parts)
        self.counts["tiles_rejected"] += int((~kept).sum())
        self.counts["tiles_accepted"] += int(full.sum())
        self.counts["edges_32"] += self._edges(6, parts, size)
        if self.job.parameters["separate"]:
            boxed = ((parts < self.bbox[2:]) & (parts + size > self.bbox[:2])).all(axis=1)
            self.counts["separations"] += int(kept.sum())
            self.counts["tiles_separated"] += int((kept & ~boxed).sum())
            kept &= boxed
        return np.repeat(np.arange(len(squares)), 16)[kept], parts[kept], full[kept]

    @staticmethod
    def _cut(squares: Squares, size: int) -> NDArray[np.int64]:
        """int64 [N, 16, 2]: 4x4 parts of `size` px."""
        return squares[:, None] + size * np.stack(np.meshgrid(np.arange(4), np.arange(4)), axis=-1).reshape(-1, 2)

    def _test(self, squares: Squares, size: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        x, y = squares.T
        return touches(self.sides, x, y, size), fills(self.sides, x, y, size)

"""What the models of variants share, which work out how much each does; csrc/core/counters.h lists what they count."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..precision import Arithmetic
from .binning import binning
from .coverage import is_inside, sides_of, touches
from .depth import depth
from .numerics import BACKGROUND, BIN, TILE, TILES, ramp
from .pipeline import FRAGMENTS, ROWS, batches
from .records import Records
from .scanline import scanline
from .tile_mask import tile_mask
from .work_map import Places

POINTER_BYTES = 8  # of a record in a queue
_SHARES_TOGETHER = 1024  # kSharesTogether of csrc/cpu/shares.h
_TINY_EXTENT = 4  # px; kTinyExtent of csrc/core/record.h
NO_QUEUE = np.zeros((0, 3), np.int32), np.zeros(0, np.int64)


class Job(NamedTuple):
    """One view of a drawing, as a model gets it."""

    positions: NDArray[np.float32]  # [V, 4], clip space
    triangles: NDArray[np.int32]  # [T, 3]
    records: Records  # those that set-up makes (without_empty)
    height: int  # px
    width: int
    arithmetic: Arithmetic
    parameters: Mapping[str, int]  # all of the variant's, by name
    places: Places  # out, added to: where the work is done


class Squares(NamedTuple):
    """Squares, each of a record, a box or a queue entry; int64 [K] each."""

    of: NDArray[np.int64]  # its number
    x: NDArray[np.int64]  # the first pixel
    y: NDArray[np.int64]


def extent(records: Records) -> NDArray[np.int32]:
    """int32 [N]: the larger of width and height of each, subpx."""
    span = records.xy.max(axis=1, initial=-(2**31)) - records.xy.min(axis=1, initial=2**31 - 1)
    larger: NDArray[np.int32] = span.max(axis=1, initial=0)
    return larger


def without_empty(records: Records, arithmetic: Arithmetic) -> Records:
    """The records but those that set-up leaves out: tiny, not clipped, with a bbox of at most 2x2 px and none of it covered."""
    first, size = records.bbox[:, :2].astype(np.int64), records.bbox[:, 2:] - records.bbox[:, :2]
    tiny = ~records.clipped & (extent(records) < _TINY_EXTENT * arithmetic.subpixel) & (size <= 2).all(axis=1)
    sides = sides_of(records, np.arange(len(records.xy)), arithmetic)
    covers = np.zeros(len(records.xy), np.bool_)
    for x, y in ((0, 0), (1, 0), (0, 1), (1, 1)):
        inside = is_inside(sides, first[:, 0] + x, first[:, 1] + y).all(axis=1)
        covers |= inside & (x < size[:, 0]) & (y < size[:, 1])
    kept = covers | ~tiny
    return Records(*(field if field is None else field[kept] for field in records))


class Pixels:
    """A visibility buffer that fragments are offered to one after the other."""

    def __init__(self, count: int) -> None:
        self.packed = np.full(count, BACKGROUND, np.int64)

    def offer(self, pixel: NDArray[np.int64], packed: NDArray[np.int64]) -> NDArray[np.bool_]:
        """bool [F]: which of the fragments ``packed`` [F] are nearer than what their pixel [F] holds when their turn comes."""
        passed = np.zeros(len(pixel), np.bool_)
        order = np.argsort(pixel, kind="stable")
        starts = np.flatnonzero(np.diff(pixel[order], prepend=-1))
        turn = ramp(np.diff(starts, append=len(order)))  # of the fragments of a pixel
        by_turn = order[np.argsort(turn, kind="stable")]
        for now in np.split(by_turn, np.cumsum(np.bincount(turn))[:-1]):
            passed[now] = packed[now] < self.packed[pixel[now]]
            self.packed[pixel[now]] = np.minimum(self.packed[pixel[now]], packed[now])
        return passed


def pack(triangle: NDArray[np.int32], z: NDArray[np.float32]) -> NDArray[np.int64]:
    """int64 [F]: fragments as they are offered to pixels; docs/numerics.md section 8."""
    bits = z.view(np.uint32).astype(np.int64)
    return np.where(z <= 1, (bits << 32) | triangle, BACKGROUND)


def passing(job: Job) -> int:
    """How many fragments are nearer than what their pixel holds, if records are drawn one after the other."""
    pixels, passed = Pixels(job.height * job.width), 0
    rows = job.records.bbox[:, 3] - job.records.bbox[:, 1]
    for records in batches(rows, ROWS):
        small = np.arange(records.start, records.stop, dtype=np.int32)
        spans = scanline(job.records, *NO_QUEUE, small, job.arithmetic)
        for part in batches(spans[:, 3] - spans[:, 2], FRAGMENTS):
            record, y, lower, upper = spans[part].astype(np.int64).T
            length = upper - lower
            pixel = np.repeat(y * job.width + lower, length) + ramp(length)
            z = depth(job.records, spans[part], job.arithmetic)
            passed += int(pixels.offer(pixel, pack(np.repeat(job.records.triangle[record], length), z)).sum())
    return passed


def fragments_of(job: Job) -> NDArray[np.int64]:
    """int64 [N]: how many pixels each record covers, which get fragments."""
    spans = scanline(job.records, *NO_QUEUE, np.arange(len(job.records.xy), dtype=np.int32), job.arithmetic)
    job.places.add_spans(spans)
    return np.bincount(spans[:, 0], weights=spans[:, 3] - spans[:, 2], minlength=len(job.records.xy)).astype(np.int64)


class TilesOfEntry(NamedTuple):
    """What drawing queue entries by tiles of 8x8 px finds; int64 [Q] each."""

    boxed: NDArray[np.int64]  # tiles that the record's bounding box meets
    touched: NDArray[np.int64]  # of these, rejected by no edge
    full: NDArray[np.int64]  # of these, with all pixel centres inside of all edges
    covered: NDArray[np.int64]  # of those touched, with a covered pixel
    fragments: NDArray[np.int64]  # covered pixels
    edges: NDArray[np.int64]  # edge values


def tiles_of(job: Job, queue: NDArray[np.int32], of_boxed: int = 0, of_touched: int = 0, of_partly: int = 0) -> TilesOfEntry:
    """The tiles of queue entries (record, bin column, bin row), int32 [Q, 3]; their fragments and edge values get their place.

    Args:
        of_boxed, of_touched, of_partly: edge values of each tile that the record's bounding box meets; besides, of one that no
            edge rejects; besides, of one of these that the record does not fill.
    """
    parts = [TilesOfEntry(*[np.zeros(0, np.int64)] * 6)]
    for part in batches(np.full(len(queue), BIN), ROWS):
        parts.append(_tiles_of(job, queue[part], (of_boxed, of_touched, of_partly)))
    return TilesOfEntry(*(np.concatenate(field) for field in zip(*parts, strict=True)))


def _tiles_of(job: Job, queue: NDArray[np.int32], edges: tuple[int, int, int]) -> TilesOfEntry:
    touched, full = tile_mask(job.records, queue, job.arithmetic)
    boxed = boxed_tiles(job.records.bbox[queue[:, 0]], queue[:, 1], queue[:, 2])
    of_boxed, of_touched, of_partly = edges
    job.places.add_edges(of_boxed, *squares_in_boxes(in_bins(job.records.bbox[queue[:, 0]], queue[:, 1:], BIN), TILE)[1:])
    job.places.add_edges(of_touched, *tiles_in(queue, touched)[1:])
    job.places.add_edges(of_partly, *tiles_in(queue, touched & ~full)[1:])
    spans = scanline(job.records, queue, touched, np.zeros(0, np.int32), job.arithmetic).astype(np.int64)
    job.places.add_spans(spans)
    record, y, lower, upper = spans.T
    # A span lies in one tile of one entry. Number both by record, row and column, which ascend with the queue.
    rows, columns = job.height // BIN + 1, job.width // BIN + 1
    first, column, row = queue.astype(np.int64).T
    numbers = _number(first, column, row, rows, columns)
    entry = np.searchsorted(numbers, _number(record, lower // BIN, y // BIN, rows, columns))
    _, once = np.unique(_number(record, lower // TILE, y // TILE, TILES * rows, TILES * columns), return_index=True)
    return TilesOfEntry(
        boxed,
        popcount(touched),
        popcount(full),
        np.bincount(entry[once], minlength=len(queue)),
        np.bincount(entry, weights=(upper - lower).astype(np.float64), minlength=len(queue)).astype(np.int64),
        of_boxed * boxed + of_touched * popcount(touched) + of_partly * popcount(touched & ~full),
    )


def tiles_in(queue: NDArray[np.int32], mask: NDArray[np.int64]) -> Squares:
    """Of queue entries [Q, 3], the tiles whose bits are set in masks [Q]."""
    entry, bit = np.nonzero(mask[:, None] >> np.arange(TILES * TILES) & 1)
    _, column, row = queue[entry].astype(np.int64).T
    return Squares(entry, BIN * column + TILE * (bit % TILES), BIN * row + TILE * (bit // TILES))


def squares_in_boxes(boxes: NDArray[np.integer], size: int) -> Squares:
    """Squares of ``size`` px, of a grid, that boxes [N, 4] meet."""
    first = boxes[:, :2].astype(np.int64) // size
    count = (boxes[:, 2:].astype(np.int64) - 1) // size + 1 - first
    squares = count[:, 0] * count[:, 1]
    box, place = np.repeat(np.arange(len(boxes)), squares), ramp(squares)
    column, row = (first[box] + np.stack([place % count[box, 0], place // count[box, 0]], axis=1)).T
    return Squares(box, size * column, size * row)


def in_bins(boxes: NDArray[np.integer], place: NDArray[np.integer], size: int) -> NDArray[np.int64]:
    """int64 [N, 4]: the parts of boxes that lie in bins of ``size`` px, whose columns and rows are [N, 2]."""
    begin = size * place.astype(np.int64)
    return np.hstack([np.maximum(boxes[:, :2], begin), np.minimum(boxes[:, 2:], begin + size)])


def _number(
    record: NDArray[np.int64], column: NDArray[np.int64], row: NDArray[np.int64], rows: int, columns: int
) -> NDArray[np.int64]:
    return (record * rows + row) * columns + column


def touched_tiles(job: Job, queue: NDArray[np.int32]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """int64 [K] each: column and row, in tiles of the image, of the different tiles that queue entries touch."""
    image = np.zeros((TILES * (job.height // BIN + 1), TILES * (job.width // BIN + 1)), np.bool_)
    for part in batches(np.full(len(queue), BIN), ROWS):
        touched, _ = tile_mask(job.records, queue[part], job.arithmetic)
        _, x, y = tiles_in(queue[part], touched)
        image[y // TILE, x // TILE] = True
    rows, columns = np.nonzero(image)
    return columns, rows


def boxed_tiles(
    bbox: NDArray[np.int32], column: NDArray[np.integer], row: NDArray[np.integer], size: int = BIN
) -> NDArray[np.int64]:
    """int64 [Q]: how many tiles of a bin of ``size`` px each ``bbox`` [Q, 4] meets."""
    count = np.ones(len(bbox), np.int64)
    for low, high, place in ((bbox[:, 0], bbox[:, 2], column), (bbox[:, 1], bbox[:, 3], row)):
        begin, end = np.maximum(low - size * place, 0), np.minimum(high - size * place, size)
        count *= (end - 1) // TILE - begin // TILE + 1
    return count


def squares_of(job: Job, size: int) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """As ``binning`` has it of bins: int32 [C, 3], squares (record, column, row) of ``size`` px that bounding boxes meet, and
    bool [C], which of them no edge rejects."""
    record, x, y = squares_in_boxes(job.records.bbox, size)
    kept = touches(sides_of(job.records, record, job.arithmetic), x, y, size)
    return np.stack([record, x // size, y // size], axis=1).astype(np.int32), kept


def pixels_in(job: Job, column: NDArray[np.integer], row: NDArray[np.integer], size: int) -> int:
    """How many pixels of the image lie in different squares of ``size`` px."""
    return int((np.minimum(size, job.width - size * column) * np.minimum(size, job.height - size * row)).sum(dtype=np.int64))


def check_one_round(job: Job) -> None:
    """Raise ValueError where a view's shares are not all set up at once: models are of those that are."""
    shares = -(-len(job.triangles) // job.parameters["share"])
    if shares > _SHARES_TOGETHER:
        raise ValueError(
            f"bigtri.count: the reference counts what {_SHARES_TOGETHER} shares make; with parameter share ="
            f" {job.parameters['share']} this view has {shares}"
        )


def popcount(masks: NDArray[np.int64]) -> NDArray[np.int64]:
    """int64 [...]: how many bits of each are set."""
    octets = np.ascontiguousarray(masks).view(np.uint8).reshape(*masks.shape, 8)
    return np.unpackbits(octets, axis=-1).sum(axis=-1, dtype=np.int64)


def queued_bins(job: Job) -> tuple[NDArray[np.int32], TilesOfEntry, dict[str, int]]:
    """The elements of the queues that csrc/cpu/record_queue.h makes of 64 px bins, int32 [Q, 3]; their tiles; and what is counted
    of both, where every tile that is touched is drawn."""
    bins = binning(job.records, -1, job.arithmetic)
    queue = bins.candidates[bins.kept]
    tiles = tiles_of(job, queue, of_partly=3 * TILE * TILE)
    lengths = np.unique(queue[:, 1:], axis=0, return_counts=True)[1]
    return (
        queue,
        tiles,
        {
            "records": len(job.records.xy),
            "by_tiles": len(job.records.xy),
            "candidates": len(bins.kept),
            "entries": len(queue),
            "overflows": int(np.maximum(lengths - job.parameters["room"], 0).sum()),
            "bytes": record_bytes(job.arithmetic) * len(job.records.xy) + POINTER_BYTES * len(queue),
            "bins_tested": len(bins.kept),
            "bins_rejected": len(bins.kept) - len(queue),
            "tiles_tested": int(tiles.boxed.sum()),
            "tiles_rejected": int((tiles.boxed - tiles.touched).sum()),
            "tiles_accepted": int(tiles.full.sum()),
            "tiles_empty": int((tiles.touched - tiles.covered).sum()),
            "edges_64": job.places.add_bins(3, bins.candidates),
            "fragments": int(tiles.fragments.sum()),
            "atomics": len(queue),
        },
    )


def tile_entry_bytes(arithmetic: Arithmetic) -> int:
    """The size of csrc/cpu/tile_entry.h's TileEntry."""
    return 16 if arithmetic.precision.depth == "float32_cell" else 24


def record_bytes(arithmetic: Arithmetic) -> int:
    """The size of csrc/core/record.h's Record: two gradients of depth are float32 or float64."""
    return 88 if arithmetic.precision.depth == "float32_cell" else 96


def load(job: Job, work: NDArray[np.int64]) -> dict[str, int]:
    """The counters of the load, of the work of each task that draws, which ``job.places`` keeps."""
    job.places.tasks = work[work > 0]
    return {
        "tasks": int(np.count_nonzero(work)),
        "work": int(work.sum()),
        "most_work": int(work.max(initial=0)),
    }


def sums_by(group: NDArray[np.int64], work: NDArray[np.int64]) -> NDArray[np.int64]:
    """int64 [G]: the sum of ``work`` [N] of each different ``group`` [N]."""
    _, place = np.unique(group, return_inverse=True)
    sums = np.zeros(place.max(initial=-1) + 1, np.int64)
    np.add.at(sums, place.reshape(-1), work)
    return sums

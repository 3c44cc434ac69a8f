"""The work of csrc/cpu/hierarchical_tiles.cpp: a pyramid of tiles, a record at the level at which it meets few."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..coverage import fills, is_inside, sides_of, touches
from ..depth import bound_depth
from ..numerics import BIN, ramp
from ..records import Records
from ..work import Job, check_one_round, load, passing, record_bytes, sums_by

# Of the variant's parameters; what is 0 is chosen by _shape.
STANDARD = {"share": 256, "tile": 0, "levels": 0, "meets": 0, "room": 0, "early_z": 1}
REJECTS_BY_DEPTH = "early_z"
OWNS_PIXELS = True
_MOST_SLOTS = 1 << 24  # kMostSlots of csrc/cpu/hierarchical_tiles.cpp
_ELEMENT_BYTES, _OVERFLOW_BYTES = 8, 16
_LANES = 8  # px


class _Shape(NamedTuple):
    """The pyramid: of each level the size of a tile in px, tiles across and down, and the room of a list."""

    size: list[int]
    columns: list[int]
    rows: list[int]
    room: list[int]
    meets: int


def _shape(job: Job) -> _Shape:
    p = job.parameters
    meets, finest = p["meets"] or 16, p["tile"] or BIN
    count = p["levels"] or next(n for n in range(1, 32) if finest << (n - 1) >= max(job.width, job.height))
    size = [finest << i for i in range(count)]
    columns, rows = ([-(-extent // s) for s in size] for extent in (job.width, job.height))
    room = p["room"] or min(max(8 * len(job.triangles) // (columns[0] * rows[0]), 16), 4096)
    most = [max(_MOST_SLOTS // count // (a * b), 1) for a, b in zip(columns, rows, strict=True)]
    return _Shape(size, columns, rows, [min(room << i, most[i]) for i in range(count)], meets)


class _Elements(NamedTuple):
    """Elements of lists, by level, record, row and column; int64 [E] each."""

    record: NDArray[np.int64]
    level: NDArray[np.int64]
    column: NDArray[np.int64]
    row: NDArray[np.int64]
    full: NDArray[np.bool_]  # whether the record has all of the tile inside


def count(job: Job) -> dict[str, int]:
    """What is stored, and what the finest tiles find in the lists above them."""
    check_one_round(job)
    shape = _shape(job)
    elements, stored = _stored(job, shape)
    drawn, work = _walked(job, shape, elements)
    order = np.argsort(_levels(job, shape), kind="stable")
    edges_64 = stored.pop("edges_64") + drawn.pop("edges_64")
    # What is left out lies behind what was drawn before it, so it would not have passed.
    passed = passing(job._replace(records=Records(*(field[order] for field in job.records))))
    return {**stored, **drawn, "edges_64": edges_64, "passed": passed, **load(job, work)}


def _boxes(bbox: NDArray[np.int64], size: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First tile and number of tiles, int64 [N, 2] each, that bounding boxes [N, 4] meet among those of ``size`` [N] px."""
    first = bbox[:, :2] // size[:, None]
    return first, (bbox[:, 2:] - 1) // size[:, None] + 1 - first


def _levels(job: Job, shape: _Shape) -> NDArray[np.int64]:
    """int64 [N]: where each record is stored."""
    bbox = job.records.bbox.astype(np.int64)
    level = np.full(len(bbox), len(shape.size) - 1)
    for i in reversed(range(len(shape.size) - 1)):
        _, tiles = _boxes(bbox, np.full(len(bbox), shape.size[i]))
        level[tiles.prod(axis=1) <= shape.meets] = i
    return level


def _stored(job: Job, shape: _Shape) -> tuple[_Elements, dict[str, int]]:
    level = _levels(job, shape)
    size = np.array(shape.size)[level]
    first, tiles = _boxes(job.records.bbox.astype(np.int64), size)
    count = tiles.prod(axis=1)
    record, place = np.repeat(np.arange(len(count)), count), ramp(count)
    column = first[record, 0] + place % tiles[record, 0]
    row = first[record, 1] + place // tiles[record, 0]
    kept, full, edges_64 = np.zeros(len(record), np.bool_), np.zeros(len(record), np.bool_), 0
    for i, s in enumerate(shape.size):
        here = level[record] == i
        sides = sides_of(job.records, record[here], job.arithmetic)
        kept[here] = touches(sides, s * column[here], s * row[here], s)
        full[here] = fills(sides, s * column[here], s * row[here], s)
        edges_64 += job.places.add_edges(np.where(kept[here], 6, 3), s * column[here], s * row[here], s)
    found = _Elements(record[kept], level[record[kept]], column[kept], row[kept], full[kept])
    order = np.lexsort((found.record, found.level))
    found = _Elements(found.record[order], found.level[order], found.column[order], found.row[order], found.full[order])
    _, which, lengths = np.unique(np.stack([found.level, found.row, found.column]), axis=1, return_index=True, return_counts=True)
    overflows = int(np.maximum(lengths - np.array(shape.room)[found.level[which]], 0).sum())
    entries = len(found.record)
    return found, {
        "records": len(count),
        "by_tiles": len(count),
        "candidates": len(record),
        "entries": entries,
        "overflows": overflows,
        "bytes": record_bytes(job.arithmetic) * len(count) + _ELEMENT_BYTES * entries + _OVERFLOW_BYTES * overflows,
        "bins_tested": len(record),
        "bins_rejected": len(record) - entries,
        "bins_accepted": int(found.full.sum()),
        "edges_64": edges_64,
        "atomics": entries,
    }


def _visits(job: Job, shape: _Shape, elements: _Elements) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Each element at each finest tile that reads it, by tile: the element, and the tile's column and row; int64 [V] each."""
    scale = 1 << elements.level
    first = np.stack([elements.column * scale, elements.row * scale], axis=1)
    last = np.minimum(first + scale[:, None], [shape.columns[0], shape.rows[0]])
    across = last - first
    count = across.prod(axis=1)
    element, place = np.repeat(np.arange(len(count)), count), ramp(count)
    column = first[element, 0] + place % across[element, 0]
    row = first[element, 1] + place // across[element, 0]
    order = np.lexsort((element, column, row))
    return element[order], column[order], row[order]


def _walked(job: Job, shape: _Shape, elements: _Elements) -> tuple[dict[str, int], NDArray[np.int64]]:
    """What is counted while finest tiles are drawn, and the work of each bin."""
    records, arithmetic, size = job.records, job.arithmetic, shape.size[0]
    element, column, row = _visits(job, shape, elements)
    read = np.unique(np.stack([column, row]), axis=1)
    written = np.minimum(size, job.width - size * read[0]) * np.minimum(size, job.height - size * read[1])

    left, top = size * column, size * row
    bbox = records.bbox[elements.record[element]].astype(np.int64)
    low, high = np.maximum(bbox[:, :2], np.stack([left, top], 1)), np.minimum(bbox[:, 2:], np.stack([left, top], 1) + size)
    boxed = (low < high).all(axis=1)
    element, column, row, left, top, low, high = (v[boxed] for v in (element, column, row, left, top, low, high))
    record, known = elements.record[element], elements.full[element]

    sides = sides_of(records, record, arithmetic)
    kept = known | touches(sides, left, top, size)
    full = known | fills(sides, left, top, size)
    place = np.stack([record, left, top], axis=1)
    zmin, zmax = records.z[record].min(axis=1), records.z[record].max(axis=1)
    bound = np.where(full & (zmax <= 1), bound_depth(records, place, size, True, arithmetic), np.float32(np.inf))
    far = _least_before(column + row * shape.columns[0], bound)
    early = job.parameters["early_z"] != 0
    behind = (zmin > far) & early  # by the nearest vertex, before any edge is asked
    hidden = ~behind & kept & (bound_depth(records, place, size, False, arithmetic) > far) & early
    tested = ~behind & ~known
    drawn = kept & ~behind & ~hidden
    partly = drawn & ~full

    lanes = -(-(high[:, 0] - low[:, 0] // _LANES * _LANES) // _LANES) * (high[:, 1] - low[:, 1])
    if size < _LANES:  # lanes are counted from the tile's first pixel
        lanes = high[:, 1] - low[:, 1]
    edges_64 = 3 * tested + 3 * (tested & kept)
    edges_32 = np.where(partly, 3 * _LANES * lanes, 0)
    fragments = np.where(drawn, (high - low).prod(axis=1), 0)
    for i in np.flatnonzero(partly):
        x, y = np.meshgrid(np.arange(low[i, 0], high[i, 0]), np.arange(low[i, 1], high[i, 1]))
        inside = is_inside(sides_of(records, record[i : i + 1], arithmetic), x, y).all(axis=-1)
        fragments[i] = job.places.add_fragments(x[inside], y[inside])
        first = left[i] + (low[i, 0] - left[i]) // _LANES * _LANES
        job.places.add_edges(3 * _LANES, *np.meshgrid(np.arange(first, high[i, 0], _LANES), np.arange(low[i, 1], high[i, 1])))
    for i in np.flatnonzero(drawn & full):
        job.places.add_box(*low[i], *high[i])
    job.places.add_edges(edges_64, left, top, size)
    bins = column * size // BIN + (row * size // BIN) * (job.width // BIN + 1)
    return {
        "tiles_tested": int(tested.sum()),
        "tiles_rejected": int((tested & ~kept).sum()),
        "tiles_accepted": int((tested & kept & full).sum()),
        "tiles_empty": int((drawn & (fragments == 0)).sum()),
        "tiles_hidden": int((behind | hidden).sum()),
        "edges_64": int(edges_64.sum()),
        "edges_32": int(edges_32.sum()),
        "fragments": int(fragments.sum()),
        "written": int(written.sum()),
    }, sums_by(bins, edges_64 + edges_32 + fragments)


def _least_before(group: NDArray[np.int64], value: NDArray[np.float32]) -> NDArray[np.float32]:
    """float32 [V]: the least ``value`` of those before in the same ``group``, whose members follow each other; infinity of none.

    It does not matter that a bound counts which a hidden record would have given: it lies behind the one that hid it.
    """
    least = np.full(len(value), np.inf, np.float32)
    starts = np.flatnonzero(np.diff(group, prepend=-1))
    for begin, end in zip(starts, np.append(starts, len(group))[1:], strict=True):
        least[begin + 1 : end] = np.minimum.accumulate(value[begin : end - 1])
    return least

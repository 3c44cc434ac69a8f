"""Where the outputs of one stage differ, as sentences: what came, and what the reference has in its place.

Each function gets the reference's output and another one of the same dtypes, and yields the differences in the order of records,
rows and columns. Equal means equal in bits; where docs/numerics.md leaves an order open, outputs are compared as sets.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..reference.binning import bbox_pixels
from ..reference.numerics import BACKGROUND, BIN, TILE, TILES
from ..reference.records import Bins, Records

Masks = tuple[NDArray[np.int64], NDArray[np.int64]]  # touched, full

# What a field of a record is called in a sentence, and its unit. "{}" is a vertex of the record, in the record's order.
_FIELDS = {
    "xy": ("vertex {} snapped to ", " subpx"),
    "z": ("vertex {} at depth ", ""),
    "area": ("twice the area is ", " subpx^2"),
    "bbox": ("bbox ", " px"),
    "w": ("vertex {} has w = ", ""),
    "corner": ("vertex {} is corner ", " of the triangle"),
    "weights": ("vertex {} has the weights ", " of the slots"),
    "clipped": ("", ""),
}


class Difference(NamedTuple):
    """One place where two backends differ."""

    stage: str  # one of ``bigtri.stages``, "rasterize" or "attributes"
    what: str  # the output: a field of Records or Bins, "dropped", "touched", "full", "spans", "depth", "packed", "barycentrics"
    expected: Any
    got: Any
    sentence: str  # the place, what came and what was expected, in words
    triangle: int | None = None  # index of the triangle at fault; of a record, its parent
    bin: tuple[int, int] | None = None  # column, row
    tile: tuple[int, int] | None = None  # column, row within the bin
    pixel: tuple[int, int] | None = None  # x, y

    def __str__(self) -> str:
        return f"stage {self.stage}, {self.sentence}"


def same_bits(a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.bool_]:
    """Elementwise, for arrays of one shape and dtype: equal as bit patterns, so -0 is not 0; every NaN equals every other."""
    pattern = np.dtype(f"u{a.dtype.itemsize}")
    same = np.ascontiguousarray(a).view(pattern) == np.ascontiguousarray(b).view(pattern)
    return same | (np.isnan(a) & np.isnan(b)) if a.dtype.kind == "f" and not same.all() else same


def setup(a: Records, b: Records) -> Iterator[Difference]:
    """Records are matched by parent and fan position: one too few or too many does not shift all that follow."""
    parents, wanted, came, of_a, of_b = _counted(a.triangle, b.triangle)
    for k in np.flatnonzero(wanted != came):
        triangle, counts = int(parents[k]), (int(wanted[k]), int(came[k]))
        words = f"triangle {triangle}: {_records(counts[1])}, {counts[0] or 'none'} expected"
        yield Difference("setup", "triangle", *counts, words, triangle)
    for k in np.flatnonzero(b.triangle[1:] < b.triangle[:-1])[:1]:
        before, after = int(b.triangle[k]), int(b.triangle[k + 1])
        words = f"triangle {after}: its record follows one of triangle {before}, ascending order expected"
        yield Difference("setup", "triangle", (after, before), (before, after), words, after)

    in_order = np.argsort(b.triangle, kind="stable")
    matched = wanted == came
    row_a, row_b = np.flatnonzero(matched[of_a]), in_order[matched[of_b[in_order]]]
    pairs = {name: (getattr(a, name)[row_a], getattr(b, name)[row_b]) for name in _FIELDS}
    wrong: dict[str, Any] = {name: ~same_bits(x, y).all(axis=tuple(range(1, x.ndim))) for name, (x, y) in pairs.items()}
    for k in np.flatnonzero(np.stack(list(wrong.values())).any(axis=0)):
        for name in _FIELDS:
            if wrong[name][k]:
                yield from _of_field(name, a, int(row_a[k]), *(values[k] for values in pairs[name]))


def dropped(stage: str, expected: int, got: int) -> Iterator[Difference]:
    """The number of triangles that are not finite."""
    if expected != got:
        yield Difference(stage, "dropped", expected, got, f"{got} triangle{'s' * (got != 1)} dropped, {expected} expected")


def binning(records: Records, threshold: int, a: Bins, b: Bins) -> Iterator[Difference]:
    """Which records are small, and which bins the others have, in any order."""
    if all(_equal(x, y) for x, y in zip(a, b, strict=True)):
        return
    small, wanted, came, *_ = _counted(a.small, b.small)
    for k in np.flatnonzero(wanted != came):
        counts = (int(wanted[k]), int(came[k]))
        record, (expected, got) = int(small[k]), (_times("small", count, max(counts) > 1) for count in counts)
        place = name_of(records, record)
        if (triangle := _parent(records, record)) is not None:
            place += f", with {bbox_pixels(records)[record]} px of bbox at a threshold of {threshold}"
        yield Difference("binning", "small", expected, got, f"{place}: {got}, {expected} expected", triangle)

    # By row before column, the order in which the reference lists them.
    bins, wanted, came, of_a, of_b = _counted(a.candidates[:, [0, 2, 1]], b.candidates[:, [0, 2, 1]])
    wanted_kept = np.bincount(of_a[a.kept], minlength=len(bins))
    came_kept = np.bincount(of_b[b.kept], minlength=len(bins))
    for k in np.flatnonzero((wanted != came) | (wanted_kept != came_kept)):
        record, row, column = (int(v) for v in bins[k])
        once = max(wanted[k], came[k]) > 1
        expected, got = (_listed(int(n[k]), int(of[k]), once) for n, of in ((wanted, wanted_kept), (came, came_kept)))
        words = f"{name_of(records, record)}, bin {(column, row)}: {got}, {expected} expected"
        what = "kept" if wanted[k] == came[k] else "candidates"
        yield Difference("binning", what, expected, got, words, _parent(records, record), (column, row))


def tile_mask(records: Records, queue: NDArray[np.int32], a: Masks, b: Masks) -> Iterator[Difference]:
    """Tile by tile, of each of the queue's entries."""
    (touched, full), (got_touched, got_full) = ([m.view(np.uint64) for m in masks] for masks in (a, b))
    wrong = (touched ^ got_touched) | (full ^ got_full)
    for entry in np.flatnonzero(wrong):
        record, column, row = queue[entry].tolist()
        for bit in range(TILES * TILES):
            if not int(wrong[entry]) >> bit & 1:
                continue
            flags = [[int(m[entry]) >> bit & 1 for m in masks] for masks in ((touched, full), (got_touched, got_full))]
            expected, got = (_tile_state(*pair) for pair in flags)
            tile = (bit % TILES, bit // TILES)
            words = f"{name_of(records, record)}, bin {(column, row)}, tile {tile}: {got}, {expected} expected"
            what = "touched" if flags[0][0] != flags[1][0] else "full"
            yield Difference("tile_mask", what, expected, got, words, _parent(records, record), (column, row), tile)


def scanline(records: Records, a: NDArray[np.int32], b: NDArray[np.int32]) -> Iterator[Difference]:
    """Which pixels of each row are covered, and how often; neither how a row is cut into spans nor their order matters."""
    if _equal(a, b):
        return
    record, y, lower, upper, wanted, came = _coverage(a, b)
    for k in np.flatnonzero(wanted != came):
        first, last = (int(lower[k]), int(y[k])), (int(upper[k]) - 1, int(y[k]))
        expected, got, who = int(wanted[k]), int(came[k]), int(record[k])
        place = f"pixel {first}" if first == last else f"pixels {first} to {last}"
        ours, theirs = (_times("covered", count, max(expected, got) > 1) for count in (expected, got))
        words = f"{place}: {theirs} by {name_of(records, who)}, {ours} expected"
        yield _at_pixel("scanline", "spans", expected, got, words, _parent(records, who), first)


def depth(records: Records, spans: NDArray[np.int32], a: NDArray[np.float32], b: NDArray[np.float32]) -> Iterator[Difference]:
    """Fragment by fragment of the spans."""
    fragments = np.flatnonzero(~same_bits(a, b))
    ends = np.cumsum(spans[:, 3] - spans[:, 2], dtype=np.int64)
    of_span = np.searchsorted(ends, fragments, side="right")
    for fragment, span in zip(fragments, of_span, strict=True):
        record, y, _, upper = spans[span].tolist()
        pixel = (upper - int(ends[span] - fragment), y)
        words = f"pixel {pixel}: {name_of(records, record)} at depth {text_of(b[fragment])}, {text_of(a[fragment])} expected"
        yield _at_pixel("depth", "depth", a[fragment], b[fragment], words, _parent(records, record), pixel)


def packed(stage: str, a: NDArray[np.int64], b: NDArray[np.int64]) -> Iterator[Difference]:
    """Pixel by pixel of two visibility buffers [H, W]."""
    for y, x in zip(*np.nonzero(a != b), strict=True):
        pixel, expected, got = (int(x), int(y)), int(a[y, x]), int(b[y, x])
        words = f"{_whereabouts(stage, pixel)}: {_fragment(got)}, {_fragment(expected)} expected"
        # The nearer of the two is the fault: it should not be there, or it should not be missing.
        yield _at_pixel(stage, "packed", expected, got, words, _triangle(min(expected, got)), pixel)


def depth_image(a: NDArray[np.float32], seen: NDArray[np.int64], b: NDArray[np.float32]) -> Iterator[Difference]:
    """Pixel by pixel of the depth images [H, W]; ``seen``: the visibility buffer that they belong to."""
    for y, x in zip(*np.nonzero(~same_bits(a, b)), strict=True):
        pixel, value = (int(x), int(y)), int(seen[y, x])
        words = f"{_whereabouts('rasterize', pixel)}: {_fragment(value)}, but {text_of(b[y, x])} in the depth image, "
        words += f"{text_of(a[y, x])} expected"
        yield _at_pixel("rasterize", "depth", a[y, x], b[y, x], words, _triangle(value), pixel)


def attributes(seen: NDArray[np.int64], a: NDArray[np.float32], b: NDArray[np.float32]) -> Iterator[Difference]:
    """Pixel by pixel of the barycentrics [H, W, 3] of the visibility buffer ``seen``."""
    rows, columns, _ = np.nonzero(~same_bits(a, b))
    for y, x in dict.fromkeys(zip(rows.tolist(), columns.tolist(), strict=True)):
        pixel, triangle = (int(x), int(y)), _triangle(int(seen[y, x]))
        who = "background" if triangle is None else f"triangle {triangle}"
        words = f"pixel {pixel}: {who} has the barycentrics {text_of(b[y, x])}, {text_of(a[y, x])} expected"
        yield _at_pixel("attributes", "barycentrics", _plain(a[y, x]), _plain(b[y, x]), words, triangle, pixel)


def name_of(records: Records, record: int) -> str:
    """The parent of a record, and which part of it the record is where it was cut into several."""
    triangle = _parent(records, record)
    if triangle is None:
        return f"record {record} (there are {len(records.triangle)})"
    first, end = (int(np.searchsorted(records.triangle, triangle, side)) for side in ("left", "right"))
    return f"triangle {triangle}" + (f" (part {record - first + 1} of {end - first})" if end - first > 1 else "")


def text_of(value: Any) -> str:
    """A value of NumPy's as a reader writes it; of floats the shortest digits that tell them from every other."""
    if isinstance(value, np.ndarray):
        return f"({', '.join(text_of(v) for v in value)})"
    if isinstance(value, np.bool_):
        return "clipped" if value else "not clipped"
    return str(value)


def _plain(value: Any) -> Any:
    """Rows as tuples, so that differences can be compared and hashed."""
    return tuple(value) if isinstance(value, np.ndarray) else value


def _equal(a: NDArray[Any], b: NDArray[Any]) -> bool:
    return a.shape == b.shape and bool((a == b).all())


def _counted(a: NDArray[Any], b: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    """The different rows [K, ...] of two arrays, how often each stands in a and in b, [K], and which of them each row is."""
    rows, place = _unique(np.concatenate([a, b]))
    of_a, of_b = np.split(place, [len(a)])
    return rows, np.bincount(of_a, minlength=len(rows)), np.bincount(of_b, minlength=len(rows)), of_a, of_b


def _unique(values: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """The different rows of [N] or [N, D], sorted, and which of them each row is. np.unique takes minutes for millions."""
    columns = values.reshape(len(values), values.shape[1] if values.ndim > 1 else 1)
    order = np.lexsort(columns.T[::-1])
    ordered = columns[order]
    new = np.ones(len(ordered), np.bool_)
    new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    place = np.empty(len(ordered), np.int64)
    place[order] = np.cumsum(new) - 1
    return values[order[new]], place


def _coverage(a: NDArray[np.int32], b: NDArray[np.int32]) -> tuple[NDArray[np.int64], ...]:
    """(record, y, lower, upper, wanted, came) [P] each: pieces of rows, and how many spans of a and of b lie over each."""
    spans = np.concatenate([a, b]).astype(np.int64)
    step = np.repeat(np.eye(2, dtype=np.int64), [len(a), len(b)], axis=0)  # [S, 2]: of which side the span is
    ends = np.concatenate([spans[:, [0, 1, 2]], spans[:, [0, 1, 3]]])
    places, at = _unique(ends)
    change = np.zeros((len(places), 2), np.int64)
    np.add.at(change, at, np.concatenate([step, -step]))
    # Where a span ends and another of the same side begins, nothing changes: such pieces become one.
    changes = change.any(axis=1)
    record, y, x = places[changes].T
    wanted, came = np.cumsum(change[changes], axis=0).T
    # A row's last count is 0 on both sides, so no piece reaches into the next row.
    return record, y, x, np.append(x[1:], 0), wanted, came


def _of_field(name: str, records: Records, record: int, a: NDArray[Any], b: NDArray[Any]) -> Iterator[Difference]:
    """What differs in a field of one record: vertex by vertex where the field has a value for each."""
    lead, unit = _FIELDS[name]
    if name == "corner" and records.clipped[record]:
        lead = lead.replace("vertex", "slot")  # of a clipped record it is the slots that are corners
    by_vertex = [(k, a[k], b[k]) for k in range(3)] if "{}" in lead else [(0, a, b)]
    for k, expected, got in by_vertex:
        if not same_bits(np.atleast_1d(expected), np.atleast_1d(got)).all():
            words = f"{name_of(records, record)}: {lead.format(k)}{text_of(got)}{unit}, {text_of(expected)} expected"
            yield Difference("setup", name, _plain(expected), _plain(got), words, int(records.triangle[record]))


def _at_pixel(
    stage: str, what: str, expected: Any, got: Any, words: str, triangle: int | None, pixel: tuple[int, int]
) -> Difference:
    column_row, tile = _bin_and_tile(pixel)
    return Difference(stage, what, expected, got, words, triangle, column_row, tile, pixel)


def _bin_and_tile(pixel: tuple[int, int]) -> tuple[tuple[int, int], tuple[int, int]]:
    x, y = pixel
    return (x // BIN, y // BIN), (x % BIN // TILE, y % BIN // TILE)


def _whereabouts(stage: str, pixel: tuple[int, int]) -> str:
    """The pixel; of the whole, whose schedule goes by bins and tiles, these too."""
    column_row, tile = _bin_and_tile(pixel)
    return f"pixel {pixel}" + (f" in tile {tile} of bin {column_row}" if stage == "rasterize" else "")


def _parent(records: Records, record: int) -> int | None:
    return int(records.triangle[record]) if 0 <= record < len(records.triangle) else None


def _triangle(value: int) -> int | None:
    return None if value == BACKGROUND else value & 0xFFFFFFFF


def _fragment(value: int) -> str:
    """What a packed value says."""
    if value == BACKGROUND:
        return "background"
    z = np.array(value >> 32, np.int32).view(np.float32)[()]
    if not z >= 0 or np.signbit(z) or value & 0x80000000:
        return f"{value & (2**64 - 1):#018x} (no triangle with a depth)"
    return f"triangle {value & 0xFFFFFFFF} at depth {text_of(z)}"


def _records(count: int) -> str:
    return {0: "no record", 1: "1 record"}.get(count, f"{count} records")


def _times(word: str, count: int, once: bool) -> str:
    """``once``: whether to say so of a count of 1, because the other count is higher."""
    return {0: f"not {word}", 1: f"{word} once" if once else word, 2: f"{word} twice"}.get(count, f"{word} {count} times")


def _listed(candidates: int, kept: int, once: bool) -> str:
    """What a record's bin is, listed so many times and kept in so many of them."""
    if not candidates:
        return "not a candidate"
    if 0 < kept < candidates:
        return f"{_times('kept', kept, once)} and {_times('rejected', candidates - kept, once)}"
    return _times("kept" if kept else "rejected", candidates, once)


def _tile_state(touched: int, full: int) -> str:
    return ("full" if touched else "full but not touched") if full else ("touched" if touched else "not touched")

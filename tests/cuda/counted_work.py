"""What CUDA kernels that count have to find beside records, entries and fragments: the reference's numbers where they do what its
model does, else those of its stages in the order of the kernels; and bounds on what depends on the order of fragments."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from cases import Case
from numpy.typing import NDArray

import bigtri
from bigtri import native, reference
from bigtri.check.counters import count
from bigtri.precision import EXACT
from bigtri.reference.coverage import fills, sides_of, touches
from bigtri.reference.depth import bound_depth
from bigtri.reference.numerics import BIN, TILE, edges_of
from bigtri.reference.records import Records
from bigtri.reference.work import NO_QUEUE, boxed_tiles, extent, in_bins, squares_in_boxes, without_empty

Model = Mapping[str, int]
Numbers = NDArray[np.int64]
_REGION = 16  # px; kRegion of csrc/cuda/region.cuh
_WIDE_BIN = 128  # px; kWideBin of csrc/cuda/tile_queues.cu
_PAIR_BYTES, _SLOT_BYTES = 8, 4  # what a queue of pairs, and a list of slots of records, has of each element
_MEETING = 9  # edge values of meet() of csrc/cuda/fragment.cuh
_TOGETHER, _WARP = 256, 32  # entries of a bin that a block of csrc/cuda/persistent.cu draws together, of a patch that a warp does
_ROW_EXTENT = 512  # px; kRowExtent of csrc/cuda/rows.cuh
_BOX, _BOX_EXTENT = 8, 32  # px; kBoxSide and kSmallExtent of csrc/cuda/small.cuh
_SLIVER_LINES, _SLIVER_WIDTH = 64, 4  # px; kSliverLines and kSliverWidth of csrc/cuda/sliver.cuh
_SLIVER_STEEPEST = 256  # kSteepest there
_COMMON, _COMMON_BYTES = 64, 12  # records that all bins look at anyway; of each a box, a view and a slot. csrc/cuda/lists.cuh
_WAITING_WARPS, _WAITING_ROWS = 8, 32  # WaitingPatch of csrc/cuda/bin_owned.cu; rows in px


class _Tested:
    """Squares of ``size`` px that were tested against the edges of records, and what the test says of each."""

    def __init__(self, records: Records, record: Numbers, x: Numbers, y: Numbers, size: int) -> None:
        self.record, self.x, self.y, self.size = record, x, y, size
        sides = sides_of(records, record, EXACT)
        self.kept, self.full = touches(sides, x, y, size), fills(sides, x, y, size)
        x0, y0, x1, y1 = records.bbox[record].astype(np.int64).T
        self.boxed = (x < x1) & (x + size > x0) & (y < y1) & (y + size > y0)
        self.inside = (x >= x0) & (x + size <= x1) & (y >= y0) & (y + size <= y1)

    def parts(self, records: Records, which: NDArray[np.bool_], size: int) -> _Tested:
        """The squares of ``size`` px that those are cut into, tested."""
        places = size * np.arange(self.size // size)
        y, x = (np.ravel(place)[None] for place in np.meshgrid(places, places, indexing="ij"))
        record = np.repeat(self.record[which], x.size)
        return _Tested(records, record, (self.x[which, None] + x).ravel(), (self.y[which, None] + y).ravel(), size)

    def seen(self, records: Records, bound: NDArray[np.float32] | None = None) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
        """Which of them no edge rejects and lie neither behind a record that fills the square nor behind a ``bound`` of each; and
        how far that is."""
        nearest, farthest = (
            bound_depth(records, np.stack([self.record, self.x, self.y], 1), self.size, farthest) for farthest in (False, True)
        )
        hides = self.full & (records.z[self.record].max(axis=1) <= 1)
        places, of = np.unique(np.stack([self.x, self.y], 1), axis=0, return_inverse=True)
        nearest_of_place = np.full(len(places), np.inf, np.float32)
        np.minimum.at(nearest_of_place, of.reshape(-1)[hides], farthest[hides])
        behind = nearest_of_place[of.reshape(-1)]
        behind = behind if bound is None else np.minimum(behind, bound)
        return self.kept & (nearest <= behind), behind

    def counted(self, kind: str, which: NDArray[np.bool_] | None = None) -> dict[str, int]:
        kept, full = (self.kept, self.full) if which is None else (self.kept[which], self.full[which])
        return {
            f"{kind}_tested": len(kept),
            f"{kind}_rejected": int((~kept).sum()),
            f"{kind}_accepted": int(full.sum()),
        }


def _in_boxes(records: Records, size: int) -> _Tested:
    return _Tested(records, *squares_in_boxes(records.bbox, size), size)


def _sum(*counted: Model) -> dict[str, int]:
    return {name: sum(counts.get(name, 0) for counts in counted) for name in set().union(*counted)}


def _listed(squares: _Tested, times: int = 1) -> dict[str, int]:
    """Of squares that records are listed by, tested ``times`` times, each time with an atomic addition for those listed."""
    return {
        "bins_tested": times * len(squares.kept),
        "bins_rejected": times * int((~squares.kept).sum()),
        "edges_64": times * 3 * len(squares.kept),
        "atomics": times * int(squares.kept.sum()),
        "bytes": _SLOT_BYTES * int(squares.kept.sum()),
    }


def scanline(case: Case, _: Records) -> Model:
    """All that the model of the CPU's has of rows and edge values."""
    model = count(*case, variant="scanline", backend="reference")
    return {"rows": model["rows"], "edges_64": model["edges_64"]}


def batched(case: Case, _: Records) -> Model:
    """Three edge values for each pixel of the bounding boxes, as in the model; but in 64 bits all of them."""
    model = count(*case, variant="batched", backend="reference")
    return {"edges_64": model.get("edges_64", 0) + model.get("edges_32", 0), "edges_32": 0, "wide": 0}


def recursive_descent(_: Case, records: Records, separate: bool = True) -> Model:
    """Bins twice, when they are queued and when they are drawn; below them squares of 16 and 4 px, beginning with the one that
    the record's part of the bin lies in."""
    bins = _in_boxes(records, BIN)
    queued = bins.kept
    x0, y0 = np.maximum(records.bbox[bins.record, :2], np.stack([bins.x, bins.y], 1)).T.astype(np.int64)
    x1, y1 = np.minimum(records.bbox[bins.record, 2:] - 1, np.stack([bins.x, bins.y], 1) + BIN - 1).T.astype(np.int64)
    apart = (x0 ^ x1) | (y0 ^ y1)
    coarse = bins.parts(records, queued & (apart >= _REGION), _REGION)
    one = queued & (apart < _REGION) & (apart >= 4)
    below = coarse.kept & (coarse.boxed | (not separate)) & ~(coarse.full & coarse.inside)
    owner = np.concatenate([coarse.record[below], bins.record[one]])
    x, y = (np.concatenate([place[below], own[one] & -_REGION]) for place, own in ((coarse.x, x0), (coarse.y, y0)))
    fine = _Tested(records, owner, x, y, _REGION).parts(records, np.ones(len(owner), np.bool_), 4)
    partly = fine.kept & (fine.boxed | (not separate)) & ~(fine.full & fine.inside)
    blocks = int(partly.sum()) + int((queued & (apart < 4)).sum())  # of 4x4 px, whose pixels are tested
    separated = int((coarse.kept & ~coarse.boxed).sum()) + int((fine.kept & ~fine.boxed).sum())
    return {
        "bytes": _PAIR_BYTES * int(queued.sum()),
        "candidates": len(queued),
        "bins_tested": len(queued) + int(queued.sum()),
        "bins_rejected": int((~queued).sum()),
        "edges_64": 3 * (len(queued) + int(queued.sum())),
        "edges_32": 6 * (len(coarse.kept) + len(fine.kept)) + 3 * 16 * blocks,
        "separations": separate * (int(coarse.kept.sum()) + int(fine.kept.sum())),
        "tiles_separated": separate * separated,
        **_sum(coarse.counted("tiles"), fine.counted("tiles")),
    }


def _drawn_by_regions(case: Case, records: Records, listed: _Tested, sizes: Numbers) -> Model:
    """Of squares of ``sizes`` px in lists, each region of the image that reads the list; every pixel of it is stored."""
    height, width = case.resolution
    end_x, end_y = (-(-size // _REGION) * _REGION for size in (width, height))
    x, y, size = listed.x[listed.kept], listed.y[listed.kept], sizes[listed.kept]
    of, left, top = squares_in_boxes(np.stack([x, y, np.minimum(x + size, end_x), np.minimum(y + size, end_y)], 1), _REGION)
    regions = _Tested(records, listed.record[listed.kept][of], left, top, _REGION)
    return {
        **regions.counted("tiles"),
        "edges_64": _MEETING * len(of),
        "edges_32": 3 * _REGION * _REGION * int((regions.kept & ~regions.full).sum()),
        "written": width * height,
    }


def hierarchical_tiles(case: Case, records: Records) -> Model:
    """With its standard parameters: tiles of 16 px and up, and a record at the first level at which it meets four at most."""
    levels = range(next(n for n in range(1, 12) if _REGION << (n - 1) >= max(case.resolution)))
    x0, y0, x1, y1 = records.bbox.astype(np.int64).T
    met = np.stack([((x1 - 1) // s - x0 // s + 1) * ((y1 - 1) // s - y0 // s + 1) for s in (_REGION << i for i in levels)])
    met[-1] = 0
    level = (met <= 4).argmax(axis=0)
    found: list[Model] = []
    for i in levels:
        size = _REGION << i
        of, x, y = squares_in_boxes(records.bbox[level == i], size)
        here = _Tested(records, np.flatnonzero(level == i)[of], x, y, size)
        found += [_listed(here), _drawn_by_regions(case, records, here, np.full(len(x), size))]
    return {**_sum(*found), "written": case.resolution[0] * case.resolution[1]}


def tile_owned(case: Case, records: Records) -> Model:
    """The squares of a record are tested when lists are measured and when they are filled."""
    tiles = _in_boxes(records, _REGION)
    return _sum(_listed(tiles, 2), _drawn_by_regions(case, records, tiles, np.full(len(tiles.x), _REGION)))


def _tiles_in_cells(records: Records) -> tuple[int, _Tested]:
    """How many tiles of 8 px of cells of 64 px that no edge rejects the records' boxes meet; and those that no edge rejects."""
    cells, tiles = _in_boxes(records, BIN), _in_boxes(records, TILE)
    kept = cells.kept
    boxed = boxed_tiles(records.bbox[cells.record[kept]], cells.x[kept] // BIN, cells.y[kept] // BIN)
    return int(boxed.sum()), tiles


def tile_queues(_: Case, records: Records) -> Model:
    """Tiles are cells of 64 px, four in each bin that a record is queued for, and in these tiles of 8 px."""
    bins = _in_boxes(records, _WIDE_BIN)
    cells = bins.parts(records, bins.kept, BIN)
    boxed, tiles = _tiles_in_cells(records)
    queued = int(tiles.kept.sum())
    of_tiles = {"tiles_tested": boxed, "tiles_rejected": boxed - queued, "edges_32": 3 * boxed + 3 * TILE * TILE * queued}
    return _sum(_listed(bins), cells.counted("tiles"), of_tiles, {"edges_64": _MEETING * len(cells.kept)})


def coverage_masks(case: Case, records: Records) -> Model:
    """Bins twice, when records are queued and when they are drawn; the tiles of these; and every pixel of a bin with a queue."""
    bins = _in_boxes(records, BIN)
    queued, full = int(bins.kept.sum()), int(bins.full.sum())
    boxed, tiles = _tiles_in_cells(records)
    touched, filled = int(tiles.kept.sum()), int(tiles.full.sum())
    x, y = np.unique(np.stack([bins.x, bins.y])[:, bins.kept], axis=1)
    height, width = case.resolution
    return _sum(
        _listed(bins),
        {"bins_tested": queued, "bins_accepted": full, "edges_64": _MEETING * queued},
        {"tiles_tested": boxed, "tiles_rejected": boxed - touched, "tiles_accepted": filled},
        {"edges_32": 3 * boxed + 3 * touched + 3 * TILE * TILE * (touched - filled)},
        {"written": int((np.minimum(BIN, width - x) * np.minimum(BIN, height - y)).sum())},
    )


def two_stage(_: Case, records: Records) -> Model:
    """Of records that are not drawn by rows: bins when they are queued and when they are drawn, and the tiles of these."""
    bins = _in_boxes(records, BIN)
    queued = int(bins.kept.sum())
    boxed, tiles = _tiles_in_cells(records)
    touched, partly = int(tiles.kept.sum()), tiles.kept & ~tiles.full
    place = np.stack([tiles.x, tiles.y], 1)[partly] // TILE
    x0, y0, x1, y1 = in_bins(records.bbox[tiles.record[partly]], place, TILE).T
    return {
        "bytes": _PAIR_BYTES * queued,
        "candidates": len(bins.kept),
        "entries": queued,
        "bins_tested": len(bins.kept) + queued,
        "bins_rejected": len(bins.kept) - queued,
        "tiles_tested": boxed,
        "tiles_rejected": boxed - touched,
        "tiles_accepted": touched - int(partly.sum()),
        "edges_64": 3 * (len(bins.kept) + queued),
        "edges_32": 6 * (BIN // TILE) ** 2 * queued + 3 * int(((x1 - x0) * (y1 - y0)).sum()),
    }


# What each variant does of a case without early reject and by no rows, and if nothing overflows.
SAME: dict[str, Callable[[Case, Records], Model]] = {
    "two_stage": two_stage,
    "scanline": scanline,
    "batched": batched,
    "recursive_descent": recursive_descent,
    "hierarchical_tiles": hierarchical_tiles,
    "tile_queues": tile_queues,
    "coverage_masks": coverage_masks,
    "tile_owned": tile_owned,
}
BY_ROWS = ("scanline", "batched")  # they queue nothing
BY_ATOMICS = (*BY_ROWS, "recursive_descent", "two_stage")  # a fragment is an atomic minimum on the image


def check(variant: str, counted: Model, case: Case, record_bytes: int) -> None:
    """Of what a variant has counted of a case, with ``early_z`` and ``rows`` 0 and without overflows. record_bytes: of one that
    is queued."""
    records = records_of(case)
    wanted = _sum(SAME[variant](case, records), {"bytes": record_bytes * len(records.xy) * (variant not in BY_ROWS)})
    of = _all(counted)
    assert wanted == {name: of[name] for name in wanted}, variant
    check_order(variant, counted, case)


def check_order(variant: str, counted: Model, case: Case, views: int = 1) -> None:
    """Bounds on what depends on the order of fragments, of so many ``views`` that show the same."""
    covered = views * int((bigtri.rasterize(*case).triangle >= 0).sum())
    assert 0 < covered <= counted["passed"] <= counted["fragments"], variant
    if variant in BY_ATOMICS:
        assert counted["passed"] == counted["written"] <= counted["atomics"] <= counted["fragments"], variant
    if variant == "tile_queues":
        assert covered <= counted["written"] <= counted["passed"]
    if variant in BY_ROWS:
        assert counted["atomics"] == counted["fragments"], variant


def check_persistent(counted: Model, case: Case, record_bytes: int) -> None:
    """Of what ``persistent`` has counted of a case, without overflows: what lies behind something that covers all of a bin is
    hidden. If no bin has more entries than are drawn together, that depends on nothing either."""
    records = records_of(case)
    bins = _in_boxes(records, BIN)
    queued = int(bins.kept.sum())
    wanted = {
        "bytes": record_bytes * len(records.xy) + _SLOT_BYTES * queued,
        "candidates": len(bins.kept),
        "entries": queued,
        "bins_tested": len(bins.kept) + queued,
        "bins_rejected": len(bins.kept) - queued,
        "bins_accepted": int(bins.full.sum()),
        "edges_64": 3 * len(bins.kept) + _MEETING * queued,
    }
    of = _all(counted)
    assert wanted == {name: of[name] for name in wanted}
    # The rows of tiles that an entry's box meets, of eight tiles each.
    x, y = bins.x[bins.kept], bins.y[bins.kept]
    _, y0, _, y1 = in_bins(records.bbox[bins.record[bins.kept]], np.stack([x, y], 1) // BIN, BIN).T
    entry, left, top = squares_in_boxes(np.stack([x, y0, x + BIN, y1], 1), TILE)
    tiles = _Tested(records, bins.record[bins.kept][entry], left, top, TILE)
    seen = bins.seen(records)[0][bins.kept]
    least, most = (
        {**tiles.counted("tiles", seen[entry]), "bins_hidden": 0},
        {**tiles.counted("tiles"), "bins_hidden": int((~seen).sum())},
    )
    if _most_of_a_square(x, y) <= _TOGETHER:
        least["bins_hidden"] = most["bins_hidden"]
        most |= tiles.counted("tiles", seen[entry])
    assert all(least[name] <= of[name] <= most[name] for name in least)
    assert of["edges_32"] == 6 * of["tiles_tested"] + 3 * TILE * TILE * (of["tiles_tested"] - of["tiles_rejected"])


def _most_of_a_square(x: Numbers, y: Numbers) -> int:
    return int(np.unique(np.stack([x, y]), axis=1, return_counts=True)[1].max(initial=0))


class Rows(NamedTuple):
    """Of records that are drawn by rows, and their edge values. A box that reaches over cells has rows in each; as many rows are
    looked at as fill these up to a power of two."""

    least: tuple[int, int]  # rows, edge values
    most: tuple[int, int]
    alone: tuple[int, int]  # where none is drawn by boxes of 8x8 px

    @classmethod
    def of(cls, records: Records) -> Rows:
        x0, y0, x1, y1 = records.bbox.astype(np.int64).T
        height, more = y1 - y0, (x1 - 1) // BIN - x0 // BIN
        rows, edges = height * (more + 1), 3 * (height << np.ceil(np.log2(more + 1)).astype(np.int64))
        # Where most of a warp's records fit boxes, their rows reach over cells, and four at a time are looked at.
        boxed = (x1 - x0 <= _BOX) & (height <= _BOX) & (extent(records) <= _BOX_EXTENT * EXACT.subpixel)
        other = np.where(boxed, height, rows), np.where(boxed, 12 * -(-height // 4), edges)
        bounds = ((int(of(a, b).sum()) for a, b in zip((rows, edges), other, strict=True)) for of in (np.minimum, np.maximum))
        return cls(*(tuple(bound) for bound in bounds), (int(rows.sum()), int(edges.sum())))


def fits_rows(records: Records, widest: int) -> NDArray[np.bool_]:
    """bool [N]: which records are drawn by rows or boxes, if none may have a side of more px than ``widest``."""
    sides = records.bbox[:, 2:] - records.bbox[:, :2]
    return (sides <= widest).all(axis=1) & (extent(records) <= _ROW_EXTENT * EXACT.subpixel)


def chosen(records: Records, which: NDArray[np.bool_]) -> Records:
    return Records(*(field if field is None else field[which] for field in records))


def _are_slivers(records: Records) -> NDArray[np.bool_]:
    sides = records.bbox[:, 2:] - records.bbox[:, :2]
    thin = records.area <= 2 * _SLIVER_WIDTH * EXACT.subpixel * extent(records).astype(np.int64)
    return (sides.max(axis=1, initial=0) >= _SLIVER_LINES) & thin


def _are_wide(slivers: Records) -> NDArray[np.bool_]:
    """bool [N]: which have columns for lines, and not rows."""
    spans = slivers.xy.max(axis=1) - slivers.xy.min(axis=1)
    wide: NDArray[np.bool_] = spans[:, 0] >= spans[:, 1]
    return wide


def _lines(slivers: Records) -> int:
    x0, y0, x1, y1 = slivers.bbox.astype(np.int64).T
    return int(np.where(_are_wide(slivers), x1 - x0, y1 - y0).sum())


def _pixels_tested(slivers: Records) -> tuple[int, int]:
    """The fewest, and the most, that are tested one by one: covered ones of slivers of which some edge has no exact crossings
    with lines, and all pixels of boxes."""
    edges, wide = edges_of(slivers.xy), _are_wide(slivers)[:, None]
    step, to_next = (np.abs(np.where(wide, *pair)) for pair in ((edges.dx, edges.dy), (edges.dy, edges.dx)))
    inexact = ((step == 0) | (_SLIVER_STEEPEST * step.astype(np.int64) < to_next)).any(axis=1)
    spans = reference.scanline(slivers, *NO_QUEUE, np.flatnonzero(inexact).astype(np.int32))
    x0, y0, x1, y1 = slivers.bbox.astype(np.int64).T
    return int((spans[:, 3] - spans[:, 2]).sum(dtype=np.int64)), int(((x1 - x0) * (y1 - y0)).sum())


def _patches(case: Case, squares: _Tested, rows: int) -> Numbers:
    """int64 [N]: patches of so many rows of the image that lie in each bin."""
    return -(-np.minimum(BIN, case.resolution[0] - squares.y) // rows)


def check_few(counted: Model, case: Case, records: Records, warps: int, height: int) -> None:
    """Of what ``bin_owned`` has counted where blocks set up all triangles by themselves; their regions have ``height`` rows."""
    bins = _in_boxes(records, BIN)
    tested = int(_patches(case, bins, warps // 4 * height).sum())
    of = _all(counted)
    # What finds no room is looked at once more.
    assert of["bins_tested"] == tested + of["overflows"]
    assert of["bins_tested"] - of["bins_rejected"] == of["entries"] + of["bins_hidden"] + of["overflows"]
    assert of["bins_accepted"] + of["bins_rejected"] <= of["bins_tested"]
    assert of["edges_64"] == _MEETING * of["bins_tested"]
    assert of["bytes"] == 0
    # Those of patches that small triangles are drawn onto by rows.
    assert of["rows"] <= warps // 4 * height * of["entries"]
    _check_regions(of, of["edges_32"] - 3 * of["rows"], of["entries"], warps, height)


def _check_regions(of: Model, edges: int, entries: int, warps: int, height: int) -> None:
    # An entry that fills a patch and is alone there is drawn without a test.
    assert of["tiles_tested"] <= warps * entries
    drawn = of["tiles_tested"] - of["tiles_rejected"] - of["tiles_hidden"]
    partly, rest = divmod(edges - 6 * of["tiles_tested"], 3 * _REGION * height)
    assert rest == 0 and max(0, drawn - of["tiles_accepted"]) <= partly <= drawn


def few_in_squares(records: Records) -> Model | None:
    """Of what ``bin_owned`` counts where patches have 64 rows and regions 16; None where that depends on the order of entries, or
    on whether one that fills a patch and is alone there can be drawn without a test."""
    bins = _in_boxes(records, BIN)
    gathered, bound = bins.seen(records)
    _, patch, length = np.unique(np.stack([bins.x, bins.y])[:, gathered], axis=1, return_inverse=True, return_counts=True)
    alone = bins.full[gathered] & (length[patch.reshape(-1)] == 1)
    if length.max(initial=0) > _WARP or alone.any():
        return None
    regions = bins.parts(records, gathered, _REGION)
    drawn, _ = regions.seen(records, np.repeat(bound[gathered], (BIN // _REGION) ** 2))
    return {
        **bins.counted("bins"),
        "bins_hidden": int((bins.kept & ~gathered).sum()),
        "entries": int(gathered.sum()),
        "edges_64": _MEETING * len(bins.kept),
        **regions.counted("tiles"),
        "tiles_hidden": int((regions.kept & ~drawn).sum()),
        "edges_32": 6 * len(drawn) + 3 * _REGION * _REGION * int((drawn & ~regions.full).sum()),
    }


def check_rows(variant: str, counted: Model, case: Case, every: Records, widest: int, together: bool, record_bytes: int) -> None:
    """Of what ``two_stage`` and ``bin_owned`` have counted where records are drawn by rows, if no list overflows.

    Args:
        every: the records that set-up makes, those that cover nothing among them.
        widest: px, the parameter.
        together: whether blocks draw their triangles together, and so none by boxes.
        record_bytes: of one that waits.
    """
    of, fits = _all(counted), fits_rows(every, widest)
    rows, waiting = Rows.of(chosen(every, fits)), chosen(every, ~fits)
    assert (of["by_rows"], of["by_tiles"]) == (fits.sum(), (~fits).sum())
    of["bytes"] -= record_bytes * len(waiting.xy)
    fewest, most = (rows.alone, rows.alone) if together else (rows.least, rows.most)
    if variant == "two_stage":
        wanted = two_stage(case, waiting)
        of["edges_32"] -= wanted["edges_32"]
        assert {**wanted, "edges_32": of["edges_32"]} == {name: of[name] for name in wanted}
        assert all(low <= n <= high for low, n, high in zip(fewest, (of["rows"], of["edges_32"]), most, strict=True))
        return
    thin = _are_slivers(waiting)
    slivers = chosen(waiting, thin)
    assert fewest[0] <= of["rows"] - _lines(slivers) <= most[0]
    gathered = _check_waiting(of, case, chosen(waiting, ~thin), slivers)
    if together:
        _check_regions(of, of["edges_32"] - rows.alone[1], gathered, _WAITING_WARPS, _REGION)
    else:
        assert rows.least[1] + 6 * of["tiles_tested"] <= of["edges_32"]


def _check_waiting(of: Model, case: Case, large: Records, slivers: Records) -> int:
    """How many entries blocks of ``bin_owned`` have gathered of what waits for them; bytes: of lists alone."""
    bins, records = _in_boxes(large, BIN), len(large.xy)
    # Of those that are not slivers all bins look at some: where there are few, at each of them.
    common = of["entries"] + of["bins_hidden"] + of["overflows"] - (of["bins_tested"] - of["bins_rejected"])
    assert min(records, _COMMON) <= common <= records
    listed, rest = divmod(of["bytes"] - _COMMON_BYTES * common, _SLOT_BYTES)
    kept = np.sort(np.bincount(bins.record, bins.kept, records))
    assert rest == 0 and kept[: records - common].sum() <= listed <= kept[common:].sum()
    patches = _patches(case, bins, _WAITING_ROWS)
    by_all, by_list = (np.bincount(bins.record, n, records) for n in (patches, 1 + patches * bins.kept))
    lowest, highest = (by_all, by_all) if records <= _COMMON else (np.minimum(by_all, by_list), np.maximum(by_all, by_list))
    assert lowest.sum() <= of["bins_tested"] - of["overflows"] <= highest.sum()
    # Three edge values of each band of a sliver, and of each pixel of a line whose crossings are not exact. Where bins are tested
    # for lists three are asked, and not nine.
    of_slivers, in_lists = of["edges_64"] - _MEETING * of["bins_tested"], len(bins.kept) * (records > _COMMON)
    fewest, most = _pixels_tested(slivers)
    assert of_slivers % 3 == 0
    assert 3 * (len(slivers.xy) + fewest) - (_MEETING - 3) * in_lists <= of_slivers <= 3 * (2 * len(slivers.xy) + most)
    return of["entries"] - common - listed


def _all(counted: Model) -> dict[str, int]:
    """Those that are 0 too, which ``count`` leaves out."""
    return {**dict.fromkeys(native.COUNTERS, 0), **counted}


def records_of(case: Case) -> Records:
    """Those that set-up makes."""
    return without_empty(reference.setup(case.positions, case.triangles, *case.resolution)[0], EXACT)


def passed_in_order(case: Case) -> int:
    """Fragments nearer than what their pixel holds where triangles are drawn one after the other."""
    return count(*case, variant="scanline", backend="reference")["passed"]

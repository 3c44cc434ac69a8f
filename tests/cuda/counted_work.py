"""What CUDA kernels that count have to find beside records, entries and fragments: the reference's numbers where they do what its
model does, else those of its stages in the order of the kernels; and bounds on what depends on the order of fragments."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from cases import Case
from numpy.typing import NDArray

import bigtri
from bigtri import reference
from bigtri.check.counters import count
from bigtri.precision import EXACT
from bigtri.reference.coverage import fills, sides_of, touches
from bigtri.reference.numerics import BIN, TILE
from bigtri.reference.records import Records
from bigtri.reference.work import boxed_tiles, squares_in_boxes, without_empty

Model = Mapping[str, int]
Numbers = NDArray[np.int64]
_REGION = 16  # px; kRegion of csrc/cuda/region.cuh
_WIDE_BIN = 128  # px; kWideBin of csrc/cuda/tile_queues.cu
_PAIR_BYTES, _SLOT_BYTES = 8, 4  # what a queue of pairs, and a list of slots of records, has of each element
_MEETING = 9  # edge values of meet() of csrc/cuda/fragment.cuh


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

    def counted(self, kind: str) -> dict[str, int]:
        return {
            f"{kind}_tested": len(self.kept),
            f"{kind}_rejected": int((~self.kept).sum()),
            f"{kind}_accepted": int(self.full.sum()),
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


# What each variant does of a case without early reject, and if nothing overflows.
SAME: dict[str, Callable[[Case, Records], Model]] = {
    "scanline": scanline,
    "batched": batched,
    "recursive_descent": recursive_descent,
    "hierarchical_tiles": hierarchical_tiles,
    "tile_queues": tile_queues,
    "coverage_masks": coverage_masks,
    "tile_owned": tile_owned,
}
BY_ROWS = ("scanline", "batched")  # they queue nothing
BY_ATOMICS = (*BY_ROWS, "recursive_descent")  # a fragment is an atomic minimum on the image
PASSED = (*BY_ATOMICS, "tile_queues", "coverage_masks")  # that count it


def check(variant: str, counted: Model, case: Case, record_bytes: int) -> None:
    """Of what a variant has counted of a case, with ``early_z`` 0 and without overflows. record_bytes: of one that is queued."""
    records = records_of(case)
    wanted = _sum(SAME[variant](case, records), {"bytes": record_bytes * len(records.xy) * (variant not in BY_ROWS)})
    assert wanted == {name: counted.get(name, 0) for name in wanted}, variant
    if variant not in PASSED:
        return
    covered = int((bigtri.rasterize(*case).triangle >= 0).sum())
    assert 0 < covered <= counted["passed"] <= counted["fragments"], variant
    if variant in BY_ATOMICS:
        assert counted["passed"] == counted["written"] <= counted["atomics"] <= counted["fragments"], variant
    if variant == "tile_queues":
        assert covered <= counted["written"] <= counted["passed"]
    if variant in BY_ROWS:
        assert counted["atomics"] == counted["fragments"], variant


def records_of(case: Case) -> Records:
    """Those that set-up makes."""
    return without_empty(reference.setup(case.positions, case.triangles, *case.resolution)[0], EXACT)


def passed_in_order(case: Case) -> int:
    """Fragments nearer than what their pixel holds where triangles are drawn one after the other."""
    return count(*case, variant="scanline", backend="reference")["passed"]

"""The work of csrc/cpu/tile_owned.cpp: a list for each tile of 16 px, drawn with bounds of depth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..binning import binning
from ..coverage import is_inside, sides_of
from ..depth import bound_depth, depth
from ..numerics import BIN, TILE, TILES
from ..pipeline import ROWS, batches
from ..tile_mask import tile_mask
from ..work import Job, Pixels, boxed_tiles, check_one_round, load, pack, record_bytes, sums_by

STANDARD = {"share": 256, "tiles": 16}  # of the variant's parameters
REJECTS_BY_DEPTH = ""  # it does, by bounds that are gathered before anything is drawn
OWNS_PIXELS = True
_OWNED = 16  # px; kOwnedTile of csrc/cpu/tile_owned.h
_ENTRY_BYTES = 16 + 8  # a pair, and its place in the tile's list


def count(job: Job) -> dict[str, int]:
    """Records, the bins that no edge rejects, the quads of 8 px that they touch, and what is drawn of these.

    Raises:
        ValueError: the view's records are not all set up at once.
    """
    check_one_round(job)
    records = job.records
    bins = binning(records, -1, job.arithmetic)
    queue = bins.candidates[bins.kept]
    boxed = boxed_tiles(records.bbox[queue[:, 0]], *queue[:, 1:].T)
    touched, full = tile_mask(records, queue, job.arithmetic)
    entry, bit = np.nonzero(touched[:, None] >> np.arange(TILES * TILES) & 1)
    place = queue[entry].astype(np.int64)  # of the quads: record, x, y of the first pixel
    place[:, 1] = BIN * place[:, 1] + TILE * (bit % TILES)
    place[:, 2] = BIN * place[:, 2] + TILE * (bit // TILES)
    filled = (full[entry] >> bit & 1).astype(np.bool_)

    tile = place[:, 2] // _OWNED * (-(-job.width // _OWNED)) + place[:, 1] // _OWNED
    of_list, hidden, quad_hidden = _hidden(job, place, filled, tile)
    seen = ~hidden & ~quad_hidden
    covered, passed = _drawn(job, place[seen], filled[seen])
    partly = ~filled[seen]
    edges_32 = 3 * TILE * TILE * partly
    quads_32 = job.places.add_edges(edges_32, *place[seen, 1:].T)
    bins_64, bins_32 = (job.places.add_bins(n, queue) for n in (3, 6 * TILES * TILES))
    entries = len(np.unique(of_list))
    return {
        "records": len(records.xy),
        "by_tiles": len(records.xy),
        "candidates": len(bins.kept),
        "entries": entries,
        "bytes": record_bytes(job.arithmetic) * len(records.xy) + _ENTRY_BYTES * entries,
        "bins_tested": len(bins.kept),
        "bins_rejected": len(bins.kept) - len(queue),
        "bins_hidden": len(np.unique(of_list[hidden])),
        "tiles_tested": int(boxed.sum()),
        "tiles_rejected": int(boxed.sum()) - len(place),
        "tiles_accepted": int(filled.sum()),
        "tiles_empty": int((covered == 0).sum()),
        "tiles_hidden": int((quad_hidden & ~hidden).sum()),
        "edges_64": job.places.add_bins(3, bins.candidates) + bins_64,
        "edges_32": bins_32 + quads_32,
        "fragments": int(covered.sum()),
        "passed": passed,
        "written": job.width * job.height,
        "atomics": 2 * entries,
        **load(job, sums_by(tile[seen] // job.parameters["tiles"], edges_32 + covered)),
    }


def _hidden(
    job: Job, place: NDArray[np.int64], filled: NDArray[np.bool_], tile: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.bool_]]:
    """Of each quad [K]: its entry's number; whether the entry is behind its tile's bound; whether the quad is behind its own."""
    record = place[:, 0]
    columns = 2 * (-(-job.width // _OWNED))
    quad = place[:, 2] // TILE * columns + place[:, 1] // TILE
    far = np.full(2 * (-(-job.height // _OWNED)) * columns, np.inf, np.float32)
    bounds = filled & (job.records.z[record].max(axis=1) <= 1)
    np.minimum.at(far, quad[bounds], bound_depth(job.records, place[bounds], TILE, True, job.arithmetic))
    tile_far = far.reshape(-1, 2, columns // 2, 2).max(axis=(1, 3)).reshape(-1)
    hidden = job.records.z[record].min(axis=1) > tile_far[tile]
    quad_hidden = bound_depth(job.records, place, TILE, False, job.arithmetic) > far[quad]
    return record * len(tile_far) + tile, hidden, quad_hidden


def _drawn(job: Job, place: NDArray[np.int64], filled: NDArray[np.bool_]) -> tuple[NDArray[np.int64], int]:
    """int64 [K]: how many pixels are covered of each quad; and how many fragments are nearer than what their pixel holds."""
    pixels, passed = Pixels(job.height * job.width), 0
    covered = np.zeros(len(place), np.int64)
    i, j = np.arange(TILE * TILE) % TILE, np.arange(TILE * TILE) // TILE
    for part in batches(np.full(len(place), TILE), ROWS):
        record, x, y = place[part, 0], place[part, 1, None] + i, place[part, 2, None] + j
        x0, y0, x1, y1 = job.records.bbox[record].astype(np.int64).T[:, :, None]
        inside = is_inside(sides_of(job.records, record[:, None], job.arithmetic), x, y).all(axis=-1)
        drawn = (filled[part, None] | inside) & (x >= x0) & (x < x1) & (y >= y0) & (y < y1)
        covered[part] = drawn.sum(axis=1)
        quad, pixel = np.nonzero(drawn)
        spans = np.stack([record[quad], y[quad, pixel], x[quad, pixel], x[quad, pixel] + 1], axis=1)
        packed = pack(job.records.triangle[record[quad]], depth(job.records, spans, job.arithmetic))
        job.places.add_fragments(spans[:, 2], spans[:, 1])
        passed += int(pixels.offer(spans[:, 1] * job.width + spans[:, 2], packed).sum())
    return covered, passed

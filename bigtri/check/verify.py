"""Compare the extension with the reference stage by stage, in bits, and name the first place where they differ.

Each stage of the extension gets the reference's output of the stage before, so that one fault is reported once, where it is; the
whole pipeline is compared at the end.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..ops.arguments import Array
from ..ops.interpolate import barycentrics
from ..ops.rasterize import rasterize
from ..reference.numerics import BIN, LARGE_THRESHOLD, TILE
from ..reference.records import Bins, Records
from . import stages

Scissor = tuple[int, int, int, int]


class Difference(NamedTuple):
    """The first place where two backends differ."""

    stage: str  # "setup", "binning", "tile_mask", "scanline", "depth", "visibility", "rasterize" or "attributes"
    what: str  # the output, and the row of it
    expected: Any
    got: Any
    triangle: int | None = None
    bin: tuple[int, int] | None = None  # column, row
    tile: tuple[int, int] | None = None  # column, row within the bin
    pixel: tuple[int, int] | None = None  # x, y

    def __str__(self) -> str:
        places = [("triangle", self.triangle), ("bin", self.bin), ("tile", self.tile), ("pixel", self.pixel)]
        where = "".join(f", {name} {value}" for name, value in places if value is not None)
        return f"stage {self.stage}, {self.what}{where}: expected {self.expected}, got {self.got}"


def same_bits(a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.bool_]:
    """Elementwise, for arrays of one shape and dtype: equal as bit patterns, so NaN equals itself and -0 is not 0."""
    pattern = np.dtype(f"u{a.dtype.itemsize}")
    return np.ascontiguousarray(a).view(pattern) == np.ascontiguousarray(b).view(pattern)


def first_difference(a: NDArray[Any], b: NDArray[Any]) -> tuple[int, ...] | None:
    """Index of the first element that differs in bits; the row after the shorter one if only the length differs."""
    if a.dtype != b.dtype or a.shape[1:] != b.shape[1:]:
        return ()
    rows = min(len(a), len(b))
    wrong = np.argwhere(~same_bits(a[:rows], b[:rows]))
    if len(wrong):
        return tuple(int(i) for i in wrong[0])
    return None if len(a) == len(b) else (rows,)


def compare(
    positions: NDArray[np.float32],
    triangles: NDArray[np.int32],
    resolution: tuple[int, int],
    *,
    cull: str = "none",
    scissor: Scissor | None = None,
    variant: str = "auto",
    threshold: int = LARGE_THRESHOLD,
) -> Difference | None:
    """Run every stage on both backends.

    Args:
        positions: float32 [V, 4], clip space.
        triangles: int32 [T, 3].
        resolution: (height, width), px.
        cull, scissor, variant: as for ``rasterize``.
        threshold: of the binning stage, px.

    Returns:
        The first difference, or None if all bits are equal.
    """
    height, width = resolution
    expected, dropped = stages.setup(positions, triangles, height, width, cull, scissor, backend="reference")
    records, lost = stages.setup(positions, triangles, height, width, cull, scissor, backend="native")
    found = _records(expected, records)
    if found is None and lost != dropped:
        found = Difference("setup", "dropped", dropped, lost)
    found = found or _raster(expected, height, width, threshold)
    return found or _whole(positions, triangles, resolution, cull, scissor, variant)


def _records(expected: Records, got: Records) -> Difference | None:
    for name, a, b in zip(Records._fields, expected, got, strict=True):
        index = first_difference(a, b)
        if index is not None:
            triangle = int(expected.triangle[index[0]]) if index and index[0] < len(expected.triangle) else None
            return Difference("setup", f"{name}{list(index)}", _at(a, index), _at(b, index), triangle)
    return None


def _raster(records: Records, height: int, width: int, threshold: int) -> Difference | None:
    """The stages from binning to visibility."""
    bins = stages.binning(records, threshold, backend="reference")
    got_bins = stages.binning(records, threshold, backend="native")
    for name, a, b in zip(Bins._fields, bins, got_bins, strict=True):
        if (index := first_difference(a, b)) is not None:
            entry = bins.candidates[index[0]] if name != "small" and index and index[0] < len(bins.candidates) else None
            place = None if entry is None else (int(entry[1]), int(entry[2]))
            triangle = None if entry is None else int(records.triangle[entry[0]])
            return Difference("binning", f"{name}{list(index)}", _at(a, index), _at(b, index), triangle, place)

    queue = bins.candidates[bins.kept]
    touched, full = stages.tile_mask(records, queue, backend="reference")
    for name, a, b in zip(("touched", "full"), (touched, full), stages.tile_mask(records, queue, backend="native"), strict=True):
        if (index := first_difference(a, b)) is not None:
            record, column, row = queue[index[0]].tolist()
            bit = int(np.unpackbits((a ^ b)[index[0] : index[0] + 1].view(np.uint8), bitorder="little").argmax())
            mask, got_mask = (f"{int(v[index]) & (2**64 - 1):#018x}" for v in (a, b))
            where = (int(records.triangle[record]), (column, row), (bit % 8, bit // 8))
            return Difference("tile_mask", f"{name}{list(index)}", mask, got_mask, *where)

    spans = stages.scanline(records, queue, touched, bins.small, backend="reference")
    got_spans = stages.scanline(records, queue, touched, bins.small, backend="native")
    if (index := first_difference(spans, got_spans)) is not None:
        record, y, lower, _ = (spans if index[0] < len(spans) else got_spans)[index[0]].tolist()
        pixel = (lower, y)
        return _at_pixel("scanline", f"span {index[0]}", _row(spans, index), _row(got_spans, index), pixel, records, record)

    z = stages.depth(records, spans, backend="reference")
    got_z = stages.depth(records, spans, backend="native")
    if (index := first_difference(z, got_z)) is not None:
        ends = np.cumsum(spans[:, 3] - spans[:, 2], dtype=np.int64)
        span = int(np.searchsorted(ends, index[0], side="right"))
        record, y, _, upper = (int(v) for v in spans[span])
        pixel = (upper - int(ends[span] - index[0]), y)
        return _at_pixel("depth", f"fragment {index[0]}", _at(z, index), _at(got_z, index), pixel, records, record)

    packed = stages.visibility(records, spans, z, height, width, backend="reference")
    return _image("visibility", packed, stages.visibility(records, spans, z, height, width, backend="native"))


def _whole(
    positions: NDArray[np.float32],
    triangles: NDArray[np.int32],
    resolution: tuple[int, int],
    cull: str,
    scissor: Scissor | None,
    variant: str,
) -> Difference | None:
    """The pipeline from end to end, and the attributes of what it drew."""
    a, b = (
        rasterize(positions, triangles, resolution, backend=backend, variant=variant, cull=cull, scissor=scissor)
        for backend in ("reference", "native")
    )
    if found := _image("rasterize", a.packed, b.packed) or _image("rasterize", a.depth, b.depth):
        return found
    expected, got = (barycentrics(a, positions, triangles, backend=backend) for backend in ("reference", "native"))
    return _image("attributes", expected, got)


def _image(stage: str, expected: Array | None, got: Array | None) -> Difference | None:
    assert isinstance(expected, np.ndarray) and isinstance(got, np.ndarray)  # NumPy in, NumPy out
    index = first_difference(expected, got)
    if index is None:
        return None
    what = "packed" if expected.dtype == np.int64 else f"{expected.dtype} image"
    a, b = (f"{int(v[index]):#018x}" if v.dtype == np.int64 else v[index] for v in (expected, got))
    return _at_pixel(stage, what, a, b, (index[1], index[0]))


def _at_pixel(
    stage: str, what: str, expected: Any, got: Any, pixel: tuple[int, int], records: Records | None = None, record: int = 0
) -> Difference:
    x, y = pixel
    tile = (x % BIN // TILE, y % BIN // TILE)
    triangle = None if records is None else int(records.triangle[record])
    return Difference(stage, what, expected, got, triangle, (x // BIN, y // BIN), tile, pixel)


def _at(values: NDArray[Any], index: tuple[int, ...]) -> Any:
    """The element, or what there is to say where there is none."""
    if not index:
        return f"{values.dtype} {list(values.shape)}"
    return values[index] if index[0] < len(values) else f"only {len(values)} rows"


def _row(values: NDArray[Any], index: tuple[int, ...]) -> Any:
    return values[index[0]].tolist() if index[0] < len(values) else f"only {len(values)} rows"

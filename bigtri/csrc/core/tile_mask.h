// Which of a bin's 8x8 tiles of 8x8 px an entry touches and fills; docs/numerics.md 5. The answers are 64-bit masks,
// bit 8 * row + column. They come after binning, and decide which rows are looked at. Mirrors
// bigtri/reference/tile_mask.py. This file has the arithmetic; cpu/tile_mask.inl and cuda/direct.cuh build the masks.
#pragma once

#include "binning.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

// The tiles that meet columns [x0, x1) and rows [y0, y1), given in px from the bin's upper left corner. They may
// reach beyond the bin.
BIGTRI_HD uint64_t bbox_tiles(int x0, int y0, int x1, int y1) {
  x0 = max_of(x0, 0), y0 = max_of(y0, 0), x1 = min_of(x1, kBin), y1 = min_of(y1, kBin);
  if (x0 >= x1 || y0 >= y1) return 0;
  const int c0 = x0 / kTile, c1 = (x1 - 1) / kTile, r0 = y0 / kTile, r1 = (y1 - 1) / kTile;
  const uint64_t columns = (0xffull >> (7 - c1)) & (0xffull << c0);
  const uint64_t rows = (~0ull >> (8 * (7 - r1))) & (~0ull << (8 * r0));
  return (columns * 0x0101010101010101ull) & rows;
}

// f at a tile's first pixel centre. E is a NarrowEdge, or a WideEdge (coverage.h).
template <class E>
BIGTRI_HD auto tile_edge(const E& e, int column, int row) {
  return e.f + (kTile * column) * e.sx + (kTile * row) * e.sy;
}

// Added to tile_edge, they give the extremes of f over the tile's 64 pixel centres.
template <class E>
BIGTRI_HD auto tile_highest(const E& e) {
  return (kTile - 1) * (max_of<decltype(e.f)>(e.sx, 0) + max_of<decltype(e.f)>(e.sy, 0));
}
template <class E>
BIGTRI_HD auto tile_lowest(const E& e) {
  return (kTile - 1) * (min_of<decltype(e.f)>(e.sx, 0) + min_of<decltype(e.f)>(e.sy, 0));
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

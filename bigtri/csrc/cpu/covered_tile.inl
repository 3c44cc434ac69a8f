// Draws what a record covers of a tile of 8x8 px into pixels that the thread owns: coverage as a mask of 64 bits, then
// eight pixels of a row at a time. For variants that own tiles or bins. Compiled once per instruction set.
#pragma once

#include "depth.inl"
#include "tile_mask.inl"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// The pixels of the tile whose first one is (x, y) that lie in the record's bounding box, bit 8 * row + column.
BIGTRI_INLINE uint64_t boxed_pixels(const Record& r, int x, int y) {
  if (r.x0 <= x && r.y0 <= y && r.x1 >= x + kTile && r.y1 >= y + kTile) return ~0ull;
  const int x0 = max_of(r.x0 - x, 0), x1 = min_of(r.x1 - x, kTile), y0 = max_of(r.y0 - y, 0),
            y1 = min_of(r.y1 - y, kTile);
  if (x0 >= x1 || y0 >= y1) return 0;
  const uint64_t columns = (0xffull >> (kTile - x1)) & (0xffull << x0);
  const uint64_t rows = (~0ull >> (8 * (kTile - y1))) & (~0ull << (8 * y0));
  return (columns * 0x0101010101010101ull) & rows;
}

// An edge within a tile that it does not reject, whose first pixel is (x, y): constant 0 if all of the tile lies inside.
// Any other edge crosses the tile, and has |f| <= 7 * 2^25 there, as binning.h shows for 63.
BIGTRI_INLINE NarrowEdge edge_in_tile(const Edge& e, int x, int y) {
  const StepNumber f = edge_steps(e, x, y);
  const int32_t sx = -e.dy, sy = e.dx;
  if (lowest_of(f, sx, sy, kTile - 1) >= 0) return {0, 0, 0};
  return {(int32_t)f, sx, sy};
}

// The pixels of the tile whose first one is (x, y) that lie inside all edges, wherever the bounding box ends.
BIGTRI_INLINE uint64_t pixels_in_tile(const Record& r, int x, int y, Counts* counts) {
  NarrowEdge edge[3];
  i32x16 offset[3];
  for (int k = 0; k < 3; ++k) {
    edge[k] = edge_in_tile(edge_of(r.x, r.y, k), x, y);
    offset[k] = lanes(0, edge[k].sx, edge[k].sy);
  }
  counts->add_edges(Counter::edges_32, 3 * kTile * kTile, x, y);
  return tile_coverage(edge, offset, 0, 0);
}

// The tiles of a bin that a record touches, of those that its bounding box meets, and which of these it fills.
BIGTRI_INLINE TileMasks tiles_in_bin(const Record& r, int bin_x, int bin_y, Counts* counts) {
  NarrowEdge edge[3];
  for (int k = 0; k < 3; ++k) edge[k] = narrow(bin_edge(edge_of(r.x, r.y, k), bin_x, bin_y));
  const uint64_t boxed = bbox_tiles(r.x0 - bin_x * kBin, r.y0 - bin_y * kBin, r.x1 - bin_x * kBin, r.y1 - bin_y * kBin);
  TileMasks m = tile_masks(edge);
  m.touched &= boxed;
  m.full &= m.touched;
  counts->add_edges(Counter::edges_64, 3, bin_x * kBin, bin_y * kBin, kBin);
  counts->add_edges(Counter::edges_32, 6 * kTile * kTile, bin_x * kBin, bin_y * kBin, kBin);
  counts->add(Counter::tiles_tested, __builtin_popcountll(boxed));
  counts->add(Counter::tiles_rejected, __builtin_popcountll(boxed & ~m.touched));
  counts->add(Counter::tiles_accepted, __builtin_popcountll(m.full));
  return m;
}

template <bool kThin, bool kFar>
BIGTRI_INLINE void merge_rows(const CellDepth& d, uint64_t covered, int i, int j, int64_t* pixels, int pitch,
                              Counts* counts) {
  for (int row = 0; row < kTile; ++row) {
    const uint32_t bits = covered >> (8 * row) & 0xff;
    if (!bits) continue;
    const i64x8 packed = packed_of<kFar>(d, row_depth<kThin>(d, i, j + row));
    if constexpr (kCounts)
      for (int x = 0; x < kTile; ++x)
        counts->add(Counter::passed, (bits >> x & 1) && packed[x] < pixels[row * pitch + x]);
    keep_nearest(pixels + row * pitch, packed, bits);
  }
}

// Keeps the nearest at the covered pixels of the tile whose first pixel is (i, j) of the cell. pixels: its first pixel;
// a row takes `pitch` elements.
BIGTRI_INLINE void merge_tile(const CellDepth& d, uint64_t covered, int i, int j, int64_t* pixels, int pitch,
                              Counts* counts) {
  if (d.thin)
    d.far ? merge_rows<true, true>(d, covered, i, j, pixels, pitch, counts)
          : merge_rows<true, false>(d, covered, i, j, pixels, pitch, counts);
  else
    d.far ? merge_rows<false, true>(d, covered, i, j, pixels, pitch, counts)
          : merge_rows<false, false>(d, covered, i, j, pixels, pitch, counts);
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// Draws a record into the patch of a bin, tile by tile, for the variant persistent: draw_into, called by persistent.cpp.
// Compiled once per instruction set.
#pragma once

#include "covered_tile.inl"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

void draw_into(const Record& r, int bin_x, int bin_y, int64_t* patch, Counts* counts) {
  const TileMasks m = tiles_in_bin(r, bin_x, bin_y, counts);
  if (!m.touched) return;
  CellDepth d;
  cell_depth(r, bin_x, bin_y, &d);
  for (uint64_t rest = m.touched; rest; rest &= rest - 1) {
    const int tile = __builtin_ctzll(rest), i = tile % 8 * kTile, j = tile / 8 * kTile;
    const int x = bin_x * kBin + i, y = bin_y * kBin + j;
    const uint64_t covered = boxed_pixels(r, x, y) & (m.full >> tile & 1 ? ~0ull : pixels_in_tile(r, x, y, counts));
    counts->add(Counter::tiles_empty, !covered);
    counts->add_fragments_of(covered, kTile, x, y);
    if (covered) merge_tile(d, covered, i, j, patch + j * kBin + i, kBin, counts);
  }
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

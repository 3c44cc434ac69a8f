// Draws an owned tile with bounds of depth at two levels, for the variant tile_owned; called by tile_owned.cpp. Compiled
// once per instruction set.
#pragma once

#include "covered_tile.inl"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

void find_quads(const Record& r, int bin_x, int bin_y, uint64_t* touched, uint64_t* full, Counts* counts) {
  const TileMasks m = tiles_in_bin(r, bin_x, bin_y, counts);
  *touched = m.touched;
  *full = m.full;
}

// Bounds are gathered from the whole list before any pixel is drawn, so they do not depend on its order. A record that
// fills a quad hides what is behind its farthest depth there. A far one does not: fragments with z > 1 are dropped, so it
// may leave pixels open. All tests are strict: what gave a bound is tested against it too, and of equal depths the lower
// triangle wins.
void draw_list(const Record* records, const OwnedEntry* list, int64_t count, int x, int y, int64_t* pixels,
               Counts* counts) {
  constexpr int kQuads = 4;
  const int bin_x = x / kBin, bin_y = y / kBin, i = x % kBin, j = y % kBin;
  float quad_far[kQuads] = {kInfinity, kInfinity, kInfinity, kInfinity};
  for (int64_t n = 0; n < count; ++n) {
    const Record& r = records[list[n].record];
    if (!list[n].full || (r.flags & kRecordFar)) continue;
    CellDepth d;
    cell_depth(r, bin_x, bin_y, &d);
    for (int q = 0; q < kQuads; ++q)
      if (list[n].full >> q & 1)
        quad_far[q] = min_of(quad_far[q], farthest_depth(d, i + q % 2 * kTile, j + q / 2 * kTile, kTile));
  }
  const float tile_far = max_of(max_of(quad_far[0], quad_far[1]), max_of(quad_far[2], quad_far[3]));
  for (int64_t n = 0; n < count; ++n) {
    const Record& r = records[list[n].record];
    const bool hidden = r.zmin > tile_far;
    counts->add(Counter::bins_hidden, hidden);
    if (hidden) continue;
    CellDepth d;
    cell_depth(r, bin_x, bin_y, &d);
    for (uint32_t rest = list[n].touched; rest; rest &= rest - 1) {
      const int q = __builtin_ctz(rest), left = q % 2 * kTile, top = q / 2 * kTile;
      const bool quad_hidden = nearest_depth(d, i + left, j + top, kTile) > quad_far[q];
      counts->add(Counter::tiles_hidden, quad_hidden);
      if (quad_hidden) continue;
      const uint64_t inside = list[n].full >> q & 1 ? ~0ull : pixels_in_tile(r, x + left, y + top, counts);
      const uint64_t covered = boxed_pixels(r, x + left, y + top) & inside;
      counts->add(Counter::tiles_empty, !covered);
      merge_tile(d, covered, i + left, j + top, pixels + top * kOwnedTile + left, kOwnedTile, counts);
      counts->add_fragments_of(covered, kTile, x + left, y + top);
    }
  }
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

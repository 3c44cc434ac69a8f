// Draws what the lists of a pyramid name into a finest tile, for the variant hierarchical_tiles: walk_up, called by
// hierarchical_tiles.cpp. Compiled once per instruction set.
//
// Early rejection: a record that fills the tile, and is not far, hides all that is behind its farthest depth there. Which
// records come first is a matter of the lists, so how much is left out depends on their order; what is left out loses
// in any order. All tests against the bound are strict: of equal depths the lower triangle index wins.
#pragma once

#include "depth.inl"
#include "kernels.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// The part of a record's bounding box in a tile, px from the tile's first pixel, half-open.
struct BoxInTile {
  int x0, y0, x1, y1;
};

// Draws rows of the box, eight pixels at a time. edge: within the tile.
template <bool kThin, bool kFar>
BIGTRI_INLINE int64_t draw_rows(const CellDepth& d, const FinestTile& t, const BoxInTile& box, const NarrowEdge edge[3],
                                Counts* counts) {
  const i32x8 lane = load<i32x8>(kLaneInt);
  const int pitch = pitch_of(t.size), first = box.x0 & ~7;
  int64_t covered = 0;
  for (int y = box.y0; y < box.y1; ++y)
    for (int x = first; x < box.x1; x += 8) {
      const i32x8 column = lane + x;
      i32x8 outside = (column - box.x0) | (splat<i32x8>(box.x1 - 1) - column);
      for (int k = 0; k < 3; ++k) outside = outside | (column * edge[k].sx + (edge[k].f + y * edge[k].sy));
      const uint32_t bits = sign_mask(outside) ^ 0xff;
      if (!bits) continue;
      const i64x8 packed = packed_of<kFar>(d, row_depth<kThin>(d, t.x % kBin + x, t.y % kBin + y));
      int64_t* at = t.pixels + y * pitch + x;
      covered += __builtin_popcount(bits);
      counts->add_fragments_of(bits, 8, t.x + x, t.y + y);
      if constexpr (kCounts)
        for (int i = 0; i < 8; ++i) counts->add(Counter::passed, (bits >> i & 1) && packed[i] < at[i]);
      keep_nearest(at, packed, bits);
    }
  return covered;
}

BIGTRI_INLINE int64_t draw_in_tile(const CellDepth& d, const FinestTile& t, const BoxInTile& box,
                                   const NarrowEdge edge[3], Counts* counts) {
  if (d.thin)
    return d.far ? draw_rows<true, true>(d, t, box, edge, counts) : draw_rows<true, false>(d, t, box, edge, counts);
  return d.far ? draw_rows<false, true>(d, t, box, edge, counts) : draw_rows<false, false>(d, t, box, edge, counts);
}

// Draws one element. far: the tile's depth bound.
BIGTRI_INLINE void draw_element(const TileElement& element, const FinestTile& t, float* far, Counts* counts) {
  const Record& r = element.record();
  const BoxInTile box = {max_of(r.x0 - t.x, 0), max_of(r.y0 - t.y, 0), min_of(r.x1 - t.x, t.size),
                         min_of(r.y1 - t.y, t.size)};
  if (box.x0 >= box.x1 || box.y0 >= box.y1) return;
  if (t.early_z && r.zmin > *far) {
    counts->add(Counter::tiles_hidden, 1);
    return;
  }
  // An edge that has all of the tile inside is constant. Any other that does not reject it has |f| <= 63 * 2^25 there
  // (narrow() in core/binning.h), and up to 7 px past a tile of 4 px far less.
  NarrowEdge edge[3] = {};
  bool full = true;
  if (!element.full()) {
    StepNumber f[3], high[3], low[3];
    Edge e[3];
    for (int k = 0; k < 3; ++k) {
      e[k] = edge_of(r.x, r.y, k);
      f[k] = edge_steps(e[k], t.x, t.y);
      high[k] = highest_of(f[k], -e[k].dy, e[k].dx, t.size - 1);
      low[k] = lowest_of(f[k], -e[k].dy, e[k].dx, t.size - 1);
    }
    const bool kept = (high[0] | high[1] | high[2]) >= 0;
    counts->add(Counter::tiles_tested, 1);
    counts->add(Counter::tiles_rejected, !kept);
    counts->add_edges(Counter::edges_64, kept ? 6 : 3, t.x, t.y, t.size);
    if (!kept) return;
    full = (low[0] | low[1] | low[2]) >= 0;
    counts->add(Counter::tiles_accepted, full);
    for (int k = 0; k < 3; ++k)
      if (low[k] < 0) edge[k] = {(int32_t)f[k], -e[k].dy, e[k].dx};
  }
  CellDepth d = {};
  cell_depth(r, t.x / kBin, t.y / kBin, &d);
  const int i = t.x % kBin, j = t.y % kBin;
  if (t.early_z && nearest_depth(d, i, j, t.size) > *far) {
    counts->add(Counter::tiles_hidden, 1);
    return;
  }
  if (full && !d.far) *far = min_of(*far, farthest_depth(d, i, j, t.size));
  for (int y = box.y0; kCounts && !full && y < box.y1; ++y)
    for (int x = box.x0 & ~7; x < box.x1; x += 8) counts->add_edges(Counter::edges_32, 3 * 8, t.x + x, t.y + y);
  const int64_t covered = draw_in_tile(d, t, box, edge, counts);
  counts->add(Counter::tiles_empty, !covered);
}

void walk_up(const FinestTile& tile, Counts* counts) {
  float far = kInfinity;
  for (int l = 0; l < tile.list_count; ++l) {
    const TileElements& list = tile.lists[l];
    for (int64_t i = 0; i < list.count; ++i) draw_element(list.first[i], tile, &far, counts);
  }
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

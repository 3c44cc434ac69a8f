// From a bin's queue to the queues of its tiles, and from these to pixels, for the variant tile_queues; called by
// tile_queues.cpp. Compiled once per instruction set.
#pragma once

#include "covered_tile.inl"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

void find_tiles(const Record& r, int left, int top, WideMasks* masks, DepthNumber anchors[4], Counts* counts) {
  i64x8 across[3][kWideTiles / 8];
  int64_t down[3], high[3], low[3];
  for (int k = 0; k < 3; ++k) {
    const Edge e = edge_of(r.x, r.y, k);
    const WideEdge w = {edge_steps(e, left, top), -e.dy, e.dx};
    high[k] = tile_highest(w);
    low[k] = tile_lowest(w);
    down[k] = kTile * w.sy;
    for (int c = 0; c < kWideTiles; c += 8)
      across[k][c / 8] = w.f + (lane_numbers<int64_t>() + (int64_t)c) * (kTile * w.sx);
  }
  const int x0 = max_of(r.x0 - left, 0) / kTile, x1 = (min_of(r.x1 - left, kWideBin) - 1) / kTile;
  const int y0 = max_of(r.y0 - top, 0) / kTile, y1 = (min_of(r.y1 - top, kWideBin) - 1) / kTile;
  const uint32_t boxed = (0xffffu << x0) & (0xffffu >> (kWideTiles - 1 - x1));
  uint32_t in_rows[2] = {0, 0};  // tiles touched of the upper and of the lower cells
  for (int row = 0; row < kWideTiles; ++row) {
    uint32_t touched = 0, full = 0;
    for (int c = 0; row >= y0 && row <= y1 && c < kWideTiles; c += 8) {
      i64x8 at[3];
      for (int k = 0; k < 3; ++k) at[k] = across[k][c / 8] + row * down[k];
      touched |= (sign_mask((at[0] + high[0]) | (at[1] + high[1]) | (at[2] + high[2])) ^ 0xff) << c;
      full |= (sign_mask((at[0] + low[0]) | (at[1] + low[1]) | (at[2] + low[2])) ^ 0xff) << c;
    }
    touched &= boxed;
    masks->touched[row] = (uint16_t)touched;
    masks->full[row] = (uint16_t)(full & touched);
    in_rows[row / 8] |= touched;
    counts->add(Counter::tiles_rejected, row >= y0 && row <= y1 ? x1 - x0 + 1 - __builtin_popcount(touched) : 0);
    counts->add(Counter::tiles_accepted, __builtin_popcount(full & touched));
    for (int c = x0; kCounts && row >= y0 && row <= y1 && c <= x1; ++c)
      counts->add_edges(Counter::edges_64, touched >> c & 1 ? 6 : 3, left + c * kTile, top + row * kTile);
  }
  counts->add(Counter::tiles_tested, (x1 - x0 + 1) * (y1 - y0 + 1));
  for (int c = 0; c < 4; ++c)
    if (in_rows[c / 2] >> (c % 2 * 8) & 0xff) anchors[c] = cell_anchor(r, left / kBin + c % 2, top / kBin + c / 2);
}

void draw_queue(const TileEntry* queue, int64_t count, int x, int y, int64_t* pixels, Counts* counts) {
  for (int64_t n = 0; n < count; ++n) {
    const Record& r = *queue[n].record;
    const uint64_t covered = boxed_pixels(r, x, y) & (queue[n].full ? ~0ull : pixels_in_tile(r, x, y, counts));
    counts->add(Counter::tiles_empty, !covered);
    CellDepth d;
    cell_depth(r, x / kBin, y / kBin, queue[n].anchor, &d);
    merge_tile(d, covered, x % kBin, y % kBin, pixels, kTile, counts);
    counts->add_fragments_of(covered, kTile, x, y);
  }
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

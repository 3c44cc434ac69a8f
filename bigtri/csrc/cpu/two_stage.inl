// Draws a record within a bin, for the variant two_stage: draw_bin, called by two_stage.cpp. Compiled once per
// instruction set, whose vectors the compiler finds by itself: every loop over eight pixels is the scalar code of core/,
// so that a rung needs no code here.
#pragma once

#include "../core/coverage.h"
#include "../core/pixel_depth.h"
#include "atomic.h"
#include "kernels.h"
#include "simd.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// Eight pixels of row j of the bin from column i on. edges: null if all pixels are inside of them; the bbox allows the
// lanes [begin, end).
template <bool kThin>
BIGTRI_INLINE void draw_eight(const DepthInCell& d, const EdgesInBin* edges, int i, int j, int begin, int end,
                              int64_t* pixels) {
  int32_t covered[8];
  int some = 0;
  for (int lane = 0; lane < 8; ++lane) {
    covered[lane] = (lane >= begin) & (lane < end) & (!edges || is_inside(*edges, i + lane, j));
    some |= covered[lane];
  }
  if (!some) return;
  float z[8];
  for (int lane = 0; lane < 8; ++lane) z[lane] = pixel_depth<kThin>(d, i + lane, j);
  for (int lane = 0; lane < 8; ++lane)
    if (covered[lane]) keep_nearest_atomically(pixels + lane, pack_fragment(z[lane], d.r->triangle));
}

template <bool kThin>
BIGTRI_INLINE void draw_touched(const Record& r, const EdgesInBin& edges, int bin_x, int bin_y, int64_t* pixels,
                                int width) {
  const DepthInCell depth = depth_in_cell(r, bin_x, bin_y);
  const int left = bin_x * kBin, top = bin_y * kBin;
  for (uint64_t tiles = allowed_tiles(r, edges.bin); tiles; tiles &= tiles - 1) {
    const int tile = __builtin_ctzll(tiles), column = tile % 8, row = tile / 8;
    if (!touches_tile(edges, column, row)) continue;
    const EdgesInBin* partly = fills_tile(edges, column, row) ? nullptr : &edges;
    const int i = column * kTile, begin = max_of(r.x0 - left - i, 0), end = min_of(r.x1 - left - i, kTile);
    const int j0 = max_of(r.y0 - top, row * kTile), j1 = min_of(r.y1 - top, row * kTile + kTile);
    int64_t* line = pixels + (int64_t)(top + j0) * width + left + i;
    for (int j = j0; j < j1; ++j, line += width) draw_eight<kThin>(depth, partly, i, j, begin, end, line);
  }
}

void draw_bin(const Record& r, int bin_x, int bin_y, int64_t* pixels, int width) {
  EdgesInBin edges;
  if (!edges_in_bin(r, bin_x, bin_y, &edges)) return;
  if (is_thin(r))
    draw_touched<true>(r, edges, bin_x, bin_y, pixels, width);
  else
    draw_touched<false>(r, edges, bin_x, bin_y, pixels, width);
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

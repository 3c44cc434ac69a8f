// Draws a record within a bin, for the variant two_stage: draw_bin, called by two_stage.cpp. Compiled once per
// instruction set, whose vectors the compiler finds by itself: every loop over pixels is the scalar code of core/,
// so that a rung needs no code here. The one exception is a fused product.
#pragma once

#include "../core/coverage.h"
#include "../core/pixel_depth.h"
#include "atomic.h"
#include "kernels.h"
#include "simd.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// A tile's 64 pixels at a time, pixel p in column p % 8 and row p / 8: loops that are long enough for the compiler to make
// vectors of. i, j: the tile's first pixel in the bin; pixels: its first pixel.
constexpr int kTilePixels = kTile * kTile;

// Where a product is fused, pixels are tested in vectors of eight by an instruction for it: the compiler makes none of
// fused(), whose library function may set errno. Without such an instruction they are tested one by one.
#if BIGTRI_SIMD >= 256
constexpr bool kFusedInVectors = Rung::kCoverage == CoverageRule::kFloat32Fused;

// value_of(e, x, y) (core/coverage.h) of eight pixels of a row from x on.
BIGTRI_INLINE f32x8 fused_values(const FloatEdge& e, int x, int y) {
  const f32x8 right = (lane_numbers<float>() + ((float)x + 0.5f)) - e.x;
  const float down = ((float)y + 0.5f) - e.y;
  return fused(splat<f32x8>(e.dx), splat<f32x8>(down), e.dy * right);
}

BIGTRI_INLINE void test_fused(const FloatEdge edge[3], const Bin& bin, int i, int j, bool full,
                              int32_t covered[kTilePixels]) {
  for (int row = 0; row < kTile; ++row) {
    i32x8 outside = splat<i32x8>(0);  // -1 where it is
    for (int k = 0; k < 3; ++k)
      outside = outside | (fused_values(edge[k], bin.left + i, bin.top + j + row) < edge[k].least);
    store(covered + kTile * row, (outside + 1) | (int32_t)full);
  }
}
#else
constexpr bool kFusedInVectors = false;
#endif
BIGTRI_INLINE void test_fused(const void*, const Bin&, int, int, bool, int32_t[kTilePixels]) {}

template <bool kThin>
BIGTRI_INLINE void draw_tile(const Record& r, const DepthInCell& depth, const EdgesInBin& edges, int i, int j,
                             bool full, int64_t* pixels, int width, Counts* counts) {
  int32_t covered[kTilePixels];
  if constexpr (kFusedInVectors)
    test_fused(edges.edge, edges.bin, i, j, full, covered);
  else
    for (int p = 0; p < kTilePixels; ++p) covered[p] = full | is_inside(edges, i + p % kTile, j + p / kTile);
  // Pixels of the bbox.
  const int left = r.x0 - edges.bin.left - i, right = r.x1 - edges.bin.left - i, top = r.y0 - edges.bin.top - j,
            bottom = r.y1 - edges.bin.top - j;
  int32_t some = 0;
  for (int p = 0; p < kTilePixels; ++p) {
    const int x = p % kTile, y = p / kTile;
    covered[p] &= (x >= left) & (x < right) & (y >= top) & (y < bottom);
    some |= covered[p];
    counts->add_fragments(covered[p], edges.bin.left + i + x, edges.bin.top + j + y);
  }
  counts->add_edges(Counter::edges_32, 3 * kTilePixels, edges.bin.left + i, edges.bin.top + j);
  counts->add(Counter::tiles_empty, !some);
  if (!some) return;
  float z[kTilePixels];
  for (int p = 0; p < kTilePixels; ++p) z[p] = pixel_depth<kThin>(depth, i + p % kTile, j + p / kTile);
  for (int p = 0; p < kTilePixels; ++p)
    if (covered[p])
      keep_nearest_atomically(pixels + (int64_t)(p / kTile) * width + p % kTile, pack_fragment(z[p], r.triangle),
                              counts);
}

template <bool kThin>
BIGTRI_INLINE void draw_touched(const Record& r, const EdgesInBin& edges, int bin_x, int bin_y, int64_t* pixels,
                                int width, Counts* counts) {
  const DepthInCell depth = depth_in_cell(r, bin_x, bin_y);
  for (uint64_t tiles = allowed_tiles(r, edges.bin); tiles; tiles &= tiles - 1) {
    const int tile = __builtin_ctzll(tiles), column = tile % 8, row = tile / 8;
    const bool touched = touches_tile(edges, column, row);
    counts->add(Counter::tiles_tested, 1);
    counts->add(Counter::tiles_rejected, !touched);
    counts->add_edges(Counter::edges_32, touched ? 6 : 3, edges.bin.left + column * kTile, edges.bin.top + row * kTile);
    if (!touched) continue;
    const bool full = fills_tile(edges, column, row);
    counts->add(Counter::tiles_accepted, full);
    const int i = column * kTile, j = row * kTile;
    int64_t* first = pixels + (int64_t)(edges.bin.top + j) * width + edges.bin.left + i;
    draw_tile<kThin>(r, depth, edges, i, j, full, first, width, counts);
  }
}

void draw_bin(const Record& r, int bin_x, int bin_y, int64_t* pixels, int width, Counts* counts) {
  EdgesInBin edges;
  counts->add_edges(Counter::edges_64, 6, bin_x * kBin, bin_y * kBin, kBin);
  if (!edges_in_bin(r, bin_x, bin_y, &edges)) return;
  if (is_thin(r))
    draw_touched<true>(r, edges, bin_x, bin_y, pixels, width, counts);
  else
    draw_touched<false>(r, edges, bin_x, bin_y, pixels, width, counts);
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

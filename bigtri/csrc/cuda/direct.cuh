// Drawing at once, onto what is in the frame already, with an atomic minimum a fragment: a warp takes a bin of a
// record, makes 64-bit masks of its tiles, and draws these. Nothing waits, so nothing needs room.
#pragma once

#include "../core/coverage.h"
#include "fragment.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// The edges of a record in a bin where the rung has integers in 32 bits and masks that ask the corners, as all variants
// are made for; by core/coverage.h where it has others.
struct NarrowEdges {
  NarrowEdge edge[3];
  Bin bin;
};
constexpr bool kNarrowEdges = !kFloatCoverage && !Rung::kWideEdges && kMaskRule == MaskRule::kCorners;
using TileEdges = std::conditional_t<kNarrowEdges, NarrowEdges, EdgesInBin>;

__device__ __forceinline__ bool edges_in_bin(const Record& r, int bin_x, int bin_y, NarrowEdges* e) {
  e->bin = {bin_x * kBin, bin_y * kBin};
  return narrow_edges(r, bin_x, bin_y, e->edge);
}

// Whether a tile is to be looked at, and whether it is known that all of its pixels are inside.
struct TileTest {
  bool any, all;
};
__device__ __forceinline__ TileTest test_tile(const NarrowEdges& e, int column, int row) {
  TileTest t = {true, true};
  for (int k = 0; k < 3; ++k) {
    const int32_t f = tile_edge(e.edge[k], column, row);
    t.any = t.any && f + tile_highest(e.edge[k]) >= 0;
    t.all = t.all && f + tile_lowest(e.edge[k]) >= 0;
  }
  return t;
}
__device__ __forceinline__ TileTest test_tile(const EdgesInBin& e, int column, int row) {
  return {touches_tile(e, column, row), fills_tile(e, column, row)};
}

__device__ __forceinline__ bool is_inside(const NarrowEdges& e, int i, int j) {
  int32_t outside = 0;
  for (int k = 0; k < 3; ++k) outside |= e.edge[k].f + i * e.edge[k].sx + j * e.edge[k].sy;
  return outside >= 0;
}

struct TileMasks {
  uint64_t touched, full;
};

// All lanes: two tiles each.
__device__ __forceinline__ TileMasks warp_tile_masks(const Record& r, const TileEdges& edges) {
  unsigned touched[2], full[2];
  for (int half = 0; half < 2; ++half) {
    const int tile = lane_id() + kWarp * half, x = tile % 8, y = tile / 8;
    const TileTest test = test_tile(edges, x, y);
    touched[half] = __ballot_sync(kAllLanes, test.any);
    full[half] = __ballot_sync(kAllLanes, test.all);
  }
  return {((uint64_t)touched[1] << 32 | touched[0]) & allowed_tiles(r, edges.bin), (uint64_t)full[1] << 32 | full[0]};
}

// Counts what warp_tile_masks() has asked, of each edge two corners of all tiles of the bin; and those tiles that the
// record's bounding box meets.
__device__ __forceinline__ void count_tiles(FramePixel pixels, const Record& r, const TileEdges& edges,
                                            const TileMasks& masks) {
  if (!kCounts || lane_id() != 0) return;
  const int boxed = __popcll(allowed_tiles(r, edges.bin));
  count_work(pixels, Counter::tiles_tested, boxed);
  count_work(pixels, Counter::tiles_rejected, boxed - __popcll(masks.touched));
  count_work(pixels, Counter::tiles_accepted, __popcll(masks.touched & masks.full));
  count_work(pixels, Counter::edges_32, 3 * 2 * (kBin / kTile) * (kBin / kTile));
}

// The record within one bin of a view, by a warp; a pixel is read first, since most of what large triangles draw is
// hidden.
__device__ __forceinline__ void warp_draw_bin(FramePixel pixels, int width, const Record& r, int bin_x, int bin_y) {
  TileEdges edges;
  const int counts = kCounts && lane_id() == 0;  // the bin, once
  count_work(pixels, Counter::bins_tested, counts);
  count_work(pixels, Counter::edges_64, 3 * counts);
  if (!edges_in_bin(r, bin_x, bin_y, &edges)) return count_work(pixels, Counter::bins_rejected, counts);
  const TileMasks masks = warp_tile_masks(r, edges);
  count_tiles(pixels, r, edges, masks);
  if (!masks.touched) return;
  const DepthInCell depth = plane_in_cell(r, bin_x, bin_y);
  const bool thin = is_thin(r);
  const int left = bin_x * kBin, top = bin_y * kBin;
  for (uint64_t todo = masks.touched; todo; todo &= todo - 1) {
    const int tile = __ffsll((long long)todo) - 1;
    const bool full = masks.full >> tile & 1;
    const int i = tile % 8 * kTile + (lane_id() & 7);
    if (left + i < r.x0 || left + i >= r.x1) continue;
#pragma unroll
    for (int half = 0; half < 2; ++half) {
      const int j = tile / 8 * kTile + (lane_id() >> 3) + 4 * half;
      if (top + j < r.y0 || top + j >= r.y1) continue;
      count_work(pixels, Counter::edges_32, full ? 0 : 3);
      if (!full && !is_inside(edges, i, j)) continue;
      if constexpr (kCounts) count_fragment(pixels + ((int64_t)(top + j) * width + left + i));
      const float z = thin ? thin_depth(&r, left + i, top + j) : pixel_depth<false>(depth, i, j);
      keep_nearest(pixels + (int64_t)(top + j) * width + left + i, pack_fragment(z, r.triangle), true);
    }
  }
}

// The whole record, by a warp.
__device__ __noinline__ void warp_draw(FramePixel pixels, int width, const Record& r) {
  for (int y = r.y0 / kBin; y <= (r.y1 - 1) / kBin; ++y)
    for (int x = r.x0 / kBin; x <= (r.x1 - 1) / kBin; ++x) warp_draw_bin(pixels, width, r, x, y);
}

// Those of a warp's records that are in `which` (bit k: record k), one after the other.
__device__ __forceinline__ void draw_now(FramePixel pixels, int width, const Record* records, unsigned which) {
  for (; which; which &= which - 1) warp_draw(pixels, width, records[__ffs(which) - 1]);
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

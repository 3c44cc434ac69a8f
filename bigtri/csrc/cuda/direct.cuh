// Drawing at once, onto what is in the frame already, with an atomic minimum a fragment: a warp takes a bin of a
// record, makes 64-bit masks of its tiles, and draws these. Nothing waits, so nothing needs room.
#pragma once

#include "../core/tile_mask.h"
#include "fragment.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

struct TileMasks {
  uint64_t touched, full;
};

// All lanes: two tiles each.
__device__ __forceinline__ TileMasks warp_tile_masks(const Record& r, const NarrowEdge edge[3], int bin_x, int bin_y) {
  unsigned touched[2], full[2];
  for (int half = 0; half < 2; ++half) {
    const int tile = lane_id() + kWarp * half, x = tile % 8, y = tile / 8;
    bool any = true, all = true;
    for (int k = 0; k < 3; ++k) {
      const int32_t f = tile_edge(edge[k], x, y);
      any = any && f + tile_highest(edge[k]) >= 0;
      all = all && f + tile_lowest(edge[k]) >= 0;
    }
    touched[half] = __ballot_sync(kAllLanes, any);
    full[half] = __ballot_sync(kAllLanes, all);
  }
  const uint64_t boxed = bbox_tiles(r.x0 - bin_x * kBin, r.y0 - bin_y * kBin, r.x1 - bin_x * kBin, r.y1 - bin_y * kBin);
  return {((uint64_t)touched[1] << 32 | touched[0]) & boxed, (uint64_t)full[1] << 32 | full[0]};
}

// The record within one bin of a view, by a warp; a pixel is read first, since most of what large triangles draw is
// hidden.
__device__ __forceinline__ void warp_draw_bin(int64_t* pixels, int width, const Record& r, int bin_x, int bin_y) {
  NarrowEdge edge[3];
  if (!narrow_edges(r, bin_x, bin_y, edge)) return;
  const TileMasks masks = warp_tile_masks(r, edge, bin_x, bin_y);
  if (!masks.touched) return;
  const CellPlane plane = cell_plane(r, bin_x, bin_y);
  const bool thin = r.flags & kRecordThin;
  const int left = bin_x * kBin, top = bin_y * kBin;
  for (uint64_t todo = masks.touched; todo; todo &= todo - 1) {
    const int tile = __ffsll((long long)todo) - 1;
    const bool full = masks.full >> tile & 1;
    const int i = tile % 8 * kTile + (lane_id() & 7);
    if (left + i < r.x0 || left + i >= r.x1) continue;
    const double column = plane_column<double>(plane.dzdx, i);
#pragma unroll
    for (int half = 0; half < 2; ++half) {
      const int j = tile / 8 * kTile + (lane_id() >> 3) + 4 * half;
      if (top + j < r.y0 || top + j >= r.y1) continue;
      if (!full) {
        int32_t outside = 0;
        for (int k = 0; k < 3; ++k) outside |= edge[k].f + i * edge[k].sx + j * edge[k].sy;
        if (outside < 0) continue;
      }
      const float z = thin ? thin_depth(&r, left + i, top + j)
                           : finish_depth(plane_row<double>(plane.zcell, plane.dzdy, j) + column, r.zmin, r.zmax);
      keep_nearest(pixels + (int64_t)(top + j) * width + left + i, pack_fragment(z, r.triangle), true);
    }
  }
}

// The whole record, by a warp.
__device__ __noinline__ void warp_draw(int64_t* pixels, int width, const Record& r) {
  for (int y = r.y0 / kBin; y <= (r.y1 - 1) / kBin; ++y)
    for (int x = r.x0 / kBin; x <= (r.x1 - 1) / kBin; ++x) warp_draw_bin(pixels, width, r, x, y);
}

// Those of a warp's records that are in `which` (bit k: record k), one after the other.
__device__ __forceinline__ void draw_now(int64_t* pixels, int width, const Record* records, unsigned which) {
  for (; which; which &= which - 1) warp_draw(pixels, width, records[__ffs(which) - 1]);
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

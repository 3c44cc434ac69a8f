// What every way to draw shares: a record within one bin, and the atomic minimum on a pixel.
#pragma once

#include "../core/scanline.h"
#include "../core/tile_mask.h"
#include "setup.cuh"

namespace bigtri {
namespace {

// A record within one bin. record is read for thin ones alone.
struct Entry {
  CellPlane plane;
  NarrowEdge edge[3];  // from the bin's first pixel
  float zmin, zmax;
  uint32_t triangle, flags;
  const Record* record;
};

// False if an edge rejects the bin.
__device__ __forceinline__ bool narrow_edges(const Record& r, int bin_x, int bin_y, NarrowEdge edge[3]) {
  for (int k = 0; k < 3; ++k) {
    const BinEdge b = bin_edge(edge_of(r.x, r.y, k), bin_x, bin_y);
    if (b.highest < 0) return false;
    edge[k] = narrow(b);
  }
  return true;
}

__device__ __forceinline__ CellPlane cell_plane(const Record& r, int bin_x, int bin_y) {
  return {depth_at(r.x, r.y, r.z, r.area, bin_x * kBin, bin_y * kBin), r.dzdx, r.dzdy};
}

// Of a record that no edge keeps out of the bin.
__device__ __forceinline__ void make_entry(const Record* r, int bin_x, int bin_y, Entry* e) {
  narrow_edges(*r, bin_x, bin_y, e->edge);
  e->plane = cell_plane(*r, bin_x, bin_y);
  e->zmin = r->zmin;
  e->zmax = r->zmax;
  e->triangle = r->triangle;
  e->flags = r->flags;
  e->record = r;
}

// Extremes of f over the centres from (x, y) to (x + last_x, y + last_y) of the bin.
__device__ __forceinline__ int32_t highest_over(const NarrowEdge& e, int x, int y, int last_x, int last_y) {
  return e.f + (e.sx > 0 ? x + last_x : x) * e.sx + (e.sy > 0 ? y + last_y : y) * e.sy;
}
__device__ __forceinline__ int32_t lowest_over(const NarrowEdge& e, int x, int y, int last_x, int last_y) {
  return e.f + (e.sx < 0 ? x + last_x : x) * e.sx + (e.sy < 0 ? y + last_y : y) * e.sy;
}

__device__ __forceinline__ float bound_depth(const Entry& e, int x, int y, int last_x, int last_y, bool farthest) {
  if (e.flags & kRecordThin) return farthest ? e.zmax : e.zmin;
  return corner_depth(e.plane, e.zmin, e.zmax, x, y, last_x, last_y, farthest);
}

// Depth of pixel (x, y) of the image of a thin record. A call, so that its registers cost the others nothing.
__device__ __noinline__ float thin_depth(const Record* r, int x, int y) { return finish_depth(depth_at(r->x, r->y, r->z, r->area, x, y), r->zmin, r->zmax); }

// 64 bits at once; the background is the same minimum signed and unsigned.
__device__ __forceinline__ void keep_nearest(int64_t* pixel, int64_t packed, bool read_first) {
  if (read_first && __ldcg(pixel) <= packed) return;
  atomicMin(reinterpret_cast<unsigned long long*>(pixel), (unsigned long long)packed);
}

}  // namespace
}  // namespace bigtri

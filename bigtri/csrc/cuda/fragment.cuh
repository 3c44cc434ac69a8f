// What every way to draw shares: a record within one bin, and the atomic minimum on a pixel.
#pragma once

#include "../core/scanline.h"
#include "../core/tile_mask.h"
#include "setup.cuh"

namespace bigtri {
namespace {

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

// A record within one bin.
struct Entry {
  CellPlane plane;
  NarrowEdge edge[3];  // from the bin's first pixel
  float zmin, zmax;
  uint32_t triangle;
  uint32_t info;  // slot of the record << 4 | whether it covers the area entered for << 3 | its flags
  float nearest;  // for those who keep it here

  __device__ __forceinline__ bool thin() const { return info & kRecordThin; }
  __device__ __forceinline__ bool far() const { return info & kRecordFar; }
  __device__ __forceinline__ bool full() const { return info & kEntryFull; }
  __device__ __forceinline__ uint32_t slot() const { return info >> 4; }
  static constexpr uint32_t kEntryFull = 8;
};
static_assert(kRecordLarge < 8 && kRecordThin < 8 && kRecordFar < 8, "flags fit beside the slot");

// A depth that every record's is below, though not infinite.
constexpr float kHuge = 1e30f;

// What a record and an area of a bin have to do with each other: it misses it, or its nearest depth there, and the farthest where it covers all of it and so hides what lies behind, else infinity.
struct Meeting {
  bool meets;
  float nearest, farthest;
};

// Makes the entry of a record for the bin if it meets the area of it, px from the bin's corner. Extremes in int64: an edge far away does not fit 32 bits; one that crosses the bin does.
__device__ __forceinline__ Meeting enter_bin(const Record& r, uint32_t slot, int bin_x, int bin_y, int left, int top, int columns, int rows, Entry* e) {
  bool full = true;
  double g[3];
  for (int k = 0; k < 3; ++k) {
    const Edge edge = edge_of(r.x, r.y, k);
    const int64_t value = edge_value(edge, pixel_centre(bin_x * kBin), pixel_centre(bin_y * kBin));
    BinEdge b;
    b.sx = -edge.dy;
    b.sy = edge.dx;
    b.f = (value + edge_bias(edge)) >> kSubpixelBits;
    b.lowest = lowest_of(b.f, b.sx, b.sy, kBin - 1);
    const int64_t first = b.f + (int64_t)left * b.sx + (int64_t)top * b.sy;
    if (first + (int64_t)(columns - 1) * max_of(b.sx, 0) + (int64_t)(rows - 1) * max_of(b.sy, 0) < 0) return {false, 0.0f, 0.0f};
    full = full && first + (int64_t)(columns - 1) * min_of(b.sx, 0) + (int64_t)(rows - 1) * min_of(b.sy, 0) >= 0;
    e->edge[k] = narrow(b);
    g[k] = (double)value;
  }
  e->zmin = r.zmin;
  e->zmax = r.zmax;
  e->triangle = r.triangle;
  e->info = slot << 4 | (full ? Entry::kEntryFull : 0) | r.flags;
  const bool hides = full && !(r.flags & kRecordFar);
  if (r.flags & kRecordThin) return {true, r.zmin, hides ? r.zmax : kInfinity};
  const CellPlane plane = {weighted_depth<double, double, double>(g[0], g[1], g[2], r.z[0], r.z[1], r.z[2], (double)r.area), r.dzdx, r.dzdy};
  e->plane = plane;
  return {true, corner_depth(plane, r.zmin, r.zmax, left, top, columns - 1, rows - 1, false),
          hides ? corner_depth(plane, r.zmin, r.zmax, left, top, columns - 1, rows - 1, true) : kInfinity};
}

// Extremes of f over the centres from (x, y) to (x + last_x, y + last_y) of the bin.
__device__ __forceinline__ int32_t highest_over(const NarrowEdge& e, int x, int y, int last_x, int last_y) {
  return e.f + (e.sx > 0 ? x + last_x : x) * e.sx + (e.sy > 0 ? y + last_y : y) * e.sy;
}
__device__ __forceinline__ int32_t lowest_over(const NarrowEdge& e, int x, int y, int last_x, int last_y) {
  return e.f + (e.sx < 0 ? x + last_x : x) * e.sx + (e.sy < 0 ? y + last_y : y) * e.sy;
}

__device__ __forceinline__ float bound_depth(const Entry& e, int x, int y, int last_x, int last_y, bool farthest) {
  if (e.thin()) return farthest ? e.zmax : e.zmin;
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

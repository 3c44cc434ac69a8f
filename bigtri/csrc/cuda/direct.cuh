// Drawing at once, with an atomic minimum a fragment, on a frame that has been cleared: four lanes for a small triangle, a warp for anything else. Nothing waits,
// so nothing needs room.
#pragma once

#include "fragment.cuh"

namespace bigtri {
namespace {

// --- A warp a bin of a record: 64-bit masks of the tiles first, then the tiles.

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

// The record within one bin, by a warp; a pixel is read first, since most of what large triangles draw is hidden.
__device__ __forceinline__ void warp_draw_bin(const Frame& f, const Record& r, int bin_x, int bin_y) {
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
      const float z = thin ? thin_depth(&r, left + i, top + j) : finish_depth(plane_row<double>(plane.zcell, plane.dzdy, j) + column, r.zmin, r.zmax);
      keep_nearest(f.packed + (int64_t)(top + j) * f.view.width + left + i, pack_fragment(z, r.triangle), true);
    }
  }
}

// The whole record, by a warp.
__device__ __noinline__ void warp_draw(const Frame& f, const Record& r) {
  for (int y = r.y0 / kBin; y <= (r.y1 - 1) / kBin; ++y)
    for (int x = r.x0 / kBin; x <= (r.x1 - 1) / kBin; ++x) warp_draw_bin(f, r, x, y);
}

// --- Slivers: a lane a line of pixels along the longer side, which meets few of them.

constexpr int kSliverLines = 64;  // px; shorter ones are not worth a block
constexpr int kSliverWidth = 4;  // px, on average, at most

__device__ __forceinline__ bool is_sliver(const Primitive& p) {
  return max_of(p.x1 - p.x0, p.y1 - p.y0) >= kSliverLines && p.area <= 2 * kSliverWidth * kSubpixel * extent_of(p);
}

// By threads [0, count) of whom this is the one given.
__device__ __forceinline__ void draw_sliver(const Frame& f, const Record& r, int thread, int count) {
  const bool wide = r.x1 - r.x0 >= r.y1 - r.y0;  // a line is a column of the image, else a row
  const int lines = wide ? r.x1 - r.x0 : r.y1 - r.y0;
  for (int n = thread; n < lines; n += count) {
    const int x = wide ? r.x0 + n : r.x0, y = wide ? r.y0 : r.y0 + n;
    int64_t lower = 0, upper = wide ? r.y1 - r.y0 : r.x1 - r.x0;
    for (int k = 0; k < 3; ++k) {
      const Edge e = edge_of(r.x, r.y, k);
      cut_span(edge_steps(e, x, y), wide ? e.dx : -e.dy, &lower, &upper);
    }
    int cell_x = -1, cell_y = -1;
    CellPlane plane;
    for (int64_t at = lower; at < upper; ++at) {
      const int px = wide ? x : x + (int)at, py = wide ? y + (int)at : y;
      float z;
      if (r.flags & kRecordThin) {
        z = thin_depth(&r, px, py);
      } else {
        if (px / kBin != cell_x || py / kBin != cell_y) {
          cell_x = px / kBin;
          cell_y = py / kBin;
          plane = cell_plane(r, cell_x, cell_y);
        }
        z = finish_depth(plane_row<double>(plane.zcell, plane.dzdy, py % kBin) + plane_column<double>(plane.dzdx, px % kBin), r.zmin, r.zmax);
      }
      keep_nearest(f.packed + (int64_t)py * f.view.width + px, pack_fragment(z, r.triangle), false);
    }
  }
}

// --- Small triangles: four lanes take the pixels of an aligned sector of 32 bytes, since an atomic on several of its pixels costs no more than on one.

constexpr int kSmallSide = 16;  // px
constexpr int kSectorPixels = 4;

// A small record within one cell, in a warp's shared memory: a column a job.
struct Jobs {
  int32_t f[3][kWarp], sx[3][kWarp], sy[3][kWarp];  // f at (x0 & ~3, y0)
  uint32_t columns[kWarp], rows[kWarp];  // first and end, px, 16 bits each
  double zcell[kWarp], dzdx[kWarp], dzdy[kWarp];
  float zmin[kWarp], zmax[kWarp];
  uint32_t triangle[kWarp];
};

__device__ __forceinline__ bool is_small(const Primitive& p) {
  return p.x1 - p.x0 <= kSmallSide && p.y1 - p.y0 <= kSmallSide && extent_of(p) <= kDirectExtent && !is_thin(p.x, p.y, p.area);
}

// Draws the lanes' small primitives, a cell of each at a time. All lanes; have: whether this one has any.
__device__ __forceinline__ void draw_small(const Frame& f, const Primitive& p, uint32_t triangle, bool have, Jobs* jobs, bool read_first) {
  int cells = 0, across = 1;
  DepthGradient g = {0.0, 0.0};
  float zmin = 0.0f, zmax = 0.0f;
  if (have) {
    across = (p.x1 - 1) / kBin - p.x0 / kBin + 1;
    cells = across * ((p.y1 - 1) / kBin - p.y0 / kBin + 1);
    g = depth_gradient(p.x, p.y, p.z, p.area);
    zmin = min_of(min_of(p.z[0], p.z[1]), p.z[2]);
    zmax = max_of(max_of(p.z[0], p.z[1]), p.z[2]);
  }
  for (int c = 0;; ++c) {
    const unsigned some = __ballot_sync(kAllLanes, c < cells);
    if (!some) return;
    if (c < cells) {
      const int slot = __popc(some & lanes_below());
      const int cell_x = p.x0 / kBin + (c >= across ? c - across : c), cell_y = p.y0 / kBin + (c >= across ? 1 : 0);
      const int x0 = max_of(p.x0, cell_x * kBin), x1 = min_of(p.x1, (cell_x + 1) * kBin);
      const int y0 = max_of(p.y0, cell_y * kBin), y1 = min_of(p.y1, (cell_y + 1) * kBin);
      for (int k = 0; k < 3; ++k) {
        const Edge e = edge_of(p.x, p.y, k);
        jobs->f[k][slot] = (int32_t)edge_steps(e, x0 & ~(kSectorPixels - 1), y0);
        jobs->sx[k][slot] = (int32_t)-e.dy;
        jobs->sy[k][slot] = (int32_t)e.dx;
      }
      jobs->columns[slot] = (uint32_t)x0 | (uint32_t)x1 << 16;
      jobs->rows[slot] = (uint32_t)y0 | (uint32_t)y1 << 16;
      jobs->zcell[slot] = depth_at(p.x, p.y, p.z, p.area, cell_x * kBin, cell_y * kBin);
      jobs->dzdx[slot] = g.dzdx;
      jobs->dzdy[slot] = g.dzdy;
      jobs->zmin[slot] = zmin;
      jobs->zmax[slot] = zmax;
      jobs->triangle[slot] = triangle;
    }
    __syncwarp();
    const int count = __popc(some);
    for (int j = lane_id() / kSectorPixels; j < count; j += kWarp / kSectorPixels) {
      const int x0 = (int)(jobs->columns[j] & 0xffff), x1 = (int)(jobs->columns[j] >> 16), y0 = (int)(jobs->rows[j] & 0xffff), y1 = (int)(jobs->rows[j] >> 16);
      const int start = x0 & ~(kSectorPixels - 1);
      for (int x = start + lane_id() % kSectorPixels; x < x1; x += kSectorPixels) {
        if (x < x0) continue;
        int32_t at[3];
        for (int k = 0; k < 3; ++k) at[k] = jobs->f[k][j] + (x - start) * jobs->sx[k][j];
        const double column = plane_column<double>(jobs->dzdx[j], x % kBin);
        double line = y0 % kBin;
        int64_t* pixel = f.packed + (int64_t)y0 * f.view.width + x;
        for (int y = y0; y < y1; ++y, pixel += f.view.width, line += 1.0) {
          if ((at[0] | at[1] | at[2]) >= 0) {
            const float z = finish_depth(plane_row<double>(jobs->zcell[j], jobs->dzdy[j], line) + column, jobs->zmin[j], jobs->zmax[j]);
            keep_nearest(pixel, pack_fragment(z, jobs->triangle[j]), read_first);
          }
          for (int k = 0; k < 3; ++k) at[k] += jobs->sy[k][j];
        }
      }
    }
    __syncwarp();
  }
}

// --- The frame

// Background everywhere, and zeros in the counters.
__global__ void clear_frame(Frame f, uint32_t* counters, int counter_count) {
  const int64_t n = (int64_t)f.view.width * f.view.height, stride = (int64_t)gridDim.x * blockDim.x, first = (int64_t)blockIdx.x * blockDim.x + threadIdx.x;
  if (((uintptr_t)f.packed & 15) == 0) {
    for (int64_t i = first; i < n / 2; i += stride) reinterpret_cast<longlong2*>(f.packed)[i] = make_longlong2(kBackground, kBackground);
    if (first == 0 && n % 2) f.packed[n - 1] = kBackground;
  } else {
    for (int64_t i = first; i < n; i += stride) f.packed[i] = kBackground;
  }
  if (first == 0) *f.dropped = 0;
  if (first < counter_count) counters[first] = 0;
}

// The depth image of a finished frame.
__global__ void write_depth(Frame f) {
  const int64_t n = (int64_t)f.view.width * f.view.height, stride = (int64_t)gridDim.x * blockDim.x;
  for (int64_t i = (int64_t)blockIdx.x * blockDim.x + threadIdx.x; i < n; i += stride) f.depth[i] = depth_of(f.packed[i]);
}

}  // namespace
}  // namespace bigtri

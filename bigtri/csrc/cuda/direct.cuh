// Drawing at once, with an atomic minimum a fragment, on a frame that has been cleared. Nothing waits, so nothing needs room.
#pragma once

#include "fragment.cuh"
#include "launch.cuh"

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

// --- The frame

// Background everywhere, zeros, and the vertices projected where there is room for them: by blocks of their own, spread evenly among the others, since one is bound by memory and the other
// by arithmetic.
constexpr int kClearThreads = 256, kVerticesEach = 2;
constexpr int kClearPixels = 16 * kClearThreads, kProjectVertices = kVerticesEach * kClearThreads;  // of a block

__global__ void __launch_bounds__(kClearThreads, 4) clear_frame(const __grid_constant__ Frame f, Vertex* projected, int projecting_blocks, Zeros zeros) {
  let_next_begin();
  const int thread = threadIdx.x, projecting = (int)((int64_t)blockIdx.x * projecting_blocks / gridDim.x);  // blocks before this one
  if ((int64_t)(blockIdx.x + 1) * projecting_blocks / gridDim.x > projecting) {
    project_vertices<kVerticesEach>(f, (int64_t)projecting * kProjectVertices + thread, kClearThreads, [&](const Vertex& p, int64_t i) {
      reinterpret_cast<int4*>(projected)[i] = make_int4(p.x, p.y, __float_as_int(p.z), (int)p.flags);
    });
    return;
  }
  // From the end to the beginning: triangles mostly come from the top of the image, which then is what the cache still holds.
  const int block = (int)gridDim.x - projecting_blocks - 1 - ((int)blockIdx.x - projecting);
  const int64_t n = (int64_t)f.view.width * f.view.height, first = (int64_t)block * kClearPixels, end = min_of(first + kClearPixels, n);
  if (((uintptr_t)f.packed & 15) == 0) {
    for (int64_t i = first + 2 * thread; i + 1 < end; i += 2 * kClearThreads)
      *reinterpret_cast<longlong2*>(f.packed + i) = make_longlong2(kBackground, kBackground);
    if (thread == 0 && end == n && n % 2) f.packed[n - 1] = kBackground;
  } else {
    for (int64_t i = first + thread; i < end; i += kClearThreads) f.packed[i] = kBackground;
  }
  zeros.set(block * kClearThreads + thread, ((int)gridDim.x - projecting_blocks) * kClearThreads);
  if (block == 0 && thread == 0) *f.dropped = 0;
}

// The depth image of a finished frame.
__global__ void write_depth(const __grid_constant__ Frame f) {
  wait_for_previous();
  const int64_t n = (int64_t)f.view.width * f.view.height, stride = (int64_t)gridDim.x * blockDim.x;
  for (int64_t i = (int64_t)blockIdx.x * blockDim.x + threadIdx.x; i < n; i += stride) f.depth[i] = depth_of(f.packed[i]);
}

// Room for the projected vertices, or null: projecting each once pays where triangles share them, not where most are left out.
Vertex* take_projected(Scratch* scratch, const Frame& f) {
  if (f.vertices > 2 * (int64_t)f.count) return nullptr;
  return scratch->take<Vertex>(f.vertices);
}

// A frame's first kernel.
cudaError_t launch_clear(const Frame& f, Vertex* projected, const Zeros& zeros, cudaStream_t stream) {
  const int64_t clearing = ((int64_t)f.view.width * f.view.height + kClearPixels - 1) / kClearPixels;
  const int64_t projecting = projected ? (f.vertices + kProjectVertices - 1) / kProjectVertices : 0;
  return launch_first(clear_frame, projecting + clearing, kClearThreads, 0, stream, f, projected, (int)projecting, zeros);
}

// Its last one, where a depth image is wanted.
cudaError_t launch_depth(const Frame& f, const Tuning& t, cudaStream_t stream) {
  if (!f.depth) return cudaSuccess;
  int blocks;
  BIGTRI_CUDA(blocks_for(write_depth, 256, 0, ((int64_t)f.view.width * f.view.height + 255) / 256, t, &blocks));
  return launch_next(write_depth, blocks, 256, 0, stream, f);
}

// For kernels in which a warp sets up `share` triangles: as many as it has lanes, or fewer where triangles are fewer, so that there are warps enough.
template <class Kernel>
cudaError_t share_triangles(Kernel kernel, int threads, int64_t triangles, int* share, int64_t* blocks) {
  int resident;
  BIGTRI_CUDA(resident_blocks(reinterpret_cast<const void*>(kernel), threads, 0, &resident));
  const int64_t warps = (int64_t)resident * (threads / kWarp);
  *share = kWarp;
  while (*share > 1 && triangles / *share < warps) *share /= 2;
  const int64_t each = (int64_t)(threads / kWarp) * *share;
  *blocks = (triangles + each - 1) / each;
  return cudaSuccess;
}

}  // namespace
}  // namespace bigtri

// Small triangles on a patch that a block owns: its warps draw them by rows, as rows.cuh does onto the whole image. By regions
// a warp would go through what its region shows one after the other, and of a small triangle most of its lanes have no pixel.
// Pixels are merged in memory, where atomic minima of 64 bits take less time than in shared memory.
#pragma once

#include "region.cuh"
#include "rows.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// A row of an entry that has pixels: the entry, the row of the patch, and what is added to the number of a pixel, counted over
// a warp's rows, to get its column of the bin: mostly less than 0.
__device__ __forceinline__ uint32_t pack_span(int entry, int row, int shift) {
  return (uint32_t)entry << 18 | (uint32_t)row << 12 | (uint32_t)(shift + kWarp * kBin);
}
__device__ __forceinline__ int entry_of(uint32_t span) { return (int)(span >> 18); }
__device__ __forceinline__ int row_of(uint32_t span) { return (int)(span >> 12 & (kBin - 1)); }
__device__ __forceinline__ int shift_of(uint32_t span) { return (int)(span & 0xfff) - kWarp * kBin; }
static_assert(kWarp * kBin + kBin <= 1 << 12 && kBin <= 1 << 6, "there is room for the row and the shift");

// Depth of pixel (i, j) of the bin of an entry that is not thin, which is (px, py) of the image; used: whether anybody asks
// for it.
__device__ __forceinline__ float depth_in_bin(const Entry& e, int i, int j, bool, int, int, const Record*) {
  return finish_depth(plane_row<DepthNumber>(e.plane.zcell, e.plane.dzdy, place_in_cell(j)) +
                          plane_column<DepthNumber>(e.plane.dzdx, place_in_cell(i)),
                      e.zmin, e.zmax);
}
__device__ __forceinline__ float depth_in_bin(const PairEntry& e, int i, int j, bool used, int px, int py,
                                              const Record* records) {
  float z;
  if (pair_depth(pair_at(e.z, e.dzdy, exact_float(j)), e.dzdx, exact_float(i), e.error, &z) || !used)
    return clamp_depth(z, e.zmin, e.zmax);
  return undecided_depth_of(records + e.slot(), px, py);
}

// Where in the image a block draws, and what.
struct PatchRows {
  FramePixel pixels;  // the patch's first
  int width;  // of the image, px
  int left, top;  // px
  const PatchEntry* entries;
  const Record* records;
  uint32_t* spans;  // kWarp of them, the warp's own
};

// Draws pixels first, first + 1, ... of the `total` pixels of the rows in p.spans, of which each lane in `have` has one,
// beginning at pixel `begin`: kGroups for each lane, so that one does not wait for the other. By all lanes.
template <int kGroups>
__device__ __forceinline__ void draw_span_pixels(const PatchRows& p, int first, int total, int begin, bool have,
                                                 unsigned lanes_to_here) {
  uint32_t at[kGroups];
  int64_t packed[kGroups];
  bool seen[kGroups];
#pragma unroll
  for (int g = 0; g < kGroups; ++g) {
    const int n = first + g * kWarp;
    const uint32_t span = p.spans[interval_at(n, begin, have, lanes_to_here)];
    const PatchEntry& e = p.entries[entry_of(span)];
    const int row = row_of(span), i = n + lane_id() + shift_of(span);
    const bool used = n + lane_id() < total;
    const float z = depth_in_bin(e, i, (p.top & (kBin - 1)) + row, used, p.left + i, p.top + row, p.records);
    seen[g] = used && z <= 1.0f;
    packed[g] = pack_depth(z, e.triangle);
    at[g] = (uint32_t)(row * p.width + i);
    if constexpr (kCounts)
      if (used) count_fragment(p.pixels + at[g]);
  }
#pragma unroll
  for (int g = 0; g < kGroups; ++g)
    if (seen[g]) keep_nearest(p.pixels + at[g], packed[g], false);
}

// Pixels [span.lower, span.upper) of a row of a thin entry, by its lane alone: mostly there are few.
__device__ __noinline__ void draw_thin_span(const PatchRows& p, const PatchEntry& e, int row, RowSpan span) {
#pragma unroll 1
  for (int i = span.lower; i < span.upper; ++i) {
    const float z = thin_depth(p.records + e.slot(), p.left + i, p.top + row);
    if constexpr (kCounts) count_fragment(p.pixels + (row * p.width + i));
    keep_nearest(p.pixels + (row * p.width + i), pack_fragment(z, e.triangle), false);
  }
}

// Draws the `count` entries of a list onto a patch of kRows rows, whose pixels have been set: a lane a row of one of them,
// then a pixel of any row. By all of kThreads threads. A call, so that its registers cost the others nothing.
template <int kRows, int kThreads>
__device__ __noinline__ void draw_patch_rows(const Frame& f, int left, int top, const PatchEntry* entries,
                                             const uint16_t* list, int count, const Record* records, uint32_t* spans) {
  const int lane = lane_id(), in_bin = top & (kBin - 1);
  const unsigned lanes_to_here = (2u << lane) - 1;
  const PatchRows p = {
      first_pixel(f, 0) + ((int64_t)top * f.view.width + left), f.view.width, left, top, entries, records, spans};
  const RowSpan on_screen = {max_of(f.view.x0 - left, 0), min_of(f.view.x1 - left, kBin)};
#pragma unroll 1
  for (int first = (int)threadIdx.x - lane; first < count * kRows; first += kThreads) {
    const bool have = first + lane < count * kRows;
    const int entry = list[have ? (first + lane) / kRows : 0], row = (first + lane) % kRows;
    const PatchEntry& e = entries[entry];
    RowSpan span = {0, 0};
    if (have && top + row >= f.view.y0 && top + row < f.view.y1) {
      span = on_screen;
      count_work(f, Counter::rows, 1);
      count_work(f, Counter::edges_32, 3);
#pragma unroll
      for (int k = 0; k < 3; ++k) cut_row<kBin - 1>(e.edge[k].f + (in_bin + row) * e.edge[k].sy, e.edge[k].sx, &span);
    }
    const bool thin = e.thin();
    if (thin) draw_thin_span(p, e, row, span);
    const int length = thin ? 0 : max_of(span.upper - span.lower, 0), end = warp_sum_up_to(length),
              begin = end - length, total = __shfl_sync(kAllLanes, end, kWarp - 1);
    const bool any = length > 0;
    const unsigned filled = __ballot_sync(kAllLanes, any);
    if (any) spans[__popc(filled & lanes_to_here) - 1] = pack_span(entry, row, span.lower - begin);
    __syncwarp();
    int pixel = 0;
#pragma unroll 1
    for (; pixel + kWarp < total; pixel += 2 * kWarp) draw_span_pixels<2>(p, pixel, total, begin, any, lanes_to_here);
    if (pixel < total) draw_span_pixels<1>(p, pixel, total, begin, any, lanes_to_here);
    __syncwarp();
  }
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

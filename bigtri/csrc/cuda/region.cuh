// Owned pixels: a warp owns 16x16 px, a lane 8 of them in registers, and writes each once: no clear, no atomics.
#pragma once

#include "fragment.cuh"

namespace bigtri {
namespace {

constexpr int kRegion = 16;       // px
constexpr int kLanePixels = 8;    // two next to each other in each of four rows, four rows apart

// Whether two pixels can be stored at once wherever x is even.
__device__ __forceinline__ bool wide_rows(const Frame& f) { return f.view.width % 2 == 0 && ((uintptr_t)f.packed & 15) == 0; }

// In one instruction: the compiler would make two of most.
__device__ __forceinline__ void store_pair(int64_t* to, int64_t a, int64_t b) {
  asm volatile("st.global.v2.s64 [%0], {%1, %2};" ::"l"(to), "l"(a), "l"(b) : "memory");
}

// The same number, which the compiler can compute nothing from before this place: what would wait in a register, or out of one, while a region is drawn.
__device__ __forceinline__ int computed_here(int v) {
  asm volatile("" : "+r"(v));
  return v;
}

// A lane's pixels, and drawing into them.
struct Region {
  int64_t best[kLanePixels];
  int bin_x, bin_y, x, y;  // x, y: of the region, px from the bin's corner
  float far;     // behind this depth nothing of the region can be seen
  uint32_t cut;  // bits of the lane's pixels that the scissor leaves

  __device__ __forceinline__ int lane_x() const { return x + 2 * (lane_id() & 7); }
  __device__ __forceinline__ int lane_y() const { return y + (lane_id() >> 3); }

  __device__ __forceinline__ void begin(const Frame& f, int in_bin_x, int in_bin_y, int at_x, int at_y, float far_depth) {
    bin_x = in_bin_x;
    bin_y = in_bin_y;
    x = at_x;
    y = at_y;
    far = far_depth;
    cut = (1u << kLanePixels) - 1;
    for (int i = 0; i < kLanePixels; ++i) best[i] = kBackground;
    const int left = bin_x * kBin + x, top = bin_y * kBin + y;
    if (left >= f.view.x0 && left + kRegion <= f.view.x1 && top >= f.view.y0 && top + kRegion <= f.view.y1) return;
    for (int i = 0; i < kLanePixels; ++i) {
      const int px = bin_x * kBin + lane_x() + i % 2, py = bin_y * kBin + lane_y() + i / 2 * 4;
      if (px < f.view.x0 || px >= f.view.x1 || py < f.view.y0 || py >= f.view.y1) cut &= ~(1u << i);
    }
  }

  __device__ __forceinline__ void draw(const Entry& e, bool full, const Record* records) {
    uint32_t covered = cut;
    const int i = lane_x(), j = lane_y();
    if (!full) {
      int32_t at[3], step[3];
      for (int k = 0; k < 3; ++k) {
        at[k] = e.edge[k].f + i * e.edge[k].sx + j * e.edge[k].sy;
        step[k] = 4 * e.edge[k].sy;
      }
      uint32_t inside = 0;
#pragma unroll
      for (int row = 0; row < 4; ++row) {
        const int32_t left = at[0] | at[1] | at[2], right = (at[0] + e.edge[0].sx) | (at[1] + e.edge[1].sx) | (at[2] + e.edge[2].sx);
        inside |= (left >= 0 ? 1u : 0u) << (2 * row) | (right >= 0 ? 2u : 0u) << (2 * row);
        for (int k = 0; k < 3; ++k) at[k] += step[k];
      }
      covered &= inside;
    }
    if (e.thin() || e.far()) return draw_special(e, covered, records);
    const double column = i, line = j;  // sums of small integers are exact, and cheaper than conversions
    const double left = plane_column<double>(e.plane.dzdx, column), right = plane_column<double>(e.plane.dzdx, column + 1.0);
#pragma unroll
    for (int row = 0; row < 4; ++row) {
      const double start = plane_row<double>(e.plane.zcell, e.plane.dzdy, line + 4.0 * row);
#pragma unroll
      for (int c = 0; c < 2; ++c) {
        const int64_t packed = (int64_t)((uint64_t)float_bits(finish_depth(start + (c ? right : left), e.zmin, e.zmax)) << 32 | e.triangle);
        const int n = 2 * row + c;
        if (covered >> n & 1 && packed < best[n]) best[n] = packed;
      }
    }
  }

  // Thin records, and those that reach beyond z = 1. Not unrolled, but for the choice of the register.
  __device__ __forceinline__ void draw_special(const Entry& e, uint32_t covered, const Record* records) {
#pragma unroll 1
    for (int n = 0; n < kLanePixels; ++n) {
      if (!(covered >> n & 1)) continue;
      const int i = lane_x() + n % 2, j = lane_y() + n / 2 * 4;
      const float z = e.thin() ? thin_depth(records + e.slot(), bin_x * kBin + i, bin_y * kBin + j)
                               : finish_depth(plane_row<double>(e.plane.zcell, e.plane.dzdy, j) + plane_column<double>(e.plane.dzdx, i), e.zmin, e.zmax);
      const int64_t packed = pack_fragment(z, e.triangle);
#pragma unroll
      for (int m = 0; m < kLanePixels; ++m)
        if (m == n) best[m] = min_of(best[m], packed);
    }
  }

  // Calls use(index in best, offset in the image) for the lane's pixels on the screen.
  template <class Use>
  __device__ __forceinline__ void each(const Frame& f, const Use& use) const {
    const int px = computed_here(bin_x * kBin + lane_x()), top = computed_here(bin_y * kBin + lane_y());
#pragma unroll
    for (int row = 0; row < 4; ++row) {
      const int py = top + 4 * row;
      if (py >= f.view.height) break;
      const int64_t at = (int64_t)py * f.view.width + px;
      if (px < f.view.width) use(2 * row, at);
      if (px + 1 < f.view.width) use(2 * row + 1, at + 1);
    }
  }

  __device__ __forceinline__ void load(const Frame& f) {
    each(f, [&](int n, int64_t at) { best[n] = f.packed[at]; });
  }

  __device__ __forceinline__ void store(const Frame& f) const {
    const int px = computed_here(bin_x * kBin + lane_x()), py = computed_here(bin_y * kBin + lane_y());
    if (wide_rows(f)) {
      int64_t* to = f.packed + (int64_t)py * f.view.width + px;
#pragma unroll
      for (int row = 0; row < 4; ++row, to += 4 * (int64_t)f.view.width)
        if (px < f.view.width && py + 4 * row < f.view.height) store_pair(to, best[2 * row], best[2 * row + 1]);
    } else {
      each(f, [&](int n, int64_t at) { f.packed[at] = best[n]; });
    }
    if (f.depth) each(f, [&](int n, int64_t at) { f.depth[at] = depth_of(best[n]); });
  }

  // Where others draw at the same time.
  __device__ __forceinline__ void merge(const Frame& f) const {
    each(f, [&](int n, int64_t at) {
      if (best[n] != kBackground) keep_nearest(f.packed + at, best[n], false);
    });
  }
};

}  // namespace
}  // namespace bigtri

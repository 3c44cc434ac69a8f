// Owned pixels: a warp owns 16x16 px or fewer rows of them, a lane 8 or fewer in registers, and stores each once: no
// clear, no atomics. Where others draw at the same time, it merges each with one atomic minimum instead.
#pragma once

#include "fragment.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr int kRegion = 16;  // px

// In one instruction: the compiler would make two of most. Streaming: nobody here reads them again, and lines that
// leave the cache first in the order in which they came are written out faster.
__device__ __forceinline__ void store_pair(int64_t* to, int64_t a, int64_t b) {
  asm volatile("st.global.cs.v2.s64 [%0], {%1, %2};" ::"l"(to), "l"(a), "l"(b) : "memory");
}

// Whether two pixels can be stored at once wherever x is even.
__device__ __forceinline__ bool wide_rows(const Frame& f) {
  return ((computed_here(f.view.width) & 1) | (computed_here((int)(uintptr_t)f.packed) & 15)) == 0;
}

// A pixel's place in its view: below 2^28, and 2^29 for those beyond its edges.
__device__ __forceinline__ uint32_t offset_of(const Frame& f, int x, int y) { return (uint32_t)(y * f.view.width + x); }

// A lane's pixels, and drawing into them: two next to each other in each of kLaneRows rows, four rows apart.
template <int kLaneRows>
struct RegionOf {
  static constexpr int kHeight = 4 * kLaneRows, kPixels = 2 * kLaneRows;  // px: of the region, of a lane
  int64_t best[kPixels];
  int left, top;  // px
  float bound;  // behind this depth nothing of the region can be seen
  uint32_t cut;  // bits of the lane's pixels that the scissor leaves, the first one highest

  static __device__ __forceinline__ uint32_t bit_of(int n) { return 1u << (kPixels - 1 - n); }
  // px from the bin's corner
  __device__ __forceinline__ int x() const { return left & (kBin - 1); }
  __device__ __forceinline__ int y() const { return top & (kBin - 1); }
  // The lane's first pixel, px
  __device__ __forceinline__ int lane_left() const { return left + 2 * (lane_id() & 7); }
  __device__ __forceinline__ int lane_top() const { return top + (lane_id() >> 3); }

  // Whether the scissor leaves all of it.
  __device__ __forceinline__ bool whole(const Frame& f) const {
    return left >= f.view.x0 && left + kRegion <= f.view.x1 && top >= f.view.y0 && top + kHeight <= f.view.y1;
  }

  __device__ __forceinline__ void clear() {
    for (int i = 0; i < kPixels; ++i) best[i] = kBackground;
  }

  // Before draw().
  __device__ __forceinline__ void begin(const Frame& f) {
    cut = (1u << kPixels) - 1;
    if (whole(f)) return;
    for (int i = 0; i < kPixels; ++i) {
      const int px = lane_left() + i % 2, py = lane_top() + i / 2 * 4;
      if (px < f.view.x0 || px >= f.view.x1 || py < f.view.y0 || py >= f.view.y1) cut &= ~bit_of(i);
    }
  }

  // first: nothing has been drawn here yet.
  template <class E>
  __device__ __forceinline__ void draw(const E& e, bool full, bool first, const Record* records) {
    uint32_t covered = cut;
    const int i = lane_left() & (kBin - 1), j = lane_top() & (kBin - 1);
    if (!full) {
      int32_t at[3], step[3];
      for (int k = 0; k < 3; ++k) {
        at[k] = e.edge[k].f + i * e.edge[k].sx + j * e.edge[k].sy;
        step[k] = 4 * e.edge[k].sy;
      }
      uint32_t outside = 0;
#pragma unroll
      for (int row = 0; row < kLaneRows; ++row) {
        const int32_t left = at[0] | at[1] | at[2],
                      right = (at[0] + e.edge[0].sx) | (at[1] + e.edge[1].sx) | (at[2] + e.edge[2].sx);
        outside = __funnelshift_l((uint32_t)right, __funnelshift_l((uint32_t)left, outside, 1), 1);  // sign bits
        for (int k = 0; k < 3; ++k) at[k] += step[k];
      }
      covered &= ~outside;
    }
    if (e.thin() || e.far()) return draw_special(e, covered, records);
    uint32_t undecided;
    if (first && e.plain())  // as most of large triangles
      undecided = each_depth(e, [&](int n, float z, bool decided) {
        if ((covered & bit_of(n)) && decided) best[n] = pack_depth(z, e.triangle);
      });
    else
      undecided = each_depth(e, [&](int n, float z, bool decided) {
        const int64_t packed = pack_depth(clamp_depth(z, e.zmin, e.zmax), e.triangle);
        if ((covered & bit_of(n)) && decided && packed < best[n]) best[n] = packed;
      });
    if (undecided & covered) draw_special(e, undecided & covered, records);
  }

  // draw() of an entry that covers all of the region, where nothing else does: begin() and clear() are not needed.
  template <class E>
  __device__ __forceinline__ void fill(const E& e, const Record* records) {
    const uint32_t undecided = each_depth(
        e, [&](int n, float z, bool decided) { best[n] = decided ? pack_depth(z, e.triangle) : kBackground; });
    if (undecided) draw_special(e, undecided, records);
  }

  // Calls use(index in best, plane rounded to float32, whether that is certain) for the lane's pixels. Returns bits of
  // those of which it is not.
  template <class Use>
  __device__ __forceinline__ uint32_t each_depth(const Entry& e, const Use& use) const {
    // Sums of small integers are exact, in float32 too, and cheaper than conversions. Not computed once for all
    // entries: there are no registers to keep them in.
    const DepthNumber column = place_in_cell(computed_here(lane_left() & (kBin - 1))),
                      line = place_in_cell(computed_here(lane_top() & (kBin - 1)));
    const DepthNumber left = plane_column<DepthNumber>(e.plane.dzdx, column),
                      right = plane_column<DepthNumber>(e.plane.dzdx, column + 1);
#pragma unroll
    for (int row = 0; row < kLaneRows; ++row) {
      const DepthNumber start = plane_row<DepthNumber>(e.plane.zcell, e.plane.dzdy, line + 4 * row);
      use(2 * row, (float)(start + left), true);
      use(2 * row + 1, (float)(start + right), true);
    }
    return 0;
  }
  template <class Use>
  __device__ __forceinline__ uint32_t each_depth(const PairEntry& e, const Use& use) const {
    const float column = exact_float(computed_here(lane_left() & (kBin - 1))),
                line = exact_float(computed_here(lane_top() & (kBin - 1)));
    uint32_t undecided = 0;
#pragma unroll
    for (int row = 0; row < kLaneRows; ++row) {
      const FloatPair start = pair_at(e.z, e.dzdy, line + 4 * row);
#pragma unroll
      for (int side = 0; side < 2; ++side) {
        float z;
        const bool decided = pair_depth(start, e.dzdx, column + side, e.error, &z);
        use(2 * row + side, z, decided);
        undecided |= decided ? 0 : bit_of(2 * row + side);
      }
    }
    return undecided;
  }

  // Depth of pixel (px, py) of a record that is not thin.
  static __device__ __forceinline__ float depth_of_pixel(const Entry& e, int px, int py, const Record*) {
    return finish_depth(plane_row<DepthNumber>(e.plane.zcell, e.plane.dzdy, py & (kBin - 1)) +
                            plane_column<DepthNumber>(e.plane.dzdx, px & (kBin - 1)),
                        e.zmin, e.zmax);
  }
  static __device__ __forceinline__ float depth_of_pixel(const PairEntry& e, int px, int py, const Record* records) {
    return undecided_depth_of(records + e.slot(), px, py);
  }

  // Thin records, those that reach beyond z = 1, and pixels that are not decided. Each lane goes through its own, of which
  // a thin record has few. Not unrolled, but for the choice of the register.
  template <class E>
  __device__ __forceinline__ void draw_special(const E& e, uint32_t covered, const Record* records) {
#pragma unroll 1
    for (; covered; covered &= covered - 1) {
      const int n = kPixels - __ffs((int)covered);
      const int px = lane_left() + n % 2, py = lane_top() + n / 2 * 4;
      const float z = e.thin() ? thin_depth(records + e.slot(), px, py) : depth_of_pixel(e, px, py, records);
      const int64_t packed = pack_fragment(z, e.triangle);
#pragma unroll
      for (int m = 0; m < kPixels; ++m)
        if (m == n) best[m] = min_of(best[m], packed);
    }
  }

  // Calls use(index in best, offset in the view) for the lane's pixels on the screen.
  template <class Use>
  __device__ __forceinline__ void each(const Frame& f, const Use& use) const {
    const int px = computed_here(lane_left()), first = computed_here(lane_top());
#pragma unroll
    for (int row = 0; row < kLaneRows; ++row) {
      const int py = first + 4 * row;
      if (py >= f.view.height) break;
      const uint32_t at = offset_of(f, px, py);
      if (px < f.view.width) use(2 * row, at);
      if (px + 1 < f.view.width) use(2 * row + 1, at + 1);
    }
  }

  __device__ __forceinline__ void load(const Frame& f) {
    each(f, [&](int n, uint32_t at) { best[n] = f.packed[at]; });
  }

  __device__ __forceinline__ void store(const Frame& f) const {
    store_packed(f);
    if (f.depth) store_depth(f);
  }

  __device__ __forceinline__ void store_depth(const Frame& f) const {
    each(f, [&](int n, uint32_t at) { __stcs(f.depth + at, depth_of(best[n])); });
  }

  __device__ __forceinline__ void store_packed(const Frame& f) const {
    int64_t* const to = f.packed + offset_of(f, computed_here(lane_left()), computed_here(lane_top()));
    const int64_t down = 4 * (int64_t)f.view.width;
    if (left + kRegion > f.view.width || top + kHeight > f.view.height) {
      each(f, [&](int n, uint32_t at) { __stcs(reinterpret_cast<long long*>(f.packed) + at, (long long)best[n]); });
    } else if (wide_rows(f)) {
#pragma unroll
      for (int row = 0; row < kLaneRows; ++row) store_pair(to + row * down, best[2 * row], best[2 * row + 1]);
    } else {  // where a lane's pixels do not lie in one place of 16 bytes, its second and the next lane's first do
      const bool shifted = ((uintptr_t)to & 15) != 0;  // all rows are, or none: they are an even number of rows apart
      const bool first = (lane_id() & 7) == 0, last = (lane_id() & 7) == 7;
#pragma unroll
      for (int row = 0; row < kLaneRows; ++row) {
        int64_t* const at = to + row * down;
        const int64_t next = __shfl_down_sync(kAllLanes, best[2 * row], 1);
        if (!shifted)
          store_pair(at, best[2 * row], best[2 * row + 1]);
        else if (!last)
          store_pair(at + 1, best[2 * row + 1], next);
        if (shifted && (first || last))
          __stcs(reinterpret_cast<long long*>(at) + last, (long long)(first ? best[2 * row] : best[2 * row + 1]));
      }
    }
  }

  // Where others draw at the same time, in one of several views. The lanes exchange pixels first: then each atomic
  // minimum of the warp is of eight neighbours in each of four rows, which is half as many sectors.
  __device__ __forceinline__ void merge(const Frame& f, int view) const {
    const FramePixel to = first_pixel(f, view);
    const int place = computed_here(lane_id() & 7), py = computed_here(lane_top());
#pragma unroll
    for (int row = 0; row < kLaneRows; ++row)
#pragma unroll
      for (int half = 0; half < 2; ++half) {
        const int owner = (lane_id() & ~7) + 4 * half + place / 2, px = left + 8 * half + place, y = py + 4 * row;
        const int64_t even = __shfl_sync(kAllLanes, best[2 * row], owner),
                      odd = __shfl_sync(kAllLanes, best[2 * row + 1], owner), pixel = place & 1 ? odd : even;
        if (pixel != kBackground && px < f.view.width && y < f.view.height)
          keep_nearest(to + offset_of(f, px, y), pixel, false);
      }
  }
};
using Region = RegionOf<kRegion / 4>;  // 16x16 px

// Counts those of the lane's pixels in `cut` that an entry covers.
template <class AnyRegion, class E>
__device__ __forceinline__ void count_fragments(const Frame& f, const AnyRegion& region, uint32_t cut, const E& e) {
  for (int n = 0; n < AnyRegion::kPixels; ++n) {
    const int px = region.lane_left() + n % 2, py = region.lane_top() + n / 2 * 4;
    int32_t outside = 0;
    for (int k = 0; k < 3; ++k)
      outside |= e.edge[k].f + (px & (kBin - 1)) * e.edge[k].sx + (py & (kBin - 1)) * e.edge[k].sy;
    if ((cut & AnyRegion::bit_of(n)) && outside >= 0) count_fragment(f, px, py);
  }
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

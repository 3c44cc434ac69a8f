// Owned pixels: a block owns a patch of a bin, 64 px wide, a warp 16x16 px of it, a lane 8 px in registers. Every pixel is written once: no clear, no atomics.
// Hidden surfaces are rejected without sorting, per patch and per warp: whatever covers an area completely bounds the depth behind which nothing can be seen.
#pragma once

#include "fragment.cuh"

namespace bigtri {
namespace {

constexpr int kRegion = 16;       // px; side of a warp's part of the patch
constexpr int kLanePixels = 8;    // two next to each other in each of four rows, four rows apart
constexpr int kMaxEntries = 256;  // drawn together

// The bins that a record touches, first and last column and row, a byte each: what a block looks at before the record itself.
__device__ __forceinline__ uint32_t box_of(const Record& r) {
  return (uint32_t)(r.x0 / kBin) | (uint32_t)(r.y0 / kBin) << 8 | (uint32_t)((r.x1 - 1) / kBin) << 16 | (uint32_t)((r.y1 - 1) / kBin) << 24;
}
constexpr uint32_t kNoBox = 0x000000ff;      // first column after the last: in no bin
constexpr uint32_t kSliverBox = 0x000000fe;  // in no bin either: drawn by sliver.cuh
__device__ __forceinline__ bool in_box(uint32_t box, int bin_x, int bin_y) {
  return bin_x >= (int)(box & 0xff) && bin_y >= (int)(box >> 8 & 0xff) && bin_x <= (int)(box >> 16 & 0xff) && bin_y <= (int)(box >> 24);
}

// Records one after the other.
struct Candidates {
  const Record* records;
  const uint32_t* boxes;
  int count;

  __device__ __forceinline__ int slot(int i) const { return i; }
};

// Shared memory of a block that owns a patch.
struct PatchShared {
  Entry entries[kMaxEntries];  // of records whose bins the patch lies in
  uint16_t list[kMaxEntries];  // those that can be seen
  int entry_count, list_count;
  uint32_t far;  // bits of the depth behind which nothing of the patch can be seen
};

// Where a patch of kWarps regions is.
template <int kWarps>
struct Patch {
  static constexpr int kRows = kWarps / 4 * kRegion;
  static constexpr int kPerBin = kBin / kRows;
  int bin_x, bin_y, top;  // top: row of the bin where it begins, px

  __host__ __device__ static int count(const Viewport& v) { return ((v.width + kBin - 1) / kBin) * ((v.height + kRows - 1) / kRows); }
  __device__ static Patch at(const Viewport& v, int i) {
    const int columns = (v.width + kBin - 1) / kBin, row = i / columns;
    return {i - row * columns, row / kPerBin, row % kPerBin * kRows};
  }
};

// Whether two pixels can be stored at once wherever x is even.
__device__ __forceinline__ bool wide_rows(const Frame& f) { return f.view.width % 2 == 0 && ((uintptr_t)f.packed & 15) == 0; }

// In one instruction: the compiler would make two of most.
__device__ __forceinline__ void store_pair(int64_t* to, int64_t a, int64_t b) {
  asm volatile("st.global.v2.s64 [%0], {%1, %2};" ::"l"(to), "l"(a), "l"(b) : "memory");
}

// A lane's pixels, and drawing into them.
template <int kWarps>
struct Region {
  int64_t best[kLanePixels];
  int x, y;      // of the region, px from the bin's corner
  float far;     // behind this depth nothing of the region can be seen
  uint32_t cut;  // bits of the lane's pixels that the scissor leaves

  __device__ __forceinline__ int lane_x() const { return x + 2 * (lane_id() & 7); }
  __device__ __forceinline__ int lane_y() const { return y + (lane_id() >> 3); }

  __device__ __forceinline__ void begin(const Frame& f, const Patch<kWarps>& p, float far_depth) {
    const int warp = threadIdx.x / kWarp, left = p.bin_x * kBin, top = p.bin_y * kBin;
    x = warp % 4 * kRegion;
    y = p.top + warp / 4 * kRegion;
    far = far_depth;
    cut = (1u << kLanePixels) - 1;
    for (int i = 0; i < kLanePixels; ++i) best[i] = kBackground;
    if (left + x >= f.view.x0 && left + x + kRegion <= f.view.x1 && top + y >= f.view.y0 && top + y + kRegion <= f.view.y1) return;
    for (int i = 0; i < kLanePixels; ++i) {
      const int px = left + lane_x() + i % 2, py = top + lane_y() + i / 2 * 4;
      if (px < f.view.x0 || px >= f.view.x1 || py < f.view.y0 || py >= f.view.y1) cut &= ~(1u << i);
    }
  }

  __device__ __forceinline__ void draw(const Entry& e, bool full, const Patch<kWarps>& p, const Record* records) {
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
    if (e.thin() || e.far()) return draw_special(e, covered, p, records);
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
  __device__ __forceinline__ void draw_special(const Entry& e, uint32_t covered, const Patch<kWarps>& p, const Record* records) {
#pragma unroll 1
    for (int n = 0; n < kLanePixels; ++n) {
      if (!(covered >> n & 1)) continue;
      const int i = lane_x() + n % 2, j = lane_y() + n / 2 * 4;
      const float z = e.thin() ? thin_depth(records + e.slot(), p.bin_x * kBin + i, p.bin_y * kBin + j)
                               : finish_depth(plane_row<double>(e.plane.zcell, e.plane.dzdy, j) + plane_column<double>(e.plane.dzdx, i), e.zmin, e.zmax);
      const int64_t packed = pack_fragment(z, e.triangle);
#pragma unroll
      for (int m = 0; m < kLanePixels; ++m)
        if (m == n) best[m] = min_of(best[m], packed);
    }
  }

  // Draws the block's entries: what misses the region or lies behind it first falls out, an entry a lane.
  __device__ __forceinline__ void draw_all(const PatchShared& s, int count, const Patch<kWarps>& p, const Record* records) {
    for (int base = 0; base < count; base += kWarp) {
      bool keep = false, full = false;
      float nearest = 0.0f, farthest = kInfinity;
      if (base + lane_id() < count) {
        const Entry& e = s.entries[s.list[base + lane_id()]];
        keep = full = true;
        for (int k = 0; k < 3; ++k) {
          keep = keep && highest_over(e.edge[k], x, y, kRegion - 1, kRegion - 1) >= 0;
          full = full && lowest_over(e.edge[k], x, y, kRegion - 1, kRegion - 1) >= 0;
        }
        if (keep) nearest = bound_depth(e, x, y, kRegion - 1, kRegion - 1, false);
        if (full && !e.far()) farthest = bound_depth(e, x, y, kRegion - 1, kRegion - 1, true);
      }
      far = min_of(far, bits_float(warp_min(float_bits(farthest))));  // depths are not negative: their bits are in order
      const unsigned whole = __ballot_sync(kAllLanes, full);
      for (unsigned todo = __ballot_sync(kAllLanes, keep && nearest <= far); todo; todo &= todo - 1) {
        const int i = __ffs(todo) - 1;
        draw(s.entries[s.list[base + i]], whole >> i & 1, p, records);
      }
    }
  }

  // Calls use(index in best, offset in the image) for the lane's pixels on the screen.
  template <class Use>
  __device__ __forceinline__ void each(const Frame& f, const Patch<kWarps>& p, const Use& use) const {
    const int px = p.bin_x * kBin + lane_x();
#pragma unroll
    for (int row = 0; row < 4; ++row) {
      const int py = p.bin_y * kBin + lane_y() + 4 * row;
      if (py >= f.view.height) break;
      const int64_t at = (int64_t)py * f.view.width + px;
      if (px < f.view.width) use(2 * row, at);
      if (px + 1 < f.view.width) use(2 * row + 1, at + 1);
    }
  }

  __device__ __forceinline__ void load(const Frame& f, const Patch<kWarps>& p) {
    each(f, p, [&](int n, int64_t at) { best[n] = f.packed[at]; });
  }

  __device__ __forceinline__ void store(const Frame& f, const Patch<kWarps>& p) const {
    const int px = p.bin_x * kBin + lane_x(), py = p.bin_y * kBin + lane_y();
    if (wide_rows(f)) {
      int64_t* to = f.packed + (int64_t)py * f.view.width + px;
#pragma unroll
      for (int row = 0; row < 4; ++row, to += 4 * (int64_t)f.view.width)
        if (px < f.view.width && py + 4 * row < f.view.height) store_pair(to, best[2 * row], best[2 * row + 1]);
    } else {
      each(f, p, [&](int n, int64_t at) { f.packed[at] = best[n]; });
    }
    if (f.depth) each(f, p, [&](int n, int64_t at) { f.depth[at] = depth_of(best[n]); });
  }

  // Where others draw at the same time.
  __device__ __forceinline__ void merge(const Frame& f, const Patch<kWarps>& p) const {
    each(f, p, [&](int n, int64_t at) {
      if (best[n] != kBackground) keep_nearest(f.packed + at, best[n], false);
    });
  }
};

enum class Output { kWrite, kMerge };  // alone on the frame, or beside others

__device__ __forceinline__ PatchShared* patch_shared() {
  extern __shared__ __align__(16) char memory[];
  return reinterpret_cast<PatchShared*>(memory);
}

// By all threads of a block.
template <int kWarps>
__device__ __forceinline__ void store_background(const Frame& f, const Patch<kWarps>& p) {
  constexpr int kPairs = kBin / 2;
  const int px = p.bin_x * kBin + (int)threadIdx.x % kPairs * 2, py = p.bin_y * kBin + p.top + (int)threadIdx.x / kPairs;
  const bool wide = wide_rows(f);
#pragma unroll
  for (int row = 0; row < Patch<kWarps>::kRows; row += kWarps * kWarp / kPairs) {
    if (py + row >= f.view.height || px >= f.view.width) break;
    const int64_t at = (int64_t)(py + row) * f.view.width + px;
    if (wide) {
      store_pair(f.packed + at, kBackground, kBackground);
    } else {
      f.packed[at] = kBackground;
      if (px + 1 < f.view.width) f.packed[at + 1] = kBackground;
    }
    if (f.depth) {
      f.depth[at] = kInfinity;
      if (px + 1 < f.view.width) f.depth[at + 1] = kInfinity;
    }
  }
}

// Draws a patch of what `candidates` has, by all threads of a block. What can be seen gathers in shared memory, and the pixels are in registers only while that is drawn: mostly once.
// If more gathers than there is room for, the patch is drawn several times, each time from what the last one left. drawn: the frame already holds something of the patch.
// Candidates: int count; int slot(int i), i < count; const Record* records; const uint32_t* boxes.
template <int kWarps, Output kOutput, class Candidates>
__device__ __forceinline__ void draw_patch(const Frame& f, const Candidates& candidates, const Patch<kWarps>& patch, int room, bool drawn) {
  constexpr int kThreads = kWarps * kWarp;
  PatchShared* const s = patch_shared();
  const int count = candidates.count;
  bool any = false;
  for (int i = threadIdx.x; i < count; i += kThreads) any = any || in_box(candidates.boxes[candidates.slot(i)], patch.bin_x, patch.bin_y);
  if (!__syncthreads_or(any)) {  // most patches of most scenes
    if (kOutput == Output::kWrite && !drawn) store_background(f, patch);
    return;
  }
  if (threadIdx.x == 0) {
    s->entry_count = s->list_count = 0;
    s->far = float_bits(kInfinity);
  }
  __syncthreads();
  bool done = false;  // this thread's candidate of the turn
  for (int base = 0;;) {
    bool full_up = false;
    while (base < count && !full_up) {
      const int i = base + (int)threadIdx.x;
      bool pending = false;
      int place = 0;
      Meeting meeting = {false, 0.0f, 0.0f};
      if (i < count && !done) {
        const int slot = candidates.slot(i);
        if (in_box(candidates.boxes[slot], patch.bin_x, patch.bin_y)) {
          place = atomicAdd(&s->entry_count, 1);
          pending = place >= room;
          if (!pending) {
            meeting = enter_bin(candidates.records[slot], (uint32_t)slot, patch.bin_x, patch.bin_y, patch.top, Patch<kWarps>::kRows, &s->entries[place]);
            if (meeting.meets && meeting.farthest < kInfinity) atomicMin(&s->far, float_bits(meeting.farthest));
          }
        }
      }
      full_up = __syncthreads_or(pending);
      if (meeting.meets && meeting.nearest <= bits_float(s->far)) s->list[atomicAdd(&s->list_count, 1)] = (uint16_t)place;
      done = full_up && !pending;
      if (!full_up) base += kThreads;
      __syncthreads();
    }
    const int waiting = s->list_count;
    if (waiting > 0 || (kOutput == Output::kWrite && !drawn)) {
      Region<kWarps> region;
      region.begin(f, patch, bits_float(s->far));
      if (kOutput == Output::kWrite && drawn) region.load(f, patch);
      region.draw_all(*s, waiting, patch, candidates.records);
      if (kOutput == Output::kWrite)
        region.store(f, patch);
      else
        region.merge(f, patch);
      drawn = true;
    }
    __syncthreads();
    if (!full_up) return;
    if (threadIdx.x == 0) s->entry_count = s->list_count = 0;
    __syncthreads();
  }
}

}  // namespace
}  // namespace bigtri

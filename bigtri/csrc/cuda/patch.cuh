// A block owns a patch of a bin, 64 px wide, and each of its warps a region of it. Candidates are looked at once for the whole patch, a thread each.
// Hidden surfaces are rejected without sorting, per patch and per region: whatever covers an area completely bounds the depth behind which nothing can be seen.
#pragma once

#include "region.cuh"

namespace bigtri {
namespace {

// The bins that a record touches, first and last column and row, a byte each: what a block looks at before the record itself.
__device__ __forceinline__ uint32_t box_of(const Record& r) {
  return (uint32_t)(r.x0 / kBin) | (uint32_t)(r.y0 / kBin) << 8 | (uint32_t)((r.x1 - 1) / kBin) << 16 | (uint32_t)((r.y1 - 1) / kBin) << 24;
}
constexpr uint32_t kNoBox = 0x000000ff;  // first column after the last: in no bin
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

constexpr int kTurn = 8;  // patches that a block takes at a time

// Where a patch of kWarps regions is.
template <int kWarps>
struct Patch {
  static constexpr int kRows = kWarps / 4 * kRegion;
  static constexpr int kPerBin = kBin / kRows;
  static constexpr int kNowhere = 1 << 16;
  int bin_x, bin_y, top;  // bin_x: kNowhere, with no pixel, behind the last; top: row of the bin where it begins, px

  __host__ __device__ static int count(const Viewport& v) { return ((v.width + kBin - 1) / kBin) * ((v.height + kRows - 1) / kRows); }
  __device__ static Patch at(const Viewport& v, int i) {
    const int columns = (v.width + kBin - 1) / kBin, row = i / columns;
    return {i - row * columns, row / kPerBin, row % kPerBin * kRows};
  }
};

// Shared memory of a block that owns patches.
template <int kWarps>
struct PatchShared {
  static constexpr int kMaxEntries = 24 * kWarps;  // 384 of 80 B, so that records fit beside them
  Entry entries[kMaxEntries];  // of records in the bin that a patch lies in
  uint16_t list[kWarps * kWarp];  // those that can be seen: a part for each patch
  Patch<kWarps> at[kTurn];
  int entry_count, list_count[kTurn];
  uint32_t far[kTurn];  // bits of the depth behind which nothing of the patch can be seen
  unsigned touched;  // bits of the patches that have a candidate
};

enum class Output { kWrite, kMerge };  // alone on the frame, or beside others

// Draws entries into a region: what misses it or lies behind it first falls out, an entry a lane.
__device__ __forceinline__ void draw_all(Region& region, const Entry* entries, const uint16_t* list, int count, const Record* records) {
  const int x = region.x, y = region.y;
  for (int base = 0; base < count; base += kWarp) {
    bool keep = false, full = false;
    float nearest = 0.0f, farthest = kInfinity;
    if (base + lane_id() < count) {
      const Entry& e = entries[list[base + lane_id()]];
      keep = full = true;
      for (int k = 0; k < 3; ++k) {
        keep = keep && highest_over(e.edge[k], x, y, kRegion - 1, kRegion - 1) >= 0;
        full = full && lowest_over(e.edge[k], x, y, kRegion - 1, kRegion - 1) >= 0;
      }
      if (keep) nearest = bound_depth(e, x, y, kRegion - 1, kRegion - 1, false);
      if (full && !e.far()) farthest = bound_depth(e, x, y, kRegion - 1, kRegion - 1, true);
    }
    region.far = min_of(region.far, bits_float(warp_min(float_bits(farthest))));  // depths are not negative: their bits are in order
    const unsigned whole = __ballot_sync(kAllLanes, full);
    for (unsigned todo = __ballot_sync(kAllLanes, keep && nearest <= region.far); todo; todo &= todo - 1) {
      const int i = __ffs(todo) - 1;
      region.draw(entries[list[base + i]], whole >> i & 1, records);
    }
  }
}

// This warp's region of a patch.
template <int kWarps>
__device__ __forceinline__ Region region_of(const Frame& f, const Patch<kWarps>& p, float far) {
  const int warp = threadIdx.x / kWarp;
  Region region;
  region.begin(f, p.bin_x, p.bin_y, warp % 4 * kRegion, p.top + warp / 4 * kRegion, far);
  return region;
}

// Draws the patches of what `candidates` has that are this block's, by all of its threads. As many patches at once as there are threads to look at the candidates of each. What can be seen gathers in
// shared memory; then each warp draws its region of each patch, the pixels in registers, mostly once. If more gathers than there is room for, the patches are drawn several times, each time
// from what the last one left. drawn: the frame holds what has been drawn before.
// Candidates: int count; int slot(int i), i < count; const Record* records; const uint32_t* boxes.
template <int kWarps, Output kOutput, class Candidates>
__device__ __forceinline__ void draw_patches(const Frame& f, const Candidates& candidates, int room, bool drawn) {
  constexpr int kThreads = kWarps * kWarp;
  extern __shared__ __align__(16) char memory[];
  PatchShared<kWarps>* const s = reinterpret_cast<PatchShared<kWarps>*>(memory);
  const int count = candidates.count, patches = Patch<kWarps>::count(f.view);
  int shift = 31 - __clz(kTurn);
  while (shift > 0 && count << shift > kThreads) --shift;
  const int together = 1 << shift, each = kThreads >> shift;  // patches at once, threads for one
  const int own = (int)threadIdx.x >> (31 - __clz(each));  // the patch that this thread looks at candidates for
  room = min_of(room, PatchShared<kWarps>::kMaxEntries);
#pragma unroll 1
  for (int first = blockIdx.x; first < patches; first += kTurn * gridDim.x) {
    if (threadIdx.x < kTurn) {
      const int index = first + (int)threadIdx.x * (int)gridDim.x;
      Patch<kWarps> patch = {Patch<kWarps>::kNowhere, 0, 0};
      if (index < patches) patch = Patch<kWarps>::at(f.view, index);
      s->at[threadIdx.x] = patch;
      s->far[threadIdx.x] = float_bits(kInfinity);
    }
    if (threadIdx.x == 0) s->touched = together > 1 ? ~0u : 0;
    __syncthreads();
    if (together == 1) {  // many candidates: look at them once for all patches
      unsigned touched = 0;
      for (int i = threadIdx.x; i < count; i += kThreads) {
        const uint32_t box = candidates.boxes[candidates.slot(i)];
#pragma unroll
        for (int k = 0; k < kTurn; ++k) touched |= in_box(box, s->at[k].bin_x, s->at[k].bin_y) ? 1u << k : 0;
      }
      if (touched) atomicOr(&s->touched, touched);
      __syncthreads();
    }
#pragma unroll 1
    for (int group = 0; group < kTurn; group += together) {
      if (s->at[group].bin_x == Patch<kWarps>::kNowhere) break;
      if (!(s->touched >> group & 1)) {
        if (kOutput == Output::kWrite && !drawn) region_of(f, s->at[group], kInfinity).store(f);
        continue;
      }
      const Patch<kWarps> patch = s->at[group + own];
      // This thread's next candidate in the bin of its patch, from i on.
      const auto next = [&](int i) {
        while (i < count && !in_box(candidates.boxes[candidates.slot(i)], patch.bin_x, patch.bin_y)) i += each;
        return i;
      };
      int i = next((int)threadIdx.x & (each - 1));
      bool again = drawn, full_up;
      do {
        if ((int)threadIdx.x < together) s->list_count[threadIdx.x] = 0;
        if (threadIdx.x == 0) s->entry_count = 0;
        full_up = false;
        bool more = __syncthreads_or(i < count);
        while (more && !full_up) {
          // What a patch is covered by hides what lies behind. Only what is left takes room.
          Meeting m;
          m.meets = false;
          const int slot = i < count ? candidates.slot(i) : 0;
          if (i < count) m = meet(candidates.records[slot], patch.bin_x, patch.bin_y, 0, patch.top, kBin, Patch<kWarps>::kRows);
          if (m.meets && m.farthest < kInfinity) atomicMin(&s->far[group + own], float_bits(m.farthest));
          __syncthreads();
          bool pending = false;
          if (m.meets && m.nearest <= bits_float(s->far[group + own])) {
            const int place = atomicAdd(&s->entry_count, 1);
            pending = place >= room;
            if (!pending) {
              m.make_entry(candidates.records[slot], (uint32_t)slot, &s->entries[place]);
              s->list[own * each + atomicAdd(&s->list_count[own], 1)] = (uint16_t)place;
            }
          }
          if (i < count && !pending) i = next(i + each);
          more = __syncthreads_or(i < count);
          full_up = s->entry_count > room;
        }
#pragma unroll 1
        for (int k = 0; k < together; ++k) {
          const Patch<kWarps> p = s->at[group + k];
          const int waiting = s->list_count[k];
          if (p.bin_x == Patch<kWarps>::kNowhere) break;
          if (waiting == 0 && (kOutput == Output::kMerge || again)) continue;
          Region region = region_of(f, p, bits_float(s->far[group + k]));
          if (kOutput == Output::kWrite && again) region.load(f);
          draw_all(region, s->entries, s->list + k * each, waiting, candidates.records);
          if (kOutput == Output::kWrite)
            region.store(f);
          else
            region.merge(f);
        }
        again = true;
        __syncthreads();
      } while (full_up);
    }
    __syncthreads();  // nobody looks at these patches any more
  }
}

}  // namespace
}  // namespace bigtri

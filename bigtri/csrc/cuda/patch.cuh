// A block owns a patch of a bin, 64 px wide, and each of its warps a region of it. Candidates are looked at once for the whole patch, a thread each.
// Hidden surfaces are rejected without sorting, per patch and per region: whatever covers an area completely bounds the depth behind which nothing can be seen.
#pragma once

#include "region.cuh"

namespace bigtri {
namespace {

constexpr int kMaxEntries = 256;  // drawn together

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

enum class Output { kWrite, kMerge };  // alone on the frame, or beside others

__device__ __forceinline__ PatchShared* patch_shared() {
  extern __shared__ __align__(16) char memory[];
  return reinterpret_cast<PatchShared*>(memory);
}

// Draws the block's entries: what misses the region or lies behind it first falls out, an entry a lane.
__device__ __forceinline__ void draw_all(Region& region, const PatchShared& s, int count, const Record* records) {
  const int x = region.x, y = region.y;
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
    region.far = min_of(region.far, bits_float(warp_min(float_bits(farthest))));  // depths are not negative: their bits are in order
    const unsigned whole = __ballot_sync(kAllLanes, full);
    for (unsigned todo = __ballot_sync(kAllLanes, keep && nearest <= region.far); todo; todo &= todo - 1) {
      const int i = __ffs(todo) - 1;
      region.draw(s.entries[s.list[base + i]], whole >> i & 1, records);
    }
  }
}

// By all threads of a block.
template <int kWarps>
__device__ __forceinline__ void store_background(const Frame& f, const Patch<kWarps>& p) {
  constexpr int kPairs = kBin / 2, kStep = kWarps * kWarp / kPairs;  // pairs of pixels in a row, rows at a time
  const int px = p.bin_x * kBin + (int)threadIdx.x % kPairs * 2, py = p.bin_y * kBin + p.top + (int)threadIdx.x / kPairs;
  const int rows = min_of(f.view.height - py, Patch<kWarps>::kRows - (int)threadIdx.x / kPairs);
  if (px >= f.view.width) return;
  int64_t* to = f.packed + ((uint32_t)(py * f.view.width) + px);
  if (wide_rows(f)) {
    for (int row = 0; row < rows; row += kStep, to += kStep * (int64_t)f.view.width) store_pair(to, kBackground, kBackground);
  } else {
    for (int row = 0; row < rows; row += kStep, to += kStep * (int64_t)f.view.width) {
      to[0] = kBackground;
      if (px + 1 < f.view.width) to[1] = kBackground;
    }
  }
  if (f.depth)
    for (int row = 0; row < rows; row += kStep) {
      float* depth = f.depth + (uint32_t)((py + row) * f.view.width + px);
      depth[0] = kInfinity;
      if (px + 1 < f.view.width) depth[1] = kInfinity;
    }
}

// Draws a patch of what `candidates` has, by all threads of a block. What can be seen gathers in shared memory, and the pixels are in registers only while that is drawn: mostly once.
// If more gathers than there is room for, the patch is drawn several times, each time from what the last one left.
// Candidates: int count; int slot(int i), i < count; const Record* records; const uint32_t* boxes.
template <int kWarps, Output kOutput, class Candidates>
__device__ __forceinline__ void draw_patch(const Frame& f, const Candidates& candidates, const Patch<kWarps>& patch, int room) {
  constexpr int kThreads = kWarps * kWarp;
  PatchShared* const s = patch_shared();
  const int count = candidates.count;
  bool any = false;
  for (int i = threadIdx.x; i < count; i += kThreads) any = any || in_box(candidates.boxes[candidates.slot(i)], patch.bin_x, patch.bin_y);
  if (!__syncthreads_or(any)) {  // most patches of most scenes
    if (kOutput == Output::kWrite) store_background(f, patch);
    return;
  }
  if (threadIdx.x == 0) {
    s->entry_count = s->list_count = 0;
    s->far = float_bits(kInfinity);
  }
  __syncthreads();
  bool drawn = false;  // the frame already holds something of the patch
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
            meeting =
                enter_bin(candidates.records[slot], (uint32_t)slot, patch.bin_x, patch.bin_y, 0, patch.top, kBin, Patch<kWarps>::kRows, &s->entries[place]);
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
      const int warp = threadIdx.x / kWarp;
      Region region;
      region.begin(f, patch.bin_x, patch.bin_y, warp % 4 * kRegion, patch.top + warp / 4 * kRegion, bits_float(s->far));
      if (kOutput == Output::kWrite && drawn) region.load(f);
      draw_all(region, *s, waiting, candidates.records);
      if (kOutput == Output::kWrite)
        region.store(f);
      else
        region.merge(f);
      drawn = true;
    }
    __syncthreads();
    if (!full_up) return;
    if (threadIdx.x == 0) s->entry_count = s->list_count = 0;
    __syncthreads();
  }
}

// A region by a warp alone: what `draw_patch` does, without a barrier, for few records, all of which each warp looks at, a lane each. entries: kWarp of them, the warp's own.
template <class Candidates>
__device__ __forceinline__ void draw_region(const Frame& f, const Candidates& candidates, int index, int room, Entry* entries) {
  const int count = candidates.count;
  const int columns = (f.view.width + kRegion - 1) / kRegion, row = index / columns;
  const int left = (index - row * columns) * kRegion, top = row * kRegion;
  const int bin_x = left / kBin, bin_y = top / kBin, x = left % kBin, y = top % kBin;
  float far = kHuge;
  bool drawn = false;
  for (int base = 0;;) {
    int waiting = 0;
    while (base < count) {
      const int slot = base + lane_id() < count ? candidates.slot(base + lane_id()) : 0;
      const Record* r = candidates.records + slot;
      const bool near_it =
          base + lane_id() < count && candidates.boxes[slot] != kNoBox && r->x0 < left + kRegion && r->x1 > left && r->y0 < top + kRegion && r->y1 > top;
      const unsigned some = __ballot_sync(kAllLanes, near_it);
      if (waiting > 0 && waiting + __popc(some) > room) break;
      Meeting meeting = {false, 0.0f, kInfinity};
      const int place = waiting + __popc(some & lanes_below());
      if (near_it) {
        Entry* e = entries + place;
        meeting = enter_bin(*r, (uint32_t)slot, bin_x, bin_y, x, y, kRegion, kRegion, e);
        e->nearest = meeting.meets ? meeting.nearest : kInfinity;
      }
      if (some) far = min_of(far, bits_float(warp_min(float_bits(meeting.meets ? meeting.farthest : kInfinity))));
      waiting += __popc(some);
      base += kWarp;
    }
    __syncwarp();
    if (waiting > 0 || !drawn) {
      Region region;
      region.begin(f, bin_x, bin_y, x, y, far);
      if (drawn) region.load(f);
      const bool mine = lane_id() < waiting;
      const unsigned full = __ballot_sync(kAllLanes, mine && entries[lane_id()].full());
      for (unsigned todo = __ballot_sync(kAllLanes, mine && entries[lane_id()].nearest <= far); todo; todo &= todo - 1) {
        const int i = __ffs(todo) - 1;
        region.draw(entries[i], full >> i & 1, candidates.records);
      }
      region.store(f);
      drawn = true;
    }
    __syncwarp();
    if (base >= count) return;
  }
}

}  // namespace
}  // namespace bigtri

// What waits for the blocks that own bins: records, and for each bin a list of those that touch it. A record that
// touches many bins, or finds a list full, goes to one more list, which all blocks look at for all bins: nothing is
// lost, and a triangle that fills the screen does not take an atomic for each of its bins.
#pragma once

#include "launch.cuh"
#include "patch.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr int kListBytes = 32 << 20;  // of all lists together

struct Waiting {
  Record* records;
  Record* slivers;  // in no list; null if those are among the others
  uint32_t room;  // of either
  // How many records have been put into each bin's list, or were to be; in front of bin 0 the other counts.
  uint32_t* sizes;
  uint32_t* slots;  // of the records in the lists, `listed` of each bin
  uint32_t *wide_boxes, *wide_slots;  // of the records that all look at
  int columns, bins, listed;
  int wide_above;  // a record with more bins in its bbox is looked at by all
  uint32_t wide_below;  // so are records in slots below
  int bands;  // in which slivers are drawn

  __device__ uint64_t* count() const { return counts(); }  // of records, or of those that were to be put there
  __device__ uint64_t* wide_count() const { return counts() + 1; }
  __device__ uint64_t* sliver_count() const { return counts() + 2; }
  __device__ uint64_t* counts() const { return reinterpret_cast<uint64_t*>(sizes - kCounts); }
  static constexpr int kCounts = 6;  // words
  Zeros zeros() const { return {sizes - kCounts, bins + kCounts}; }
};

Waiting take_waiting(Scratch* scratch, const Frame& f, int64_t queue, int64_t room) {
  Waiting w;
  w.columns = bin_columns(f.view);
  w.bins = w.columns * bin_rows(f.view);
  w.room = (uint32_t)room;
  // In proportion to the queue, so that it changes both; by default 1024, and fewer where images are so large that all
  // lists together would take too much.
  w.listed = (int)max_of<int64_t>(1, min_of<int64_t>(queue / 256, kListBytes / (int64_t)sizeof(uint32_t) / w.bins));
  w.wide_above = max_of(64, w.bins / 64);  // an atomic for each bin, against a look for each bin of the image
  w.records = scratch->take<Record>(room);
  w.slivers = nullptr;
  w.wide_below = 0;
  w.bands = 1;
  w.sizes = scratch->take<uint32_t>(w.bins + Waiting::kCounts) + Waiting::kCounts;
  w.slots = scratch->take<uint32_t>((int64_t)w.bins * w.listed);
  w.wide_boxes = scratch->take<uint32_t>(room);
  w.wide_slots = scratch->take<uint32_t>(room);
  return w;
}

// Puts the lanes' records, which are in their slots already, into the lists of the bins that no edge rejects; two
// records at a time, half of the lanes each, so that a large one does not hold up a lane. By all lanes.
__device__ __forceinline__ void put_into_lists(const Waiting& w, const Primitive& p, bool have, uint32_t slot) {
  constexpr int kTeam = kWarp / 2;
  const BinBox bins = bin_box(p);
  bool wide = have && (bins.count > w.wide_above || slot < w.wide_below);
  for (unsigned todo = __ballot_sync(kAllLanes, have && !wide); todo;) {
    const unsigned others = todo & (todo - 1), mine = lane_id() < kTeam ? todo : others;
    const int lane = max_of(__ffs(mine) - 1, 0);
    const BinBox box = of_lane(bins, lane);
    const uint32_t its = __shfl_sync(kAllLanes, slot, lane);
    int32_t x[3], y[3];
    for (int k = 0; k < 3; ++k) {
      x[k] = __shfl_sync(kAllLanes, p.x[k], lane);
      y[k] = __shfl_sync(kAllLanes, p.y[k], lane);
    }
    bool full = false;
    for (int i = mine ? lane_id() % kTeam : box.count; i < box.count; i += kTeam) {
      const int down = i / box.columns, bin_x = box.x + i - down * box.columns, bin_y = box.y + down;
      bool rejected = false;
      for (int k = 0; k < 3; ++k) rejected |= bin_edge(edge_of(x, y, k), bin_x, bin_y).highest < 0;
      if (rejected) continue;
      const int bin = bin_y * w.columns + bin_x;
      const uint32_t at = atomicAdd(&w.sizes[bin], 1u);
      if (at < (uint32_t)w.listed)
        w.slots[(int64_t)bin * w.listed + at] = its;
      else
        full = true;
    }
    const unsigned lanes = __ballot_sync(kAllLanes, full);
    wide |= (lanes & 0xffff) && lane_id() == __ffs(todo) - 1;
    wide |= (lanes >> kTeam) && lane_id() == __ffs(others) - 1;
    todo = others & (others - 1);
  }
  if (wide) {
    const uint32_t at = claim(w.wide_count(), w.room, 1);
    w.wide_boxes[at] = box_of(p);
    w.wide_slots[at] = slot;
  }
}

// What gather() takes them from.
struct ListedCandidates {
  static constexpr bool kLists = true;
  const Record* records;
  const Waiting& waiting;
  const bool any;  // in lists

  __device__ ListedCandidates(const Waiting& w, bool any_listed) : records(w.records), waiting(w), any(any_listed) {}
  __device__ __forceinline__ uint32_t box(int i) const { return waiting.wide_boxes[i]; }
  __device__ __forceinline__ int slot(int i) const { return (int)waiting.wide_slots[i]; }
  __device__ __forceinline__ int bin(int x, int y) const { return y * waiting.columns + x; }
  __device__ __forceinline__ int listed(int bin_x, int bin_y) const {
    return !any ? 0 : (int)min_of(waiting.sizes[bin(bin_x, bin_y)], (uint32_t)waiting.listed);
  }
  __device__ __forceinline__ int listed_slot(int bin_x, int bin_y, int i) const {
    return (int)waiting.slots[(int64_t)bin(bin_x, bin_y) * waiting.listed + i];
  }
};

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// What waits for the blocks that own bins: a list of records for each bin. A record that touches many bins, or finds a list full, goes to one more list, which all blocks look at for all bins:
// nothing is lost, and a triangle that fills the screen does not take an atomic for each of its bins.
#pragma once

#include "launch.cuh"
#include "patch.cuh"

namespace bigtri {
namespace {

constexpr int kListedBins = 64;  // a record that touches more is looked at by all
constexpr int kListBytes = 32 << 20;  // of all bins' lists together

struct BinLists {
  uint32_t *sizes, *slots;  // of each bin's list: what was to be put there, and `room` records, each by its slot
  uint32_t *wide_size, *wide_boxes, *wide_slots;  // records that all look at: boxes, slots
  int columns, room;
};

inline int64_t bins_of(const Viewport& v) { return (int64_t)((v.width + kBin - 1) / kBin) * ((v.height + kBin - 1) / kBin); }

// counters: zeros, one and one for each bin. records: how many can wait.
BinLists take_lists(Scratch* scratch, const Frame& f, const Tuning& t, int64_t records, uint32_t* counters) {
  BinLists l;
  l.columns = (f.view.width + kBin - 1) / kBin;
  l.room = (int)max_of<int64_t>(1, min_of<int64_t>(t.queue / 256, kListBytes / (int64_t)sizeof(uint32_t) / bins_of(f.view)));
  l.wide_size = counters;
  l.sizes = counters + 1;
  l.slots = scratch->take<uint32_t>(bins_of(f.view) * l.room);
  l.wide_boxes = scratch->take<uint32_t>(records);
  l.wide_slots = scratch->take<uint32_t>(records);
  return l;
}

// Puts the lanes' records, which are in their slots already, into the lists of the bins that no edge rejects; two records at a time, half of the lanes each, so that a large one does not hold up a lane. By all lanes.
__device__ __forceinline__ void put_into_lists(const BinLists& l, const Primitive& p, bool have, uint32_t slot) {
  constexpr int kTeam = kWarp / 2;
  const int x0 = p.x0 / kBin, y0 = p.y0 / kBin, across = (p.x1 - 1) / kBin - x0 + 1, bins = across * ((p.y1 - 1) / kBin - y0 + 1);
  bool wide = have && bins > kListedBins;
  for (unsigned todo = __ballot_sync(kAllLanes, have && !wide); todo;) {
    const unsigned others = todo & (todo - 1), mine = lane_id() < kTeam ? todo : others;
    const int lane = max_of(__ffs(mine) - 1, 0), n = __shfl_sync(kAllLanes, bins, lane);
    const int left = __shfl_sync(kAllLanes, x0, lane), top = __shfl_sync(kAllLanes, y0, lane), columns = __shfl_sync(kAllLanes, across, lane);
    const uint32_t its = __shfl_sync(kAllLanes, slot, lane);
    int32_t x[3], y[3];
    for (int k = 0; k < 3; ++k) {
      x[k] = __shfl_sync(kAllLanes, p.x[k], lane);
      y[k] = __shfl_sync(kAllLanes, p.y[k], lane);
    }
    bool full = false;
    for (int i = mine ? lane_id() % kTeam : n; i < n; i += kTeam) {
      const int down = i / columns, bin_x = left + i - down * columns, bin_y = top + down;
      bool rejected = false;
      for (int k = 0; k < 3; ++k) rejected |= bin_edge(edge_of(x, y, k), bin_x, bin_y).highest < 0;
      if (rejected) continue;
      const int64_t bin = (int64_t)bin_y * l.columns + bin_x;
      const uint32_t at = atomicAdd(&l.sizes[bin], 1u);
      if (at < (uint32_t)l.room)
        l.slots[bin * l.room + at] = its;
      else
        full = true;
    }
    const unsigned lanes = __ballot_sync(kAllLanes, full);
    wide |= (lanes & 0xffff) && lane_id() == __ffs(todo) - 1;
    wide |= (lanes >> kTeam) && lane_id() == __ffs(others) - 1;
    todo = others & (others - 1);
  }
  if (wide) {
    const uint32_t at = atomicAdd(l.wide_size, 1u);
    l.wide_boxes[at] = box_of(p);
    l.wide_slots[at] = slot;
  }
}

// What gather() takes them from.
struct ListedCandidates {
  static constexpr bool kListed = true;
  const Record* records;
  const BinLists& lists;

  __device__ ListedCandidates(const Record* r, const BinLists& l) : records(r), lists(l) {}
  __device__ __forceinline__ uint32_t box(int i) const { return lists.wide_boxes[i]; }
  __device__ __forceinline__ int slot(int i) const { return (int)lists.wide_slots[i]; }
  __device__ __forceinline__ int64_t bin(int x, int y) const { return (int64_t)y * lists.columns + x; }
  __device__ __forceinline__ int listed(int bin_x, int bin_y) const { return (int)min_of(lists.sizes[bin(bin_x, bin_y)], (uint32_t)lists.room); }
  __device__ __forceinline__ int listed_slot(int bin_x, int bin_y, int i) const { return (int)lists.slots[bin(bin_x, bin_y) * lists.room + i]; }
};

}  // namespace
}  // namespace bigtri

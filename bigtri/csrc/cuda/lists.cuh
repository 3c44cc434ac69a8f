// What waits for the blocks that own patches: records, and for each bin of each view a list of those that touch it. A record that
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
  Record* slivers;  // in no list
  uint32_t room;  // of either
  // How many records have been put into each bin's list, or were to be; in front of bin 0 the other counts.
  uint32_t* sizes;
  uint32_t* words;  // of teams' decisions, zero at first, or of a sample
  uint64_t* samples;  // RowLimits::samples
  uint32_t* slots;  // of the records in the lists, `list_room` of each bin
  ViewBox* common_boxes;  // of the records that all look at
  uint32_t* common_slots;
  int columns, bins;  // of a view
  int list_room;  // slots of a bin
  int common_above;  // a record with more bins in its bbox is looked at by all
  uint32_t common_below;  // so are records in slots below
  int bands;  // in which slivers are drawn

  __device__ uint64_t* count() const { return counts(); }  // of records, or of those that were to be put there
  __device__ uint64_t* common_count() const { return counts() + 1; }
  __device__ uint64_t* sliver_count() const { return counts() + 2; }
  __device__ uint64_t* counts() const { return reinterpret_cast<uint64_t*>(sizes - kCounts); }
  static constexpr int kCounts = 6;  // words
  // more: of `words`, how many are needed.
  Zeros zeros(int views, int64_t more) const {
    return {sizes - kCounts, (int64_t)bins * views + kCounts + more, samples};
  }
  __device__ __forceinline__ int64_t bin(int view, int x, int y) const {
    return (int64_t)view * bins + y * columns + x;
  }
};

// words: Waiting::words.
Waiting take_waiting(Scratch* scratch, const Frame& f, int64_t queue, int64_t room, int64_t words) {
  Waiting w;
  w.columns = bin_columns(f.view);
  w.bins = w.columns * bin_rows(f.view);
  w.room = (uint32_t)room;
  // In proportion to the queue, so that it changes both; by default 1024, and fewer where images are so large that all
  // lists together would take too much.
  const int64_t bins = (int64_t)w.bins * f.views;
  w.list_room = (int)max_of<int64_t>(1, min_of<int64_t>(queue / 256, kListBytes / (int64_t)sizeof(uint32_t) / bins));
  // An atomic for each of its bins, against a look for each bin of the image. Of a batch blocks look at it for all views' bins,
  // one turn after the other, so that a look costs more than where each has one turn.
  w.common_above = (int)max_of<int64_t>(64, f.views > 1 ? bins / 16 : bins / 64);
  w.records = scratch->take<Record>(room);
  w.slivers = scratch->take<Record>(room);
  // Few large triangles among many small ones: their records are at hand sooner than lists would be.
  w.common_below = 64;
  w.bands = 1;
  w.sizes = scratch->take<uint32_t>(Waiting::kCounts + bins + words) + Waiting::kCounts;
  w.words = w.sizes + bins;
  w.samples = scratch->take<uint64_t>(1);
  w.slots = scratch->take<uint32_t>(bins * w.list_room);
  w.common_boxes = scratch->take<ViewBox>(room);
  w.common_slots = scratch->take<uint32_t>(room);
  return w;
}

// Puts those of a warp's records of a view that are in `which` (bit k: record k), and which wait in the lanes' slots
// already, into the lists of the bins that no edge rejects; two records at a time, half of the lanes each, so that a
// large one does not hold up a lane. By all lanes.
__device__ __forceinline__ void put_into_lists(const Frame& f, const Waiting& w, const Record* records, int32_t view,
                                               unsigned which, uint32_t slot) {
  constexpr int kTeam = kWarp / 2;
  const bool have = which >> lane_id() & 1;
  bool wide = have && (bin_box(records[have ? lane_id() : 0]).count > w.common_above || slot < w.common_below);
  count_work(f, Counter::entries, wide);
  for (unsigned todo = __ballot_sync(kAllLanes, have && !wide); todo;) {
    const unsigned others = todo & (todo - 1), mine = lane_id() < kTeam ? todo : others;
    const int its_lane = max_of(__ffs(mine) - 1, 0);
    const uint32_t its_slot = __shfl_sync(kAllLanes, slot, its_lane);
    const Record& r = records[mine ? its_lane : __ffs(todo) - 1];
    const BinBox box = bin_box(r);
    bool full = false;
    for (int i = mine ? lane_id() % kTeam : box.count; i < box.count; i += kTeam) {
      const int down = i / box.columns, bin_x = box.x + i - down * box.columns, bin_y = box.y + down;
      bool rejected = false;
      for (int k = 0; k < 3; ++k) rejected |= bin_edge(edge_of(r.x, r.y, k), bin_x, bin_y).highest < 0;
      count_work(f, Counter::bins_tested, 1);
      count_work(f, Counter::bins_rejected, rejected);
      count_work(f, Counter::edges_64, 3);
      if (rejected) continue;
      const int64_t bin = w.bin(view, bin_x, bin_y);
      const uint32_t at = atomicAdd(&w.sizes[bin], 1u);
      count_work(f, Counter::entries, 1);
      count_work(f, Counter::atomics, 1);
      count_work(f, Counter::overflows, at >= (uint32_t)w.list_room);
      count_work(f, Counter::bytes, at < (uint32_t)w.list_room ? sizeof(*w.slots) : 0);
      if (at < (uint32_t)w.list_room)
        w.slots[bin * w.list_room + at] = its_slot;
      else
        full = true;
    }
    const unsigned lanes = __ballot_sync(kAllLanes, full);
    wide |= (lanes & 0xffff) && lane_id() == __ffs(todo) - 1;
    wide |= (lanes >> kTeam) && lane_id() == __ffs(others) - 1;
    todo = others & (others - 1);
  }
  if (wide) {
    const uint32_t at = claim(w.common_count(), w.room, 1);
    count_work(f, Counter::atomics, 1);
    count_work(f, Counter::bytes, sizeof(*w.common_boxes) + sizeof(*w.common_slots));
    w.common_boxes[at] = {box_of(records[lane_id()]), view};
    w.common_slots[at] = slot;
  }
}

// What gather() takes them from.
struct ListedCandidates {
  static constexpr bool kLists = true;
  const Record* records;
  const Waiting& waiting;
  const bool any;  // in lists

  __device__ ListedCandidates(const Waiting& w, bool any_listed) : records(w.records), waiting(w), any(any_listed) {}
  __device__ __forceinline__ ViewBox box(int i) const { return waiting.common_boxes[i]; }
  __device__ __forceinline__ int slot(int i) const { return (int)waiting.common_slots[i]; }
  __device__ __forceinline__ int listed(int view, int bin_x, int bin_y) const {
    return !any ? 0 : (int)min_of(waiting.sizes[waiting.bin(view, bin_x, bin_y)], (uint32_t)waiting.list_room);
  }
  __device__ __forceinline__ int listed_slot(int view, int bin_x, int bin_y, int i) const {
    return (int)waiting.slots[waiting.bin(view, bin_x, bin_y) * waiting.list_room + i];
  }
};

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// The queue between set-up and drawing of the variants whose warps take a record's bin at a time: pairs of a record and a
// bin, first come, first served. What finds no room is drawn at once, with atomics, so that nothing is lost.
#pragma once

#include "counting.cuh"
#include "direct.cuh"
#include "primitives.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

struct Pair {
  uint32_t record;
  uint16_t bin_x, bin_y;
};

struct PairQueue {
  enum Counter { kRecordCount, kPairCount, kNextPair, kCounters };

  SetUp set_up;
  Record* records;
  Pair* pairs;
  uint64_t* counters;
  uint32_t record_room, pair_room;

  Zeros zeros() const { return Zeros::of(counters, kCounters); }
};

// queue: records that may wait. search: as in BIGTRI_SEARCH_PARAMETER.
PairQueue take_pairs(Scratch* scratch, const Frame& f, int64_t queue, int64_t search) {
  PairQueue q;
  q.set_up = take_set_up(scratch, f, search);
  q.record_room = (uint32_t)min_of<int64_t>(queue, (int64_t)f.count * kMaxSubTriangles);
  // Sixteen bins for each record that may wait; a queue that is as small as tests make it is small for pairs too, so
  // that they see it full.
  q.pair_room = (uint32_t)(queue < 16 ? queue : 16 * queue);
  q.records = scratch->take<Record>(q.record_room);
  q.pairs = scratch->take<Pair>(q.pair_room);
  q.counters = scratch->take<uint64_t>(PairQueue::kCounters);
  return q;
}

// The record's bins that no edge rejects, a lane each, to the queue; what finds no room there is drawn at once. All
// lanes.
__device__ __forceinline__ void queue_pairs(const Frame& f, const PairQueue& q, const Record& r, uint32_t slot) {
  const BinBox bins = bin_box(r);
  if (lane_id() == 0) {
    count_work(f, Counter::candidates, bins.count);
    count_work(f, Counter::bins_tested, bins.count);
    count_work(f, Counter::edges_64, 3 * (int64_t)bins.count);
  }
  for (int base = 0; base < bins.count; base += kWarp) {
    const int i = base + lane_id(), x = bins.x + i % bins.columns, y = bins.y + i / bins.columns;
    TileEdges edges;
    const bool kept = i < bins.count && edges_in_bin(r, x, y, &edges);
    count_work(f, Counter::bins_rejected, i < bins.count && !kept);
    const unsigned all = __ballot_sync(kAllLanes, kept);
    if (!all) continue;
    uint32_t at = 0;
    if (lane_id() == 0) at = claim(&q.counters[PairQueue::kPairCount], q.pair_room, (uint32_t)__popc(all));
    at = __shfl_sync(kAllLanes, at, 0) + __popc(all & lanes_below());
    const bool room = at < q.pair_room;
    count_work(f, Counter::entries, kept);
    count_work(f, Counter::overflows, kept && !room);
    count_work(f, Counter::bytes, kept && room ? sizeof(Pair) : 0);
    if (kept && room) q.pairs[at] = {slot, (uint16_t)x, (uint16_t)y};
    for (unsigned todo = __ballot_sync(kAllLanes, kept && !room); todo; todo &= todo - 1) {
      const int lane = __ffs(todo) - 1;
      warp_draw_bin(frame_pixel(f, f.packed), f.view.width, r, __shfl_sync(kAllLanes, x, lane),
                    __shfl_sync(kAllLanes, y, lane));
    }
  }
}

// A warp's records to the queue, one at a time with all lanes, so that a huge one holds up no lane; what finds no room
// is drawn.
__device__ __noinline__ void queue_or_draw(const Frame& f, const PairQueue& q, const Record* records, int count) {
  if (lane_id() == 0) {
    count_work(f, Counter::records, count);
    count_work(f, Counter::by_tiles, count);
  }
  uint32_t first = 0;
  if (lane_id() == 0) first = claim(&q.counters[PairQueue::kRecordCount], q.record_room, (uint32_t)count);
  first = __shfl_sync(kAllLanes, first, 0);
  for (int i = 0; i < count; ++i) {
    const uint32_t slot = first + (uint32_t)i;
    if (slot < q.record_room) {
      copy_record(q.records + slot, records[i]);
      if (lane_id() == 0) count_work(f, Counter::bytes, sizeof(Record));
      queue_pairs(f, q, records[i], slot);
    } else {
      if (lane_id() == 0) count_work(f, Counter::overflows, 1);
      warp_draw(frame_pixel(f, f.packed), f.view.width, records[i]);
    }
  }
  __syncwarp();
}

// Takes pairs until there is none left, and calls draw(record, bin_x, bin_y) for each. By all lanes, after the kernel that
// queued them has ended.
template <class Draw>
__device__ __forceinline__ void each_pair(const PairQueue& q, const Draw& draw) {
  const uint32_t count = (uint32_t)min_of<uint64_t>(q.counters[PairQueue::kPairCount], q.pair_room);
  for (;;) {
    uint32_t i = 0;
    if (lane_id() == 0) i = claim(&q.counters[PairQueue::kNextPair], count, 1);
    i = __shfl_sync(kAllLanes, i, 0);
    if (i >= count) return;
    const Pair pair = q.pairs[i];
    draw(q.records[pair.record], pair.bin_x, pair.bin_y);
  }
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

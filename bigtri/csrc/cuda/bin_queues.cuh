// A queue for each bin of an image, of as many px as the variant wants, between set-up and the blocks that own bins. What
// finds a queue full goes to one that all bins look at, and records for which there is no memory are drawn at once, with
// atomics: nothing is lost.
#pragma once

#include "counting.cuh"
#include "direct.cuh"
#include "primitives.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// Calls use(square) for the squares of `size` px that the record's bounding box meets and that no edge rejects, numbered
// row by row, `columns` a row; a lane each. By all lanes. In int64: edges may be far away.
template <class Use>
__device__ __forceinline__ void each_square(const Frame& f, const Record& r, int size, int columns, const Use& use) {
  const int x0 = r.x0 / size, y0 = r.y0 / size, across = (r.x1 - 1) / size - x0 + 1,
            count = across * ((r.y1 - 1) / size - y0 + 1);
  for (int i = lane_id(); i < count; i += kWarp) {
    const int x = x0 + i % across, y = y0 + i / across;
    bool rejected = false;
    for (int k = 0; k < 3; ++k) {
      const Edge e = edge_of(r.x, r.y, k);
      rejected |=
          edge_steps(e, x * size, y * size) + (int64_t)(size - 1) * ((int64_t)max_of(-e.dy, 0) + max_of(e.dx, 0)) < 0;
    }
    count_work(f, Counter::bins_tested, 1);
    count_work(f, Counter::bins_rejected, rejected);
    count_work(f, Counter::edges_64, 3);
    if (!rejected) use(y * columns + x);
  }
}

struct BinQueues {
  enum Counter { kRecordCount, kLeftCount, kNextBin, kCounters };

  SetUp set_up;
  Record* records;
  uint64_t* counters;
  uint32_t* sizes;  // of the queues, or what they were to be
  uint32_t* slots;  // of records, `room` of each bin
  uint32_t* left;  // slots of records that found a queue full
  uint32_t record_room;
  int size;  // of a bin, px
  int columns, count;  // of bins
  int room;

  Zeros zeros() const { return {reinterpret_cast<uint32_t*>(counters), 2 * kCounters + count}; }
  // Whether records have been drawn at once.
  __device__ __forceinline__ bool others() const { return counters[kRecordCount] > record_room; }
  // What a bin looks at: so many records, each by its slot.
  __device__ __forceinline__ int length(int bin) const {
    return (int)(min_of(sizes[bin], (uint32_t)room) + min_of<uint64_t>(counters[kLeftCount], record_room));
  }
  __device__ __forceinline__ uint32_t slot(int bin, int i) const {
    const int own = (int)min_of(sizes[bin], (uint32_t)room);
    return i < own ? slots[(int64_t)bin * room + i] : left[i - own];
  }
};

constexpr int64_t kQueueBytes = 32 << 20;  // for all queues together

// Slots of each of `count` queues: as many as wanted, and as memory allows, but no more than there are records.
inline int64_t queue_room(int64_t wanted, int64_t records, int64_t count) {
  const int64_t allowed = max_of<int64_t>(1, kQueueBytes / (int64_t)sizeof(uint32_t) / count);
  return min_of<int64_t>(records, wanted > 0 ? min_of<int64_t>(wanted, allowed) : allowed);
}

// queue: records that may wait; room: wanted in each bin's queue, or 0; search: as in BIGTRI_SEARCH_PARAMETER; size: of a
// bin, px.
BinQueues take_bin_queues(Scratch* scratch, const Frame& f, int64_t queue, int64_t room, int64_t search, int size) {
  BinQueues q;
  q.set_up = take_set_up(scratch, f, search);
  q.size = size;
  q.columns = (f.view.width + size - 1) / size;
  q.count = q.columns * ((f.view.height + size - 1) / size);
  q.record_room = (uint32_t)min_of<int64_t>(queue, (int64_t)f.count * kMaxSubTriangles);
  q.room = (int)queue_room(room, q.record_room, q.count);
  q.records = scratch->take<Record>(q.record_room);
  q.counters = scratch->take<uint64_t>(BinQueues::kCounters + (q.count + 1) / 2);
  q.sizes = reinterpret_cast<uint32_t*>(q.counters + BinQueues::kCounters);
  q.slots = scratch->take<uint32_t>((int64_t)q.count * q.room);
  q.left = scratch->take<uint32_t>(q.record_room);
  return q;
}

// A warp's records to the queues, one at a time with all lanes.
__device__ __noinline__ void queue_or_draw(const Frame& f, const BinQueues& q, const Record* records, int count) {
  if (lane_id() == 0) {
    count_work(f, Counter::records, count);
    count_work(f, Counter::by_tiles, count);
  }
  uint32_t first = 0;
  if (lane_id() == 0) first = claim(&q.counters[BinQueues::kRecordCount], q.record_room, (uint32_t)count);
  first = __shfl_sync(kAllLanes, first, 0);
  for (int i = 0; i < count; ++i) {
    const uint32_t slot = first + (uint32_t)i;
    if (slot >= q.record_room) {
      if (lane_id() == 0) count_work(f, Counter::overflows, 1);
      warp_draw(frame_pixel(f, f.packed), f.view.width, records[i]);
      continue;
    }
    copy_record(q.records + slot, records[i]);
    if (lane_id() == 0) count_work(f, Counter::bytes, sizeof(Record));
    bool full = false;
    each_square(f, records[i], q.size, q.columns, [&](int bin) {
      const uint32_t at = atomicAdd(&q.sizes[bin], 1u);
      count_work(f, Counter::entries, 1);
      count_work(f, Counter::atomics, 1);
      count_work(f, Counter::overflows, at >= (uint32_t)q.room);
      count_work(f, Counter::bytes, at < (uint32_t)q.room ? sizeof(*q.slots) : 0);
      if (at < (uint32_t)q.room)
        q.slots[(int64_t)bin * q.room + at] = slot;
      else
        full = true;
    });
    if (__any_sync(kAllLanes, full) && lane_id() == 0) {
      q.left[claim(&q.counters[BinQueues::kLeftCount], q.record_room, 1)] = slot;
      count_work(f, Counter::bytes, sizeof(*q.left));
    }
  }
  __syncwarp();
}

// The next bin that nobody has taken yet, or one beyond the last. By all threads of a block.
__device__ __forceinline__ int next_bin(const BinQueues& q, int* shared) {
  __syncthreads();
  if (threadIdx.x == 0) *shared = (int)claim(&q.counters[BinQueues::kNextBin], (uint32_t)q.count, 1);
  __syncthreads();
  return *shared;
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

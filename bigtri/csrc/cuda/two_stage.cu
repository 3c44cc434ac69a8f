// The two-stage variant: set-up puts the pairs of (large record, bin) into one global queue; then warps take them,
// first come, first served, make the 64-bit masks of the bin's tiles, and draw the tiles with an atomic minimum a
// fragment, the pixel read first. Small triangles are drawn at set-up, by rows, or where the caller or the rung has it
// so, wait like the others.

#include "clear.h"
#include "depth_image.h"
#include "direct.cuh"
#include "parameters.h"
#include "share.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

#define BIGTRI_LIST(X)       \
  BIGTRI_BLOCKS_PARAMETER(X) \
  BIGTRI_QUEUE_PARAMETER(X)  \
  BIGTRI_WIDEST_PARAMETER(X) \
  BIGTRI_SHARE_PARAMETER(X)  \
  BIGTRI_ROWS_PARAMETER(X)
BIGTRI_PARAMETERS(BIGTRI_LIST)

// Rows rest on what bin_owned rests on: edges in int32 over a bounding box, and the planes of core/depth.h.
constexpr bool kHasRows = Rung::kBinOwned;
static_assert(!kHasRows || (!kFloatCoverage && !Rung::kWideEdges && !Rung::kWraps),
              "what is drawn by rows has the rung's bits");

enum Counter { kRecordCount, kPairCount, kNextPair, kCounters };

struct Pair {
  uint32_t record;
  uint16_t bin_x, bin_y;
};

struct Queue {
  Record* records;
  Pair* pairs;
  uint64_t* counters;
  uint32_t record_room, pair_room;
  Vertex* projected;
};

Queue take_queue(Scratch* scratch, const Frame& f, const Values& v) {
  Queue q;
  q.record_room = (uint32_t)min_of<int64_t>(v.queue, (int64_t)f.count * kMaxSubTriangles);
  // Sixteen bins for each record that may wait; a queue that is as small as tests make it is small for pairs too, so
  // that they see it full.
  q.pair_room = (uint32_t)(v.queue < 16 ? v.queue : 16 * v.queue);
  q.records = scratch->take<Record>(q.record_room);
  q.pairs = scratch->take<Pair>(q.pair_room);
  q.counters = scratch->take<uint64_t>(kCounters);
  q.projected = take_projected(scratch, f, way_of(v.share) == Way::kTested);
  return q;
}

// The record's bins that no edge rejects, a lane each, to the queue; what finds no room there is drawn at once. All
// lanes.
__device__ __forceinline__ void queue_pairs(const Frame& f, const Queue& q, const Record& r, uint32_t slot) {
  const BinBox bins = bin_box(r);
  for (int base = 0; base < bins.count; base += kWarp) {
    const int i = base + lane_id(), x = bins.x + i % bins.columns, y = bins.y + i / bins.columns;
    TileEdges edges;
    const bool kept = i < bins.count && edges_in_bin(r, x, y, &edges);
    const unsigned all = __ballot_sync(kAllLanes, kept);
    if (!all) continue;
    uint32_t at = 0;
    if (lane_id() == 0) at = claim(&q.counters[kPairCount], q.pair_room, (uint32_t)__popc(all));
    at = __shfl_sync(kAllLanes, at, 0) + __popc(all & lanes_below());
    const bool room = at < q.pair_room;
    if (kept && room) q.pairs[at] = {slot, (uint16_t)x, (uint16_t)y};
    for (unsigned todo = __ballot_sync(kAllLanes, kept && !room); todo; todo &= todo - 1) {
      const int lane = __ffs(todo) - 1;
      warp_draw_bin(f.packed, f.view.width, r, __shfl_sync(kAllLanes, x, lane), __shfl_sync(kAllLanes, y, lane));
    }
  }
}

// A warp's records to the queue, one at a time with all lanes, so that a huge one holds up no lane; what finds no room
// is drawn.
__device__ __noinline__ void queue_or_draw(const Frame& f, const Queue& q, const Record* records, int count) {
  uint32_t first = 0;
  if (lane_id() == 0) first = claim(&q.counters[kRecordCount], q.record_room, (uint32_t)count);
  first = __shfl_sync(kAllLanes, first, 0);
  for (int i = 0; i < count; ++i) {
    const uint32_t slot = first + (uint32_t)i;
    if (slot < q.record_room) {
      copy_record(q.records + slot, records[i]);
      queue_pairs(f, q, records[i], slot);
    } else {
      warp_draw(f.packed, f.view.width, records[i]);
    }
  }
  __syncwarp();
}

constexpr int kThreads = 256;

template <Way kWay>
__global__ void __launch_bounds__(block_threads(kWay), blocks_held(kWay))
    set_up_and_enqueue(const __grid_constant__ Frame f, const __grid_constant__ Queue q,
                       const __grid_constant__ Sharing s, int widest) {
  __shared__ ShareShared<kWay> shared;
  let_next_begin();
  draw_share<kWay>(f, s, q.projected, widest, &shared,
                   [&](int32_t, const Record* records, int count) { queue_or_draw(f, q, records, count); });
}

__global__ void __launch_bounds__(kThreads)
    draw_pairs(const __grid_constant__ Frame f, const __grid_constant__ Queue q) {
  let_next_begin();
  wait_for_previous();
  const uint32_t count = (uint32_t)min_of<uint64_t>(q.counters[kPairCount], q.pair_room);
  for (;;) {
    uint32_t i = 0;
    if (lane_id() == 0) i = claim(&q.counters[kNextPair], count, 1);
    i = __shfl_sync(kAllLanes, i, 0);
    if (i >= count) return;
    const Pair pair = q.pairs[i];
    warp_draw_bin(f.packed, f.view.width, q.records[pair.record], pair.bin_x, pair.bin_y);
  }
}

// kRows: whether the rung has the kernels that draw by rows.
template <bool kRows>
cudaError_t draw_view(const Frame& f, const Values& v, void* memory, cudaStream_t stream) {
  Scratch scratch = {static_cast<char*>(memory)};
  Queue q = take_queue(&scratch, f, v);
  Sharing sharing;
  int64_t set_up_blocks;
  Way way = Way::kQueued;
  if constexpr (kRows)
    if (v.rows) {
      BIGTRI_CUDA(share_triangles(set_up_and_enqueue<Way::kEven>, f, q.projected, v.share, nullptr, &sharing,
                                  &set_up_blocks, stream));
      way = way_of(sharing.each);
    }
  if (way == Way::kQueued)
    BIGTRI_CUDA(share_queued(set_up_and_enqueue<Way::kQueued>, f, v.share, &sharing, &set_up_blocks));
  if (way == Way::kTogether) q.projected = nullptr;  // blocks project corners while the image is cleared
  BIGTRI_CUDA(launch_clear(f, q.projected, Zeros::of(q.counters, kCounters), stream));
  if (f.count > 0) {
    int blocks;
    const int widest = widest_rows(f, way, v.widest);
    const auto set_up = [&](auto of) {
      return launch_next(set_up_and_enqueue<of.value>, set_up_blocks, block_threads(of.value), 0, stream, f, q, sharing,
                         widest);
    };
    if (way == Way::kQueued) BIGTRI_CUDA(set_up(WayOf<Way::kQueued>()));
    if constexpr (kRows)
      if (way != Way::kQueued) BIGTRI_CUDA(with_way(way, set_up));
    BIGTRI_CUDA(blocks_for(draw_pairs, kThreads, 0, INT32_MAX, v.blocks, &blocks));
    BIGTRI_CUDA(launch_next(draw_pairs, blocks, kThreads, 0, stream, f, q));
  }
  return launch_depth(f, v.blocks, stream);
}

int64_t scratch_bytes(const Frame& f, const int64_t* values) {
  Scratch scratch = {nullptr};
  take_queue(&scratch, f, Values::of(values));
  return scratch.used;
}

cudaError_t draw(const Frame& frame, const int64_t* values, void* memory, cudaStream_t stream) {
  const Values v = Values::of(values);
  return each_view(frame, [&](const Frame& f) { return draw_view<kHasRows>(f, v, memory, stream); });
}

}  // namespace

extern const CudaVariant two_stage_variant;
const CudaVariant two_stage_variant = {
    "two_stage",
    "two stages with one global queue of (record, bin) pairs between them, atomics: another project's; docs/cuda.md",
    kParameters, scratch_bytes, draw};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

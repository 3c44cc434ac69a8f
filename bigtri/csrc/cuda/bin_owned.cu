// The variant that "auto" means: blocks own pixels and write each once. How triangles get to the pixels depends on how many there are, which the host knows without asking the device:
//   alone  set-up to records; then every warp looks at all of them for each of its regions;
//   few    set-up; then every block looks at all of them for each of its patches;
//   some   the same, but for slivers, which are drawn last;
//   many   clear, set-up that draws small triangles at once and queues large ones and slivers, then these.

#include "direct.cuh"
#include "launch.cuh"
#include "patch.cuh"
#include "small.cuh"

namespace bigtri {
namespace {

// --- up to some

constexpr int kSetupTriangles = 64, kSetupThreads = 3 * kSetupTriangles;  // a thread a corner, then a thread a triangle
constexpr int kParts = kSetupTriangles * kMaxSubTriangles;  // that the clipped triangles of a block can become

// Record t is triangle t's, if it is drawn whole. The parts of clipped triangles follow, kParts for each block of the set-up; there are part_count of them.
struct Records {
  Record* records;
  uint32_t* boxes;
  int32_t* part_count;
  int32_t* dropped;
  int triangles, blocks;

  __host__ __device__ int first_part(int block) const { return triangles + block * kParts; }
};

struct RecordCandidates {
  const Record* records;
  const uint32_t* boxes;
  const Records& all;
  int count;

  __device__ explicit RecordCandidates(const Records& r) : records(r.records), boxes(r.boxes), all(r), count(r.triangles) {
#pragma unroll 1
    for (int b = 0; b < r.blocks; ++b) count += r.part_count[b];
  }
  __device__ __forceinline__ int slot(int i) const {
    if (i < all.triangles) return i;
    i -= all.triangles;
    int b = 0;
#pragma unroll 1
    for (; i >= all.part_count[b]; ++b) i -= all.part_count[b];
    return all.first_part(b) + i;
  }
};

Records take_records(Scratch* scratch, const Frame& f) {
  Records r;
  r.triangles = f.count;
  r.blocks = max_of((f.count + kSetupTriangles - 1) / kSetupTriangles, 1);
  const int64_t room = (int64_t)r.triangles + (int64_t)r.blocks * kParts;
  r.records = scratch->take<Record>(room);
  r.boxes = scratch->take<uint32_t>(room);
  r.part_count = scratch->take<int32_t>(r.blocks);
  r.dropped = scratch->take<int32_t>(r.blocks);
  return r;
}

__device__ __forceinline__ void put_record(const Primitive& p, int64_t triangle, bool slivers, Record* record, uint32_t* box) {
  fill_record(p, triangle, record);
  *box = slivers && is_sliver(p) ? kSliverBox : box_of(*record);
}

__global__ void __launch_bounds__(kSetupThreads) set_up_records(const __grid_constant__ Frame f, const __grid_constant__ Records r, bool slivers) {
  __shared__ ClipScratch clip[kSetupTriangles / kWarp];
  __shared__ Vertex corners[kSetupThreads];
  __shared__ int parts;
  let_next_begin();
  const int64_t base = (int64_t)blockIdx.x * kSetupTriangles, t = base + threadIdx.x;
  const int count = (int)min_of<int64_t>(f.count - base, kSetupTriangles);
  if (threadIdx.x == 0) parts = 0;
  project_corners(f, base, count, corners, threadIdx.x, kSetupThreads);
  __syncthreads();
  Fate fate = Fate::kNothing;
  if ((int)threadIdx.x < count) {
    Primitive p;
    fate = assemble(f, corners + 3 * threadIdx.x, &p);
    if (fate == Fate::kWhole)
      put_record(p, t, slivers, r.records + t, r.boxes + t);
    else
      r.boxes[t] = kNoBox;
  }
  for (unsigned todo = __ballot_sync(kAllLanes, fate == Fate::kClip); todo; todo &= todo - 1) {
    const int32_t triangle = (int32_t)(t - lane_id()) + __ffs(todo) - 1;
    Primitive part;
    if (clip_part(f, triangle, &clip[threadIdx.x / kWarp], &part)) {
      const int64_t slot = (int64_t)r.first_part((int)blockIdx.x) + atomicAdd(&parts, 1);
      put_record(part, triangle, slivers, r.records + slot, r.boxes + slot);
    }
  }
  const int dropped = __syncthreads_count(fate == Fate::kDropped);
  if (threadIdx.x == 0) {
    r.part_count[blockIdx.x] = parts;
    r.dropped[blockIdx.x] = dropped;
  }
}

// The drawing kernel's last word: what the blocks of the set-up have dropped.
__device__ __forceinline__ void sum_dropped(const Frame& f, const Records& r) {
  if (blockIdx.x > 0 || threadIdx.x > 0) return;
  int64_t dropped = 0;
#pragma unroll 1
  for (int i = 0; i < r.blocks; ++i) dropped += r.dropped[i];
  *f.dropped = dropped;
}

constexpr int kAloneThreads = 256, kAloneWarps = kAloneThreads / kWarp;

__global__ void __launch_bounds__(kAloneThreads, 4) draw_alone(const __grid_constant__ Frame f, const __grid_constant__ Records r, int room) {
  __shared__ Entry entries[kAloneWarps][kWarp];
  wait_for_previous();
  let_next_begin();
  const int warp = threadIdx.x / kWarp, regions = ((f.view.width + kRegion - 1) / kRegion) * ((f.view.height + kRegion - 1) / kRegion);
  const RecordCandidates candidates(r);
  for (int i = blockIdx.x * kAloneWarps + warp; i < regions; i += gridDim.x * kAloneWarps) draw_region(f, candidates, i, room, entries[warp]);
  sum_dropped(f, r);
}

template <int kWarps>
__global__ void __launch_bounds__(kWarps* kWarp, 32 / kWarps) draw_together(const __grid_constant__ Frame f, const __grid_constant__ Records r, int room) {
  wait_for_previous();
  let_next_begin();
  const int patches = Patch<kWarps>::count(f.view);
  const RecordCandidates candidates(r);
  for (int i = blockIdx.x; i < patches; i += gridDim.x) draw_patch<kWarps, Output::kWrite>(f, candidates, Patch<kWarps>::at(f.view, i), room);
  sum_dropped(f, r);
}

constexpr int kSliverThreads = 128;

__global__ void __launch_bounds__(kSliverThreads) draw_slivers(const __grid_constant__ Frame f, const __grid_constant__ Records r) {
  let_next_begin();
  wait_for_previous();
  const RecordCandidates candidates(r);
  for (int i = blockIdx.x; i < candidates.count; i += gridDim.x) {
    const int slot = candidates.slot(i);
    if (r.boxes[slot] == kSliverBox) draw_sliver(f.packed, f.view.width, r.records + slot, threadIdx.x, kSliverThreads);
  }
}

template <int kWarps>
cudaError_t launch_records(const Frame& f, const Tuning& t, void* memory, cudaStream_t stream) {
  Scratch scratch = {static_cast<char*>(memory)};
  const Records r = take_records(&scratch, f);
  const bool alone = f.count <= t.alone, slivers = !alone && f.count > t.few;
  set_up_records<<<r.blocks, kSetupThreads, 0, stream>>>(f, r, slivers);
  BIGTRI_CUDA(cudaGetLastError());
  Frame undrawn = f;
  if (slivers) undrawn.depth = nullptr;  // they are still to come
  int blocks;
  if (alone) {
    const int64_t regions = (int64_t)((f.view.width + kRegion - 1) / kRegion) * ((f.view.height + kRegion - 1) / kRegion);
    BIGTRI_CUDA(blocks_for(draw_alone, kAloneThreads, 0, (regions + kAloneWarps - 1) / kAloneWarps, t, &blocks));
    return launch_next(draw_alone, blocks, kAloneThreads, 0, stream, undrawn, r, (int)min_of<int64_t>(t.entries, kWarp));
  }
  BIGTRI_CUDA(blocks_for(draw_together<kWarps>, kWarps * kWarp, sizeof(PatchShared), Patch<kWarps>::count(f.view), t, &blocks));
  BIGTRI_CUDA(launch_next(draw_together<kWarps>, blocks, kWarps * kWarp, sizeof(PatchShared), stream, undrawn, r, (int)t.entries));
  if (!slivers) return cudaSuccess;
  BIGTRI_CUDA(blocks_for(draw_slivers, kSliverThreads, 0, f.count, t, &blocks));
  BIGTRI_CUDA(launch_next(draw_slivers, blocks, kSliverThreads, 0, stream, f, r));
  return launch_depth(f, t, stream);
}

// --- many

enum Counter { kLargeCount, kSliverCount, kCounters };

struct Queues {
  Record *large, *slivers;
  uint32_t* boxes;  // of the large ones
  uint32_t* counters;
  uint32_t room;  // of either
  Vertex* projected;  // all vertices, or null
};

Queues take_queues(Scratch* scratch, const Frame& f, const Tuning& t) {
  Queues q;
  q.room = (uint32_t)min_of<int64_t>(t.queue, (int64_t)f.count * kMaxSubTriangles);
  q.large = scratch->take<Record>(q.room);
  q.slivers = scratch->take<Record>(q.room);
  q.boxes = scratch->take<uint32_t>(q.room);
  q.counters = scratch->take<uint32_t>(kCounters);
  q.projected = take_projected(scratch, f);
  return q;
}

constexpr int kManyThreads = 256;

// Queues what waits for a block, and draws the rest at once, a primitive at a time; all lanes. Rarely called, so that its registers cost the small ones nothing.
__device__ __noinline__ void queue_or_draw(const Frame& f, const Queues& q, int64_t threshold, Primitive p, int64_t triangle, bool have, Record* shared) {
  Record record;
  bool now = have;
  if (have) {
    fill_record(p, triangle, &record, threshold);
    const bool sliver = is_sliver(p);
    if (sliver || (record.flags & kRecordLarge)) {
      const uint32_t slot = atomicAdd(&q.counters[sliver ? kSliverCount : kLargeCount], 1u);
      if (slot < q.room) {
        (sliver ? q.slivers : q.large)[slot] = record;
        if (!sliver) q.boxes[slot] = box_of(record);
        now = false;
      }
    }
  }
  for (unsigned todo = __ballot_sync(kAllLanes, now); todo; todo &= todo - 1) {
    __syncwarp();
    if (lane_id() == __ffs(todo) - 1) *shared = record;
    __syncwarp();
    warp_draw(f, *shared);
  }
  __syncwarp();
}

// Each warp takes `share` triangles, so that there are warps enough also where triangles are not.
__global__ void __launch_bounds__(kManyThreads, 4)
    draw_many(const __grid_constant__ Frame f, const __grid_constant__ Queues q, const __grid_constant__ Tuning t, int share) {
  __shared__ WarpShared shared[kManyThreads / kWarp];
  let_next_begin();
  wait_for_previous();
  set_up_share(f, q.projected, share, shared,
               [&](const Primitive& p, int64_t triangle, bool have, Record* record) { queue_or_draw(f, q, t.threshold, p, triangle, have, record); });
}

// What waits, onto what has been drawn.
template <int kWarps>
__global__ void __launch_bounds__(kWarps* kWarp, 32 / kWarps) draw_queued(const __grid_constant__ Frame f, const __grid_constant__ Queues q, int room) {
  let_next_begin();
  wait_for_previous();
  const int large = (int)min_of(q.counters[kLargeCount], q.room), slivers = (int)min_of(q.counters[kSliverCount], q.room);
  if (large > 0)
    for (int i = blockIdx.x, n = Patch<kWarps>::count(f.view); i < n; i += gridDim.x)
      draw_patch<kWarps, Output::kMerge>(f, Candidates{q.large, q.boxes, large}, Patch<kWarps>::at(f.view, i), room);
  for (int i = blockIdx.x; i < slivers; i += gridDim.x) draw_sliver(f.packed, f.view.width, q.slivers + i, threadIdx.x, kWarps * kWarp);
}

template <int kWarps>
cudaError_t launch_many(const Frame& f, const Tuning& t, void* memory, cudaStream_t stream) {
  Scratch scratch = {static_cast<char*>(memory)};
  const Queues q = take_queues(&scratch, f, t);
  BIGTRI_CUDA(launch_clear(f, q.projected, q.counters, kCounters, stream));
  int share;
  int64_t set_up_blocks;
  BIGTRI_CUDA(share_triangles(draw_many, kManyThreads, f.count, &share, &set_up_blocks));
  BIGTRI_CUDA(launch_next(draw_many, set_up_blocks, kManyThreads, 0, stream, f, q, t, share));
  int blocks;
  BIGTRI_CUDA(blocks_for(draw_queued<kWarps>, kWarps * kWarp, sizeof(PatchShared), Patch<kWarps>::count(f.view), t, &blocks));
  return launch_next(draw_queued<kWarps>, blocks, kWarps * kWarp, sizeof(PatchShared), stream, f, q, (int)t.entries);
}

template <int kWarps>
cudaError_t launch(const Frame& f, const Tuning& t, void* scratch, cudaStream_t stream) {
  if (f.count <= max_of(max_of(t.alone, t.few), t.some)) return launch_records<kWarps>(f, t, scratch, stream);
  BIGTRI_CUDA(launch_many<kWarps>(f, t, scratch, stream));
  return launch_depth(f, t, stream);
}

}  // namespace

int64_t bin_owned_scratch(const Frame& f, const Tuning& t) {
  Scratch scratch = {nullptr};
  if (f.count > max_of(max_of(t.alone, t.few), t.some))
    take_queues(&scratch, f, t);
  else
    take_records(&scratch, f);
  return scratch.used;
}

cudaError_t draw_bin_owned(const Frame& f, const Tuning& t, void* scratch, cudaStream_t stream) {
  switch (t.warps) {
    case 4: return launch<4>(f, t, scratch, stream);
    case 16: return launch<16>(f, t, scratch, stream);
    default: return launch<8>(f, t, scratch, stream);
  }
}

}  // namespace bigtri

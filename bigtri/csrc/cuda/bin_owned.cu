// The variant that "auto" means: blocks own pixels and write each once. How triangles get to the pixels depends on how many there are, which the host knows without asking the device:
//   few   every block sets up all of them by itself, looks at all of them for each of its patches, and draws these;
//   some  set-up to records; then every block looks at all of them for each of its patches, but for slivers, which are drawn last;
//   many  clear, set-up that draws small triangles at once and queues large ones and slivers, then these.

#include "direct.cuh"
#include "launch.cuh"
#include "lists.cuh"
#include "sliver.cuh"
#include "small.cuh"

namespace bigtri {
namespace {

// --- few

// Shared memory of a block that sets up all triangles itself.
template <int kWarps>
struct FewShared {
  static constexpr int kMost = 16 * kWarps, kRecords = 19 * kWarps;  // triangles; records at a time, the parts of clipped triangles among them
  union {
    PatchShared<kWarps> patch;  // has to come first
    Vertex corners[3 * kMost];  // all vertices, or three for each triangle
    ClipScratch clip[kWarps / 2];
  };
  Record records[kRecords];
  uint32_t boxes[kRecords];
  uint16_t waiting[2][kMost];  // triangles to clip: those of this round, and those whose parts find no room in it
  int waiting_count[2];
  int record_count;  // asked for
  int record_end;  // given
  int round;
  __device__ FewShared() {}
};
static_assert(FewShared<4>::kRecords >= kMaxSubTriangles, "a round clips one triangle at least");
static_assert(3 * FewShared<16>::kMost * sizeof(Vertex) <= sizeof(PatchShared<16>::entries) && 8 * sizeof(ClipScratch) <= sizeof(PatchShared<16>::entries),
              "begin_turn writes behind what set-up uses");
static_assert(sizeof(FewShared<16>) <= 64 * 1024, "as much as a block can have on all devices");

// Sets up the triangles; returns how many were dropped. By all threads.
template <int kWarps>
__device__ __forceinline__ int set_up_few(const Frame& f, FewShared<kWarps>* s) {
  constexpr int kThreads = kWarps * kWarp;
  const int t = threadIdx.x;
  int32_t corner[3];  // where the thread's triangle has its own
  const bool valid = t < f.count && load_indices(f, t, corner);
  if (f.vertices <= 3 * FewShared<kWarps>::kMost) {  // all vertices, each once, and without waiting for the indices
    constexpr int kEach = 2;
    static_assert(kEach * kThreads >= 3 * FewShared<kWarps>::kMost, "all of them");
    project_vertices<kEach>(f, t, kThreads, [&](const Vertex& p, int64_t i) { s->corners[i] = p; });
  } else {
    project_corners(f, 0, f.count, s->corners, t, kThreads);
    for (int k = 0; k < 3; ++k) corner[k] = 3 * t + k;
  }
  if (t == kThreads - 1) {
    s->waiting_count[0] = s->waiting_count[1] = 0;
    s->round = 0;
    s->patch.begin(f.count, false);
  }
  begin_turn<kWarps>(f, blockIdx.x);
  __syncthreads();
  Fate fate = t < f.count ? Fate::kDropped : Fate::kNothing;
  if (t < f.count) s->boxes[t] = kNoBox;
  if (valid) {
    Primitive p;
    const Vertex v[3] = {s->corners[corner[0]], s->corners[corner[1]], s->corners[corner[2]]};
    fate = assemble(f, v, &p);
    if (fate == Fate::kWhole) {
      fill_record(p, t, &s->records[t]);
      s->boxes[t] = box_of(s->records[t]);
    }
    if (fate == Fate::kClip) s->waiting[0][atomicAdd(&s->waiting_count[0], 1)] = (uint16_t)t;
  }
  return __syncthreads_count(fate == Fate::kDropped);
}

// Clips what waits in round `round`, a triangle a warp, and puts the parts behind the whole triangles, in later rounds where these were. Those that find no room wait for the next round. By all threads.
template <int kWarps>
__device__ __noinline__ void clip_few(const Frame& f, FewShared<kWarps>* s, int round) {
  const int warp = threadIdx.x / kWarp, now = round & 1, later = now ^ 1, count = s->waiting_count[now];
  __syncthreads();
  if (threadIdx.x == 0) {
    s->round = round;
    s->record_count = round > 0 ? 0 : f.count;
    s->record_end = FewShared<kWarps>::kRecords;
    s->waiting_count[later] = 0;
  }
  __syncthreads();
  if (warp < kWarps / 2)
    for (int i = warp; i < count; i += kWarps / 2) {
      const int triangle = s->waiting[now][i];
      Primitive part;
      const bool have = clip_part(f, triangle, &s->clip[warp], &part);
      const unsigned all = __ballot_sync(kAllLanes, have);
      int at = 0;
      if (lane_id() == 0) at = atomicAdd(&s->record_count, __popc(all));
      at = __shfl_sync(kAllLanes, at, 0);
      if (at + __popc(all) > FewShared<kWarps>::kRecords) {  // all parts or none
        if (lane_id() == 0) {
          atomicMin(&s->record_end, at);
          s->waiting[later][atomicAdd(&s->waiting_count[later], 1)] = (uint16_t)triangle;
        }
      } else if (have) {
        at += __popc(all & lanes_below());
        fill_record(part, triangle, &s->records[at]);
        s->boxes[at] = box_of(s->records[at]);
      }
      __syncwarp();
    }
  __syncthreads();
  if (threadIdx.x == 0) s->patch.begin(min_of(s->record_count, s->record_end), round > 0);
  begin_turn<kWarps>(f, blockIdx.x);
  __syncthreads();
}

template <int kWarps>
__global__ void __launch_bounds__(kWarps* kWarp, 32 / kWarps) draw_few(const __grid_constant__ Frame f, int room) {
  extern __shared__ __align__(16) char memory[];
  FewShared<kWarps>* const s = reinterpret_cast<FewShared<kWarps>*>(memory);
  const int dropped = set_up_few(f, s);
  if (blockIdx.x == 0 && threadIdx.x == 0) *f.dropped = dropped;
  if (s->waiting_count[0] > 0) clip_few(f, s, 0);
#pragma unroll 1
  for (;;) {
    draw_patches<kWarps, Output::kWrite, false>(f, Candidates{s->records, s->boxes}, room);
    const int round = reread(s->round) + 1;
    if (s->waiting_count[round & 1] == 0) return;
    clip_few(f, s, round);
  }
}

template <int kWarps>
cudaError_t launch_few(const Frame& f, const Tuning& t, cudaStream_t stream) {
  int blocks;
  BIGTRI_CUDA(blocks_for(draw_few<kWarps>, kWarps * kWarp, sizeof(FewShared<kWarps>), Patch<kWarps>::count(f.view), t, &blocks));
  draw_few<kWarps><<<blocks, kWarps * kWarp, sizeof(FewShared<kWarps>), stream>>>(f, (int)t.entries);
  return cudaGetLastError();
}

// --- some

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
  static constexpr bool kListed = false;
  const Record* records;
  const uint32_t* boxes;
  const Records& all;

  __device__ explicit RecordCandidates(const Records& r) : records(r.records), boxes(r.boxes), all(r) {}
  __device__ __forceinline__ int count() const { return all.triangles + warp_sum(all.part_count, all.blocks); }  // by all lanes of a warp
  __device__ __forceinline__ int slot(int i) const {
    if (i < all.triangles) return i;
    i -= all.triangles;
    int b = 0;
#pragma unroll 1
    for (; i >= all.part_count[b]; ++b) i -= all.part_count[b];
    return all.first_part(b) + i;
  }
  __device__ __forceinline__ uint32_t box(int i) const { return boxes[slot(i)]; }
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

__device__ __forceinline__ void put_record(const Primitive& p, int64_t triangle, Record* record, uint32_t* box) {
  fill_record(p, triangle, record);
  *box = is_sliver(p) ? kSliverBox : box_of(*record);
}

__global__ void __launch_bounds__(kSetupThreads) set_up_records(const __grid_constant__ Frame f, const __grid_constant__ Records r) {
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
      put_record(p, t, r.records + t, r.boxes + t);
    else
      r.boxes[t] = kNoBox;
  }
  for (unsigned todo = __ballot_sync(kAllLanes, fate == Fate::kClip); todo; todo &= todo - 1) {
    const int32_t triangle = (int32_t)(t - lane_id()) + __ffs(todo) - 1;
    Primitive part;
    if (clip_part(f, triangle, &clip[threadIdx.x / kWarp], &part)) {
      const int64_t slot = (int64_t)r.first_part((int)blockIdx.x) + atomicAdd(&parts, 1);
      put_record(part, triangle, r.records + slot, r.boxes + slot);
    }
  }
  const int dropped = __syncthreads_count(fate == Fate::kDropped);
  if (threadIdx.x == 0) {
    r.part_count[blockIdx.x] = parts;
    r.dropped[blockIdx.x] = dropped;
  }
}

// What the blocks of the set-up have dropped; by the drawing kernel.
__device__ __forceinline__ void sum_dropped(const Frame& f, const Records& r) {
  if (blockIdx.x > 0 || threadIdx.x >= kWarp) return;
  const int dropped = warp_sum(r.dropped, r.blocks);
  if (threadIdx.x == 0) *f.dropped = dropped;
}

template <int kWarps>
__global__ void __launch_bounds__(kWarps* kWarp, 32 / kWarps) draw_together(const __grid_constant__ Frame f, const __grid_constant__ Records r, int room) {
  begin_turn<kWarps>(f, blockIdx.x);
  wait_for_previous();
  let_next_begin();
  const RecordCandidates candidates(r);
  const int count = candidates.count();
  if (threadIdx.x == 0) patch_shared<kWarps>()->begin(count, false);
  __syncthreads();
  draw_patches<kWarps, Output::kWrite, true>(f, candidates, room);
  sum_dropped(f, r);
}

__global__ void __launch_bounds__(kSliverThreads, 8) draw_slivers(const __grid_constant__ Frame f, const __grid_constant__ Records r) {
  __shared__ SliverShared shared;
  let_next_begin();
  wait_for_previous();
  const RecordCandidates candidates(r);
  const int first = (int)blockIdx.x / sliver_chunks(f.view);
  if (first < f.count) prefetch_sliver(candidates, first);  // not after the number of candidates is known, which takes as long
  draw_all_slivers(f, candidates, candidates.count(), &shared);
}

template <int kWarps>
cudaError_t launch_some(const Frame& f, const Tuning& t, void* memory, cudaStream_t stream) {
  Scratch scratch = {static_cast<char*>(memory)};
  const Records r = take_records(&scratch, f);
  set_up_records<<<r.blocks, kSetupThreads, 0, stream>>>(f, r);
  BIGTRI_CUDA(cudaGetLastError());
  Frame undrawn = f;
  undrawn.depth = nullptr;  // slivers are still to come
  int blocks;
  BIGTRI_CUDA(blocks_for(draw_together<kWarps>, kWarps * kWarp, sizeof(PatchShared<kWarps>), Patch<kWarps>::count(f.view), t, &blocks));
  BIGTRI_CUDA(launch_next(draw_together<kWarps>, blocks, kWarps * kWarp, sizeof(PatchShared<kWarps>), stream, undrawn, r, (int)t.entries));
  BIGTRI_CUDA(blocks_for(draw_slivers, kSliverThreads, 0, (int64_t)f.count * sliver_chunks(f.view), t, &blocks));
  BIGTRI_CUDA(launch_next(draw_slivers, blocks, kSliverThreads, 0, stream, f, r));
  return launch_depth(f, t, stream);
}

// --- many

enum Counter { kLargeCount, kSliverCount, kListCounts };

struct Queues {
  Record *large, *slivers;
  BinLists lists;  // of the large ones
  uint32_t* counters;
  int counter_count;
  uint32_t room;  // of either
  Vertex* projected;  // all vertices, or null
};

Queues take_queues(Scratch* scratch, const Frame& f, const Tuning& t) {
  Queues q;
  q.room = (uint32_t)min_of<int64_t>(t.queue, (int64_t)f.count * kMaxSubTriangles);
  q.large = scratch->take<Record>(q.room);
  q.slivers = scratch->take<Record>(q.room);
  q.counter_count = kListCounts + 1 + (int)bins_of(f.view);
  q.counters = scratch->take<uint32_t>(q.counter_count);
  q.lists = take_lists(scratch, f, t, q.room, q.counters + kListCounts);
  q.projected = take_projected(scratch, f);
  return q;
}

// Queues what waits for a block, and draws the rest at once, a primitive at a time; all lanes. Rarely called, so that its registers cost the small ones nothing.
__device__ __noinline__ void queue_or_draw(const Frame& f, const Queues& q, int64_t threshold, Primitive p, int64_t triangle, bool have, Record* shared) {
  Record record;
  bool now = have, listed = false;
  uint32_t slot = 0;
  if (have) {
    fill_record(p, triangle, &record, threshold);
    const bool sliver = is_sliver(p);
    if (sliver || (record.flags & kRecordLarge)) {
      slot = atomicAdd(&q.counters[sliver ? kSliverCount : kLargeCount], 1u);
      if (slot < q.room) {
        (sliver ? q.slivers : q.large)[slot] = record;
        listed = !sliver;
        now = false;
      }
    }
  }
  put_into_lists(q.lists, p, listed, slot);
  for (unsigned todo = __ballot_sync(kAllLanes, now); todo; todo &= todo - 1) {
    __syncwarp();
    if (lane_id() == __ffs(todo) - 1) *shared = record;
    __syncwarp();
    warp_draw(f, *shared);
  }
  __syncwarp();
}

// Each warp takes `share` triangles, so that there are warps enough also where triangles are not.
__global__ void __launch_bounds__(kShareThreads, kShareBlocks)
    draw_many(const __grid_constant__ Frame f, const __grid_constant__ Queues q, int64_t threshold, int share) {
  __shared__ WarpShared shared[kShareThreads / kWarp];
  let_next_begin();
  wait_for_previous();
  set_up_share(f, q.projected, share, shared,
               [&](const Primitive& p, int64_t triangle, bool have, Record* record) { queue_or_draw(f, q, threshold, p, triangle, have, record); });
}

// What waits, onto what has been drawn.
template <int kWarps>
__global__ void __launch_bounds__(kWarps* kWarp, 32 / kWarps) draw_queued(const __grid_constant__ Frame f, const __grid_constant__ Queues q, int room) {
  __shared__ SliverShared shared;
  let_next_begin();
  begin_turn<kWarps>(f, blockIdx.x);
  wait_for_previous();
  const int slivers = (int)min_of(q.counters[kSliverCount], q.room);
  if (q.counters[kLargeCount] > 0) {
    if (threadIdx.x == 0) patch_shared<kWarps>()->begin((int)*q.lists.wide_size, true);
    __syncthreads();
    draw_patches<kWarps, Output::kMerge, true>(f, ListedCandidates(q.large, q.lists), room);
  }
  draw_all_slivers(f, Candidates{q.slivers, nullptr}, slivers, &shared);
}

template <int kWarps>
cudaError_t launch_many(const Frame& f, const Tuning& t, void* memory, cudaStream_t stream) {
  Scratch scratch = {static_cast<char*>(memory)};
  const Queues q = take_queues(&scratch, f, t);
  BIGTRI_CUDA(launch_clear(f, q.projected, q.counters, q.counter_count, stream));
  int share;
  int64_t set_up_blocks;
  BIGTRI_CUDA(share_triangles(draw_many, kShareThreads, f.count, &share, &set_up_blocks));
  BIGTRI_CUDA(launch_next(draw_many, set_up_blocks, kShareThreads, 0, stream, f, q, t.threshold, share));
  int blocks;
  BIGTRI_CUDA(blocks_for(draw_queued<kWarps>, kWarps * kWarp, sizeof(PatchShared<kWarps>), Patch<kWarps>::count(f.view), t, &blocks));
  BIGTRI_CUDA(launch_next(draw_queued<kWarps>, blocks, kWarps * kWarp, sizeof(PatchShared<kWarps>), stream, f, q, (int)t.entries));
  return launch_depth(f, t, stream);
}

enum class Path { kFew, kSome, kMany };

int warps_of(const Frame& f, const Tuning& t) { return t.warps > 0 ? (int)t.warps : f.count <= 128 ? 8 : 16; }

Path path_of(const Frame& f, const Tuning& t) {
  if (f.count <= min_of<int64_t>(t.few, 16 * warps_of(f, t))) return Path::kFew;
  return f.count <= t.some ? Path::kSome : Path::kMany;
}

template <int kWarps>
cudaError_t launch(const Frame& f, const Tuning& t, void* scratch, cudaStream_t stream) {
  static_assert(FewShared<kWarps>::kMost == 16 * kWarps, "as path_of has it");
  switch (path_of(f, t)) {
    case Path::kFew: return launch_few<kWarps>(f, t, stream);
    case Path::kSome: return launch_some<kWarps>(f, t, scratch, stream);
    default: return launch_many<kWarps>(f, t, scratch, stream);
  }
}

}  // namespace

int64_t bin_owned_scratch(const Frame& f, const Tuning& t) {
  Scratch scratch = {nullptr};
  switch (path_of(f, t)) {
    case Path::kFew: break;
    case Path::kSome: take_records(&scratch, f); break;
    default: take_queues(&scratch, f, t);
  }
  return scratch.used;
}

cudaError_t draw_bin_owned(const Frame& f, const Tuning& t, void* scratch, cudaStream_t stream) {
  switch (warps_of(f, t)) {
    case 4: return launch<4>(f, t, scratch, stream);
    case 16: return launch<16>(f, t, scratch, stream);
    default: return launch<8>(f, t, scratch, stream);
  }
}

}  // namespace bigtri

// The variant that "auto" means: blocks own pixels and write each once. How triangles get to the pixels depends on how
// many there are, which the host knows without asking the device:
//   few   every block sets up all of them by itself, looks at all of them for each of its patches, and draws these;
//   some  set-up to records and, for each bin, a list of them; blocks draw their patches from the lists; slivers and
//   small triangles last; many  clear; set-up that draws small triangles at once and puts what is larger into lists;
//   blocks draw these, and slivers.

#include "clear.h"
#include "depth_image.h"
#include "direct.cuh"
#include "lists.cuh"
#include "parameters.h"
#include "sliver.cuh"
#include "small.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr int64_t kMostKept = 1 << 16;  // triangles that records are kept for, all of them and all parts
constexpr int64_t kWarpsAllowed[] = {0, 4, 8, kMostWarps, -1};
#define BIGTRI_LIST(X)                                                                                                \
  X(few, "triangles", "up to so many, and 16 for each warp of a block, every block sets up all of them by itself",    \
    256, 0, kMostKept)                                                                                                \
  X(some, "triangles",                                                                                                \
    "up to so many, blocks write the pixels that they own, then small triangles follow; above, small triangles come " \
    "first",                                                                                                          \
    32768, 0, kMostKept)                                                                                              \
  X(warps, "warps", "of a block that owns a patch of 64 px by 4 px a warp; 0: 8 for up to 128 triangles, else 16", 0, \
    0, kMostWarps, kWarpsAllowed)                                                                                     \
  BIGTRI_BLOCKS_PARAMETER(X)                                                                                          \
  X(entries, "records", "that a block draws together, at most 22 for each of its warps", kMostEntries, 1,             \
    kMostEntries)                                                                                                     \
  BIGTRI_QUEUE_PARAMETER(X)                                                                                           \
  X(threshold, "px",                                                                                                  \
    "of bbox above which a record waits where small triangles come first; slivers always do, small whole triangles "  \
    "never",                                                                                                          \
    0, 0, INT64_MAX)                                                                                                  \
  X(cache, "bytes", "that the device's cache holds; 0: what the device says", 0, 0, int64_t{1} << 40)
BIGTRI_PARAMETERS(BIGTRI_LIST)

// --- few

// Triangles that a block of so many warps can set up by itself. A record for each, and for the parts of clipped ones
// three more a warp, are what shared memory has room for beside the entries.
constexpr int most_few(int warps) { return 16 * warps; }

// Shared memory of a block that sets up all triangles itself.
template <int kWarps>
struct FewShared {
  static constexpr int kMost = most_few(kWarps),
                       kRecords =
                           kMost +
                           3 * kWarps;  // triangles; records at a time, the parts of clipped triangles among them
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
static_assert(3 * FewShared<kMostWarps>::kMost * sizeof(Vertex) <= sizeof(PatchShared<kMostWarps>::entries) &&
                  sizeof(FewShared<kMostWarps>::clip) <= sizeof(PatchShared<kMostWarps>::entries),
              "begin_turn writes behind what set-up uses");
static_assert(sizeof(FewShared<kMostWarps>) <= 64 * 1024, "as much as a block can have on all devices");

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
    project_corners(f, s->corners, t, kThreads);
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

// Clips what waits in round `round`, a triangle a warp, and puts the parts behind the whole triangles, in later rounds
// where these were. Those that find no room wait for the next round. By all threads.
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
    draw_patches<kWarps, Output::kWrite>(f, Candidates{s->records, s->boxes}, room);
    const int round = reread(s->round) + 1;
    if (s->waiting_count[round & 1] == 0) return;
    clip_few(f, s, round);
  }
}

template <int kWarps>
cudaError_t launch_few(const Frame& f, const Values& v, cudaStream_t stream) {
  int blocks;
  BIGTRI_CUDA(blocks_for(draw_few<kWarps>, kWarps * kWarp, sizeof(FewShared<kWarps>), Patch<kWarps>::count(f.view),
                         v.blocks, &blocks));
  return launch_first(draw_few<kWarps>, blocks, kWarps * kWarp, sizeof(FewShared<kWarps>), stream, f, (int)v.entries);
}

// --- lists

// Draws the patches of a grid's blocks from the lists, and where the frame has been drawn before, slivers.
template <int kWarps, Output kOutput>
__global__ void __launch_bounds__(kWarps* kWarp, 32 / kWarps)
    draw_listed(const __grid_constant__ Frame f, const __grid_constant__ Waiting w, int room) {
  __shared__ SliverShared shared;
  begin_turn<kWarps>(f, blockIdx.x, kOutput == Output::kWrite ? 1 : 0);
  // While set-up still keeps it waiting: the background into its first patch, which may be all of it.
  if (kOutput == Output::kWrite) {
    Region region = region_of(Patch<kWarps>::at(f.view, blockIdx.x));
    region.clear();
    region.store(f);
  }
  wait_for_previous();
  let_next_begin();
  const uint64_t count = *w.count();
  if (kOutput == Output::kWrite || count > 0) {
    if (threadIdx.x == 0) patch_shared<kWarps>()->begin((int)*w.wide_count(), kOutput == Output::kMerge);
    __syncthreads();
    draw_patches<kWarps, kOutput>(f, ListedCandidates(w, kOutput == Output::kWrite || count > w.wide_below), room);
  }
  if (kOutput == Output::kMerge)
    draw_slivers(
        f, w.slivers, (int)min_of<uint64_t>(*w.sliver_count(), w.room), w.bands, [](int) { return true; }, &shared);
}

template <int kWarps, Output kOutput>
cudaError_t launch_listed(const Frame& f, const Waiting& w, const Values& v, cudaStream_t stream) {
  int blocks;
  BIGTRI_CUDA(blocks_for(draw_listed<kWarps, kOutput>, kWarps * kWarp, sizeof(PatchShared<kWarps>),
                         Patch<kWarps>::count(f.view), v.blocks, &blocks));
  return launch_next(draw_listed<kWarps, kOutput>, blocks, kWarps * kWarp, sizeof(PatchShared<kWarps>), stream, f, w,
                     (int)v.entries);
}

// --- some

// What becomes of a triangle after the owned pixels have been written.
enum Later : uint8_t { kNothingLater, kSmallLater, kSliverLater, kClipLater };

// Slot t is triangle t's. The parts of clipped triangles follow, all of them for the lists, even slivers.
struct Some {
  Waiting waiting;
  Later* later;  // of each triangle
};

Some take_some(Scratch* scratch, const Frame& f, const Values& v) {
  Some s;
  s.waiting =
      take_waiting(scratch, f, v.queue, f.count + min_of<int64_t>(v.queue, (int64_t)f.count * kMaxSubTriangles));
  s.later = scratch->take<Later>(f.count);
  return s;
}

// Records of the lanes' primitives, each in its slot, and of whole triangles what becomes of them; what waits into the
// lists. By all lanes.
__device__ __forceinline__ void put_records(const Some& s, const Primitive& p, int64_t triangle, bool have,
                                            uint32_t slot) {
  Later later = kNothingLater;
  if (have) {
    fill_record(p, triangle, &s.waiting.records[slot]);
    if (slot == (uint32_t)triangle)
      s.later[slot] = later = is_small(p) ? kSmallLater : is_sliver(p) ? kSliverLater : kNothingLater;
  }
  put_into_lists(s.waiting, p, have && later == kNothingLater, slot);
}

constexpr int kZeroThreads = 256;
__global__ void __launch_bounds__(kZeroThreads) clear_lists(const __grid_constant__ Frame f, Zeros zeros) {
  let_next_begin();
  const int i = (int)(blockIdx.x * kZeroThreads + threadIdx.x);
  zeros.set(i, (int)gridDim.x * kZeroThreads);
  if (i == 0) *f.dropped = 0;
}

// Each warp takes `share` triangles. Records of all, and of the parts of clipped ones as far as there is room.
__global__ void __launch_bounds__(kShareThreads, kShareBlocks / 2)
    set_up_records(const __grid_constant__ Frame f, const __grid_constant__ Some s, int share) {
  __shared__ ClipScratch clip[kShareThreads / kWarp];
  const Waiting& w = s.waiting;
  let_next_begin();
  const int warp = threadIdx.x / kWarp;
  const int64_t first = ((int64_t)blockIdx.x * (kShareThreads / kWarp) + warp) * share, t = first + lane_id();
  const bool mine = lane_id() < share && t < f.count;
  Primitive p;
  const Fate fate = mine ? set_up(f, (int32_t)t, nullptr, &p) : Fate::kNothing;
  wait_for_previous();
  put_records(s, p, t, fate == Fate::kWhole, (uint32_t)t);
  Later later = kNothingLater;
  for (unsigned todo = __ballot_sync(kAllLanes, fate == Fate::kClip); todo; todo &= todo - 1) {
    const int lane = __ffs(todo) - 1;
    Primitive part;
    const bool have = clip_part(f, (int32_t)(first + lane), &clip[warp], &part);
    const unsigned all = __ballot_sync(kAllLanes, have);
    uint32_t at = 0;
    if (lane_id() == 0) at = (uint32_t)f.count + claim(w.count(), w.room - (uint32_t)f.count, (uint32_t)__popc(all));
    at = __shfl_sync(kAllLanes, at, 0);
    const bool room = at + __popc(all) <= w.room;  // for all parts or none
    at += __popc(all & lanes_below());
    put_records(s, part, first + lane, have && room, at);
    if (!room && lane_id() == lane) later = kClipLater;
  }
  if (mine && fate != Fate::kWhole) s.later[t] = later;
  count_dropped(f, fate);
}

union LaterShared {
  SliverShared sliver;
  WarpShared warp[kShareThreads / kWarp];
  __device__ LaterShared() {}
};

// Slivers, small triangles, and what found no room, onto the frame. Before its pixels are there this kernel reads what
// set_up_records has written: draw_listed lets it begin only after having waited for that one.
__global__ void __launch_bounds__(kShareThreads, kShareBlocks)
    draw_later(const __grid_constant__ Frame f, const __grid_constant__ Some s, int share) {
  __shared__ LaterShared shared;
  let_next_begin();
  draw_slivers(
      f, s.waiting.records, f.count, s.waiting.bands, [&](int triangle) { return s.later[triangle] == kSliverLater; },
      &shared.sliver);
  WarpShared& own = shared.warp[threadIdx.x / kWarp];
  const int64_t first = ((int64_t)blockIdx.x * (kShareThreads / kWarp) + threadIdx.x / kWarp) * share,
                t = first + lane_id();
  const Later later = lane_id() < share && t < f.count ? s.later[t] : kNothingLater;
  Primitive p;
  if (later == kSmallLater) p = primitive_of(s.waiting.records[t]);
  wait_for_previous();
  if (__any_sync(kAllLanes, later == kSmallLater)) draw_small(f, p, (uint32_t)t, later == kSmallLater, &own.small);
  for (unsigned todo = __ballot_sync(kAllLanes, later == kClipLater); todo; todo &= todo - 1) {
    const int64_t triangle = first + __ffs(todo) - 1;
    Primitive part;
    Record record;
    __syncwarp();
    const bool have = clip_part(f, (int32_t)triangle, &own.clip, &part);
    if (have) fill_record(part, triangle, &record);
    __syncwarp();
    draw_now(f, record, have, &own.record);
  }
}

template <int kWarps>
cudaError_t launch_some(const Frame& f, const Values& v, void* memory, cudaStream_t stream) {
  Scratch scratch = {static_cast<char*>(memory)};
  Some s = take_some(&scratch, f, v);
  BIGTRI_CUDA(sliver_bands(f, v.cache, &s.waiting.bands));
  int share;
  int64_t blocks;
  const Zeros zeros = s.waiting.zeros();
  BIGTRI_CUDA(
      launch_first(clear_lists, (zeros.count + kZeroThreads - 1) / kZeroThreads, kZeroThreads, 0, stream, f, zeros));
  BIGTRI_CUDA(share_triangles(set_up_records, kShareThreads, f.count, &share, &blocks));
  BIGTRI_CUDA(launch_next(set_up_records, blocks, kShareThreads, 0, stream, f, s, share));
  Frame undrawn = f;
  undrawn.depth = nullptr;  // slivers and small triangles are still to come
  BIGTRI_CUDA((launch_listed<kWarps, Output::kWrite>(undrawn, s.waiting, v, stream)));
  BIGTRI_CUDA(share_triangles(draw_later, kShareThreads, f.count, &share, &blocks));
  int for_slivers;
  BIGTRI_CUDA(
      blocks_for(draw_later, kShareThreads, 0, (int64_t)f.count * sliver_chunks(f.view), v.blocks, &for_slivers));
  BIGTRI_CUDA(launch_next(draw_later, max_of<int64_t>(blocks, for_slivers), kShareThreads, 0, stream, f, s, share));
  return launch_depth(f, v.blocks, stream);
}

// --- many

struct Many {
  Waiting waiting;
  Vertex* projected;  // all vertices, or null
};

Many take_many(Scratch* scratch, const Frame& f, const Values& v) {
  Many m;
  m.waiting = take_waiting(scratch, f, v.queue, min_of<int64_t>(v.queue, (int64_t)f.count * kMaxSubTriangles));
  m.waiting.slivers = scratch->take<Record>(m.waiting.room);
  m.waiting.wide_below =
      64;  // few large triangles among many small ones: their records are at hand sooner than lists would be
  m.projected = take_projected(scratch, f);
  return m;
}

// Queues what waits for a block, and draws the rest at once, a primitive at a time; all lanes. Rarely called, so that
// its registers cost the small ones nothing.
__device__ __noinline__ void list_or_draw(const Frame& f, const Waiting& w, int64_t threshold, Primitive p,
                                          int64_t triangle, bool have, Record* shared) {
  Record record;
  bool waits = false, sliver = false;
  uint32_t slot = 0;
  if (have) {
    fill_record(p, triangle, &record, threshold);
    sliver = is_sliver(p);
    waits = sliver || (record.flags & kRecordLarge);
    if (waits) slot = claim(sliver ? w.sliver_count() : w.count(), w.room, 1);
    waits = waits && slot < w.room;
    if (waits) (sliver ? w.slivers : w.records)[slot] = record;
  }
  put_into_lists(w, p, waits && !sliver, slot);
  draw_now(f, record, have && !waits, shared);
}

// Each warp takes `share` triangles, so that there are warps enough also where triangles are not.
__global__ void __launch_bounds__(kShareThreads, kShareBlocks)
    draw_many(const __grid_constant__ Frame f, const __grid_constant__ Many m, int64_t threshold, int share) {
  __shared__ WarpShared shared[kShareThreads / kWarp];
  let_next_begin();
  wait_for_previous();
  set_up_share(f, m.projected, share, shared, [&](const Primitive& p, int64_t triangle, bool have, Record* record) {
    list_or_draw(f, m.waiting, threshold, p, triangle, have, record);
  });
}

template <int kWarps>
cudaError_t launch_many(const Frame& f, const Values& v, void* memory, cudaStream_t stream) {
  Scratch scratch = {static_cast<char*>(memory)};
  Many m = take_many(&scratch, f, v);
  BIGTRI_CUDA(sliver_bands(f, v.cache, &m.waiting.bands));
  BIGTRI_CUDA(launch_clear(f, m.projected, m.waiting.zeros(), stream));
  int share;
  int64_t blocks;
  BIGTRI_CUDA(share_triangles(draw_many, kShareThreads, f.count, &share, &blocks));
  BIGTRI_CUDA(launch_next(draw_many, blocks, kShareThreads, 0, stream, f, m, v.threshold, share));
  BIGTRI_CUDA((launch_listed<kWarps, Output::kMerge>(f, m.waiting, v, stream)));
  return launch_depth(f, v.blocks, stream);
}

enum class Path { kFew, kSome, kMany };

int warps_of(const Frame& f, const Values& v) { return v.warps > 0 ? (int)v.warps : f.count <= 128 ? 8 : 16; }

Path path_of(const Frame& f, const Values& v) {
  if (f.count <= min_of<int64_t>(v.few, most_few(warps_of(f, v)))) return Path::kFew;
  return f.count <= v.some ? Path::kSome : Path::kMany;
}

template <int kWarps>
cudaError_t launch(const Frame& f, const Values& v, void* scratch, cudaStream_t stream) {
  switch (path_of(f, v)) {
    case Path::kFew: return launch_few<kWarps>(f, v, stream);
    case Path::kSome: return launch_some<kWarps>(f, v, scratch, stream);
    default: return launch_many<kWarps>(f, v, scratch, stream);
  }
}

int64_t scratch_bytes(const Frame& f, const int64_t* values) {
  const Values v = Values::of(values);
  Scratch scratch = {nullptr};
  switch (path_of(f, v)) {
    case Path::kFew: break;
    case Path::kSome: take_some(&scratch, f, v); break;
    default: take_many(&scratch, f, v);
  }
  return scratch.used;
}

cudaError_t draw(const Frame& frame, const int64_t* values, void* scratch, cudaStream_t stream) {
  const Values v = Values::of(values);
  return each_view(frame, [&](const Frame& f) {
    switch (warps_of(f, v)) {
      case 4: return launch<4>(f, v, scratch, stream);
      case kMostWarps: return launch<kMostWarps>(f, v, scratch, stream);
      default: return launch<8>(f, v, scratch, stream);
    }
  });
}

}  // namespace

extern const CudaVariant bin_owned_variant;
const CudaVariant bin_owned_variant = {"bin_owned",
                                       "blocks own pixels and write each once, hidden surfaces rejected; docs/cuda.md",
                                       kParameters, scratch_bytes, draw};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

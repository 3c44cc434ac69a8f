// The variant that "auto" means. How triangles get to the pixels depends on how many there are, which the host knows
// without asking the device:
//   few   one kernel: every block sets up all triangles by itself, looks at all of them for each of its patches of the
//         image, and writes each pixel once, or draws small ones by rows onto the patch;
//   rows  three kernels: clear; set-up, which draws most triangles at once by rows and puts what is too large for that
//         into lists; blocks draw these onto the rest, patch by patch, and slivers. All views of a batch together.

#include "clear.h"
#include "depth_image.h"
#include "direct.cuh"
#include "lists.cuh"
#include "parameters.h"
#include "share.cuh"
#include "sliver.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr int64_t kMostKept = 1 << 16;
constexpr int64_t kWarpsAllowed[] = {0, 8, kMostWarps, -1};
constexpr int64_t kRegionsAllowed[] = {0, 4, 8, kRegion, -1};
#define BIGTRI_LIST(X)                                                                                                \
  X(few, "triangles",                                                                                                 \
    "up to so many, and 16 for each warp of a block, every block sets up all of them by itself; up to 256 only in "   \
    "an image that has many pixels for each",                                                                         \
    kFewTriangles, 0, kMostKept)                                                                                      \
  X(warps, "warps",                                                                                                   \
    "of a block, where triangles are few: four regions of its patch side by side; 0: 8 for up to 128, else 16", 0, 0, \
    kMostWarps, kWarpsAllowed)                                                                                        \
  X(region, "px",                                                                                                     \
    "rows of a warp's 16 px wide region, where triangles are few; 0: 4 in images of up to 2^17 px, 8 up to 2^20, "    \
    "else 16; of 16 warps 4 from 2^18 to 327,680 too",                                                                \
    0, 0, kRegion, kRegionsAllowed)                                                                                   \
  BIGTRI_BLOCKS_PARAMETER(X)                                                                                          \
  X(entries, "records", "that a block draws together, at most 22 for each of its warps", kMostEntries, 1,             \
    kMostEntries)                                                                                                     \
  BIGTRI_QUEUE_PARAMETER(X)                                                                                           \
  BIGTRI_WIDEST_PARAMETER(X)                                                                                          \
  BIGTRI_SHARE_PARAMETER(X)                                                                                           \
  X(team, "blocks",                                                                                                   \
    "that set up the same triangles, and draw a part of their rows each, where that is up to 32 a block and there "   \
    "are no ranges; 0: where share is 0, 4, 2 or 1 by the image and the number of triangles; else 1",                 \
    0, 0, 8, kTeamSizes)                                                                                              \
  X(cache, "bytes", "that the device's cache holds; 0: what the device says", 0, 0, int64_t{1} << 40)
BIGTRI_PARAMETERS(BIGTRI_LIST)

// --- few

// Triangles that a block of so many warps can set up by itself. A record for each, and for the parts of clipped ones
// three more a warp, are what shared memory has room for beside the entries.
constexpr int most_few(int warps) { return 16 * warps; }

// Shared memory of a block that sets up all triangles itself.
template <class P>
struct FewShared {
  static constexpr int kWarps = P::kWarps, kMost = most_few(kWarps);  // triangles
  static constexpr int kRecords = kMost + 3 * kWarps;  // at a time, the parts of clipped triangles among them
  union {
    PatchShared<P> patch;  // has to come first
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

// Sets up the triangles; returns how many were dropped. Where float64 is slow, patches make planes by pairs, and records
// have none. By all threads.
template <class P>
__device__ __forceinline__ int set_up_few(const Frame& f, FewShared<P>* s) {
  constexpr int kThreads = P::kThreads;
  static_assert(FewShared<P>::kRecords >= kMaxSubTriangles, "a round clips one triangle at least");
  static_assert(3 * FewShared<P>::kMost * sizeof(Vertex) <= sizeof(PatchShared<P>::entries) &&
                    sizeof(FewShared<P>::clip) <= sizeof(PatchShared<P>::entries),
                "begin_turn writes behind what set-up uses");
  static_assert(sizeof(FewShared<P>) <= 64 * 1024, "as much as a block can have on all devices");
  const int t = threadIdx.x;
  int32_t corner[3];  // where the thread's triangle has its own
  const bool valid = t < f.count && load_indices(f, t, corner);
  if (f.vertices <= 3 * FewShared<P>::kMost) {  // all vertices, each once, and without waiting for the indices
    constexpr int kEach = 2;
    static_assert(kEach * kThreads >= 3 * FewShared<P>::kMost, "all of them");
    project_vertices<kEach>(f, t, kThreads, f.vertices, [&](const Vertex& p, int64_t i) { s->corners[i] = p; });
  } else {
    project_corners(f, s->corners, t, kThreads);
    for (int k = 0; k < 3; ++k) corner[k] = 3 * t + k;
  }
  if (t == kThreads - 1) {
    s->waiting_count[0] = s->waiting_count[1] = 0;
    s->round = 0;
    s->patch.begin(f.count, false);
  }
  begin_turn<P, false>(f, blockIdx.x);
  __syncthreads();
  Fate fate = t < f.count ? Fate::kDropped : Fate::kNothing;
  if (t < f.count) s->boxes[t] = kNoBox;
  if (valid) {
    Primitive p;
    const Vertex v[3] = {s->corners[corner[0]], s->corners[corner[1]], s->corners[corner[2]]};
    fate = assemble(f, v, &p);
    if (fate == Fate::kWhole) {
      fill_record<!kPairDepth>(p, f.first_triangle + t, &s->records[t]);
      s->boxes[t] = box_of(s->records[t]);
      if (blockIdx.x == 0) {  // the others set up the same
        count_work(f, Counter::records, 1);
        count_work(f, Counter::by_tiles, 1);
      }
    }
    if (fate == Fate::kClip) s->waiting[0][atomicAdd(&s->waiting_count[0], 1)] = (uint16_t)t;
  }
  return __syncthreads_count(fate == Fate::kDropped);
}

// Clips what waits in round `round`, a triangle a warp, and puts the parts behind the whole triangles, in later rounds
// where these were. Those that find no room wait for the next round. By all threads.
template <class P>
__device__ __noinline__ void clip_few(const Frame& f, FewShared<P>* s, int round) {
  constexpr int kWarps = P::kWarps;
  const int warp = threadIdx.x / kWarp, now = round & 1, later = now ^ 1, count = s->waiting_count[now];
  __syncthreads();
  if (threadIdx.x == 0) {
    s->round = round;
    s->record_count = round > 0 ? 0 : f.count;
    s->record_end = FewShared<P>::kRecords;
    s->waiting_count[later] = 0;
  }
  __syncthreads();
  if (warp < kWarps / 2)
    for (int i = warp; i < count; i += kWarps / 2) {
      const int triangle = s->waiting[now][i];
      Primitive part;
      const bool have = clip_part(f, 0, triangle, &s->clip[warp], &part);
      const unsigned all = __ballot_sync(kAllLanes, have);
      int at = 0;
      if (lane_id() == 0) at = atomicAdd(&s->record_count, __popc(all));
      at = __shfl_sync(kAllLanes, at, 0);
      if (at + __popc(all) > FewShared<P>::kRecords) {  // all parts or none
        if (lane_id() == 0) {
          atomicMin(&s->record_end, at);
          s->waiting[later][atomicAdd(&s->waiting_count[later], 1)] = (uint16_t)triangle;
        }
      } else if (have) {
        at += __popc(all & lanes_below());
        fill_record<!kPairDepth>(part, f.first_triangle + triangle, &s->records[at]);
        s->boxes[at] = box_of(s->records[at]);
        if (blockIdx.x == 0) {
          count_work(f, Counter::records, 1);
          count_work(f, Counter::by_tiles, 1);
        }
      }
      __syncwarp();
    }
  __syncthreads();
  if (threadIdx.x == 0) s->patch.begin(min_of(s->record_count, s->record_end), round > 0);
  begin_turn<P, false>(f, blockIdx.x);
  __syncthreads();
}

template <class P>
__global__ void __launch_bounds__(P::kThreads, 32 / P::kWarps) draw_few(const __grid_constant__ Frame f, int room) {
  extern __shared__ __align__(16) char memory[];
  FewShared<P>* const s = reinterpret_cast<FewShared<P>*>(memory);
  const int dropped = set_up_few(f, s);
  if (blockIdx.x == 0 && threadIdx.x == 0) *f.dropped = dropped;
  if (s->waiting_count[0] > 0) clip_few(f, s, 0);
#pragma unroll 1
  for (;;) {
    draw_patches<P>(f, Candidates{s->records, s->boxes}, room);
    const int round = reread(s->round) + 1;
    if (s->waiting_count[round & 1] == 0) return;
    clip_few(f, s, round);
  }
}

template <class P>
cudaError_t launch_few(const Frame& f, const Values& v, cudaStream_t stream) {
  int blocks;
  BIGTRI_CUDA(blocks_for(draw_few<P>, P::kThreads, sizeof(FewShared<P>), P::count(f.view), v.blocks, &blocks));
  return launch_first(draw_few<P>, blocks, P::kThreads, sizeof(FewShared<P>), stream, f, (int)v.entries);
}

// --- rows

struct Rows {
  Waiting waiting;
  Vertex* projected;  // the vertices of all views, or null
  ViewRange* ranges;  // of each view, or null if all draw the same triangles
  Sharing sharing;
  RowLimits limits;  // what is beyond them waits
};

// Waiting::words.
int64_t more_words(const Frame& f, const Values& v) {
  return max_of<int64_t>(may_show_all(f) ? sizeof(Sample) / sizeof(uint32_t) : 0, most_teams(f, v.share, v.team));
}

Rows take_rows(Scratch* scratch, const Frame& f, const Values& v) {
  Rows r;
  r.waiting = take_waiting(scratch, f, v.queue, min_of<int64_t>(v.queue, triangles_of_all(f) * kMaxSubTriangles),
                           more_words(f, v));
  r.projected = take_projected(scratch, f, way_of(v.share) == Way::kTested);
  r.ranges = f.ranges ? scratch->take<ViewRange>(f.views) : nullptr;
  return r;
}

// Places for the records in `which`, whose number the lanes get, from a count of those that wait. By all lanes.
__device__ __forceinline__ void claim_slots(uint64_t* count, uint32_t room, unsigned which, uint32_t* slot) {
  if (!which) return;
  uint32_t first = 0;
  if (lane_id() == 0) first = claim(count, room, (uint32_t)__popc(which));
  first = __shfl_sync(kAllLanes, first, 0);
  if (which >> lane_id() & 1) *slot = first + __popc(which & lanes_below());
}

// Lets a warp's records of a view wait for a block, and draws what finds no room at once. By all lanes. Rarely called,
// so that its registers cost the others nothing.
__device__ __noinline__ void wait_or_draw(const Frame& f, const Waiting& w, int32_t view, const Record* records,
                                          int count) {
  const bool have = lane_id() < count, sliver = have && is_sliver(records[lane_id()]);
  const unsigned all = __ballot_sync(kAllLanes, have), slivers = __ballot_sync(kAllLanes, sliver);
  uint32_t slot = w.room;
  claim_slots(w.count(), w.room, all & ~slivers, &slot);
  claim_slots(w.sliver_count(), w.room, slivers, &slot);
  const unsigned waiting = __ballot_sync(kAllLanes, slot < w.room);
  for (unsigned todo = waiting; todo; todo &= todo - 1) {
    const int i = __ffs(todo) - 1;
    copy_record((slivers >> i & 1 ? w.slivers : w.records) + __shfl_sync(kAllLanes, slot, i), records[i]);
  }
  put_into_lists(f, w, records, view, waiting & ~slivers, slot);
  count_work(f, Counter::records, have);
  count_work(f, Counter::by_tiles, have);
  count_work(f, Counter::overflows, have && !(waiting >> lane_id() & 1));
  count_work(f, Counter::bytes, waiting >> lane_id() & 1 ? sizeof(Record) : 0);
  draw_now(first_pixel(f, view), f.view.width, records, all & ~waiting);
}

template <Way kWay>
__global__ void __launch_bounds__(block_threads(kWay), blocks_held(kWay))
    draw_by_rows(const __grid_constant__ Frame f, const __grid_constant__ Rows r) {
  __shared__ ShareShared<kWay> shared;
  let_next_begin();
  draw_share<kWay>(f, r.sharing, r.projected, r.limits, &shared, [&](int32_t view, const Record* records, int count) {
    wait_or_draw(f, r.waiting, view, records, count);
  });
}

// Most of what waits is slivers and few large triangles: small blocks share it better.
using WaitingPatch = Patch<8, kRegion / 4>;

// Draws what waits: blocks their patches of all views, from the lists, and slivers.
__global__ void __launch_bounds__(WaitingPatch::kThreads, 32 / WaitingPatch::kWarps)
    draw_waiting(const __grid_constant__ Frame f, const __grid_constant__ Waiting w, int room) {
  __shared__ SliverShared shared;
  begin_turn<WaitingPatch, true>(f, blockIdx.x);
  wait_for_previous();
  let_next_begin();
  const uint64_t count = *w.count();
  uint64_t slivers = *w.sliver_count();
  if ((count | slivers) == 0) return;  // as in most frames: known after one wait for memory instead of two
  if (count > 0) {
    if (threadIdx.x == 0) patch_shared<WaitingPatch>()->begin((int)*w.common_count(), true);
    __syncthreads();
    draw_patches<WaitingPatch>(f, ListedCandidates(w, count > w.common_below), room);
    slivers = reread(*w.sliver_count());  // no register keeps it while patches are drawn
  }
  draw_slivers(f, w.slivers, (int)min_of<uint64_t>(slivers, w.room), w.bands, [](int) { return true; }, &shared);
}

cudaError_t launch_rows(const Frame& f, const Values& v, void* memory, cudaStream_t stream) {
  Scratch scratch = {static_cast<char*>(memory)};
  Rows r = take_rows(&scratch, f, v);
  BIGTRI_CUDA(sliver_bands(f, v.cache, &r.waiting.bands));
  int64_t blocks;
  BIGTRI_CUDA(share_triangles(draw_by_rows<Way::kEven>, f, r.projected, v.share, v.team, r.ranges, &r.sharing, &blocks,
                              stream));
  const Way way = r.sharing.way;
  if (together(way)) r.projected = nullptr;  // blocks project corners while the image is cleared
  const bool teams = way == Way::kInTeams;
  int64_t zeros = teams ? blocks >> r.sharing.log_team : 0;  // words: teams' decisions, or what is claimed
  Sample* const sample = r.sharing.in_turns && may_show_all(f) ? reinterpret_cast<Sample*>(r.waiting.words) : nullptr;
  r.sharing.sample = sample;
  if (sample) zeros = 1;  // Sample::claimed
  if (zeros > more_words(f, v)) return cudaErrorInvalidValue;  // or they would lie in the lists
  BIGTRI_CUDA(launch_clear(f, r.projected, r.waiting.zeros(f.views, zeros), stream, sample ? &sample->shown : nullptr));
  r.limits = {widest_rows(f, r.sharing, v.widest), most_large(f, teams, of_sample(r.sharing)),
              most_large(f, teams, r.sharing.group) / 2, v.widest > 0 ? nullptr : r.waiting.samples, r.waiting.words};
  BIGTRI_CUDA(with_way(way, [&](auto of) {
    return launch_next(draw_by_rows<of.value>, blocks, block_threads(of.value), 0, stream, f, r);
  }));
  constexpr int kThreads = WaitingPatch::kThreads, kBytes = sizeof(PatchShared<WaitingPatch>);
  int for_patches;
  BIGTRI_CUDA(blocks_for(draw_waiting, kThreads, kBytes, (int64_t)WaitingPatch::count(f.view) * f.views, v.blocks,
                         &for_patches));
  BIGTRI_CUDA(launch_next(draw_waiting, for_patches, kThreads, kBytes, stream, f, r.waiting, (int)v.entries));
  return launch_depth(f, v.blocks, stream);
}

// ---

// Where triangles are few for the image, they are large, or most of its patches are empty: a number says nothing of which.
// From these pixels on, few takes up to 1.2 times as long as rows, and rows up to 2.3 times as long as few. Rows of more
// triangles are spread over more blocks, while each block of `few` sets up all.
constexpr double kLeastPixelsOfFew = 200;
bool are_few(const Frame& f, const Values& v) {
  return f.views == 1 && !f.ranges &&
         f.count <= min_of<int64_t>(v.few, most_few(v.warps > 0 ? (int)v.warps : kMostWarps)) &&
         (v.few > kFewTriangles || pixels_each(f) >= kLeastPixelsOfFew);
}

int warps_of(const Frame& f, const Values& v) {
  return v.warps > 0 ? (int)v.warps : f.count > most_few(8) ? kMostWarps : 8;
}

// Low regions give a small image enough blocks for the device, and a warp fewer triangles to draw one after the other.
// With more blocks than the device has multiprocessors what all of them do counts: each sets up all triangles. At 640x480
// patches of 64x32 px are already more, and twice as many take little longer.
int region_of(const Frame& f, const Values& v) {
  if (v.region > 0) return (int)v.region;
  const int64_t pixels = (int64_t)f.view.width * f.view.height;
  const bool many = warps_of(f, v) == kMostWarps && pixels > 1 << 18 && pixels <= 5 << 16;
  return pixels <= 1 << 17 || many ? 4 : pixels <= 1 << 20 ? 8 : kRegion;
}

// Up to so many pixels patches are 64x8 px, whatever the number of warps: at 256x256 about one for each multiprocessor.
constexpr int64_t kTinyImage = 1 << 16;

template <int kWarps>
cudaError_t launch_few_with(const Frame& f, const Values& v, cudaStream_t stream) {
  switch (region_of(f, v)) {
    case 4:
      if (pixels_of_all(f) <= kTinyImage) return launch_few<Patch<kWarps, 1, kWarps / 8>>(f, v, stream);
      return launch_few<Patch<kWarps, 1>>(f, v, stream);
    case 8: return launch_few<Patch<kWarps, 2>>(f, v, stream);
    default: return launch_few<Patch<kWarps, 4>>(f, v, stream);
  }
}

int64_t scratch_bytes(const Frame& f, const int64_t* values) {
  const Values v = Values::of(values);
  Scratch scratch = {nullptr};
  if (!are_few(f, v)) take_rows(&scratch, f, v);
  return scratch.used;
}

cudaError_t draw(const Frame& f, const int64_t* values, void* scratch, cudaStream_t stream) {
  const Values v = Values::of(values);
  return launch_as_one(stream, [&] {
    if (!are_few(f, v)) return launch_rows(f, v, scratch, stream);
    return warps_of(f, v) == kMostWarps ? launch_few_with<kMostWarps>(f, v, stream) : launch_few_with<8>(f, v, stream);
  });
}

bool lists_areas(const Frame& f, const int64_t* values) { return !are_few(f, Values::of(values)); }

}  // namespace

extern const CudaVariant bin_owned_variant;
const CudaVariant bin_owned_variant = {
    "bin_owned", "few triangles: blocks own pixels and write each once; else rows of pixels by atomics; docs/cuda.md",
    kParameters, scratch_bytes,
    draw,        lists_areas};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

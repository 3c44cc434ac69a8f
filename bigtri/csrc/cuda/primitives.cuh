// A warp's triangles to primitives, a lane each: the set-up of all variants, but for what is drawn by rows at set-up
// (share.cuh), which takes the same steps. Vertices are projected once, beside the clear, where take_projected() says so.
// Where most triangles cover no pixel, a warp tests 256 of them first, and sets up those that may show, 32 at a time.
#pragma once

#include "clear.h"
#include "clip.cuh"
#include "ways.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr int kMostlyShown = 24;  // triangles of 32 that may show and make testing further ones a waste
constexpr uint32_t kMostShown = kSampled * 3 / 4;  // triangles of a sample that may show and make testing any a waste

// Adds triangles to a view's number of those dropped. By all lanes. Rarely called.
__device__ __noinline__ void count_dropped(const Frame& f, int32_t view, unsigned dropped) {
  wait_for_previous();
  if (lane_id() == 0)
    atomicAdd(reinterpret_cast<unsigned long long*>(f.dropped + view), (unsigned long long)__popc(dropped));
}

// What a warp that tests its triangles knows. It lies in shared memory, so that no register holds it while they are
// drawn.
struct Search {
  int32_t next;  // the first triangle not looked at
  int32_t waiting;  // how many wait in the list
  bool test;  // whether to test, or to take all, because most of those tested may show
  int32_t list[2 * kWarp];

  // tests: whether it is worth while to test any. By all lanes.
  __device__ __forceinline__ void begin(int32_t first, bool tests) {
    if (lane_id() == 0) {
      next = first;
      waiting = 0;
      test = tests;
    }
    __syncwarp();
  }
  // The vote changes nothing but what the compiler knows: that the lanes of a warp stay together.
  __device__ __forceinline__ bool goes_on(int32_t end) const {
    return __any_sync(kAllLanes, reread(next) < end || reread(waiting) > 0);
  }
};

// The corners of triangle t. projected: the view's vertices. An index that names none of them drops the triangle.
__device__ __forceinline__ void projected_corners(const Frame& f, const Vertex* projected, int32_t t, Vertex v[3]) {
  const uint32_t vertices = nameable_vertices(f);
  int32_t index[3];
  for (int k = 0; k < 3; ++k) index[k] = __ldg(f.triangles + 3 * (int64_t)t + k);
  for (int k = 0; k < 3; ++k) v[k] = {0, 0, 0.0f, kNonFinite};
  if (!((uint32_t)index[0] < vertices && (uint32_t)index[1] < vertices && (uint32_t)index[2] < vertices)) return;
  for (int k = 0; k < 3; ++k) {
    // Not __ldg: the kernel in front may still have been writing them when this one began.
    const int4 p = reinterpret_cast<const int4*>(projected)[index[k]];
    v[k] = {p.x, p.y, __int_as_float(p.z), (uint32_t)p.w};
  }
}

// Tests triangles, 32 at a time, which begin `step` from each other, until 32 wait that may show or `end` is reached.
// Returns how many a warp is to draw next: those from s->waiting on in the list, taken from its end, so that none has to
// move. By all lanes; ends with a barrier of the warp.
__device__ __forceinline__ int find_waiting(const Frame& f, const Vertex* projected, int32_t step, int32_t end,
                                            Search* s) {
  int32_t next = s->next, waiting = s->waiting;
  bool test = s->test;
  while (__any_sync(kAllLanes, waiting < kWarp && next < end)) {
    bool may = lane_id() < end - next;
    if (may && test) {
      Vertex v[3];
      projected_corners(f, projected, next + lane_id(), v);
      may = may_show(f.view, v);
    }
    const unsigned all = __ballot_sync(kAllLanes, may);
    if (may) s->list[waiting + __popc(all & lanes_below())] = next + lane_id();
    waiting += __popc(all);
    test = __popc(all) < kMostlyShown;
    next += min_of(step, end - next);
  }
  const int count = min_of(waiting, kWarp);
  __syncwarp();
  if (lane_id() == 0) {
    s->next = next;
    s->waiting = waiting - count;
    s->test = test;
  }
  __syncwarp();
  return count;
}

// How the only view of a frame is set up; an argument of kernels.
struct SetUp {
  Vertex* projected;  // the vertices, or null: a triangle's corners are projected for it alone
  int32_t each;  // triangles of a warp: as many as it has lanes at most, or kSearched, which it tests first
};

// search: as in BIGTRI_SEARCH_PARAMETER, here and below.
inline SetUp take_set_up(Scratch* scratch, const Frame& f, int64_t search) {
  return {take_projected(scratch, f, search == kSearched), kWarp};
}

// Triangles of a warp that tests none: no more than leave another one of the device without any.
inline int untested_each(const Frame& f, int64_t warps) {
  int each = 1;
  while (each < kWarp && f.count > warps * each) each *= 2;
  return each;
}

// Chooses how many triangles a warp gets. untested: what it gets where it tests none.
inline cudaError_t choose_each(const Frame& f, int64_t search, int untested, SetUp* how) {
  int processors;
  BIGTRI_CUDA(multiprocessors(&processors));
  const bool few = how->projected && shows_few(f, (int64_t)processors * blocks_held(Way::kEven));
  how->each = search == kSearched || (search == 0 && few) ? kSearched : untested;
  return cudaSuccess;
}

// Begins with a warp's triangles, from `first` on. By all lanes.
__device__ __forceinline__ void begin_set_up(const SetUp& how, int32_t first, Search* s) {
  if (how.projected) wait_for_previous();
  s->begin(first, how.each == kSearched);
}

// Sets up a warp's next triangles, those before `end`, 32 at most, a lane each. Returns what becomes of this lane's. *t:
// which it is; *p: its primitive where it is to be drawn and may cover a pixel. By all lanes.
__device__ __forceinline__ Fate set_up_next(const Frame& f, const SetUp& how, int32_t end, Search* s, int32_t* t,
                                            Primitive* p) {
  const int count = find_waiting(f, how.projected, kWarp, end, s);
  const bool have = lane_id() < count;
  *t = s->list[s->waiting + (have ? lane_id() : 0)];
  __syncwarp();  // all have read the list
  if (!have) return Fate::kNothing;
  Fate fate;
  if (how.projected) {
    Vertex v[3];
    projected_corners(f, how.projected, *t, v);
    fate = assemble(f, v, p);
    if constexpr (kUnsnapped)
      if (fate == Fate::kWhole) load_places(f, 0, *t, p);
  } else {
    fate = set_up(f, *t, p);
  }
  if constexpr (kSkipsEmpty)
    if (fate == Fate::kWhole && covers_nothing(*p)) return Fate::kNothing;
  return fate;
}

// The parts of a triangle that has to be clipped, a lane each; false where this lane has none. By all lanes.
__device__ __forceinline__ bool clip_lanes(const Frame& f, int32_t triangle, ClipScratch* clip, Primitive* part) {
  __syncwarp();
  const bool have = clip_part(f, 0, triangle, clip, part);
  __syncwarp();
  return have;
}

// Sets up a warp's triangles [first, end), counts those that are dropped, and calls use(have, primitive, triangle) with
// up to 32 at a time, after the kernels in front have ended; have: whether this lane has one. By all lanes. clip: may be
// overwritten by `use`.
template <class Use>
__device__ __forceinline__ void each_primitive(const Frame& f, const SetUp& how, int32_t first, int32_t end, Search* s,
                                               ClipScratch* clip, const Use& use) {
  begin_set_up(how, first, s);
  while (s->goes_on(end)) {
    Primitive p;
    int32_t t;
    const Fate fate = set_up_next(f, how, end, s, &t, &p);
    wait_for_previous();
    if (const unsigned dropped = __ballot_sync(kAllLanes, fate == Fate::kDropped)) count_dropped(f, 0, dropped);
    use(fate == Fate::kWhole, p, t);
    for (unsigned todo = __ballot_sync(kAllLanes, fate == Fate::kClip); todo; todo &= todo - 1) {
      const int32_t triangle = __shfl_sync(kAllLanes, t, __ffs(todo) - 1);
      use(clip_lanes(f, triangle, clip, &p), p, triangle);
    }
  }
  wait_for_previous();
}

// Puts the lanes' primitives as records into shared memory, and returns how many; have: whether this lane has one. By all
// lanes.
__device__ __forceinline__ int put_records(bool have, const Primitive& p, int64_t triangle, Record* records) {
  const unsigned all = __ballot_sync(kAllLanes, have);
  if (have) fill_record(p, triangle, records + __popc(all & lanes_below()));
  return __popc(all);
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

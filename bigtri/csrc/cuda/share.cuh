// How the triangles of all views are shared among blocks, and what becomes of a block's share: set-up, rows, and what is
// left to the caller. Few triangles are drawn together by all warps of a block, so that one large triangle does not
// hold up a warp; of many, each warp draws its own.
#pragma once

#include "clip.cuh"
#include "rows.cuh"
#include "small.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr int kShareThreads = 256, kShareBlocks = 4;  // of a block, and blocks that a multiprocessor ought to hold
constexpr int kShareWarps = kShareThreads / kWarp;
constexpr int64_t kShares[] = {0, 4, 8, 16, kWarp, kShareThreads, -1};  // triangles of a block; up to kWarp together

constexpr int64_t kMostTogether = 128;  // triangles for each block that the device holds at once

// What a view draws, where views draw different triangles.
struct ViewRange {
  int32_t first, count;  // triangles
  uint32_t first_block;  // of the grid
};

struct Sharing {
  int each;                 // triangles of a block
  uint32_t blocks;          // of a view, if all draw the same triangles
  const ViewRange* ranges;  // of each view; null if all draw the same triangles

  __device__ __forceinline__ bool together() const { return each <= kWarp; }
};

// A block's share: triangles first, first + step, ... of a view, `count` of them. Those drawn together lie as far apart
// in the list as they can: neighbours are alike in size, and what has to be clipped comes in rows.
struct Share {
  int32_t view, first, step, count;
};

// The last view whose first block is not behind this one. By all lanes, 32 views at a time.
__device__ __forceinline__ int32_t view_of_block(const ViewRange* ranges, int32_t views, uint32_t block) {
  int stride = 1;
  while ((int64_t)stride * kWarp < views) stride *= kWarp;
  int32_t view = 0;
  for (; stride > 0; stride /= kWarp) {
    const int64_t at = view + (int64_t)lane_id() * stride;
    const unsigned begun = __ballot_sync(kAllLanes, at < views && ranges[at].first_block <= block);
    view += (__popc(begun) - 1) * stride;
  }
  return view;
}

// By all threads.
__device__ __forceinline__ Share share_of(const Frame& f, const Sharing& s) {
  Share share = {0, 0, 1, 0};
  int32_t count = f.count;
  uint32_t block = blockIdx.x, blocks = s.blocks;
  if (s.ranges) {
    share.view = view_of_block(s.ranges, f.views, block);
    const ViewRange range = s.ranges[share.view];
    share.first = range.first;
    count = range.count;
    block -= range.first_block;
    blocks = (uint32_t)((range.count + s.each - 1) / s.each);
  } else if (f.views > 1) {
    share.view = (int32_t)(block / blocks);
    block -= (uint32_t)share.view * blocks;
  }
  if (block >= blocks) return share;
  const int32_t number = (int32_t)block;
  if (s.together()) {
    share.first += number;
    share.step = (int32_t)blocks;
    share.count = (count - number - 1) / (int32_t)blocks + 1;
  } else {
    share.first += number * s.each;
    share.count = min_of(s.each, count - number * s.each);
  }
  return share;
}

// Shares triangles so that there are blocks for the device. each: triangles of a block as the caller wants, or 0.
// kernel: of kShareThreads threads a block.
template <class Kernel>
cudaError_t share_triangles(Kernel kernel, const Frame& f, int64_t each, Sharing* s, int64_t* blocks) {
  int resident;
  BIGTRI_CUDA(resident_blocks(reinterpret_cast<const void*>(kernel), kShareThreads, 0, &resident));
  const int64_t total = (int64_t)f.views * f.count;
  s->each = (int)each;
  if (each == 0) {
    s->each = 8;
    while (s->each < kWarp && total > (int64_t)resident * s->each) s->each *= 2;
    if (total > (int64_t)resident * kMostTogether) s->each = kShareThreads;
  }
  s->blocks = (uint32_t)((f.count + s->each - 1) / s->each);
  s->ranges = nullptr;
  *blocks = max_of<int64_t>(1, (int64_t)s->blocks * f.views);
  return cudaSuccess;
}

// Shared memory of a warp.
struct WarpShared {
  union {
    RowTriangle triangle[kWarp];  // what is drawn by rows, from the front; the records of the rest from the back
    Vertex corners[3 * kWarp];
    SmallShared small;
    ClipScratch clip;
  };
  RowShared rows;
  __device__ WarpShared() {}

  __device__ __forceinline__ Record* records_end() { return reinterpret_cast<Record*>(triangle + kWarp); }
};
static_assert(sizeof(RowTriangle) >= sizeof(Record) && sizeof(RowTriangle) * kWarp % alignof(Record) == 0,
              "a warp's triangles find room, whatever they are");

// Shared memory of a block.
struct ShareShared {
  WarpShared warp[kShareWarps];
  int rows;       // triangles that are drawn together
  unsigned clip;  // bit k: triangle k of the share has to be clipped
  __device__ ShareShared() {}
};
static_assert(sizeof(ShareShared) <= 48 * 1024, "as much as a block can have without asking");

// Corners first, first + step, ... of `count` triangles of a share, from number `from` on, a thread each. An index that
// names no vertex gives a corner that drops its triangle. projected: the vertices of all views, or null.
__device__ __forceinline__ void make_corners(const Frame& f, const Share& share, const Vertex* projected, int from,
                                             int count, int first, int step, Vertex* corners) {
  const int64_t first_vertex = share.view * (f.view_stride / 4);
#pragma unroll 1
  for (int c = first; c < 3 * count; c += step) {
    const int number = c / 3;
    const int32_t index =
        __ldg(f.triangles + 3 * (int64_t)(share.first + (from + number) * share.step) + (c - 3 * number));
    if (index < 0 || index >= f.vertices) {
      corners[c] = {0, 0, 0.0f, kNonFinite};
    } else if (projected) {  // not __ldg: the kernel in front may still have been writing them when this one began
      const int4 v = reinterpret_cast<const int4*>(projected)[first_vertex + index];
      corners[c] = {v.x, v.y, __int_as_float(v.z), (uint32_t)v.w};
    } else {
      corners[c] = load_and_project(f, first_vertex + index);
    }
  }
}

// How many triangles are drawn by rows, and how many are not.
struct Filed {
  int rows, rest;
};

// Puts the lanes' primitives in their places in shared memory; have: whether this lane has one. By all lanes; ends with
// a barrier of the warp.
__device__ __forceinline__ Filed file(const Primitive& p, int64_t triangle, int32_t view, bool have, int widest,
                                      WarpShared* s) {
  const bool by_rows = have && fits_rows(p, widest);
  const unsigned rows = __ballot_sync(kAllLanes, by_rows), rest = __ballot_sync(kAllLanes, have && !by_rows);
  if (by_rows) make_row_triangle(p, (uint32_t)triangle, &s->triangle[__popc(rows & lanes_below())]);
  if (have && !by_rows) {
    Record* const r = s->records_end() - 1 - __popc(rest & lanes_below());
    fill_record(p, triangle, r);
    r->view = view;
  }
  __syncwarp();
  return {__popc(rows), __popc(rest)};
}

// Clips triangle t of a view and files the parts. By all lanes. Rarely called, so that its registers cost the others
// nothing.
__device__ __noinline__ Filed clip_and_file(const Frame& f, int32_t view, int32_t t, int widest, WarpShared* s) {
  __syncwarp();
  Primitive part;
  const bool have = clip_part(f, view, t, &s->clip, &part);
  __syncwarp();
  return file(part, f.first_triangle + t, view, have, widest, s);
}

// Sets up a block's share and draws what fits by rows. What is left goes to rest(view, records, their number), which
// all lanes of a warp call after the kernels in front have ended. Parts of clipped triangles take the same way as whole
// triangles. By all threads of a block of kShareThreads.
template <class Rest>
__device__ __forceinline__ void draw_share(const Frame& f, const Sharing& sharing, const Vertex* projected, int widest,
                                           ShareShared* shared, const Rest& rest) {
  const int warp = computed_here((int)(threadIdx.x / kWarp));
  WarpShared* const s = &shared->warp[warp];
  const Share share = share_of(f, sharing);
  const bool together = sharing.together();
  if (projected || share.count <= 0) wait_for_previous();
  if (share.count <= 0) return;
  // Together, each thread makes a corner, which takes a third of the time; they lie in the memory of warp 1, for that of
  // warp 0 is where the triangles end up.
  const int from = together ? 0 : warp * kWarp, count = min_of(share.count - from, kWarp);
  Vertex* const corners = together ? shared->warp[1].corners : s->corners;
  make_corners(f, share, projected, from, count, together ? (int)threadIdx.x : lane_id(), together ? kShareThreads : kWarp,
               corners);
  if (together)
    __syncthreads();
  else
    __syncwarp();
  Filed filed = {0, 0};
  unsigned clip = 0, dropped = 0;
  if (!together || warp == 0) {
    Fate fate = Fate::kNothing;
    Primitive p;
    if (lane_id() < count) {
      const Vertex v[3] = {corners[3 * lane_id()], corners[3 * lane_id() + 1], corners[3 * lane_id() + 2]};
      fate = assemble(f, v, &p);
    }
    __syncwarp();
    clip = __ballot_sync(kAllLanes, fate == Fate::kClip);
    dropped = __ballot_sync(kAllLanes, fate == Fate::kDropped);
    const int64_t id = f.first_triangle + share.first + (from + lane_id()) * share.step;
    bool have = fate == Fate::kWhole;
    if (!together) {
      const bool small = have && is_small(p);
      if (__any_sync(kAllLanes, small)) {
        draw_small(pixels_of(f, share.view), f.view.width, p, (uint32_t)id, small, &s->small);
        have = have && !small;
      }
    }
    filed = file(p, id, share.view, have, widest, s);
  }
  const RowTriangle* triangles = s->triangle;
  int first = 0, step = kWarp;
  if (together) {
    if (threadIdx.x == 0) {
      shared->rows = filed.rows;
      shared->clip = clip;
    }
    __syncthreads();
    triangles = shared->warp[0].triangle;
    filed.rows = shared->rows;
    first = warp * kWarp;
    step = kShareThreads;
    // Those to be clipped go round among the other warps: warp 0's memory is in use.
    unsigned mine = 0, all = shared->clip;
    for (int turn = 1; all; turn = turn % (kShareWarps - 1) + 1, all &= all - 1)
      if (turn == warp) mine |= all & -all;
    clip = mine;
  }
#pragma unroll 1
  for (;;) {
    draw_rows(pixels_of(f, share.view), f.view.width, triangles, filed.rows, first, step, &s->rows);
    if (filed.rest > 0) {
      wait_for_previous();
      rest(share.view, s->records_end() - filed.rest, filed.rest);
    }
    if (!clip) break;
    filed = clip_and_file(f, share.view, share.first + (from + __ffs(clip) - 1) * share.step, widest, s);
    clip &= clip - 1;
    triangles = s->triangle;
    first = 0;
    step = kWarp;
  }
  wait_for_previous();
  if (dropped && lane_id() == 0)
    atomicAdd(reinterpret_cast<unsigned long long*>(f.dropped + share.view), (unsigned long long)__popc(dropped));
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

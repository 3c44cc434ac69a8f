// How the triangles of all views are shared among blocks, and what becomes of a block's share: set-up, rows, and what is
// left to the caller. Few triangles are drawn together by all warps of a block, so that one large triangle does not
// hold up a warp; of many, each warp draws its own.
#pragma once

#include "clip.cuh"
#include "rows.cuh"

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

// kEach vertices of a view, whose first vertex has number `first` of all views: all are loaded before the first is
// used. An index that names none gives a vertex that drops its triangle. projected: the vertices of all views, or null.
template <int kEach>
__device__ __forceinline__ void load_corners(const Frame& f, const Vertex* projected, int64_t first,
                                             const int32_t index[kEach], Vertex v[kEach]) {
  bool valid[kEach];
#pragma unroll
  for (int k = 0; k < kEach; ++k) valid[k] = index[k] >= 0 && index[k] < f.vertices;
  if (projected) {
#pragma unroll
    for (int k = 0; k < kEach; ++k) {
      // Not __ldg: the kernel in front may still have been writing them when this one began.
      int4 q = make_int4(0, 0, 0, (int)kNonFinite);
      if (valid[k]) q = reinterpret_cast<const int4*>(projected)[first + index[k]];
      v[k] = {q.x, q.y, __int_as_float(q.z), (uint32_t)q.w};
    }
  } else {
    float position[kEach][4];
#pragma unroll
    for (int k = 0; k < kEach; ++k)
      if (valid[k]) load_vertex(f, first + index[k], position[k]);
#pragma unroll
    for (int k = 0; k < kEach; ++k) {
      v[k] = {0, 0, 0.0f, kNonFinite};
      if (valid[k]) v[k] = project_vertex(position[k], f.view.width, f.view.height);
    }
  }
}

// The corners of a share that is drawn together, a thread each, which takes a third of the time. By all threads.
__device__ __forceinline__ void make_corners(const Frame& f, const Share& share, const Vertex* projected,
                                             Vertex* corners) {
  const int c = (int)threadIdx.x, number = c / 3;
  if (c >= 3 * share.count) return;
  const int32_t index = __ldg(f.triangles + 3 * (int64_t)(share.first + number * share.step) + (c - 3 * number));
  load_corners<1>(f, projected, share.view * (f.view_stride / 4), &index, corners + c);
}

// How many triangles are drawn by rows, and which are not (bit k: record k).
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

// Draws thin records of few pixels, a lane each, and returns which of the warp's records are left. By all lanes. As
// rarely called.
__device__ __noinline__ unsigned draw_thin(int64_t* pixels, int width, const Record* records, int count) {
  constexpr int kFewPixels = 256;
  bool left = lane_id() < count;
  if (left) {
    const Record& r = records[lane_id()];
    left = !(r.flags & kRecordThin) || (r.x1 - r.x0) * (r.y1 - r.y0) > kFewPixels;
    if (!left)
      for (int y = r.y0; y < r.y1; ++y) draw_tested(pixels + (uint32_t)(y * width + r.x0), 1, r, r.x0, y, true, r.x1 - r.x0);
  }
  return __ballot_sync(kAllLanes, left);
}

// Sets up a block's share and draws what fits by rows. What is left goes to rest(view, records, which of them), which
// all lanes of a warp call after the kernels in front have ended. Parts of clipped triangles take the same way as whole
// triangles. By all threads of a block of kShareThreads.
template <class Rest>
__device__ __forceinline__ void draw_share(const Frame& f, const Sharing& sharing, const Vertex* projected, int widest,
                                           ShareShared* shared, const Rest& rest) {
  const int warp = computed_here((int)(threadIdx.x / kWarp));
  WarpShared* const s = kept(&shared->warp[warp]);
  const Share share = share_of(f, sharing);
  const bool together = sharing.together();
  if (projected || share.count <= 0) wait_for_previous();
  if (share.count <= 0) return;
  const Vertex* const corners = shared->warp[1].corners;  // warp 0's memory is where they end up
  if (together) {
    make_corners(f, share, projected, shared->warp[1].corners);
    __syncthreads();
  }
  Filed filed = {0, 0};
  unsigned clip = 0, dropped = 0;
  const int first_of_warp = together ? 0 : warp * kWarp;
  if (!together || warp == 0) {
    const int number = first_of_warp + lane_id();
    const int32_t t = share.first + number * share.step;
    Fate fate = Fate::kNothing;
    Primitive p;
    if (number < share.count) {
      Vertex v[3];
      if (together) {
        for (int k = 0; k < 3; ++k) v[k] = corners[3 * number + k];
      } else {
        int32_t index[3];
        for (int k = 0; k < 3; ++k) index[k] = __ldg(f.triangles + 3 * (int64_t)t + k);
        load_corners<3>(f, projected, share.view * (f.view_stride / 4), index, v);
      }
      fate = assemble(f, v, &p);
    }
    clip = __ballot_sync(kAllLanes, fate == Fate::kClip);
    dropped = __ballot_sync(kAllLanes, fate == Fate::kDropped);
    filed = file(p, f.first_triangle + t, share.view, fate == Fate::kWhole, widest, s);
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
      const Record* const records = s->records_end() - filed.rest;
      const unsigned left = draw_thin(pixels_of(f, share.view), f.view.width, records, filed.rest);
      if (left) rest(share.view, records, left);
    }
    if (!clip) break;
    filed = clip_and_file(f, share.view, share.first + (first_of_warp + __ffs(clip) - 1) * share.step, widest, s);
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

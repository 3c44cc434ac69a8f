// How the triangles of all views are shared among blocks, and what becomes of a block's share: set-up, rows, and what is
// left to the caller.
#pragma once

#include "clip.cuh"
#include "rows.cuh"
#include "small.cuh"
#include "view_ranges.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr int kShareThreads = 256, kShareBlocks = 4;  // of a block, and blocks that a multiprocessor ought to hold
constexpr int kShareWarps = kShareThreads / kWarp;
// What a block does with its share.
enum class Way {
  kTogether,  // up to 32 triangles, drawn by all warps together, so that a large one does not hold up a warp
  kEven,  // as kApart, but the others help a warp that has far more to draw than they
  kApart,  // each warp draws 32 of its own, by boxes (small.cuh) where most are small
  kTested,  // each warp tests many, and draws those that may show, 32 at a time
};
constexpr int kMostBatches = 8;
constexpr int kMostlySmall = 24;  // triangles of a warp's 32 with a box of 8x8 px that make boxes worth while
// Triangles of a block: up to kWarp together, kShareThreads apart, more tested.
constexpr int64_t kShares[] = {0, 4, 8, 16, kWarp, kShareThreads, kMostBatches * kShareThreads, -1};

struct Sharing {
  Way way;
  int each;  // triangles of a block
  uint32_t blocks;  // of a view, if all draw the same triangles
  const ViewRange* ranges;  // of each view; null if all draw the same triangles
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
template <Way kWay>
__device__ __forceinline__ Share share_of(const Frame& f, const Sharing& s) {
  Share share = {0, 0, 1, 0};
  int32_t all = f.count;  // triangles of the view
  uint32_t block = blockIdx.x, blocks = s.blocks;
  if (s.ranges) {
    share.view = view_of_block(s.ranges, f.views, block);
    const ViewRange range = s.ranges[share.view];
    share.first = range.first;
    all = range.count;
    block -= range.first_block;
    blocks = ((uint32_t)all + (uint32_t)s.each - 1) / (uint32_t)s.each;
    if (block >= blocks) return share;
  } else if (f.views > 1) {
    share.view = (int32_t)(block / blocks);
    block -= (uint32_t)share.view * blocks;
  }
  if (kWay == Way::kTogether) {
    share.first += (int32_t)block;
    share.step = (int32_t)blocks;
    share.count = (all - 1 - (int32_t)block) / (int32_t)blocks + 1;
  } else {
    share.first += (int32_t)block * s.each;
    share.count = min_of(s.each, all - (int32_t)block * s.each);
  }
  return share;
}

// Pixels of the image, or of all views, for each triangle: up to the first number most triangles cover none, from the
// second on some may be large.
constexpr double kTinyPixels = 0.8, kSmallPixels = 16;
// Triangles for each block that the device holds at once, if some may be large; else half as many.
constexpr int64_t kMostTogether = 224;

// Longest side of what is drawn by rows, px. Warps that are left alone with their triangles take no large ones, and where
// an image has many pixels, what waits for blocks that own them takes long to begin.
inline int widest_rows(const Frame& f, const Sharing& s, int64_t wanted) {
  if (wanted > 0) return (int)wanted;
  if (s.way == Way::kApart || s.way == Way::kTested) return 64;
  return (int64_t)f.view.width * f.view.height > (1 << 22) ? kWidestRows : 192;
}

// Shares triangles so that there are blocks for the device. each: triangles of a block as the caller wants, or 0.
// ranges: memory for the views' ranges, or null. kernel: of kShareThreads threads a block.
template <class Kernel>
cudaError_t share_triangles(Kernel kernel, const Frame& f, bool projected, int64_t each, ViewRange* ranges, Sharing* s,
                            int64_t* blocks, cudaStream_t stream) {
  int resident;
  BIGTRI_CUDA(resident_blocks(reinterpret_cast<const void*>(kernel), kShareThreads, 0, &resident));
  const int64_t total = triangles_of_all(f), pixels = (int64_t)f.views * f.view.width * f.view.height;
  s->each = (int)each;
  if (each == 0) {
    s->each = 8;
    while (s->each < kWarp && total > (int64_t)resident * s->each) s->each *= 2;
    const double pixels_each = (double)pixels / (double)max_of<int64_t>(total, 1);
    if (total > resident * (pixels_each >= kSmallPixels ? kMostTogether : kMostTogether / 2)) s->each = kShareThreads;
    if (projected && pixels_each <= kTinyPixels && total > (int64_t)resident * kMostBatches * kShareThreads / 2)
      s->each = kMostBatches * kShareThreads;
  }
  // Where there are more blocks than the device holds at once, they even out by themselves.
  s->way = s->each <= kWarp                             ? Way::kTogether
           : s->each > kShareThreads                    ? Way::kTested
           : total <= (int64_t)resident * kShareThreads ? Way::kEven
                                                        : Way::kApart;
  s->blocks = (uint32_t)(((int64_t)f.count + s->each - 1) / s->each);
  s->ranges = ranges;
  *blocks = (int64_t)s->blocks * f.views;
  if (ranges) BIGTRI_CUDA(launch_ranges(f, s->each, ranges, blocks, stream));
  *blocks = max_of<int64_t>(1, *blocks);
  return cudaSuccess;
}

template <Way kWay>
struct WayOf {
  static constexpr Way value = kWay;
};

// Calls launch(WayOf<the way>()), for the instance of a kernel.
template <class Launch>
cudaError_t with_way(Way way, const Launch& launch) {
  switch (way) {
    case Way::kTogether: return launch(WayOf<Way::kTogether>());
    case Way::kEven: return launch(WayOf<Way::kEven>());
    case Way::kApart: return launch(WayOf<Way::kApart>());
    default: return launch(WayOf<Way::kTested>());
  }
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
  int32_t waiting[2 * kWarp];  // triangles that may show
  __device__ WarpShared() {}

  __device__ __forceinline__ Record* records_end() { return reinterpret_cast<Record*>(triangle + kWarp); }
};
static_assert(sizeof(RowTriangle) >= sizeof(Record) && sizeof(RowTriangle) * kWarp % alignof(Record) == 0,
              "a warp's triangles find room, whatever they are");

// Shared memory of a block.
struct ShareShared {
  WarpShared warp[kShareWarps];
  unsigned clip;  // bit k: triangle k of a share that is drawn together has to be clipped
  int rows[kShareWarps];  // triangles of each warp that are drawn by rows
  int boxes[kShareWarps];  // pixels of their bboxes
  __device__ ShareShared() {}
};
static_assert(sizeof(ShareShared) <= 48 * 1024, "as much as a block can have without asking");

// A projected vertex of a view, whose first vertex has number `first` of all views. An index that names none gives one
// that drops its triangle.
__device__ __forceinline__ Vertex projected_vertex(const Frame& f, const Vertex* projected, int64_t first,
                                                   int32_t index) {
  if (index < 0 || index >= f.vertices) return {0, 0, 0.0f, kNonFinite};
  // Not __ldg: the kernel in front may still have been writing them when this one began.
  const int4 v = reinterpret_cast<const int4*>(projected)[first + index];
  return {v.x, v.y, __int_as_float(v.z), (uint32_t)v.w};
}

__device__ __forceinline__ void projected_corners(const Frame& f, const Vertex* projected, int64_t first, int32_t t,
                                                  Vertex v[3]) {
  int32_t index[3];
  for (int k = 0; k < 3; ++k) index[k] = __ldg(f.triangles + 3 * (int64_t)t + k);
  for (int k = 0; k < 3; ++k) v[k] = projected_vertex(f, projected, first, index[k]);
}

// The corners of triangle t, projected by this thread alone.
__device__ __forceinline__ void own_corners(const Frame& f, int64_t first, int32_t t, Vertex v[3]) {
  int32_t index[3];
  for (int k = 0; k < 3; ++k) index[k] = __ldg(f.triangles + 3 * (int64_t)t + k);
#pragma unroll 1
  for (int k = 0; k < 3; ++k) {
    v[0] = v[1];
    v[1] = v[2];
    v[2] = {0, 0, 0.0f, kNonFinite};
    if (index[0] >= 0 && index[0] < f.vertices) v[2] = load_and_project(f, first + index[0]);
    index[0] = index[1];
    index[1] = index[2];
  }
}

// Corners of triangles t, t + stride, ..., `count` of them, a thread each. As above.
__device__ __forceinline__ void make_corners(const Frame& f, int64_t first_vertex, int32_t t, int32_t stride, int count,
                                             Vertex* corners) {
  const int c = (int)threadIdx.x, number = c / 3;
  if (c >= 3 * count) return;
  const int32_t index = __ldg(f.triangles + 3 * (int64_t)(t + number * stride) + (c - 3 * number));
  corners[c] = {0, 0, 0.0f, kNonFinite};
  if (index >= 0 && index < f.vertices) corners[c] = load_and_project(f, first_vertex + index);
}

// Whether a triangle may cover a pixel centre, at a fraction of what set-up costs: most triangles of a mesh that is far
// away do not. Never false of one that does, or that is to be clipped or dropped.
__device__ __forceinline__ bool may_show(const Viewport& view, const Vertex v[3]) {
  if ((v[0].flags | v[1].flags | v[2].flags) & ~kScreenMask) return true;
  const int32_t x[3] = {v[0].x, v[1].x, v[2].x}, y[3] = {v[0].y, v[1].y, v[2].y};
  const PixelBox box = pixel_box(x, y, view);
  return box.x0 < box.x1 && box.y0 < box.y1;
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

// Notes how many triangles a warp draws by rows, and the pixels of their bboxes. By all lanes.
__device__ __forceinline__ void note_rows(ShareShared* shared, const WarpShared* s, int warp, int count) {
  const bool have = lane_id() < count;
  const int pixels = have ? s->triangle[lane_id()].columns() * s->triangle[lane_id()].rows() : 0;
  const int all = warp_sum_up_to(pixels);
  if (lane_id() == kWarp - 1) {
    shared->rows[warp] = count;
    shared->boxes[warp] = all;
  }
}

// Whether one warp has so much more to draw than the others that it should not be left alone with it.
__device__ __forceinline__ bool are_uneven(const int boxes[kShareWarps]) {
  constexpr int kMuch = 2048;
  int most = 0, all = 0;
  for (int k = 0; k < kShareWarps; ++k) {
    most = max_of(most, boxes[k]);
    all += boxes[k];
  }
  return most > kMuch && most > 2 * (all / kShareWarps);
}

// Tests triangles from *next on, 32 at a time, until 32 wait that may show or `end` is reached; returns how many wait. By
// all lanes; ends with a barrier of the warp.
__device__ __forceinline__ int find_waiting(const Frame& f, const Vertex* projected, int64_t first_vertex,
                                            int32_t* next, int32_t end, int waiting, int32_t* list) {
  while (waiting < kWarp && *next < end) {
    bool may = *next + lane_id() < end;
    if (may) {
      Vertex v[3];
      projected_corners(f, projected, first_vertex, *next + lane_id(), v);
      may = may_show(f.view, v);
    }
    const unsigned all = __ballot_sync(kAllLanes, may);
    if (may) list[waiting + __popc(all & lanes_below())] = *next + lane_id();
    waiting += __popc(all);
    *next += min_of(kWarp, end - *next);
  }
  __syncwarp();
  return waiting;
}

// Those of the triangles in `all` that a warp clips where they are drawn together: they go round among the warps but for
// warp 0, whose memory is in use.
__device__ __forceinline__ unsigned clips_of(unsigned all, int warp) {
  unsigned mine = 0;
  for (int turn = 1; all; turn = turn % (kShareWarps - 1) + 1, all &= all - 1)
    if (turn == warp) mine |= all & -all;
  return mine;
}

// Sets up a block's share and draws what fits by rows. What is left goes to rest(view, records, their number), which
// all lanes of a warp call after the kernels in front have ended. Parts of clipped triangles take the same way as whole
// triangles. projected: the vertices of all views, or null. By all threads of a block of kShareThreads.
template <Way kWay, class Rest>
__device__ __forceinline__ void draw_share(const Frame& f, const Sharing& sharing, const Vertex* projected, int widest,
                                           ShareShared* shared, const Rest& rest) {
  constexpr bool kTogether = kWay == Way::kTogether;
  const int warp = computed_here((int)(threadIdx.x / kWarp));
  WarpShared* const s = &shared->warp[warp];
  const Share share = share_of<kWay>(f, sharing);
  if ((!kTogether && projected) || share.count <= 0) wait_for_previous();
  if (share.count <= 0) return;
  const int64_t first_vertex = share.view * (f.view_stride / 4);
  int64_t* const pixels = pixels_of(f, share.view);
  // Of this warp: triangles that have not been looked at, [next, end), and how many wait in s->waiting.
  const int each = kTogether ? 0 : kWay == Way::kTested ? sharing.each / kShareWarps : kWarp;
  int32_t next = share.first + min_of(warp * each, share.count);  // a list may be as long as int32 counts
  const int32_t end = kTogether ? next : next + min_of(each, share.first + share.count - next);
  int waiting = 0;
  unsigned dropped = 0;
  if (kTogether) {
    // Each thread makes a corner, which takes a third of the time; they lie in the memory of warp 1, for that of warp 0
    // is where the triangles end up.
    make_corners(f, first_vertex, share.first, share.step, share.count, shared->warp[1].corners);
    __syncthreads();
  }
#pragma unroll 1
  do {
    int32_t t = kTogether ? share.first + lane_id() * share.step : next + lane_id();
    int count = kTogether ? (warp == 0 ? share.count : 0) : min_of(end - next, kWarp);
    if (kWay == Way::kTested) {
      waiting = find_waiting(f, projected, first_vertex, &next, end, waiting, s->waiting);
      count = min_of(waiting, kWarp);
      waiting -= count;
      t = s->waiting[waiting + min_of(lane_id(), max_of(count - 1, 0))];  // from the end, so that none has to move
    }
    Filed filed = {0, 0};
    unsigned clip = 0;
    if (!kTogether || warp == 0) {
      Fate fate = Fate::kNothing;
      Primitive p;
      if (lane_id() < count) {
        Vertex v[3];
        if (kTogether)
          for (int k = 0; k < 3; ++k) v[k] = shared->warp[1].corners[3 * lane_id() + k];
        else if (projected)
          projected_corners(f, projected, first_vertex, t, v);
        else
          own_corners(f, first_vertex, t, v);
        fate = assemble(f, v, &p);
      }
      clip = __ballot_sync(kAllLanes, fate == Fate::kClip);
      dropped += __popc(__ballot_sync(kAllLanes, fate == Fate::kDropped));
      bool have = fate == Fate::kWhole;
      if (kWay == Way::kApart || kWay == Way::kEven) {
        const bool small = have && is_small(p), one_box = small && max_of(p.x1 - p.x0, p.y1 - p.y0) <= kBoxSide;
        if (__popc(__ballot_sync(kAllLanes, one_box)) >= kMostlySmall) {
          draw_small(pixels, f.view.width, p, (uint32_t)(f.first_triangle + t), small, &s->small);
          have = have && !small;
        }
      }
      if (__any_sync(kAllLanes, have)) filed = file(p, f.first_triangle + t, share.view, have, widest, s);
    }
    // This warp draws triangles of warps owner, ..., owners - 1, and of their rows 32 at first, first + step, ...
    int owner = warp, owners = warp + 1, first = 0, step = kWarp;
    bool shared_rows = false;
    if (kTogether) {
      if (threadIdx.x == 0) {
        shared->rows[0] = filed.rows;
        shared->clip = clip;
      }
      __syncthreads();
      shared_rows = true;
      owner = 0;
      owners = 1;
      clip = clips_of(shared->clip, warp);
    }
    if (kWay == Way::kEven) {
      note_rows(shared, s, warp, filed.rows);
      __syncthreads();
      shared_rows = are_uneven(shared->boxes);
      if (shared_rows) {
        owner = 0;
        owners = kShareWarps;
      }
    }
    if (shared_rows) {
      first = warp * kWarp;
      step = kShareThreads;
    }
#pragma unroll 1
    for (;;) {
#pragma unroll 1
      do {
        const int count = shared_rows ? shared->rows[owner] : filed.rows;
        if (count == 0) continue;
        const int rows = draw_rows(pixels, f.view.width, shared->warp[owner].triangle, count, first, step, &s->rows);
        // The next warp's rows go on where these end.
        if (kWay == Way::kEven && shared_rows)
          first = (first - (rows + kWarp - 1) / kWarp * kWarp) & (kShareThreads - 1);
      } while (++owner < owners);
      if (filed.rest > 0) {
        wait_for_previous();
        rest(share.view, s->records_end() - filed.rest, filed.rest);
      }
      // After this nobody else reads this warp's memory.
      if (kWay == Way::kEven && shared_rows) __syncthreads();
      if (!clip) break;
      const int number = __ffs(clip) - 1;
      filed = clip_and_file(
          f, share.view, kTogether ? share.first + number * share.step : __shfl_sync(kAllLanes, t, number), widest, s);
      clip &= clip - 1;
      shared_rows = false;
      owner = warp;
      first = 0;
      step = kWarp;
      owners = warp + 1;
    }
    __syncwarp();
  } while (kWay == Way::kTested && (next < end || waiting > 0));
  wait_for_previous();
  if (dropped && lane_id() == 0)
    atomicAdd(reinterpret_cast<unsigned long long*>(f.dropped + share.view), (unsigned long long)dropped);
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

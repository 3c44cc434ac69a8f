// How the triangles of all views are shared among blocks: which way, chosen by the host from what it knows without
// asking the device, and which triangles a block gets.
#pragma once

#include "launch.cuh"
#include "setup.cuh"
#include "view_ranges.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// What a block does with its share.
enum class Way {
  kTogether,  // up to 32 triangles, drawn by all warps together, so that a large one does not hold up a warp
  kEven,  // each warp draws 32 of its own, by boxes (small.cuh) where most are small; the others help a warp that has
  // far more to draw than they
  kApart,  // the same, and none helps
  kTested,  // each warp tests many, and draws those that may show, 32 at a time
  kQueued,  // each warp sets up its own, 32 at most, and draws none: all are left to the caller
};

// Warps of a block. A block's place is free for the next one only when its last warp is done, so that warps that do not
// help each other are better off in small blocks.
BIGTRI_HD constexpr int block_warps(Way way) { return way == Way::kTogether || way == Way::kEven ? 8 : 4; }
BIGTRI_HD constexpr int block_threads(Way way) { return block_warps(way) * kWarp; }
// Blocks that a multiprocessor ought to hold.
BIGTRI_HD constexpr int blocks_held(Way way) { return 32 / block_warps(way); }

constexpr int kMostBatches = 8;  // of 32 triangles, that a warp tests
// Triangles of a block, which say what way it goes: up to kWarp together.
constexpr int kOfEven = block_threads(Way::kEven), kOfApart = block_threads(Way::kApart),
              kOfTested = kMostBatches * block_threads(Way::kTested), kOfQueued = block_threads(Way::kQueued);
constexpr int64_t kShares[] = {0, 4, 8, 16, kWarp, kOfApart, kOfEven, kOfTested, -1};
constexpr Way way_of(int64_t each) {
  return each <= kWarp ? Way::kTogether : each == kOfEven ? Way::kEven : each == kOfApart ? Way::kApart : Way::kTested;
}

struct Sharing {
  int each;  // triangles of a block
  bool spread;  // they lie as far apart in the list as they can
  uint32_t blocks;  // of a view, if all draw the same triangles
  const ViewRange* ranges;  // of each view; null if all draw the same triangles
};

// Pixels of the image, or of all views, for each triangle: up to the first number most triangles cover none, from the
// second on some may be large, from the third on most.
constexpr double kTinyPixels = 0.8, kSmallPixels = 16, kLargePixels = 1 << 14;
inline double pixels_each(const Frame& f) {
  return (double)f.views * f.view.width * f.view.height / (double)max_of<int64_t>(triangles_of_all(f), 1);
}
// Triangles for each block that the device holds at once, if some may be large; else half as many.
constexpr int64_t kMostTogether = 224;

// Triangles of a block such that there are blocks for a device that holds so many of kEven's warps at once. projected:
// whether there is memory for the vertices, which testing needs.
inline int share_size(const Frame& f, int64_t resident, bool projected) {
  const int64_t total = triangles_of_all(f);
  const double pixels = pixels_each(f);
  if (total > resident * kOfEven)  // more blocks than the device holds even out by themselves
    return projected && pixels <= kTinyPixels && total > resident * kOfEven * 4 ? kOfTested : kOfApart;
  if (f.views == 1 && total > resident * kMostTogether / 2) return pixels < kSmallPixels ? kOfApart : kOfEven;
  if (total > resident * (pixels >= kSmallPixels ? kMostTogether : kMostTogether / 2)) return kOfEven;
  int each = 4;
  while (each < kWarp && total > resident * each) each *= 2;
  return each;
}

// Neighbours in the list are alike: in size, and what has to be clipped comes in rows. Blocks of neighbours have far
// more to do than others, which evens out only where there are many for each place on the device; they read less memory.
inline bool are_spread(const Frame& f, Way way, int64_t resident) {
  return way == Way::kEven || (f.views == 1 && triangles_of_all(f) <= resident * kOfEven * 4);
}

// Longest side of what is drawn by rows, px. Warps that are left alone with their triangles take no large ones. Nor do
// the blocks of a few triangles, where most of the device has nothing to do. Where an image has many pixels, what waits
// for blocks that own them takes long to begin.
constexpr int64_t kFewTriangles = 256;
inline int widest_rows(const Frame& f, Way way, int64_t wanted) {
  if (wanted > 0) return (int)wanted;
  const int64_t pixels = (int64_t)f.view.width * f.view.height;
  if (way == Way::kApart || way == Way::kTested || pixels_each(f) > kLargePixels) return 64;
  if (triangles_of_all(f) <= kFewTriangles && pixels <= 1 << 19) return 96;
  return pixels > (1 << 22) ? 256 : 192;
}

// Shares triangles among blocks. each: triangles of a block as the caller wants, or 0. ranges: memory for the views'
// ranges, or null. kernel: that of kEven.
template <class Kernel>
cudaError_t share_triangles(Kernel kernel, const Frame& f, bool projected, int64_t each, ViewRange* ranges, Sharing* s,
                            int64_t* blocks, cudaStream_t stream) {
  int resident;
  BIGTRI_CUDA(resident_blocks(reinterpret_cast<const void*>(kernel), block_threads(Way::kEven), 0, &resident));
  s->each = each > 0 ? (int)each : share_size(f, resident, projected);
  s->spread = are_spread(f, way_of(s->each), resident);
  s->blocks = (uint32_t)(((int64_t)f.count + s->each - 1) / s->each);
  s->ranges = ranges;
  *blocks = (int64_t)s->blocks * f.views;
  if (ranges) BIGTRI_CUDA(launch_ranges(f, s->each, ranges, blocks, stream));
  *blocks = max_of<int64_t>(1, *blocks);
  return cudaSuccess;
}

// The same for kQueued: no more triangles for a warp than leave another one of the device without any. kernel: its own.
template <class Kernel>
cudaError_t share_queued(Kernel kernel, const Frame& f, int64_t each, Sharing* s, int64_t* blocks) {
  int resident;
  BIGTRI_CUDA(resident_blocks(reinterpret_cast<const void*>(kernel), block_threads(Way::kQueued), 0, &resident));
  s->each = each > 0 ? (int)min_of<int64_t>(each, kOfQueued) : block_warps(Way::kQueued);
  while (each == 0 && s->each < kOfQueued && f.count > (int64_t)resident * s->each) s->each *= 2;
  s->blocks = (uint32_t)(((int64_t)f.count + s->each - 1) / s->each);
  s->ranges = nullptr;
  *blocks = max_of<int64_t>(1, s->blocks);
  return cudaSuccess;
}

template <Way kWay>
struct WayOf {
  static constexpr Way value = kWay;
};

// Calls launch(WayOf<the way>()), for the instance of a kernel; of the ways that draw.
template <class Launch>
cudaError_t with_way(Way way, const Launch& launch) {
  switch (way) {
    case Way::kTogether: return launch(WayOf<Way::kTogether>());
    case Way::kEven: return launch(WayOf<Way::kEven>());
    case Way::kApart: return launch(WayOf<Way::kApart>());
    default: return launch(WayOf<Way::kTested>());
  }
}

// A block's share of a view's triangles: first, first + step, ..., `count` of them, 32 for each warp where it has its own.
// Tested and queued: warps' parts begin at first, first + step, ..., each of triangles in a row.
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
  } else if (blocks == 0) {
    return share;
  } else if (f.views > 1) {
    share.view = (int32_t)(block / blocks);
    block -= (uint32_t)share.view * blocks;
  }
  // A list may be as long as int32 counts.
  if (kWay == Way::kTogether || ((kWay == Way::kEven || kWay == Way::kApart) && s.spread)) {
    share.first += (int32_t)block;
    share.step = (int32_t)blocks;
    share.count = (all - 1 - (int32_t)block) / (int32_t)blocks + 1;
  } else {
    const int32_t before = (int32_t)block * s.each;
    share.first += before;
    share.step = kWay == Way::kTested || kWay == Way::kQueued ? s.each / block_warps(kWay) : 1;
    share.count = min_of(s.each, all - before);
  }
  return share;
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// How the triangles of all views are shared among blocks: which way, chosen by the host from what it knows without
// asking the device, and which triangles a block gets.
#pragma once

#include <numeric>

#include "launch.cuh"
#include "setup.cuh"
#include "view_ranges.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// What a block does with its share.
enum class Way {
  kTogether,  // up to 32 triangles, drawn by all warps together, so that a large one does not hold up a warp
  kInTeams,  // the same triangles by several blocks, which draw a part of their rows each
  kInGroups,  // together, up to four groups, each set up by a warp
  kEven,  // each warp draws up to 32 of its own, by boxes (small.cuh) where many are small; if some are large, it leaves
  // a part of them to all warps of the block, which draw it at the end
  kApart,  // the same, and none leaves any
  kTested,  // each warp tests many, and draws those that may show, 32 at a time; if a sample says that nearly all show, for
  // there are layers of them, they are drawn as they are
};

BIGTRI_HD constexpr bool tests(Way way) { return way == Way::kTested; }
BIGTRI_HD constexpr bool together(Way way) {
  return way == Way::kTogether || way == Way::kInTeams || way == Way::kInGroups;
}
BIGTRI_HD constexpr int most_groups(Way way) { return way == Way::kInGroups ? 4 : 1; }

// Warps of a block. A block's place is free for the next one only when its last warp is done, so that warps that do not
// help each other are better off in small blocks.
BIGTRI_HD constexpr int log_block_warps(Way way) { return together(way) || way == Way::kEven ? 3 : 2; }
BIGTRI_HD constexpr int block_warps(Way way) { return 1 << log_block_warps(way); }
BIGTRI_HD constexpr int block_threads(Way way) { return block_warps(way) * kWarp; }
// Blocks that a multiprocessor ought to hold.
BIGTRI_HD constexpr int blocks_held(Way way) { return 32 / block_warps(way); }

constexpr int kSearched = 8 * kWarp;  // triangles of a warp that tests them
// Triangles of a block, which say what way it goes: up to kWarp together, up to the first number in groups, and each way
// beyond up to the next. Four groups of 32 would be as many as kOfApart.
constexpr int kMostInGroups = most_groups(Way::kInGroups) * (kWarp - 1), kOfEven = block_threads(Way::kEven),
              kOfApart = block_threads(Way::kApart), kOfTested = block_warps(Way::kTested) * kSearched;
constexpr int64_t kShares[] = {0,        2,         4,       8,         16, kWarp, 2 * kWarp, 3 * kWarp, kMostInGroups,
                               kOfApart, 6 * kWarp, kOfEven, kOfTested, -1};
static_assert(kMostInGroups < kOfApart, "or they would go the same way");
constexpr Way way_of(int64_t each) {
  return each <= kWarp           ? Way::kTogether
         : each <= kMostInGroups ? Way::kInGroups
         : each <= kOfApart      ? Way::kApart
         : each <= kOfEven       ? Way::kEven
                                 : Way::kTested;
}

constexpr uint32_t kSpread = 35;  // the least Sharing::spread

// Tested, of one view: what a sample of the triangles says, which the first kernel draws.
struct Sample {
  uint32_t claimed;  // how many times 128 triangles, if all are drawn; zero at first
  uint32_t shown;  // how many of kSampled may cover a pixel centre
};

struct Sharing {
  Way way;
  int each;  // triangles of a block, if not in turns
  int groups, group;  // of a block, and triangles of each but the last: what a warp sets up at once, if it tests none
  int log_team;  // in teams: log2 of how many blocks one has
  int own_pixels;  // even: of the bboxes of those that a warp draws by rows alone; it leaves what comes after
  int log_neighbours;  // even and apart: log2 of how many of them lie next to each other in the list
  uint32_t blocks;  // of a view, if all draw the same triangles
  // Together, if all draw the same triangles: how many each block has, or team of them, and how many of these have one more.
  // A block would divide for it before its first load, which with the instructions to fetch took 0.25 us.
  int fewest;
  uint32_t with_more;
  bool in_turns;  // tested: all blocks, which the device holds at once, take triangles of the only view in turns
  uint32_t spread;  // in turns: how far from each other neighbouring blocks begin; prime to `blocks`
  Sample* sample;  // tested; null: few show, as far as the host knows
  const ViewRange* ranges;  // of each view; null if all draw the same triangles
};

// Pixels of the image, or of all views, for each triangle: up to the first number nearly all triangles of a mesh cover
// none, up to the second most, from the third on some may be large, from the fourth on many, from the fifth on
// most; of several views, whose blocks all have something to do, from the last on.
constexpr double kLeastPixels = 0.4, kTinyPixels = 0.8, kSmallPixels = 16, kMiddlePixels = 64, kLargePixels = 24 << 10,
                 kLargePixelsOfViews = 10 << 10;
inline double pixels_each(const Frame& f) {
  return (double)pixels_of_all(f) / (double)max_of<int64_t>(triangles_of_all(f), 1);
}
// Pixels of several views for each triangle, from which on two turns that blocks draw together take less than one of which
// each warp draws neighbours by itself.
constexpr double kPixelsOfTwoTurns = 24;
// Pixels of several views for a block that draws its triangles together. Of some views a camera may stand close by, and see few
// that are large: blocks of fewer, in several turns, even that out.
constexpr double kPixelsOfBlock = 8 << 10;
constexpr int kLeastOfViews = 24;  // triangles of such a block: below that, views that are seen whole take longer
// Times that kEven's largest blocks fill the device, from which on it does not matter what each of them has to do.
constexpr int64_t kTurns = 4;
constexpr int kLeastTogether = 4, kLeastOfTeam = 2;  // triangles of a block that draws them together, or of a team
// Pixels of several views for each triangle, from which on many turns of blocks that draw together take less than blocks whose
// warps are left alone: some triangles are large for a warp.
constexpr double kPixelsOfManyTurns = 100;
constexpr int64_t kTeamImage = 1 << 18, kSmallImage = 1 << 19, kLargeImage = 1 << 20, kHugeImage = 1 << 22;  // px

// A team of blocks sets up the same triangles, and each block draws a part of their rows: all multiprocessors have as much to
// draw, whatever the triangles' sizes. While the device holds all blocks at once that takes next to no longer, for a warp sets
// up 16 as fast as four. It pays where some triangles may be large; few of them are drawn as fast alone in a small image.
// Of more triangles two blocks set up the same in a large image: a camera that stands close by sees few of a mesh, and these
// are large, while one that sees it whole takes next to no longer.
constexpr int kBlocksOfTeam = 4, kMostOfTeam = 16;  // the latter triangles
constexpr int kBlocksOfPair = 2;
constexpr int64_t kMostInTeams = 1 << 16;  // triangles of all views, whatever the device
constexpr int64_t kTeamSizes[] = {0, 1, 2, 4, 8, -1};
inline int blocks_of_team(const Frame& f, int64_t resident) {
  if (f.count <= resident * kMostOfTeam / kBlocksOfTeam && pixels_each(f) >= kSmallPixels &&
      (pixels_of_all(f) > kTeamImage || f.count > 2 * resident))
    return kBlocksOfTeam;
  return f.count <= resident * kWarp / kBlocksOfPair && pixels_of_all(f) > kLargeImage ? kBlocksOfPair : 1;
}
// Whether there can be teams at all, as the caller wants it: triangles of a block, and blocks of a team, or 0.
inline bool may_be_in_teams(const Frame& f, int64_t each, int64_t team) {
  if (f.ranges || team == 1 || each > kWarp) return false;
  return each > 0 ? team > 1 : triangles_of_all(f) <= kMostInTeams && (team > 1 || f.views == 1);
}
// How many teams there are then at most.
inline int64_t most_teams(const Frame& f, int64_t each, int64_t team) {
  if (!may_be_in_teams(f, each, team)) return 0;
  const int64_t least = each > 0 ? each : kLeastOfTeam;
  return (f.count + least - 1) / least * f.views;
}

// Whether most triangles cover no pixel, so that testing them first pays, if vertices are projected once.
inline bool shows_few(const Frame& f, int64_t resident) {
  const double pixels = pixels_each(f);
  return pixels <= kTinyPixels &&
         triangles_of_all(f) > resident * kOfEven * (pixels <= kLeastPixels ? kTurns / 2 : kTurns);
}

// Log2 of how many of a block's triangles lie next to each other in the list, where warps have their own. Those in a row
// share vertices and are alike, in size and in whether they have to be clipped: they take less memory to read, and some
// blocks have far more to do than others.
inline int log_neighbours(const Frame& f, Way way, int64_t resident) {
  // What a camera close by sees of a mesh are neighbours, all of which one block would draw: in fours they take next to no longer
  // to read than all of a block's in a row.
  if (f.views > 1) return 2;
  // Many turns even out by themselves: as many as a block of kApart has, or a warp of kEven may have.
  if (triangles_of_all(f) > resident * kOfEven * kTurns) return way == Way::kApart ? 7 : 5;
  // A quadrangle's two triangles are mostly neighbours. Where many are large, all of a block are better far apart.
  return way == Way::kEven && pixels_each(f) >= kMiddlePixels ? 0 : 1;
}
static_assert(kOfApart == 1 << 7 && kWarp == 1 << 5, "as log_neighbours says");

// Triangles of a block such that there are blocks for a device that holds so many of kEven's at once: as few as make one
// turn, or as many turns as it takes. team: blocks of a team. projected: whether there is memory for the vertices, which
// testing needs.
inline int share_size(const Frame& f, int64_t resident, int team, bool projected) {
  const int64_t total = triangles_of_all(f);
  const double pixels = pixels_each(f);
  if (projected && shows_few(f, resident)) return kOfTested;
  const auto turns_of = [&](int64_t triangles, int most) {
    return max_of<int64_t>(1, (triangles + resident * most - 1) / (resident * most));
  };
  const auto as_few = [&](int least, int step, int most, int blocks_of_team, int64_t turns) {
    const int64_t room = turns * resident;
    const auto blocks = [&](int64_t each) {  // each view has its own; of ranges, the last one is half full on average
      return f.ranges ? total / each + f.views / 2 : (f.count + each - 1) / each * f.views * blocks_of_team;
    };
    int each = least;
    while (each < most && (each * room < total * blocks_of_team || blocks(each) > room)) each += step;
    if (f.ranges || f.count == 0) return each;
    const int of_view = (f.count + each - 1) / each;  // the view's blocks get as many as each other
    const int even = (f.count + of_view - 1) / of_view;
    return max_of(least, (even + step - 1) / step * step);
  };
  const int64_t turns = turns_of(total, kMostInGroups);
  if (turns > (f.views > 1 && pixels >= kPixelsOfTwoTurns ? 2 : 1)) {
    // None is too large for a warp where all are tiny. Blocks that take many turns, and several views, even out what
    // there is to do.
    if (f.views > 1 && pixels >= kPixelsOfManyTurns) return 2 * kWarp;
    const bool even = f.views > 1 ? pixels >= kSmallPixels && total <= resident * kOfEven
                                  : pixels > kTinyPixels && total <= resident * kOfEven * kTurns;
    if (!even) return kOfApart;
    const int step = max_of(block_warps(Way::kEven), 1 << log_neighbours(f, Way::kEven, resident));
    return as_few(kOfApart + step, step, kOfEven, 1, 1);
  }
  int most = team > 1 ? kWarp : kMostInGroups;
  if (f.views > 1) most = max_of(kLeastOfViews, (int)min_of<double>(most, kPixelsOfBlock / pixels));
  return as_few(kLeastTogether, 1, most, team, turns_of(total * team, most));
}

// What is drawn by rows: nothing with a side above `widest` px; and none of those that cover more than kLarge pixels if such
// ones have many on average. A row costs an atomic a pixel, and a block draws it alone. How many they have the blocks find
// out from each other: what is set up together is a sample, and all that have large ones add theirs to `samples`.
struct RowLimits {
  int widest;
  int most_large;  // px of the large ones of a sample, on average
  int most_at_once;  // px of a group's that are drawn without asking the others
  uint64_t* samples;  // how many << kPixelBits, and their pixels; null: large ones are drawn as any other
  uint32_t* decisions;  // of each team, 0 at first
};
constexpr int kLarge = 1 << 11;  // px
constexpr int kPixelBits = 40;

// RowLimits::widest. Warps that are left alone with their triangles take no large ones. Nor do the blocks of a few
// triangles, where most of the device has nothing to do. Where an image has many pixels, or all views have few, what waits
// for blocks that own them takes long to begin; where four blocks share the rows, or a batch keeps all blocks busy, wide ones are
// soon drawn. wanted: the caller's, or 0.
constexpr int64_t kFewTriangles = 256;
inline int widest_rows(const Frame& f, const Sharing& s, int64_t wanted) {
  if (wanted > 0) return (int)wanted;
  const int64_t pixels = (int64_t)f.view.width * f.view.height, total = triangles_of_all(f);
  if (s.way == Way::kApart || tests(s.way) || pixels_each(f) > (f.views > 1 ? kLargePixelsOfViews : kLargePixels))
    return 64;
  if (total <= kFewTriangles && pixels <= kSmallImage) return 96;
  const bool busy = f.views > 1 && total > 2 * kFewTriangles, shared = 1 << s.log_team >= kBlocksOfTeam;
  return shared || busy || pixels_of_all(f) <= kSmallImage || pixels >= kHugeImage ? 256 : 192;
}

// RowLimits::most_large where what waits is drawn by patches, which cost little for each pixel, but much to begin with.
// The smaller the image, the fewer patches draw at once, and the more triangles each of them draws one after the other.
// Nor do they pay where samples that have large ones have, for each triangle, less than half of what the image has for each: a
// mesh of few triangles, all of which are large. Since that tells such meshes from layers, less is enough in teams; and
// in batches, which have patches for all blocks, where samples have more than the image has for each triangle: layers.
constexpr double kMostLarge = 1800, kMostLargeOfTeam = 1300, kLeastLargeOfViews = 1000;  // px for each, of any image
constexpr double kMostLargeOfImage = 3.2e8;  // what a smaller image adds, times its pixels
constexpr double kLeastLayers = 0.5;
inline int most_large(const Frame& f, bool of_team, int count) {
  double any = of_team ? kMostLargeOfTeam : kMostLarge;
  if (f.views > 1) any = min_of(any, max_of(kLeastLargeOfViews, pixels_each(f)));
  const double for_each = max_of(any + kMostLargeOfImage / (double)pixels_of_all(f), kLeastLayers * pixels_each(f));
  return (int)min_of(count * for_each, (double)INT32_MAX);
}
// Triangles of a sample. A team's group is shared out to its blocks, so many in a row each.
constexpr int kOfSample = 4;
inline int of_sample(const Sharing& s) {
  return s.log_team > 0 ? min_of(s.group, max_of(kOfSample, s.group >> s.log_team)) : s.group;
}

// Sharing::own_pixels. Below that a warp is sooner done than the others can begin to help.
inline int own_pixels(const Frame& f) { return (int64_t)f.view.width * f.view.height > kHugeImage ? 4096 : 2048; }

// Whether nearly all may show although there are so many.
inline bool may_show_all(const Frame& f) {
  // Where faces are culled, half of those that show are not drawn, and nearly all never are.
  return f.views == 1 && !f.ranges && pixels_each(f) <= kLeastPixels && f.view.cull == kCullNone;
}

// Shares triangles among blocks. each, team: triangles of a block, and blocks of a team, as the caller wants, or 0. ranges:
// memory for the views' ranges, or null. kernel: that of kEven.
template <class Kernel>
cudaError_t share_triangles(Kernel kernel, const Frame& f, bool projected, int64_t each, int64_t team,
                            ViewRange* ranges, Sharing* s, int64_t* blocks, cudaStream_t stream) {
  int resident;
  BIGTRI_CUDA(resident_blocks(reinterpret_cast<const void*>(kernel), block_threads(Way::kEven), 0, &resident));
  if (!may_be_in_teams(f, each, team)) team = 1;
  if (team == 0) team = blocks_of_team(f, resident);
  s->each = each > 0 ? (int)each : share_size(f, resident, (int)team, projected);
  s->way = way_of(s->each);
  int64_t alone = (f.count + (int64_t)s->each - 1) / s->each;  // blocks of a view, without teams
  // Blocks of the same whole number of triangles might leave places of the device empty.
  if (each == 0 && !ranges && alone > 0 && together(s->way) && alone * f.views * team <= resident) {
    const int least = team > 1 ? kLeastOfTeam : kLeastTogether;
    alone = max_of(alone, min_of<int64_t>(resident / (f.views * team), f.count / least));
    s->each = (int)((f.count + alone - 1) / alone);
  }
  s->log_team = 0;
  while (s->way == Way::kTogether && 1 << s->log_team < team && alone * f.views << s->log_team <= INT32_MAX / 2)
    ++s->log_team;
  if (s->log_team > 0) s->way = Way::kInTeams;
  const bool by_warps = s->way == Way::kEven || s->way == Way::kApart;
  s->groups = by_warps ? block_warps(s->way) : (s->each + kWarp - 1) / kWarp;
  s->group = (s->each + s->groups - 1) / s->groups;
  s->in_turns = s->way == Way::kTested && f.views == 1 && !ranges;
  s->log_neighbours = log_neighbours(f, s->way, resident);
  s->own_pixels = own_pixels(f);
  s->spread = kSpread;
  s->sample = nullptr;
  if (s->in_turns) {  // places for kEven's blocks are as many warps for these
    const int64_t held = (int64_t)resident * block_warps(Way::kEven) / block_warps(Way::kTested);
    s->blocks = (uint32_t)min_of(held, grid_blocks(f.count, block_threads(Way::kTested)));
    while (std::gcd(s->spread, s->blocks) > 1) ++s->spread;
  } else {
    s->blocks = (uint32_t)(alone << s->log_team);
  }
  s->fewest = (int)(f.count / max_of<int64_t>(alone, 1));
  s->with_more = (uint32_t)(f.count % max_of<int64_t>(alone, 1));
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
    case Way::kInTeams: return launch(WayOf<Way::kInTeams>());
    case Way::kInGroups: return launch(WayOf<Way::kInGroups>());
    case Way::kEven: return launch(WayOf<Way::kEven>());
    case Way::kApart: return launch(WayOf<Way::kApart>());
    default: return launch(WayOf<Way::kTested>());
  }
}

// A block's share of a view's triangles. Together: first, first + step, ..., `count` of them. Even and apart: groups of
// neighbours that begin at first, first + step, ..., as far as `count` reaches from the first triangle. Tested: warp w has
// groups of 32 that begin at first + w * apart, and at every `step` from there.
struct Share {
  int32_t view, first, step, count, apart;
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
  Share share = {0, 0, 1, 0, kWarp};
  int32_t all = f.count;  // triangles of the view
  uint32_t block = blockIdx.x, blocks = s.blocks, with_more = s.with_more;
  int fewest = s.fewest;
  if (s.ranges) {
    share.view = view_of_block(s.ranges, f.views, block);
    const ViewRange range = s.ranges[share.view];
    share.first = range.first;
    all = range.count;
    block -= range.first_block;
    blocks = ((uint32_t)all + (uint32_t)s.each - 1) / (uint32_t)s.each;
    if (block >= blocks) return share;
    fewest = (int)((uint32_t)all / blocks);
    with_more = (uint32_t)all % blocks;
  } else if (blocks == 0) {
    return share;
  } else if (f.views > 1) {
    share.view = (int32_t)(block / blocks);
    block -= (uint32_t)share.view * blocks;
  }
  // A list may be as long as int32 counts.
  if (together(kWay)) {
    if (kWay == Way::kInTeams) {
      block >>= s.log_team;
      blocks >>= s.log_team;
    }
    share.first += (int32_t)block;
    share.step = (int32_t)blocks;
    share.count = fewest + (block < with_more ? 1 : 0);
  } else if (kWay == Way::kEven || kWay == Way::kApart) {
    const int32_t before = (int32_t)(block << s.log_neighbours);
    share.first += before;
    share.step = (int32_t)(blocks << s.log_neighbours);
    share.count = all - before;
  } else {
    // In turns, neighbours in the list are drawn by blocks far from each other: a multiprocessor whose warps draw onto the
    // same part of the image takes longer.
    if (s.in_turns) {
      share.apart = (int32_t)blocks * kWarp;
      block = block * s.spread % blocks;
    }
    const int32_t before = (int32_t)block * (s.in_turns ? kWarp : s.each);
    share.first += before;
    share.step = s.in_turns ? (int32_t)blocks * block_threads(kWay) : block_threads(kWay);
    share.count = s.in_turns ? all - before : min_of(s.each, all - before);
  }
  return share;
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

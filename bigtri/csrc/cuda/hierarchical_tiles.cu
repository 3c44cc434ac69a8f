// The hierarchical-tiles variant (Merchante): a pyramid of tiles, each level twice as wide as the one below. Set-up stores
// a record at the finest level at which it meets few tiles, in each of these; their lists have room for more the wider
// they are. Then a warp owns 16x16 px, and walks up the pyramid from the finest tile that holds them: it draws what the
// lists name into registers, and writes each pixel once. A record that finds a list full goes to one that all warps look
// at, so none is lost.

#include "bin_queues.cuh"
#include "clear.h"
#include "depth_image.h"
#include "owned.cuh"
#include "parameters.h"
#include "queued.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr int64_t kTileSizes[] = {16, 32, 64, -1};
constexpr int kMostLevels = 11;  // tiles of 16 px, and above them up to the widest image
#define BIGTRI_LIST(X)                                                                                               \
  BIGTRI_BLOCKS_PARAMETER(X)                                                                                         \
  BIGTRI_QUEUE_PARAMETER(X)                                                                                          \
  BIGTRI_SEARCH_PARAMETER(X)                                                                                         \
  BIGTRI_EARLY_Z_PARAMETER(X)                                                                                        \
  X(tile, "px", "of the finest tiles", 16, 16, 64, kTileSizes)                                                       \
  X(levels, "", "of the pyramid; 0: up to a tile that holds the image", 0, 0, kMostLevels)                           \
  X(meets, "tiles", "that a triangle may meet at the level where it is stored, unless that is the last", 4, 1, 4096) \
  BIGTRI_ROOM_PARAMETER(X)
BIGTRI_PARAMETERS(BIGTRI_LIST)

constexpr int kThreads = 256, kWarps = kThreads / kWarp;

struct Level {
  int tile;  // px
  int columns, rows;
  int room;  // of a tile's list
  int64_t first_tile;  // among those of all levels
  int64_t first_slot;  // of the first tile's list
};

struct Pyramid {
  SetUp set_up;
  Record* records;
  uint32_t* sizes;  // of the lists, or what they were to be; in front of them the counts
  uint32_t* slots;  // of records, list after list
  uint32_t* left;  // slots of records that found a list full
  uint32_t record_room;
  int levels, most;
  int64_t tiles;  // of all levels
  Level level[kMostLevels];

  __device__ uint64_t* record_count() const { return reinterpret_cast<uint64_t*>(sizes - kCounts); }
  __device__ uint64_t* left_count() const { return record_count() + 1; }
  static constexpr int kCounts = 4;  // words
  Zeros zeros() const { return {sizes - kCounts, tiles + kCounts}; }
};

Pyramid take_pyramid(Scratch* scratch, const Frame& f, const Values& v) {
  Pyramid p;
  p.set_up = take_set_up(scratch, f, v.search);
  p.levels = (int)v.levels;
  if (p.levels == 0)
    for (p.levels = 1; v.tile << (p.levels - 1) < max_of(f.view.width, f.view.height);) ++p.levels;
  p.most = (int)v.meets;
  p.record_room = (uint32_t)min_of<int64_t>(v.queue, (int64_t)f.count * kMaxSubTriangles);
  // Each level has a quarter of the tiles of the one below and room for twice as many in each, so that all have twice as
  // many slots as the finest one.
  const int64_t finest = ((f.view.width + v.tile - 1) / v.tile) * ((f.view.height + v.tile - 1) / v.tile),
                room = queue_room(v.room, p.record_room, 2 * finest);
  int64_t slots = 0;
  p.tiles = 0;
  for (int i = 0; i < p.levels; ++i) {
    Level& level = p.level[i];
    level.tile = (int)v.tile << i;
    level.columns = (f.view.width + level.tile - 1) / level.tile;
    level.rows = (f.view.height + level.tile - 1) / level.tile;
    level.room = (int)min_of<int64_t>(room << i, p.record_room);
    level.first_tile = p.tiles;
    level.first_slot = slots;
    p.tiles += (int64_t)level.columns * level.rows;
    slots += (int64_t)level.columns * level.rows * level.room;
  }
  p.records = scratch->take<Record>(p.record_room);
  p.sizes = scratch->take<uint32_t>(p.tiles + Pyramid::kCounts) + Pyramid::kCounts;
  p.slots = scratch->take<uint32_t>(slots);
  p.left = scratch->take<uint32_t>(p.record_room);
  return p;
}

// How many tiles of a level a record's bounding box meets.
__device__ __forceinline__ int tiles_met(const Record& r, int tile) {
  return ((r.x1 - 1) / tile - r.x0 / tile + 1) * ((r.y1 - 1) / tile - r.y0 / tile + 1);
}

// The record in a slot to the lists of those of its tiles that no edge rejects, a lane a tile. By all lanes.
__device__ __forceinline__ void store(const Frame& f, const Pyramid& p, const Record& r, uint32_t slot) {
  int at = 0;
  while (at + 1 < p.levels && tiles_met(r, p.level[at].tile) > p.most) ++at;
  const Level& level = p.level[at];
  bool full = false;
  each_square(f, r, level.tile, level.columns, [&](int64_t tile) {
    const uint32_t place = atomicAdd(&p.sizes[level.first_tile + tile], 1u);
    count_work(f, Counter::entries, 1);
    count_work(f, Counter::atomics, 1);
    count_work(f, Counter::overflows, place >= (uint32_t)level.room);
    count_work(f, Counter::bytes, place < (uint32_t)level.room ? sizeof(*p.slots) : 0);
    if (place < (uint32_t)level.room)
      p.slots[level.first_slot + tile * level.room + place] = slot;
    else
      full = true;
  });
  if (__any_sync(kAllLanes, full) && lane_id() == 0) {
    p.left[claim(p.left_count(), p.record_room, 1)] = slot;
    count_work(f, Counter::bytes, sizeof(*p.left));
  }
}

// A warp's records to the pyramid; those for which there is no memory are drawn at once.
__device__ __noinline__ void queue_or_draw(const Frame& f, const Pyramid& p, const Record* records, int count) {
  if (lane_id() == 0) {
    count_work(f, Counter::records, count);
    count_work(f, Counter::by_tiles, count);
  }
  uint32_t first = 0;
  if (lane_id() == 0) first = claim(p.record_count(), p.record_room, (uint32_t)count);
  first = __shfl_sync(kAllLanes, first, 0);
  for (int i = 0; i < count; ++i) {
    const uint32_t slot = first + (uint32_t)i;
    if (slot < p.record_room) {
      copy_record(p.records + slot, records[i]);
      if (lane_id() == 0) count_work(f, Counter::bytes, sizeof(Record));
      store(f, p, records[i], slot);
    } else {
      if (lane_id() == 0) count_work(f, Counter::overflows, 1);
      warp_draw(frame_pixel(f, f.packed), f.view.width, records[i]);
    }
  }
  __syncwarp();
}

__global__ void __launch_bounds__(kThreads, 4)
    walk_up(const __grid_constant__ Frame f, const __grid_constant__ Pyramid p, bool early_z) {
  __shared__ Entry entries[kWarps][kWarp];
  let_next_begin();
  wait_for_previous();
  const bool others = *p.record_count() > p.record_room;  // have been drawn at once
  const int left = (int)min_of<uint64_t>(*p.left_count(), p.record_room);
  const int columns = (f.view.width + kRegion - 1) / kRegion, rows = (f.view.height + kRegion - 1) / kRegion;
  for (int n = blockIdx.x * kWarps + this_warp(); n < columns * rows; n += gridDim.x * kWarps) {
    Region region;
    begin_region(f, n % columns * kRegion, n / columns * kRegion, others, &region);
    const auto tile_at = [&](const Level& level) {
      return (int64_t)(region.top / level.tile) * level.columns + region.left / level.tile;
    };
    // A lane reads the length of the list at its level, so that there is one wait for all of them.
    const Level& own = p.level[min_of(lane_id(), p.levels - 1)];
    const int size = (int)min_of(p.sizes[own.first_tile + tile_at(own)], (uint32_t)own.room);
    for (int i = 0; i < p.levels; ++i) {
      const Level& level = p.level[i];
      const int count = __shfl_sync(kAllLanes, size, i);
      const uint32_t* const slots = p.slots + level.first_slot + tile_at(level) * level.room;
      draw_listed(f, p.records, count, early_z, &region, entries[this_warp()], [&](int k) { return slots[k]; });
    }
    draw_listed(f, p.records, left, early_z, &region, entries[this_warp()], [&](int k) { return p.left[k]; });
    store_region(f, region);
  }
}

cudaError_t draw_view(const Frame& f, const Values& v, const Pyramid& p, cudaStream_t stream) {
  BIGTRI_CUDA(launch_clear(f, p.set_up.projected, p.zeros(), stream));
  BIGTRI_CUDA(launch_set_up(f, p, v.search, stream));
  int blocks;
  const int64_t regions = (int64_t)((f.view.width + kRegion - 1) / kRegion) * ((f.view.height + kRegion - 1) / kRegion);
  BIGTRI_CUDA(blocks_for(walk_up, kThreads, 0, (regions + kWarps - 1) / kWarps, v.blocks, &blocks));
  return launch_next(walk_up, blocks, kThreads, 0, stream, f, p, v.early_z != 0);
}

using Drawn = ViewByView<Values, take_pyramid, draw_view>;

}  // namespace

extern const CudaVariant hierarchical_tiles_variant;
const CudaVariant hierarchical_tiles_variant = {
    "hierarchical_tiles", "a pyramid of tiles, a triangle at the level where it meets few, owned pixels: Merchante",
    kParameters, Drawn::scratch_bytes, Drawn::draw};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

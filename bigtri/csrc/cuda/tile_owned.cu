// The tile-owned variant: entries are grouped by the tile that owns them, without a gap and whatever their number. Set-up
// counts the tiles that each record touches; then each tile takes a range as long as its count, the records are put into
// the ranges, and a warp owns 16x16 px: it draws the entries of its tile into registers, leaves out what lies behind what
// is there, and writes each pixel once. Where there is no memory for a record, or for a tile's range, it is drawn at once.

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
#define BIGTRI_LIST(X)        \
  BIGTRI_BLOCKS_PARAMETER(X)  \
  BIGTRI_QUEUE_PARAMETER(X)   \
  BIGTRI_SEARCH_PARAMETER(X)  \
  BIGTRI_EARLY_Z_PARAMETER(X) \
  X(tile, "px", "of the tiles by which entries are grouped", 16, 16, 64, kTileSizes)
BIGTRI_PARAMETERS(BIGTRI_LIST)

constexpr int kThreads = 256, kWarps = kThreads / kWarp;
constexpr int64_t kEntriesEach = 16;  // room for entries, for each record that may wait

struct Tiles {
  enum Counter { kRecordCount, kEntryCount, kCounters };

  SetUp set_up;
  Record* records;
  uint64_t* counters;
  uint32_t* sizes;  // of each tile: entries counted
  uint32_t* first;  // of each tile: its range, or kNowhere
  uint32_t* filled;  // of each tile: entries put into its range
  uint32_t* entries;  // slots of records
  uint32_t record_room, entry_room;
  int tile;  // px
  int columns, count;

  static constexpr uint32_t kNowhere = ~0u;
};

Tiles take_tiles(Scratch* scratch, const Frame& f, const Values& v) {
  Tiles t;
  t.set_up = take_set_up(scratch, f, v.search);
  t.tile = (int)v.tile;
  t.columns = (f.view.width + t.tile - 1) / t.tile;
  t.count = t.columns * ((f.view.height + t.tile - 1) / t.tile);
  t.record_room = (uint32_t)min_of<int64_t>(v.queue, (int64_t)f.count * kMaxSubTriangles);
  t.entry_room = (uint32_t)(v.queue * kEntriesEach);
  t.records = scratch->take<Record>(t.record_room);
  t.entries = scratch->take<uint32_t>(t.entry_room);
  t.first = scratch->take<uint32_t>(t.count);
  // These are cleared together.
  t.counters = scratch->take<uint64_t>(Tiles::kCounters + t.count);
  t.sizes = reinterpret_cast<uint32_t*>(t.counters + Tiles::kCounters);
  t.filled = t.sizes + t.count;
  return t;
}

// A warp's records to memory, counted by tiles; those for which there is no memory are drawn at once.
__device__ __noinline__ void queue_or_draw(const Frame& f, const Tiles& t, const Record* records, int count) {
  if (lane_id() == 0) {
    count_work(f, Counter::records, count);
    count_work(f, Counter::by_tiles, count);
  }
  uint32_t first = 0;
  if (lane_id() == 0) first = claim(&t.counters[Tiles::kRecordCount], t.record_room, (uint32_t)count);
  first = __shfl_sync(kAllLanes, first, 0);
  for (int i = 0; i < count; ++i) {
    const uint32_t slot = first + (uint32_t)i;
    if (slot < t.record_room) {
      copy_record(t.records + slot, records[i]);
      if (lane_id() == 0) count_work(f, Counter::bytes, sizeof(Record));
      each_square(f, records[i], t.tile, t.columns, [&](int tile) {
        atomicAdd(&t.sizes[tile], 1u);
        count_work(f, Counter::atomics, 1);
      });
    } else {
      if (lane_id() == 0) count_work(f, Counter::overflows, 1);
      warp_draw(frame_pixel(f, f.packed), f.view.width, records[i]);
    }
  }
  __syncwarp();
}

// A range for each tile, in any order: a warp's 32 tiles take theirs at once.
__global__ void __launch_bounds__(kThreads) place_ranges(const __grid_constant__ Tiles t) {
  let_next_begin();
  wait_for_previous();
  const int tile = blockIdx.x * kThreads + threadIdx.x;
  const uint32_t size = tile < t.count ? t.sizes[tile] : 0;
  // 32 tiles have fewer entries than int32 counts: 2^24 records each at most.
  const uint32_t end = (uint32_t)warp_sum_up_to((int)size), all = __shfl_sync(kAllLanes, end, kWarp - 1);
  uint32_t begin = 0;
  if (lane_id() == 0) begin = claim(&t.counters[Tiles::kEntryCount], t.entry_room, all);
  begin = __shfl_sync(kAllLanes, begin, 0) + end - size;
  if (tile < t.count) t.first[tile] = begin + (uint64_t)size <= t.entry_room ? begin : Tiles::kNowhere;
}

// The records to their tiles' ranges, a warp each.
__global__ void __launch_bounds__(kThreads)
    fill_ranges(const __grid_constant__ Frame f, const __grid_constant__ Tiles t) {
  let_next_begin();
  wait_for_previous();
  const uint32_t count = (uint32_t)min_of<uint64_t>(t.counters[Tiles::kRecordCount], t.record_room);
  for (uint32_t slot = blockIdx.x * kWarps + this_warp(); slot < count; slot += gridDim.x * kWarps) {
    bool nowhere = false;
    each_square(f, t.records[slot], t.tile, t.columns, [&](int tile) {
      count_work(f, Counter::entries, 1);
      count_work(f, Counter::overflows, t.first[tile] == Tiles::kNowhere);
      if (t.first[tile] == Tiles::kNowhere)
        nowhere = true;
      else
        t.entries[t.first[tile] + atomicAdd(&t.filled[tile], 1u)] = slot;
      count_work(f, Counter::atomics, t.first[tile] != Tiles::kNowhere);
      count_work(f, Counter::bytes, t.first[tile] != Tiles::kNowhere ? sizeof(*t.entries) : 0);
    });
    if (__any_sync(kAllLanes, nowhere)) warp_draw(frame_pixel(f, f.packed), f.view.width, t.records[slot]);
  }
}

__global__ void __launch_bounds__(kThreads, 4)
    draw_regions(const __grid_constant__ Frame f, const __grid_constant__ Tiles t, bool early_z) {
  __shared__ Entry entries[kWarps][kWarp];
  let_next_begin();
  wait_for_previous();
  const bool others = t.counters[Tiles::kRecordCount] > t.record_room || t.counters[Tiles::kEntryCount] > t.entry_room;
  const int columns = (f.view.width + kRegion - 1) / kRegion, rows = (f.view.height + kRegion - 1) / kRegion;
  for (int n = blockIdx.x * kWarps + this_warp(); n < columns * rows; n += gridDim.x * kWarps) {
    Region region;
    begin_region(f, n % columns * kRegion, n / columns * kRegion, others, &region);
    const int tile = region.top / t.tile * t.columns + region.left / t.tile;
    const uint32_t* const slots = t.entries + t.first[tile];
    draw_listed(f, t.records, (int)t.filled[tile], early_z, &region, entries[this_warp()],
                [&](int k) { return slots[k]; });
    store_region(f, region);
  }
}

cudaError_t draw_view(const Frame& f, const Values& v, const Tiles& t, cudaStream_t stream) {
  const int64_t regions = (int64_t)((f.view.width + kRegion - 1) / kRegion) * ((f.view.height + kRegion - 1) / kRegion);
  int filling, drawing;
  BIGTRI_CUDA(blocks_for(fill_ranges, kThreads, 0, (f.count + kWarps - 1) / kWarps, v.blocks, &filling));
  BIGTRI_CUDA(blocks_for(draw_regions, kThreads, 0, (regions + kWarps - 1) / kWarps, v.blocks, &drawing));
  BIGTRI_CUDA(launch_clear(f, t.set_up.projected, Zeros::of(t.counters, Tiles::kCounters + t.count), stream));
  BIGTRI_CUDA(launch_set_up(f, t, v.search, stream));
  BIGTRI_CUDA(launch_next(place_ranges, grid_blocks(t.count, kThreads), kThreads, 0, stream, t));
  BIGTRI_CUDA(launch_next(fill_ranges, filling, kThreads, 0, stream, f, t));
  return launch_next(draw_regions, drawing, kThreads, 0, stream, f, t, v.early_z != 0);
}

using Drawn = ViewByView<Values, take_tiles, draw_view>;

}  // namespace

extern const CudaVariant tile_owned_variant;
const CudaVariant tile_owned_variant = {
    "tile_owned", "entries grouped by tile, a warp owns 16x16 px and writes each once, hierarchical z: this project's",
    kParameters, Drawn::scratch_bytes, Drawn::draw};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

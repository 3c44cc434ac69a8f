// The coverage-masks variant (the idea of CudaRaster, in this project's own code): coarse to fine. Set-up queues records by
// bins; then blocks take bins, those with the longest queues first, so that none is left at the end. Coarse: a thread takes
// a record and masks the bin's tiles that it touches. Fine: a warp takes a tile; lanes make 8x8 coverage masks of a record
// each, and a prefix sum of their bits spreads the fragments evenly over lanes, however few pixels a record has.

#include "bin_queues.cuh"
#include "clear.h"
#include "depth_image.h"
#include "parameters.h"
#include "queued.cuh"
#include "rows.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

#define BIGTRI_LIST(X)       \
  BIGTRI_BLOCKS_PARAMETER(X) \
  BIGTRI_QUEUE_PARAMETER(X)  \
  BIGTRI_SEARCH_PARAMETER(X) \
  BIGTRI_ROOM_PARAMETER(X)
BIGTRI_PARAMETERS(BIGTRI_LIST)

constexpr int kThreads = 256, kWarps = kThreads / kWarp;
constexpr int kTilesOfBin = 64;
constexpr int kTogether = 128;  // entries

struct Queues : BinQueues {
  uint32_t* order;  // bins, the longest queues first
};

Queues take_queues(Scratch* scratch, const Frame& f, const Values& v) {
  Queues q;
  static_cast<BinQueues&>(q) = take_bin_queues(scratch, f, v.queue, v.room, v.search, kBin);
  q.order = scratch->take<uint32_t>(q.count);
  return q;
}

// Sorts bins by the highest bit of their queues' lengths: one in front of another is at least half as long. By one block.
__global__ void __launch_bounds__(kThreads) order_bins(const __grid_constant__ Queues q) {
  __shared__ unsigned place[kWarp + 1];  // of the next bin with so many leading zeros
  let_next_begin();
  wait_for_previous();
  if (threadIdx.x <= kWarp) place[threadIdx.x] = 0;
  __syncthreads();
  for (int bin = threadIdx.x; bin < q.count; bin += kThreads) atomicAdd(&place[__clz((int)q.sizes[bin])], 1u);
  __syncthreads();
  if (threadIdx.x == 0) {
    unsigned before = 0;
    for (int zeros = 0; zeros <= kWarp; ++zeros) {
      const unsigned count = place[zeros];
      place[zeros] = before;
      before += count;
    }
  }
  __syncthreads();
  for (int bin = threadIdx.x; bin < q.count; bin += kThreads)
    q.order[atomicAdd(&place[__clz((int)q.sizes[bin])], 1u)] = (uint32_t)bin;
}

// Of a warp: the records of a tile that have pixels there.
struct Masks {
  uint64_t mask[kWarp];  // bit 8 * row + column
  int begin[kWarp];  // how many pixels the records before this one have
  uint8_t entry[kWarp];
  uint8_t touching[kTogether];  // entries that touch the tile
};

// Shared memory of a block.
struct Shared {
  int64_t pixels[kBin * kBin];
  Entry entries[kTogether];
  uint64_t tiles[kTogether];  // that each entry touches
  Masks masks[kWarps];
  int count, bin;
};
static_assert(sizeof(Shared) <= 48 * 1024, "as much as a block can have without asking");

__device__ __forceinline__ uint64_t tile_mask(const Frame& f, const Record& r, const Entry& e, int left, int top) {
  uint64_t mask = 0;
  for (uint64_t todo = bbox_tiles(r.x0 - left, r.y0 - top, r.x1 - left, r.y1 - top); todo; todo &= todo - 1) {
    const int tile = __ffsll((long long)todo) - 1;
    bool touched = true;
    for (int k = 0; k < 3; ++k) touched &= tile_edge(e.edge[k], tile % 8, tile / 8) + tile_highest(e.edge[k]) >= 0;
    count_work(f, Counter::tiles_tested, 1);
    count_work(f, Counter::tiles_rejected, !touched);
    count_work(f, Counter::edges_32, 3);
    if (touched) mask |= todo & -todo;
  }
  return mask;
}

// The pixels of a tile that an entry covers.
__device__ __forceinline__ uint64_t coverage_mask(const Frame& frame, const Entry& e, int tile) {
  int32_t f[3];
  bool full = true;
  for (int k = 0; k < 3; ++k) {
    f[k] = tile_edge(e.edge[k], tile % 8, tile / 8);
    full &= f[k] + tile_lowest(e.edge[k]) >= 0;
  }
  count_work(frame, Counter::tiles_accepted, full);
  count_work(frame, Counter::edges_32, full ? 3 : 3 + 3 * kTile * kTile);
  if (full) return ~0ull;
  uint64_t outside = 0;
#pragma unroll 1
  for (int row = 0; row < kTile; ++row) {
    uint32_t signs = 0;
#pragma unroll
    for (int i = kTile - 1; i >= 0; --i) {
      const int32_t any = (f[0] + i * e.edge[0].sx) | (f[1] + i * e.edge[1].sx) | (f[2] + i * e.edge[2].sx);
      signs = __funnelshift_l((uint32_t)any, signs, 1);
    }
    outside |= (uint64_t)signs << (8 * row);
    for (int k = 0; k < 3; ++k) f[k] += row + 1 < kTile ? e.edge[k].sy : 0;
  }
  return ~outside;
}

// Where the bit number n of a mask is, from its lowest one on.
__device__ __forceinline__ int place_of_bit(uint64_t mask, int n) {
  uint32_t half = (uint32_t)mask;
  int at = 0;
  if (n >= __popc(half)) {
    n -= __popc(half);
    half = (uint32_t)(mask >> 32);
    at = 32;
  }
#pragma unroll
  for (int width = 16; width; width /= 2) {
    const int below = __popc(half & ((1u << width) - 1));
    if (n < below) continue;
    n -= below;
    half >>= width;
    at += width;
  }
  return at;
}

// The entries that touch a tile, into shared memory. By all lanes of a warp; m: its own.
__device__ __forceinline__ void draw_tile(const Frame& f, const Record* records, int tile, int left, int top, Masks* m,
                                          Shared* s) {
  __syncwarp();
  int touching = 0;
  for (int base = 0; base < s->count; base += kWarp) {
    const int i = base + lane_id();
    const bool mine = i < s->count && (s->tiles[i] >> tile & 1);
    const unsigned all = __ballot_sync(kAllLanes, mine);
    if (mine) m->touching[touching + __popc(all & lanes_below())] = (uint8_t)i;
    touching += __popc(all);
  }
  __syncwarp();
  const int x = tile % 8 * kTile, y = tile / 8 * kTile;
  // bbox_tiles has a bit for every 8 px; here a bit is a px.
  const uint64_t allowed = bbox_tiles(8 * (f.view.x0 - left - x), 8 * (f.view.y0 - top - y), 8 * (f.view.x1 - left - x),
                                      8 * (f.view.y1 - top - y));
  for (int base = 0; base < touching; base += kWarp) {
    uint64_t mask = 0;
    int entry = 0;
    if (base + lane_id() < touching) {
      entry = m->touching[base + lane_id()];
      mask = coverage_mask(f, s->entries[entry], tile) & allowed;
    }
    const int end = warp_sum_up_to(__popc((unsigned)mask) + __popc((unsigned)(mask >> 32))),
              begin = end - __popc((unsigned)mask) - __popc((unsigned)(mask >> 32)),
              all = __shfl_sync(kAllLanes, end, kWarp - 1);
    const int place = __popc(__ballot_sync(kAllLanes, mask != 0) & lanes_below());
    if (mask) {
      m->mask[place] = mask;
      m->begin[place] = begin;
      m->entry[place] = (uint8_t)entry;
    }
    __syncwarp();
    for (int first = 0; first < all; first += kWarp) {
      const int its = interval_at(first, begin, mask != 0, lanes_below() << 1 | 1);
      if (first + lane_id() >= all) continue;
      const Entry& e = s->entries[m->entry[its]];
      const int bit = place_of_bit(m->mask[its], first + lane_id() - m->begin[its]), i = x + bit % 8, j = y + bit / 8;
      count_fragment(f, left + i, top + j);
      const float z =
          e.thin()
              ? thin_depth(records + e.slot(), left + i, top + j)
              : finish_depth(plane_row<double>(e.plane.zcell, e.plane.dzdy, j) + plane_column<double>(e.plane.dzdx, i),
                             e.zmin, e.zmax);
      keep_nearest_shared_counted(f, &s->pixels[j * kBin + i], pack_fragment(z, e.triangle));
    }
    __syncwarp();
  }
}

__global__ void __launch_bounds__(kThreads)
    draw_bins(const __grid_constant__ Frame f, const __grid_constant__ Queues q) {
  __shared__ Shared s;
  let_next_begin();
  wait_for_previous();
  const bool others = q.others();
  for (;;) {
    const int number = next_bin(q, &s.bin);
    if (number >= q.count) return;
    const int bin = (int)q.order[number], count = q.length(bin);
    if (count == 0) continue;  // the image has been cleared
    const int left = bin % q.columns * kBin, top = bin / q.columns * kBin;
    const auto each_pixel = [&](const auto& use) {
      for (int i = threadIdx.x; i < kBin * kBin; i += kThreads) {
        const int px = left + i % kBin, py = top + i / kBin;
        if (px < f.view.width && py < f.view.height) use(s.pixels[i], f.packed[(int64_t)py * f.view.width + px]);
      }
    };
    each_pixel([&](int64_t& pixel, int64_t there) { pixel = others ? there : kBackground; });
    for (int base = 0; base < count; base += kTogether) {
      __syncthreads();
      if (threadIdx.x == 0) s.count = 0;
      __syncthreads();
      const int i = base + (int)threadIdx.x;
      if (threadIdx.x < kTogether && i < count) {
        const uint32_t slot = q.slot(bin, i);
        const Record& r = q.records[slot];
        const Meeting meeting = meet(r, slot, left / kBin, top / kBin, 0, 0, kBin, kBin);
        count_meeting(f, meeting, Counter::bins_tested, Counter::bins_rejected, Counter::bins_accepted);
        if (meeting.meets()) {
          const int at = atomicAdd(&s.count, 1);
          meeting.make_entry(r, &s.entries[at]);
          s.tiles[at] = tile_mask(f, r, s.entries[at], left, top);
          count_work(f, Counter::entries, __popc((unsigned)s.tiles[at]) + __popc((unsigned)(s.tiles[at] >> 32)));
        }
      }
      __syncthreads();
      for (int tile = this_warp(); tile < kTilesOfBin; tile += kWarps)
        draw_tile(f, q.records, tile, left, top, &s.masks[this_warp()], &s);
    }
    __syncthreads();
    each_pixel([&](int64_t pixel, int64_t& there) {
      there = pixel;
      count_work(f, Counter::written, 1);
    });
  }
}

cudaError_t draw_view(const Frame& f, const Values& v, const Queues& q, cudaStream_t stream) {
  int blocks;
  BIGTRI_CUDA(blocks_for(draw_bins, kThreads, 0, q.count, v.blocks, &blocks));
  BIGTRI_CUDA(launch_clear(f, q.set_up.projected, q.zeros(), stream));
  BIGTRI_CUDA(launch_set_up(f, static_cast<const BinQueues&>(q), v.search, stream));
  BIGTRI_CUDA(launch_next(order_bins, 1, kThreads, 0, stream, q));
  BIGTRI_CUDA(launch_next(draw_bins, blocks, kThreads, 0, stream, f, q));
  return launch_depth(f, v.blocks, stream);
}

using Drawn = ViewByView<Values, take_queues, draw_view>;

}  // namespace

extern const CudaVariant coverage_masks_variant;
const CudaVariant coverage_masks_variant = {
    "coverage_masks",
    "bins, the longest first, then tiles by 8x8 masks, fragments spread over lanes: CudaRaster's idea", kParameters,
    Drawn::scratch_bytes, Drawn::draw};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

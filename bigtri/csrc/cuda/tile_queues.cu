// The tile-queues variant (Sui's second pipeline): queues of 128 px bins, then of 8 px tiles, then pixels. Set-up queues
// records by bins; then a block takes a bin, moves its records on into queues of the bin's 256 tiles in shared memory, 64
// records at a time, and a warp draws a tile's queue, two pixels a lane. Where the published design loses what comes after
// 1024 triangles, here rounds of 64 follow each other. Edges are in 32 bits in each 64 px cell of a bin: they would not fit
// in all of it.

#include "bin_queues.cuh"
#include "clear.h"
#include "depth_image.h"
#include "parameters.h"
#include "queued.cuh"

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
constexpr int kWideBin = 128;  // px
constexpr int kRow = kWideBin / kTile, kTiles = kRow * kRow;  // of a bin
constexpr int kCells = kWideBin / kBin;  // in a row of a bin
constexpr int kTogether = kThreads / (kCells * kCells);  // records; a thread for each in each cell
static_assert(kTiles == kThreads, "a thread for each tile");

// Shared memory of a block.
struct Shared {
  Entry entries[kThreads];
  int sizes[kTiles];  // of the tiles' queues
  uint8_t queues[kTiles][kTogether];  // entries; a record has one at most in a tile
  int bin;
};

// Puts a thread's entry into the queues of the tiles that it touches in its cell. column, row: the cell in the bin.
__device__ __forceinline__ void queue_tiles(const Frame& f, const Record& r, const Entry& e, int left, int top,
                                            int column, int row, Shared* s) {
  for (uint64_t todo = bbox_tiles(r.x0 - left, r.y0 - top, r.x1 - left, r.y1 - top); todo; todo &= todo - 1) {
    const int tile = __ffsll((long long)todo) - 1, x = tile % 8, y = tile / 8;
    bool touched = true;
    for (int k = 0; k < 3; ++k) touched &= tile_edge(e.edge[k], x, y) + tile_highest(e.edge[k]) >= 0;
    count_work(f, Counter::tiles_tested, 1);
    count_work(f, Counter::tiles_rejected, !touched);
    count_work(f, Counter::edges_32, 3);
    if (!touched) continue;
    count_work(f, Counter::entries, 1);
    const int of_bin = (row * 8 + y) * kRow + column * 8 + x;
    s->queues[of_bin][atomicAdd(&s->sizes[of_bin], 1)] = (uint8_t)threadIdx.x;
  }
}

// A tile's queue onto the frame, where the block owns it. By all lanes of a warp.
__device__ __forceinline__ void draw_tile(const Frame& f, const Record* records, const Shared& s, int tile, int left,
                                          int top) {
  const int x = tile % kRow * kTile + (lane_id() & 7), y = tile / kRow * kTile + (lane_id() >> 3);  // and 4 px below
  const int px = left + x, py = top + y, i = x % kBin, j = y % kBin;
  int64_t* const pixel = f.packed + (int64_t)py * f.view.width + px;
  const int64_t below = 4 * (int64_t)f.view.width;
  const bool column = px >= f.view.x0 && px < f.view.x1;
  const bool allowed[2] = {column && py >= f.view.y0 && py < f.view.y1,
                           column && py + 4 >= f.view.y0 && py + 4 < f.view.y1};
  // What is there is compared last, so that nothing waits for it.
  const int64_t there[2] = {allowed[0] ? pixel[0] : kBackground, allowed[1] ? pixel[below] : kBackground};
  int64_t best[2] = {kBackground, kBackground};
  for (int k = 0; k < s.sizes[tile]; ++k) {
    const Entry& e = s.entries[s.queues[tile][k]];
#pragma unroll
    for (int half = 0; half < 2; ++half) {
      int32_t outside = 0;
      for (int m = 0; m < 3; ++m) outside |= e.edge[m].f + i * e.edge[m].sx + (j + 4 * half) * e.edge[m].sy;
      count_work(f, Counter::edges_32, 3);
      if (outside < 0 || !allowed[half]) continue;
      count_fragment(f, px, py + 4 * half);
      const float z = e.thin() ? thin_depth(records + e.slot(), px, py + 4 * half)
                               : finish_depth(plane_row<double>(e.plane.zcell, e.plane.dzdy, j + 4 * half) +
                                                  plane_column<double>(e.plane.dzdx, i),
                                              e.zmin, e.zmax);
      const int64_t packed = pack_fragment(z, e.triangle);
      count_work(f, Counter::passed, packed < min_of(best[half], there[half]));
      best[half] = min_of(best[half], packed);
    }
  }
  if (best[0] < there[0]) pixel[0] = best[0];
  if (best[1] < there[1]) pixel[below] = best[1];
  count_work(f, Counter::written, (best[0] < there[0]) + (best[1] < there[1]));
}

__global__ void __launch_bounds__(kThreads)
    draw_bins(const __grid_constant__ Frame f, const __grid_constant__ BinQueues q) {
  __shared__ Shared s;
  let_next_begin();
  wait_for_previous();
  for (;;) {
    const int bin = next_bin(q, &s.bin);
    if (bin >= q.count) return;
    const int left = bin % q.columns * kWideBin, top = bin / q.columns * kWideBin, count = q.length(bin);
    for (int base = 0; base < count; base += kTogether) {
      __syncthreads();  // the tiles of the round before are drawn
      s.sizes[threadIdx.x] = 0;
      __syncthreads();
      const int i = base + (int)threadIdx.x / (kCells * kCells), column = threadIdx.x % kCells,
                row = threadIdx.x / kCells % kCells;
      if (i < count) {
        const uint32_t slot = q.slot(bin, i);
        const Record& r = q.records[slot];
        const Meeting m = meet(r, slot, left / kBin + column, top / kBin + row, 0, 0, kBin, kBin);
        count_meeting(f, m, Counter::tiles_tested, Counter::tiles_rejected, Counter::tiles_accepted);
        if (m.meets()) {
          m.make_entry(r, &s.entries[threadIdx.x]);
          queue_tiles(f, r, s.entries[threadIdx.x], left + column * kBin, top + row * kBin, column, row, &s);
        }
      }
      __syncthreads();
      for (int tile = this_warp(); tile < kTiles; tile += kWarps)
        if (s.sizes[tile] > 0) draw_tile(f, q.records, s, tile, left, top);
    }
  }
}

BinQueues take(Scratch* scratch, const Frame& f, const Values& v) {
  return take_bin_queues(scratch, f, v.queue, v.room, v.search, kWideBin);
}

cudaError_t draw_view(const Frame& f, const Values& v, const BinQueues& q, cudaStream_t stream) {
  int blocks;
  BIGTRI_CUDA(blocks_for(draw_bins, kThreads, 0, q.count, v.blocks, &blocks));
  BIGTRI_CUDA(launch_clear(f, q.set_up.projected, q.zeros(), stream));
  BIGTRI_CUDA(launch_set_up(f, q, v.search, stream));
  BIGTRI_CUDA(launch_next(draw_bins, blocks, kThreads, 0, stream, f, q));
  return launch_depth(f, v.blocks, stream);
}

using Drawn = ViewByView<Values, take, draw_view>;

}  // namespace

extern const CudaVariant tile_queues_variant;
const CudaVariant tile_queues_variant = {
    "tile_queues", "queues of 128 px bins, then of 8 px tiles, then pixels: Sui's second pipeline", kParameters,
    Drawn::scratch_bytes, Drawn::draw};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// The persistent-kernel variant: one kernel whose blocks stay. All set up triangles and put them into a queue for each
// bin; then blocks own bins, first come, first served, draw a bin's queue into a copy of the bin in shared memory, a
// warp taking a row of tiles of an entry at a time, and write each pixel once. Between the two all blocks wait for each other. More
// triangles than there is room for records take several passes, each going on from the frame that the last one left.

#include "depth_image.h"
#include "clip.cuh"
#include "direct.cuh"
#include "launch.cuh"
#include "parameters.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

#define BIGTRI_LIST(X) BIGTRI_BLOCKS_PARAMETER(X) BIGTRI_QUEUE_PARAMETER(X)
BIGTRI_PARAMETERS(BIGTRI_LIST)

constexpr int kThreads = 256, kWarps = kThreads / kWarp;
constexpr int kPassTriangles = 1 << 18,
              kPassParts = 1 << 16;  // records of a pass: of whole triangles, and of the parts of clipped ones
constexpr int kQueueBytes = 32 << 20;  // for all bins together
constexpr int kRows = kBin / kTile;  // of tiles in a bin

struct Counters {
  uint32_t arrived;  // at the barriers, in all
  uint32_t parts;  // of clipped triangles
  uint32_t deferred;  // triangles whose parts found no room
  uint32_t next_bin;
  unsigned long long dropped;
};

struct Job {
  Record* records;  // of the pass: triangle by triangle, then parts
  uint8_t* valid;  // whether there is a record
  int32_t* deferred;
  uint32_t* bin_count;  // of its queue; more than there is room for: the bin looks at all records
  uint32_t* queues;
  Counters* counters;
  int pass, parts, room;  // room for triangles, parts, and in a bin's queue
  int bins_x, bins_y;
};

Job take_job(Scratch* scratch, const Frame& f, const Values& v) {
  Job j;
  j.bins_x = bin_columns(f.view);
  j.bins_y = bin_rows(f.view);
  j.pass = min_of(f.count, kPassTriangles);
  j.parts = (int)min_of<int64_t>(kPassParts, min_of<int64_t>(v.queue, (int64_t)f.count * kMaxSubTriangles));
  const int64_t bins = (int64_t)j.bins_x * j.bins_y, records = (int64_t)j.pass + j.parts;
  j.room = (int)min_of<int64_t>(min_of<int64_t>(v.queue, records), max_of<int64_t>(kQueueBytes / 4 / bins, 16));
  j.counters = scratch->take<Counters>(1);  // these two are cleared together
  j.bin_count = scratch->take<uint32_t>(bins);
  j.records = scratch->take<Record>(records);
  j.valid = scratch->take<uint8_t>(records);
  j.deferred = scratch->take<int32_t>(j.pass);
  j.queues = scratch->take<uint32_t>(bins * j.room);
  return j;
}

// All blocks of the grid, which are resident together.
__device__ void wait_for_all(Counters* c, uint32_t* expected) {
  *expected += gridDim.x;
  __syncthreads();
  if (threadIdx.x == 0) {
    __threadfence();
    atomicAdd(&c->arrived, 1u);
    while (*(volatile uint32_t*)&c->arrived < *expected) {
    }
    __threadfence();
  }
  __syncthreads();
}

// The record in a slot to the queue of bin i of its bins, unless an edge rejects that.
__device__ __forceinline__ void put(const Job& j, const Record& r, const BinBox& bins, int i, uint32_t slot) {
  const int bin_x = bins.x + i % bins.columns, bin_y = bins.y + i / bins.columns, bin = bin_y * j.bins_x + bin_x;
  NarrowEdge edge[3];
  if (!narrow_edges(r, bin_x, bin_y, edge)) return;
  const uint32_t at = atomicAdd(&j.bin_count[bin], 1u);
  if (at < (uint32_t)j.room) j.queues[(int64_t)bin * j.room + at] = slot;
}

// The lanes' records to the queues of their bins: a lane its own where it has few, all lanes together where one has
// many.
__device__ __forceinline__ void queue_records(const Job& j, bool have, uint32_t slot) {
  constexpr int kFew = 4;
  BinBox bins = {0, 0, 0, 0};
  if (have) {
    const Record& r = j.records[slot];
    bins = bin_box(r);
    if (bins.count <= kFew)
      for (int i = 0; i < bins.count; ++i) put(j, r, bins, i, slot);
  }
  __syncwarp();
  for (unsigned todo = __ballot_sync(kAllLanes, bins.count > kFew); todo; todo &= todo - 1) {
    const int lane = __ffs(todo) - 1;
    const uint32_t its = __shfl_sync(kAllLanes, slot, lane);
    const BinBox box = of_lane(bins, lane);
    for (int i = lane_id(); i < box.count; i += kWarp) put(j, j.records[its], box, i, its);
  }
}

// Of a warp: one may still clip while another draws.
union WarpOwn {
  ClipScratch clip;
  Record record[kWarp];
  __device__ WarpOwn() {}
};

// What a block of entries is drawn from: each is split into the rows of tiles that it may touch, so that a large one does
// not keep one warp busy, and many small ones in one row, as neighbours in a mesh are, keep all of them busy.
struct Together {
  Entry entries[kThreads];
  uint16_t rows[kThreads * kRows];  // entry * kRows + row
};

struct Shared {
  int64_t pixels[kBin * kBin];
  union {
    Together together;
    WarpOwn warp[kWarps];
  };
  uint32_t far;
  int count, row_count, bin;
  __device__ Shared() {}
};

__device__ void set_up_pass(const Frame& f, const Job& j, int64_t base, int count, Shared* s) {
  const int warp = threadIdx.x / kWarp;
  for (int first = (blockIdx.x * kWarps + warp) * kWarp; first < count; first += gridDim.x * kThreads) {
    const int slot = first + lane_id();
    Primitive p;
    const Fate fate = slot < count ? set_up(f, (int32_t)(base + slot), &p) : Fate::kNothing;
    if (fate == Fate::kWhole) fill_record(p, f.first_triangle + base + slot, &j.records[slot]);
    if (slot < count) j.valid[slot] = fate == Fate::kWhole;
    __syncwarp();
    queue_records(j, fate == Fate::kWhole, (uint32_t)slot);
    for (unsigned todo = __ballot_sync(kAllLanes, fate == Fate::kClip); todo; todo &= todo - 1) {
      const int32_t triangle = (int32_t)(base + first + __ffs(todo) - 1);
      Primitive part;
      const bool have = clip_part(f, 0, triangle, &s->warp[warp].clip, &part);
      const unsigned all = __ballot_sync(kAllLanes, have);
      uint32_t at = 0;
      if (lane_id() == 0) at = atomicAdd(&j.counters->parts, (uint32_t)__popc(all));
      at = __shfl_sync(kAllLanes, at, 0);
      if (at + __popc(all) > (uint32_t)j.parts) {  // all parts or none
        for (uint32_t i = at + lane_id(); i < min_of<uint32_t>(at + __popc(all), (uint32_t)j.parts); i += kWarp)
          j.valid[j.pass + i] = 0;
        if (lane_id() == 0) j.deferred[atomicAdd(&j.counters->deferred, 1u)] = triangle;
        continue;
      }
      const uint32_t its = (uint32_t)j.pass + at + __popc(all & lanes_below());
      if (have) {
        fill_record(part, f.first_triangle + triangle, &j.records[its]);
        j.valid[its] = 1;
      }
      __syncwarp();
      queue_records(j, have, its);
    }
    const unsigned dropped = __ballot_sync(kAllLanes, fate == Fate::kDropped);
    if (dropped && lane_id() == 0) atomicAdd(&j.counters->dropped, (unsigned long long)__popc(dropped));
  }
}

// A row of tiles of one entry, into shared memory. By all lanes of a warp.
__device__ __forceinline__ void draw_tiles(const Frame& f, const Record* records, const Entry& e, int bin_x, int bin_y,
                                           int row, int64_t* pixels) {
  bool any = true, all = true;
  for (int k = 0; k < 3; ++k) {
    const int32_t at = tile_edge(e.edge[k], lane_id() & 7, row);
    any = any && at + tile_highest(e.edge[k]) >= 0;
    all = all && at + tile_lowest(e.edge[k]) >= 0;
  }
  const unsigned touched = __ballot_sync(kAllLanes, any) & 0xff, full = __ballot_sync(kAllLanes, all) & 0xff;
  for (unsigned todo = touched; todo; todo &= todo - 1) {
    const int tile = __ffs(todo) - 1, i = tile * kTile + (lane_id() & 7), px = bin_x * kBin + i;
    const DepthNumber column = plane_column<DepthNumber>(e.plane.dzdx, i);
    // Step by step for both halves, without branches, so that one does not wait for the other: a block's few warps have
    // little else to do meanwhile.
    bool inside[2];
    int64_t packed[2];
#pragma unroll
    for (int half = 0; half < 2; ++half) {
      const int y = row * kTile + (lane_id() >> 3) + 4 * half, py = bin_y * kBin + y;
      int32_t outside = 0;
      for (int k = 0; k < 3; ++k) outside |= e.edge[k].f + i * e.edge[k].sx + y * e.edge[k].sy;
      inside[half] = (full >> tile & 1 || outside >= 0) & (px >= f.view.x0) & (px < f.view.x1) & (py >= f.view.y0) &
                     (py < f.view.y1);
      const float z = finish_depth(plane_row<DepthNumber>(e.plane.zcell, e.plane.dzdy, y) + column, e.zmin, e.zmax);
      packed[half] = pack_fragment(z, e.triangle);
    }
    int64_t* const pixel = pixels + (row * kTile + (lane_id() >> 3)) * kBin + i;
    if (e.thin())
      for (int half = 0; half < 2; ++half)
        if (inside[half])
          packed[half] = pack_fragment(
              thin_depth(records + e.slot(), px, bin_y * kBin + row * kTile + (lane_id() >> 3) + 4 * half), e.triangle);
    const bool nearer[2] = {inside[0] && packed[0] < reread(pixel[0]),
                            inside[1] && packed[1] < reread(pixel[4 * kBin])};
    if (nearer[0]) atomicMin(reinterpret_cast<long long*>(pixel), (long long)packed[0]);
    if (nearer[1]) atomicMin(reinterpret_cast<long long*>(pixel + 4 * kBin), (long long)packed[1]);
  }
}

__device__ void draw_bin(const Frame& f, const Job& j, int bin, int count, int parts, bool first_pass, Shared* s) {
  const int bin_x = bin % j.bins_x, bin_y = bin / j.bins_x, warp = threadIdx.x / kWarp;
  for (int i = threadIdx.x; i < kBin * kBin; i += kThreads) {
    const int px = bin_x * kBin + i % kBin, py = bin_y * kBin + i / kBin;
    s->pixels[i] = !first_pass && px < f.view.width && py < f.view.height ? f.packed[(int64_t)py * f.view.width + px]
                                                                          : kBackground;
  }
  if (threadIdx.x == 0) s->far = float_bits(kInfinity);
  const uint32_t waiting = j.bin_count[bin];
  const bool listed = waiting <= (uint32_t)j.room;
  const int n = listed ? (int)waiting : j.pass + parts;
  Together* const t = &s->together;
  for (int base = 0; base < n; base += kThreads) {
    __syncthreads();
    if (threadIdx.x == 0) s->count = s->row_count = 0;
    __syncthreads();
    const int i = base + (int)threadIdx.x;
    if (i < n) {
      const int slot = listed ? (int)j.queues[(int64_t)bin * j.room + i] : i;
      const bool valid = listed || ((i < count || i >= j.pass) && j.valid[i]);
      if (valid) {
        const Record& r = j.records[slot];
        const bool inside = listed || (r.x0 / kBin <= bin_x && (r.x1 - 1) / kBin >= bin_x && r.y0 / kBin <= bin_y &&
                                       (r.y1 - 1) / kBin >= bin_y);
        if (inside) {
          const Meeting meeting = meet(r, (uint32_t)slot, bin_x, bin_y, 0, 0, kBin, kBin);
          if (meeting.meets()) {
            const int entry = atomicAdd(&s->count, 1);
            meeting.make_entry(r, &t->entries[entry]);
            const int first = max_of(r.y0 - bin_y * kBin, 0) / kTile,
                      end = (min_of(r.y1 - bin_y * kBin, kBin) - 1) / kTile + 1;
            const int at = atomicAdd(&s->row_count, end - first);
            for (int row = first; row < end; ++row) t->rows[at + row - first] = (uint16_t)(entry * kRows + row);
          }
          if (meeting.farthest < kInfinity) atomicMin(&s->far, float_bits(meeting.farthest));
        }
      }
    }
    __syncthreads();
    const float far = bits_float(s->far);  // behind what covers all of the bin nothing can be seen
    for (int k = warp; k < s->row_count; k += kWarps) {
      const Entry& e = t->entries[t->rows[k] / kRows];
      if (e.nearest <= far) draw_tiles(f, j.records, e, bin_x, bin_y, t->rows[k] % kRows, s->pixels);
    }
  }
  __syncthreads();
  for (int i = threadIdx.x; i < kBin * kBin; i += kThreads) {
    const int px = bin_x * kBin + i % kBin, py = bin_y * kBin + i / kBin;
    if (px < f.view.width && py < f.view.height) f.packed[(int64_t)py * f.view.width + px] = s->pixels[i];
  }
  if (threadIdx.x == 0) j.bin_count[bin] = 0;  // for the next pass
}

// Clipped triangles whose parts found no room, onto what this pass has drawn.
__device__ void draw_deferred(const Frame& f, const Job& j, int count, Shared* s) {
  const int warp = threadIdx.x / kWarp;
  for (int i = blockIdx.x * kWarps + warp; i < count; i += gridDim.x * kWarps) {
    Primitive part;
    const bool have = clip_part(f, 0, j.deferred[i], &s->warp[warp].clip, &part);
    __syncwarp();
    if (have) fill_record(part, f.first_triangle + j.deferred[i], &s->warp[warp].record[lane_id()]);
    __syncwarp();
    draw_now(f.packed, f.view.width, s->warp[warp].record, __ballot_sync(kAllLanes, have));
    __syncwarp();
  }
}

__global__ void __launch_bounds__(kThreads)
    stay_and_draw(const __grid_constant__ Frame f, const __grid_constant__ Job j) {
  extern __shared__ __align__(16) char memory[];
  Shared* s = reinterpret_cast<Shared*>(memory);
  uint32_t expected = 0;
  Counters* c = j.counters;
  int64_t base = 0;
  do {
    const int count = (int)min_of<int64_t>(j.pass, f.count - base);
    set_up_pass(f, j, base, count, s);
    wait_for_all(c, &expected);
    const int parts = (int)min_of<uint32_t>(__ldcg(&c->parts), (uint32_t)j.parts), deferred = (int)__ldcg(&c->deferred);
    for (;;) {
      __syncthreads();
      if (threadIdx.x == 0) s->bin = (int)atomicAdd(&c->next_bin, 1u);
      __syncthreads();
      const int bin = s->bin;
      if (bin >= j.bins_x * j.bins_y) break;
      draw_bin(f, j, bin, count, parts, base == 0, s);
    }
    base += count;
    if (base < f.count || deferred) {
      wait_for_all(c, &expected);
      if (deferred) draw_deferred(f, j, deferred, s);
      if (blockIdx.x == 0 && threadIdx.x == 0) c->parts = c->deferred = c->next_bin = 0;
      wait_for_all(c, &expected);
    }
  } while (base < f.count);
  if (blockIdx.x == 0 && threadIdx.x == 0) *f.dropped = (int64_t)__ldcg(&c->dropped);
}

cudaError_t draw_view(const Frame& f, const Values& v, const Job& job, cudaStream_t stream) {
  const char* end = reinterpret_cast<const char*>(job.bin_count + (int64_t)job.bins_x * job.bins_y);
  BIGTRI_CUDA(cudaMemsetAsync(job.counters, 0, (size_t)(end - reinterpret_cast<const char*>(job.counters)), stream));
  int blocks;
  BIGTRI_CUDA(resident_blocks(reinterpret_cast<const void*>(stay_and_draw), kThreads, sizeof(Shared), &blocks));
  if (v.blocks > 0) blocks = min_of(blocks, (int)v.blocks);  // all of them have to be resident
  BIGTRI_CUDA(launch_together(stay_and_draw, blocks, kThreads, sizeof(Shared), stream, f, job));
  return launch_depth(f, v.blocks, stream);
}

using Drawn = ViewByView<Values, take_job, draw_view>;

}  // namespace

extern const CudaVariant persistent_variant;
const CudaVariant persistent_variant = {
    "persistent",
    "one kernel that stays, a queue for each bin, a bin in shared memory: another project's; docs/cuda.md", kParameters,
    Drawn::scratch_bytes, Drawn::draw};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

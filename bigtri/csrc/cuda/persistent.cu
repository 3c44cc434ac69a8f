// The persistent-kernel variant: one kernel whose blocks stay. All project vertices where each is projected once, set up
// triangles and put them into a queue for each bin; then blocks own bins, first come, first served, draw a bin's queue
// into a copy of the bin in shared memory, a warp taking a row of tiles of an entry at a time, and write each pixel once.
// In between all blocks wait for each other. More triangles than there is room for records take several passes, each going
// on from the frame that the last one left.

#include "depth_image.h"
#include "direct.cuh"
#include "parameters.h"
#include "primitives.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

#define BIGTRI_LIST(X)                                                                                                 \
  BIGTRI_BLOCKS_PARAMETER(X)                                                                                           \
  BIGTRI_QUEUE_PARAMETER(X)                                                                                            \
  BIGTRI_SEARCH_PARAMETER(X)                                                                                           \
  X(patch, "",                                                                                                         \
    "1: a bin's pixels lie in shared memory while it is drawn; 0: in the image, so that global memory is compared", 1, \
    0, 1)
BIGTRI_PARAMETERS(BIGTRI_LIST)

constexpr int kThreads = 256, kWarps = kThreads / kWarp;
constexpr int kPassTriangles = 1 << 18,
              kPassParts = 1 << 16;  // records of a pass: of whole triangles, and of the parts of clipped ones
constexpr int kQueueBytes = 32 << 20;  // for all bins together
constexpr int kRows = kBin / kTile;  // of tiles in a bin

struct Counters {
  uint32_t arrived;  // at the barriers, in all
  uint32_t whole, parts;  // records: of whole triangles, and parts of clipped ones
  uint32_t deferred;  // triangles whose parts found no room
  uint32_t next_bin;
  unsigned long long dropped;
};

struct Job {
  SetUp set_up;
  Record* records;  // of the pass: `pass` places for whole triangles, then those for parts; each filled from its front
  int32_t* deferred;
  uint32_t* bin_count;  // of its queue; more than there is room for: the bin looks at all records
  uint32_t* queues;
  Counters* counters;
  int pass, parts, room;  // room for triangles, parts, and in a bin's queue
  int bins_x, bins_y;
};

Job take_job(Scratch* scratch, const Frame& f, const Values& v) {
  Job j;
  j.set_up = take_set_up(scratch, f, v.search);
  j.bins_x = bin_columns(f.view);
  j.bins_y = bin_rows(f.view);
  j.pass = min_of(f.count, kPassTriangles);
  j.parts = (int)min_of<int64_t>(kPassParts, min_of<int64_t>(v.queue, (int64_t)f.count * kMaxSubTriangles));
  const int64_t bins = (int64_t)j.bins_x * j.bins_y, records = (int64_t)j.pass + j.parts;
  j.room = (int)min_of<int64_t>(min_of<int64_t>(v.queue, records), max_of<int64_t>(kQueueBytes / 4 / bins, 16));
  j.counters = scratch->take<Counters>(1);  // these two are cleared together
  j.bin_count = scratch->take<uint32_t>(bins);
  j.records = scratch->take<Record>(records);
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
__device__ __forceinline__ void put(const Frame& f, const Job& j, const Record& r, const BinBox& bins, int i,
                                    uint32_t slot) {
  const int bin_x = bins.x + i % bins.columns, bin_y = bins.y + i / bins.columns, bin = bin_y * j.bins_x + bin_x;
  NarrowEdge edge[3];
  count_work(f, Counter::candidates, 1);
  count_work(f, Counter::bins_tested, 1);
  count_work(f, Counter::edges_64, 3);
  if (!narrow_edges(r, bin_x, bin_y, edge)) return count_work(f, Counter::bins_rejected, 1);
  const uint32_t at = atomicAdd(&j.bin_count[bin], 1u);
  count_work(f, Counter::entries, 1);
  count_work(f, Counter::atomics, 1);
  count_work(f, Counter::overflows, at >= (uint32_t)j.room);
  count_work(f, Counter::bytes, at < (uint32_t)j.room ? sizeof(*j.queues) : 0);
  if (at < (uint32_t)j.room) j.queues[(int64_t)bin * j.room + at] = slot;
}

// The lanes' records to the queues of their bins: a lane its own where it has few, all lanes together where one has
// many.
__device__ __forceinline__ void queue_records(const Frame& f, const Job& j, bool have, uint32_t slot) {
  constexpr int kFew = 4;
  BinBox bins = {0, 0, 0, 0};
  if (have) {
    const Record& r = j.records[slot];
    bins = bin_box(r);
    if (bins.count <= kFew)
      for (int i = 0; i < bins.count; ++i) put(f, j, r, bins, i, slot);
  }
  __syncwarp();
  for (unsigned todo = __ballot_sync(kAllLanes, bins.count > kFew); todo; todo &= todo - 1) {
    const int lane = __ffs(todo) - 1;
    const uint32_t its = __shfl_sync(kAllLanes, slot, lane);
    const BinBox box = of_lane(bins, lane);
    for (int i = lane_id(); i < box.count; i += kWarp) put(f, j, j.records[its], box, i, its);
  }
}

// Of a warp: one may still clip while another draws.
struct WarpOwn {
  Search search;
  union {
    ClipScratch clip;
    Record record[kWarp];
  };
  __device__ WarpOwn() {}
};

// What a block of entries is drawn from: each is split into the rows of tiles that it may touch, so that a large one does
// not keep one warp busy, and many small ones in one row, as neighbours in a mesh are, keep all of them busy.
struct Together {
  Entry entries[kThreads];
  uint16_t rows[kThreads * kRows];  // entry * kRows + row
};

struct Shared {
  union {
    Together together;
    WarpOwn warp[kWarps];
  };
  uint32_t far;
  int count, row_count, bin;
  __device__ Shared() {}
};

// Where a bin's pixels lie while its block draws it: in shared memory, from which they are written to the image in the
// end, or in the image itself.
template <bool kPatch>
struct BinPixels;
template <>
struct BinPixels<true> {
  struct Memory : Shared {
    int64_t pixels[kBin * kBin];
  };
  int64_t* first;
  static constexpr int64_t pitch = kBin;

  __device__ __forceinline__ BinPixels(const Frame&, Memory* s, int, int) : first(s->pixels) {}
  __device__ __forceinline__ static int64_t look(const int64_t* pixel) { return reread(*pixel); }
  __device__ __forceinline__ static void lower(const Frame& f, int64_t* pixel, int64_t packed) {
    const bool passed = atomicMin(reinterpret_cast<long long*>(pixel), (long long)packed) > packed;
    count_work(f, Counter::passed, passed);
  }
};
template <>
struct BinPixels<false> {
  using Memory = Shared;
  int64_t* first;
  int64_t pitch;

  __device__ __forceinline__ BinPixels(const Frame& f, Memory*, int bin_x, int bin_y)
      : first(f.packed + (int64_t)bin_y * kBin * f.view.width + bin_x * kBin), pitch(f.view.width) {}
  // Atomic operations pass the L1 cache by.
  __device__ __forceinline__ static int64_t look(const int64_t* pixel) { return __ldcg(pixel); }
  __device__ __forceinline__ static void lower(const Frame& f, int64_t* pixel, int64_t packed) {
    keep_nearest_counted(f, pixel, packed);
  }
};

// Calls use(place in the bin, pixel of the image) for the bin's pixels. By all threads of a block.
template <class Use>
__device__ __forceinline__ void each_pixel(const Frame& f, int bin_x, int bin_y, const Use& use) {
  for (int i = threadIdx.x; i < kBin * kBin; i += kThreads) {
    const int px = bin_x * kBin + i % kBin, py = bin_y * kBin + i / kBin;
    if (px < f.view.width && py < f.view.height) use(i, f.packed + ((int64_t)py * f.view.width + px));
  }
}

constexpr uint32_t kNoRoom = ~0u;

// The first of the next n places of `room`, or kNoRoom where there are less left: then none is taken. By all lanes.
__device__ __forceinline__ uint32_t claim_all(uint32_t* count, uint32_t room, uint32_t n) {
  uint32_t at = 0;
  if (lane_id() == 0) {
    uint32_t seen = __ldcg(count);
    do {
      at = seen;
      seen = at + n <= room ? atomicCAS(count, at, at + n) : at;
    } while (seen != at);
    if (at + n > room) at = kNoRoom;
  }
  return __shfl_sync(kAllLanes, at, 0);
}

// The lanes' primitives to records from place `first` on, which go to the queues. By all lanes.
__device__ __forceinline__ void put_and_queue(const Frame& f, const Job& j, bool have, const Primitive& p,
                                              int64_t triangle, uint32_t first) {
  const uint32_t slot = first + (uint32_t)__popc(__ballot_sync(kAllLanes, have) & lanes_below());
  if (have) fill_record(p, triangle, &j.records[slot]);
  __syncwarp();
  count_work(f, Counter::records, have);
  count_work(f, Counter::by_tiles, have);
  count_work(f, Counter::bytes, have ? sizeof(Record) : 0);
  queue_records(f, j, have, slot);
}

// The share of a warp, its triangles [first, end).
__device__ __forceinline__ void set_up_share(const Frame& f, const Job& j, int32_t first, int32_t end, WarpOwn* own) {
  begin_set_up(j.set_up, first, &own->search);
  while (own->search.goes_on(end)) {
    Primitive p;
    int32_t t;
    const Fate fate = set_up_next(f, j.set_up, end, &own->search, &t, &p);
    const unsigned whole = __ballot_sync(kAllLanes, fate == Fate::kWhole),
                   dropped = __ballot_sync(kAllLanes, fate == Fate::kDropped);
    if (whole) {
      uint32_t at = 0;
      if (lane_id() == 0) at = atomicAdd(&j.counters->whole, (uint32_t)__popc(whole));
      put_and_queue(f, j, fate == Fate::kWhole, p, f.first_triangle + t, __shfl_sync(kAllLanes, at, 0));
    }
    for (unsigned todo = __ballot_sync(kAllLanes, fate == Fate::kClip); todo; todo &= todo - 1) {
      const int32_t triangle = __shfl_sync(kAllLanes, t, __ffs(todo) - 1);
      const bool have = clip_lanes(f, triangle, &own->clip, &p);
      const uint32_t parts = (uint32_t)__popc(__ballot_sync(kAllLanes, have)),
                     place = claim_all(&j.counters->parts, (uint32_t)j.parts, parts);
      if (place != kNoRoom)
        put_and_queue(f, j, have, p, f.first_triangle + triangle, (uint32_t)j.pass + place);
      else if (lane_id() == 0) {
        j.deferred[atomicAdd(&j.counters->deferred, 1u)] = triangle;
        count_work(f, Counter::bytes, sizeof(*j.deferred));
      }
    }
    if (dropped && lane_id() == 0) atomicAdd(&j.counters->dropped, (unsigned long long)__popc(dropped));
  }
}

__device__ void set_up_pass(const Frame& f, const Job& j, int64_t base, int count, Shared* s) {
  const int64_t step = (int64_t)gridDim.x * kWarps * j.set_up.each;
  for (int64_t first = ((int64_t)blockIdx.x * kWarps + this_warp()) * j.set_up.each; first < count; first += step)
    set_up_share(f, j, (int32_t)(base + first), (int32_t)(base + min_of<int64_t>(first + j.set_up.each, count)),
                 &s->warp[this_warp()]);
}

__device__ void project_all(const Frame& f, Vertex* projected) {
  constexpr int kEach = 2;
  const int step = (int)gridDim.x * kThreads;
  for (int64_t first = blockIdx.x * kThreads + threadIdx.x; first < f.vertices; first += (int64_t)kEach * step)
    project_vertices<kEach>(f, first, step, f.vertices,
                            [&](const Vertex& v, int64_t i) { store_vertex(v, projected + i); });
}

// A row of tiles of one entry. By all lanes of a warp.
template <bool kPatch>
__device__ __forceinline__ void draw_tiles(const Frame& f, const Record* records, const Entry& e, int bin_x, int bin_y,
                                           int row, const BinPixels<kPatch>& pixels) {
  bool any = true, all = true;
  for (int k = 0; k < 3; ++k) {
    const int32_t at = tile_edge(e.edge[k], lane_id() & 7, row);
    any = any && at + tile_highest(e.edge[k]) >= 0;
    all = all && at + tile_lowest(e.edge[k]) >= 0;
  }
  const unsigned touched = __ballot_sync(kAllLanes, any) & 0xff, full = __ballot_sync(kAllLanes, all) & 0xff;
  if (lane_id() == 0) {
    count_work(f, Counter::tiles_tested, kRows);
    count_work(f, Counter::tiles_rejected, kRows - __popc(touched));
    count_work(f, Counter::tiles_accepted, __popc(full));
    count_work(f, Counter::edges_32, 3 * (2 * kRows + kTile * kTile * __popc(touched)));
  }
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
      if constexpr (kCounts)
        if (inside[half]) count_fragment(f, px, py);
      const float z = finish_depth(plane_row<DepthNumber>(e.plane.zcell, e.plane.dzdy, y) + column, e.zmin, e.zmax);
      packed[half] = pack_fragment(z, e.triangle);
    }
    int64_t* const pixel = pixels.first + (row * kTile + (lane_id() >> 3)) * pixels.pitch + i;
    int64_t* const below = pixel + 4 * pixels.pitch;
    if (e.thin())
      for (int half = 0; half < 2; ++half)
        if (inside[half])
          packed[half] = pack_fragment(
              thin_depth(records + e.slot(), px, bin_y * kBin + row * kTile + (lane_id() >> 3) + 4 * half), e.triangle);
    const bool nearer[2] = {inside[0] && packed[0] < pixels.look(pixel), inside[1] && packed[1] < pixels.look(below)};
    if (nearer[0]) pixels.lower(f, pixel, packed[0]);
    if (nearer[1]) pixels.lower(f, below, packed[1]);
  }
}

// whole, parts: records of the pass.
template <bool kPatch>
__device__ void draw_bin(const Frame& f, const Job& j, int bin, int whole, int parts, bool first_pass,
                         typename BinPixels<kPatch>::Memory* s) {
  const int bin_x = bin % j.bins_x, bin_y = bin / j.bins_x, warp = threadIdx.x / kWarp;
  const BinPixels<kPatch> pixels(f, s, bin_x, bin_y);
  if (kPatch || first_pass)
    each_pixel(f, bin_x, bin_y,
               [&](int i, int64_t* pixel) { (kPatch ? pixels.first[i] : *pixel) = first_pass ? kBackground : *pixel; });
  if (threadIdx.x == 0) s->far = float_bits(kInfinity);
  const uint32_t waiting = j.bin_count[bin];
  const bool listed = waiting <= (uint32_t)j.room;
  const int n = listed ? (int)waiting : whole + parts;
  Together* const t = &s->together;
  for (int base = 0; base < n; base += kThreads) {
    __syncthreads();
    if (threadIdx.x == 0) s->count = s->row_count = 0;
    __syncthreads();
    const int i = base + (int)threadIdx.x;
    if (i < n) {
      const int slot = listed ? (int)j.queues[(int64_t)bin * j.room + i] : i < whole ? i : j.pass + i - whole;
      const Record& r = j.records[slot];
      const bool inside = listed || (r.x0 / kBin <= bin_x && (r.x1 - 1) / kBin >= bin_x && r.y0 / kBin <= bin_y &&
                                     (r.y1 - 1) / kBin >= bin_y);
      if (inside) {
        const Meeting meeting = meet(r, (uint32_t)slot, bin_x, bin_y, 0, 0, kBin, kBin);
        count_meeting(f, meeting, Counter::bins_tested, Counter::bins_rejected, Counter::bins_accepted);
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
    __syncthreads();
    const float far = bits_float(s->far);  // behind what covers all of the bin nothing can be seen
    for (int k = threadIdx.x; kCounts && k < s->count; k += kThreads)
      count_work(f, Counter::bins_hidden, t->entries[k].nearest > far);
    for (int k = warp; k < s->row_count; k += kWarps) {
      const Entry& e = t->entries[t->rows[k] / kRows];
      if (e.nearest <= far) draw_tiles(f, j.records, e, bin_x, bin_y, t->rows[k] % kRows, pixels);
    }
  }
  __syncthreads();
  if (kPatch)
    each_pixel(f, bin_x, bin_y, [&](int i, int64_t* pixel) {
      *pixel = pixels.first[i];
      count_work(f, Counter::written, 1);
    });
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
    count_work(f, Counter::records, have);
    count_work(f, Counter::by_tiles, have);
    count_work(f, Counter::overflows, have);
    draw_now(frame_pixel(f, f.packed), f.view.width, s->warp[warp].record, __ballot_sync(kAllLanes, have));
    __syncwarp();
  }
}

template <bool kPatch>
__global__ void __launch_bounds__(kThreads)
    stay_and_draw(const __grid_constant__ Frame f, const __grid_constant__ Job j) {
  extern __shared__ __align__(16) char memory[];
  auto* const s = reinterpret_cast<typename BinPixels<kPatch>::Memory*>(memory);
  uint32_t expected = 0;
  Counters* c = j.counters;
  int64_t base = 0;
  if (j.set_up.projected) {
    project_all(f, j.set_up.projected);
    wait_for_all(c, &expected);
  }
  do {
    const int count = (int)min_of<int64_t>(j.pass, f.count - base);
    set_up_pass(f, j, base, count, s);
    wait_for_all(c, &expected);
    const int whole = (int)__ldcg(&c->whole), parts = (int)__ldcg(&c->parts), deferred = (int)__ldcg(&c->deferred);
    for (;;) {
      __syncthreads();
      if (threadIdx.x == 0) s->bin = (int)atomicAdd(&c->next_bin, 1u);
      __syncthreads();
      const int bin = s->bin;
      if (bin >= j.bins_x * j.bins_y) break;
      draw_bin<kPatch>(f, j, bin, whole, parts, base == 0, s);
    }
    base += count;
    if (base < f.count || deferred) {
      wait_for_all(c, &expected);
      if (deferred) draw_deferred(f, j, deferred, s);
      if (blockIdx.x == 0 && threadIdx.x == 0) c->whole = c->parts = c->deferred = c->next_bin = 0;
      wait_for_all(c, &expected);
    }
  } while (base < f.count);
  if (blockIdx.x == 0 && threadIdx.x == 0) *f.dropped = (int64_t)__ldcg(&c->dropped);
}

template <bool kPatch>
cudaError_t draw(const Frame& f, const Values& v, Job job, cudaStream_t stream) {
  constexpr int64_t kSharedBytes = sizeof(typename BinPixels<kPatch>::Memory);
  const char* end = reinterpret_cast<const char*>(job.bin_count + (int64_t)job.bins_x * job.bins_y);
  BIGTRI_CUDA(cudaMemsetAsync(job.counters, 0, (size_t)(end - reinterpret_cast<const char*>(job.counters)), stream));
  int blocks;
  BIGTRI_CUDA(resident_blocks(reinterpret_cast<const void*>(stay_and_draw<kPatch>), kThreads, kSharedBytes, &blocks));
  if (v.blocks > 0) blocks = min_of(blocks, (int)v.blocks);  // all of them have to be resident
  BIGTRI_CUDA(choose_each(f, v.search, untested_each(f, (int64_t)blocks * kWarps), &job.set_up));
  BIGTRI_CUDA(launch_together(stay_and_draw<kPatch>, blocks, kThreads, kSharedBytes, stream, f, job));
  return launch_depth(f, v.blocks, stream);
}

cudaError_t draw_view(const Frame& f, const Values& v, const Job& job, cudaStream_t stream) {
  return v.patch ? draw<true>(f, v, job, stream) : draw<false>(f, v, job, stream);
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

// The batched variant: a block takes up to 32 triangles, and draws one after the other; its threads stride over the
// pixels of the bounding box, test the three edges at each, and draw with an atomic minimum. The baseline of Splatshop:
// simple and good for small triangles, but most of a large triangle's bounding box is not the triangle, and one block has
// all of it.

#include "clear.h"
#include "counting.cuh"
#include "depth_image.h"
#include "fragment.cuh"
#include "parameters.h"
#include "primitives.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

#define BIGTRI_LIST(X)                                                                                             \
  BIGTRI_THREADS_PARAMETER(X)                                                                                      \
  BIGTRI_SEARCH_PARAMETER(X)                                                                                       \
  X(batch, "triangles", "of a block, which draws one after the other; of those that it tests first, 32", kWarp, 1, \
    kWarp)
BIGTRI_PARAMETERS(BIGTRI_LIST)

// Shared memory of a block.
struct Batch {
  Record record[kWarp];
  Search search;
  ClipScratch clip;
  int count;  // records
  unsigned to_clip;  // bit k: the triangle of lane k has to be clipped
};

// The pixels of the record's bounding box within one cell, which has one depth plane. By all threads of a block.
__device__ __forceinline__ void draw_in_cell(const Frame& f, const Record& r, int cell_x, int cell_y) {
  const int x0 = max_of(r.x0, cell_x * kBin), x1 = min_of(r.x1, (cell_x + 1) * kBin), y0 = max_of(r.y0, cell_y * kBin),
            y1 = min_of(r.y1, (cell_y + 1) * kBin), columns = x1 - x0;
  const CellPlane plane = cell_plane(r, cell_x, cell_y);
  Edge edge[3];
  int64_t first[3];  // an edge may be so far away that its value does not fit 32 bits
  for (int k = 0; k < 3; ++k) {
    edge[k] = edge_of(r.x, r.y, k);
    first[k] = edge_steps(edge[k], x0, y0);
  }
  if (threadIdx.x == 0) count_work(f, Counter::edges_64, 3 * (int64_t)columns * (y1 - y0));
  for (int n = threadIdx.x; n < columns * (y1 - y0); n += blockDim.x) {
    const int i = n % columns, j = n / columns, x = x0 + i, y = y0 + j;
    int64_t outside = 0;
    for (int k = 0; k < 3; ++k) outside |= first[k] - (int64_t)edge[k].dy * i + (int64_t)edge[k].dx * j;
    if (outside < 0) continue;
    count_fragment(f, x, y);
    const float z = r.flags & kRecordThin ? thin_depth(&r, x, y)
                                          : finish_depth(plane_row<double>(plane.zcell, plane.dzdy, y % kBin) +
                                                             plane_column<double>(plane.dzdx, x % kBin),
                                                         r.zmin, r.zmax);
    keep_nearest_counted(f, f.packed + (int64_t)y * f.view.width + x, pack_fragment(z, r.triangle));
  }
}

// The batch's records. By all threads of a block.
__device__ __forceinline__ void draw_records(const Frame& f, const Batch& b) {
  if (threadIdx.x == 0) {
    count_work(f, Counter::records, b.count);
    count_work(f, Counter::by_rows, b.count);
  }
  for (int n = 0; n < b.count; ++n) {
    const Record& r = b.record[n];
    const BinBox cells = bin_box(r);
    for (int i = 0; i < cells.count; ++i) draw_in_cell(f, r, cells.x + i % cells.columns, cells.y + i / cells.columns);
  }
}

// Threads of so large a block have 96 registers each, which leaves five blocks of the standard size room; with 98 there
// are four.
constexpr int kRoomThreads = 640;
static_assert(kRoomThreads >= kMostThreads, "blocks of all sizes");

__global__ void __launch_bounds__(kRoomThreads)
    draw_batches(const __grid_constant__ Frame f, const __grid_constant__ SetUp how) {
  __shared__ Batch b;
  let_next_begin();
  const int64_t first = (int64_t)blockIdx.x * how.each;
  const int32_t end = (int32_t)min_of<int64_t>(first + how.each, f.count);
  if (this_warp() == 0) begin_set_up(how, (int32_t)first, &b.search);
  __syncthreads();
  // A block that tests none has one batch.
  while (b.search.goes_on(end)) {
    Primitive p;
    int32_t t = 0;
    __syncthreads();  // all know that it goes on, and have drawn what was there
    if (this_warp() == 0) {
      const Fate fate = set_up_next(f, how, end, &b.search, &t, &p);
      const unsigned to_clip = __ballot_sync(kAllLanes, fate == Fate::kClip),
                     dropped = __ballot_sync(kAllLanes, fate == Fate::kDropped);
      if (dropped) count_dropped(f, 0, dropped);
      const int count = put_records(fate == Fate::kWhole, p, f.first_triangle + t, b.record);
      if (lane_id() == 0) {
        b.to_clip = to_clip;
        b.count = count;
      }
    }
    __syncthreads();
    wait_for_previous();
    draw_records(f, b);
    for (unsigned todo = b.to_clip; todo; todo &= todo - 1) {
      __syncthreads();  // all have drawn what was there
      if (this_warp() == 0) {
        const int32_t triangle = __shfl_sync(kAllLanes, t, __ffs(todo) - 1);
        const bool have = clip_lanes(f, triangle, &b.clip, &p);
        const int count = put_records(have, p, f.first_triangle + triangle, b.record);
        if (lane_id() == 0) b.count = count;
      }
      __syncthreads();
      draw_records(f, b);
    }
  }
  wait_for_previous();
}

SetUp take(Scratch* scratch, const Frame& f, const Values& v) { return take_set_up(scratch, f, v.search); }

cudaError_t draw_view(const Frame& f, const Values& v, SetUp how, cudaStream_t stream) {
  BIGTRI_CUDA(launch_clear(f, how.projected, {}, stream));
  if (f.count > 0) {
    BIGTRI_CUDA(choose_each(f, v.search, (int)v.batch, &how));
    BIGTRI_CUDA(launch_next(draw_batches, grid_blocks(f.count, how.each), (int)v.threads, 0, stream, f, how));
  }
  return launch_depth(f, 0, stream);
}

using Drawn = ViewByView<Values, take, draw_view>;

}  // namespace

extern const CudaVariant batched_variant;
const CudaVariant batched_variant = {
    "batched", "32 triangles a block, whose threads stride over bounding boxes, with atomics: Splatshop's baseline",
    kParameters, Drawn::scratch_bytes, Drawn::draw};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

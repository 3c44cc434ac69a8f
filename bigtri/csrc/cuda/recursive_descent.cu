// The recursive-descent variant (Abrash's rasterizer for Larrabee): set-up queues pairs of a record and a bin; a warp
// takes one, and descends from the bin to squares of 16 and of 4 px. At each step 16 lanes test the squares' corners that
// are trivially rejected and 16 those that are trivially accepted: an OR of three edges, whose sign bits a ballot makes
// masks of. Then bits are scanned. All of it is in 32 bits; 64 are needed for the bin alone. A record within one square
// begins there.

#include "clear.h"
#include "counting.cuh"
#include "depth_image.h"
#include "pairs.cuh"
#include "parameters.h"
#include "queued.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

#define BIGTRI_LIST(X)        \
  BIGTRI_BLOCKS_PARAMETER(X)  \
  BIGTRI_QUEUE_PARAMETER(X)   \
  BIGTRI_SEARCH_PARAMETER(X)  \
  BIGTRI_EARLY_Z_PARAMETER(X) \
  X(separate, "",             \
    "1: squares beyond the bounding box are rejected, which no edge may do near a corner; 0: they are not", 1, 0, 1)
BIGTRI_PARAMETERS(BIGTRI_LIST)

constexpr int kThreads = 256;
constexpr int kCoarse = 16, kFine = 4;  // px

// A record within a bin; places are px from the bin's corner.
struct Descent {
  const Frame* frame;
  int64_t* pixels;  // the bin's first one
  int width;  // of the image
  const Record* record;
  NarrowEdge edge[3];
  CellPlane plane;
  int x0, y0, x1, y1;  // bbox
  int bin_x, bin_y;
  int64_t nearest;  // no fragment of the record is below
  bool early_z, separate;
};

// Of 4x4 squares, bit 4 * row + column.
struct Squares {
  unsigned touched, full;
};

// Counts the test of this lane's square, by its rejecting or by its accepting corners. outside: what edges say of these.
__device__ __forceinline__ void count_squares(const Descent& d, int i, int j, int size, int32_t outside) {
  const Frame& f = *d.frame;
  count_work(f, Counter::edges_32, 3);
  if (lane_id() & 16) return count_work(f, Counter::tiles_accepted, outside >= 0);
  count_work(f, Counter::tiles_tested, 1);
  count_work(f, Counter::tiles_rejected, outside < 0);
  if (outside < 0 || !d.separate) return;
  const bool boxed = i < d.x1 && i + size > d.x0 && j < d.y1 && j + size > d.y0;
  count_work(f, Counter::separations, 1);
  count_work(f, Counter::tiles_separated, !boxed);
}

// The squares of `size` px, four by four from (x, y) on. By all lanes.
__device__ __forceinline__ Squares test_squares(const Descent& d, int x, int y, int size) {
  const int i = x + (lane_id() & 3) * size, j = y + (lane_id() >> 2 & 3) * size, last = size - 1;
  const bool accepts = lane_id() & 16;
  int32_t outside = 0;
  for (int k = 0; k < 3; ++k)
    outside |= accepts ? lowest_over(d.edge[k], i, j, last, last) : highest_over(d.edge[k], i, j, last, last);
  if constexpr (kCounts) count_squares(d, i, j, size, outside);
  if (accepts)
    outside |= (i - d.x0) | (d.x1 - 1 - i - last) | (j - d.y0) | (d.y1 - 1 - j - last);
  else if (d.separate)
    outside |= (d.x1 - 1 - i) | (i + last - d.x0) | (d.y1 - 1 - j) | (j + last - d.y0);
  const unsigned inside = __ballot_sync(kAllLanes, outside >= 0);
  return {inside & 0xffff, inside >> 16};
}

__device__ __forceinline__ void draw_pixel(const Descent& d, int i, int j) {
  int64_t* const pixel = d.pixels + (int64_t)j * d.width + i;
  const int64_t there = d.early_z ? __ldcg(pixel) : kBackground;
  if (there < d.nearest) return;
  count_fragment(*d.frame, d.bin_x * kBin + i, d.bin_y * kBin + j);
  const Record& r = *d.record;
  const float z =
      r.flags & kRecordThin
          ? thin_depth(&r, d.bin_x * kBin + i, d.bin_y * kBin + j)
          : finish_depth(plane_row<double>(d.plane.zcell, d.plane.dzdy, j) + plane_column<double>(d.plane.dzdx, i),
                         r.zmin, r.zmax);
  const int64_t packed = pack_fragment(z, r.triangle);
  if (packed < there) keep_nearest_counted(*d.frame, pixel, packed);
}

// The pixel of this lane in a square of 4x4 px at (x, y), 16 lanes a square. full: whether all of it is inside.
__device__ __forceinline__ void draw_fine(const Descent& d, int x, int y, bool full) {
  const int i = x + (lane_id() & 3), j = y + (lane_id() >> 2 & 3);
  int32_t outside = 0;
  if (!full) {
    count_work(*d.frame, Counter::edges_32, 3);
    for (int k = 0; k < 3; ++k) outside |= d.edge[k].f + i * d.edge[k].sx + j * d.edge[k].sy;
    outside |= (i - d.x0) | (d.x1 - 1 - i) | (j - d.y0) | (d.y1 - 1 - j);
  }
  if (outside >= 0) draw_pixel(d, i, j);
}

// A square of 16 px that the record may cover in part: its squares of 4 px, two at a time. By all lanes.
__device__ __forceinline__ void descend_coarse(const Descent& d, int x, int y) {
  const Squares s = test_squares(d, x, y, kFine);
  for (unsigned todo = s.touched; todo;) {
    const unsigned others = todo & (todo - 1), mine = lane_id() & 16 ? others : todo;
    if (mine) {
      const int square = __ffs(mine) - 1;
      draw_fine(d, x + (square & 3) * kFine, y + (square >> 2) * kFine, s.full >> square & 1);
    }
    todo = others & (others - 1);
  }
}

// By all lanes.
__device__ __forceinline__ void descend(const Descent& d) {
  // Where all of the bounding box lies in a square, the squares above it are not asked.
  const int last_x = d.x1 - 1, last_y = d.y1 - 1;
  if (((d.x0 ^ last_x) | (d.y0 ^ last_y)) < kFine) {
    if (lane_id() < kWarp / 2) draw_fine(d, d.x0 & -kFine, d.y0 & -kFine, false);
    return;
  }
  if (((d.x0 ^ last_x) | (d.y0 ^ last_y)) < kCoarse) return descend_coarse(d, d.x0 & -kCoarse, d.y0 & -kCoarse);
  const Squares s = test_squares(d, 0, 0, kCoarse);
  for (unsigned todo = s.touched; todo; todo &= todo - 1) {
    const int square = __ffs(todo) - 1, x = (square & 3) * kCoarse, y = (square >> 2) * kCoarse;
    if (!(s.full >> square & 1)) {
      descend_coarse(d, x, y);
      continue;
    }
    for (int row = lane_id() / kCoarse; row < kCoarse; row += kWarp / kCoarse)
      draw_pixel(d, x + lane_id() % kCoarse, y + row);
  }
}

__global__ void __launch_bounds__(kThreads)
    descend_pairs(const __grid_constant__ Frame f, const __grid_constant__ PairQueue q, bool early_z, bool separate) {
  let_next_begin();
  wait_for_previous();
  each_pair(q, [&](const Record& r, int bin_x, int bin_y) {
    Descent d;
    if (lane_id() == 0) {
      count_work(f, Counter::bins_tested, 1);
      count_work(f, Counter::edges_64, 3);
    }
    if (!narrow_edges(r, bin_x, bin_y, d.edge)) return;
    const int left = bin_x * kBin, top = bin_y * kBin;
    d.frame = &f;
    d.pixels = f.packed + (int64_t)top * f.view.width + left;
    d.width = f.view.width;
    d.record = &r;
    d.plane = cell_plane(r, bin_x, bin_y);
    d.x0 = max_of(r.x0 - left, 0), d.y0 = max_of(r.y0 - top, 0);
    d.x1 = min_of(r.x1 - left, kBin), d.y1 = min_of(r.y1 - top, kBin);
    d.bin_x = bin_x, d.bin_y = bin_y;
    d.nearest = pack_depth(r.zmin, 0);
    d.early_z = early_z, d.separate = separate;
    descend(d);
  });
}

PairQueue take(Scratch* scratch, const Frame& f, const Values& v) { return take_pairs(scratch, f, v.queue, v.search); }

cudaError_t draw_view(const Frame& f, const Values& v, const PairQueue& q, cudaStream_t stream) {
  BIGTRI_CUDA(launch_clear(f, q.set_up.projected, q.zeros(), stream));
  if (f.count > 0) {
    int blocks;
    BIGTRI_CUDA(launch_set_up(f, q, v.search, stream));
    BIGTRI_CUDA(blocks_for(descend_pairs, kThreads, 0, INT32_MAX, v.blocks, &blocks));
    BIGTRI_CUDA(launch_next(descend_pairs, blocks, kThreads, 0, stream, f, q, v.early_z != 0, v.separate != 0));
  }
  return launch_depth(f, v.blocks, stream);
}

using Drawn = ViewByView<Values, take, draw_view>;

}  // namespace

extern const CudaVariant recursive_descent_variant;
const CudaVariant recursive_descent_variant = {
    "recursive_descent", "a warp a bin of a record, 64 to 16 to 4 px by corner masks, atomics: Abrash, for Larrabee",
    kParameters, Drawn::scratch_bytes, Drawn::draw};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

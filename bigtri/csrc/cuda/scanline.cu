// The scanline variant: a thread takes a triangle, and cuts each row of its bounding box to the exact span of pixels,
// each of which gets an atomic minimum. What is usually tried first (Sui's first pipeline): a large triangle keeps one
// thread busy while the other 31 of its warp wait.

#include "../core/scanline.h"
#include "clear.h"
#include "counting.cuh"
#include "depth_image.h"
#include "fragment.cuh"
#include "parameters.h"
#include "primitives.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

#define BIGTRI_LIST(X) BIGTRI_THREADS_PARAMETER(X)
BIGTRI_PARAMETERS(BIGTRI_LIST)

// Pixels [begin, end) of row y, in one cell.
__device__ __forceinline__ void draw_span(const Frame& f, const Record& r, int begin, int end, int y) {
  const CellPlane plane = cell_plane(r, begin / kBin, y / kBin);
  const double row = plane_row<double>(plane.zcell, plane.dzdy, y % kBin);
  int64_t* const to = f.packed + (int64_t)y * f.view.width;
  for (int x = begin; x < end; ++x) {
    const float z = r.flags & kRecordThin
                        ? thin_depth(&r, x, y)
                        : finish_depth(row + plane_column<double>(plane.dzdx, x % kBin), r.zmin, r.zmax);
    keep_nearest(to + x, pack_fragment(z, r.triangle), false);
  }
}

// triangle: of the frame's list. Called twice, and compiled once.
__device__ __noinline__ void draw_primitive(const Frame& f, const Primitive& p, int64_t triangle) {
  Record r;
  fill_record(p, f.first_triangle + triangle, &r);
  count_work(f, Counter::records, 1);
  count_work(f, Counter::by_rows, 1);
  count_work(f, Counter::rows, r.y1 - r.y0);
  for (int y = r.y0; y < r.y1; ++y) {
    int64_t lower = 0, upper = r.x1 - r.x0;
    for (int k = 0; k < 3; ++k) {
      const Edge e = edge_of(r.x, r.y, k);
      cut_span(edge_steps(e, r.x0, y), -e.dy, &lower, &upper);
    }
    const int end = r.x0 + (int)upper;
    count_work(f, Counter::fragments, max_of<int64_t>(upper - lower, 0));
    for (int x = r.x0 + (int)lower; x < end; x = (x | (kBin - 1)) + 1)
      draw_span(f, r, x, min_of(end, (x | (kBin - 1)) + 1), y);
  }
}

__global__ void __launch_bounds__(kMostThreads) draw_triangles(const __grid_constant__ Frame f) {
  extern __shared__ __align__(16) char memory[];
  let_next_begin();
  wait_for_previous();
  const int64_t first = (int64_t)blockIdx.x * blockDim.x + this_warp() * kWarp;
  ClipScratch* const clip = reinterpret_cast<ClipScratch*>(memory) + this_warp();
  Primitive p;
  const Fate fate = set_up_lanes(f, first, (int)min_of<int64_t>(kWarp, f.count - first), &p);
  if (fate == Fate::kWhole) draw_primitive(f, p, first + lane_id());
  for (unsigned todo = __ballot_sync(kAllLanes, fate == Fate::kClip); todo; todo &= todo - 1) {
    const int64_t triangle = first + __ffs(todo) - 1;
    if (clip_lanes(f, triangle, clip, &p)) draw_primitive(f, p, triangle);
  }
}

cudaError_t draw_view(const Frame& f, const Values& v, Nothing, cudaStream_t stream) {
  BIGTRI_CUDA(launch_clear(f, nullptr, {}, stream));
  if (f.count > 0)
    BIGTRI_CUDA(launch_next(draw_triangles, grid_blocks(f.count, v.threads), (int)v.threads,
                            v.threads / kWarp * (int64_t)sizeof(ClipScratch), stream, f));
  return launch_depth(f, 0, stream);
}

using Drawn = ViewByView<Values, take_nothing<Values>, draw_view>;

}  // namespace

extern const CudaVariant scanline_variant;
const CudaVariant scanline_variant = {"scanline", "a thread a triangle, row by row, with atomics: Sui's first pipeline",
                                      kParameters, Drawn::scratch_bytes, Drawn::draw};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

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

#define BIGTRI_LIST(X) BIGTRI_THREADS_PARAMETER(X) BIGTRI_SEARCH_PARAMETER(X)
BIGTRI_PARAMETERS(BIGTRI_LIST)

// Pixels [begin, end) of row y, in one cell.
__device__ __forceinline__ void draw_span(const Frame& f, const Record& r, int begin, int end, int y) {
  const CellPlane plane = cell_plane(r, begin / kBin, y / kBin);
  const double row = plane_row<double>(plane.zcell, plane.dzdy, y % kBin);
  int64_t* const to = f.packed + (int64_t)y * f.view.width;
  for (int x = begin; x < end; ++x) {
    count_fragment(f, x, y);
    const float z = r.flags & kRecordThin
                        ? thin_depth(&r, x, y)
                        : finish_depth(row + plane_column<double>(plane.dzdx, x % kBin), r.zmin, r.zmax);
    keep_nearest_counted(f, to + x, pack_fragment(z, r.triangle));
  }
}

// triangle: of the frame's list. Called twice, and compiled once.
__device__ __noinline__ void draw_primitive(const Frame& f, const Primitive& p, int64_t triangle) {
  Record r;
  fill_record(p, f.first_triangle + triangle, &r);
  count_work(f, Counter::records, 1);
  count_work(f, Counter::by_rows, 1);
  count_work(f, Counter::rows, r.y1 - r.y0);
  count_work(f, Counter::edges_64, 3 * (int64_t)(r.y1 - r.y0));
  for (int y = r.y0; y < r.y1; ++y) {
    int64_t lower = 0, upper = r.x1 - r.x0;
    for (int k = 0; k < 3; ++k) {
      const Edge e = edge_of(r.x, r.y, k);
      cut_span(edge_steps(e, r.x0, y), -e.dy, &lower, &upper);
    }
    const int end = r.x0 + (int)upper;
    for (int x = r.x0 + (int)lower; x < end; x = (x | (kBin - 1)) + 1)
      draw_span(f, r, x, min_of(end, (x | (kBin - 1)) + 1), y);
  }
}

// Shared memory of a warp.
struct Own {
  Search search;
  ClipScratch clip;
};

__global__ void __launch_bounds__(kMostThreads)
    draw_triangles(const __grid_constant__ Frame f, const __grid_constant__ SetUp how) {
  extern __shared__ __align__(16) char memory[];
  let_next_begin();
  Own* const own = reinterpret_cast<Own*>(memory) + this_warp();
  const int64_t first = ((int64_t)blockIdx.x * (blockDim.x / kWarp) + this_warp()) * how.each;
  if (first >= f.count) return wait_for_previous();
  const int32_t end = (int32_t)min_of<int64_t>(first + how.each, f.count);
  each_primitive(f, how, (int32_t)first, end, &own->search, &own->clip, [&](bool have, const Primitive& p, int32_t t) {
    if (have) draw_primitive(f, p, t);
    __syncwarp();
  });
}

SetUp take(Scratch* scratch, const Frame& f, const Values& v) { return take_set_up(scratch, f, v.search); }

cudaError_t draw_view(const Frame& f, const Values& v, SetUp how, cudaStream_t stream) {
  BIGTRI_CUDA(launch_clear(f, how.projected, {}, stream));
  if (f.count > 0) {
    const int64_t warps = v.threads / kWarp, shared_bytes = warps * (int64_t)sizeof(Own);
    BIGTRI_CUDA(choose_each(f, v.search, kWarp, &how));
    BIGTRI_CUDA(allow_shared(reinterpret_cast<const void*>(draw_triangles), shared_bytes));
    BIGTRI_CUDA(launch_next(draw_triangles, grid_blocks(f.count, warps * how.each), (int)v.threads, shared_bytes,
                            stream, f, how));
  }
  return launch_depth(f, 0, stream);
}

using Drawn = ViewByView<Values, take, draw_view>;

}  // namespace

extern const CudaVariant scanline_variant;
const CudaVariant scanline_variant = {"scanline", "a thread a triangle, row by row, with atomics: Sui's first pipeline",
                                      kParameters, Drawn::scratch_bytes, Drawn::draw};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// The two-stage variant: set-up puts the pairs of (large record, bin) into one global queue; then warps take them,
// first come, first served, make the 64-bit masks of the bin's tiles, and draw the tiles with an atomic minimum a
// fragment, the pixel read first. Small triangles are drawn at set-up, by rows, or where the caller or the rung has it
// so, wait like the others.

#include "clear.h"
#include "depth_image.h"
#include "pairs.cuh"
#include "parameters.h"
#include "queued.cuh"
#include "share.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

#define BIGTRI_LIST(X)       \
  BIGTRI_BLOCKS_PARAMETER(X) \
  BIGTRI_QUEUE_PARAMETER(X)  \
  BIGTRI_WIDEST_PARAMETER(X) \
  BIGTRI_SHARE_PARAMETER(X)  \
  BIGTRI_ROWS_PARAMETER(X)
BIGTRI_PARAMETERS(BIGTRI_LIST)

// Rows rest on what bin_owned rests on: edges in int32 over a bounding box, and the planes of core/depth.h.
constexpr bool kHasRows = Rung::kBinOwned;
static_assert(!kHasRows || (!kFloatCoverage && !Rung::kWideEdges && !Rung::kWraps),
              "what is drawn by rows has the rung's bits");

// What `share` says, as the parameter `search` of variants whose warps set up by themselves.
int64_t search_of(const Values& v) { return v.share == 0 ? 0 : v.share == kOfTested ? kSearched : kWarp; }

PairQueue take(Scratch* scratch, const Frame& f, const Values& v) {
  return take_pairs(scratch, f, v.queue, search_of(v));
}

constexpr int kThreads = 256;

template <Way kWay>
__global__ void __launch_bounds__(block_threads(kWay), blocks_held(kWay))
    set_up_and_enqueue(const __grid_constant__ Frame f, const __grid_constant__ PairQueue q,
                       const __grid_constant__ Sharing s, const __grid_constant__ RowLimits limits) {
  __shared__ ShareShared<kWay> shared;
  let_next_begin();
  draw_share<kWay>(f, s, q.set_up.projected, limits, &shared,
                   [&](int32_t, const Record* records, int count) { queue_or_draw(f, q, records, count); });
}

__global__ void __launch_bounds__(kThreads)
    draw_pairs(const __grid_constant__ Frame f, const __grid_constant__ PairQueue q) {
  let_next_begin();
  wait_for_previous();
  each_pair(q, [&](const Record& r, int bin_x, int bin_y) {
    warp_draw_bin(frame_pixel(f, f.packed), f.view.width, r, bin_x, bin_y);
  });
}

// The clear, and the kernel that draws what fits by rows.
template <bool kRows>
cudaError_t launch_rows(const Frame& f, const Values& v, PairQueue q, cudaStream_t stream) {
  if constexpr (kRows) {
    Sharing sharing;
    int64_t blocks;
    BIGTRI_CUDA(share_triangles(set_up_and_enqueue<Way::kEven>, f, q.set_up.projected, v.share, 1, nullptr, &sharing,
                                &blocks, stream));
    const Way way = sharing.way;
    if (together(way)) q.set_up.projected = nullptr;  // blocks project corners while the image is cleared
    BIGTRI_CUDA(launch_clear(f, q.set_up.projected, q.zeros(), stream));
    if (f.count > 0)
      BIGTRI_CUDA(with_way(way, [&](auto of) {
        return launch_next(set_up_and_enqueue<of.value>, blocks, block_threads(of.value), 0, stream, f, q, sharing,
                           RowLimits{widest_rows(f, sharing, v.widest), 0, 0, nullptr, nullptr});
      }));
  }
  return cudaSuccess;
}

// kRows: whether the rung has the kernels that draw by rows.
template <bool kRows>
cudaError_t draw_view(const Frame& f, const Values& v, const PairQueue& q, cudaStream_t stream) {
  if (kRows && v.rows) {
    BIGTRI_CUDA(launch_rows<kRows>(f, v, q, stream));
  } else {
    BIGTRI_CUDA(launch_clear(f, q.set_up.projected, q.zeros(), stream));
    if (f.count > 0) BIGTRI_CUDA(launch_set_up(f, q, search_of(v), stream));
  }
  if (f.count > 0) {
    int blocks;
    BIGTRI_CUDA(blocks_for(draw_pairs, kThreads, 0, INT32_MAX, v.blocks, &blocks));
    BIGTRI_CUDA(launch_next(draw_pairs, blocks, kThreads, 0, stream, f, q));
  }
  return launch_depth(f, v.blocks, stream);
}

using Drawn = ViewByView<Values, take, draw_view<kHasRows>>;

}  // namespace

extern const CudaVariant two_stage_variant;
const CudaVariant two_stage_variant = {
    "two_stage",
    "two stages with one global queue of (record, bin) pairs between them, atomics: another project's; docs/cuda.md",
    kParameters, Drawn::scratch_bytes, Drawn::draw};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

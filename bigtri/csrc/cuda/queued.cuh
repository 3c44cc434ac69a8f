// The set-up kernel of the variants that draw nothing at set-up: all records go to a queue of the variant's own.
#pragma once

#include "share.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// Queue: of the variant, with a function queue_or_draw(frame, queue, records, their number), which all lanes of a warp
// call, and which may draw with atomics on the cleared image.
template <class Queue>
__global__ void __launch_bounds__(block_threads(Way::kQueued), blocks_held(Way::kQueued))
    set_up_and_queue(const __grid_constant__ Frame f, const __grid_constant__ Queue q,
                     const __grid_constant__ Sharing s) {
  __shared__ ShareShared<Way::kQueued> shared;
  let_next_begin();
  draw_share<Way::kQueued>(f, s, nullptr, 0, &shared,
                           [&](int32_t, const Record* records, int count) { queue_or_draw(f, q, records, count); });
}

// Behind launch_clear.
template <class Queue>
cudaError_t launch_set_up(const Frame& f, const Queue& q, cudaStream_t stream) {
  Sharing sharing;
  int64_t blocks;
  BIGTRI_CUDA(share_queued(set_up_and_queue<Queue>, f, 0, &sharing, &blocks));
  return launch_next(set_up_and_queue<Queue>, blocks, block_threads(Way::kQueued), 0, stream, f, q, sharing);
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// The set-up kernel of the variants that draw nothing at set-up: all records go to a queue of the variant's own.
#pragma once

#include "primitives.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr int kQueuingWarps = 4;  // of a block; few, so that its place is soon free for the next one

// Shared memory of a warp.
struct QueuingShared {
  Search search;
  union {
    ClipScratch clip;
    Record records[kWarp];
  };
  __device__ QueuingShared() {}
};

// Queue: of the variant, with a SetUp `set_up`, and a function queue_or_draw(frame, queue, records, their number), which
// all lanes of a warp call, and which may draw with atomics on the cleared image.
template <class Queue>
__global__ void __launch_bounds__(kQueuingWarps* kWarp, 32 / kQueuingWarps)
    set_up_and_queue(const __grid_constant__ Frame f, const __grid_constant__ Queue q) {
  __shared__ QueuingShared shared[kQueuingWarps];
  let_next_begin();
  QueuingShared* const s = &shared[this_warp()];
  const int64_t first = ((int64_t)blockIdx.x * kQueuingWarps + this_warp()) * q.set_up.each;
  if (first >= f.count) return wait_for_previous();
  const int32_t end = (int32_t)min_of<int64_t>(first + q.set_up.each, f.count);
  each_primitive(f, q.set_up, (int32_t)first, end, &s->search, &s->clip, [&](bool have, const Primitive& p, int32_t t) {
    const int count = put_records(have, p, f.first_triangle + t, s->records);
    __syncwarp();
    if (count > 0) queue_or_draw(f, q, s->records, count);
  });
}

// Launches it behind launch_clear, which has projected the vertices if there is memory for them.
template <class Queue>
cudaError_t launch_set_up(const Frame& f, Queue q, int64_t search, cudaStream_t stream) {
  int resident;
  BIGTRI_CUDA(
      resident_blocks(reinterpret_cast<const void*>(set_up_and_queue<Queue>), kQueuingWarps * kWarp, 0, &resident));
  BIGTRI_CUDA(choose_each(f, search, untested_each(f, (int64_t)resident * kQueuingWarps), &q.set_up));
  return launch_next(set_up_and_queue<Queue>, grid_blocks(f.count, kQueuingWarps * q.set_up.each),
                     kQueuingWarps * kWarp, 0, stream, f, q);
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

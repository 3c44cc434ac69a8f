// Pixels of clipped triangles for which begin_frame had no memory.
#pragma once

#include "shade_pixels.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// The pixels that are left. A warp clips a triangle that it meets, for the pixels of it that lie side by side.
__global__ void __launch_bounds__(kShadeThreads, 4)
    shade_left(const __grid_constant__ Shading job, const __grid_constant__ Work work) {
  __shared__ ClipScratch scratch[kShadeWarps];
  __shared__ ClippedTriangle clipped[kShadeWarps];
  wait_for_previous();
  if (*work.any_left == 0) return;
  ClippedTriangle* held = clipped + this_warp();
  uint32_t held_view = ~0u;
  int32_t held_triangle = -1;
  const uint32_t words = word_count(work);
  for (uint32_t w = blockIdx.x * kShadeWarps + this_warp(); w < words; w += gridDim.x * kShadeWarps) {
    Place at;
    uint32_t row;
    int32_t triangle;
    if (!look_at_word(job, work, w, &at, &row, &triangle)) continue;
    const uint32_t i = row * job.width + at.x;
    const bool wanted =
        triangle >= 0 && work.place[work.first_item + (int64_t)at.view * job.count + triangle] == kNoPlace;
    bool drawn = false;
    for (unsigned waiting = __ballot_sync(kAllLanes, wanted); waiting;) {
      const uint32_t view = __shfl_sync(kAllLanes, at.view, __ffs(waiting) - 1);
      const int32_t next = __shfl_sync(kAllLanes, triangle, __ffs(waiting) - 1);
      if (view != held_view || next != held_triangle) {
        __syncwarp();  // all have read what is held
        clip(job, view, next, scratch + this_warp(), held);
        held_view = view;
        held_triangle = next;
      }
      const bool mine = triangle == next && at.view == view;
      if (mine) {
        Finished finished;
        drawn = held->count > 0;
        if (drawn) {
          float weight[3];
          weigh(job, *held, at.x, at.y, weight);
          finish(job.surface, work.lookups, SkinAtHand{held->skin}, weight, &finished);
        } else {
          finish_background(job, at.y, &finished);
        }
        store_beside(job, finished, i);
        if (job.image)
          store_pixel(job, i, drawn ? encoded(*work.lookups.codes, finished.linear) : work.background[row]);
      }
      waiting &= ~__ballot_sync(kAllLanes, mine);
    }
    const unsigned all = __ballot_sync(kAllLanes, drawn);
    if (work.drawn && lane_id() == 0) work.drawn[row * row_words(job) + at.x / kWarp] |= all;
  }
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

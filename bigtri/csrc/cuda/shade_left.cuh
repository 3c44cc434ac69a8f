// Pixels with samples of clipped triangles for which begin_frame had no memory.
#pragma once

#include "shade_words.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// A clipped triangle that a warp holds, for samples of it that lie side by side.
struct Held {
  uint32_t view;
  int32_t triangle;
  ClippedTriangle* clipped;
};

// Finishes the samples of triangles that found no memory, with all lanes; wanted: whether the lane's is one. The warp clips
// a triangle that it meets.
__device__ __forceinline__ Sample shade_clipped(const Shading& job, const Work& work, const Place& sample,
                                                int32_t triangle, bool wanted, ClipScratch* scratch, Held* held,
                                                Finished* out) {
  Sample found = Sample::kBackground;
  for (unsigned waiting = __ballot_sync(kAllLanes, wanted); waiting;) {
    const int32_t next = __shfl_sync(kAllLanes, triangle, __ffs(waiting) - 1);
    if (sample.view != held->view || next != held->triangle) {  // all samples of a warp are of one view
      __syncwarp();                                             // all have read what is held
      clip(job, sample.view, next, scratch, held->clipped);
      held->view = sample.view;
      held->triangle = next;
    }
    const bool mine = wanted && triangle == next;
    if (mine && held->clipped->count > 0) {
      float weight[3];
      weigh(job, *held->clipped, sample.x, sample.y, weight);
      finish(job.surface, work.lookups, SkinAtHand{held->clipped->skin}, weight, out);
      found = Sample::kDrawn;
    }
    waiting &= ~__ballot_sync(kAllLanes, mine);
  }
  return found;
}

// The pixels that are left, of which all samples are finished once more.
__global__ void __launch_bounds__(kShadeThreads, 16 / kShadeWarps)
    shade_left(const __grid_constant__ Shading job, const __grid_constant__ Work work) {
  __shared__ ClipScratch scratch[kShadeWarps];
  __shared__ ClippedTriangle clipped[kShadeWarps];
  wait_for_previous();
  if (*work.any_left == 0) return;
  Held held = {~0u, -1, clipped + this_warp()};
  const auto is_left = [&](uint32_t view, int32_t triangle) {
    return triangle >= 0 && work.place[work.first_item + (int64_t)view * job.count + triangle] == kNoPlace;
  };
  const bool listed = work.areas.list;
  const uint32_t words = listed ? word_count<true>(work) : word_count<false>(work);
  for (uint32_t w = blockIdx.x * kShadeWarps + this_warp(); w < words; w += gridDim.x * kShadeWarps) {
    const Place word = listed ? word_at<true>(work, w) : word_at<false>(work, w),
                at = {word.view, word.x + lane_id(), word.y};
    bool mine = false;
    if (at.x < (int)work.width.by && at.y < work.height)
      each_sample(job, at,
                  [&](const Place& sample) { mine |= is_left(at.view, triangle_of(job, number_of(job, sample))); });
    if (!__any_sync(kAllLanes, mine)) continue;
    Mean mean = {};
    each_sample(job, at, [&](const Place& place) {
      const uint32_t i = number_of(job, place);
      const int32_t triangle = mine ? triangle_of(job, i) : -1;
      const bool wanted = is_left(at.view, triangle);
      Finished finished;
      Sample sample = shade_clipped(job, work, place, triangle, wanted, scratch + this_warp(), &held, &finished);
      if (triangle >= 0 && !wanted) sample = shade_sample<false>(job, work, place, triangle, &finished);
      if (sample == Sample::kBackground) finish_background(job, place.y, &finished);
      mean.add(finished.linear, sample == Sample::kDrawn);
      if (mine) store_beside(job, finished, i);
    });
    if (mine) {
      const uint32_t pixel = (at.view * work.height + at.y) * work.width.by + at.x;
      store_pixel(job, pixel, mean.encoded(job, work.lookups.codes->encode));
    }
  }
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

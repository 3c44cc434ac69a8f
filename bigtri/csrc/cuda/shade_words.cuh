// Which words of a picture which warp finishes.
#pragma once

#include "shade_samples.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// A triangle of the lane's pixel, or -1. kSeveral: whether a pixel has several samples.
template <bool kSeveral>
__device__ __forceinline__ int32_t look_at(const Shading& job, const Work& work, const Place& at) {
  if constexpr (kSeveral)
    return look_at_samples(job, work, at);
  else
    return look_at_pixel(job, work, at);
}

// Finishes a word, with all lanes. at: the lane's pixel; triangle: what look_at said.
template <bool kSeveral, bool kPrepared>
__device__ __forceinline__ void finish_word(const Shading& job, const Work& work, const Place& at, int32_t triangle) {
  if constexpr (kSeveral)
    finish_samples<kPrepared>(job, work, at);
  else
    finish_pixels<kPrepared>(job, work, at, triangle);
}

// Of a warp that takes several words, two lie beside each other.
BIGTRI_HD constexpr int words_across(int words) { return words == 1 ? 1 : 2; }
BIGTRI_HD constexpr int rows_down(int words) { return words / words_across(words); }

// A whole picture. A warp takes kWords words, which it looks at together, and then goes through those that have a triangle;
// others take no longer than it takes to load them. The device shares out the warps: a word that a model covers takes ten
// times as long. A block's warps lie one below the other; the grid is as wide and as high as the picture, with a layer for
// each view, so that no warp divides to find its place.
template <bool kSeveral, bool kPrepared, int kWords>
__global__ void __launch_bounds__(kShadeThreads, shade_blocks(kPrepared))
    shade_all(const __grid_constant__ Shading job, const __grid_constant__ Work work) {
  static_assert(kWords == 1 || kWords % 2 == 0, "whole rows");
  wait_for_previous();
  const Place word = {blockIdx.z, (int)blockIdx.x * words_across(kWords) * kWarp,
                      ((int)blockIdx.y * kShadeWarps + this_warp()) * rows_down(kWords)};
  int32_t triangle[kWords];
#pragma unroll
  for (int j = 0; j < kWords; ++j) triangle[j] = look_at<kSeveral>(job, work, pixel_at(word, j));
  unsigned covered = 0;
#pragma unroll
  for (int j = 0; j < kWords; ++j) {
    const Place at = pixel_at(word, j);
    if (!begins_in_picture(work, at)) continue;
    if (work.beside || __any_sync(kAllLanes, triangle[j] >= 0))
      covered |= 1u << j;
    else
      store_word_at(job, work, at, work.background[row_of(work, at)]);
  }
  if constexpr (kWords == 1) {
    if (covered) finish_word<kSeveral, kPrepared>(job, work, pixel_at(word, 0), triangle[0]);
  } else {
    __shared__ int32_t looked[kShadeWarps][kWords][kWarp];  // no register holds these while a word is finished
    int32_t (*const own)[kWarp] = looked[this_warp()];
#pragma unroll
    for (int j = 0; j < kWords; ++j) own[j][lane_id()] = triangle[j];
#pragma unroll 1
    for (; covered; covered &= covered - 1) {
      const int j = __ffs(covered) - 1;
      finish_word<kSeveral, kPrepared>(job, work, pixel_at(word, j), own[j][lane_id()]);
    }
  }
}

// The areas that are listed, of prepared triangles and a picture that has its background already. Nearly all of their
// words have a triangle, so that warps may take them in turn.
template <bool kSeveral>
__global__ void __launch_bounds__(kShadeThreads, shade_blocks(!kSeveral))
    shade_listed(const __grid_constant__ Shading job, const __grid_constant__ Work work) {
  __shared__ uint32_t numbers[kShadeWarps];  // of the warps' words: no register holds them while a word is finished
  wait_for_previous();
  uint32_t number = blockIdx.x * kShadeWarps + this_warp();
#pragma unroll 1
  while (number < word_count<true>(work)) {
    const Place at = pixel_at(word_at<true>(work, number), 0);
    const int32_t triangle = look_at<kSeveral>(job, work, at);
    __syncwarp();
    if (lane_id() == 0) numbers[this_warp()] = number;
    __syncwarp();
    if (number + gridDim.x * kShadeWarps >= word_count<true>(work)) let_next_begin();  // this word is the warp's last
    if (__any_sync(kAllLanes, triangle >= 0)) finish_word<kSeveral, true>(job, work, at, triangle);
    number = reread(numbers[this_warp()]) + gridDim.x * kShadeWarps;
  }
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

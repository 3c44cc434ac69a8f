// Which words of a picture which warp finishes.
#pragma once

#include "shade_samples.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// Word number i of the areas, with all lanes: where the lane's pixel lies, its row among those of all views, and a
// triangle of it, or -1. kSeveral: whether a pixel has several samples. False where none of the word lies in the picture.
template <bool kSeveral>
__device__ __forceinline__ bool look_at_word(const Shading& job, const Work& work, uint32_t i, Place* at, uint32_t* row,
                                             int32_t* triangle) {
  const Place word = word_at(work, i);
  const int width = (int)work.width.by;
  *at = {word.view, word.x + lane_id(), word.y};
  *row = word.view * work.height + word.y;
  const bool within = word.x < width && word.y < work.height;
  *triangle = -1;
  if (within && at->x < width) {
    if constexpr (kSeveral)
      *triangle = look_at_samples(job, *at);
    else
      *triangle = look_at_pixel(job, work, *row, at->x);
  }
  return within;
}

// Finishes it, with all lanes.
template <bool kSeveral, bool kPrepared>
__device__ __forceinline__ void finish_word(const Shading& job, const Work& work, const Place& at, uint32_t row,
                                            int32_t triangle) {
  if constexpr (kSeveral)
    finish_samples<kPrepared>(job, work, at, row);
  else
    finish_pixels<kPrepared>(job, work, at, row, triangle);
}

// All areas. A warp takes kWords words, which it looks at together, and then goes through those that have a triangle;
// others take no longer than it takes to load them. The device shares out the warps: a word that a model covers takes ten
// times as long.
template <bool kSeveral, bool kPrepared, int kWords>
__global__ void __launch_bounds__(kShadeThreads, 8)
    shade_all(const __grid_constant__ Shading job, const __grid_constant__ Work work) {
  wait_for_previous();
  const uint32_t start = (blockIdx.x * kShadeWarps + this_warp()) * kWords;
  if (start >= word_count(work)) return;
  Place at;
  uint32_t row;
  int32_t triangle;
  unsigned covered = 0;
#pragma unroll
  for (int j = 0; j < kWords; ++j) {
    if (!look_at_word<kSeveral>(job, work, start + j, &at, &row, &triangle)) continue;
    if (work.beside || __any_sync(kAllLanes, triangle >= 0))
      covered |= 1u << j;
    else
      store_word_at(job, work, at, row, work.background[row]);
  }
  if constexpr (kWords == 1) {
    if (covered) finish_word<kSeveral, kPrepared>(job, work, at, row, triangle);
  } else {
#pragma unroll 1
    for (; covered; covered &= covered - 1) {
      look_at_word<kSeveral>(job, work, start + __ffs(covered) - 1, &at, &row, &triangle);
      finish_word<kSeveral, kPrepared>(job, work, at, row, triangle);
    }
  }
}

// The areas that are listed, of prepared triangles and a picture that has its background already. Nearly all of their
// words have a triangle, so that warps may take them in turn.
template <bool kSeveral>
__global__ void __launch_bounds__(kShadeThreads, 8)
    shade_listed(const __grid_constant__ Shading job, const __grid_constant__ Work work) {
  __shared__ uint32_t numbers[kShadeWarps];  // of the warps' words: no register holds them while a word is finished
  wait_for_previous();
  uint32_t number = blockIdx.x * kShadeWarps + this_warp();
#pragma unroll 1
  while (number < word_count(work)) {
    Place at;
    uint32_t row;
    int32_t triangle;
    look_at_word<kSeveral>(job, work, number, &at, &row, &triangle);
    __syncwarp();
    if (lane_id() == 0) numbers[this_warp()] = number;
    __syncwarp();
    if (number + gridDim.x * kShadeWarps >= word_count(work)) let_next_begin();  // this word is the warp's last
    if (__any_sync(kAllLanes, triangle >= 0)) finish_word<kSeveral, true>(job, work, at, row, triangle);
    number = reread(numbers[this_warp()]) + gridDim.x * kShadeWarps;
  }
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

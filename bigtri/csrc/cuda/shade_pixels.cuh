// The pixels of the shading pass, a lane each; docs/numerics.md 18.
#pragma once

#include "shade_work.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// The triangle of a pixel of the buffer; -1: background, or none of the triangles.
__device__ __forceinline__ int32_t triangle_of(const Shading& job, uint32_t pixel) {
  const uint32_t triangle = reinterpret_cast<const uint32_t*>(job.packed)[2 * (int64_t)pixel];  // the lower half
  return triangle < (uint32_t)job.count ? (int32_t)triangle : -1;
}

// A triangle that has been clipped; null if there was no memory for it.
__device__ __forceinline__ const ClippedTriangle* clipped_of(const Work& work, int64_t item) {
  const int place = work.place[item];
  return place == kNoPlace ? nullptr : work.clipped + item / kBeginThreads * work.places + place;
}

enum class Pixel { kBackground, kDrawn, kLeft };

// Finishes a pixel that lies at a place of the buffer and has a triangle.
template <bool kPrepared>
__device__ __forceinline__ Pixel shade_pixel(const Shading& job, const Work& work, const Place& at, int32_t triangle,
                                             Finished* out) {
  // Of a prepared one: these have many pixels each, so that the number of those of a launch fits 32 bits.
  [[maybe_unused]] const uint32_t number = at.view * (uint32_t)job.count + (uint32_t)triangle;
  WholeTriangle whole;
  int32_t vertex[3];
  bool back;
  if constexpr (kPrepared)
    whole = loaded(&work.prepared[number].whole);
  else
    set_up_whole(job, at.view, triangle, work.projected ? work.projected + at.view * job.vertices : nullptr, &whole,
                 vertex, &back);
  float weight[3];
  if (whole.fate == Fate::kWhole) {
    weigh(job, whole, at.x, at.y, weight);
    if constexpr (kPrepared) {
      finish(job.surface, work.lookups, SkinInMemory{&work.prepared[number].skin}, weight, out);
    } else {
      Skin skin;
      if (!load_skin(job, triangle, vertex, back, &skin)) return Pixel::kBackground;
      finish(job.surface, work.lookups, SkinAtHand{skin}, weight, out);
    }
  } else if (whole.fate == Fate::kClip) {
    const ClippedTriangle* clipped = clipped_of(work, work.first_item + (int64_t)at.view * job.count + triangle);
    if (!clipped) return Pixel::kLeft;
    if (clipped->count == 0) return Pixel::kBackground;
    weigh(job, *clipped, at.x, at.y, weight);
    finish(job.surface, work.lookups, SkinInMemory{&clipped->skin}, weight, out);
  } else {
    return Pixel::kBackground;
  }
  return Pixel::kDrawn;
}

__device__ __forceinline__ void store_pixel(const Shading& job, uint32_t i, uint32_t color) {
  for (int c = 0; c < job.channels; ++c) job.image[(int64_t)i * job.channels + c] = (uint8_t)(color >> (8 * c));
}

// Stores the colours of a word of the picture, of so many pixels from pixel `first` on, with all lanes.
__device__ __forceinline__ void store_word(const Shading& job, uint32_t first, int pixels, uint32_t color) {
  const int lane = lane_id();
  uint8_t* const bytes = job.image + (int64_t)first * job.channels;
  if (pixels >= kWarp && ((uintptr_t)bytes & 3) == 0) {
    uint32_t* to = reinterpret_cast<uint32_t*>(bytes);
    if (job.channels == 4) {
      to[lane] = color;
    } else {  // the word's 96 bytes, four a lane
      const int from = 4 * lane / 3, skipped = 8 * (4 * lane - 3 * from);
      const uint32_t low = __shfl_sync(kAllLanes, color, from & (kWarp - 1)) & 0xffffff,
                     high = __shfl_sync(kAllLanes, color, (from + 1) & (kWarp - 1));
      if (lane < 3 * kWarp / 4) to[lane] = low >> skipped | high << (24 - skipped);
    }
  } else if (lane < pixels) {
    store_pixel(job, first + lane, color);
  }
}

// Word number i of the areas, with all lanes: where the lane's pixel lies, its row among those of all views, and its
// triangle, or -1. False where none of the word lies in the image.
__device__ __forceinline__ bool look_at_word(const Shading& job, const Work& work, uint32_t i, Place* at, uint32_t* row,
                                             int32_t* triangle) {
  const Place word = word_at(work, i);
  *at = {word.view, word.x + lane_id(), word.y};
  *row = word.view * job.height + word.y;
  const bool within = word.x < job.width && word.y < job.height;
  *triangle = within && at->x < job.width ? triangle_of(job, *row * job.width + at->x) : -1;
  return within;
}

// Stores a word of the picture, with all lanes; at: the lane's pixel.
__device__ __forceinline__ void store_word_at(const Shading& job, const Place& at, uint32_t row, uint32_t color) {
  const int x = at.x - lane_id();
  store_word(job, row * job.width + x, job.width - x, color);
}

// Finishes a word, with all lanes.
template <bool kPrepared>
__device__ __forceinline__ void finish_word(const Shading& job, const Work& work, const Place& at, uint32_t row,
                                            int32_t triangle) {
  Pixel pixel = Pixel::kBackground;
  Finished finished;
  uint32_t color = work.background ? work.background[row] : 0;
  if (triangle >= 0) {
    pixel = shade_pixel<kPrepared>(job, work, at, triangle, &finished);
    if (pixel == Pixel::kDrawn && job.image) color = encoded(*work.lookups.codes, finished.linear);
    if (pixel == Pixel::kLeft) *work.any_left = 1;
  }
  if (work.beside) {
    if (pixel == Pixel::kBackground) finish_background(job, at.y, &finished);
    if (pixel != Pixel::kLeft && at.x < job.width) store_beside(job, finished, row * job.width + at.x);
    const unsigned drawn = __ballot_sync(kAllLanes, pixel == Pixel::kDrawn);
    if (work.drawn && lane_id() == 0) work.drawn[row * row_words(job) + at.x / kWarp] = drawn;
  }
  if (job.image) store_word_at(job, at, row, color);
}

// All areas. A warp takes kWords words, which it looks at together, and then goes through those that have a triangle;
// others take no longer than it takes to load them. The device shares out the warps: a word that a model covers takes ten
// times as long.
template <bool kPrepared, int kWords>
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
    if (!look_at_word(job, work, start + j, &at, &row, &triangle)) continue;
    if (work.beside || __any_sync(kAllLanes, triangle >= 0))
      covered |= 1u << j;
    else
      store_word_at(job, at, row, work.background[row]);
  }
  if constexpr (kWords == 1) {
    if (covered) finish_word<kPrepared>(job, work, at, row, triangle);
  } else {
#pragma unroll 1
    for (; covered; covered &= covered - 1) {
      look_at_word(job, work, start + __ffs(covered) - 1, &at, &row, &triangle);
      finish_word<kPrepared>(job, work, at, row, triangle);
    }
  }
}

// The areas that are listed, of prepared triangles and a picture that has its background already. Nearly all of their
// words have a triangle, so that warps may take them in turn.
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
    look_at_word(job, work, number, &at, &row, &triangle);
    __syncwarp();
    if (lane_id() == 0) numbers[this_warp()] = number;
    __syncwarp();
    if (number + gridDim.x * kShadeWarps >= word_count(work)) let_next_begin();  // this word is the warp's last
    if (__any_sync(kAllLanes, triangle >= 0)) finish_word<true>(job, work, at, row, triangle);
    number = reread(numbers[this_warp()]) + gridDim.x * kShadeWarps;
  }
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

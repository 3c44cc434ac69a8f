// Pixels of the shading pass, a lane each; docs/numerics.md 18.
#pragma once

#include "shade_work.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// The triangle of a sample of the buffer; -1: background, or none of the triangles.
__device__ __forceinline__ int32_t triangle_of(const Shading& job, uint32_t sample) {
  const uint32_t triangle = reinterpret_cast<const uint32_t*>(job.packed)[2 * (int64_t)sample];  // the lower half
  return triangle < (uint32_t)job.count ? (int32_t)triangle : -1;
}

// A triangle that has been clipped, and was not prepared; null if there was no memory for it.
__device__ __forceinline__ const ClippedTriangle* clipped_of(const Work& work, int64_t item) {
  const int place = work.place[item];
  return place == kNoPlace ? nullptr : work.clipped + item / kBeginThreads * work.places + place;
}

enum class Sample { kBackground, kDrawn, kLeft };

// Finishes a sample that lies at a place of the buffer and has a triangle. Whole or clipped, there is one place where it
// is finished, so that lanes that have the one and lanes that have the other go through that together.
template <bool kPrepared>
__device__ __forceinline__ Sample shade_sample(const Shading& job, const Work& work, const Place& at, int32_t triangle,
                                               Finished* out) {
  // Of a prepared one: these have many pixels each, so that the number of those of a launch fits 32 bits.
  [[maybe_unused]] const uint32_t number = at.view * (uint32_t)job.count + (uint32_t)triangle;
  // Set on every path: else registers hold them from one sample to the next.
  PixelTriangle whole = {};
  int32_t vertex[3] = {};
  bool back = false;
  if constexpr (kPrepared)
    whole = loaded(&work.prepared[number].whole);
  else
    set_up_whole(job, at.view, triangle, work.projected ? work.projected + at.view * job.vertices : nullptr, &whole,
                 vertex, &back);
  float weight[3];
  const ClippedTriangle* clipped = nullptr;
  if (whole.fate == Fate::kWhole) {
    weigh(job, at.view, triangle, whole, at.x, at.y, weight);
  } else if (whole.fate == Fate::kClip) {
    if constexpr (kPrepared)
      clipped = whole.clipped < 0 ? nullptr : work.clipped + (uint32_t)whole.clipped;
    else
      clipped = clipped_of(work, work.first_item + (int64_t)at.view * job.count + triangle);
    if (!clipped) return Sample::kLeft;
    if (clipped->count == 0) return Sample::kBackground;
    weigh(job, *clipped, at.x, at.y, weight);
  } else {
    return Sample::kBackground;
  }
  if constexpr (kPrepared) {
    const SkinInMemory skin = {clipped ? &clipped->skin : &work.prepared[number].skin};
    finish(job.surface, work.lookups, skin, weight, out);
  } else {
    Skin skin = {};
    if (clipped)
      skin = clipped->skin;
    else if (!load_skin(job, triangle, vertex, back, &skin))
      return Sample::kBackground;
    finish(job.surface, work.lookups, SkinAtHand{skin}, weight, out);
  }
  return Sample::kDrawn;
}

__device__ __forceinline__ void store_pixel(const Shading& job, uint32_t i, uint32_t color) {
  for (int c = 0; c < job.channels; ++c) job.image[i * (uint32_t)job.channels + c] = (uint8_t)(color >> (8 * c));
}

// Stores the colours of a word of the picture, of so many pixels from pixel `first` on, with all lanes.
__device__ __forceinline__ void store_word(const Shading& job, uint32_t first, int pixels, uint32_t color) {
  const int lane = lane_id();
  uint8_t* const bytes = job.image + first * (uint32_t)job.channels;
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

// Stores a word of the picture, with all lanes; at: the lane's pixel.
__device__ __forceinline__ void store_word_at(const Shading& job, const Work& work, const Place& at, uint32_t color) {
  const int x = at.x - lane_id(), width = (int)work.width.by;
  store_word(job, row_of(work, at) * width + x, width - x, color);
}

// What is looked at of a pixel before it is finished: its triangle, or -1. Without a branch, so that the loads of several
// pixels go together.
__device__ __forceinline__ int32_t look_at_pixel(const Shading& job, const Work& work, const Place& at) {
  const bool within = in_picture(work, at);
  const int32_t triangle = triangle_of(job, within ? row_of(work, at) * work.width.by + at.x : 0);
  return within ? triangle : -1;
}

// Finishes a word, with all lanes. triangle: what look_at_pixel said.
template <bool kPrepared>
__device__ __forceinline__ void finish_pixels(const Shading& job, const Work& work, const Place& at, int32_t triangle) {
  Sample sample = Sample::kBackground;
  Finished finished;
  if (triangle >= 0) {
    sample = shade_sample<kPrepared>(job, work, at, triangle, &finished);
    if (sample == Sample::kLeft) *work.any_left = 1;
  }
  if (work.beside) {
    if (sample == Sample::kBackground) finish_background(job, at.y, &finished);
    if (sample != Sample::kLeft && at.x < job.width) store_beside(job, finished, row_of(work, at) * job.width + at.x);
  }
  const uint32_t color =
      sample == Sample::kDrawn ? encoded(*work.lookups.codes, finished.linear) : work.background[row_of(work, at)];
  store_word_at(job, work, at, color);
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// Pixels of several samples, a lane each: it goes over its samples, keeps their sum, and stores the finished pixel;
// docs/numerics.md 18. A lane's sample lies beside those of its neighbours, so many columns away as a pixel has.
#pragma once

#include "shade_pixels.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// The number of a sample among those of all views.
__device__ __forceinline__ uint32_t number_of(const Shading& job, const Place& sample) {
  return (sample.view * job.height + sample.y) * job.width + sample.x;
}

// Calls each(sample) for all samples of a pixel, in the order in which they are added.
template <class Each>
__device__ __forceinline__ void each_sample(const Shading& job, const Place& pixel, const Each& each) {
  const int n = job.samples, left = pixel.x * n, top = pixel.y * n;
#pragma unroll 1
  for (int y = top; y < top + n; ++y)
#pragma unroll 1
    for (int x = left; x < left + n; ++x) each(Place{pixel.view, x, y});
}

// A triangle of those of a pixel, or -1 if it has none.
__device__ __forceinline__ int32_t look_at_samples(const Shading& job, const Work& work, const Place& pixel) {
  if (!in_picture(work, pixel)) return -1;
  const uint32_t first = number_of(job, {pixel.view, pixel.x * job.samples, pixel.y * job.samples});
  const auto look = [&](int n) {
    int32_t triangle = -1;
    for (int y = 0; y < n; ++y)
      for (int x = 0; x < n; ++x) triangle = max_of(triangle, triangle_of(job, first + y * job.width + x));
    return triangle;
  };
  return job.samples == 2 ? look(2) : look(job.samples);  // of four samples all loads go together
}

// Of a sample that shows the background.
__device__ __forceinline__ void finish_behind(const Work& work, int y, Finished* out) {
  const PackedColor light = loaded(work.light_behind + y);
  for (int c = 0; c < 3; ++c) out->albedo[c] = out->normal[c] = 0.0f, out->linear[c] = light.value[c];
}

// Finishes a word, with all lanes. A pixel that has a sample that is left is stored by shade_left.
template <bool kPrepared>
__device__ __forceinline__ void finish_samples(const Shading& job, const Work& work, const Place& at) {
  const bool within = at.x < (int)work.width.by;
  Mean mean = {};
  each_sample(job, at, [&](const Place& place) {
    const uint32_t i = number_of(job, place);
    const int32_t triangle = within ? triangle_of(job, i) : -1;
    Sample sample = Sample::kBackground;
    Finished finished = {};
    if (triangle >= 0) sample = shade_sample<kPrepared>(job, work, place, triangle, &finished);
    if (sample == Sample::kLeft) *work.any_left = 1;
    if (sample != Sample::kDrawn) finish_behind(work, place.y, &finished);
    mean.add(finished.linear, sample == Sample::kDrawn);
    if (work.beside && within) store_beside(job, finished, i);
    __syncwarp();  // else lanes that are through with a sample go on by themselves
  });
  store_word_at(job, work, at, mean.encoded(job, work.lookups.codes->encode));
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

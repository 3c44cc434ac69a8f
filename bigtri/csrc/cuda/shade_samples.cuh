// Several samples a pixel; docs/numerics.md 18.
#pragma once

#include "shade_pixels.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// The samples' mean, a thread a pixel.
__global__ void __launch_bounds__(kShadeThreads)
    add_samples(const __grid_constant__ Shading job, const Codes* __restrict__ codes, const float* __restrict__ linear,
                const uint32_t* __restrict__ drawn) {
  wait_for_previous();
  const int n = job.samples, width = job.width / n, height = job.height / n;
  const int64_t pixels = job.views * height * width;
  for (int64_t i = (int64_t)blockIdx.x * kShadeThreads + threadIdx.x; i < pixels;
       i += (int64_t)gridDim.x * kShadeThreads) {
    const int64_t row = i / width, column = i - row * width;
    float total[3] = {0.0f, 0.0f, 0.0f};
    int covered = 0;
    for (int y = 0; y < n; ++y)
      for (int x = 0; x < n; ++x) {
        const int64_t line = row * n + y, place = column * n + x, sample = line * job.width + place;
        for (int c = 0; c < 3; ++c) total[c] = total[c] + linear[3 * sample + c];
        covered += drawn[line * row_words(job) + place / kWarp] >> (place % kWarp) & 1;
      }
    store_mean(total, covered, n * n, job.channels, codes->encode, job.image + job.channels * i);
  }
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// Points to clip space on the GPU, a thread a point of a view.

#include "transform.h"

#include "../core/transform.h"
#include "launch.cuh"

namespace bigtri {
namespace {

constexpr int kThreads = 256;

__global__ void __launch_bounds__(kThreads)
    transform_points(const float* __restrict__ points, const double* __restrict__ matrices, int64_t count,
                     int64_t views, float* __restrict__ out) {
  const int64_t stride = (int64_t)gridDim.x * kThreads;
  for (int64_t i = (int64_t)blockIdx.x * kThreads + threadIdx.x; i < views * count; i += stride) {
    const int64_t view = i / count, point = i - view * count;
    float to[4];
    transform_point(matrices + 16 * view, points + 3 * point, to);
    if (((uintptr_t)out & 15) == 0)
      reinterpret_cast<float4*>(out)[i] = {to[0], to[1], to[2], to[3]};
    else
      for (int c = 0; c < 4; ++c) out[4 * i + c] = to[c];
  }
}

}  // namespace

cudaError_t transform_cuda(const float* points, const double* matrices, int64_t count, int64_t views, float* out,
                           cudaStream_t stream) {
  return launch_first(transform_points, grid_blocks(count * views, kThreads), kThreads, 0, stream, points, matrices,
                      count, views, out);
}

}  // namespace bigtri

// The depth image of a frame.

#include "depth_image.h"

#include "../core/visibility.h"
#include "launch.cuh"

namespace bigtri {
namespace {

// The depth image of a finished frame.
__global__ void write_depth(const __grid_constant__ Frame f) {
  wait_for_previous();
  const int64_t n = pixels_of_all(f), stride = (int64_t)gridDim.x * blockDim.x;
  for (int64_t i = (int64_t)blockIdx.x * blockDim.x + threadIdx.x; i < n; i += stride)
    f.depth[i] = depth_of(f.packed[i]);
}

}  // namespace

cudaError_t launch_depth(const Frame& f, int64_t blocks_wanted, cudaStream_t stream) {
  if (!f.depth) return cudaSuccess;
  int blocks;
  const int64_t pixels = pixels_of_all(f);
  BIGTRI_CUDA(blocks_for(write_depth, 256, 0, (pixels + 255) / 256, blocks_wanted, &blocks));
  return launch_next(write_depth, blocks, 256, 0, stream, f);
}

}  // namespace bigtri

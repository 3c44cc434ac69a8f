// Points to clip space on the GPU; torch-free.
#pragma once

#include <cuda_runtime_api.h>

#include <stdint.h>

namespace bigtri {

// points [count, 3], matrices [views, 4, 4], out [views, count, 4], all in device memory. Only enqueues.
cudaError_t transform_cuda(const float* points, const double* matrices, int64_t count, int64_t views, float* out,
                           cudaStream_t stream);

}  // namespace bigtri

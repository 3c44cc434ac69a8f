// Textures and shading on the GPU; torch-free. Every function only enqueues: nothing waits for the device.
#pragma once

#include <cuda_runtime_api.h>

#include "../core/texture.h"

namespace bigtri {

// texture [height, width, channels]; uv [count, 2]; out [count, channels]. Code: float for linear light, uint8_t or
// uint16_t for sRGB codes.
template <class Code>
cudaError_t sample_cuda(const Code* texture, int height, int width, int64_t channels, const float* uv, int64_t count,
                        Filter filter, Wrap wrap, float* out, cudaStream_t stream);

// normals, albedo, out [count, 3]; ambient [3]; directions, colors [lights, 3].
cudaError_t lambert_cuda(const float* normals, const float* albedo, const float* ambient, const float* directions,
                         const float* colors, int64_t lights, int64_t count, float* out, cudaStream_t stream);

// thresholds [255], ascending, in the memory of the host: they go to the device with the launch.
cudaError_t encode_srgb_cuda(const float* linear, const float* thresholds, int64_t count, uint8_t* out,
                             cudaStream_t stream);

}  // namespace bigtri

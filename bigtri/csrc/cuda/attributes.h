// What reads a visibility buffer on the GPU: interpolation, textures, shading; torch-free. Every function only enqueues: nothing waits for the device.
#pragma once

#include <cuda_runtime_api.h>

#include "../core/texture.h"

namespace bigtri {

// Pointers are to device memory.
struct Interpolation {
  const int64_t* packed;     // [B, H, W], any values
  const float* positions;    // [B, V, 4], clip space
  const int32_t* triangles;  // [T, 3]; one with an index that is no vertex reads as background
  const float* attributes;   // [V, C] or [B, V, C]; without a vertex null
  bool weights;              // no attributes: the barycentrics of the parent's corners
  float* out;                // [B, H, W, channels]
  uint32_t* clipped;         // interpolation_scratch bytes
  int64_t batch;             // B
  int64_t vertices;          // V
  int64_t attribute_view;    // floats from one view's attributes to the next one's; 0 where all views share them
  int64_t channels;          // C, or 3
  int32_t count;             // T
  int height, width;
};

// Bytes of memory that it works with.
int64_t interpolation_scratch(int64_t batch, int64_t height, int64_t width);
cudaError_t interpolate_cuda(const Interpolation& job, cudaStream_t stream);

// texture [height, width, channels]; uv [count, 2]; out [count, channels].
cudaError_t sample_cuda(const float* texture, int height, int width, int64_t channels, const float* uv, int64_t count, Filter filter, Wrap wrap, float* out,
                        cudaStream_t stream);

// normals, albedo, out [count, 3]; ambient [3]; directions, colors [lights, 3].
cudaError_t lambert_cuda(const float* normals, const float* albedo, const float* ambient, const float* directions, const float* colors, int64_t lights,
                         int64_t count, float* out, cudaStream_t stream);

// thresholds [255], ascending, in the memory of the host: they go to the device with the launch.
cudaError_t encode_srgb_cuda(const float* linear, const float* thresholds, int64_t count, uint8_t* out, cudaStream_t stream);

}  // namespace bigtri

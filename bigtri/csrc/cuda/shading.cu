// Textures and shading on the GPU: a thread a texture coordinate, a point or a number.

#include "shading.h"

#include "../core/shading.h"
#include "launch.cuh"

namespace bigtri {
namespace {

constexpr int kThreads = 256;

__device__ __forceinline__ int64_t thread_in_grid() { return (int64_t)blockIdx.x * kThreads + threadIdx.x; }
__device__ __forceinline__ int64_t threads_of_grid() { return (int64_t)gridDim.x * kThreads; }

// Of linear light, or of 16-bit codes, each of which is decoded where it is read: a table of all would take 256 KiB.
template <class Code>
__global__ void __launch_bounds__(kThreads)
    sample_texels(const Code* __restrict__ texture, int height, int width, int64_t channels,
                  const float* __restrict__ uv, int64_t count, Filter filter, Wrap wrap, float* __restrict__ out) {
  for (int64_t i = thread_in_grid(); i < count; i += threads_of_grid())
    sample(texture, height, width, channels, uv[2 * i], uv[2 * i + 1], filter, wrap, out + channels * i);
}

// Of 8-bit codes, by a table that each block makes, a thread an entry; so every thread has several coordinates.
constexpr int kSampledByThread = 8;

template <>
__global__ void __launch_bounds__(kThreads)
    sample_texels(const uint8_t* __restrict__ texture, int height, int width, int64_t channels,
                  const float* __restrict__ uv, int64_t count, Filter filter, Wrap wrap, float* __restrict__ out) {
  __shared__ float decoded[256];
  for (int code = threadIdx.x; code < 256; code += kThreads) decoded[code] = decode_srgb(257 * code);
  __syncthreads();
  const CodedTexels<uint8_t> texels = {texture, decoded};
  for (int64_t i = thread_in_grid(); i < count; i += threads_of_grid())
    sample(texels, height, width, channels, uv[2 * i], uv[2 * i + 1], filter, wrap, out + channels * i);
}

__global__ void __launch_bounds__(kThreads)
    light_points(const float* __restrict__ normals, const float* __restrict__ albedo, const float* __restrict__ ambient,
                 const float* __restrict__ directions, const float* __restrict__ colors, int64_t lights, int64_t count,
                 float* __restrict__ out) {
  for (int64_t i = thread_in_grid(); i < count; i += threads_of_grid())
    lambert(normals + 3 * i, albedo + 3 * i, ambient, LightArrays{directions, colors}, lights, out + 3 * i);
}

struct Thresholds {
  float value[255];
};

constexpr int kEncodedByThread = 8;

__global__ void __launch_bounds__(kThreads)
    encode_numbers(const float* __restrict__ linear, const __grid_constant__ Thresholds thresholds, int64_t count,
                   uint8_t* __restrict__ out) {
  // Not from the parameters themselves: constant memory gives the threads of a warp different elements only one after
  // the other.
  __shared__ float shared[255];
  for (int k = threadIdx.x; k < 255; k += kThreads) shared[k] = thresholds.value[k];
  __syncthreads();
  for (int64_t i = thread_in_grid(); i < count; i += threads_of_grid()) out[i] = encode_srgb(linear[i], shared);
}

}  // namespace

template <class Code>
cudaError_t sample_cuda(const Code* texture, int height, int width, int64_t channels, const float* uv, int64_t count,
                        Filter filter, Wrap wrap, float* out, cudaStream_t stream) {
  const int each = sizeof(Code) == 1 ? kThreads * kSampledByThread : kThreads;
  return launch_first(sample_texels<Code>, grid_blocks(count, each), kThreads, 0, stream, texture, height, width,
                      channels, uv, count, filter, wrap, out);
}
template cudaError_t sample_cuda(const float*, int, int, int64_t, const float*, int64_t, Filter, Wrap, float*,
                                 cudaStream_t);
template cudaError_t sample_cuda(const uint8_t*, int, int, int64_t, const float*, int64_t, Filter, Wrap, float*,
                                 cudaStream_t);
template cudaError_t sample_cuda(const uint16_t*, int, int, int64_t, const float*, int64_t, Filter, Wrap, float*,
                                 cudaStream_t);

cudaError_t lambert_cuda(const float* normals, const float* albedo, const float* ambient, const float* directions,
                         const float* colors, int64_t lights, int64_t count, float* out, cudaStream_t stream) {
  return launch_first(light_points, grid_blocks(count, kThreads), kThreads, 0, stream, normals, albedo, ambient,
                      directions, colors, lights, count, out);
}

cudaError_t encode_srgb_cuda(const float* linear, const float* thresholds, int64_t count, uint8_t* out,
                             cudaStream_t stream) {
  Thresholds by_value;
  for (int k = 0; k < 255; ++k) by_value.value[k] = thresholds[k];
  return launch_first(encode_numbers, grid_blocks(count, kThreads * kEncodedByThread), kThreads, 0, stream, linear,
                      by_value, count, out);
}

}  // namespace bigtri

// fragments.h on a GPU: a thread a triangle, as in the variant `scanline`, and a thread a pixel.

#include "fragments.h"

#include "cuda/launch.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

// On the device; and where no compiler for CUDA is at work, but tests/cuda/cuda_on_cpu.h has its words.
#if defined(__CUDA_ARCH__) || !defined(__CUDACC__)
BIGTRI_HD int64_t read_pixel(const int64_t* pixel) { return __ldcg(reinterpret_cast<const long long*>(pixel)); }

BIGTRI_HD void lower_pixel(int64_t* pixel, int64_t v) { atomicMin(reinterpret_cast<long long*>(pixel), (long long)v); }

// The lanes of a warp may want the same lock, so whoever has it lets go of it before the others try again.
BIGTRI_HD void lower_under_lock(uint32_t* lock, int64_t* pixel, int64_t v) {
  for (bool done = false; !done;) {
    if (atomicCAS(lock, 0u, 1u)) continue;
    __threadfence();
    volatile int64_t* const kept = pixel;
    if (v < *kept) *kept = v;
    __threadfence();
    atomicExch(lock, 0u);
    done = true;
  }
}
#else
BIGTRI_HD int64_t read_pixel(const int64_t* pixel) { return *pixel; }
BIGTRI_HD void lower_pixel(int64_t* pixel, int64_t v) { *pixel = min_of(*pixel, v); }
BIGTRI_HD void lower_under_lock(uint32_t*, int64_t* pixel, int64_t v) { lower_pixel(pixel, v); }
#endif

namespace {

constexpr int kThreads = 128;  // of a block, as many as those of the variant `scanline`

__device__ __forceinline__ int64_t this_thread() { return (int64_t)blockIdx.x * blockDim.x + threadIdx.x; }

__global__ void clear(const __grid_constant__ FragmentJob job, int64_t pixels) {
  if (this_thread() < pixels) job.frame.packed[this_thread()] = kBackground;
}

template <Way kWay>
__global__ void draw_all(const __grid_constant__ FragmentJob job) {
  if (this_thread() < job.frame.count) draw_triangle<kWay>(job, this_thread());
}

__global__ void finish(const __grid_constant__ FragmentJob job, int64_t pixels, bool coloured) {
  const int64_t i = this_thread();
  if (i >= pixels) return;
  Held held;
  const int width = job.frame.view.width, y = (int)(i / width);
  job.given.image[i] =
      coloured ? packed_colour(job.frame.packed[i]) : shade_pixel(job, (int)(i - (int64_t)y * width), y, &held);
}

int64_t blocks(int64_t threads) { return (threads + kThreads - 1) / kThreads; }

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

using namespace bigtri;

// Draws by one way, clear included, on a stream of the current device, whose work it joins. Returns CUDA's error, or 0.
extern "C" int fragments_draw(const FragmentArguments* given, int way, int, void* stream) {
  const auto on = static_cast<cudaStream_t>(stream);
  const FragmentJob job = fragment_job(*given);
  const int64_t pixels = (int64_t)given->height * given->width;
  const cudaError_t error = launch_first(clear, blocks(pixels), kThreads, 0, on, job, pixels);
  if (error != cudaSuccess || given->count == 0) return error;
  const auto draw = way == kPacked     ? draw_all<kPacked>
                    : way == kLocked   ? draw_all<kLocked>
                    : way == kColoured ? draw_all<kColoured>
                                       : draw_all<kColouredAll>;
  return launch_first(draw, blocks(given->count), kThreads, 0, on, job);
}

// The image from what was drawn: shaded from triangles, or the colours that were packed.
extern "C" int fragments_finish(const FragmentArguments* given, int way, int, void* stream) {
  const int64_t pixels = (int64_t)given->height * given->width;
  const auto on = static_cast<cudaStream_t>(stream);
  return launch_first(finish, blocks(pixels), kThreads, 0, on, fragment_job(*given), pixels, has_colours(way));
}

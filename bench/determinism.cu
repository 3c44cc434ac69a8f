// Two ways to keep the nearest of a pixel's fragments: one atomic minimum of 64 bits that hold depth and triangle, as
// bigtri does, and an atomic minimum of the depth alone, after which whoever has lowered it stores its triangle. The
// second is a race: the one that came second may store first, and of equal depths the first one wins.
// determinism.py builds it; without the kernels, for threads of a CPU, determinism.cpp does.

#include <stdint.h>
#include <string.h>

#ifdef __CUDACC__
#define BOTH __host__ __device__ __forceinline__
#else
#include <atomic>
#include <thread>
#include <vector>
#define BOTH inline
#endif

namespace {

struct Job {
  const float* corners;  // [count, 3, 3]: x, y in px, depth in [0, 1]
  int64_t count;
  int width, height;
  bool packed;
  uint64_t* words;   // [height, width], if packed: bits of the depth, triangle
  uint32_t* depths;  // [height, width], if not packed
  int32_t* ids;      // [height, width], if not packed; -1: no triangle
};

BOTH bool lower(uint64_t* to, uint64_t v) {
#ifdef __CUDA_ARCH__
  return atomicMin(reinterpret_cast<unsigned long long*>(to), (unsigned long long)v) > v;
#else
  uint64_t old = __atomic_load_n(to, __ATOMIC_RELAXED);
  while (v < old && !__atomic_compare_exchange_n(to, &old, v, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED)) {
  }
  return v < old;
#endif
}
BOTH bool lower(uint32_t* to, uint32_t v) {
#ifdef __CUDA_ARCH__
  return atomicMin(to, v) > v;
#else
  uint32_t old = __atomic_load_n(to, __ATOMIC_RELAXED);
  while (v < old && !__atomic_compare_exchange_n(to, &old, v, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED)) {
  }
  return v < old;
#endif
}

BOTH void keep(const Job& job, int64_t pixel, float depth, int32_t triangle) {
  uint32_t bits;
  memcpy(&bits, &depth, sizeof(bits));
  if (job.packed)
    lower(job.words + pixel, (uint64_t)bits << 32 | (uint32_t)triangle);
  else if (lower(job.depths + pixel, bits))
    *const_cast<volatile int32_t*>(job.ids + pixel) = triangle;
}

// Pixels first, first + step, ... of a triangle's box. Which pixels it covers is the same by both ways, and no more.
BOTH void draw(const Job& job, int32_t triangle, int64_t first, int64_t step) {
  const float* c = job.corners + 9 * (int64_t)triangle;
  float low[2] = {c[0], c[1]}, high[2] = {c[0], c[1]};
  for (int k = 1; k < 3; ++k)
    for (int i = 0; i < 2; ++i) {
      if (c[3 * k + i] < low[i]) low[i] = c[3 * k + i];
      if (c[3 * k + i] > high[i]) high[i] = c[3 * k + i];
    }
  const int x0 = low[0] > 0 ? (int)low[0] : 0, y0 = low[1] > 0 ? (int)low[1] : 0;
  const int x1 = high[0] < job.width ? (int)high[0] + 1 : job.width;
  const int y1 = high[1] < job.height ? (int)high[1] + 1 : job.height;
  const float area = (c[3] - c[0]) * (c[7] - c[1]) - (c[4] - c[1]) * (c[6] - c[0]);
  if (x0 >= x1 || y0 >= y1 || area == 0) return;
  const int columns = x1 - x0;
  for (int64_t i = first; i < (int64_t)columns * (y1 - y0); i += step) {
    const int x = x0 + (int)(i % columns), y = y0 + (int)(i / columns);
    float share[3];
    bool inside = true;
    for (int k = 0; k < 3; ++k) {
      const float *p = c + 3 * ((k + 1) % 3), *q = c + 3 * ((k + 2) % 3);
      share[k] = ((q[0] - p[0]) * (y + 0.5f - p[1]) - (q[1] - p[1]) * (x + 0.5f - p[0])) / area;
      inside = inside && share[k] >= 0;
    }
    const float depth = share[0] * c[2] + share[1] * c[5] + share[2] * c[8];
    if (inside && depth >= 0) keep(job, (int64_t)y * job.width + x, depth, triangle);
  }
}

#ifdef __CUDACC__
__global__ void clear(const __grid_constant__ Job job) {
  const int64_t pixels = (int64_t)job.width * job.height;
  for (int64_t i = (int64_t)blockIdx.x * blockDim.x + threadIdx.x; i < pixels; i += (int64_t)gridDim.x * blockDim.x) {
    if (job.packed) {
      job.words[i] = ~(uint64_t)0;
    } else {
      job.depths[i] = ~0u;
      job.ids[i] = -1;
    }
  }
}
__global__ void draw_all(const __grid_constant__ Job job) { draw(job, (int32_t)blockIdx.x, threadIdx.x, blockDim.x); }
#endif

}  // namespace

// On the current device and a stream, whose work it joins; or on so many threads. 0, or CUDA's error.
extern "C" int draw_frame(const float* corners, int64_t count, int width, int height, int packed, uint64_t* words,
                          uint32_t* depths, int32_t* ids, int threads, void* stream) {
  const Job job = {corners, count, width, height, packed != 0, words, depths, ids};
#ifdef __CUDACC__
  clear<<<1024, 256, 0, static_cast<cudaStream_t>(stream)>>>(job);
  if (count > 0) draw_all<<<(unsigned)count, 256, 0, static_cast<cudaStream_t>(stream)>>>(job);
  return cudaGetLastError();
#else
  const size_t pixels = (size_t)width * height;
  memset(packed ? (void*)words : (void*)depths, 0xff, pixels * (packed ? 8 : 4));
  if (!packed) memset(ids, 0xff, pixels * 4);
  std::atomic<int64_t> next{0};
  std::vector<std::thread> workers;
  for (int k = 0; k < threads; ++k)
    workers.emplace_back([&] {
      for (int64_t t; (t = next++) < count;) draw(job, (int32_t)t, 0, 1);
    });
  for (std::thread& worker : workers) worker.join();
  return 0;
#endif
}

// CUDA C++ for a host compiler: what the kernels of bigtri/csrc/cuda use of it. Included before each of their sources;
// cuda_on_cpu.py says how these are changed, cuda_on_cpu.cpp runs them.
#pragma once

#include <cuda_runtime.h>

#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <map>
#include <tuple>
#include <utility>

#undef __noinline__
#define __noinline__ __attribute__((noinline))
#undef __forceinline__
#define __forceinline__ inline
#undef __launch_bounds__
#define __launch_bounds__(...)
#undef __grid_constant__
#define __grid_constant__

extern uint3 threadIdx, blockIdx;
extern dim3 blockDim, gridDim;
extern char* dynamic_shared;  // of the block that runs

// Runs a grid to its end, a block after the other.
void run_grid(dim3 grid, dim3 block, size_t shared_bytes, const std::function<void()>& body);

// All lanes of the warp have to come here before one goes on: the values that they brought.
const uint64_t* warp_values(uint64_t value, const char* file, int line);
// The same for a bit of each.
unsigned warp_votes(bool value, const char* file, int line);
// The same for the threads of the block: the sum of what they brought.
int block_sum(int value, const char* file, int line);

template <class T>
uint64_t to_bits(T v) {
  static_assert(sizeof(T) <= 8, "one word");
  uint64_t bits = 0;
  memcpy(&bits, &v, sizeof(T));
  return bits;
}
template <class T>
T from_bits(uint64_t bits) {
  T v;
  memcpy(&v, &bits, sizeof(T));
  return v;
}
template <class T>
T value_of_lane(T v, unsigned lane, const char* file, int line) {
  return from_bits<T>(warp_values(to_bits(v), file, line)[lane & 31]);
}

#define __syncwarp() ((void)warp_values(0, __FILE__, __LINE__))
#define __ballot_sync(mask, v) warp_votes((v), __FILE__, __LINE__)
#define __any_sync(mask, v) (warp_votes((v), __FILE__, __LINE__) != 0)
#define __shfl_sync(mask, v, lane) value_of_lane((v), (unsigned)(lane), __FILE__, __LINE__)
#define __shfl_xor_sync(mask, v, step) value_of_lane((v), threadIdx.x ^ (unsigned)(step), __FILE__, __LINE__)
#define __shfl_down_sync(mask, v, step)                                                                         \
  value_of_lane((v), (threadIdx.x & 31) + (unsigned)(step) > 31 ? threadIdx.x : threadIdx.x + (unsigned)(step), \
                __FILE__, __LINE__)
#define __shfl_up_sync(mask, v, step)                                                                                \
  value_of_lane((v), (threadIdx.x & 31) < (unsigned)(step) ? threadIdx.x : threadIdx.x - (unsigned)(step), __FILE__, \
                __LINE__)
#define __syncthreads() ((void)block_sum(0, __FILE__, __LINE__))
#define __syncthreads_or(v) (block_sum((v) ? 1 : 0, __FILE__, __LINE__) > 0)
#define __syncthreads_count(v) block_sum((v) ? 1 : 0, __FILE__, __LINE__)
#define __threadfence() ((void)0)

template <class T>
T __ldg(const T* p) {
  return *p;
}
template <class T>
T __ldcg(const T* p) {
  return *p;
}
template <class T>
void __stcs(T* p, T v) {
  *p = v;
}
inline int __float_as_int(float v) { return from_bits<int>(to_bits(v)); }
inline float __int_as_float(int v) { return from_bits<float>(to_bits(v)); }
inline uint32_t __funnelshift_l(uint32_t low, uint32_t high, uint32_t shift) {
  return (uint32_t)((((uint64_t)high << 32 | low) << (shift & 31)) >> 32);
}
inline uint32_t __byte_perm(uint32_t low, uint32_t high, uint32_t selector) {
  uint32_t v = 0;
  for (int i = 0; i < 4; ++i)
    v |= (uint32_t)(((uint64_t)high << 32 | low) >> (8 * (selector >> (4 * i) & 7)) & 0xff) << (8 * i);
  return v;
}
inline int __ffs(unsigned v) { return __builtin_ffs((int)v); }
inline int __ffsll(long long v) { return __builtin_ffsll(v); }
inline int __popc(unsigned v) { return __builtin_popcount(v); }
inline int __popcll(unsigned long long v) { return __builtin_popcountll(v); }
inline int __clz(int v) { return v ? __builtin_clz((unsigned)v) : 32; }
inline float __saturatef(float v) { return v > 0 ? (v < 1 ? v : 1.0f) : 0.0f; }  // a NaN to 0
inline float __fmaf_rn(float a, float b, float c) { return std::fmaf(a, b, c); }
inline double __fma_rn(double a, double b, double c) { return std::fma(a, b, c); }
inline double __drcp_rn(double v) { return 1.0 / v; }
inline float __frcp_rn(float v) { return 1.0f / v; }
inline float __fdividef(float a, float b) { return a / b; }
inline int __float2int_rn(float v) { return (int)std::nearbyint(v); }
inline int __double2int_ru(double v) {  // to the nearest there is, a NaN to 0
  v = std::ceil(v);
  return v != v ? 0 : v >= 2147483647.0 ? 2147483647 : v <= -2147483648.0 ? -2147483647 - 1 : (int)v;
}

// One thread runs at a time.
template <class T, class V>
T atomicAdd(T* p, V v) {
  const T before = *p;
  *p = before + (T)v;
  return before;
}
template <class T, class V>
T atomicMin(T* p, V v) {
  const T before = *p;
  if ((T)v < before) *p = (T)v;
  return before;
}
template <class T, class V>
T atomicOr(T* p, V v) {
  const T before = *p;
  *p = before | (T)v;
  return before;
}

template <class T, class V>
T atomicExch(T* p, V v) {
  const T before = *p;
  *p = (T)v;
  return before;
}
template <class T>
T atomicCAS(T* p, T expected, T v) {
  const T before = *p;
  if (before == expected) *p = v;
  return before;
}

// What calls a kernel with copies of the parameters that it is given pointers to; known once the kernel was launched.
using Bind = std::function<std::function<void()>(void**)>;
extern std::map<const void*, Bind> kernels_seen;

template <class... Parameters, size_t... kOrder>
Bind bind_of(void (*kernel)(Parameters...), std::index_sequence<kOrder...>) {
  return [kernel](void** given) -> std::function<void()> {
    return
        [kernel, values = std::make_tuple(*static_cast<Parameters*>(given[kOrder])...)] { std::apply(kernel, values); };
  };
}

// Whether a grid may have these dimensions.
inline bool may_be(dim3 grid) { return grid.x > 0 && grid.y > 0 && grid.z > 0 && grid.y < 1 << 16 && grid.z < 1 << 16; }

// Whether a kernel may have so much dynamic shared memory.
bool may_have(const void* kernel, size_t shared_bytes);

template <class... Parameters, class... Arguments>
cudaError_t run_configured(const cudaLaunchConfig_t* c, void (*kernel)(Parameters...), Arguments... arguments) {
  kernels_seen[reinterpret_cast<const void*>(kernel)] = bind_of(kernel, std::index_sequence_for<Parameters...>());
  if (!may_have(reinterpret_cast<const void*>(kernel), c->dynamicSmemBytes)) return cudaErrorInvalidValue;
  if (!may_be(c->gridDim)) return cudaErrorInvalidConfiguration;
  run_grid(c->gridDim, c->blockDim, c->dynamicSmemBytes, [&] { kernel(arguments...); });
  return cudaSuccess;
}
#define cudaLaunchKernelEx run_configured

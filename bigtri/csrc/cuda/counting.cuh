// Counting a kernel's work (core/counters.h). In builds without BIGTRI_COUNTING the functions are empty and cost nothing; in
// those with it each call is an atomic addition or several, so that they tell nothing about time.
#pragma once

#include <cuda_runtime.h>

#include "../core/numerics.h"
#include "counted_work.h"
#include "fragment.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

#if defined(BIGTRI_COUNTING)
constexpr bool kCounts = true;

// Null: nothing is counted.
__device__ __forceinline__ const CountedWork* counted_work(const Frame& f) {
  return reinterpret_cast<const CountedWork*>(f.counters);
}
__device__ __forceinline__ void add_work(int64_t* to, int64_t n) {
  atomicAdd(reinterpret_cast<unsigned long long*>(to), (unsigned long long)n);
}
__device__ __forceinline__ void count_work(const Frame& f, Counter counter, int64_t n) {
  if (n && f.counters) add_work(counted_work(f)->counters + (int)counter, n);
}
// One that is offered to pixel (x, y) of the image, by this block.
__device__ __forceinline__ void count_fragment(const Frame& f, int x, int y) {
  if (!f.counters) return;
  const CountedWork& work = *counted_work(f);
  add_work(work.counters + (int)Counter::fragments, 1);
  add_work(work.fragments + y * CountedWork::columns(f.view.width) + x, 1);
  if (blockIdx.x < work.room) add_work(work.blocks + blockIdx.x, 1);
}
// keep_nearest() without reading first, of a pixel of the image.
__device__ __forceinline__ void keep_nearest_counted(const Frame& f, int64_t* pixel, int64_t packed) {
  const bool nearer = packed < atomicMin(reinterpret_cast<long long*>(pixel), (long long)packed);
  count_work(f, Counter::atomics, 1);
  count_work(f, Counter::passed, nearer);
  count_work(f, Counter::written, nearer);
}
#else
constexpr bool kCounts = false;
__device__ __forceinline__ void count_work(const Frame&, Counter, int64_t) {}
__device__ __forceinline__ void count_fragment(const Frame&, int, int) {}
__device__ __forceinline__ void keep_nearest_counted(const Frame&, int64_t* pixel, int64_t packed) {
  keep_nearest(pixel, packed, false);
}
#endif

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// Counting a kernel's work (core/counters.h). In builds without BIGTRI_COUNTING the functions are empty and cost nothing; in
// those with it each call is an atomic addition, so that they tell nothing about time.
#pragma once

#include <cuda_runtime.h>

#include "../core/counters.h"
#include "../core/numerics.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

#if defined(BIGTRI_COUNTING)
constexpr bool kCounts = true;
__device__ __forceinline__ void count_work(const Frame& f, Counter counter, int64_t n) {
  if (n && f.counters)
    atomicAdd(reinterpret_cast<unsigned long long*>(f.counters + (int)counter), (unsigned long long)n);
}
#else
constexpr bool kCounts = false;
__device__ __forceinline__ void count_work(const Frame&, Counter, int64_t) {}
#endif

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

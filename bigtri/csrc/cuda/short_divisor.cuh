// Division by a number that the host knows.
#pragma once

#include <cuda_runtime.h>

#include <cstdint>

namespace bigtri {

// Divides numbers below 2^31.
struct ShortDivisor {
  uint32_t by, factor;
  int shift;

  ShortDivisor() = default;
  explicit ShortDivisor(uint32_t v) : by(v), shift(31) {
    while (v > 1ull << (shift - 31)) ++shift;
    factor = (uint32_t)((1ull << shift) / v + 1);
  }
  // factor = (2^shift + e) / by, where 2^shift = 2^31 * 2^l with by / 2 <= 2^(l - 1) < by or by = 2^l = 1, so that it
  // fits 32 bits, and 0 < e <= by <= 2^l. Then v * factor / 2^shift is v / by plus v * e / 2^shift / by < 1 / by, which
  // v / by is away from the next whole number at least.
  __device__ __forceinline__ uint32_t quotient(uint32_t v) const { return (uint32_t)((uint64_t)v * factor >> shift); }
  // Of any number that is not negative.
  __device__ __forceinline__ int64_t quotient_of_any(int64_t v) const {
    return v <= INT32_MAX ? (int64_t)quotient((uint32_t)v) : v / by;
  }
};

}  // namespace bigtri

// What the core needs to know of the compiler: functions for host and device, and nothing else.
#pragma once

#include <stddef.h>
#include <stdint.h>

#if defined(__CUDACC__)
#define BIGTRI_HD __host__ __device__ static inline
#else
// Internal linkage on purpose: the same header is compiled once per instruction set, and a linker that merged the copies
// could hand AVX-512 code to a machine without it.
#define BIGTRI_HD static inline
#endif

namespace bigtri {

template <class T>
BIGTRI_HD T min_of(T a, T b) {
  return b < a ? b : a;
}
template <class T>
BIGTRI_HD T max_of(T a, T b) {
  return a < b ? b : a;
}

// Bits as they are; the union form is understood alike by gcc, clang and nvcc.
BIGTRI_HD uint32_t float_bits(float v) {
  union {
    float f;
    uint32_t u;
  } x;
  x.f = v;
  return x.u;
}
BIGTRI_HD float bits_float(uint32_t v) {
  union {
    float f;
    uint32_t u;
  } x;
  x.u = v;
  return x.f;
}
BIGTRI_HD uint64_t double_bits(double v) {
  union {
    double f;
    uint64_t u;
  } x;
  x.f = v;
  return x.u;
}
BIGTRI_HD double bits_double(uint64_t v) {
  union {
    double f;
    uint64_t u;
  } x;
  x.u = v;
  return x.f;
}

}  // namespace bigtri

// The compiler's part: how a function is declared for host and device, and helpers that need no library call.
// Every stage includes this file. It is the only one in core/ that includes system headers.
#pragma once

#include <stddef.h>
#include <stdint.h>

#include <type_traits>

#if defined(__CUDACC__)
#define BIGTRI_HD __host__ __device__ static inline
#else
// Internal linkage, because each header is compiled once per instruction set. A linker that merged the copies could
// keep the AVX-512 one and run it on a machine without AVX-512.
#define BIGTRI_HD static inline
#endif

namespace bigtri {

// Whether float64 is slow: a GPU that does two operations of it a clock and multiprocessor, a 64th or a 32nd of its
// float32 rate. Those that do 32 or 64 are named. Tests say BIGTRI_SLOW_FLOAT64 to have on a CPU what is made for these.
#if defined(BIGTRI_SLOW_FLOAT64)
constexpr bool kSlowFloat64 = true;
#elif defined(__CUDA_ARCH__)
constexpr bool kSlowFloat64 = __CUDA_ARCH__ != 700 && __CUDA_ARCH__ != 720 && __CUDA_ARCH__ != 800 &&
                              __CUDA_ARCH__ != 900 && __CUDA_ARCH__ != 1000;
#else
constexpr bool kSlowFloat64 = false;
#endif

template <class T>
BIGTRI_HD T min_of(T a, T b) {
  return b < a ? b : a;
}
template <class T>
BIGTRI_HD T max_of(T a, T b) {
  return a < b ? b : a;
}

// The functions from here to square_root have overloads for vectors (cpu/simd.h), so that a formula serves a pixel and a
// vector of pixels.
BIGTRI_HD float select(bool mask, float yes, float no) { return mask ? yes : no; }
BIGTRI_HD int32_t select(bool mask, int32_t yes, int32_t no) { return mask ? yes : no; }

// v, as a number of the kind of `like`.
BIGTRI_HD float constant(float v, float) { return v; }

// Cuts off the fraction. |v| must be below 2^31.
BIGTRI_HD int32_t to_int(float v) { return (int32_t)v; }
BIGTRI_HD float to_float(int32_t v) { return (float)v; }

// Correctly rounded on the CPU and on the GPU.
#if defined(__CUDA_ARCH__)
BIGTRI_HD float square_root(float v) { return __fsqrt_rn(v); }
#else
BIGTRI_HD float square_root(float v) { return __builtin_sqrtf(v); }
#endif

// Reinterprets the bits. gcc, clang and nvcc all define reading the other member of a union.
template <class To, class From>
BIGTRI_HD To bits_as(From v) {
  static_assert(sizeof(To) == sizeof(From), "as many bits");
  union {
    From from;
    To to;
  } x;
  x.from = v;
  return x.to;
}
BIGTRI_HD uint32_t float_bits(float v) { return bits_as<uint32_t>(v); }
BIGTRI_HD float bits_float(uint32_t v) { return bits_as<float>(v); }
BIGTRI_HD uint64_t double_bits(double v) { return bits_as<uint64_t>(v); }
BIGTRI_HD double bits_double(uint64_t v) { return bits_as<double>(v); }

constexpr float kInfinity = __builtin_inff();
constexpr float kNotANumber = __builtin_nanf("");

BIGTRI_HD bool is_finite(float v) { return (float_bits(v) & 0x7f800000u) != 0x7f800000u; }

}  // namespace bigtri

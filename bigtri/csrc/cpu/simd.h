// Eight pixels of a row, or sixteen of two rows, as compiler vectors. gcc and clang lower them to whatever the translation unit's target has, element by
// element the same IEEE operations; only the sign mask needs to know the instruction set.
#pragma once

#include <stdint.h>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

namespace bigtri {

typedef int32_t i32x8 __attribute__((vector_size(32)));
typedef int32_t i32x16 __attribute__((vector_size(64)));
typedef uint32_t u32x8 __attribute__((vector_size(32)));
typedef int64_t i64x8 __attribute__((vector_size(64)));
typedef uint64_t u64x8 __attribute__((vector_size(64)));
typedef float f32x8 __attribute__((vector_size(32)));
typedef double f64x8 __attribute__((vector_size(64)));
// The same without an alignment demand, for rows that start anywhere.
typedef int64_t i64x8u __attribute__((vector_size(64), aligned(8)));
typedef float f32x8u __attribute__((vector_size(32), aligned(4)));

#define BIGTRI_INLINE static inline __attribute__((always_inline))

constexpr f64x8 kLane = {0, 1, 2, 3, 4, 5, 6, 7};
constexpr i32x16 kLaneX = {0, 1, 2, 3, 4, 5, 6, 7, 0, 1, 2, 3, 4, 5, 6, 7};   // column within the tile
constexpr i32x16 kLaneY = {0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 1, 1};   // row within a pair of rows
constexpr i64x8 kLaneBit = {1, 2, 4, 8, 16, 32, 64, 128};

// Bit i: lane i is negative.
BIGTRI_INLINE uint32_t sign_mask(i32x16 v) {
#if defined(__AVX512DQ__)
  return _mm512_movepi32_mask((__m512i)v);
#elif defined(__AVX2__)
  const uint32_t low = _mm256_movemask_ps((__m256)__builtin_shufflevector(v, v, 0, 1, 2, 3, 4, 5, 6, 7));
  const uint32_t high = _mm256_movemask_ps((__m256)__builtin_shufflevector(v, v, 8, 9, 10, 11, 12, 13, 14, 15));
  return low | high << 8;
#else
  uint32_t mask = 0;
  for (int i = 0; i < 16; ++i) mask |= ((uint32_t)v[i] >> 31) << i;
  return mask;
#endif
}

BIGTRI_INLINE f32x8 to_float(f64x8 v) { return __builtin_convertvector(v, f32x8); }
BIGTRI_INLINE f32x8 splat(float v) { return (f32x8){v, v, v, v, v, v, v, v}; }

// min_of(max_of(f, low), high) + 0.0f, as finish_depth has it.
BIGTRI_INLINE f32x8 clamp_depth(f32x8 f, f32x8 low, f32x8 high) {
  f = f < low ? low : f;
  f = high < f ? high : f;
  return f + 0.0f;
}

}  // namespace bigtri

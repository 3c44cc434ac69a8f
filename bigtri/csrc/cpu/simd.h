// Eight pixels of a row, or sixteen of two rows, as compiler vectors. gcc and clang lower them to whatever the translation unit's target has, element by
// element the same IEEE operations. Where that lowering falls short, a few functions spell it out for BIGTRI_SIMD = 256 (AVX2) or 512 (AVX-512), which the including file
// defines: a target pragma does not define __AVX2__ and the like.
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
typedef double f64x8u __attribute__((vector_size(64), aligned(8)));
typedef float f32x8u __attribute__((vector_size(32), aligned(4)));

#define BIGTRI_INLINE static inline __attribute__((always_inline))

constexpr float kInfinity = __builtin_inff();
constexpr f64x8 kLane = {0, 1, 2, 3, 4, 5, 6, 7};
constexpr i32x16 kLaneX = {0, 1, 2, 3, 4, 5, 6, 7, 0, 1, 2, 3, 4, 5, 6, 7};   // column within the tile
constexpr i32x16 kLaneY = {0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 1, 1};   // row within a pair of rows

// Bit i: lane i is negative.
BIGTRI_INLINE uint32_t sign_mask(i32x16 v) {
#if BIGTRI_SIMD >= 512
  return _mm512_movepi32_mask((__m512i)v);
#elif BIGTRI_SIMD >= 256
  const uint32_t low = _mm256_movemask_ps((__m256)__builtin_shufflevector(v, v, 0, 1, 2, 3, 4, 5, 6, 7));
  const uint32_t high = _mm256_movemask_ps((__m256)__builtin_shufflevector(v, v, 8, 9, 10, 11, 12, 13, 14, 15));
  return low | high << 8;
#else
  uint32_t mask = 0;
  for (int i = 0; i < 16; ++i) mask |= ((uint32_t)v[i] >> 31) << i;
  return mask;
#endif
}

BIGTRI_INLINE uint32_t sign_mask(i32x8 v) {
#if BIGTRI_SIMD >= 256
  return (uint32_t)_mm256_movemask_ps((__m256)v);
#else
  uint32_t mask = 0;
  for (int i = 0; i < 8; ++i) mask |= ((uint32_t)v[i] >> 31) << i;
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

// The high half from the depth, the low half from the triangle.
BIGTRI_INLINE i64x8 pack(f32x8 z, uint64_t triangle) {
#if BIGTRI_SIMD >= 512
  const __m512i to_high = _mm512_setr_epi32(0, 0, 0, 1, 0, 2, 0, 3, 0, 4, 0, 5, 0, 6, 0, 7);
  return (i64x8)_mm512_mask_permutexvar_epi32(_mm512_set1_epi64((int64_t)triangle), 0xaaaa, to_high, _mm512_castsi256_si512((__m256i)z));
#else
  return (i64x8)(__builtin_convertvector((u32x8)z, u64x8) << 32 | triangle);
#endif
}

#if BIGTRI_SIMD >= 256
BIGTRI_INLINE __m256i low_half(i64x8 v) { return (__m256i)__builtin_shufflevector(v, v, 0, 1, 2, 3); }
BIGTRI_INLINE __m256i high_half(i64x8 v) { return (__m256i)__builtin_shufflevector(v, v, 4, 5, 6, 7); }

BIGTRI_INLINE void keep_nearest(int64_t* pixels, __m256i packed, __m256i wanted) {
  const __m256i old = _mm256_loadu_si256((const __m256i*)pixels);
  const __m256i nearer = _mm256_and_si256(_mm256_cmpgt_epi64(old, packed), wanted);
  _mm256_storeu_si256((__m256i*)pixels, _mm256_blendv_epi8(old, packed, nearer));
}
#endif

// pixels[i] = min(pixels[i], packed[i]) for all eight, or where bit i is set.
BIGTRI_INLINE void keep_nearest(int64_t* pixels, i64x8 packed) {
#if BIGTRI_SIMD >= 512
  _mm512_storeu_si512(pixels, _mm512_min_epi64(_mm512_loadu_si512(pixels), (__m512i)packed));
#elif BIGTRI_SIMD >= 256
  const __m256i all = _mm256_set1_epi64x(-1);
  keep_nearest(pixels, low_half(packed), all);
  keep_nearest(pixels + 4, high_half(packed), all);
#else
  for (int i = 0; i < 8; ++i) pixels[i] = packed[i] < pixels[i] ? packed[i] : pixels[i];
#endif
}

BIGTRI_INLINE void keep_nearest(int64_t* pixels, i64x8 packed, uint32_t bits) {
#if BIGTRI_SIMD >= 512
  const __m512i old = _mm512_loadu_si512(pixels);
  _mm512_storeu_si512(pixels, _mm512_mask_min_epi64(old, (__mmask8)bits, old, (__m512i)packed));
#elif BIGTRI_SIMD >= 256
  const __m256i all = _mm256_set1_epi64x((int64_t)bits), low = _mm256_setr_epi64x(1, 2, 4, 8), high = _mm256_setr_epi64x(16, 32, 64, 128);
  keep_nearest(pixels, low_half(packed), _mm256_cmpeq_epi64(_mm256_and_si256(all, low), low));
  keep_nearest(pixels + 4, high_half(packed), _mm256_cmpeq_epi64(_mm256_and_si256(all, high), high));
#else
  for (int i = 0; i < 8; ++i)
    if ((bits >> i & 1) && packed[i] < pixels[i]) pixels[i] = packed[i];
#endif
}

// Appends code[j] << 8 | byte j of the mask for every byte that is not 0, from list[n] on; returns the new n. Writes up to eight elements whatever the mask.
BIGTRI_INLINE int append_rows(uint64_t mask, i32x8 code, uint32_t* list, int n) {
#if BIGTRI_SIMD >= 512
  const __m256i bytes = _mm256_cvtepu8_epi32(_mm_cvtsi64_si128((int64_t)mask));
  const __mmask8 some = _mm256_test_epi32_mask(bytes, bytes);
  const __m256i items = _mm256_or_si256(_mm256_slli_epi32((__m256i)code, 8), bytes);
  _mm256_storeu_si256((__m256i*)(list + n), _mm256_maskz_compress_epi32(some, items));
  return n + __builtin_popcount(some);
#else
  for (int j = 0; mask; ++j, mask >>= 8) {
    list[n] = (uint32_t)code[j] << 8 | (mask & 0xff);
    n += (mask & 0xff) != 0;
  }
  return n;
#endif
}

// To memory that is not read again soon: past the caches.
BIGTRI_INLINE void stream(int64_t* to, i64x8 v) {
#if BIGTRI_SIMD >= 512
  _mm512_stream_si512((__m512i*)to, (__m512i)v);
#elif BIGTRI_SIMD >= 256
  _mm256_stream_si256((__m256i*)to, low_half(v));
  _mm256_stream_si256((__m256i*)(to + 4), high_half(v));
#else
  *(i64x8*)to = v;
#endif
}

}  // namespace bigtri

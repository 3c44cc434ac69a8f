// Vectors of eight pixels of a row, or of sixteen in two rows, for the kernels (.inl). A vector consists of as many
// machine vectors as it takes. Elements are computed with the same IEEE operations on every machine, so the bits are
// the same. The including file defines BIGTRI_SIMD, the width of a machine vector in bits: 512 (AVX-512), 256 (AVX2) or
// 128 (any x86-64, and other processors). __AVX2__ would not do: not every compiler defines it for a target pragma.
#pragma once

#if BIGTRI_SIMD > 128
#include <immintrin.h>
#endif

#include <type_traits>

#include "../core/depth.h"
#include "../core/visibility.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

#define BIGTRI_INLINE static inline __attribute__((always_inline))

template <class T, int N>
struct Lanes {
  // Elements of one machine vector.
  static constexpr int kWidth = N * (int)sizeof(T) * 8 < BIGTRI_SIMD ? N : BIGTRI_SIMD / 8 / (int)sizeof(T);
  static constexpr int kParts = N / kWidth;
  typedef T Vector __attribute__((vector_size(kWidth * sizeof(T))));
  Vector part[kParts];

  __attribute__((always_inline)) T operator[](int i) const { return part[i / kWidth][i % kWidth]; }
};

using i32x8 = Lanes<int32_t, 8>;
using i32x16 = Lanes<int32_t, 16>;
using u32x16 = Lanes<uint32_t, 16>;
using i64x8 = Lanes<int64_t, 8>;
using f32x8 = Lanes<float, 8>;
using f32x16 = Lanes<float, 16>;
using f64x8 = Lanes<double, 8>;
using DepthLanes = Lanes<DepthNumber, 8>;  // what depth planes are computed in

// What a comparison of Lanes<T, N> gives: elements of T's width, all bits set where it holds.
template <class T, int N>
using MaskOf = Lanes<std::conditional_t<sizeof(T) == 8, int64_t, int32_t>, N>;

// All elements v. scalar - vector is how the vector extension broadcasts. v - 0 is v, also for -0 (v + 0 would make it
// +0). The compiler removes the subtraction.
template <class L, class T>
BIGTRI_INLINE L splat(T v) {
  L r;
  for (int i = 0; i < L::kParts; ++i) r.part[i] = v - typename L::Vector{};
  return r;
}

// Unaligned. The compiler makes vector loads and stores of memcpy.
template <class L, class T>
BIGTRI_INLINE L load(const T* from) {
  L r;
  __builtin_memcpy(&r, from, sizeof r);
  return r;
}

template <class T, int N>
BIGTRI_INLINE void store(T* to, const Lanes<T, N>& v) {
  __builtin_memcpy(to, &v, sizeof v);
}

#define BIGTRI_OPERATOR(OP)                                                           \
  template <class T, int N>                                                           \
  BIGTRI_INLINE Lanes<T, N> operator OP(const Lanes<T, N>& a, const Lanes<T, N>& b) { \
    Lanes<T, N> r;                                                                    \
    for (int i = 0; i < r.kParts; ++i) r.part[i] = a.part[i] OP b.part[i];            \
    return r;                                                                         \
  }                                                                                   \
  template <class T, int N>                                                           \
  BIGTRI_INLINE Lanes<T, N> operator OP(const Lanes<T, N>& a, T b) {                  \
    return a OP splat<Lanes<T, N>>(b);                                                \
  }                                                                                   \
  template <class T, int N>                                                           \
  BIGTRI_INLINE Lanes<T, N> operator OP(T a, const Lanes<T, N>& b) {                  \
    return splat<Lanes<T, N>>(a) OP b;                                                \
  }
BIGTRI_OPERATOR(+)
BIGTRI_OPERATOR(-)
BIGTRI_OPERATOR(*)
BIGTRI_OPERATOR(/)
BIGTRI_OPERATOR(|)
BIGTRI_OPERATOR(&)
BIGTRI_OPERATOR(>>)
BIGTRI_OPERATOR(<<)
#undef BIGTRI_OPERATOR

#define BIGTRI_COMPARISON(OP)                                                                               \
  template <class T, int N>                                                                                 \
  BIGTRI_INLINE MaskOf<T, N> operator OP(const Lanes<T, N>& a, const Lanes<T, N>& b) {                      \
    MaskOf<T, N> r;                                                                                         \
    for (int i = 0; i < r.kParts; ++i) r.part[i] = (typename MaskOf<T, N>::Vector)(a.part[i] OP b.part[i]); \
    return r;                                                                                               \
  }                                                                                                         \
  template <class T, int N>                                                                                 \
  BIGTRI_INLINE MaskOf<T, N> operator OP(const Lanes<T, N>& a, T b) {                                       \
    return a OP splat<Lanes<T, N>>(b);                                                                      \
  }
BIGTRI_COMPARISON(<)
BIGTRI_COMPARISON(>)
BIGTRI_COMPARISON(==)
#undef BIGTRI_COMPARISON

#if BIGTRI_SIMD >= 256
// fused (core/coverage.h) of each.
BIGTRI_INLINE f32x8 fused(const f32x8& a, const f32x8& b, const f32x8& c) {
  f32x8 r;
  r.part[0] = (f32x8::Vector)_mm256_fmsub_ps((__m256)a.part[0], (__m256)b.part[0], (__m256)c.part[0]);
  return r;
}
#endif

// reciprocal (core/attributes.h) of each.
BIGTRI_INLINE f32x8 reciprocal(const f32x8& v) {
  f32x8 start;
  for (int i = 0; i < v.kParts; ++i)
    start.part[i] = (f32x8::Vector)(0x7ef311c7 - (i32x8::Vector)v.part[i]);  // of the bits
  const f32x8 once = start * (2.0f - v * start);
  return once * (2.0f - v * once);
}

// yes[i] where the mask is set, else no[i].
template <class T, int N>
BIGTRI_INLINE Lanes<T, N> select(const MaskOf<T, N>& mask, const Lanes<T, N>& yes, const Lanes<T, N>& no) {
  Lanes<T, N> r;
  for (int i = 0; i < r.kParts; ++i) r.part[i] = mask.part[i] ? yes.part[i] : no.part[i];
  return r;
}

// The functions of core/platform.h, of each.
template <int N>
BIGTRI_INLINE Lanes<float, N> constant(float v, const Lanes<float, N>&) {
  return splat<Lanes<float, N>>(v);
}
template <int N>
BIGTRI_INLINE Lanes<int32_t, N> to_int(const Lanes<float, N>& v) {
  Lanes<int32_t, N> r;
  for (int i = 0; i < r.kParts; ++i) r.part[i] = __builtin_convertvector(v.part[i], typename Lanes<int32_t, N>::Vector);
  return r;
}
template <int N>
BIGTRI_INLINE Lanes<float, N> to_float(const Lanes<int32_t, N>& v) {
  Lanes<float, N> r;
  for (int i = 0; i < r.kParts; ++i) r.part[i] = __builtin_convertvector(v.part[i], typename Lanes<float, N>::Vector);
  return r;
}
template <int N>
BIGTRI_INLINE Lanes<float, N> square_root(const Lanes<float, N>& v) {
  Lanes<float, N> r;
  for (int i = 0; i < r.kParts; ++i) {
#if BIGTRI_SIMD >= 512
    if constexpr (Lanes<float, N>::kWidth == 16)
      r.part[i] = (typename Lanes<float, N>::Vector)_mm512_sqrt_ps((__m512)v.part[i]);
    else
      r.part[i] = (typename Lanes<float, N>::Vector)_mm256_sqrt_ps((__m256)v.part[i]);
#elif BIGTRI_SIMD >= 256
    r.part[i] = (typename Lanes<float, N>::Vector)_mm256_sqrt_ps((__m256)v.part[i]);
#else
    for (int k = 0; k < r.kWidth; ++k) r.part[i][k] = __builtin_sqrtf(v.part[i][k]);
#endif
  }
  return r;
}

#if BIGTRI_SIMD >= 256
// floor_any and floor_small (core/texture.h) of each.
template <int N>
BIGTRI_INLINE Lanes<float, N> floor_any(const Lanes<float, N>& v) {
  Lanes<float, N> r;
  for (int i = 0; i < r.kParts; ++i) {
#if BIGTRI_SIMD >= 512
    if constexpr (Lanes<float, N>::kWidth == 16)
      r.part[i] = (typename Lanes<float, N>::Vector)_mm512_roundscale_ps((__m512)v.part[i], _MM_FROUND_TO_NEG_INF);
    else
#endif
      r.part[i] = (typename Lanes<float, N>::Vector)_mm256_floor_ps((__m256)v.part[i]);
  }
  return r;
}
template <int N>
BIGTRI_INLINE Lanes<float, N> floor_small(const Lanes<float, N>& v) {
  return floor_any(v);
}
#endif

// inner_part and share_of (core/attributes.h) of each.
BIGTRI_INLINE f64x8 inner_part(const f64x8& u, const f64x8& turn) {
  const f64x8 none = splat<f64x8>(0.0), towards = select<double, 8>(turn < 0.0, none - u, u);
  return select<double, 8>(towards > 0.0, towards, none);
}
BIGTRI_INLINE f64x8 share_of(const f64x8& v, const f64x8& sum) {
  return select<double, 8>(sum == 0.0, splat<f64x8>(0.0), v / sum);
}

// min_of and max_of (core/platform.h) of each.
template <class T, int N>
BIGTRI_INLINE Lanes<T, N> least(const Lanes<T, N>& a, const Lanes<T, N>& b) {
  return select<T, N>(b < a, b, a);
}
template <class T, int N>
BIGTRI_INLINE Lanes<T, N> greatest(const Lanes<T, N>& a, const Lanes<T, N>& b) {
  return select<T, N>(a < b, b, a);
}

alignas(64) constexpr double kLaneDouble[8] = {0, 1, 2, 3, 4, 5, 6, 7};
alignas(64) constexpr int32_t kLaneInt[8] = {0, 1, 2, 3, 4, 5, 6, 7};
alignas(64) constexpr int64_t kLaneLong[8] = {0, 1, 2, 3, 4, 5, 6, 7};
alignas(64) constexpr int32_t kLaneX[16] = {0, 1, 2, 3, 4, 5, 6, 7, 0, 1, 2, 3, 4, 5, 6, 7};  // column within the tile
alignas(64) constexpr int32_t kLaneY[16] = {0, 0, 0, 0, 0, 0, 0, 0,
                                            1, 1, 1, 1, 1, 1, 1, 1};  // row within a pair of rows

// Bit i: element i is negative. movemask collects the sign bits of floats; only the bits matter, so integers may pass
// as floats.
template <int N>
BIGTRI_INLINE uint32_t sign_mask(const Lanes<int32_t, N>& v) {
  uint32_t mask = 0;
  for (int i = 0; i < v.kParts; ++i) {
    uint32_t some = 0;
#if BIGTRI_SIMD >= 512
    if constexpr (Lanes<int32_t, N>::kWidth == 16)
      some = _mm512_movepi32_mask((__m512i)v.part[i]);
    else
      some = (uint32_t)_mm256_movemask_ps((__m256)v.part[i]);
#elif BIGTRI_SIMD >= 256
    some = (uint32_t)_mm256_movemask_ps((__m256)v.part[i]);
#else
    for (int k = 0; k < v.kWidth; ++k) some |= ((uint32_t)v.part[i][k] >> 31) << k;
#endif
    mask |= some << (i * v.kWidth);
  }
  return mask;
}

BIGTRI_INLINE uint32_t sign_mask(const f64x8& v) {
#if BIGTRI_SIMD >= 512
  return _mm512_movepi64_mask((__m512i)v.part[0]);
#elif BIGTRI_SIMD >= 256
  return (uint32_t)(_mm256_movemask_pd((__m256d)v.part[0]) | _mm256_movemask_pd((__m256d)v.part[1]) << 4);
#else
  uint32_t mask = 0;
  for (int i = 0; i < 8; ++i) mask |= (uint32_t)(double_bits(v[i]) >> 63) << i;
  return mask;
#endif
}

BIGTRI_INLINE uint32_t sign_mask(const i64x8& v) {
  f64x8 same_bits;
  __builtin_memcpy(&same_bits, &v, sizeof v);
  return sign_mask(same_bits);
}

// Bit i: a[i] > b[i]. False for a NaN.
BIGTRI_INLINE uint32_t greater_mask(const f32x8& a, const f32x8& b) {
#if BIGTRI_SIMD >= 256
  return (uint32_t)_mm256_movemask_ps(_mm256_cmp_ps((__m256)a.part[0], (__m256)b.part[0], _CMP_GT_OQ));
#else
  uint32_t mask = 0;
  for (int i = 0; i < 8; ++i) mask |= (uint32_t)(a[i] > b[i]) << i;
  return mask;
#endif
}

// Exact.
BIGTRI_INLINE f64x8 to_double(const i32x8& v) {
  f64x8 r;
#if BIGTRI_SIMD >= 512
  r.part[0] = __builtin_convertvector(v.part[0], f64x8::Vector);
#elif BIGTRI_SIMD >= 256
  r.part[0] = (f64x8::Vector)_mm256_cvtepi32_pd(_mm256_castsi256_si128((__m256i)v.part[0]));
  r.part[1] = (f64x8::Vector)_mm256_cvtepi32_pd(_mm256_extracti128_si256((__m256i)v.part[0], 1));
#else
  double d[8];
  for (int i = 0; i < 8; ++i) d[i] = v[i];
  r = load<f64x8>(d);
#endif
  return r;
}
BIGTRI_INLINE f64x8 to_double(const f32x8& v) {
  f64x8 r;
#if BIGTRI_SIMD >= 512
  r.part[0] = __builtin_convertvector(v.part[0], f64x8::Vector);
#elif BIGTRI_SIMD >= 256
  r.part[0] = (f64x8::Vector)_mm256_cvtps_pd(_mm256_castps256_ps128((__m256)v.part[0]));
  r.part[1] = (f64x8::Vector)_mm256_cvtps_pd(_mm256_extractf128_ps((__m256)v.part[0], 1));
#else
  double d[8];
  for (int i = 0; i < 8; ++i) d[i] = v[i];
  r = load<f64x8>(d);
#endif
  return r;
}

#if BIGTRI_SIMD == 256
// The upper halves of eight elements, or the lower ones, as kShuffle says. The shuffle, which works within 128-bit
// halves, gives those of elements 0 1 4 5 | 2 3 6 7. The permutation puts them in order.
template <int kShuffle>
BIGTRI_INLINE __m256i halves(const i64x8& v) {
  const __m256 both = _mm256_shuffle_ps((__m256)v.part[0], (__m256)v.part[1], kShuffle);
  return _mm256_permute4x64_epi64((__m256i)both, _MM_SHUFFLE(3, 1, 2, 0));
}
#endif

// The lower half of each element: the same mask for narrower elements.
BIGTRI_INLINE i32x8 lower_half(const i64x8& v) {
  i32x8 r;
#if BIGTRI_SIMD >= 512
  r.part[0] = __builtin_convertvector(v.part[0], i32x8::Vector);
#elif BIGTRI_SIMD >= 256
  r.part[0] = (i32x8::Vector)halves<_MM_SHUFFLE(2, 0, 2, 0)>(v);
#else
  int32_t lower[8];
  for (int i = 0; i < 8; ++i) lower[i] = (int32_t)v[i];
  r = load<i32x8>(lower);
#endif
  return r;
}

// Bit i: the lower halves of elements i differ.
BIGTRI_INLINE uint32_t lower_differ(const i64x8& a, const i64x8& b) {
#if BIGTRI_SIMD >= 512
  return _mm512_test_epi64_mask(_mm512_xor_si512((__m512i)a.part[0], (__m512i)b.part[0]),
                                _mm512_set1_epi64(0xffffffff));
#elif BIGTRI_SIMD >= 256
  uint32_t same = 0;
  for (int i = 0; i < 2; ++i) {
    const __m256i lower = _mm256_slli_epi64(_mm256_cmpeq_epi32((__m256i)a.part[i], (__m256i)b.part[i]), 32);
    same |= (uint32_t)_mm256_movemask_pd((__m256d)lower) << 4 * i;
  }
  return same ^ 0xff;
#else
  uint32_t mask = 0;
  for (int i = 0; i < 8; ++i) mask |= (uint32_t)((uint32_t)a[i] != (uint32_t)b[i]) << i;
  return mask;
#endif
}

// Rounds to nearest, half to even.
BIGTRI_INLINE f32x8 to_float(const f32x8& v) { return v; }
BIGTRI_INLINE f32x8 to_float(const i32x8& v) {
  f32x8 r;
  for (int i = 0; i < v.kParts; ++i) r.part[i] = __builtin_convertvector(v.part[i], f32x8::Vector);
  return r;
}
BIGTRI_INLINE f32x8 to_float(const f64x8& v) {
  f32x8 r;
#if BIGTRI_SIMD >= 512
  r.part[0] = (f32x8::Vector)_mm512_cvtpd_ps((__m512d)v.part[0]);
#elif BIGTRI_SIMD >= 256
  r.part[0] = (f32x8::Vector)_mm256_set_m128(_mm256_cvtpd_ps((__m256d)v.part[1]), _mm256_cvtpd_ps((__m256d)v.part[0]));
#else
  float f[8];
  for (int i = 0; i < 8; ++i) f[i] = (float)v[i];
  r = load<f32x8>(f);
#endif
  return r;
}

// quotient (core/numerics.h) of each.
template <class T, int N>
BIGTRI_INLINE Lanes<T, N> quotient(const Lanes<T, N>& v, const Lanes<T, N>& by) {
  return v / by;
}
BIGTRI_INLINE f32x8 quotient(const f32x8& v, const f64x8& by) { return v / to_float(by); }
BIGTRI_INLINE f32x8 quotient(const f32x8& v, double by) { return v / (float)by; }

// Each as a T, which is float or double; rounds to nearest, half to even.
template <class T, class From>
BIGTRI_INLINE Lanes<T, 8> converted(const Lanes<From, 8>& v) {
  if constexpr (std::is_same_v<T, double>)
    return to_double(v);
  else
    return to_float(v);
}

// 0, 1, ..., 7.
template <class T>
BIGTRI_INLINE Lanes<T, 8> lane_numbers() {
  if constexpr (std::is_same_v<T, double>)
    return load<f64x8>(kLaneDouble);
  else if constexpr (std::is_same_v<T, int64_t>)
    return load<i64x8>(kLaneLong);
  else if constexpr (std::is_same_v<T, int32_t>)
    return load<i32x8>(kLaneInt);
  else
    return converted<T>(load<i32x8>(kLaneInt));
}

// min_of(max_of(f, low), high) + 0.0f, as in finish_depth (core/depth.h).
BIGTRI_INLINE f32x8 clamp_depth(f32x8 f, const f32x8& low, const f32x8& high) {
  for (int i = 0; i < f.kParts; ++i) {
    f.part[i] = f.part[i] < low.part[i] ? low.part[i] : f.part[i];
    f.part[i] = high.part[i] < f.part[i] ? high.part[i] : f.part[i];
  }
  return f + 0.0f;
}

// pack_depth (core/visibility.h) of each: the depth's bits in the upper half, the triangle in the lower half.
BIGTRI_INLINE i64x8 pack(const f32x8& z, uint32_t triangle) {
  i64x8 r;
#if BIGTRI_SIMD >= 512
  // The mask chooses the odd 32-bit elements: they take the depths. The even ones keep the triangle.
  const __m512i to_high = _mm512_setr_epi32(0, 0, 0, 1, 0, 2, 0, 3, 0, 4, 0, 5, 0, 6, 0, 7);
  r.part[0] = (i64x8::Vector)_mm512_mask_permutexvar_epi32(_mm512_set1_epi64(triangle), 0xaaaa, to_high,
                                                           _mm512_castsi256_si512((__m256i)z.part[0]));
#elif BIGTRI_SIMD >= 256
  const __m256i bits = (__m256i)z.part[0], low = _mm256_set1_epi64x(triangle);
  r.part[0] =
      (i64x8::Vector)_mm256_or_si256(_mm256_slli_epi64(_mm256_cvtepu32_epi64(_mm256_castsi256_si128(bits)), 32), low);
  r.part[1] = (i64x8::Vector)_mm256_or_si256(
      _mm256_slli_epi64(_mm256_cvtepu32_epi64(_mm256_extracti128_si256(bits, 1)), 32), low);
#else
  uint32_t bits[8];
  __builtin_memcpy(bits, &z, sizeof bits);
  int64_t packed[8];
  for (int i = 0; i < 8; ++i) packed[i] = (int64_t)((uint64_t)bits[i] << 32 | triangle);
  r = load<i64x8>(packed);
#endif
  return r;
}

// If bit i is set: pixels[i] = min(pixels[i], packed[i]). All eight are loaded and stored. Signed comparisons are
// right, because packed values are not negative.
BIGTRI_INLINE void keep_nearest(int64_t* pixels, const i64x8& packed, uint32_t bits) {
#if BIGTRI_SIMD >= 512
  const __m512i old = _mm512_loadu_si512(pixels);
  _mm512_storeu_si512(pixels, _mm512_mask_min_epi64(old, (__mmask8)bits, old, (__m512i)packed.part[0]));
#elif BIGTRI_SIMD >= 256
  // Element k of part i is taken if bit 4 * i + k is set; `lane` holds that bit.
  const __m256i all = _mm256_set1_epi64x((int64_t)bits);
  for (int i = 0; i < 2; ++i) {
    const __m256i lane = _mm256_set_epi64x(8 << 4 * i, 4 << 4 * i, 2 << 4 * i, 1 << 4 * i);
    const __m256i old = _mm256_loadu_si256((const __m256i*)(pixels + 4 * i)), offered = (__m256i)packed.part[i];
    const __m256i taken =
        _mm256_and_si256(_mm256_cmpgt_epi64(old, offered), _mm256_cmpeq_epi64(_mm256_and_si256(all, lane), lane));
    _mm256_storeu_si256((__m256i*)(pixels + 4 * i), _mm256_blendv_epi8(old, offered, taken));
  }
#else
  for (int i = 0; i < 8; ++i)
    if ((bits >> i & 1) && packed[i] < pixels[i]) pixels[i] = packed[i];
#endif
}

// pixels[i] = min(pixels[i], packed[i]).
BIGTRI_INLINE void keep_nearest(int64_t* pixels, const i64x8& packed) {
#if BIGTRI_SIMD >= 512
  _mm512_storeu_si512(pixels, _mm512_min_epi64(_mm512_loadu_si512(pixels), (__m512i)packed.part[0]));
#elif BIGTRI_SIMD >= 256
  for (int i = 0; i < 2; ++i) {
    const __m256i old = _mm256_loadu_si256((const __m256i*)(pixels + 4 * i)), offered = (__m256i)packed.part[i];
    _mm256_storeu_si256((__m256i*)(pixels + 4 * i), _mm256_blendv_epi8(old, offered, _mm256_cmpgt_epi64(old, offered)));
  }
#else
  for (int i = 0; i < 8; ++i) pixels[i] = packed[i] < pixels[i] ? packed[i] : pixels[i];
#endif
}

// Appends (code + kBin * j) << 8 | byte j of the mask, for each byte that is not 0, from list[n] on. code: the tile's
// first pixel within the bin. Returns the new n.
// It may write as far as list[n + 7], whatever the mask. AVX-512 moves the elements to keep together with one compress;
// the loop writes each element and advances only past those to keep.
BIGTRI_INLINE int append_rows(uint64_t mask, uint32_t code, uint32_t* list, int n) {
#if BIGTRI_SIMD >= 512
  const __m256i bytes = _mm256_cvtepu8_epi32(_mm_cvtsi64_si128((int64_t)mask));
  const __mmask8 some = _mm256_test_epi32_mask(bytes, bytes);
  const __m256i row = _mm256_setr_epi32(0, kBin, 2 * kBin, 3 * kBin, 4 * kBin, 5 * kBin, 6 * kBin, 7 * kBin);
  const __m256i items =
      _mm256_or_si256(_mm256_slli_epi32(_mm256_add_epi32(_mm256_set1_epi32((int)code), row), 8), bytes);
  _mm256_storeu_si256((__m256i*)(list + n), _mm256_maskz_compress_epi32(some, items));
  return n + __builtin_popcount(some);
#else
  for (int j = 0; j < kTile; ++j) {
    const uint32_t bits = mask >> (8 * j) & 0xff;
    list[n] = (code + kBin * j) << 8 | bits;
    n += bits != 0;
  }
  return n;
#endif
}

// depth_of (core/visibility.h) of each. The upper half of a background pixel is 0x7fffffff, above the bits of infinity;
// that of any other pixel is below them. So an integer minimum with infinity's bits is enough.
BIGTRI_INLINE f32x8 depths_of(const i64x8& packed) {
  f32x8 r;
#if BIGTRI_SIMD >= 512
  const __m256i high = _mm512_cvtepi64_epi32(_mm512_srli_epi64((__m512i)packed.part[0], 32));
  r.part[0] = (f32x8::Vector)_mm256_min_epi32(high, _mm256_set1_epi32(0x7f800000));
#elif BIGTRI_SIMD >= 256
  const __m256i high = halves<_MM_SHUFFLE(3, 1, 3, 1)>(packed);
  r.part[0] = (f32x8::Vector)_mm256_min_epi32(high, _mm256_set1_epi32(0x7f800000));
#else
  float f[8];
  for (int i = 0; i < 8; ++i) f[i] = depth_of(packed[i]);
  r = load<f32x8>(f);
#endif
  return r;
}

// Sixteen groups of four floats: out[c] takes element c of each. The fourth ones are left behind.
BIGTRI_INLINE void load_triples(const float* from, f32x16 out[3]) {
#if BIGTRI_SIMD >= 512
  // Elements c and c + 1 of eight groups each, then of all sixteen.
  const __m512i pairs = _mm512_setr_epi32(0, 4, 8, 12, 16, 20, 24, 28, 1, 5, 9, 13, 17, 21, 25, 29);
  const __m512i third = _mm512_add_epi32(pairs, _mm512_set1_epi32(2));
  const __m512 a = _mm512_loadu_ps(from), b = _mm512_loadu_ps(from + 16), c = _mm512_loadu_ps(from + 32),
               d = _mm512_loadu_ps(from + 48);
  const __m512 low = _mm512_permutex2var_ps(a, pairs, b), high = _mm512_permutex2var_ps(c, pairs, d);
  out[0].part[0] = (f32x16::Vector)_mm512_shuffle_f32x4(low, high, _MM_SHUFFLE(1, 0, 1, 0));
  out[1].part[0] = (f32x16::Vector)_mm512_shuffle_f32x4(low, high, _MM_SHUFFLE(3, 2, 3, 2));
  out[2].part[0] = (f32x16::Vector)_mm512_shuffle_f32x4(_mm512_permutex2var_ps(a, third, b),
                                                        _mm512_permutex2var_ps(c, third, d), _MM_SHUFFLE(1, 0, 1, 0));
#elif BIGTRI_SIMD >= 256
  for (int i = 0; i < 2; ++i) {
    __m256 both[4];  // group k in the lower half, group k + 4 in the upper one
    for (int k = 0; k < 4; ++k)
      both[k] = _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps(from + 32 * i + 4 * k)),
                                     _mm_loadu_ps(from + 32 * i + 4 * (k + 4)), 1);
    const __m256 low = _mm256_unpacklo_ps(both[0], both[1]), high = _mm256_unpacklo_ps(both[2], both[3]);
    out[0].part[i] = (f32x16::Vector)_mm256_shuffle_ps(low, high, _MM_SHUFFLE(1, 0, 1, 0));
    out[1].part[i] = (f32x16::Vector)_mm256_shuffle_ps(low, high, _MM_SHUFFLE(3, 2, 3, 2));
    out[2].part[i] = (f32x16::Vector)_mm256_shuffle_ps(_mm256_unpackhi_ps(both[0], both[1]),
                                                       _mm256_unpackhi_ps(both[2], both[3]), _MM_SHUFFLE(1, 0, 1, 0));
  }
#else
  float element[3][16];
  for (int i = 0; i < 16; ++i)
    for (int c = 0; c < 3; ++c) element[c][i] = from[4 * i + c];
  for (int c = 0; c < 3; ++c) out[c] = load<f32x16>(element[c]);
#endif
}

// Writes the three lower bytes of each of sixteen words, one behind the other.
BIGTRI_INLINE void store_triples(uint8_t* to, const u32x16& v) {
#if BIGTRI_SIMD >= 256
  const __m128i without_fourth = _mm_setr_epi8(0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, -1, -1, -1, -1);
#endif
#if BIGTRI_SIMD >= 512
  const __m512i packed = _mm512_shuffle_epi8((__m512i)v.part[0], _mm512_broadcast_i32x4(without_fourth));
  const __m512i in_front = _mm512_setr_epi32(0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, 3, 7, 11, 15);
  _mm512_mask_storeu_epi32(to, 0xfff, _mm512_permutexvar_epi32(in_front, packed));
#elif BIGTRI_SIMD >= 256
  for (int i = 0; i < 2; ++i) {
    const __m256i packed = _mm256_shuffle_epi8((__m256i)v.part[i], _mm256_broadcastsi128_si256(without_fourth));
    const __m256i in_front = _mm256_permutevar8x32_epi32(packed, _mm256_setr_epi32(0, 1, 2, 4, 5, 6, 3, 7));
    _mm_storeu_si128((__m128i*)(to + 24 * i), _mm256_castsi256_si128(in_front));
    _mm_storel_epi64((__m128i*)(to + 24 * i + 16), _mm256_extracti128_si256(in_front, 1));
  }
#else
  for (int i = 0; i < 16; ++i) {
    const uint32_t word = v[i];
    __builtin_memcpy(to + 3 * i, &word, 3);
  }
#endif
}

// Streaming store: past the caches, for memory that is not read again soon. `to` is 64-byte aligned. Other threads see
// it after a fence (StoreFence in thread_pool.cpp).
BIGTRI_INLINE void stream(int64_t* to, const i64x8& v) {
#if BIGTRI_SIMD >= 512
  _mm512_stream_si512((__m512i*)to, (__m512i)v.part[0]);
#elif BIGTRI_SIMD >= 256
  for (int i = 0; i < 2; ++i) _mm256_stream_si256((__m256i*)(to + 4 * i), (__m256i)v.part[i]);
#else
  store(to, v);
#endif
}

// The same; `to` is 32-byte aligned.
BIGTRI_INLINE void stream(float* to, const f32x8& v) {
#if BIGTRI_SIMD >= 256
  _mm256_stream_ps(to, (__m256)v.part[0]);
#else
  store(to, v);
#endif
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

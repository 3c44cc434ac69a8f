// Numbers of two float32 words, for GPUs on which float64 is slow (kSlowFloat64). They are never a result: they decide
// what a float64 formula of the contract rounds to, where bounds on the errors of both allow that. Where they do not,
// the formula itself is computed, so the bits are the same.
//
// u is 2^-24. |lo| <= u * |hi| in every pair that a function returns. The bounds hold as long as nothing overflows. What
// underflows adds less than 2^-140 to a result below 2^20, which callers add to their bounds.
#pragma once

#include "platform.h"

namespace bigtri {

// hi + lo
struct alignas(8) FloatPair {
  float hi, lo;
};

// a * b + c, rounded once.
BIGTRI_HD float multiply_add(float a, float b, float c) {
#if defined(__CUDA_ARCH__)
  return __fmaf_rn(a, b, c);
#else
  return __builtin_fmaf(a, b, c);
#endif
}

// a + b exactly.
BIGTRI_HD FloatPair two_sum(float a, float b) {
  const float s = a + b, shadow = s - a;
  return {s, (a - (s - shadow)) + (b - shadow)};
}

// The same where |a| >= |b|, or a is 0.
BIGTRI_HD FloatPair ordered_sum(float a, float b) {
  const float s = a + b;
  return {s, b - (s - a)};
}

// a * b exactly.
BIGTRI_HD FloatPair two_product(float a, float b) {
  const float p = a * b;
  return {p, multiply_add(a, b, -p)};
}

// Off by 4 u^2 (|a| + |b|) at most: the sum of the low words and the sum with what the high ones leave are rounded, at
// u (|a| + |b|) and 2 u (|a| + |b|).
BIGTRI_HD FloatPair sum(FloatPair a, FloatPair b) {
  const FloatPair s = two_sum(a.hi, b.hi);
  return two_sum(s.hi, s.lo + (a.lo + b.lo));
}

// Off by 4 u^2 |a * b| at most: one sum is rounded, at 2 u |a * b|.
BIGTRI_HD FloatPair product(float a, FloatPair b) {
  const FloatPair p = two_product(a, b.hi);
  return ordered_sum(p.hi, multiply_add(a, b.lo, p.lo));
}

// Off by 8 u^2 |a * b| at most: two sums are rounded, at 2 and 3 u |a * b|, and lo * lo is left out.
BIGTRI_HD FloatPair product(FloatPair a, FloatPair b) {
  const FloatPair p = two_product(a.hi, b.hi);
  return ordered_sum(p.hi, multiply_add(a.lo, b.hi, multiply_add(a.hi, b.lo, p.lo)));
}

// 1 / a, off by 32 u^2 of it at most, for 2^-60 <= a <= 2^60. With the quotient r = (1 + d) / a.hi, |d| <= u, what is left
// is e = 1 - r * a, at most 3 u, and 1 / a = r (1 + e + e^2 + ...). Left out is e^2, 9 u^2; rounded are the two steps of e,
// at 2 u and 3 u, and the product with r, at 3 u: 17 u^2 in all.
BIGTRI_HD FloatPair inverse(FloatPair a) {
#if defined(__CUDA_ARCH__)
  const float r = __frcp_rn(a.hi);
#else
  const float r = 1.0f / a.hi;
#endif
  return ordered_sum(r, r * multiply_add(-r, a.lo, multiply_add(-r, a.hi, 1.0f)));
}

// v exactly, |v| < 2^49: multiples of 2^25 below 2^49, and what is left, of 2^24 at most.
BIGTRI_HD FloatPair pair_of(int64_t v) {
  const int32_t high = (int32_t)((v + (1 << 24)) >> 25), low = (int32_t)(v - ((int64_t)high << 25));
  return ordered_sum((float)high * 33554432.0f, (float)low);
}

// v as a float32, exactly, for 0 <= v < 2^23, without a conversion: as exact_double.
BIGTRI_HD float exact_float(int v) { return bits_float(0x4b000000u | (uint32_t)v) - 8388608.0f; }

// Whether every number within `error` of hi + lo, bounds included, rounds to the same float32, which becomes *rounded.
// |hi + lo| + error <= `most`; `error` has to hold 3 u^2 `most` for the roundings here. Rounding is monotone, so all
// numbers between two that round alike do.
BIGTRI_HD bool rounds_alike(float hi, float lo, float error, float* rounded) {
  const float low = hi + (lo - error), high = hi + (lo + error);
  *rounded = low;
  return low == high;
}

}  // namespace bigtri

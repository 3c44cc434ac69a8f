// Weights of corners by multiplication where docs/numerics.md 9 divides, and whether that decides what the rule's weights
// are rounded to, which it does but for one pixel in a million: a division takes as long as ten products.
//
// With edge values that are not negative, as weights of slots never are (cut_weight), nothing cancels, and rounding 30
// times at most, here and by the rule together, moves a result by less than 2^-48 of it; an inverse here counts for two.
// That is half of what round_surely() allows for. All w are divided by where the rule does not, because they are equal:
// that changes nothing but the rounding, since edge values have the sum `area`.
#pragma once

#include "../core/attributes.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr bool kNearWeights = kAttributeRule == AttributeRule::kFloat64 && kSubpixelBits <= 8;

// 1 / v within 2^-52 of it, for positive v far from both ends of float64's range; beyond these a NaN or 0.
__device__ __forceinline__ double near_inverse(double v) {
  double r;  // within 2^-18 of it; the next step makes an error e to e^3, and rounds once
  asm("rcp.approx.ftz.f64 %0, %1;" : "=d"(r) : "d"(v));
  const double e = __fma_rn(-v, r, 1.0);
  return __fma_rn(r, __fma_rn(e, e, e), r);
}

// Brings b to a sum of 1.
__device__ __forceinline__ void share_out(double b[3]) {
  const double inverse = near_inverse((b[0] + b[1]) + b[2]);
  for (int k = 0; k < 3; ++k) b[k] = b[k] * inverse;
}

// Rounds b to float32. Returns whether every number within 2^-47 of b[k] is rounded to the same: where b[k] is not tiny,
// rounding takes away the lowest 29 bits, whose middle decides where to.
__device__ __forceinline__ bool round_surely(const double b[3], float weight[3]) {
  constexpr uint32_t kMiddle = 1u << 28, kNear = 64;  // units of 2^-52 of the largest power of two up to b[k]
  constexpr float kLeastSure = 1.0f / (1ull << 63);
  bool sure = true;
  for (int k = 0; k < 3; ++k) {
    weight[k] = (float)b[k];
    sure &= ((uint32_t)double_bits(b[k]) - kMiddle + kNear) << 3 > 2 * kNear << 3;
  }
  // Not so of one that is below 0 or a NaN. In a whole triangle one is, where an edge value is negative.
  return sure && weight[0] >= kLeastSure && weight[1] >= kLeastSure && weight[2] >= kLeastSure;
}

// Weights of a triangle that is not clipped, from its edge values at a pixel. Returns whether they are the rule's.
__device__ __forceinline__ bool near_weights(const int64_t e[3], const double inverse_w[3], float weight[3]) {
  double b[3];
  for (int k = 0; k < 3; ++k) b[k] = (double)e[k] * inverse_w[k];
  share_out(b);
  return round_surely(b, weight);
}

// The same of the slots of a clipped one, by a record that covers the pixel, whose vertices are the rows of t. Where other
// numbers than these edge values decide what is covered, one may be negative, so that terms cancel and yet no weight is
// below 0.
__device__ __forceinline__ bool near_weights(const int64_t e[3], const double inverse_w[3], const double t[3][3],
                                             float weight[3]) {
  double u[3], b[3];
  for (int k = 0; k < 3; ++k) u[k] = (double)e[k] * inverse_w[k];
  for (int m = 0; m < 3; ++m) b[m] = __fma_rn(u[2], t[2][m], __fma_rn(u[1], t[1][m], u[0] * t[0][m]));
  share_out(b);
  const bool sure = round_surely(b, weight);
  if constexpr (kFloatCoverage || Rung::kWraps) return sure && (e[0] | e[1] | e[2]) >= 0;
  return sure;
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

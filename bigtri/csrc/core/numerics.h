// Constants of the rung, edge functions and the fill rule; docs/numerics.md 1 and 3. Mirrors
// bigtri/reference/numerics.py. All stages from setup to attributes use them. The inline namespace is compiled once per
// rung.
#pragma once

#include "frame.h"
#include "precision.h"

#if !defined(BIGTRI_RUNG)
#error "BIGTRI_RUNG must name a rung of core/precision.h"
#endif

// A file that counts is compiled a second time (counters.h). That build gets a namespace of its own, so that the linker
// keeps both.
#if defined(BIGTRI_COUNTING)
#define BIGTRI_JOIN(A, B) A##B
#define BIGTRI_EXPAND_AND_JOIN(A, B) BIGTRI_JOIN(A, B)
#define BIGTRI_NAMESPACE BIGTRI_EXPAND_AND_JOIN(BIGTRI_RUNG, _counting)
#else
#define BIGTRI_NAMESPACE BIGTRI_RUNG
#endif

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

using Rung = rungs::BIGTRI_RUNG;

constexpr int kSubpixelBits = Rung::kSubpixelBits;
constexpr int kSubpixel = 1 << kSubpixelBits;  // subpx per px; s in numerics.md
constexpr int kHalf = kSubpixel / 2;  // from a pixel's border to its centre, subpx; h in numerics.md
// X and Y lie in [-kGuard, kGuard - 1] subpx; G in numerics.md
constexpr int kGuard = 1 << (kSubpixelBits <= 15 ? 15 + kSubpixelBits : 30);
// All bounds on integers in core/ are proved for 8 sub-pixel bits. Fewer bits only make the integers smaller. More need
// kWideEdges; numerics.md 14 has the bounds for those.
static_assert(kSubpixelBits <= 8 || (Rung::kWideEdges && kSubpixelBits <= 16), "more bits need wider integers");
// f of an edge at a pixel of a bin; and at any pixel, where it may need 42 bits.
using EdgeNumber = std::conditional_t<Rung::kWideEdges, int64_t, int32_t>;
using StepNumber = std::conditional_t<Rung::kWraps, int32_t, int64_t>;
constexpr bool kFloatCoverage = Rung::kCoverage != CoverageRule::kFixed;
// Whether coverage is that of vertices that are not snapped.
constexpr bool kUnsnapped =
    Rung::kCoverage == CoverageRule::kFloat32Inclusive || Rung::kCoverage == CoverageRule::kFloat32Strict;
constexpr int64_t kLargeThreshold = 4000;  // a record whose bbox has more pixels is large; numerics.md 4
constexpr int64_t kThinRatio = 32;  // decides which records are thin; numerics.md 7

// Where a sample lies in its pixel, subpx from the pixel's upper left corner. So far every sample is the centre.
struct SamplePoint {
  int32_t x, y;
};
constexpr SamplePoint kCentre = {kHalf, kHalf};

// One edge of a triangle of positive area, from P along (dx, dy), subpx. Coordinates lie in [-2^23, 2^23), so
// |dx|, |dy| < 2^24: 25 bits with the sign.
struct Edge {
  int32_t px, py, dx, dy;
};

// Edge k is opposite vertex k: it runs from vertex k + 1 to vertex k + 2, mod 3.
BIGTRI_HD Edge edge_of(const int32_t x[3], const int32_t y[3], int k) {
  const int p = k == 2 ? 0 : k + 1, q = p == 2 ? 0 : p + 1;
  return {x[p], y[p], x[q] - x[p], y[q] - y[p]};
}

// e at (sx, sy), subpx^2. Samples lie in the guard band too, so both products are of differences below 2^24. Hence
// |e| < 2 * 2^48 = 2^49: 50 bits with the sign.
BIGTRI_HD int64_t edge_value(const Edge& e, int32_t sx, int32_t sy) {
  return (int64_t)e.dx * (sy - e.py) - (int64_t)e.dy * (sx - e.px);
}

// e of a triangle's edges at (sx, sy), with the sample as the origin: fewer operations for all three together.
BIGTRI_HD void edge_values(const int32_t x[3], const int32_t y[3], int32_t sx, int32_t sy, int64_t e[3]) {
  for (int k = 0; k < 3; ++k) {
    const int p = k == 2 ? 0 : k + 1, q = p == 2 ? 0 : p + 1;
    e[k] = (int64_t)(x[p] - sx) * (y[q] - sy) - (int64_t)(x[q] - sx) * (y[p] - sy);
  }
}

// Top-left rule: 0 if the edge owns the samples on it, else -1. | and & instead of || and && avoid branches.
BIGTRI_HD int64_t edge_bias(const Edge& e) { return ((e.dy < 0) | ((e.dy == 0) & (e.dx > 0))) - 1; }

// The centre of pixel p, subpx.
BIGTRI_HD int32_t pixel_centre(int32_t p) { return p * kSubpixel + kHalf; }

// The edge value f in steps of a pixel, subpx: floor((value + bias) / kSubpixel), since >> rounds down. A sample is
// covered where f >= 0 for all three edges. From one pixel to the next, f changes by exactly -dy in x and +dx in y.
BIGTRI_HD int64_t steps_of(int64_t value, const Edge& e) { return (value + edge_bias(e)) >> kSubpixelBits; }

// The same where edge values wrap around; numerics.md 14.1. The value is computed at the first pixel of the 64x64 px
// cell alone, in unsigned arithmetic, since signed numbers must not overflow. f is then below 2^23 in magnitude. Steps
// within the cell add at most 63 * 2^25, so f stays below 63/64 * 2^31 + 2^23 < 2^31: nothing else wraps.
BIGTRI_HD int32_t wrapped_steps(const Edge& e, int32_t x, int32_t y, SamplePoint at) {
  const int32_t left = x & -kBin, top = y & -kBin;
  const uint32_t value = (uint32_t)e.dx * (uint32_t)(top * kSubpixel + at.y - e.py) -
                         (uint32_t)e.dy * (uint32_t)(left * kSubpixel + at.x - e.px) + (uint32_t)edge_bias(e);
  return ((int32_t)value >> kSubpixelBits) + ((y - top) * e.dx - (x - left) * e.dy);
}

// f at the sample point of pixel (x, y).
BIGTRI_HD StepNumber edge_steps(const Edge& e, int32_t x, int32_t y, SamplePoint at = kCentre) {
  if constexpr (Rung::kWraps) return wrapped_steps(e, x, y, at);
  return steps_of(edge_value(e, x * kSubpixel + at.x, y * kSubpixel + at.y), e);
}

// Twice the signed area, subpx^2; > 0 is clockwise on the screen (y down). |area| < 2^49, as edge_value.
BIGTRI_HD int64_t twice_area(const int32_t x[3], const int32_t y[3]) {
  return (int64_t)(x[1] - x[0]) * (y[2] - y[0]) - (int64_t)(y[1] - y[0]) * (x[2] - x[0]);
}

// v as float64, for v >= 0. A GPU adds faster than it converts. Its version ORs v into the lowest bits of 2^52, which
// makes 2^52 + v, and subtracts 2^52.
BIGTRI_HD double exact_double(int v) {
#if defined(__CUDA_ARCH__)
  return bits_double(0x4330000000000000ull | (uint32_t)v) - 4503599627370496.0;
#else
  return v;
#endif
}

// A divisor of several numbers. A GPU needs some thirty instructions for a division, but five if it has the divisor's
// correctly rounded inverse: a quotient that is corrected twice by its exact remainder is correctly rounded (Markstein
// 1990, "Computation of elementary functions on the IBM RISC System/6000 processor", theorem 8.1 and its consequences).
// That holds where nothing overflows or underflows, which quotients of floats and edge values in float64 cannot do.
//
// A quotient of zero may get the other sign. No caller depends on it: snapping rounds to an integer, window_depth adds
// 0.5, and finish_depth adds +0.0f.
struct Divisor {
  double value;
#if defined(__CUDACC__)
  double inverse;  // 1 / value, rounded; set and used only on the GPU
#endif
};

BIGTRI_HD Divisor divisor(double v) {
  Divisor d;
  d.value = v;
#if defined(__CUDA_ARCH__)
  d.inverse = __drcp_rn(v);
#endif
  return d;
}

template <class D>
BIGTRI_HD D quotient(D v, double by) {
  return v / by;
}
BIGTRI_HD float quotient(float v, const Divisor& by) { return v / (float)by.value; }
BIGTRI_HD double quotient(double v, const Divisor& by) {
#if defined(__CUDA_ARCH__)
  double q = v * by.inverse;
  q = __fma_rn(__fma_rn(-by.value, q, v), by.inverse, q);
  return __fma_rn(__fma_rn(-by.value, q, v), by.inverse, q);
#else
  return v / by.value;
#endif
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// Constants and edge functions; docs/numerics.md 1 and 3. Mirrors bigtri/reference/numerics.py. What stands in the inline namespace is compiled once per rung.
#pragma once

#include "frame.h"
#include "precision.h"

#if !defined(BIGTRI_RUNG)
#error "BIGTRI_RUNG must name a rung of core/precision.h"
#endif

// Files that count are compiled twice; what they compile to must not be merged either.
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
constexpr int kSubpixel = 1 << kSubpixelBits;  // 1 px in subpx
constexpr int kHalf = kSubpixel / 2;  // half a pixel
constexpr int kGuard = 1 << (15 + kSubpixelBits);  // X and Y lie in [-kGuard, kGuard - 1] subpx
// Every bound below is for 8 bits and holds for fewer, which make all integers smaller.
static_assert(kSubpixelBits <= 8, "more sub-pixel bits need wider integers");
constexpr int64_t kLargeThreshold = 4000;  // px of bbox; not above: the direct path
constexpr int64_t kThinRatio = 32;  // numerics.md 7

// Where in its pixel a sample lies, subpx from the pixel's corner.
struct SamplePoint {
  int32_t x, y;
};
constexpr SamplePoint kCentre = {kHalf, kHalf};

// One edge of a positively oriented triangle, from P along (dx, dy); subpx. Differences of coordinates in [-2^23, 2^23) fit 25 bits.
struct Edge {
  int32_t px, py, dx, dy;
};

// Edge k of a record is opposite its vertex k.
BIGTRI_HD Edge edge_of(const int32_t x[3], const int32_t y[3], int k) {
  const int p = k == 2 ? 0 : k + 1, q = p == 2 ? 0 : p + 1;
  return {x[p], y[p], x[q] - x[p], y[q] - y[p]};
}

// Products of two such differences: e fits 50 bits, int64 is exact.
BIGTRI_HD int64_t edge_value(const Edge& e, int32_t sx, int32_t sy) {
  return (int64_t)e.dx * (sy - e.py) - (int64_t)e.dy * (sx - e.px);
}

// Top-left rule: 0 where the edge owns the samples on it, else -1.
BIGTRI_HD int64_t edge_bias(const Edge& e) { return ((e.dy < 0) | ((e.dy == 0) & (e.dx > 0))) - 1; }  // no branches

// The centre of pixel p, subpx.
BIGTRI_HD int32_t pixel_centre(int32_t p) { return p * kSubpixel + kHalf; }

// f = floor((value + bias)/kSubpixel): at pixel centres covered where >= 0 for all three edges; changes by -dy and +dx per pixel.
BIGTRI_HD int64_t steps_of(int64_t value, const Edge& e) { return (value + edge_bias(e)) >> kSubpixelBits; }

// f at the sample point of pixel (x, y).
BIGTRI_HD int64_t edge_steps(const Edge& e, int32_t x, int32_t y, SamplePoint at = kCentre) {
  return steps_of(edge_value(e, x * kSubpixel + at.x, y * kSubpixel + at.y), e);
}

// Twice the signed area, subpx^2; > 0 is clockwise on the screen (y down).
BIGTRI_HD int64_t twice_area(const int32_t x[3], const int32_t y[3]) {
  return (int64_t)(x[1] - x[0]) * (y[2] - y[0]) - (int64_t)(y[1] - y[0]) * (x[2] - x[0]);
}

// Of a number from 0 on. A GPU adds faster than it converts: 2^52 + v is the bits of 2^52 with v in the lowest ones.
BIGTRI_HD double exact_double(int v) {
#if defined(__CUDA_ARCH__)
  return bits_double(0x4330000000000000ull | (uint32_t)v) - 4503599627370496.0;
#else
  return v;
#endif
}

// What several numbers are divided by. A GPU divides in some thirty instructions, but in five by a number whose correctly rounded inverse is there: a quotient corrected twice by its exact
// remainder is correctly rounded too (Markstein 1990, "Computation of elementary functions on the IBM RISC System/6000 processor", theorem 8.1 and what follows from it), where
// nothing overflows or underflows, as floats and edge values cannot. A zero may have the other sign: no use of them here minds.
struct Divisor {
  double value;
#if defined(__CUDACC__)
  double inverse;  // for the GPU alone
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

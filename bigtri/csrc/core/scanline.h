// Exact spans of covered pixels; docs/numerics.md 6. Mirrors bigtri/reference/scanline.py.
#pragma once

#include "numerics.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

// floor(n / d) for 0 <= n < 2^52 and 0 < d < 2^52, by a float64 division, several times faster than an integer one on CPU and GPU. Rounding cannot reach an integer m that n / d stays below:
// it is 1/d away at least, and half a unit of m's last place is m * 2^-53 < 1/d.
BIGTRI_HD int64_t floor_quotient(int64_t n, int64_t d) { return (int64_t)((double)n / (double)d); }

// The pixels i in [lower, upper) of a row where f + step * i >= 0, cut to the interval given.
BIGTRI_HD void cut_span(int64_t f, int64_t step, int64_t* lower, int64_t* upper) {
  if (step == 0) {
    if (f < 0) *upper = *lower;
  } else if (step > 0) {  // first i with step * i >= -f
    const int64_t first = f >= 0 ? 0 : floor_quotient(-f + step - 1, step);
    *lower = max_of(*lower, first);
  } else {  // last i with -step * i <= f
    const int64_t end = f < 0 ? 0 : floor_quotient(f, -step) + 1;
    *upper = min_of(*upper, end);
  }
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

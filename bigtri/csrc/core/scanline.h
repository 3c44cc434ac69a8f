// Exact spans of covered pixels in a row; docs/numerics.md 6. The stage `scanline` and the variant of that
// name cut rows to spans; bin_owned tests eight pixels of a row at once instead. Mirrors bigtri/reference/scanline.py.
#pragma once

#include "numerics.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

// floor(n / d) for 0 <= n < 2^52 and 0 < d < 2^52. A float64 division is several times faster than an integer one, on
// CPU and GPU. It cannot round up to the next integer m > n / d: m - n / d >= 1/d, while rounding moves a number just
// below m by at most half a unit in its last place, m * 2^-53. From m * d <= n + d < 2^53 follows m * 2^-53 < 1/d.
BIGTRI_HD int64_t floor_quotient(int64_t n, int64_t d) { return (int64_t)((double)n / (double)d); }

// Cuts [lower, upper) to the pixels i of a row where f + step * i >= 0. f is the value at i = 0; lower >= 0.
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

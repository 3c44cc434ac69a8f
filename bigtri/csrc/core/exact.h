// Sums of products in float64 that are rounded once, however much cancels on the way; docs/numerics.md 2.1. Mirrors bigtri/reference/exact.py, which names the sources.
// Exact as long as no product leaves float64's normal range; nothing but + - *.
#pragma once

#include "platform.h"

namespace bigtri {

// The rounded sum and its error.
BIGTRI_HD void two_sum(double a, double b, double* sum, double* error) {
  const double s = a + b, shadow = s - a;
  *sum = s;
  *error = (a - (s - shadow)) + (b - shadow);
}

// 53 bits into 26 and 26 (and a sign).
BIGTRI_HD void split(double a, double* high, double* low) {
  const double c = 134217729.0 * a;  // 2^27 + 1
  *high = c - (c - a);
  *low = a - *high;
}

// The rounded product and its error.
BIGTRI_HD void two_product(double a, double b, double* product, double* error) {
  double ah, al, bh, bl;
  split(a, &ah, &al);
  split(b, &bh, &bl);
  const double p = a * b;
  double e = p - ah * bh;
  e = e - al * bh;
  e = e - ah * bl;
  *product = p;
  *error = al * bl - e;
}

// The exact sum of the terms, rounded once, half to even.
template <int kTerms>
BIGTRI_HD double rounded_sum(const double terms[kTerms]) {
  // An expansion: parts in ascending order whose bits do not overlap, so that together they are the exact sum. Some may be zero.
  double parts[kTerms];
  for (int n = 0; n < kTerms; ++n) {
    double term = terms[n];
    for (int i = 0; i < n; ++i) two_sum(term, parts[i], &term, &parts[i]);
    parts[n] = term;
  }
  // From the largest part down until something does not fit: that is what rounding leaves out, and its sign is the rest's.
  double total = parts[kTerms - 1], rest = 0.0, below = 0.0;
  for (int i = kTerms - 2; i >= 0; --i) {
    if (rest == 0.0)
      two_sum(total, parts[i], &total, &rest);
    else if (below == 0.0)
      below = parts[i];
  }
  // If the rest looked like exactly half a unit, rounding went to even; what lies below it decides the other way.
  const double doubled = 2.0 * rest, moved = total + doubled;
  const bool same_sign = (rest > 0.0 && below > 0.0) || (rest < 0.0 && below < 0.0);
  return same_sign && moved - total == doubled ? moved : total;
}

}  // namespace bigtri

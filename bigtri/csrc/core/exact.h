// Sums of float64 products that are rounded once, however much cancels on the way; docs/numerics.md 2.1. Clipping makes
// new vertices with them. Mirrors bigtri/reference/exact.py, which names the sources. The functions use only +, -
// and *, and are exact as long as no product leaves float64's normal range.
#pragma once

#include "platform.h"

namespace bigtri {

// sum + error == a + b exactly; sum is a + b rounded.
BIGTRI_HD void two_sum(double a, double b, double* sum, double* error) {
  const double s = a + b, shadow = s - a;
  *sum = s;
  *error = (a - (s - shadow)) + (b - shadow);
}

// high + low == a exactly. The 53 bits become 26 and 26: the sign of low stands for one bit.
BIGTRI_HD void split(double a, double* high, double* low) {
  const double c = 134217729.0 * a;  // 2^27 + 1
  *high = c - (c - a);
  *low = a - *high;
}

// product + error == a * b exactly; product is a * b rounded.
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
  // parts is an expansion: its sum is exactly that of the terms, its elements ascend in magnitude, and their bits do
  // not overlap. Some may be zero.
  double parts[kTerms];
  for (int n = 0; n < kTerms; ++n) {
    double term = terms[n];
    for (int i = 0; i < n; ++i) two_sum(term, parts[i], &term, &parts[i]);
    parts[n] = term;
  }
  // Add the parts from the largest down until one does not fit into total. rest is then what rounding left out of
  // total, and below is the next part that is not zero.
  double total = parts[kTerms - 1], rest = 0.0, below = 0.0;
  for (int i = kTerms - 2; i >= 0; --i) {
    if (rest == 0.0)
      two_sum(total, parts[i], &total, &rest);
    else if (below == 0.0)
      below = parts[i];
  }
  // If rest is exactly half a unit in total's last place, total was rounded to even without regard to below. If below
  // has the sign of rest, the exact sum lies beyond the half, and total moves by a whole unit, twice the rest. If
  // rest is not half a unit, adding twice the rest rounds, and moved - total == doubled does not hold.
  const double doubled = 2.0 * rest, moved = total + doubled;
  const bool same_sign = (rest > 0.0 && below > 0.0) || (rest < 0.0 && below < 0.0);
  return same_sign && moved - total == doubled ? moved : total;
}

}  // namespace bigtri

// Barycentrics and interpolation; docs/numerics.md 9. Mirrors bigtri/reference/attributes.py.
#pragma once

#include "resolve.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

// e_k at the centre of pixel (x, y), as float64: exact, since |e| < 2^50.
BIGTRI_HD double edge_at(const Primitive& p, int k, int32_t x, int32_t y) {
  return (double)edge_value(edge_of(p.x, p.y, k), pixel_centre(x), pixel_centre(y));
}

// From e_k to the weights of the record's vertices (not clipped) or of the slots (clipped), in that order, not yet rounded to float32. D is double or a vector of doubles.
template <int kRecords, class D>
BIGTRI_HD void barycentrics(const ParentOf<kRecords>& parent, int record, const D e[3], D b[3]) {
  const double area = (double)parent.primitive[record].area;
  for (int k = 0; k < 3; ++k) b[k] = e[k] / area;
  if (parent.affine) return;
  for (int k = 0; k < 3; ++k) b[k] = b[k] / parent.w[record][k];
  if (parent.clipped) {
    const double (*t)[3] = parent.weights[record];
    const D u0 = b[0], u1 = b[1], u2 = b[2];
    for (int m = 0; m < 3; ++m) b[m] = (u0 * t[0][m] + u1 * t[1][m]) + u2 * t[2][m];
  }
  const D sum = (b[0] + b[1]) + b[2];
  for (int m = 0; m < 3; ++m) b[m] = b[m] / sum;
}

template <class F>
BIGTRI_HD F interpolate(const F b[3], float a0, float a1, float a2) {
  return (b[0] * a0 + b[1] * a1) + b[2] * a2;
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// Barycentrics and interpolation of attributes; docs/numerics.md 9. The attribute pass uses them at each pixel, with
// the record that resolve found. Mirrors bigtri/reference/attributes.py.
#pragma once

#include "resolve.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

// e_k at the centre of pixel (x, y), unbiased. float64 holds it exactly, since |e| < 2^49 (edge_value).
BIGTRI_HD double edge_at(const Primitive& p, int k, int32_t x, int32_t y) {
  return (double)edge_value(edge_of(p.x, p.y, k), pixel_centre(x), pixel_centre(y));
}

// Barycentrics b from the edge values e, not yet rounded to float32. They are the weights of the record's vertices if
// the parent is not clipped, else of the slots, in that order. D is double or a vector of doubles.
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

// One attribute channel, in float32. a0, a1, a2: its values at the corners that b belongs to (corner_of).
template <class F>
BIGTRI_HD F interpolate(const F b[3], float a0, float a1, float a2) {
  return (b[0] * a0 + b[1] * a1) + b[2] * a2;
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

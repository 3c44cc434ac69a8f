// Barycentrics and interpolation; docs/numerics.md 9. Mirrors bigtri/reference/attributes.py.
#pragma once

#include "resolve.h"

namespace bigtri {

// e_k at the centre of pixel (x, y), as float64: exact, since |e| < 2^50.
BIGTRI_HD double edge_at(const Primitive& p, int k, int64_t x, int64_t y) {
  return (double)edge_value(edge_of(p.x, p.y, k), pixel_centre(x), pixel_centre(y));
}

// From e_k to the weights of the record's vertices (not clipped) or of the slots (clipped), in that order.
BIGTRI_HD void barycentrics(const Parent& parent, int record, const double e[3], float b[3]) {
  const double area = (double)parent.primitive[record].area;
  const double l0 = e[0] / area, l1 = e[1] / area, l2 = e[2] / area;
  if (parent.affine) {
    b[0] = (float)l0;
    b[1] = (float)l1;
    b[2] = (float)l2;
    return;
  }
  const double* w = parent.w[record];
  double v0 = l0 / w[0], v1 = l1 / w[1], v2 = l2 / w[2];
  if (parent.clipped) {
    const double(*t)[3] = parent.weights[record];
    const double u0 = v0, u1 = v1, u2 = v2;
    v0 = (u0 * t[0][0] + u1 * t[1][0]) + u2 * t[2][0];
    v1 = (u0 * t[0][1] + u1 * t[1][1]) + u2 * t[2][1];
    v2 = (u0 * t[0][2] + u1 * t[1][2]) + u2 * t[2][2];
  }
  const double sum = (v0 + v1) + v2;
  b[0] = (float)(v0 / sum);
  b[1] = (float)(v1 / sum);
  b[2] = (float)(v2 / sum);
}

BIGTRI_HD float interpolate(const float b[3], float a0, float a1, float a2) { return (b[0] * a0 + b[1] * a1) + b[2] * a2; }

}  // namespace bigtri

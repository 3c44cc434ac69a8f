// Points to clip space: an affine map in float64, rounded once. It comes before setup, which reads its results. Mirrors
// bigtri/reference/transform.py.
#pragma once

#include "platform.h"

namespace bigtri {

// m: [4, 4], row by row. The order of the sums is that of Camera.transform.
BIGTRI_HD void transform_point(const double* m, const float point[3], float out[4]) {
  const double x = point[0], y = point[1], z = point[2];
  for (int i = 0; i < 4; ++i) out[i] = (float)(((m[4 * i] * x + m[4 * i + 1] * y) + m[4 * i + 2] * z) + m[4 * i + 3]);
}

}  // namespace bigtri

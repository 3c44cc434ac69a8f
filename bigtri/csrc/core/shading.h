// Lambert shading and sRGB encoding of a pixel, in float32, the last stage, which follows attributes and textures; and
// what a texture's sRGB codes stand for. docs/numerics.md 11. Mirrors bigtri/reference/shading.py.
#pragma once

#include "platform.h"

namespace bigtri {

// Correctly rounded on the CPU and on the GPU.
#if defined(__CUDA_ARCH__)
BIGTRI_HD float square_root(float v) { return __fsqrt_rn(v); }
#else
BIGTRI_HD float square_root(float v) { return __builtin_sqrtf(v); }
#endif

// directions, colors: [lights, 3], of the lights. normal, albedo, ambient, out: [3]. The normal need not have length 1.
BIGTRI_HD void lambert(const float normal[3], const float albedo[3], const float ambient[3], const float* directions,
                       const float* colors, int64_t lights, float out[3]) {
  const float s = (normal[0] * normal[0] + normal[1] * normal[1]) + normal[2] * normal[2];
  float n[3] = {0.0f, 0.0f, 0.0f};
  if (s > 0.0f && is_finite(s)) {
    const float length = square_root(s);
    for (int i = 0; i < 3; ++i) n[i] = normal[i] / length;
  }
  float c[3] = {ambient[0], ambient[1], ambient[2]};
  for (int64_t l = 0; l < lights; ++l) {
    const float* d = directions + 3 * l;
    const float cosine = max_of((n[0] * d[0] + n[1] * d[1]) + n[2] * d[2], 0.0f);
    for (int i = 0; i < 3; ++i) c[i] = c[i] + colors[3 * l + i] * cosine;
  }
  for (int i = 0; i < 3; ++i) out[i] = albedo[i] * c[i];
}

// The linear value of a 16-bit sRGB code, correctly rounded: a test compares all 65536. 257 * c is the 8-bit code c.
BIGTRI_HD float decode_srgb(int code) {
  const double encoded = code / 65535.0;
  if (encoded <= 0.04045) return (float)(encoded / 12.92);
  // base^(12/5) is (base * r)^3 with r = base^(-1/5). base lies in [0.09, 1], where the polynomial is within 3.4 % of r.
  // Each step of Newton's method makes an error e to 3 * e^2, so that after four only float64's own rounding is left:
  // no value of a code lies so near the middle of two floats that it could decide which is the nearest.
  const double base = (encoded + 0.055) / 1.055;
  double r = (0.92 * base - 1.59) * base + 1.7;
  for (int step = 0; step < 4; ++step) {
    const double square = r * r;
    r = r * (1.2 - 0.2 * base * (square * square * r));
  }
  const double root = base * r;
  return (float)(root * root * root);
}

// The sRGB byte of a linear value: the number of thresholds ([255], ascending) that are <= v. The count goes on from
// `from`, which must not be above the result. A NaN gives `from`.
BIGTRI_HD uint8_t encode_srgb(float v, const float* thresholds, int from) {
  while (from < 255 && thresholds[from] <= v) ++from;
  return (uint8_t)from;
}

// The same by binary search, where a NaN gives 0. It takes eight comparisons for any v, so the threads of a warp do not
// diverge.
BIGTRI_HD uint8_t encode_srgb(float v, const float* thresholds) {
  int from = 0;
  for (int step = 128; step > 0; step /= 2)
    if (thresholds[from + step - 1] <= v) from += step;
  return (uint8_t)from;
}

}  // namespace bigtri

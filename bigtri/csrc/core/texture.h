// Texture sampling in float32; docs/numerics.md 10. It runs per pixel, on uv coordinates that the attribute pass
// interpolated. Mirrors bigtri/reference/texture.py.
#pragma once

#include "platform.h"

namespace bigtri {

enum class Filter : int { kNearest, kBilinear };
enum class Wrap : int { kRepeat, kClamp };

// floor(v) for |v| < 2^31, without a library call.
BIGTRI_HD float floor_small(float v) {
  const float t = (float)(int32_t)v;
  return t > v ? t - 1.0f : t;
}

// floor(v) for any finite v. From 2^23 = 8388608 on, every float is an integer.
BIGTRI_HD float floor_any(float v) {
  const float magnitude = v < 0 ? -v : v;
  return magnitude < 8388608.0f ? floor_small(v) : v;
}

// u or v, brought into [0, 1].
BIGTRI_HD float wrap_coordinate(float u, Wrap wrap) {
  if (wrap == Wrap::kRepeat) return u - floor_any(u);
  return min_of(max_of(u, 0.0f), 1.0f);
}

// The column or row of a texel, brought into [0, size).
BIGTRI_HD int wrap_texel(int i, int size, Wrap wrap) {
  if (wrap == Wrap::kClamp) return min_of(max_of(i, 0), size - 1);
  const int r = i % size;
  return r < 0 ? r + size : r;
}

// texture: [height, width, channels], row 0 on top. u, v: (0, 0) at the lower left. out: [channels].
BIGTRI_HD void sample(const float* texture, int height, int width, int64_t channels, float u, float v, Filter filter,
                      Wrap wrap, float* out) {
  if (!(is_finite(u) && is_finite(v))) u = v = 0.0f;
  u = wrap_coordinate(u, wrap);
  v = wrap_coordinate(v, wrap);
  if (filter == Filter::kNearest) {
    const int x = min_of((int)floor_small(u * (float)width), width - 1),
              y = min_of((int)floor_small((1.0f - v) * (float)height), height - 1);
    const float* texel = texture + ((int64_t)y * width + x) * channels;
    for (int64_t c = 0; c < channels; ++c) out[c] = texel[c];
    return;
  }
  const float x = u * (float)width - 0.5f, y = (1.0f - v) * (float)height - 0.5f;
  const float fx = floor_small(x), fy = floor_small(y), tx = x - fx, ty = y - fy;
  const int64_t x0 = wrap_texel((int)fx, width, wrap), x1 = wrap_texel((int)fx + 1, width, wrap);
  const int64_t y0 = wrap_texel((int)fy, height, wrap), y1 = wrap_texel((int)fy + 1, height, wrap);
  const float *c00 = texture + (y0 * width + x0) * channels, *c10 = texture + (y0 * width + x1) * channels;
  const float *c01 = texture + (y1 * width + x0) * channels, *c11 = texture + (y1 * width + x1) * channels;
  for (int64_t c = 0; c < channels; ++c) {
    const float top = c00[c] + (c10[c] - c00[c]) * tx, bottom = c01[c] + (c11[c] - c01[c]) * tx;
    out[c] = top + (bottom - top) * ty;
  }
}

}  // namespace bigtri

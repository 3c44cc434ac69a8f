// Texture sampling in float32; docs/numerics.md 10. It runs per pixel, on uv coordinates that the attribute pass
// interpolated. A texture holds linear values, or sRGB codes that are decoded when they are fetched. Mirrors
// bigtri/reference/texture.py.
#pragma once

#include "shading.h"

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

// Texels that are sRGB codes, with a table of what they stand for.
template <class Code>
struct CodedTexels {
  const Code* codes;
  const float* decoded;  // [256] or [65536]
};

// Value i of a texture, a channel of a texel, as linear light.
BIGTRI_HD float linear_at(const float* texture, int64_t i) { return texture[i]; }
BIGTRI_HD float linear_at(const uint16_t* texture, int64_t i) { return decode_srgb(texture[i]); }
template <class Code>
BIGTRI_HD float linear_at(const CodedTexels<Code>& texture, int64_t i) {
  return texture.decoded[texture.codes[i]];
}

// texture: what linear_at takes, [height, width, channels], row 0 on top. u, v: (0, 0) at the lower left. out:
// [channels].
template <class Texture>
BIGTRI_HD void sample(Texture texture, int height, int width, int64_t channels, float u, float v, Filter filter,
                      Wrap wrap, float* out) {
  if (!(is_finite(u) && is_finite(v))) u = v = 0.0f;
  u = wrap_coordinate(u, wrap);
  v = wrap_coordinate(v, wrap);
  if (filter == Filter::kNearest) {
    const int x = min_of((int)floor_small(u * (float)width), width - 1),
              y = min_of((int)floor_small((1.0f - v) * (float)height), height - 1);
    const int64_t texel = ((int64_t)y * width + x) * channels;
    for (int64_t c = 0; c < channels; ++c) out[c] = linear_at(texture, texel + c);
    return;
  }
  const float x = u * (float)width - 0.5f, y = (1.0f - v) * (float)height - 0.5f;
  const float fx = floor_small(x), fy = floor_small(y), tx = x - fx, ty = y - fy;
  const int64_t x0 = wrap_texel((int)fx, width, wrap), x1 = wrap_texel((int)fx + 1, width, wrap);
  const int64_t y0 = wrap_texel((int)fy, height, wrap), y1 = wrap_texel((int)fy + 1, height, wrap);
  const int64_t i00 = (y0 * width + x0) * channels, i10 = (y0 * width + x1) * channels;
  const int64_t i01 = (y1 * width + x0) * channels, i11 = (y1 * width + x1) * channels;
  for (int64_t c = 0; c < channels; ++c) {
    const float c00 = linear_at(texture, i00 + c), c10 = linear_at(texture, i10 + c);
    const float c01 = linear_at(texture, i01 + c), c11 = linear_at(texture, i11 + c);
    const float top = c00 + (c10 - c00) * tx, bottom = c01 + (c11 - c01) * tx;
    out[c] = top + (bottom - top) * ty;
  }
}

}  // namespace bigtri

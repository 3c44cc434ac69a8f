// Texture sampling in float32; docs/numerics.md 10. It runs per pixel, on uv coordinates that the attribute pass
// interpolated. A texture holds linear values, or sRGB codes that are decoded when they are fetched. Mirrors
// bigtri/reference/texture.py.
#pragma once

#include "shading.h"

namespace bigtri {

enum class Filter : int { kNearest, kBilinear };
enum class Wrap : int { kRepeat, kClamp };

// F is float, or a vector of floats (cpu/simd.h), in what follows; I is an integer, or a vector of integers.

// floor(v) for |v| < 2^31, without a library call.
template <class F>
BIGTRI_HD F floor_small(const F& v) {
  const F t = to_float(to_int(v));
  return select(t > v, t - 1.0f, t);
}

#if defined(__CUDA_ARCH__)
// A GPU has an instruction for it. A zero may get the other sign, which no caller depends on.
BIGTRI_HD float floor_small(float v) { return floorf(v); }
BIGTRI_HD float floor_any(float v) { return floorf(v); }
#endif

// floor(v) for any finite v. From 2^23 = 8388608 on, every float is an integer.
template <class F>
BIGTRI_HD F floor_any(const F& v) {
  const auto small = (v > -8388608.0f) & (v < 8388608.0f);
  return select(small, floor_small(select(small, v, constant(0.0f, v))), v);
}

// u or v, brought into [0, 1].
template <class F>
BIGTRI_HD F wrap_coordinate(const F& u, Wrap wrap) {
  if (wrap == Wrap::kRepeat) return u - floor_any(u);
  const F low = select(u < 0.0f, constant(0.0f, u), u);
  return select(low > 1.0f, constant(1.0f, u), low);
}

// Columns or rows `first`, -1 to size - 1, and the next one, of a texture with `size` of them: what lies beside it is the
// other border by repeating, else the nearest.
template <class I>
BIGTRI_HD void wrap_texels(const I& first, int size, Wrap wrap, I i[2]) {
  const int last = size - 1, before = wrap == Wrap::kRepeat ? last : 0, after = last - before;
  const I next = first + 1;
  i[0] = select(first < 0, first - first + before, first);
  i[1] = select(next > last, first - first + after, next);
}

#if defined(__CUDA_ARCH__)
// A GPU takes the magnitude for nothing.
BIGTRI_HD bool both_finite(float u, float v) { return (fabsf(u) < kInfinity) & (fabsf(v) < kInfinity); }
#endif

// Whether neither is a NaN or an infinity.
template <class F>
BIGTRI_HD auto both_finite(const F& u, const F& v) {
  return (u > -kInfinity) & (u < kInfinity) & (v > -kInfinity) & (v < kInfinity);
}

// The coordinates of a lookup, brought into [0, 1]; (0, 0) for a pair with a NaN or an infinity.
template <class F>
BIGTRI_HD void wrap_coordinates(F* u, F* v, Wrap wrap) {
  const F zero = constant(0.0f, *u);
  const auto finite = both_finite(*u, *v);
  *u = wrap_coordinate(select(finite, *u, zero), wrap);
  *v = wrap_coordinate(select(finite, *v, zero), wrap);
}

// The texel that wrapped coordinates fall into.
template <class F, class I>
BIGTRI_HD void nearest_texel(int height, int width, const F& u, const F& v, I* x, I* y) {
  const I column = to_int(floor_small(u * (float)width)), row = to_int(floor_small((1.0f - v) * (float)height));
  *x = select(column > width - 1, column - column + (width - 1), column);
  *y = select(row > height - 1, row - row + (height - 1), row);
}

// The four texels around wrapped coordinates, columns x[0] and x[1] of rows y[0] and y[1], and how far they lie from the
// first of each.
template <class F, class I>
BIGTRI_HD void bilinear_texels(int height, int width, const F& u, const F& v, Wrap wrap, I x[2], I y[2], F* tx, F* ty) {
  const F at_x = u * (float)width - 0.5f, at_y = (1.0f - v) * (float)height - 0.5f;
  const F left = floor_small(at_x), upper = floor_small(at_y);
  *tx = at_x - left;
  *ty = at_y - upper;
  wrap_texels(to_int(left), width, wrap, x);
  wrap_texels(to_int(upper), height, wrap, y);
}

// A channel between its values at those texels: c[row][column].
template <class F>
BIGTRI_HD F bilinear(const F c[2][2], const F& tx, const F& ty) {
  const F top = c[0][0] + (c[0][1] - c[0][0]) * tx, bottom = c[1][0] + (c[1][1] - c[1][0]) * tx;
  return top + (bottom - top) * ty;
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

// The number of a texel, which fits 32 bits: a texture has 2^16 rows and columns at most.
BIGTRI_HD int64_t texel_number(int32_t x, int32_t y, int width) {
  return (int64_t)((uint32_t)y * (uint32_t)width + (uint32_t)x);
}

// texture: what linear_at takes, [height, width, channels], row 0 on top. u, v: (0, 0) at the lower left. out:
// [channels].
template <class Texture>
BIGTRI_HD void sample(Texture texture, int height, int width, int64_t channels, float u, float v, Filter filter,
                      Wrap wrap, float* out) {
  wrap_coordinates(&u, &v, wrap);
  if (filter == Filter::kNearest) {
    int32_t x, y;
    nearest_texel(height, width, u, v, &x, &y);
    const int64_t texel = texel_number(x, y, width) * channels;
    for (int64_t c = 0; c < channels; ++c) out[c] = linear_at(texture, texel + c);
    return;
  }
  int32_t x[2], y[2];
  float tx, ty;
  bilinear_texels(height, width, u, v, wrap, x, y, &tx, &ty);
  for (int64_t c = 0; c < channels; ++c) {
    float near[2][2];
    for (int row = 0; row < 2; ++row)
      for (int column = 0; column < 2; ++column)
        near[row][column] = linear_at(texture, texel_number(x[column], y[row], width) * channels + c);
    out[c] = bilinear(near, tx, ty);
  }
}

}  // namespace bigtri

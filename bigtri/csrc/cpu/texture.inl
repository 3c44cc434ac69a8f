// Textures by themselves: the lookups of sample_texture, called by shading.cpp. Compiled once per instruction set.
//
// Many lookups at a time find where their texels are, in vectors; each of them then fetches and blends the channels of
// its texels as one vector.
#pragma once

#include "../core/texture.h"
#include "simd.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

using f32x4 = Lanes<float, 4>;

constexpr int kLookups = 64;  // a multiple of 16

// Where some lookups have their texels: columns x[0] and x[1] of rows y[0] and y[1], of the nearest one x[0] and y[0].
struct Lookups {
  int32_t x[2][kLookups], y[2][kLookups];
  float tx[kLookups], ty[kLookups];  // how far they lie from the first column and row
};

void find_texels(int height, int width, const float* uv, int n, Filter filter, Wrap wrap, Lookups* to) {
  float u[kLookups], v[kLookups];
  for (int i = 0; i < n; ++i) {
    u[i] = uv[2 * i];
    v[i] = uv[2 * i + 1];
  }
  for (int i = n; i < ((n + 15) & ~15); ++i) u[i] = v[i] = 0.0f;
  for (int i = 0; i < n; i += 16) {
    f32x16 at_u = load<f32x16>(u + i), at_v = load<f32x16>(v + i), tx, ty;
    i32x16 x[2], y[2];
    wrap_coordinates(&at_u, &at_v, wrap);
    if (filter == Filter::kNearest) {
      nearest_texel(height, width, at_u, at_v, x, y);
      store(to->x[0] + i, x[0]);
      store(to->y[0] + i, y[0]);
      continue;
    }
    bilinear_texels(height, width, at_u, at_v, wrap, x, y, &tx, &ty);
    for (int k = 0; k < 2; ++k) {
      store(to->x[k] + i, x[k]);
      store(to->y[k] + i, y[k]);
    }
    store(to->tx + i, tx);
    store(to->ty + i, ty);
  }
}

// The channels of a texel; what a fourth lane holds where there are three means nothing. texels: how many there are.
template <int kChannels>
BIGTRI_INLINE f32x4 texel_at(const float* texture, int64_t texel, int64_t texels) {
  // Four floats from the last of three channels would lie past the texture.
  if (kChannels == 4 || texel + 1 < texels) return load<f32x4>(texture + kChannels * texel);
  f32x4 last = {};
  __builtin_memcpy(&last, texture + kChannels * texel, kChannels * sizeof(float));
  return last;
}
template <int kChannels, class Code>
BIGTRI_INLINE f32x4 texel_at(const CodedTexels<Code>& texture, int64_t texel, int64_t) {
  const Code* code = texture.codes + kChannels * texel;
  const float* decoded = texture.decoded;
  const float fourth = kChannels == 4 ? decoded[code[kChannels - 1]] : 0.0f;
  // By way of memory it would have to wait for four stores.
  return {{f32x4::Vector{decoded[code[0]], decoded[code[1]], decoded[code[2]], fourth}}};
}

// Fetches the texels of `rows` rows into the cache, which else would be waited for one by one. Codes are a quarter or
// half as large, and there it takes longer than it saves.
template <int kChannels>
BIGTRI_INLINE void fetch_ahead(const float* texture, int width, const Lookups& at, int n, int rows) {
  for (int row = 0; row < rows; ++row)
    for (int i = 0; i < n; ++i) __builtin_prefetch(texture + kChannels * ((int64_t)at.y[row][i] * width + at.x[0][i]));
}
template <int kChannels, class Code>
BIGTRI_INLINE void fetch_ahead(const CodedTexels<Code>&, int, const Lookups&, int, int) {}

// Lookups in a texture of three or four channels.
template <int kChannels, class Texture>
void sample_vectors(const Texture& texture, int height, int width, const float* uv, int64_t count, Filter filter,
                    Wrap wrap, float* out) {
  const int64_t texels = (int64_t)height * width;
  Lookups at;
  for (int64_t first = 0; first < count; first += kLookups) {
    const int n = (int)min_of<int64_t>(kLookups, count - first);
    find_texels(height, width, uv + 2 * first, n, filter, wrap, &at);
    fetch_ahead<kChannels>(texture, width, at, n, filter == Filter::kBilinear ? 2 : 1);
    for (int i = 0; i < n; ++i) {
      const int64_t upper = (int64_t)at.y[0][i] * width;
      f32x4 result = texel_at<kChannels>(texture, upper + at.x[0][i], texels);
      if (filter == Filter::kBilinear) {
        const int64_t lower = (int64_t)at.y[1][i] * width;
        const f32x4 near[2][2] = {{result, texel_at<kChannels>(texture, upper + at.x[1][i], texels)},
                                  {texel_at<kChannels>(texture, lower + at.x[0][i], texels),
                                   texel_at<kChannels>(texture, lower + at.x[1][i], texels)}};
        result = bilinear(near, splat<f32x4>(at.tx[i]), splat<f32x4>(at.ty[i]));
      }
      // A fourth lane too many lies where the next lookup's result will be; after the last one may be another thread's.
      float* to = out + kChannels * (first + i);
      if (first + i + 1 < count)
        store(to, result);
      else
        __builtin_memcpy(to, &result, kChannels * sizeof(float));
    }
  }
}

template <class Texture>
void stage_sample(Texture texture, int height, int width, int64_t channels, const float* uv, int64_t count,
                  Filter filter, Wrap wrap, float* out) {
  if (channels == 3) return sample_vectors<3>(texture, height, width, uv, count, filter, wrap, out);
  if (channels == 4) return sample_vectors<4>(texture, height, width, uv, count, filter, wrap, out);
  for (int64_t i = 0; i < count; ++i)
    sample(texture, height, width, channels, uv[2 * i], uv[2 * i + 1], filter, wrap, out + channels * i);
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

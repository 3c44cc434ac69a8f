// Textures: the lookups of sample_texture, called by shading.cpp, and those of the shading pass (shade.inl). Compiled once
// per instruction set.
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

// Where some lookups have their texels: the first value of each, by row and column; of the nearest one [0][0].
struct Lookups {
  int32_t value[2][2][kLookups];
  float tx[kLookups], ty[kLookups];  // how far they lie from the first column and row
};

// Whether 32 bits number the values of a texture, as Lookups does.
BIGTRI_INLINE bool are_numbered(int height, int width, int channels) {
  return (int64_t)height * width <= INT32_MAX / channels;
}

// Of a texture whose values are numbered. u, v: [n], readable as far as the next multiple of 16.
template <int kChannels>
void find_texels(int height, int width, const float* u, const float* v, int n, Filter filter, Wrap wrap, Lookups* to) {
  for (int i = 0; i < n; i += 16) {
    f32x16 at_u = load<f32x16>(u + i), at_v = load<f32x16>(v + i), tx, ty;
    i32x16 x[2], y[2];
    wrap_coordinates(&at_u, &at_v, wrap);
    const bool nearest = filter == Filter::kNearest;
    if (nearest) {
      nearest_texel(height, width, at_u, at_v, x, y);
    } else {
      bilinear_texels(height, width, at_u, at_v, wrap, x, y, &tx, &ty);
      store(to->tx + i, tx);
      store(to->ty + i, ty);
    }
    const int sides = nearest ? 1 : 2;
    for (int k = 0; k < sides; ++k) {
      x[k] = x[k] * kChannels;
      y[k] = y[k] * (kChannels * width);
    }
    for (int row = 0; row < sides; ++row)
      for (int column = 0; column < sides; ++column) store(to->value[row][column] + i, y[row] + x[column]);
  }
}

// The channels of the texel that begins at a value of a texture of so many values. What a fourth lane holds where there
// are three channels means nothing.
template <int kChannels>
BIGTRI_INLINE f32x4 texel_at(const float* texture, int64_t value, int64_t values) {
  // Four floats from the last of three channels would lie past the texture.
  if (value + 4 <= values) return load<f32x4>(texture + value);
  f32x4 last = {};
  __builtin_memcpy(&last, texture + value, kChannels * sizeof(float));
  return last;
}
template <int kChannels, class Code>
BIGTRI_INLINE f32x4 texel_at(const CodedTexels<Code>& texture, int64_t value, int64_t) {
  const auto channel = [&](int c) { return c < kChannels ? linear_at(texture, value + c) : 0.0f; };
  // All at once: a vector whose elements are set one by one goes by way of memory, and waits for the stores.
  return {{f32x4::Vector{channel(0), channel(1), channel(2), channel(3)}}};
}

// Fetches the texels of `rows` rows into the cache, which else would be waited for one by one. Codes are a quarter or
// half as large, and there it takes longer than it saves.
BIGTRI_INLINE void fetch_ahead(const float* texture, const Lookups& at, int n, int rows) {
  for (int row = 0; row < rows; ++row)
    for (int i = 0; i < n; ++i) __builtin_prefetch(texture + at.value[row][0][i]);
}
template <class Code>
BIGTRI_INLINE void fetch_ahead(const CodedTexels<Code>&, const Lookups&, int, int) {}

// Blends the texels of n lookups, in a texture of three or four channels and so many values. put(i, texel) takes the
// result of lookup i.
template <int kChannels, class Texture, class Put>
BIGTRI_INLINE void blend_texels(const Texture& texture, int64_t values, const Lookups& at, int n, Filter filter,
                                const Put& put) {
  const auto texel = [&](int row, int column, int i) {
    return texel_at<kChannels>(texture, at.value[row][column][i], values);
  };
  if (filter == Filter::kNearest) {
    fetch_ahead(texture, at, n, 1);
    for (int i = 0; i < n; ++i) put(i, texel(0, 0, i));
    return;
  }
  fetch_ahead(texture, at, n, 2);
  for (int i = 0; i < n; ++i) {
    const f32x4 near[2][2] = {{texel(0, 0, i), texel(0, 1, i)}, {texel(1, 0, i), texel(1, 1, i)}};
    put(i, bilinear(near, splat<f32x4>(at.tx[i]), splat<f32x4>(at.ty[i])));
  }
}

// sample_texture of a texture of three or four channels.
template <int kChannels, class Texture>
void sample_vectors(const Texture& texture, int height, int width, const float* uv, int64_t count, Filter filter,
                    Wrap wrap, float* out) {
  const int64_t values = (int64_t)height * width * kChannels;
  Lookups at;
  float u[kLookups] = {}, v[kLookups] = {};
  for (int64_t first = 0; first < count; first += kLookups) {
    const int n = (int)min_of<int64_t>(kLookups, count - first);
    for (int i = 0; i < n; ++i) {
      u[i] = uv[2 * (first + i)];
      v[i] = uv[2 * (first + i) + 1];
    }
    find_texels<kChannels>(height, width, u, v, n, filter, wrap, &at);
    blend_texels<kChannels>(texture, values, at, n, filter, [&](int i, const f32x4& texel) {
      // A fourth lane too many lies where the next lookup's result will be; after the last one may be another thread's.
      float* to = out + kChannels * (first + i);
      if (first + i + 1 < count)
        store(to, texel);
      else
        __builtin_memcpy(to, &texel, kChannels * sizeof(float));
    });
  }
}

template <class Texture>
void stage_sample(Texture texture, int height, int width, int64_t channels, const float* uv, int64_t count,
                  Filter filter, Wrap wrap, float* out) {
  const bool numbered = are_numbered(height, width, 4);
  if (channels == 3 && numbered) return sample_vectors<3>(texture, height, width, uv, count, filter, wrap, out);
  if (channels == 4 && numbered) return sample_vectors<4>(texture, height, width, uv, count, filter, wrap, out);
  for (int64_t i = 0; i < count; ++i)
    sample(texture, height, width, channels, uv[2 * i], uv[2 * i + 1], filter, wrap, out + channels * i);
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

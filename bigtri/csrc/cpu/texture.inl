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

#if BIGTRI_SIMD >= 512
// What the 256 codes of 8 bits stand for, to be looked up in registers: the lower halves of the floats' bits, then the upper ones.
struct CodeTable {
  alignas(64) uint16_t half[2][256];
};

BIGTRI_INLINE void fill_code_table(const float* decoded, CodeTable* table) {
  for (int code = 0; code < 256; ++code)
    for (int k = 0; k < 2; ++k) table->half[k][code] = (uint16_t)(float_bits(decoded[code]) >> 16 * k);
}

// A half of what 32 codes stand for. code: one in the lower byte of each word, the upper byte is 0.
BIGTRI_INLINE __m512i half_of(const uint16_t half[256], __m512i code, __mmask32 bit6, __mmask32 bit7) {
  const auto among = [&](int first) __attribute__((always_inline)) {
    return _mm512_permutex2var_epi16(_mm512_load_si512(half + first), code, _mm512_load_si512(half + first + 32));
  };
  const __m512i low = _mm512_mask_blend_epi16(bit6, among(0), among(64)),
                high = _mm512_mask_blend_epi16(bit6, among(128), among(192));
  return _mm512_mask_blend_epi16(bit7, low, high);
}

// What 32 codes stand for. In each quarter of `code` lie four of the first vector's and then four of the second one's.
BIGTRI_INLINE void decode_both(const CodeTable& table, __m512i code, f32x16* first, f32x16* second) {
  const __mmask32 bit6 = _mm512_test_epi16_mask(code, _mm512_set1_epi16(64)),
                  bit7 = _mm512_test_epi16_mask(code, _mm512_set1_epi16(128));
  const __m512i lower = half_of(table.half[0], code, bit6, bit7), upper = half_of(table.half[1], code, bit6, bit7);
  first->part[0] = (f32x16::Vector)_mm512_unpacklo_epi16(lower, upper);
  second->part[0] = (f32x16::Vector)_mm512_unpackhi_epi16(lower, upper);
}

// The linear values of two times sixteen texels of three codes, each in the lower bytes of a word of 32 bits.
BIGTRI_INLINE void decode_texels(const CodeTable& table, __m512i one, __m512i two, f32x16 first[3], f32x16 second[3]) {
  // Of a quarter, four texels: bytes as words; -1 is 0.
  const __m512i red_green =
                    _mm512_broadcast_i32x4(_mm_setr_epi8(0, -1, 4, -1, 8, -1, 12, -1, 1, -1, 5, -1, 9, -1, 13, -1)),
                blue =
                    _mm512_broadcast_i32x4(_mm_setr_epi8(2, -1, 6, -1, 10, -1, 14, -1, 2, -1, 6, -1, 10, -1, 14, -1));
  decode_both(table, _mm512_shuffle_epi8(one, red_green), &first[0], &first[1]);
  decode_both(table, _mm512_shuffle_epi8(two, red_green), &second[0], &second[1]);
  const __m512i blues = _mm512_mask_shuffle_epi8(_mm512_shuffle_epi8(one, blue), 0xff00ff00ff00ff00, two, blue);
  decode_both(table, blues, &first[2], &second[2]);
}

// Texels of three codes each, kCodesRead codes or more, that are decoded in registers.
struct TabledTexels {
  const uint8_t* codes;
  const CodeTable& table;
};
constexpr int kCodesRead = 8;  // at a time

// Multiplies n colours by texels that are found: what blend_texels does, sixteen lookups at a time.
BIGTRI_INLINE void multiply_texels(const TabledTexels& texels, int64_t values, const Lookups& at, int n, Filter filter,
                                   float albedo[3][kLookups]) {
  const int sides = filter == Filter::kNearest ? 1 : 2;
  const int32_t last = (int32_t)values - kCodesRead;
  // A lookup's two texels of a row mostly lie side by side, and are read at once. Bit i of `apart`: those of lookup i do
  // not, or lie too near to the end of the texture.
  int32_t from[2][kLookups];
  uint64_t apart[2] = {};
  for (int row = 0; row < sides; ++row)
    for (int i = 0; i < n; i += 16) {
      const i32x16 first = load<i32x16>(at.value[row][0] + i), second = load<i32x16>(at.value[row][sides - 1] + i);
      store(from[row] + i, least(first, splat<i32x16>(last)));
      const i32x16 together = (second == first + 3 * (sides - 1)) & (first < last + 1);
      apart[row] |= (uint64_t)(~sign_mask(together) & 0xffff) << i;
    }
  // The codes of both; the first texel's first one is the lowest byte.
  alignas(64) uint64_t pair[2][kLookups];
  for (int row = 0; row < sides; ++row) {
    for (int i = 0; i < n; i += 16)
#pragma GCC unroll 16
      for (int k = i; k < i + 16; ++k) __builtin_memcpy(pair[row] + k, texels.codes + from[row][k], kCodesRead);
    for (uint64_t left = apart[row]; left; left &= left - 1) {
      const int i = __builtin_ctzll(left);
      __builtin_memcpy(pair[row] + i, texels.codes + at.value[row][0][i], 3);
      __builtin_memcpy((uint8_t*)(pair[row] + i) + 3, texels.codes + at.value[row][sides - 1][i], 3);
    }
  }
  const __m512i even = _mm512_setr_epi32(0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
  for (int i = 0; i < n; i += 16) {
    f32x16 texel[2][2][3];
    for (int row = 0; row < sides; ++row) {
      const __m512i a = _mm512_load_si512(pair[row] + i), b = _mm512_load_si512(pair[row] + i + 8);
      decode_texels(texels.table, _mm512_permutex2var_epi32(a, even, b),
                    _mm512_permutex2var_epi32(_mm512_srli_epi64(a, 24), even, _mm512_srli_epi64(b, 24)), texel[row][0],
                    texel[row][1]);
    }
    for (int c = 0; c < 3; ++c) {
      const f32x16 near[2][2] = {{texel[0][0][c], texel[0][1][c]}, {texel[1][0][c], texel[1][1][c]}};
      const f32x16 blended = sides == 1 ? near[0][0] : bilinear(near, load<f32x16>(at.tx + i), load<f32x16>(at.ty + i));
      store(albedo[c] + i, load<f32x16>(albedo[c] + i) * blended);
    }
  }
}
#endif

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

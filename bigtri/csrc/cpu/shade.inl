// The kernel of the shading pass; docs/numerics.md 18. It finishes the pixels of a block of a visibility buffer: weights,
// attributes, texture, vertex colour, light, sRGB. Called by shade.cpp for every block of an image, and by bin_owned.inl
// for each bin that has been drawn. Compiled once per instruction set.
//
// Triangles that cover a few pixels each leave most of a vector empty, so the work is cut in two. The first half goes
// along runs of pixels of one triangle; the attributes of a run are appended to lists, the next run's right behind them
// (fragments.inl). The second half, here, takes sixteen fragments of a list at a time, whatever triangles they are of.
#pragma once

#include "fragments.inl"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// Fragments are shaded this many at a time, in steps that each go through all of them: what one step stores number by
// number, the next loads by vectors, which a processor can do fast only when the stores are done.
constexpr int kTogether = kLookups;

BIGTRI_INLINE void multiply_triples(const float texel[kTogether][4], int n, float albedo[3][kTogether]) {
  for (int i = 0; i < n; i += 16) {
    f32x16 channel[3];
    load_triples(texel[i], channel);
    for (int c = 0; c < 3; ++c) store(albedo[c] + i, load<f32x16>(albedo[c] + i) * channel[c]);
  }
}

// Multiplies n colours by texels that are found.
template <class Texels>
BIGTRI_INLINE void multiply_texels(const Texels& texels, int64_t values, const Lookups& at, int n, Filter filter,
                                   float albedo[3][kTogether]) {
  float texel[kTogether][4];
  blend_texels<3>(texels, values, at, n, filter, [&](int i, const f32x4& value) { store(texel[i], value); });
  multiply_triples(texel, n, albedo);
}

// Multiplies n colours by a texture whose values are numbered. u, v: their coordinates.
template <class Texels>
BIGTRI_INLINE void multiply_numbered(const Texels& texels, const Texture& t, const float* u, const float* v, int n,
                                     Filter filter, Wrap wrap, float albedo[3][kTogether]) {
  Lookups at;
  find_texels<3>(t.height, t.width, u, v, n, filter, wrap, &at);
  multiply_texels(texels, (int64_t)t.height * t.width * 3, at, n, filter, albedo);
}

// The same of any texture.
template <class Texels>
BIGTRI_INLINE void multiply_texture(const Texels& texels, const Texture& t, const float* u, const float* v, int n,
                                    Filter filter, Wrap wrap, float albedo[3][kTogether]) {
  if (are_numbered(t.height, t.width, 3)) return multiply_numbered(texels, t, u, v, n, filter, wrap, albedo);
  float texel[kTogether][4];
  for (int i = 0; i < n; ++i) sample(texels, t.height, t.width, 3, u[i], v[i], filter, wrap, texel[i]);
  multiply_triples(texel, n, albedo);
}

// Multiplies n colours by the texture of their material.
void apply_texture(const ShadeJob& job, const Look& look, const float* u, const float* v, int n, const ShadeScratch& s,
                   float albedo[3][kTogether]) {
  const Texture& t = job.surface.textures[look.texture];
  const Filter filter = look.bits & kLookNearest ? Filter::kNearest : Filter::kBilinear;
  const Wrap wrap = look.bits & kLookClamp ? Wrap::kClamp : Wrap::kRepeat;
#if BIGTRI_SIMD >= 512
  if (t.kind == Texels::kCodes8 && are_numbered(t.height, t.width, 3) && t.height * t.width * 3 >= kCodesRead)
    return multiply_numbered(TabledTexels{(const uint8_t*)t.texels, s.codes}, t, u, v, n, filter, wrap, albedo);
#endif
  if (t.kind == Texels::kCodes8)
    multiply_texture(CodedTexels<uint8_t>{(const uint8_t*)t.texels, job.decoded8}, t, u, v, n, filter, wrap, albedo);
  else if (t.kind == Texels::kCodes16)
    multiply_texture(CodedTexels<uint16_t>{(const uint16_t*)t.texels, job.decoded16}, t, u, v, n, filter, wrap, albedo);
  else
    multiply_texture((const float*)t.texels, t, u, v, n, filter, wrap, albedo);
}

// Writes n triples to their places in an image of three floats a sample, if there is one.
BIGTRI_INLINE void scatter(float* image, const int32_t* at, int n, const float of[3][kTogether]) {
  for (int i = 0; image && i < n; ++i)
    for (int c = 0; c < 3; ++c) image[3 * (int64_t)at[i] + c] = of[c][i];
}

// Writes the sRGB codes of n colours to their pixels. linear: the bits of the colours, within the table's steps.
template <int kChannels>
BIGTRI_INLINE void encode_pixels(const SrgbSteps& table, uint8_t* image, const int32_t* at, int n,
                                 const uint32_t linear[3][kTogether]) {
  uint32_t of_step[3][kTogether];
  for (int c = 0; c < 3; ++c)
    for (int i = 0; i < n; i += 16) store(of_step[c] + i, step_of(load<u32x16>(linear[c] + i)));
  for (int c = 0; c < 3; ++c)
    for (int i = 0; i < n; ++i) of_step[c][i] = table.byte[of_step[c][i]];
  for (int i = 0; i < n; i += 16) {
    u32x16 code[3];
    for (int c = 0; c < 3; ++c) code[c] = byte_of(load<u32x16>(linear[c] + i), load<u32x16>(of_step[c] + i)) & 0xffu;
    const u32x16 pixels = (code[0] | code[1] << 8u) | (code[2] << 16u | 0xff000000u);
    // In a row most pixels follow each other, whatever triangles they are of.
    if (n - i >= 16 && at[i + 15] - at[i] == 15) {
      uint8_t* to = image + kChannels * (int64_t)at[i];
      if (kChannels == 4)
        store((uint32_t*)to, pixels);
      else
        store_triples(to, pixels);
    } else {
      uint32_t pixel[16];
      store(pixel, pixels);
      for (int k = 0; k < min_of(16, n - i); ++k)
        __builtin_memcpy(image + kChannels * (int64_t)at[i + k], pixel + k, kChannels);
    }
  }
}

// Where the fragments of a block, or of a row of samples, go.
struct Targets {
  uint8_t* image;  // null where several samples make a pixel
  float *albedo, *normals, *linear;  // or null
};

// Shades fragments [i, i + n) of the lists, at most kTogether of one material.
void shade_together(const ShadeJob& job, const Targets& to, const Segment& segment, int i, int n,
                    const ShadeScratch& s) {
  const Surface& f = job.surface;
  const int32_t* at = s.at + i;
  float albedo[3][kTogether], normal[3][kTogether], linear[3][kTogether];
  uint32_t encoded[3][kTogether];
  for (int k = 0; k < n; k += 16)
    for (int c = 0; c < 3; ++c) store(albedo[c] + k, splat<f32x16>(segment.base[c]));
  if (segment.look.texture >= 0)
    apply_texture(job, segment.look, s.channel[kUv] + i, s.channel[kUv + 1] + i, n, s, albedo);
  for (int k = 0; k < n; k += 16) {
    f32x16 base[3], direction[3], lit[3];
    for (int c = 0; c < 3; ++c) {
      base[c] = load<f32x16>(albedo[c] + k);
      if (segment.look.bits & kLookVertexColors) base[c] = base[c] * load<f32x16>(s.channel[kColor + c] + i + k);
      direction[c] = load<f32x16>(s.channel[kNormal + c] + i + k);
    }
    lambert(direction, base, f.ambient, LightArrays{f.light_directions, f.light_colors}, f.lights, lit);
    for (int c = 0; c < 3; ++c) {
      store(albedo[c] + k, base[c]);
      store(normal[c] + k, direction[c]);
      store(linear[c] + k, lit[c]);
      store((float*)encoded[c] + k, within_steps(lit[c]));
    }
  }
  scatter(to.albedo, at, n, albedo);
  scatter(to.normals, at, n, normal);
  scatter(to.linear, at, n, linear);
  if (to.image && job.channels == 4)
    encode_pixels<4>(*job.srgb, to.image, at, n, encoded);
  else if (to.image)
    encode_pixels<3>(*job.srgb, to.image, at, n, encoded);
}

// Shades all fragments of the lists, and empties them.
void shade_fragments(const ShadeJob& job, const Targets& to, ShadeScratch* s) {
  for (int k = 0; k < s->segments; ++k) {
    const Segment& segment = s->segment[k];
    const int end = k + 1 < s->segments ? s->segment[k + 1].begin : s->count;
    for (int i = segment.begin; i < end; i += kTogether)
      shade_together(job, to, segment, i, min_of(kTogether, end - i), *s);
  }
  s->count = s->segments = 0;
}

// Fills n samples of an image of three floats a sample with a colour, if there is an image.
BIGTRI_INLINE void fill(float* to, int n, const float color[3]) {
  for (int i = 0; to && i < 3 * n; ++i) to[i] = color[i % 3];
}

// kBin pixels of one colour, to copy from.
struct Plain {
  const uint8_t* color = nullptr;
  alignas(64) uint8_t bytes[4 * kBin];
};

BIGTRI_INLINE void make_plain(const uint8_t color[4], int channels, Plain* plain) {
  if (plain->color && __builtin_memcmp(plain->color, color, 4) == 0) return;
  plain->color = color;
  // Of three bytes a pixel the fourth is the next pixel's.
  for (int i = 0; i < 8; ++i) __builtin_memcpy(plain->bytes + channels * i, color, 4);
  for (int i = 8 * channels; i < channels * kBin; i *= 2) __builtin_memcpy(plain->bytes + i, plain->bytes, (size_t)i);
}

// n pixels of one colour. Around the caches where the pictures do not fit them.
void fill_pixels(const ShadeJob& job, uint8_t* to, int n, const Plain& plain) {
  // Whole cache lines, of three channels and of four.
  const int piece = kBin * job.channels, bytes = n * job.channels;
  int i = 0;
  if (job.streams && ((uintptr_t)to & 63) == 0)
    for (; i + piece <= bytes; i += piece)
      for (int k = 0; k < piece; k += 64)
        stream((int64_t*)(to + i + k), load<i64x8>((const int64_t*)(plain.bytes + k)));
  for (; i + piece <= bytes; i += piece)
    for (int k = 0; k < piece; k += 64) __builtin_memcpy(to + i + k, plain.bytes + k, 64);
  __builtin_memcpy(to + i, plain.bytes, (size_t)(bytes - i));
}

// Fills rows [y, y + height) of samples of the outputs that have a value for each sample.
void fill_samples(const ShadeJob& job, int64_t view, int x, int y, int width, int height) {
  const float zero[3] = {0.0f, 0.0f, 0.0f};
  for (int j = y; j < y + height; ++j) {
    const int64_t first = 3 * ((view * job.height + j) * job.width + x);
    float background[3];
    background_at(job.surface, j, job.height, job.channels, background);
    if (job.albedo) fill(job.albedo + first, width, zero);
    if (job.normals) fill(job.normals + first, width, zero);
    if (job.linear) fill(job.linear + first, width, background);
  }
}

// Where a picture's row of pixels begins.
BIGTRI_INLINE uint8_t* pixel_at(const ShadeJob& job, int64_t view, int x, int y) {
  return job.image + job.channels * ((view * (job.height / job.samples) + y) * (job.width / job.samples) + x);
}

void shade_background(const ShadeJob& job, int64_t view, int x, int y, int width, int height) {
  const int n = job.samples;
  if (job.albedo || job.normals || job.linear) fill_samples(job, view, x, y, width, height);
  Plain plain;
  for (int row = y / n; row < (y + height) / n; ++row) {
    make_plain(job.background + 4 * row, job.channels, &plain);
    fill_pixels(job, pixel_at(job, view, x / n, row), width / n, plain);
  }
}

// A sample a pixel: fragments, and the background where there are none.
void shade_pixels(const ShadeJob& job, const ShadeBlock& b, ShadeScratch* s) {
  if (job.albedo || job.normals || job.linear) fill_samples(job, b.view, b.x, b.y, b.width, b.height);
  const int64_t first = (b.view * job.height + b.y) * job.width + b.x;
  const auto image = [&](float* of) { return of ? of + 3 * first : nullptr; };
  const Targets to = {job.image + job.channels * first, image(job.albedo), image(job.normals), image(job.linear)};
  Plain plain;
  for (int j = 0; j < b.height; ++j) {
    uint8_t* row = to.image + (int64_t)job.channels * j * job.width;
    append_row(job, b.view, b.packed + j * b.pitch, b.y + j, b.x, b.width, j * job.width, s, [&](int i, int n) {
      make_plain(job.background + 4 * (b.y + j), job.channels, &plain);
      fill_pixels(job, row + job.channels * i, n, plain);
    });
    if (s->count > kFragments) shade_fragments(job, to, s);
  }
  shade_fragments(job, to, s);
}

// Several samples a pixel: rows of samples are shaded one by one and added up.
void shade_samples(const ShadeJob& job, const ShadeBlock& b, ShadeScratch* s) {
  const int n = job.samples;
  if (job.albedo || job.normals || job.linear) fill_samples(job, b.view, b.x, b.y, b.width, b.height);
  for (int row = 0; row < b.height; row += n) {
    float total[3][kBin] = {};
    int covered[kBin] = {};
    for (int j = row; j < row + n; ++j) {
      float background[3];
      background_at(job.surface, b.y + j, job.height, job.channels, background);
      // A pixel may be wider than a block.
      for (int x = 0; x < b.width; x += kBin) {
        const int some = min_of(kBin, b.width - x);
        __builtin_memset(s->covered, true, (size_t)some);
        append_row(job, b.view, b.packed + j * b.pitch + x, b.y + j, b.x + x, some, 0, s,
                   [&](int i, int n) { __builtin_memset(s->covered + i, false, (size_t)n); });
        const int64_t first = 3 * ((b.view * job.height + b.y + j) * job.width + b.x + x);
        const auto image = [&](float* of) { return of ? of + first : nullptr; };
        float linear[3 * kBin];
        for (int i = 0; i < some; ++i)
          for (int c = 0; c < 3; ++c) linear[3 * i + c] = background[c];
        shade_fragments(job, {nullptr, image(job.albedo), image(job.normals), linear}, s);
        if (job.linear) __builtin_memcpy(job.linear + first, linear, (size_t)(3 * some) * sizeof(float));
        for (int i = 0; i < some; ++i) {
          const int pixel = (x + i) / n;
          for (int c = 0; c < 3; ++c) total[c][pixel] = total[c][pixel] + linear[3 * i + c];
          covered[pixel] += s->covered[i];
        }
      }
    }
    for (int i = 0; i < b.width / n; ++i) {
      const float mean[3] = {total[0][i], total[1][i], total[2][i]};
      store_mean(mean, covered[i], n * n, job.channels, *job.srgb, pixel_at(job, b.view, b.x / n + i, (b.y + row) / n));
    }
  }
}

void shade_block(const ShadeJob& job, const ShadeBlock& block, void* memory) {
  ShadeScratch* s = (ShadeScratch*)memory;
  if (job.samples == 1)
    shade_pixels(job, block, s);
  else
    shade_samples(job, block, s);
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

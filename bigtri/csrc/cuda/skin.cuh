// What the fragments of a triangle look like, and how one is finished: albedo, light, sRGB; docs/numerics.md 18.
#pragma once

#include "../core/attributes.h"
#include "setup.cuh"
#include "shade.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// Bits of Skin::bits beside those of LookBit, which stay where the surface has the data. kLitFace: a face normal with the
// light that it gets, which all of its pixels have in common.
enum : int32_t { kSmoothNormal = 1 << 8, kFaceNormal = 1 << 9, kLitFace = 1 << 10 };

struct alignas(16) SkinLook {
  float uv[2][3];  // at the corners that weights 0, 1, 2 belong to
  float base[3];   // colour of the material
  float facing;    // -1: the normal is turned round; else 1
  int32_t bits;
  int32_t texture;  // -1: none
};
// Three channels at the corners.
struct alignas(16) CornerVectors {
  float value[3][3];
};
// In parts that are read when they are needed: together they take half of a thread's registers.
struct Skin {
  SkinLook look;
  CornerVectors normal;  // of a face normal only [][0], and in [][1] its light
  CornerVectors color;
};

// A light, in two vectors.
struct alignas(16) PackedLight {
  Light light;
};

struct Codes {
  SrgbSteps encode;
  float decoded[256];  // what 8-bit codes of textures stand for
};

// What a frame looks up, made once by the kernel before it. It stays in the caches.
struct Lookups {
  Codes* codes;
  Texture* textures;
  PackedLight* lights;
};

// A struct that the frame's first kernel has written, read 16 bytes at a time.
template <class T>
__device__ __forceinline__ T loaded(const T* from) {
  static_assert(sizeof(T) % sizeof(int4) == 0 && alignof(T) >= sizeof(int4), "whole vectors");
  union Words {
    int4 word[sizeof(T) / sizeof(int4)];
    T whole;
    __device__ Words() {}
  } words;
#pragma unroll
  for (int i = 0; i < (int)(sizeof(T) / sizeof(int4)); ++i) words.word[i] = reinterpret_cast<const int4*>(from)[i];
  return words.whole;
}

__device__ __forceinline__ Light light_at(const PackedLight* lights, int64_t l) { return loaded(lights + l).light; }

__device__ __forceinline__ Frame frame_of(const Shading& job, int64_t view) {
  const Viewport whole = {job.width, job.height, 0, 0, job.width, job.height, kCullNone};
  return {job.positions + view * job.vertices * 4, job.triangles, job.vertices, job.count, 1, whole};
}

// Fills a triangle's skin. vertex: in the order that weights are in; they name vertices. False if its material does not
// exist.
__device__ __forceinline__ bool load_skin(const Shading& job, int32_t triangle, const int32_t vertex[3], bool back,
                                          Skin* out) {
  const Surface& s = job.surface;
  const int32_t material = __ldg(s.material + triangle);
  if (material < 0 || material >= s.materials) return false;
  const int32_t asked = __ldg(&s.looks[material].bits), texture = __ldg(&s.looks[material].texture);
  int32_t bits = asked & (kLookNearest | kLookClamp);
  SkinLook& look = out->look;
  for (int c = 0; c < 3; ++c) look.base[c] = __ldg(s.base_colors + 3 * (int64_t)material + c);
  look.texture = s.uvs && texture >= 0 && texture < s.texture_count ? texture : -1;
  if (look.texture >= 0)
    for (int k = 0; k < 3; ++k)
      for (int c = 0; c < 2; ++c) look.uv[c][k] = __ldg(s.uvs + 2 * (int64_t)vertex[k] + c);
  if (s.colors && (asked & kLookVertexColors)) {
    bits |= kLookVertexColors;
    for (int k = 0; k < 3; ++k)
      for (int c = 0; c < 3; ++c) out->color.value[c][k] = __ldg(s.colors + 3 * (int64_t)vertex[k] + c);
  }
  if (s.normals && (!s.face_normals || (asked & kLookSmooth))) {
    bits |= kSmoothNormal;
    for (int k = 0; k < 3; ++k)
      for (int c = 0; c < 3; ++c) out->normal.value[c][k] = __ldg(s.normals + 3 * (int64_t)vertex[k] + c);
  } else if (s.face_normals) {
    bits |= kFaceNormal;
    for (int c = 0; c < 3; ++c) out->normal.value[c][0] = __ldg(s.face_normals + 3 * (int64_t)triangle + c);
  }
  look.facing = back && (asked & kLookTwoSided) ? -1.0f : 1.0f;
  look.bits = bits;
  return true;
}

// Turns a face normal to the front, and computes the light that it gets.
__device__ __forceinline__ void light_face(const Surface& s, Skin* skin) {
  if (!(skin->look.bits & kFaceNormal)) return;
  float normal[3], light[3];
  for (int c = 0; c < 3; ++c) normal[c] = skin->normal.value[c][0] * skin->look.facing;
  light_on(normal, s.ambient, LightArrays{s.light_directions, s.light_colors}, s.lights, light);
  for (int c = 0; c < 3; ++c) skin->normal.value[c][1] = light[c];
  skin->look.bits |= kLitFace;
}

// Textures, which nothing writes while kernels read them. The compiler cannot know that, nor that they are in the device's
// memory, since it finds the pointers to them in memory.
struct ReadTexels {
  const float* texels;
};
struct ReadCodes {
  const uint8_t* codes;
  const float* decoded;  // [256]
};
__device__ __forceinline__ float linear_at(const ReadTexels& texture, int64_t i) { return __ldg(texture.texels + i); }
__device__ __forceinline__ float linear_at(const ReadCodes& texture, int64_t i) {
  return texture.decoded[__ldg(texture.codes + i)];
}

// Codes of 16 bits are decoded where they are read: a table of all would take 256 KiB. Not inlined, because few textures
// have them and the code is long.
__device__ __noinline__ void sample_wide(const Texture& t, float u, float v, Filter filter, Wrap wrap, float out[3]) {
  sample((const uint16_t*)t.texels, t.height, t.width, 3, u, v, filter, wrap, out);
}

__device__ __forceinline__ void look_up(const Lookups& lookups, int32_t texture, int32_t bits, float u, float v,
                                        float out[3]) {
  const Texture& t = lookups.textures[texture];
  const Filter filter = bits & kLookNearest ? Filter::kNearest : Filter::kBilinear;
  const Wrap wrap = bits & kLookClamp ? Wrap::kClamp : Wrap::kRepeat;
  if (t.kind == Texels::kCodes8)
    sample(ReadCodes{(const uint8_t*)t.texels, lookups.codes->decoded}, t.height, t.width, 3, u, v, filter, wrap, out);
  else if (t.kind == Texels::kLinear)
    sample(ReadTexels{(const float*)t.texels}, t.height, t.width, 3, u, v, filter, wrap, out);
  else {
    float wide[3];  // a call puts it into memory, and `out` stays in registers
    sample_wide(t, u, v, filter, wrap, wide);
    for (int c = 0; c < 3; ++c) out[c] = wide[c];
  }
}

// What is wanted of a pixel beside the picture.
struct Finished {
  float albedo[3], normal[3], linear[3];
};

// Parts of a skin that is there.
struct SkinAtHand {
  const Skin& skin;
  __device__ __forceinline__ const SkinLook& look() const { return skin.look; }
  __device__ __forceinline__ const CornerVectors& normal() const { return skin.normal; }
  __device__ __forceinline__ const CornerVectors& color() const { return skin.color; }
};
// Of one that an earlier kernel has written to memory.
struct SkinInMemory {
  const Skin* skin;
  __device__ __forceinline__ SkinLook look() const { return loaded(&skin->look); }
  __device__ __forceinline__ CornerVectors normal() const { return loaded(&skin->normal); }
  __device__ __forceinline__ CornerVectors color() const { return loaded(&skin->color); }
};

// Finishes a pixel that has these weights. Parts: SkinAtHand or SkinInMemory.
template <class Parts>
__device__ __forceinline__ void finish(const Surface& s, const Lookups& lookups, const Parts& skin,
                                       const float weight[3], Finished* out) {
  const auto mean = [&](const float at[3]) { return interpolate(weight, at[0], at[1], at[2]); };
  const SkinLook look = skin.look();
  for (int c = 0; c < 3; ++c) out->albedo[c] = look.base[c];
  if (look.texture >= 0) {
    float texel[3];
    look_up(lookups, look.texture, look.bits, mean(look.uv[0]), mean(look.uv[1]), texel);
    for (int c = 0; c < 3; ++c) out->albedo[c] = out->albedo[c] * texel[c];
  }
  if (look.bits & kLookVertexColors) {
    const CornerVectors color = skin.color();
    for (int c = 0; c < 3; ++c) out->albedo[c] = out->albedo[c] * mean(color.value[c]);
  }
  float light[3];
  for (int c = 0; c < 3; ++c) out->normal[c] = 0.0f;
  if (look.bits & (kSmoothNormal | kFaceNormal)) {
    const CornerVectors normal = skin.normal();
    for (int c = 0; c < 3; ++c) {
      out->normal[c] = look.bits & kSmoothNormal ? mean(normal.value[c]) : normal.value[c][0];
      light[c] = normal.value[c][1];
    }
  }
  for (int c = 0; c < 3; ++c) out->normal[c] = out->normal[c] * look.facing;
  if (!(look.bits & kLitFace)) light_on(out->normal, s.ambient, lookups.lights, s.lights, light);
  for (int c = 0; c < 3; ++c) out->linear[c] = out->albedo[c] * light[c];
}

// The same of the background in a row of the buffer.
__device__ __forceinline__ void finish_background(const Shading& job, int y, Finished* out) {
  for (int c = 0; c < 3; ++c) out->albedo[c] = out->normal[c] = 0.0f;
  background_at(job.surface, y, job.height, job.channels, out->linear);
}

// Stores what is wanted of pixel i beside the picture.
__device__ __forceinline__ void store_beside(const Shading& job, const Finished& pixel, uint32_t i) {
  for (int c = 0; c < 3; ++c) {
    const int64_t at = 3 * (int64_t)i + c;
    if (job.albedo) job.albedo[at] = pixel.albedo[c];
    if (job.normals) job.normals[at] = pixel.normal[c];
    if (job.linear) job.linear[at] = pixel.linear[c];
  }
}

// A pixel of the picture, the first channel in the lowest byte; opaque.
__device__ __forceinline__ uint32_t encoded(const Codes& codes, const float linear[3]) {
  return encode_srgb(linear[0], codes.encode) | encode_srgb(linear[1], codes.encode) << 8 |
         encode_srgb(linear[2], codes.encode) << 16 | 0xff000000u;
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

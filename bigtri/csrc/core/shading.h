// Lambert shading and sRGB encoding of a pixel, in float32, the last stage, which follows attributes and textures; and
// what a texture's sRGB codes stand for. docs/numerics.md 11. Mirrors bigtri/reference/shading.py.
#pragma once

#include "platform.h"

namespace bigtri {

struct Light {
  float direction[3], color[3];
};
// Lights whose directions and colours are arrays, [lights, 3].
struct LightArrays {
  const float *directions, *colors;
};
BIGTRI_HD Light light_at(const LightArrays& lights, int64_t l) {
  const float *d = lights.directions + 3 * l, *c = lights.colors + 3 * l;
  return {{d[0], d[1], d[2]}, {c[0], c[1], c[2]}};
}

// v / length of three v, none of which is larger.
template <class F>
BIGTRI_HD void divide_all(const F v[3], const F& length, F out[3]) {
  for (int i = 0; i < 3; ++i) out[i] = v[i] / length;
}
#if defined(__CUDA_ARCH__)
// The same by one inverse. From an inverse that is within a rounding of it, a quotient is correctly rounded if it is
// corrected once by its exact remainder; so does the compiler divide, where nothing comes near the ends of float32's range.
// It calls a function as soon as one of a warp's dividends is 0, as two of three are on a surface along the axes, for
// which these steps give a 0 too.
BIGTRI_HD void divide_all(const float v[3], const float& length, float out[3]) {
  constexpr uint32_t kLeast = 27u << 23, kLeastLength = 107u << 23, kMostLength = 147u << 23;  // 2^-100, 2^-20, 2^20
  bool usual = float_bits(length) - kLeastLength <= kMostLength - kLeastLength;
  for (int i = 0; i < 3; ++i) usual &= 2 * float_bits(v[i]) - 1 >= 2 * kLeast - 1;  // 0 wraps around
  if (!usual) {
    for (int i = 0; i < 3; ++i) out[i] = v[i] / length;
    return;
  }
  float inverse;
  asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(inverse) : "f"(length));
  inverse = __fmaf_rn(inverse, __fmaf_rn(inverse, -length, 1.0f), inverse);
  for (int i = 0; i < 3; ++i) {
    const float q = __fmul_rn(v[i], inverse);
    out[i] = __fmaf_rn(inverse, __fmaf_rn(q, -length, v[i]), q);
  }
}
#endif

// The light that a surface with this normal gets. normal, ambient, out: [3]. The normal need not have length 1. F is
// float, or a vector of floats; Lights: what light_at takes.
template <class F, class Lights>
BIGTRI_HD void light_on(const F normal[3], const float ambient[3], const Lights& lights, int64_t count, F out[3]) {
  const F s = (normal[0] * normal[0] + normal[1] * normal[1]) + normal[2] * normal[2], length = square_root(s);
  F n[3];
  // Where s is an infinity, each n[i] is 0 or a NaN, and so is `facing`, which is not above 0 then: no light counts, as
  // with the normal (0, 0, 0).
  divide_all(normal, length, n);
  for (int i = 0; i < 3; ++i) {
    n[i] = select(s > 0.0f, n[i], constant(0.0f, s));
    out[i] = constant(ambient[i], s);
  }
#if defined(__CUDA_ARCH__)
#pragma unroll 1  // most scenes have two, of which a loop that takes four at a time makes its rest
#endif
  for (int l = 0; l < (int)count; ++l) {
    const Light light = light_at(lights, l);
    const F facing = (n[0] * light.direction[0] + n[1] * light.direction[1]) + n[2] * light.direction[2];
    const F cosine = select(facing > 0.0f, facing, constant(0.0f, s));
    for (int i = 0; i < 3; ++i) out[i] = out[i] + light.color[i] * cosine;
  }
}

// What is seen of it. albedo: [3].
template <class F, class Lights>
BIGTRI_HD void lambert(const F normal[3], const F albedo[3], const float ambient[3], const Lights& lights,
                       int64_t count, F out[3]) {
  F light[3];
  light_on(normal, ambient, lights, count, light);
  for (int i = 0; i < 3; ++i) out[i] = albedo[i] * light[i];
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

// The sRGB byte of a linear value: the number of thresholds that are <= v. A NaN gives 0. This is a binary search in
// thresholds [255], ascending, which takes eight comparisons for any v.
BIGTRI_HD uint8_t encode_srgb(float v, const float* thresholds) {
  int from = 0;
  for (int step = 128; step > 0; step /= 2)
    if (thresholds[from + step - 1] <= v) from += step;
  return (uint8_t)from;
}

// The same with a single lookup, for a processor that has the cache for it: a table by the upper half of a float's bits,
// from 2^-13, which is below all thresholds, to 1. Such a step is at most 1/128 of its value wide, and thresholds lie
// further apart, 2.4 / 255 / 1.055 of their value or more, so that a step holds one of them at most.
constexpr float kSrgbLeast = 1.0f / 8192;
constexpr uint32_t kSrgbFirstStep = 0x3900, kSrgbLastStep = 0x3f80;  // the upper halves of 2^-13 and of 1
constexpr uint32_t kSrgbSteps = kSrgbLastStep - kSrgbFirstStep + 1;
struct SrgbSteps {
  // Of each step, 2^16 times the byte of its first value. Where it holds a threshold, what the lower half of that one's
  // bits lacks to 2^16 is added: with the lower half of a value's bits it carries into the byte from the threshold on. The
  // upper half of the bits is subtracted beforehand, so that all of a value's bits can be added. Modulo 2^32.
  uint32_t byte[kSrgbSteps];
};

// v, brought to where the table has steps; to the least one if it is a NaN. F is float, or a vector of floats.
template <class F>
BIGTRI_HD F within_steps(const F& v) {
  const F least = constant(kSrgbLeast, v), one = constant(1.0f, v);
  return select(v > kSrgbLeast, select(v > 1.0f, one, v), least);
}

// Of a value within the steps, from its bits: the step; and with what the table has of that, the byte, in the lowest eight
// bits. U is uint32_t, or a vector of it.
template <class U>
BIGTRI_HD U step_of(const U& bits) {
  return (bits >> 16u) - kSrgbFirstStep;
}
template <class U>
BIGTRI_HD U byte_of(const U& bits, const U& of_step) {
  return (of_step + bits) >> 16u;
}

#if defined(__CUDA_ARCH__)
// The same, for a minimum and a maximum are one instruction each there, and give the other number where one is a NaN.
BIGTRI_HD float within_steps(float v) { return fminf(fmaxf(v, kSrgbLeast), 1.0f); }
#endif

BIGTRI_HD uint8_t encode_srgb(float v, const SrgbSteps& table) {
  const uint32_t bits = float_bits(within_steps(v));
  return (uint8_t)byte_of(bits, table.byte[step_of(bits)]);
}

// What the table has of a step.
BIGTRI_HD uint32_t srgb_step(const float* thresholds, uint32_t step) {
  const uint32_t from = encode_srgb(bits_float(step << 16), thresholds);
  const bool holds = from < 255 && float_bits(thresholds[from]) >> 16 == step;
  const uint32_t lack = holds ? ((step + 1) << 16) - float_bits(thresholds[from]) : 0;
  return (from << 16) + lack - (step << 16);
}

inline void fill_srgb_steps(const float* thresholds, SrgbSteps* table) {
  for (uint32_t i = 0; i < kSrgbSteps; ++i) table->byte[i] = srgb_step(thresholds, kSrgbFirstStep + i);
}

}  // namespace bigtri

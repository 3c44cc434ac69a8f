// What the shading pass reads of a scene, the same for CPU and GPU; docs/numerics.md 18. The binding fills a Surface.
// Effects that a plan leaves out are left out here: their arrays are null. Mirrors bigtri/reference/shade.py.
#pragma once

#include "texture.h"

namespace bigtri {

// What a material asks for, where the surface has the data.
enum LookBit : int32_t {
  kLookVertexColors = 1,
  kLookSmooth = 2,    // normals are interpolated from the vertices
  kLookTwoSided = 4,  // normals of back faces are turned round
  kLookNearest = 8,   // Filter::kNearest, else kBilinear
  kLookClamp = 16,    // Wrap::kClamp, else kRepeat
};

struct Look {
  int32_t bits;     // of LookBit
  int32_t texture;  // index into the surface's textures; -1: none
};

enum class Texels : int32_t { kLinear, kCodes8, kCodes16 };  // float, uint8_t, uint16_t
struct Texture {
  const void* texels;  // [height, width, 3], row 0 on top
  int32_t height, width;
  Texels kind;
};

// On CUDA the pointers are to device memory, but for those of textures' own structs.
struct Surface {
  const float* uvs;           // [V, 2]; null: nothing is textured
  const float* colors;        // [V, 3]; null: no vertex colours
  const float* normals;       // [V, 3]; null: nothing is smooth
  const float* face_normals;  // [T, 3]; null: what is not smooth has the normal (0, 0, 0), or is smooth all the same
  const int32_t* material;    // [T], indices into looks and base_colors
  const Look* looks;          // [M]
  const float* base_colors;   // [M, 3], linear
  const Texture* textures;
  int32_t materials, texture_count;
  bool two_sided;                           // false: no normal is turned round
  const float *light_directions, *light_colors;  // [lights, 3]
  int64_t lights;
  float ambient[3], top[3], bottom[3];  // linear; the background's colours at the top and the bottom of the picture
};

// The background of row y of `height` rows of samples; black where it is transparent, in a picture of four channels.
BIGTRI_HD void background_at(const Surface& s, int y, int height, int channels, float out[3]) {
  const float down = ((float)y + 0.5f) / (float)height;
  for (int i = 0; i < 3; ++i) out[i] = channels == 4 ? 0.0f : s.top[i] + (s.bottom[i] - s.top[i]) * down;
}

// Whether triangle (x, y, w) of clip space shows its back: the sign of det(x, y, w) of its corners. Clipping does not
// change it, and no w needs to be positive.
BIGTRI_HD bool is_back(const float a[4], const float b[4], const float c[4]) {
  const double ax = a[0], ay = a[1], aw = a[3], bx = b[0], by = b[1], bw = b[3], cx = c[0], cy = c[1], cw = c[3];
  return (ax * (by * cw - cy * bw) - ay * (bx * cw - cx * bw)) + aw * (bx * cy - cx * by) < 0.0;
}

// The alpha of a pixel of which `covered` samples of `samples` are covered, rounded half up.
BIGTRI_HD uint8_t alpha_of(int covered, int samples) {
  return (uint8_t)((2 * 255 * covered + samples) / (2 * samples));
}

// A pixel, of the total of `samples` samples, of which `covered` are covered: their mean, in a transparent picture that
// of the covered ones. Table: what encode_srgb takes.
template <class Table>
BIGTRI_HD void store_mean(const float total[3], int covered, int samples, int channels, const Table& table,
                          uint8_t* pixel) {
  const int of = channels == 4 ? max_of(covered, 1) : samples;
  for (int c = 0; c < 3; ++c) pixel[c] = encode_srgb(total[c] / (float)of, table);
  if (channels == 4) pixel[3] = alpha_of(covered, samples);
}

}  // namespace bigtri

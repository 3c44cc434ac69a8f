// The shading pass on the GPU: from a visibility buffer to a picture; torch-free. What a rung has for it is in rungs.h.
#pragma once

#include "../core/surface.h"

namespace bigtri {

// Pointers are to device memory, but for the surface's `textures` and for `thresholds`, which go to the device with the
// launches, so that a CUDA graph keeps them.
struct Shading {
  const int64_t* packed;  // [B, H, W], any values
  const float* positions;  // [B, V, 4], clip space
  const int32_t* triangles;  // [T, 3]; one with an index that is no vertex, or of no material, reads as background
  Surface surface;  // a texture that is none of those that there are reads as none
  const float* thresholds;  // [255], of sRGB
  uint8_t* image;  // out: [B, H / samples, W / samples, channels], sRGB
  float *albedo, *normals, *linear;  // out, or null: [B, H, W, 3], as ShadeJob has them
  int64_t views;  // B
  int64_t vertices;  // V
  int32_t count;  // T
  int height, width;  // of the visibility buffer, px; multiples of samples
  // Null, or memory for the areas of the picture (areas.h): of the visibility buffer only those listed there are then read.
  // Only where the rung's shades_areas() says so.
  void* areas;
  int samples;  // of a pixel of the picture along each axis
  int channels;  // of the picture: 3, or 4 with alpha
  bool fills;  // whether triangles probably touch most of the picture; no bit of it depends on that
};

}  // namespace bigtri

// Interpolation over a visibility buffer on the GPU; torch-free. What a rung has for it is in rungs.h.
#pragma once

#include "../core/platform.h"

namespace bigtri {

// Pointers are to device memory.
struct Interpolation {
  const int64_t* packed;     // [B, H, W], any values
  const float* positions;    // [B, V, 4] or [V, 4], clip space
  const int32_t* triangles;  // [T, 3]; one with an index that is no vertex reads as background
  const float* attributes;   // [V, C] or [B, V, C]; without a vertex null
  bool weights;              // no attributes: the barycentrics of the parent's corners
  float* out;                // [B, H, W, channels]
  uint32_t* clipped;         // interpolation_scratch bytes
  int64_t batch;             // B
  int64_t vertices;          // V
  int64_t position_view;     // floats from one view's positions to the next one's; 0 where all views share them
  int64_t attribute_view;    // floats from one view's attributes to the next one's; 0 where all views share them
  int64_t channels;          // C, or 3
  int32_t count;             // T
  int height, width;
};

constexpr int kGroup = 32;  // pixels that a warp takes together
BIGTRI_HD int64_t groups_of(int64_t height, int64_t width) { return (height * width + kGroup - 1) / kGroup; }
// Bytes of memory that it works with: for each group, which of its pixels are of clipped triangles.
BIGTRI_HD int64_t interpolation_scratch(int64_t batch, int64_t height, int64_t width) {
  return batch * groups_of(height, width) * (int64_t)sizeof(uint32_t);
}

}  // namespace bigtri

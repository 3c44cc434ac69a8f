// A pixel of a visibility buffer; docs/numerics.md 8. Mirrors bigtri/reference/visibility.py.
#pragma once

#include "frame.h"

namespace bigtri {

// Nearer first, then the lower triangle index. For depths up to 1.
BIGTRI_HD int64_t pack_depth(float z, uint32_t triangle) {
  return (int64_t)(((uint64_t)float_bits(z) << 32) | triangle);
}

// The same for any depth: z > 1 leaves the background.
BIGTRI_HD int64_t pack_fragment(float z, uint32_t triangle) { return z > 1.0f ? kBackground : pack_depth(z, triangle); }

// What has been packed; infinity on the background.
BIGTRI_HD float depth_of(int64_t packed) {
  return packed == kBackground ? kInfinity : bits_float((uint32_t)(packed >> 32));
}

}  // namespace bigtri

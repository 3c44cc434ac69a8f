// A packed pixel of the visibility buffer: depth bits above, triangle index below; docs/numerics.md 8. The last stage
// of drawing keeps the minimum of each pixel. Mirrors bigtri/reference/visibility.py.
#pragma once

#include "frame.h"

namespace bigtri {

// The packed value of a fragment. Bits of floats >= +0 ascend with the floats, so the minimum is the nearer fragment,
// then the lower triangle index. z must be at most 1; farther fragments are dropped.
BIGTRI_HD int64_t pack_depth(float z, uint32_t triangle) {
  return (int64_t)(((uint64_t)float_bits(z) << 32) | triangle);
}

// The same for any depth. A fragment with z > 1 gives the background, which changes no pixel.
BIGTRI_HD int64_t pack_fragment(float z, uint32_t triangle) { return z > 1.0f ? kBackground : pack_depth(z, triangle); }

// The depth of a packed value; infinity for the background.
BIGTRI_HD float depth_of(int64_t packed) {
  return packed == kBackground ? kInfinity : bits_float((uint32_t)(packed >> 32));
}

}  // namespace bigtri

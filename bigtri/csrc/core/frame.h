// What there is to draw and where it goes, the same for CPU and GPU; docs/numerics.md 1 and 8.
#pragma once

#include "platform.h"

namespace bigtri {

constexpr int kMaxSize = 16384;  // px
constexpr int kBinBits = 6;
constexpr int kBin = 1 << kBinBits;  // px; int32 edge values are exact in a bin of 64, not of 128
constexpr int kTile = 8;             // px
constexpr int64_t kBackground = INT64_MAX;

enum Cull : int { kCullNone = 0, kCullBack = 1, kCullFront = 2 };

// The image, the scissor cut to it (half-open, px), and which faces are left out.
struct Viewport {
  int width, height;
  int x0, y0, x1, y1;
  int cull;
};

// Views of one mesh. On CUDA pointers are to device memory.
struct Frame {
  const float* positions;    // [views, vertices, 4], clip space
  const int32_t* triangles;  // [count, 3], shared by all views
  int64_t vertices;          // of a view
  int32_t count;             // triangles
  int32_t views;
  Viewport view;      // the same for every view
  int64_t* packed;    // [views, height, width]
  float* depth;       // [views, height, width] or null
  int64_t* dropped;   // [views]
  int64_t* counters;  // [kCounters], or null where nothing is counted (core/counters.h)
};

// One view of a frame, as a frame.
BIGTRI_HD Frame view_of(const Frame& f, int64_t view) {
  const int64_t pixels = (int64_t)f.view.width * f.view.height;
  Frame one = f;
  one.views = 1;
  one.positions = f.positions + view * f.vertices * 4;
  one.packed = f.packed + view * pixels;
  one.depth = f.depth ? f.depth + view * pixels : nullptr;
  one.dropped = f.dropped + view;
  return one;
}

}  // namespace bigtri

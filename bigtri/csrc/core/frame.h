// The input and output of a draw call, the same for CPU and GPU; docs/numerics.md 1 and 8. The binding fills a Frame
// and hands it to a variant. Mirrors the arguments and results of bigtri/reference/pipeline.py.
#pragma once

#include "platform.h"

namespace bigtri {

constexpr int kMaxSize = 16384;  // px; limit of width and of height
constexpr int kBinBits = 6;
constexpr int kBin = 1 << kBinBits;         // px; f fits int32 in a bin of 64 px (binning.h), but not in one of 128
constexpr int kTile = 8;                    // px
constexpr int64_t kBackground = INT64_MAX;  // packed value of a pixel that no triangle covers

struct CountedWork;  // of cuda/counted_work.h

enum Cull : int { kCullNone = 0, kCullBack = 1, kCullFront = 2 };

struct Viewport {
  int width, height;   // of the image, px
  int x0, y0, x1, y1;  // the scissor, cut to the image; px, half-open
  int cull;            // a Cull: which faces are not drawn
};

// One call: a list of triangles and the views that it is drawn in. On CUDA the pointers are to device memory.
struct Frame {
  const float* positions;    // [views, vertices, 4], clip space; [vertices, 4] if view_stride is 0
  const int32_t* triangles;  // [count, 3], vertex indices, shared by all views
  int64_t vertices;          // per view
  int32_t count;             // triangles
  int32_t views;
  Viewport view;      // the same for every view
  int64_t* packed;    // out: [views, height, width], the visibility buffer
  float* depth;       // out: [views, height, width], window depth; or null
  int64_t* dropped;   // out: [views], triangles dropped
  // What CUDA's kernels that count add to, in the device's memory; null elsewhere. The CPU's is CheckedFrame::counters.
  const CountedWork* counted;
  int64_t view_stride;  // floats from one view's positions to the next's; 0 if all views share them
  int32_t first_triangle;  // the id of triangle 0; the others' follow
  // [views, 2], each view's first triangle and number of triangles; null: all in every view. In host memory always.
  const int32_t* ranges;
  // Null, or on CUDA memory for the areas (cuda/areas.h) of a picture that has so many samples a pixel along each axis: what
  // no triangle may touch need not be written.
  void* areas;
  int area_samples;
};

// The triangles [first, end) of a view. A triangle's id is its place in the whole list.
struct Range {
  int64_t first, end;
};
BIGTRI_HD Range range_of(const Frame& f, int64_t view) {
  if (!f.ranges) return {0, f.count};
  return {f.ranges[2 * view], (int64_t)f.ranges[2 * view] + f.ranges[2 * view + 1]};
}

// Triangles of all views together.
inline int64_t triangles_of_all(const Frame& f) {
  if (!f.ranges) return (int64_t)f.views * f.count;
  int64_t all = 0;
  for (int32_t v = 0; v < f.views; ++v) all += f.ranges[2 * v + 1];
  return all;
}

// Pixels of all views together.
BIGTRI_HD int64_t pixels_of_all(const Frame& f) { return f.views * ((int64_t)f.view.width * f.view.height); }

// The first pixel of a view.
BIGTRI_HD int64_t* pixels_of(const Frame& f, int64_t view) {
  return f.packed + view * ((int64_t)f.view.width * f.view.height);
}

// The views [first, first + count) of a frame, as a frame.
BIGTRI_HD Frame views_of(const Frame& f, int64_t first, int32_t count) {
  const int64_t pixels = (int64_t)f.view.width * f.view.height;
  Frame some = f;
  some.views = count;
  some.positions = f.positions + first * f.view_stride;
  some.ranges = f.ranges ? f.ranges + 2 * first : nullptr;
  some.packed = f.packed ? pixels_of(f, first) : nullptr;
  some.depth = f.depth ? f.depth + first * pixels : nullptr;
  some.dropped = f.dropped + first;
  some.areas = nullptr;  // those of all views together
  return some;
}

// One view of a frame, as a frame. Its range, if there are ranges, is range_of(one, 0).
BIGTRI_HD Frame view_of(const Frame& f, int64_t view) { return views_of(f, view, 1); }

}  // namespace bigtri

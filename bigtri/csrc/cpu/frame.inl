// Between a bin's pixels and the frame; compiled once per instruction set.
#pragma once

#include "kernels.h"
#include "simd.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// The bin's part of the image, px.
struct Patch {
  int x, y, width, height;
  int64_t at;  // its first pixel's place in `packed` and `depth`
};

BIGTRI_INLINE Patch patch_of(const RasterJob& job, int64_t view, int bin_x, int bin_y) {
  const int x = bin_x * kBin, y = bin_y * kBin;
  return {x, y, min_of(kBin, job.view.width - x), min_of(kBin, job.view.height - y),
          (view * job.view.height + y) * job.view.width + x};
}

void load_bin(const RasterJob& job, const Patch& p, int64_t* pixels) {
  for (int j = 0; j < p.height; ++j)
    __builtin_memcpy(pixels + j * kBin, job.packed + p.at + (int64_t)j * job.view.width,
                     (size_t)p.width * sizeof(int64_t));
}

// Tiles and spans ignore the scissor inside a bin; what they drew outside it is taken back here, in the few bins that it crosses.
void apply_scissor(const Viewport& v, const Patch& p, int64_t* pixels) {
  if (v.x0 <= p.x && v.y0 <= p.y && v.x1 >= p.x + p.width && v.y1 >= p.y + p.height) return;
  for (int j = 0; j < p.height; ++j)
    for (int i = 0; i < p.width; ++i)
      if (p.x + i < v.x0 || p.x + i >= v.x1 || p.y + j < v.y0 || p.y + j >= v.y1) pixels[j * kBin + i] = kBackground;
}

// Row j of a patch: the pixels given, or background where there are none.
BIGTRI_INLINE void store_row(const RasterJob& job, const Patch& p, int j, const int64_t* row) {
  const i64x8 background = splat<i64x8>(kBackground);
  const int64_t at = p.at + (int64_t)j * job.view.width;
  int64_t* to = job.packed + at;
  if (p.width == kBin && ((uintptr_t)to & 63) == 0)
    for (int i = 0; i < kBin; i += 8) stream(to + i, row ? load<i64x8>(row + i) : background);
  else
    for (int i = 0; i < p.width; ++i) to[i] = row ? row[i] : kBackground;
  if (!job.depth) return;
  float* depth = job.depth + at;
  if (p.width == kBin && ((uintptr_t)depth & 31) == 0)
    for (int i = 0; i < kBin; i += 8) stream(depth + i, depths_of(row ? load<i64x8>(row + i) : background));
  else
    for (int i = 0; i < p.width; ++i) depth[i] = depth_of(row ? row[i] : kBackground);
}

void store_bin(const RasterJob& job, const Patch& p, const int64_t* pixels) {
  for (int j = 0; j < p.height; ++j) store_row(job, p, j, pixels + j * kBin);
}

void store_background(const RasterJob& job, const Patch& p) {
  for (int j = 0; j < p.height; ++j) store_row(job, p, j, nullptr);
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

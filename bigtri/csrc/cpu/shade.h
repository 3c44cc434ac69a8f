// The kernel of the shading pass, and the data that it shares with shade.cpp and with the variant bin_owned, which shades
// each bin as soon as it is drawn. Compiled once per rung.
#pragma once

#include "backend.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

// Samples of one view that are shaded at a time: a rectangle of whole pixels, up to kBin samples a side.
struct ShadeBlock {
  int64_t view;
  const int64_t* packed;  // of its first sample
  int64_t pitch;  // packed values from one row to the next
  int x, y, width, height;
};

// Bytes of a worker's memory: at least sizeof(ShadeScratch) (shade.inl). `begin` must have been called on it for this job.
constexpr int64_t kShadeScratchBytes = 192 * 1024;

struct ShadeKernels {
  // scratch is 64-byte aligned.
  void (*begin)(void* scratch);
  void (*block)(const ShadeJob& job, const ShadeBlock& block, void* scratch);
  // The background of `width` x `height` samples from (x, y) on, whole pixels; wider than a block.
  void (*background)(const ShadeJob& job, int64_t view, int x, int y, int width, int height);
};

// The side of the blocks that a view is cut into: the most samples up to kBin that are whole pixels.
inline int shade_side(const ShadeJob& job) {
  return job.samples > kBin ? job.samples : kBin / job.samples * job.samples;
}

// One view of a job, as a job; packed is the caller's to set.
inline ShadeJob view_of(const ShadeJob& job, int64_t view) {
  const int64_t pixels = (int64_t)job.height * job.width;
  ShadeJob one = job;
  one.views = 1;
  one.positions = job.positions + view * job.position_view;
  one.image = job.image + view * (pixels / (job.samples * job.samples)) * job.channels;
  for (float** image : {&one.albedo, &one.normals, &one.linear})
    if (*image) *image += view * 3 * pixels;
  return one;
}

// The pass over all blocks of a visibility buffer (shade.cpp).
void shade_views(const ShadeJob& job, const Parallel& parallel);

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// What is compiled once per instruction set, and the plain data it works on. Each user declares the kernels that it needs as a struct of its own; one build of all of them is a table
// (kernel_table.inl), and current_kernels() is the table in use.
#pragma once

#include "../core/attributes.h"
#include "../core/record.h"
#include "../core/scanline.h"
#include "../core/shading.h"
#include "../core/tile_mask.h"
#include "backend.h"
#include "bin_owned.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

// What reads a visibility buffer.
struct AttributeKernels {
  void (*interpolate_row)(const AttributeJob& job, int64_t view, int64_t row, Parent* scratch);
  void (*sample)(const float* texture, int height, int width, int64_t channels, const float* uv, int64_t count,
                 Filter filter, Wrap wrap, float* out);
  void (*lambert)(const float* normals, const float* albedo, const float* ambient, const float* directions,
                  const float* colors, int64_t lights, int64_t count, float* out);
  void (*encode_srgb)(const float* linear, const float* thresholds, int64_t count, uint8_t* out);
};

struct Kernels {
  BinOwnedKernels bin_owned;
  StageKernels stages;
  AttributeKernels attributes;
};

const Kernels& current_kernels();

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// The kernels: the functions that are compiled once per instruction set. The code that calls them declares them as a
// struct: set-up, each variant that has such, the stages, the attribute pass and the shading pass. A table of all of them is built
// for each instruction set (kernel_table.inl); current_kernels() is the table in use.
#pragma once

#include "../core/attributes.h"
#include "../core/record.h"
#include "../core/scanline.h"
#include "../core/shading.h"
#include "../core/texture.h"
#include "../core/tile_mask.h"
#include "backend.h"
#include "batched.h"
#include "bin_owned.h"
#include "coverage_masks.h"
#include "hierarchical_tiles.h"
#include "persistent.h"
#include "recursive_descent.h"
#include "setup.h"
#include "tile_owned.h"
#include "tile_queues.h"
#include "two_stage.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

template <class Texture>
using SampleKernel = void (*)(Texture texture, int height, int width, int64_t channels, const float* uv, int64_t count,
                              Filter filter, Wrap wrap, float* out);

// A row of the attribute pass, and the image operators over `count` elements. scratch need not be initialised.
struct AttributeKernels {
  void (*interpolate_row)(const AttributeJob& job, int64_t view, int64_t row, Parent* scratch);
  SampleKernel<const float*> sample;
  SampleKernel<CodedTexels<uint8_t>> sample_codes8;
  SampleKernel<CodedTexels<uint16_t>> sample_codes16;
  void (*lambert)(const float* normals, const float* albedo, const float* ambient, const float* directions,
                  const float* colors, int64_t lights, int64_t count, float* out);
  void (*encode_srgb)(const float* linear, const SrgbSteps& table, int64_t count, uint8_t* out);
};

struct Kernels {
  SetupKernels setup;
  BinOwnedKernels bin_owned;
  StageKernels stages;
  AttributeKernels attributes;
  TwoStageKernels two_stage;
  ShadeKernels shade;
  BatchedKernels batched;
  CoverageMasksKernels coverage_masks;
  HierarchicalTilesKernels hierarchical_tiles;
  PersistentKernels persistent;
  RecursiveDescentKernels recursive_descent;
  TileOwnedKernels tile_owned;
  TileQueuesKernels tile_queues;
};

const Kernels& current_kernels();

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

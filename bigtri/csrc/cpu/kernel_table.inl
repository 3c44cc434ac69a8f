// All kernels of one instruction set, as a table kernels_<name>. isa_*.cpp include it once each; before that they set
// the compiler's target and BIGTRI_SIMD, the width of a vector in bits.
#pragma once

#include "attributes.inl"
#include "batched.inl"
#include "bin_owned.inl"
#include "binning.inl"
#include "coverage_masks.inl"
#include "hierarchical_tiles.inl"
#include "persistent.inl"
#include "recursive_descent.inl"
#include "setup.inl"
#include "shade.inl"
#include "stages.inl"
#include "texture.inl"
#include "tile_owned.inl"
#include "tile_queues.inl"
#include "two_stage.inl"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// A kernel is compiled only if a table names it. Null is what a rung does without, and what another one's code does for it.

constexpr SetupKernels setup_kernels() {
  if constexpr (Rung::kDraws)
    return {.project = project, .setup = setup};
  else
    return {};
}
constexpr BinOwnedKernels bin_owned_kernels() {
  if constexpr (Rung::kBinOwned)
    return {.bin = bin_records, .raster_bins = raster_bins};
  else
    return {};
}
constexpr TwoStageKernels two_stage_kernels() {
  if constexpr (Rung::kDraws)
    return {.draw_bin = draw_bin};
  else
    return {};
}
// What the other variants draw with needs of a rung what bin_owned does: coverage by integers, and plain planes of depth.
constexpr BatchedKernels batched_kernels() {
  if constexpr (Rung::kBinOwned)
    return {.draw_box = draw_box};
  else
    return {};
}
constexpr TileQueuesKernels tile_queues_kernels() {
  if constexpr (Rung::kBinOwned)
    return {.find_tiles = find_tiles, .draw_queue = draw_queue};
  else
    return {};
}
constexpr CoverageMasksKernels coverage_masks_kernels() {
  if constexpr (Rung::kBinOwned)
    return {.coarse = coarse, .fine = fine};
  else
    return {};
}
constexpr PersistentKernels persistent_kernels() {
  if constexpr (Rung::kBinOwned)
    return {.draw_into = draw_into};
  else
    return {};
}
constexpr TileOwnedKernels tile_owned_kernels() {
  if constexpr (Rung::kBinOwned)
    return {.find_quads = find_quads, .draw_list = draw_list};
  else
    return {};
}
constexpr RecursiveDescentKernels recursive_descent_kernels() {
  if constexpr (Rung::kBinOwned)
    return {.descend = descend};
  else
    return {};
}
constexpr HierarchicalTilesKernels hierarchical_tiles_kernels() {
  if constexpr (Rung::kBinOwned)
    return {.walk_up = walk_up};
  else
    return {};
}
constexpr StageKernels stage_kernels() {
  if constexpr (Rung::kDraws && !kCounts)
    return {.tile_mask = stage_tile_mask,
            .scan_tiles = stage_scan_tiles,
            .scan_rows = stage_scan_rows,
            .depth = stage_depth};
  else
    return {};
}
// No rung differs in what is done with images: shading.cpp takes these kernels from the default rung.
constexpr AttributeKernels attribute_kernels() {
  AttributeKernels kernels = {};
  if constexpr (!kCounts) kernels.interpolate_row = stage_interpolate_row;
  if constexpr (!kCounts && std::is_same_v<Rung, rungs::exact>) {
    kernels.sample = stage_sample<const float*>;
    kernels.sample_codes8 = stage_sample<CodedTexels<uint8_t>>;
    kernels.sample_codes16 = stage_sample<CodedTexels<uint16_t>>;
    kernels.lambert = stage_lambert;
    kernels.encode_srgb = stage_encode_srgb;
  }
  return kernels;
}
constexpr ShadeKernels picture_kernels() {
  if constexpr (kCounts)
    return {};
  else
    return {.begin = shade_begin, .block = shade_block, .background = shade_background};
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE

#define BIGTRI_KERNEL_TABLE(NAME)                         \
  inline namespace BIGTRI_NAMESPACE {                     \
  extern const Kernels kernels_##NAME;                    \
  const Kernels kernels_##NAME = {                        \
      .setup = setup_kernels(),                           \
      .bin_owned = bin_owned_kernels(),                   \
      .stages = stage_kernels(),                          \
      .attributes = attribute_kernels(),                  \
      .two_stage = two_stage_kernels(),                   \
      .shade = picture_kernels(),                         \
      .batched = batched_kernels(),                       \
      .coverage_masks = coverage_masks_kernels(),         \
      .hierarchical_tiles = hierarchical_tiles_kernels(), \
      .persistent = persistent_kernels(),                 \
      .recursive_descent = recursive_descent_kernels(),   \
      .tile_owned = tile_owned_kernels(),                 \
      .tile_queues = tile_queues_kernels(),               \
  };                                                      \
  }

}  // namespace bigtri

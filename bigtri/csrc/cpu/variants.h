// The variants of the CPU that are compiled for each rung; the first is what "auto" means. Each is a file <name>.cpp
// here, which defines <name>_variant. variants.cpp makes a table of them. setup.py reads the lists.
#pragma once

#define BIGTRI_CPU_VARIANTS_exact(X) \
  X(bin_owned) X(scanline) X(two_stage) X(batched) X(tile_queues) X(coverage_masks) X(persistent) X(tile_owned)
#define BIGTRI_CPU_VARIANTS_balanced(X) \
  X(bin_owned) X(scanline) X(two_stage) X(batched) X(tile_queues) X(coverage_masks) X(persistent) X(tile_owned)
#define BIGTRI_CPU_VARIANTS_fast(X) \
  X(bin_owned) X(scanline) X(two_stage) X(batched) X(tile_queues) X(coverage_masks) X(persistent) X(tile_owned)
#define BIGTRI_CPU_VARIANTS_subpixel4(X) \
  X(bin_owned) X(scanline) X(two_stage) X(batched) X(tile_queues) X(coverage_masks) X(persistent) X(tile_owned)
#define BIGTRI_CPU_VARIANTS_subpixel12(X) X(two_stage)
#define BIGTRI_CPU_VARIANTS_subpixel16(X) X(two_stage)
#define BIGTRI_CPU_VARIANTS_coverage_int64(X) X(two_stage)
#define BIGTRI_CPU_VARIANTS_coverage_int32(X) X(two_stage)
#define BIGTRI_CPU_VARIANTS_coverage_float32(X) X(two_stage)
#define BIGTRI_CPU_VARIANTS_coverage_float32_fused(X) X(two_stage)
#define BIGTRI_CPU_VARIANTS_coverage_float32_canonical(X) X(two_stage)
#define BIGTRI_CPU_VARIANTS_coverage_float32_inclusive(X) X(two_stage)
#define BIGTRI_CPU_VARIANTS_coverage_float32_strict(X) X(two_stage)
#define BIGTRI_CPU_VARIANTS_depth_float32_cell(X) X(two_stage)
#define BIGTRI_CPU_VARIANTS_depth_float32_vertex(X) X(two_stage)
#define BIGTRI_CPU_VARIANTS_depth_float32_barycentric(X) X(two_stage)
#define BIGTRI_CPU_VARIANTS_depth_fixed_cell(X) X(two_stage)
#define BIGTRI_CPU_VARIANTS_depth_stored24(X) X(two_stage)
#define BIGTRI_CPU_VARIANTS_depth_stored16(X) X(two_stage)
#define BIGTRI_CPU_VARIANTS_depth_reversed(X) X(two_stage)
#define BIGTRI_CPU_VARIANTS_mask_half_tile(X) X(two_stage)
#define BIGTRI_CPU_VARIANTS_mask_bounds(X) X(two_stage)
#define BIGTRI_CPU_VARIANTS_mask_none(X) X(two_stage)
#define BIGTRI_CPU_VARIANTS_clip_float32(X) X(two_stage)
#define BIGTRI_CPU_VARIANTS_clip_none(X) X(two_stage)
#define BIGTRI_CPU_VARIANTS_attributes_float32(X) X(two_stage)
#define BIGTRI_CPU_VARIANTS_attributes_reciprocal(X) X(two_stage)
#define BIGTRI_CPU_VARIANTS_attributes_affine(X) X(two_stage)
#define BIGTRI_CPU_VARIANTS_attributes_unsnapped(X) X(two_stage)

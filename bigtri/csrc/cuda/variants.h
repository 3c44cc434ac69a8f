// The registry of variants on the GPU: which are compiled for which rung, the one that "auto" means first. setup.py
// compiles what is listed here, and that of `exact` a second time with counters (core/counters.h) where BIGTRI_CUDA_COUNTING
// asks for it. A list stands on one line: setup.py, .ci/run and tests/cuda/cuda_on_cpu.py read it.
#pragma once

// clang-format off: as long as it is
#define BIGTRI_CUDA_VARIANTS_exact(X) X(bin_owned) X(two_stage) X(persistent) X(scanline) X(batched) X(recursive_descent) X(hierarchical_tiles) X(tile_queues) X(coverage_masks) X(tile_owned)
// clang-format on
#define BIGTRI_CUDA_VARIANTS_balanced(X) X(bin_owned) X(two_stage) X(persistent)
#define BIGTRI_CUDA_VARIANTS_fast(X) X(bin_owned) X(two_stage) X(persistent)
#define BIGTRI_CUDA_VARIANTS_subpixel4(X) X(two_stage)
#define BIGTRI_CUDA_VARIANTS_subpixel12(X) X(two_stage)
#define BIGTRI_CUDA_VARIANTS_subpixel16(X) X(two_stage)
#define BIGTRI_CUDA_VARIANTS_coverage_int64(X) X(two_stage)
#define BIGTRI_CUDA_VARIANTS_coverage_int32(X) X(two_stage)
#define BIGTRI_CUDA_VARIANTS_coverage_float32(X) X(two_stage)
#define BIGTRI_CUDA_VARIANTS_coverage_float32_fused(X) X(two_stage)
#define BIGTRI_CUDA_VARIANTS_coverage_float32_canonical(X) X(two_stage)
#define BIGTRI_CUDA_VARIANTS_coverage_float32_inclusive(X) X(two_stage)
#define BIGTRI_CUDA_VARIANTS_coverage_float32_strict(X) X(two_stage)
#define BIGTRI_CUDA_VARIANTS_depth_float32_cell(X) X(two_stage)
#define BIGTRI_CUDA_VARIANTS_depth_float32_vertex(X) X(two_stage)
#define BIGTRI_CUDA_VARIANTS_depth_float32_barycentric(X) X(two_stage)
#define BIGTRI_CUDA_VARIANTS_depth_fixed_cell(X) X(two_stage)
#define BIGTRI_CUDA_VARIANTS_depth_stored24(X) X(two_stage)
#define BIGTRI_CUDA_VARIANTS_depth_stored16(X) X(two_stage)
#define BIGTRI_CUDA_VARIANTS_depth_reversed(X) X(two_stage)
#define BIGTRI_CUDA_VARIANTS_mask_half_tile(X) X(two_stage)
#define BIGTRI_CUDA_VARIANTS_mask_bounds(X) X(two_stage)
#define BIGTRI_CUDA_VARIANTS_mask_none(X) X(two_stage)
#define BIGTRI_CUDA_VARIANTS_clip_float32(X) X(two_stage)
#define BIGTRI_CUDA_VARIANTS_clip_none(X) X(two_stage)
#define BIGTRI_CUDA_VARIANTS_attributes_float32(X) X(two_stage)
#define BIGTRI_CUDA_VARIANTS_attributes_reciprocal(X) X(two_stage)
#define BIGTRI_CUDA_VARIANTS_attributes_affine(X) X(two_stage)
#define BIGTRI_CUDA_VARIANTS_attributes_unsnapped(X) X(two_stage)

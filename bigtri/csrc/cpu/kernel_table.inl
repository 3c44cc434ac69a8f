// Everything that one instruction set's build offers. The including file sets the target and BIGTRI_SIMD, the width of its vectors in bits.
#pragma once

#include "attributes.inl"
#include "bin_owned.inl"
#include "binning.inl"
#include "setup.inl"
#include "stages.inl"

namespace bigtri {

#define BIGTRI_KERNEL_TABLE(NAME)                        \
  extern const Kernels kernels_##NAME;                   \
  const Kernels kernels_##NAME = {#NAME,                 \
                                  project,               \
                                  setup,                 \
                                  bin_records,           \
                                  raster_bin,            \
                                  stage_tile_mask,       \
                                  stage_scan_tiles,      \
                                  stage_scan_rows,       \
                                  stage_depth,           \
                                  stage_interpolate_row, \
                                  stage_sample,          \
                                  stage_lambert,         \
                                  stage_encode_srgb};

}  // namespace bigtri

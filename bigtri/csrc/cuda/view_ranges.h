// Views that draw different triangles: what each one draws, in device memory.
#pragma once

#include "launch.cuh"

namespace bigtri {

struct ViewRange {
  int32_t first, count;  // triangles
  uint32_t first_block;  // of a grid in which each view has blocks of its own
};

// Writes the table of a frame with ranges to `to`, [views], for blocks of `each` triangles. The ranges travel in the
// arguments of the launch, so that a CUDA graph keeps them. Returns the number of blocks.
cudaError_t launch_ranges(const Frame& f, int each, ViewRange* to, int64_t* blocks, cudaStream_t stream);

}  // namespace bigtri

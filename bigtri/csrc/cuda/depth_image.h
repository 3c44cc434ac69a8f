// What comes after the triangles where the depth image is not written together with the pixels.
#pragma once

#include <cuda_runtime_api.h>

#include "../core/frame.h"

namespace bigtri {

// A frame's last kernel, where a depth image is wanted. blocks_wanted: as blocks_for has it.
cudaError_t launch_depth(const Frame& f, int64_t blocks_wanted, cudaStream_t stream);

}  // namespace bigtri

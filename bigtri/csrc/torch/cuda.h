// What the CUDA operators share: torch's current stream, and errors of a launch.
#pragma once

#include <torch/csrc/inductor/aoti_torch/c/shim.h>
#include <torch/csrc/stable/accelerator.h>

#include "../cuda/rungs.h"
#include "registry.h"

namespace bigtri {

inline cudaStream_t current_stream(int device) {
  void* stream = nullptr;
  TORCH_ERROR_CODE_CHECK(aoti_torch_get_current_cuda_stream(device, &stream));
  return static_cast<cudaStream_t>(stream);
}

inline void check_launch(const char* op, cudaError_t error) {
  if (error != cudaSuccess)
    cudaGetLastError();  // clears it; else torch's next check would report it again, for another kernel
  BIGTRI_CHECK(error == cudaSuccess, "bigtri::", op, ": the CUDA device answered '", cudaGetErrorString(error), "'");
}

}  // namespace bigtri

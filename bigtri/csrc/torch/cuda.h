// What the CUDA operators share: the device, torch's current stream, and errors of a launch.
#pragma once

#include <torch/csrc/inductor/aoti_torch/c/shim.h>
#include <torch/csrc/stable/accelerator.h>

#include "../cuda/rungs.h"
#include "registry.h"

namespace bigtri {

// The device of the first CUDA tensor. The checks that follow reject tensors on any other.
inline int device_of(std::initializer_list<const Tensor*> tensors) {
  for (const Tensor* t : tensors)
    if (t->defined() && t->is_cuda()) return t->get_device_index();
  return kCpu;
}

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

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

// Makes a device the current one, as long as it lives. Nothing is to be undone where it is so already: for torch, which
// may put off telling CUDA until the device is used, and for CUDA, which launches and is asked here.
class CurrentDevice {
 public:
  explicit CurrentDevice(int device) {
    if (torch::stable::accelerator::getCurrentDeviceIndex() != device || of_cuda() != device) guard_.emplace(device);
  }

 private:
  static int of_cuda() {
    int device;
    return cudaGetDevice(&device) == cudaSuccess ? device : kCpu;
  }

  std::optional<torch::stable::accelerator::DeviceGuard> guard_;
};

inline cudaStream_t current_stream(int device) {
  void* stream = nullptr;
  TORCH_ERROR_CODE_CHECK(aoti_torch_get_current_cuda_stream(device, &stream));
  return static_cast<cudaStream_t>(stream);
}

// Memory for launches in the current stream of the current device, from torch's allocator. Given back at the end, when
// the launches are in the stream: torch reuses it in stream order. A third of what a tensor takes.
class WorkingMemory {
 public:
  explicit WorkingMemory(int64_t bytes) {
    if (bytes > 0 && aoti_torch_cuda_caching_allocator_raw_alloc((uint64_t)bytes, &data_) != AOTI_TORCH_SUCCESS)
      fail("bigtri: no memory for ", bytes, " bytes to work with on the CUDA device");
  }
  ~WorkingMemory() {
    if (data_) aoti_torch_cuda_caching_allocator_raw_delete(data_);
  }
  WorkingMemory(const WorkingMemory&) = delete;
  WorkingMemory& operator=(const WorkingMemory&) = delete;

  void* data() const { return data_; }  // null where no bytes were asked for

 private:
  void* data_ = nullptr;
};

inline void check_launch(const char* op, cudaError_t error) {
  if (error != cudaSuccess)
    cudaGetLastError();  // clears it; else torch's next check would report it again, for another kernel
  BIGTRI_CHECK(error == cudaSuccess, "bigtri::", op, ": the CUDA device answered '", cudaGetErrorString(error), "'");
}

}  // namespace bigtri

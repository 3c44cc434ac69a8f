// Launching: how many blocks a device holds, and scratch memory in parts.
#pragma once

#include <cuda_runtime.h>

#include "frame.h"

namespace bigtri {

// As many blocks of the kernel as the current device holds at once; asked for once per kernel and device.
cudaError_t resident_blocks(const void* kernel, int threads, int64_t shared_bytes, int* blocks);

namespace {

#define BIGTRI_CUDA(CALL)                     \
  do {                                        \
    const cudaError_t error_ = (CALL);        \
    if (error_ != cudaSuccess) return error_; \
  } while (0)

// Blocks for work that is taken in turns: no more than there is work, or than Tuning::blocks says.
template <class Kernel>
cudaError_t blocks_for(Kernel kernel, int threads, int64_t shared_bytes, int64_t work, const Tuning& t, int* blocks) {
  BIGTRI_CUDA(resident_blocks(reinterpret_cast<const void*>(kernel), threads, shared_bytes, blocks));
  if (t.blocks > 0) *blocks = (int)t.blocks;
  if (work < *blocks) *blocks = (int)(work < 1 ? 1 : work);
  return cudaSuccess;
}

// Hands out parts of scratch memory, or with no memory only counts.
struct Scratch {
  char* memory;
  int64_t used = 0;

  template <class T>
  T* take(int64_t count) {
    T* part = reinterpret_cast<T*>(memory + used);
    used += (count * (int64_t)sizeof(T) + 255) / 256 * 256;
    return part;
  }
};

}  // namespace
}  // namespace bigtri

// What a variant on the GPU is; torch-free. docs/cuda.md says how they work.
#pragma once

#include <cuda_runtime_api.h>

#include "../core/frame.h"
#include "../core/registry.h"

namespace bigtri {

// A way to schedule the work: one file and one name in variants.h. values: one for each of its parameters, in the
// list's order.
struct CudaVariant {
  const char* name;
  const char* paper;  // where the idea is from
  const Parameter* parameters;
  // Of the memory that draw works with, whatever the number of views.
  int64_t (*scratch_bytes)(const Frame& frame, const int64_t* values);
  // All views of the frame. Only enqueues: nothing waits for the device.
  cudaError_t (*draw)(const Frame& frame, const int64_t* values, void* scratch, cudaStream_t stream);
  // Whether draw, where the frame has memory for areas, lists those that triangles may touch, and writes no others. Null:
  // never.
  bool (*lists_areas)(const Frame& frame, const int64_t* values) = nullptr;
};

}  // namespace bigtri

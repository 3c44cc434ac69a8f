// What there is on the GPU for each rung of the precision ladder; torch-free.
#pragma once

#include "attributes.h"
#include "variant.h"

namespace bigtri {

struct CudaRung {
  const char* name;
  const CudaVariant* const* variants;  // ends with null; the one that "auto" means first
  cudaError_t (*interpolate)(const Interpolation& job, cudaStream_t stream);
};

// All of them, the default first; ends with a null name.
extern const CudaRung kCudaRungs[];

}  // namespace bigtri

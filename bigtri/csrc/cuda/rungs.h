// What there is on the GPU for each rung of the precision ladder; torch-free.
#pragma once

#include "attributes.h"
#include "shade.h"
#include "variant.h"

namespace bigtri {

struct CudaRung {
  const char* name;
  const CudaVariant* const* variants;  // ends with null; the one that "auto" means first
  cudaError_t (*interpolate)(const Interpolation& job, cudaStream_t stream);
  // The shading pass: bytes of the memory that it works with; what it needs beside a visibility buffer, which may be made
  // at the same time; and the pass.
  int64_t (*shading_scratch)(const Shading& job);
  // Whether the pass can do without what no triangle may touch, which then is neither cleared nor read: Shading::areas.
  bool (*shades_areas)(const Shading& job);
  cudaError_t (*begin_shading)(const Shading& job, void* scratch, cudaStream_t stream);
  cudaError_t (*shade)(const Shading& job, void* scratch, cudaStream_t stream);
};

// All of them, the default first; ends with a null name.
extern const CudaRung kCudaRungs[];

// Variants of the default rung, compiled with counters (core/counters.h); null where the build has none.
extern const CudaVariant* const* const kCountingCudaVariants;

}  // namespace bigtri

// The rungs; what each of them has is compiled once per rung, in a namespace of its name.

#include "rungs.h"

#include "../core/precision.h"

namespace bigtri {

#define BIGTRI_OF_RUNG(RUNG)                                                              \
  namespace RUNG {                                                                        \
  extern const CudaVariant* const kCudaVariants[];                                        \
  cudaError_t interpolate_cuda(const Interpolation& job, cudaStream_t stream);            \
  int64_t shading_scratch(const Shading& job);                                            \
  bool shades_areas(const Shading& job);                                                  \
  cudaError_t begin_shading_cuda(const Shading& job, void* scratch, cudaStream_t stream); \
  cudaError_t shade_cuda(const Shading& job, void* scratch, cudaStream_t stream);         \
  }
BIGTRI_RUNGS(BIGTRI_OF_RUNG)
#if defined(BIGTRI_WITH_LADDER)
BIGTRI_LADDER(BIGTRI_OF_RUNG)
#endif
#undef BIGTRI_OF_RUNG

#if defined(BIGTRI_WITH_CUDA_COUNTING)
namespace exact_counting {
extern const CudaVariant* const kCudaVariants[];
}
const CudaVariant* const* const kCountingCudaVariants = exact_counting::kCudaVariants;
#else
const CudaVariant* const* const kCountingCudaVariants = nullptr;
#endif

const CudaRung kCudaRungs[] = {
#define BIGTRI_LISTED(RUNG)  \
  {#RUNG,                    \
   RUNG::kCudaVariants,      \
   RUNG::interpolate_cuda,   \
   RUNG::shading_scratch,    \
   RUNG::shades_areas,       \
   RUNG::begin_shading_cuda, \
   RUNG::shade_cuda},
    BIGTRI_RUNGS(BIGTRI_LISTED)
#if defined(BIGTRI_WITH_LADDER)
        BIGTRI_LADDER(BIGTRI_LISTED)
#endif
#undef BIGTRI_LISTED
            {},
};

}  // namespace bigtri

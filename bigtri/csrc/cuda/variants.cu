// The registry of variants of a rung.

#include "variants.h"

#include "../core/numerics.h"
#include "variant.h"

#define BIGTRI_JOIN_VARIANTS(RUNG) BIGTRI_CUDA_VARIANTS_##RUNG
#if defined(BIGTRI_COUNTING)
#define BIGTRI_VARIANTS_OF(RUNG) BIGTRI_CUDA_COUNTED
#else
#define BIGTRI_VARIANTS_OF(RUNG) BIGTRI_JOIN_VARIANTS(RUNG)
#endif

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

#define BIGTRI_DECLARED(NAME) extern const CudaVariant NAME##_variant;
BIGTRI_VARIANTS_OF(BIGTRI_RUNG)(BIGTRI_DECLARED)
#undef BIGTRI_DECLARED

    extern const CudaVariant* const kCudaVariants[];
const CudaVariant* const kCudaVariants[] = {
#define BIGTRI_LISTED(NAME) &NAME##_variant,
    BIGTRI_VARIANTS_OF(BIGTRI_RUNG)(BIGTRI_LISTED)
#undef BIGTRI_LISTED
        nullptr,
};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// The registry of variants of a rung. One that differs from another one in attributes alone is drawn by that one's
// kernels: BIGTRI_DRAWN_BY is then the namespace of that (setup.py).

#include "variants.h"

#include "../core/numerics.h"
#include "variant.h"

#define BIGTRI_JOIN_VARIANTS(RUNG) BIGTRI_CUDA_VARIANTS_##RUNG
#define BIGTRI_VARIANTS_OF(RUNG) BIGTRI_JOIN_VARIANTS(RUNG)

#if defined(BIGTRI_DRAWN_BY)
#define BIGTRI_DRAWING BIGTRI_DRAWN_BY
#else
#define BIGTRI_DRAWING BIGTRI_NAMESPACE
#endif

namespace bigtri {

namespace BIGTRI_DRAWING {
#define BIGTRI_DECLARED(NAME) extern const CudaVariant NAME##_variant;
BIGTRI_VARIANTS_OF(BIGTRI_RUNG)(BIGTRI_DECLARED)
#undef BIGTRI_DECLARED
}  // namespace BIGTRI_DRAWING

inline namespace BIGTRI_NAMESPACE {

extern const CudaVariant* const kCudaVariants[];
const CudaVariant* const kCudaVariants[] = {
#define BIGTRI_LISTED(NAME) &BIGTRI_DRAWING::NAME##_variant,
    BIGTRI_VARIANTS_OF(BIGTRI_RUNG)(BIGTRI_LISTED)
#undef BIGTRI_LISTED
        nullptr,
};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

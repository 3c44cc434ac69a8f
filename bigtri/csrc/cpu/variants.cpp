// The registry of one rung's variants: a table of the names in variants.h, for rungs.cpp. Compiled once per rung, and
// once more with counters.
#include "variants.h"

#include "../core/numerics.h"
#include "backend.h"

#define BIGTRI_JOIN_VARIANTS(RUNG) BIGTRI_CPU_VARIANTS_##RUNG
#define BIGTRI_VARIANTS_OF(RUNG) BIGTRI_JOIN_VARIANTS(RUNG)

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

#define BIGTRI_VARIANT(NAME) extern const Variant NAME##_variant;
BIGTRI_VARIANTS_OF(BIGTRI_RUNG)(BIGTRI_VARIANT)
#undef BIGTRI_VARIANT

    extern const Variant* const kVariants[];
const Variant* const kVariants[] = {
#define BIGTRI_VARIANT(NAME) &NAME##_variant,
    BIGTRI_VARIANTS_OF(BIGTRI_RUNG)(BIGTRI_VARIANT)
#undef BIGTRI_VARIANT
        nullptr,
};

#if !defined(BIGTRI_COUNTING)
extern const int32_t kGuardOfRung;
const int32_t kGuardOfRung = kGuard;
#endif

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

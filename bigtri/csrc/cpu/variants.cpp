// The registry of one rung's variants: a table of the names in variants.h, for rungs.cpp. Compiled once per rung, and
// once more with counters. A rung that differs from another one in attributes alone is drawn by that one's code:
// BIGTRI_DRAWN_BY is then the namespace of that (setup.py), and this rung has nothing but what is listed here.
#include "variants.h"

#include "../core/numerics.h"
#include "backend.h"

#define BIGTRI_JOIN_VARIANTS(RUNG) BIGTRI_CPU_VARIANTS_##RUNG
#define BIGTRI_VARIANTS_OF(RUNG) BIGTRI_JOIN_VARIANTS(RUNG)

#if defined(BIGTRI_DRAWN_BY)
#define BIGTRI_DRAWING BIGTRI_DRAWN_BY
#else
#define BIGTRI_DRAWING BIGTRI_NAMESPACE
#endif

namespace bigtri {

namespace BIGTRI_DRAWING {
#define BIGTRI_VARIANT(NAME) extern const Variant NAME##_variant;
BIGTRI_VARIANTS_OF(BIGTRI_RUNG)(BIGTRI_VARIANT)
#undef BIGTRI_VARIANT
    extern const Stages kStageFunctions;
}  // namespace BIGTRI_DRAWING

inline namespace BIGTRI_NAMESPACE {

extern const Variant* const kVariants[];
const Variant* const kVariants[] = {
#define BIGTRI_VARIANT(NAME) &BIGTRI_DRAWING::NAME##_variant,
    BIGTRI_VARIANTS_OF(BIGTRI_RUNG)(BIGTRI_VARIANT)
#undef BIGTRI_VARIANT
        nullptr,
};

#if !defined(BIGTRI_COUNTING)
extern const int32_t kGuardOfRung;
const int32_t kGuardOfRung = kGuard;
#if defined(BIGTRI_DRAWN_BY)
extern const Stages* const kStages;
const Stages* const kStages = &BIGTRI_DRAWN_BY::kStageFunctions;
#endif
#endif

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

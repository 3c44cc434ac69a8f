// The table of rungs that the binding reads. Each rung's variants and stages are defined in a namespace of the rung's
// name (core/numerics.h), so this file, which is compiled once, names them all.
#include "../core/precision.h"
#include "backend.h"

namespace bigtri {

#define BIGTRI_RUNG_DECLARED(NAME)                                           \
  namespace NAME {                                                           \
  extern const Variant* const kVariants[];                                   \
  extern const int32_t kGuardOfRung;                                         \
  extern const Stages* const kStages;                                        \
  void interpolate_views(const AttributeJob& job, const Parallel& parallel); \
  const ShadeKernels& shade_kernels();                                       \
  }
#define BIGTRI_COUNTING_DECLARED(NAME)       \
  namespace NAME##_counting {                \
    extern const Variant* const kVariants[]; \
  }
BIGTRI_RUNGS(BIGTRI_RUNG_DECLARED)
BIGTRI_RUNGS(BIGTRI_COUNTING_DECLARED)
#if defined(BIGTRI_WITH_LADDER)
BIGTRI_LADDER(BIGTRI_RUNG_DECLARED)
#endif
#undef BIGTRI_COUNTING_DECLARED
#undef BIGTRI_RUNG_DECLARED

const CpuRung kCpuRungs[] = {
#define BIGTRI_RUNG_LISTED(NAME)                                                           \
  {#NAME,         NAME::kGuardOfRung,      NAME::kVariants,    NAME##_counting::kVariants, \
   NAME::kStages, NAME::interpolate_views, NAME::shade_kernels},
    BIGTRI_RUNGS(BIGTRI_RUNG_LISTED)
#undef BIGTRI_RUNG_LISTED
#if defined(BIGTRI_WITH_LADDER)
#define BIGTRI_RUNG_LISTED(NAME) \
  {#NAME, NAME::kGuardOfRung, NAME::kVariants, nullptr, NAME::kStages, NAME::interpolate_views, NAME::shade_kernels},
        BIGTRI_LADDER(BIGTRI_RUNG_LISTED)
#undef BIGTRI_RUNG_LISTED
#endif
            {},
};

}  // namespace bigtri

// Chooses the table of kernels by the instruction set in use. Compiled once per rung, and once more with counters. The
// build with counters has the baseline alone, since every instruction set counts the same.
#include "kernels.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

extern const Kernels kernels_baseline;
#if defined(__x86_64__) && !defined(BIGTRI_COUNTING)
extern const Kernels kernels_avx2;
extern const Kernels kernels_avx512;
#endif

const Kernels& current_kernels() {
#if defined(__x86_64__) && !defined(BIGTRI_COUNTING)
  if (current_isa() == Isa::kAvx512) return kernels_avx512;
  if (current_isa() == Isa::kAvx2) return kernels_avx2;
#endif
  return kernels_baseline;
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

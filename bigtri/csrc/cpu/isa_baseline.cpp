#define BIGTRI_SIMD 0
#include "rasterize.inl"
#include "stages.inl"

namespace bigtri {
BIGTRI_KERNEL_TABLE(baseline)
}

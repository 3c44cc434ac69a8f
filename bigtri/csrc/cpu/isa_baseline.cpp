#define BIGTRI_SIMD 0
#include "kernel_table.inl"

namespace bigtri {
BIGTRI_KERNEL_TABLE(baseline)
}

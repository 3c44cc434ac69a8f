#define BIGTRI_SIMD 128
#include "kernel_table.inl"

namespace bigtri {
BIGTRI_KERNEL_TABLE(baseline)
}

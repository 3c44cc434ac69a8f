// The kernels compiled for any x86-64 machine, and for other processors: kernels_baseline, which kernels.cpp chooses if
// no other is in use.
#define BIGTRI_SIMD 128
#include "kernel_table.inl"

namespace bigtri {
BIGTRI_KERNEL_TABLE(baseline)
}

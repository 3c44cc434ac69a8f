#pragma GCC target("avx2,bmi,bmi2,lzcnt,popcnt")
#define BIGTRI_SIMD 256
#include "kernel_table.inl"

namespace bigtri {
BIGTRI_KERNEL_TABLE(avx2)
}

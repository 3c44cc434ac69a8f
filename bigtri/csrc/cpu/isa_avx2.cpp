#include <immintrin.h>  // before the region: intrinsics name their own instruction sets
#if defined(__clang__)
#pragma clang attribute push(__attribute__((target("avx2,bmi,bmi2,lzcnt,popcnt"))), apply_to = function)
#else
#pragma GCC target("avx2,bmi,bmi2,lzcnt,popcnt")
#endif
#define BIGTRI_SIMD 256
#include "kernel_table.inl"

namespace bigtri {
BIGTRI_KERNEL_TABLE(avx2)
}
#if defined(__clang__)
#pragma clang attribute pop
#endif

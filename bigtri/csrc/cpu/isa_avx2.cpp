// The kernels compiled for AVX2: kernels_avx2, which kernels.cpp chooses if the machine has it. The target is set
// by a pragma and not on the command line, so that inline functions of the C++ library stay those of the baseline.
#include <immintrin.h>  // above the pragma: intrinsics name their own instruction sets
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

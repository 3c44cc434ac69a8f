// The kernels compiled for AVX2: kernels_avx2, which kernels.cpp chooses if this instruction set is in use. A pragma
// sets the compiler's target, because all files of the extension are compiled with the same options.
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

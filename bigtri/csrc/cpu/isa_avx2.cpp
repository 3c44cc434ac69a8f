// The kernels compiled for AVX2: kernels_avx2, which kernels.cpp chooses if this instruction set is in use. A pragma
// sets the compiler's target, because all files of the extension are compiled with the same options.

// Every library header stands above the pragma. Each intrinsic carries its own target. What has external linkage, as
// the functions of the C++ library have, must not be compiled below: the linker may keep this file's copy for all
// files.
#include <immintrin.h>
#include <stdint.h>

#include <atomic>
#include <string>
#include <vector>

#if defined(__clang__)
#pragma clang attribute push(__attribute__((target("avx2,bmi,bmi2,popcnt,fma"))), apply_to = function)
#else
#pragma GCC target("avx2,bmi,bmi2,popcnt,fma")
#endif
#define BIGTRI_SIMD 256
#include "kernel_table.inl"

namespace bigtri {
BIGTRI_KERNEL_TABLE(avx2)
}
#if defined(__clang__)
#pragma clang attribute pop
#endif

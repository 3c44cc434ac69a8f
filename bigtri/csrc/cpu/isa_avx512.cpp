#pragma GCC target("avx512f,avx512vl,avx512dq,avx512bw,avx2,bmi,bmi2,lzcnt,popcnt,prefer-vector-width=512")
#define BIGTRI_SIMD 512
#include "kernel_table.inl"

namespace bigtri {
BIGTRI_KERNEL_TABLE(avx512)
}

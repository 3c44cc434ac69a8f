#pragma GCC target("avx2,bmi,bmi2,lzcnt,popcnt")
#define BIGTRI_SIMD 256
#include "rasterize.inl"
#include "stages.inl"

namespace bigtri {
BIGTRI_KERNEL_TABLE(avx2)
}

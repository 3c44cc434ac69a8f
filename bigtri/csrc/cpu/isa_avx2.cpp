#pragma GCC target("avx2,bmi,bmi2,lzcnt,popcnt")
#include "rasterize.inl"
#include "stages.inl"

namespace bigtri {
BIGTRI_KERNEL_TABLE(avx2)
}

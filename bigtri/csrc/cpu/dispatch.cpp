// Which per-ISA build runs: the best that the machine has, unless BIGTRI_ISA names another. All give the same bits.

#include <atomic>
#include <initializer_list>
#include <cstdlib>
#include <cstring>

#include "rasterize.h"

namespace bigtri {

extern const Kernels kernels_baseline;
#if defined(__x86_64__)
extern const Kernels kernels_avx2;
extern const Kernels kernels_avx512;
#endif

const Kernels* find_kernels(const char* name) {
  if (!std::strcmp(name, "baseline")) return &kernels_baseline;
#if defined(__x86_64__)
  __builtin_cpu_init();
  if (!std::strcmp(name, "avx2") && __builtin_cpu_supports("avx2") && __builtin_cpu_supports("bmi2")) return &kernels_avx2;
  if (!std::strcmp(name, "avx512") && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512dq") &&
      __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("bmi2"))
    return &kernels_avx512;
#endif
  return nullptr;
}

namespace {

const Kernels* best_kernels() {
  if (const char* name = std::getenv("BIGTRI_ISA"))
    if (const Kernels* k = find_kernels(name)) return k;
  for (const char* name : {"avx512", "avx2"})
    if (const Kernels* k = find_kernels(name)) return k;
  return &kernels_baseline;
}

std::atomic<const Kernels*>& current() {
  static std::atomic<const Kernels*> kernels{best_kernels()};
  return kernels;
}

}  // namespace

const Kernels& current_kernels() { return *current().load(std::memory_order_relaxed); }
void use_kernels(const Kernels& kernels) { current().store(&kernels, std::memory_order_relaxed); }

}  // namespace bigtri

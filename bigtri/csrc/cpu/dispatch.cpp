// The instruction set in use, one for the whole process: the best that the machine has, unless the environment variable
// BIGTRI_ISA names another one that it has. kernels.cpp chooses the kernels by it. All instruction sets give the same
// bits.

#include <atomic>
#include <cstdlib>

#include "backend.h"

namespace bigtri {
namespace {

constexpr Isa kIsas[] = {Isa::kAvx512, Isa::kAvx2, Isa::kBaseline};  // the best first

bool has(Isa isa) {
#if defined(__x86_64__)
  // All that the pragmas of isa_avx2.cpp and isa_avx512.cpp name.
  __builtin_cpu_init();
  const bool avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("bmi") && __builtin_cpu_supports("bmi2") &&
                    __builtin_cpu_supports("popcnt") && __builtin_cpu_supports("fma");
  if (isa == Isa::kAvx512)
    return avx2 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") &&
           __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512bw");
  if (isa == Isa::kAvx2) return avx2;
#endif
  return isa == Isa::kBaseline;
}

Isa best() {
  Isa isa = Isa::kBaseline;
  if (const char* name = std::getenv("BIGTRI_ISA"))
    if (find_isa(name, &isa)) return isa;
  for (const Isa one : kIsas)
    if (has(one)) return one;
  return isa;
}

std::atomic<Isa>& current() {
  static std::atomic<Isa> isa{best()};
  return isa;
}

}  // namespace

const char* name_of(Isa isa) { return isa == Isa::kAvx512 ? "avx512" : isa == Isa::kAvx2 ? "avx2" : "baseline"; }

bool find_isa(const std::string& name, Isa* isa) {
  for (const Isa one : kIsas)
    if (name == name_of(one) && has(one)) {
      *isa = one;
      return true;
    }
  return false;
}

Isa current_isa() { return current().load(std::memory_order_relaxed); }
void use_isa(Isa isa) { current().store(isa, std::memory_order_relaxed); }

}  // namespace bigtri

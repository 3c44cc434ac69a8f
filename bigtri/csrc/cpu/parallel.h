// Loops over threads, with the floating-point mode that the bits need.
#pragma once

#include <stdint.h>

#include "thread_pool.h"

#if defined(__x86_64__)
#include <xmmintrin.h>
#endif

namespace bigtri {

// Round to nearest, no flush to zero, no trapping. Whatever the thread was set to is put back at the end, also when a body
// throws.
class FloatMode {
 public:
#if defined(__x86_64__)
  FloatMode() : saved_(_mm_getcsr()) { _mm_setcsr(0x1f80); }
  ~FloatMode() { _mm_setcsr(saved_); }

 private:
  unsigned saved_;
#elif defined(__aarch64__)
  FloatMode() {
    asm volatile("mrs %0, fpcr" : "=r"(saved_));
    asm volatile("msr fpcr, %0" ::"r"((uint64_t)0));
  }
  ~FloatMode() { asm volatile("msr fpcr, %0" ::"r"(saved_)); }

 private:
  uint64_t saved_;
#else
  FloatMode() {}
#endif
  FloatMode(const FloatMode&) = delete;
  FloatMode& operator=(const FloatMode&) = delete;
};

// Calls body(i) for i in [0, n) on up to `threads` threads, each in the float mode above.
struct Parallel {
  int threads;

  template <class Body>
  void operator()(int64_t n, Body body) const {
    const auto call = [](void* context, int64_t i) {
      FloatMode mode;
      (*static_cast<Body*>(context))(i);
    };
    ThreadPool::instance().run(threads, n, call, &body);
  }
};

}  // namespace bigtri

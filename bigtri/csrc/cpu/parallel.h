// Parallel loops in the default floating-point mode, on the threads of thread_pool.h. Everything in cpu/ that runs on
// threads calls Parallel; the binding makes it from the number of threads that torch is set to.
#pragma once

#include <stdint.h>

#include "thread_pool.h"

#if defined(__x86_64__)
#include <xmmintrin.h>
#endif

namespace bigtri {

// Sets the mode that docs/numerics.md 1 asks for: round to nearest, no flush to zero, no traps. The destructor restores
// the thread's own mode, also on the way of an exception.
class FloatMode {
 public:
#if defined(__x86_64__)
  // 0x1f80: all exceptions masked, all other bits of MXCSR 0.
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

// Calls body(i) once for each i in [0, n), on up to `threads` threads, in FloatMode. Returns when all calls have ended.
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

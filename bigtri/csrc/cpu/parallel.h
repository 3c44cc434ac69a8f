// Threads, without knowing whose: the binding hands in torch's pool.
#pragma once

#include <stdint.h>

#if defined(__x86_64__)
#include <xmmintrin.h>
#endif

namespace bigtri {

// Round to nearest, no flush to zero, no trapping: whatever the caller's thread was set to, put back at the end.
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

struct Parallel {
  // Calls body(context, i) for i in [0, n), each once, in any order, on any thread; returns when all are done.
  void (*run)(int64_t n, void (*body)(void* context, int64_t i), void* context);
  int threads;

  template <class Body>
  void operator()(int64_t n, Body body) const {
    const auto call = [](void* context, int64_t i) {
      FloatMode mode;
      (*static_cast<Body*>(context))(i);
    };
    if (n == 1)
      call(&body, 0);
    else if (n > 1)
      run(n, call, &body);
  }
};

}  // namespace bigtri

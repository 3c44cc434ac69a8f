// Parallel loops in the default floating-point mode, on the threads of thread_pool.h. Everything in cpu/ that runs on
// threads calls Parallel; the binding makes it from the number of threads that torch is set to.
#pragma once

#include <stdint.h>
#include <time.h>

#include <algorithm>
#include <atomic>
#include <numeric>
#include <vector>

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

// How evenly parallel loops share their work out, ns of processor time.
struct Load {
  int threads = 0;
  int64_t longest = 0;  // the thread that works longest in a loop; all loops together
  int64_t all = 0;      // all threads, in all loops
};

// Processor time of this thread, ns. Where the system has no such clock, processor time of the process.
inline int64_t thread_time() {
#if defined(CLOCK_THREAD_CPUTIME_ID)
  timespec t;
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
#else
  return (int64_t)clock() * (1000000000 / CLOCKS_PER_SEC);
#endif
}

// Loops over [0, n), on up to `threads` threads, in FloatMode. They return when all calls have ended.
struct Parallel {
  int threads;
  Load* load = nullptr;  // if not null, loops are timed instead (one_by_one)

  // Calls body(i) once for each i.
  template <class Body>
  void operator()(int64_t n, Body body) const {
    if (load) return one_by_one(n, [&](int64_t i, int64_t) { body(i); });
    const auto call = [](void* context, int64_t i) {
      FloatMode mode;
      (*static_cast<Body*>(context))(i);
    };
    ThreadPool::instance().run(threads, n, call, &body);
  }

  // Calls body(i, slot) once for each i. slot, from 0 to threads - 1, is the calling thread's alone.
  template <class Body>
  void with_slots(int64_t n, Body body) const {
    if (load) return one_by_one(n, body);
    std::atomic<int64_t> next{0};
    (*this)(std::min<int64_t>(threads, n), [&](int64_t slot) {
      for (int64_t i; (i = next.fetch_add(1, std::memory_order_relaxed)) < n;) body(i, slot);
    });
  }

 private:
  // Makes all calls on this thread, and adds to `load` how `threads` cores would have shared them: whoever is free first
  // takes the next index, as in ThreadPool, and needs the time that the call takes here.
  template <class Body>
  void one_by_one(int64_t n, Body body) const {
    const FloatMode mode;
    std::vector<int64_t> busy(std::max<int64_t>(1, std::min<int64_t>(threads, n)), 0);
    for (int64_t i = 0; i < n; ++i) {
      const auto first = std::min_element(busy.begin(), busy.end());
      const int64_t start = thread_time();
      body(i, first - busy.begin());
      *first += thread_time() - start;
    }
    load->longest += *std::max_element(busy.begin(), busy.end());
    load->all += std::accumulate(busy.begin(), busy.end(), int64_t{0});
  }
};

}  // namespace bigtri

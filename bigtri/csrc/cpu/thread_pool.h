// The thread pool under Parallel (parallel.h). Work is handed out one index at a time, and the caller takes part; a
// worker that wakes late finds no index left, and nobody waits for it. A barrier over a fixed split, as in OpenMP and
// so in torch, costs milliseconds if another process holds one of the cores. A whole frame takes about one
// millisecond.
#pragma once

#include <stdint.h>

#include <atomic>

namespace bigtri {

class ThreadPool {
 public:
  static ThreadPool& instance() { return pool_; }

  // Calls body(context, i) once for each i in [0, n), in any order, on up to `threads` threads including the caller's.
  // Returns when all calls have ended. Their stores are then visible to the caller, and to every thread that
  // synchronises with it. If the pool is busy (with another thread's call, or this call comes from inside a body), the
  // caller's thread does all the work.
  //
  // After a body has thrown, no further index is started. When every thread has left its body, one of the exceptions is
  // thrown here. The pool can be used again. A body must not fork.
  void run(int threads, int64_t n, void (*body)(void* context, int64_t i), void* context);

 private:
  struct State;

  constexpr ThreadPool() = default;
  State& state();

  // Null until it is needed. It is never freed, because workers sleep in it until the process ends.
  std::atomic<State*> state_{nullptr};

  static ThreadPool pool_;
  static const int fork_handler_;
};

}  // namespace bigtri

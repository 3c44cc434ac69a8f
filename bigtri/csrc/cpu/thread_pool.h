// Threads that the caller never waits for in vain: work is handed out one index at a time, the caller takes part, and a
// worker that wakes late finds nothing left to do. A barrier over a fixed split (OpenMP's, and so torch's) costs
// milliseconds whenever a neighbour holds one of the cores; a whole frame takes one.
#pragma once

#include <stdint.h>

#include <atomic>

namespace bigtri {

class ThreadPool {
 public:
  static ThreadPool& instance() { return pool_; }

  // Calls body(context, i) for i in [0, n), each once, in any order, on up to `threads` threads with the caller among
  // them; returns when all are done, and what they stored can be seen by whoever learns of that. A call that finds the
  // pool busy (another thread's, or one from inside a body) runs on its own thread alone.
  //
  // After a body has thrown no further index is started. Once every thread has left its body the exception, or of
  // several one, is thrown here, and the pool is as good as before. A body must not fork.
  void run(int threads, int64_t n, void (*body)(void* context, int64_t i), void* context);

 private:
  struct State;

  constexpr ThreadPool() = default;
  State& state();

  // Null until it is needed; never freed: workers sleep in it until the process ends.
  std::atomic<State*> state_{nullptr};

  static ThreadPool pool_;
  static const int fork_handler_;
};

}  // namespace bigtri

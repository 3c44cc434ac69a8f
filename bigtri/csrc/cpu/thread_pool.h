// Threads that the caller never waits for in vain: work is handed out one index at a time, the caller takes part, and a worker that wakes late finds nothing left to do. A
// barrier over a fixed split (OpenMP's, and so torch's) costs milliseconds whenever a neighbour holds one of the cores; a whole frame takes one.
#pragma once

#include <stdint.h>

namespace bigtri {

class ThreadPool {
 public:
  static ThreadPool& instance();

  // Calls body(context, i) for i in [0, n), each once, in any order, on up to `threads` threads with the caller among them; returns when all are done. A call that finds the
  // pool busy (another thread's, or one from inside a body) runs on its own thread alone.
  void run(int threads, int64_t n, void (*body)(void* context, int64_t i), void* context);

 private:
  ThreadPool();
  struct State;
  State* state_;  // never freed: workers may sleep in it until the process ends
};

}  // namespace bigtri

// The counters of one thread's work (core/counters.h lists them). Variants add to them, and publish them once per task.
// In builds without BIGTRI_COUNTING the struct is empty and costs nothing.
#pragma once

#include "../core/counters.h"
#include "../core/numerics.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

// A build that counts draws, and nothing else.
#if defined(BIGTRI_COUNTING)
constexpr bool kCounts = true;

struct Counts {
  int64_t value[kCounters] = {};

  void add(Counter counter, int64_t n) { value[(int)counter] += n; }
  // Adds to the frame's counters, if it has any. Any thread may call it.
  void publish(int64_t* counters) const {
    for (int i = 0; counters && i < kCounters; ++i) {
      if (!value[i]) continue;
      if (kCounterDepends[i] != Depends::kMost) {
        __atomic_fetch_add(counters + i, value[i], __ATOMIC_RELAXED);
        continue;
      }
      int64_t old = __atomic_load_n(counters + i, __ATOMIC_RELAXED);
      while (old < value[i] &&
             !__atomic_compare_exchange_n(counters + i, &old, value[i], true, __ATOMIC_RELAXED, __ATOMIC_RELAXED)) {
      }
    }
  }
  // The same for a task that draws: its load is what was counted since the struct was made.
  void publish_task(int64_t* counters) {
    const int64_t work = value[(int)Counter::edges_64] + value[(int)Counter::edges_32] + value[(int)Counter::fragments];
    add(Counter::tasks, work > 0);
    add(Counter::work, work);
    add(Counter::most_work, work);
    publish(counters);
  }
};
#else
constexpr bool kCounts = false;

struct Counts {
  void add(Counter, int64_t) {}
  void publish(int64_t*) const {}
  void publish_task(int64_t*) {}
};
#endif

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// The counters of one thread's work (core/counters.h lists them). Variants add to them, and publish them once per task.
// In builds without BIGTRI_COUNTING the struct is empty and costs nothing.
#pragma once

#include "../core/counters.h"
#include "../core/numerics.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

#if defined(BIGTRI_COUNTING)
struct Counts {
  int64_t value[kCounters] = {};

  void add(Counter counter, int64_t n) { value[(int)counter] += n; }
  // Adds to the frame's counters, if it has any. Any thread may call it.
  void publish(int64_t* counters) const {
    for (int i = 0; counters && i < kCounters; ++i)
      if (value[i]) __atomic_fetch_add(counters + i, value[i], __ATOMIC_RELAXED);
  }
};
#else
struct Counts {
  void add(Counter, int64_t) {}
  void publish(int64_t*) const {}
};
#endif

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// The counters of one thread's work, an empty struct where nothing is counted.
#pragma once

#include "../core/counters.h"
#include "../core/numerics.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

#if defined(BIGTRI_COUNTING)
struct Counts {
  int64_t value[kCounters] = {};

  void add(Counter counter, int64_t n) { value[(int)counter] += n; }
  // Into the frame's counters, where it has any; from any thread.
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

// The atomic minimum on a pixel, for variants in which several threads draw to one image.
#pragma once

#include "counting.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// Keeps the nearer of the pixel and what is offered, and counts that. A failed exchange has read the pixel again into
// `old`.
inline void keep_nearest_atomically(int64_t* pixel, int64_t packed, Counts* counts) {
  int64_t old = __atomic_load_n(pixel, __ATOMIC_RELAXED);
  counts->add(Counter::passed, packed < old);
  while (packed < old) {
    const bool stored = __atomic_compare_exchange_n(pixel, &old, packed, false, __ATOMIC_RELAXED, __ATOMIC_RELAXED);
    counts->add(Counter::atomics, 1);
    counts->add(Counter::written, stored);
    if (stored) return;
  }
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

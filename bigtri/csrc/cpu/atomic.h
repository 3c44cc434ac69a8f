// The atomic minimum on a pixel, for variants in which several threads draw to one image.
#pragma once

#include <stdint.h>

namespace bigtri {
namespace {

// Keeps the nearer of the pixel and what is offered. A failed exchange has read the pixel again into `old`.
inline void keep_nearest_atomically(int64_t* pixel, int64_t packed) {
  int64_t old = __atomic_load_n(pixel, __ATOMIC_RELAXED);
  while (packed < old && !__atomic_compare_exchange_n(pixel, &old, packed, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED)) {
  }
}

}  // namespace
}  // namespace bigtri

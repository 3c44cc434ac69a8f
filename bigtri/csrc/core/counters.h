// How much work a variant does. A file that counts is compiled a second time with BIGTRI_COUNTING defined. In the first
// build the counters are an empty struct whose functions do nothing (cpu/counting.h), so they cost nothing.
// bigtri/reference/variants/<name>.py computes the same numbers.
#pragma once

#include "platform.h"

namespace bigtri {

// X(name, what is counted)
#define BIGTRI_COUNTERS(X)                                                   \
  X(records, "(sub)triangles that may cover a pixel")                        \
  X(candidates, "pairs of a record and a bin that its bounding box touches") \
  X(entries, "pairs of a record and a bin that went into the bin's list")    \
  X(rows, "rows of pixels that were cut to a span")                          \
  X(fragments, "pixels that were offered a depth")

enum class Counter : int {
#define BIGTRI_COUNTER(NAME, ABOUT) NAME,
  BIGTRI_COUNTERS(BIGTRI_COUNTER)
#undef BIGTRI_COUNTER
      kCount
};
constexpr int kCounters = (int)Counter::kCount;

}  // namespace bigtri

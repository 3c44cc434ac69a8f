// What a variant says of itself, the same for CPU and GPU.
#pragma once

#include "platform.h"

namespace bigtri {

// A number that a caller may set for one call. It changes no bit of the picture.
struct Parameter {
  const char* name;  // null ends a list
  const char* unit;  // of the number, e.g. "records"; "" for a plain number
  const char* about;
  int64_t standard, low, high;
  const int64_t* only = nullptr;  // the values allowed, ascending and ending with -1; null for all from low to high

  bool allows(int64_t v) const {
    if (v < low || v > high) return false;
    if (!only) return true;
    const int64_t* one = only;
    while (*one >= 0 && *one != v) ++one;
    return *one >= 0;
  }
};

inline int parameter_count(const Parameter* list) {
  int n = 0;
  while (list[n].name) ++n;
  return n;
}

}  // namespace bigtri

// The parameters that a variant offers to callers, the same for CPU and GPU. The binding checks them, and
// bigtri/native.py lists them. They change no bit of a picture, so bigtri/reference has no mirror of them.
#pragma once

#include "platform.h"

namespace bigtri {

// A number that a caller may set for one call. Lists of parameters end with one whose name is null.
struct Parameter {
  const char* name;
  const char* unit;               // e.g. "records"; "" for a plain number
  const char* about;              // what it sets, for the user
  int64_t standard, low, high;    // default, and the range allowed, both ends included
  const int64_t* only = nullptr;  // the values allowed, ascending, then -1; null: all from low to high

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

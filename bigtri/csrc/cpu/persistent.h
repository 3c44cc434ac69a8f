// The kernel of the persistent variant, which persistent.cpp calls. Compiled once per instruction set (persistent.inl);
// this file once per rung.
#pragma once

#include "../core/record.h"
#include "counting.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

struct PersistentKernels {
  // Draws a record into a bin's patch, 64x64 px.
  void (*draw_into)(const Record& r, int bin_x, int bin_y, int64_t* patch, Counts* counts);
};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

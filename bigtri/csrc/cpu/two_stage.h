// The kernel of the two_stage variant, which two_stage.cpp calls. Compiled once per instruction set (two_stage.inl);
// this file once per rung.
#pragma once

#include "../core/record.h"
#include "counting.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

struct TwoStageKernels {
  // Draws a record within one bin that its bounding box touches. pixels: of its view, `width` px a row. Other threads
  // may draw to the same pixels.
  void (*draw_bin)(const Record& r, int bin_x, int bin_y, int64_t* pixels, int width, Counts* counts);
};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// The kernel of the batched variant, which batched.cpp calls. Compiled once per instruction set (batched.inl); this file
// once per rung.
#pragma once

#include "../core/record.h"
#include "counting.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

struct BatchedKernels {
  // Tests every pixel of the record's bounding box. pixels: of its view, `width` px a row. Other threads may draw to the
  // same pixels.
  void (*draw_box)(const Record& r, int64_t* pixels, int width, Counts* counts);
};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

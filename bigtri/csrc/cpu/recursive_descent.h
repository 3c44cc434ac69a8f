// The kernel of the recursive_descent variant, which recursive_descent.cpp calls, and what both share. Compiled once per
// instruction set (recursive_descent.inl); this file once per rung.
#pragma once

#include "../core/record.h"
#include "counting.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

// Squares of the descent, px: 64x64 hold 16 of 16x16, and each of these 16 of 4x4.
constexpr int kMiddle = 16, kBlock4 = 4;
constexpr int kMiddles = kBin / kMiddle;  // across a bin

// Records of at most this extent, subpx, take 32 bits for every edge value in the bins that they meet. Let the extent be
// D = 2^19 - 2^14 subpx (1984 px of 256). Centres in these bins lie up to 63 px, below 2^14 subpx, outside of the
// triangle's bounding box. An edge value is a difference of two products of a side (<= D) and a distance (< D + 2^14 =
// 2^19), so |e| < 2 * D * 2^19 < 2^39, and |f| < 2^31 - 2^26. With fewer sub-pixel bits all of it is smaller. Rungs with
// more of them do not have the variant.
constexpr int32_t kNarrowExtent = (kMaxSize / 8 - kBin) * kSubpixel;
static_assert(Rung::kSubpixelBits > 8 || kNarrowExtent <= (1 << 19) - (1 << 14), "f fits int32");

// Where a record is drawn to: one view.
struct DescentTarget {
  int64_t* pixels;  // [height, width], shared by all threads
  int width, bins_x;
  // Depth bounds, shared by all threads: bits of a window depth behind which nothing of the square can be seen; of bins,
  // and of their squares of 16x16 px, row by row of the image.
  uint32_t *bin_far, *middle_far;
  bool early_z, separates;
};

struct RecursiveDescentKernels {
  void (*descend)(const Record& r, const DescentTarget& target, Counts* counts);
};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// The kernels of the coverage_masks variant, which coverage_masks.cpp calls. Compiled once per instruction set
// (coverage_masks.inl); this file once per rung.
#pragma once

#include "counting.h"
#include "tile_entry.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

struct CoverageMasksKernels {
  // The tiles of the bin that the record touches, and those that it fills: bit 8 * row + column. anchor: out, of the
  // bin's cell.
  void (*coarse)(const Record& r, int bin_x, int bin_y, uint64_t* touched, uint64_t* full, DepthNumber* anchor,
                 Counts* counts);
  // Draws the queue of the tile whose first pixel is (x, y) into the tile's 64 pixels, row by row.
  void (*fine)(const TileEntry* queue, int64_t count, int x, int y, int64_t* pixels, Counts* counts);
};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

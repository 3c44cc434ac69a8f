// The kernels of the tile_owned variant, and what they share with tile_owned.cpp, which calls them. Compiled once per
// instruction set (tile_owned.inl); this file once per rung.
#pragma once

#include "../core/record.h"
#include "counting.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

// An owned tile: 16x16 px, which are four quads of 8x8 px, numbered row by row.
constexpr int kOwnedTile = 16, kOwnedPixels = kOwnedTile * kOwnedTile;

// A record in the list of an owned tile. touched, full: its quads, bit n for quad n.
struct OwnedEntry {
  uint32_t record;
  uint8_t touched, full;
};

struct TileOwnedKernels {
  // The tiles of 8x8 px of a bin that the record touches, and those that it fills: bit 8 * row + column.
  void (*find_quads)(const Record& r, int bin_x, int bin_y, uint64_t* touched, uint64_t* full, Counts* counts);
  // Draws the list of the owned tile whose first pixel is (x, y) into its pixels, row by row.
  void (*draw_list)(const Record* records, const OwnedEntry* list, int64_t count, int x, int y, int64_t* pixels,
                    Counts* counts);
};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

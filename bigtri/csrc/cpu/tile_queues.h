// The kernels of the tile_queues variant, and what they share with tile_queues.cpp, which calls them. Compiled once per
// instruction set (tile_queues.inl); this file once per rung.
#pragma once

#include "counting.h"
#include "tile_entry.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

// A bin of this variant: 128 px, so 16 x 16 tiles and four cells. f of an edge within it does not fit int32: of one that
// crosses it |f| may be 127/64 of 2^31. So the bin and its tiles are tested in int64. Within a tile of 8 px it fits.
constexpr int kWideBin = 128, kWideTiles = kWideBin / kTile;

// Of the tiles of a wide bin, bit `column` of element `row`.
struct WideMasks {
  uint16_t touched[kWideTiles], full[kWideTiles];
};

struct TileQueuesKernels {
  // Which tiles of the bin whose first pixel is (left, top) the record touches, of those that its bounding box meets, and
  // which of these it fills. anchors: out, of the bin's four cells, row by row; set where a tile is touched.
  void (*find_tiles)(const Record& r, int left, int top, WideMasks* masks, DepthNumber anchors[4], Counts* counts);
  // Draws the queue of the tile whose first pixel is (x, y) into the tile's 64 pixels, row by row.
  void (*draw_queue)(const TileEntry* queue, int64_t count, int x, int y, int64_t* pixels, Counts* counts);
};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// Coverage within a bin by the rung's rule: which bins and tiles an edge rejects, and which pixels it has inside;
// docs/numerics.md 3 to 5. The variant two_stage draws with it; the others use binning.h and tile_mask.h, whose
// arithmetic it repeats for no rung. Mirrors bigtri/reference/numerics.py and tile_mask.py.
#pragma once

#include "record.h"
#include "tile_mask.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

// One edge within a bin. A pixel is inside where edge_at is >= 0.
using EdgeInBin = NarrowEdge;

// The record's edges within a bin. False if one of them rejects the bin.
BIGTRI_HD bool edges_in_bin(const Record& r, int bin_x, int bin_y, EdgeInBin e[3]) {
  for (int k = 0; k < 3; ++k) {
    const BinEdge b = bin_edge(edge_of(r.x, r.y, k), bin_x, bin_y);
    if (b.highest < 0) return false;
    e[k] = narrow(b);
  }
  return true;
}

// The edge at pixel (i, j) of the bin.
BIGTRI_HD int32_t edge_at(const EdgeInBin& e, int i, int j) { return e.f + i * e.sx + j * e.sy; }

// Whether a pixel is inside all three.
BIGTRI_HD bool is_inside(const EdgeInBin e[3], int i, int j) {
  return (edge_at(e[0], i, j) | edge_at(e[1], i, j) | edge_at(e[2], i, j)) >= 0;
}

// Whether no edge has the tile in a column and row of the bin wholly outside; whether all have it wholly inside.
BIGTRI_HD bool touches_tile(const EdgeInBin e[3], int column, int row) {
  bool any = true;
  for (int k = 0; k < 3; ++k) any &= tile_edge(e[k], column, row) + tile_highest(e[k]) >= 0;
  return any;
}
BIGTRI_HD bool fills_tile(const EdgeInBin e[3], int column, int row) {
  bool all = true;
  for (int k = 0; k < 3; ++k) all &= tile_edge(e[k], column, row) + tile_lowest(e[k]) >= 0;
  return all;
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

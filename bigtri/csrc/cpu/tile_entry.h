// An element of the queue of a tile of 8x8 px, for variants that have such.
#pragma once

#include "../core/record.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

struct TileEntry {
  const Record* record;
  DepthNumber anchor;  // cell_anchor of the tile's cell (depth.inl)
  bool full;  // whether every pixel centre of the tile lies inside all edges
};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

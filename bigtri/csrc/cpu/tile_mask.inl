// Tile masks of a record in a bin, and the coverage of a tile, sixteen tiles or pixels at a time. Called where bins are
// drawn (bin_owned.inl) and by the stages (stages.inl). Compiled once per instruction set.
#pragma once

#include "kernels.h"
#include "simd.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// Bit 8 * row + column. The bbox is not taken into account; the caller applies bbox_tiles.
struct TileMasks {
  uint64_t touched, full;
};

// f at 16 samples: two rows of eight.
BIGTRI_INLINE i32x16 lanes(int32_t f, int32_t sx, int32_t sy) {
  return f + load<i32x16>(kLaneX) * sx + load<i32x16>(kLaneY) * sy;
}

// Two rows of eight tiles at a time. An edge rejects a tile if its highest value there is negative. The OR of three
// values is negative if one of them is, so one sign mask stands for three tests. `full` is the same test of the lowest
// values.
BIGTRI_INLINE TileMasks tile_masks(const NarrowEdge e[3]) {
  i32x16 at[3];
  int32_t high[3], low[3];
  for (int k = 0; k < 3; ++k) {
    at[k] = lanes(e[k].f, kTile * e[k].sx, kTile * e[k].sy);
    high[k] = tile_highest(e[k]);
    low[k] = tile_lowest(e[k]);
  }
  TileMasks m = {0, 0};
  for (int pair = 0; pair < 4; ++pair) {
    m.touched |= (uint64_t)(sign_mask((at[0] + high[0]) | (at[1] + high[1]) | (at[2] + high[2])) ^ 0xffff)
                 << (16 * pair);
    m.full |= (uint64_t)(sign_mask((at[0] + low[0]) | (at[1] + low[1]) | (at[2] + low[2])) ^ 0xffff) << (16 * pair);
    for (int k = 0; k < 3; ++k) at[k] = at[k] + 2 * kTile * e[k].sy;
  }
  return m;
}

// Coverage of a tile's 64 pixels, bit 8 * row + column. offset[k] is lanes(0, sx, sy), which is the same for every
// tile.
BIGTRI_INLINE uint64_t tile_coverage(const NarrowEdge e[3], const i32x16 offset[3], int column, int row) {
  i32x16 at[3];
  for (int k = 0; k < 3; ++k) at[k] = offset[k] + tile_edge(e[k], column, row);
  uint64_t mask = 0;
  for (int pair = 0; pair < 4; ++pair) {
    mask |= (uint64_t)(sign_mask(at[0] | at[1] | at[2]) ^ 0xffff) << (16 * pair);
    for (int k = 0; k < 3; ++k) at[k] = at[k] + 2 * e[k].sy;
  }
  return mask;
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

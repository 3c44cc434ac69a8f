// The tiles of a bin that a record touches, and the pixels of a tile, sixteen at a time; compiled once per instruction set.
#pragma once

#include "kernels.h"
#include "simd.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

struct TileMasks {
  uint64_t touched, full;
};

BIGTRI_INLINE i32x16 lanes(int32_t f, int32_t sx, int32_t sy) {
  return f + load<i32x16>(kLaneX) * sx + load<i32x16>(kLaneY) * sy;
}

// Two rows of eight tiles at a time. A tile is dropped where one edge's maximum is negative: the sign bit of the three ORed.
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

// The 64 pixels of one tile; offset[k] = lanes(0, sx, sy).
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

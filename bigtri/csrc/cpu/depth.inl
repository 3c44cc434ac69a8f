// Depth of eight pixels of a row at a time, and depth bounds over squares. Called where bins are drawn (bin_owned.inl)
// and by the depth stage (stages.inl). The formulas are core/depth.h's. Compiled once per instruction set.
#pragma once

#include "../core/pixel_depth.h"
#include "kernels.h"
#include "simd.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// False, known when it is compiled, whatever is assigned.
struct Never {
  Never(bool = false) {}
  constexpr operator bool() const { return false; }
};

// A record's depth within one cell, which is the square of a bin. A thin record has edge values instead of a plane.
// These are integers: |e| < 2^49 at the first centre, a step is below 2^32, and there are at most 63 steps down and 70
// across (a vector may begin at column 63 and has seven lanes more). So they stay below 2^50 and float64 holds them
// exactly; only the weighted sum rounds.
struct CellDepth {
  // Not thin: the depth at the cell's first pixel centre, and its change per px.
  DepthNumber zcell, dzdx, dzdy;
  // Thin: the unbiased edges at that centre (subpx^2) and their change (subpx^2 per px), window
  // depths of the vertices, twice the area (subpx^2).
  DepthNumber e[3], ex[3], ey[3], z[3];
  double area;
  float zmin, zmax;   // of the record's vertices
  uint32_t triangle;  // index of the parent
  std::conditional_t<kKnowsThin, bool, Never> thin;  // is_thin, which is never where the rung knows no thin records
  bool far;                                          // kRecordFar
};

// The unbiased edges at the centre of the cell's first pixel, subpx^2.
BIGTRI_INLINE void cell_edges(const Record& r, int bin_x, int bin_y, int64_t e[3]) {
  for (int k = 0; k < 3; ++k)
    e[k] = edge_value(edge_of(r.x, r.y, k), pixel_centre(bin_x * kBin), pixel_centre(bin_y * kBin));
}

// The depth of a record's plane at the cell's first pixel centre; of a thin record, which has none, any number.
BIGTRI_INLINE DepthNumber cell_anchor(const Record& r, int bin_x, int bin_y) {
  return is_thin(r) ? 0 : depth_at(r.x, r.y, r.z, r.area, bin_x * kBin, bin_y * kBin);
}

// anchor: cell_anchor of the cell, where it is known already.
BIGTRI_INLINE void cell_depth(const Record& r, int bin_x, int bin_y, DepthNumber anchor, CellDepth* d) {
  d->zmin = r.zmin;
  d->zmax = r.zmax;
  d->triangle = r.triangle;
  d->thin = r.flags & kRecordThin;
  d->far = r.flags & kRecordFar;
  if (!d->thin) {
    d->dzdx = r.dzdx;
    d->dzdy = r.dzdy;
    d->zcell = anchor;
    return;
  }
  d->area = r.area.value;
  int64_t cell[3];
  cell_edges(r, bin_x, bin_y, cell);
  for (int k = 0; k < 3; ++k) {
    const Edge e = edge_of(r.x, r.y, k);
    d->e[k] = (DepthNumber)cell[k];
    d->ex[k] = -(DepthNumber)kSubpixel * e.dy;
    d->ey[k] = (DepthNumber)kSubpixel * e.dx;
    d->z[k] = r.z[k];
  }
}
BIGTRI_INLINE void cell_depth(const Record& r, int bin_x, int bin_y, CellDepth* d) {
  cell_depth(r, bin_x, bin_y, cell_anchor(r, bin_x, bin_y), d);
}

// The plane's terms for every row and column of the cell. The depth of a pixel is then one addition.
struct PlaneTable {
  DepthNumber row[kBin];
  DepthLanes column[kBin / 8];
};

BIGTRI_INLINE void plane_table(const CellDepth& d, PlaneTable* t) {
  for (int i = 0; i < kBin; i += 8) {
    const DepthLanes at = lane_numbers<DepthNumber>() + (DepthNumber)i;
    store(t->row + i, plane_row(d.zcell, d.dzdy, at));
    t->column[i / 8] = plane_column(d.dzdx, at);
  }
}

// Depth of the pixels (i, j) to (i + 7, j) of the cell, not yet rounded to float32.
template <bool kThin>
BIGTRI_INLINE DepthLanes row_depth(const CellDepth& d, int i, int j) {
  const DepthLanes x = lane_numbers<DepthNumber>() + (DepthNumber)i;
  if (!kThin) return plane_row<DepthNumber>(d.zcell, d.dzdy, j) + plane_column(d.dzdx, x);
  const DepthLanes g0 = (d.e[0] + d.ey[0] * j) + d.ex[0] * x, g1 = (d.e[1] + d.ey[1] * j) + d.ex[1] * x,
                   g2 = (d.e[2] + d.ey[2] * j) + d.ex[2] * x;
  return weighted_depth<DepthLanes>(g0, g1, g2, d.z[0], d.z[1], d.z[2], d.area);
}

// Rounds, clamps and packs eight depths. Only far records have depths above 1, which have to become background.
template <bool kFar>
BIGTRI_INLINE i64x8 packed_of(const CellDepth& d, DepthLanes depth) {
  const f32x8 z = clamp_depth(to_float(depth), splat<f32x8>(d.zmin), splat<f32x8>(d.zmax));
  if (!kFar) return pack(z, d.triangle);
  int64_t packed[8];
  for (int i = 0; i < 8; ++i) packed[i] = pack_fragment(z[i], d.triangle);
  return load<i64x8>(packed);
}

// Packed values of the pixels (x, y) to (x + 7, y) of the cell; x is a multiple of 8. A thin record does not use the
// table.
template <bool kThin, bool kFar>
BIGTRI_INLINE i64x8 row_packed(const CellDepth& d, const PlaneTable& t, int x, int y) {
  return packed_of<kFar>(d, kThin ? row_depth<true>(d, x, y) : t.row[y] + t.column[x / 8]);
}

// Nearest (farthest) depth over the square of size x size pixels whose first is (i, j). Exact for a plane, in float32 as
// in float64, whose extremes lie at corners (core/depth.h); for a thin record the extreme of its vertices. Where the rung
// knows no thin records, a plane stands for them too: far outside of the triangle it may be anything, but a bound is of
// what is stored at pixels, and that is this plane's value, clamped to the vertices.
BIGTRI_INLINE float bound_depth(const CellDepth& d, int i, int j, int size, bool farthest) {
  if (d.thin) return farthest ? d.zmax : d.zmin;
  return corner_depth({d.zcell, d.dzdx, d.dzdy}, d.zmin, d.zmax, i, j, size - 1, size - 1, farthest);
}
BIGTRI_INLINE float nearest_depth(const CellDepth& d, int i, int j, int size) {
  return bound_depth(d, i, j, size, false);
}
BIGTRI_INLINE float farthest_depth(const CellDepth& d, int i, int j, int size) {
  return bound_depth(d, i, j, size, true);
}

// bound_depth of the eight tiles of a row of tiles. The nearest (farthest) corner is the same one in every tile.
BIGTRI_INLINE f32x8 tile_corner_depths(const CellDepth& d, int row, bool farthest) {
  if (d.thin) return splat<f32x8>(farthest ? d.zmax : d.zmin);
  const int x = (d.dzdx < 0) != farthest ? kTile - 1 : 0, y = (d.dzdy < 0) != farthest ? kTile - 1 : 0;
  const DepthLanes z = plane_row<DepthNumber>(d.zcell, d.dzdy, kTile * row + y) +
                       plane_column(d.dzdx, lane_numbers<DepthNumber>() * (DepthNumber)kTile + (DepthNumber)x);
  return clamp_depth(to_float(z), splat<f32x8>(d.zmin), splat<f32x8>(d.zmax));
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

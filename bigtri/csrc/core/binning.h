// Which 64x64 px bins a record touches; docs/numerics.md 4. Mirrors bigtri/reference/binning.py.
#pragma once

#include "numerics.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

BIGTRI_HD bool is_large(int x0, int y0, int x1, int y1, int64_t threshold) {
  return (int64_t)(x1 - x0) * (y1 - y0) > threshold;
}

// The bins that a record or primitive touches by its bbox, row by row.
struct BinBox {
  int x, y;  // the first one
  int columns, count;
};

template <class Boxed>
BIGTRI_HD BinBox bin_box(const Boxed& r) {
  const int x = r.x0 / kBin, y = r.y0 / kBin, columns = (r.x1 - 1) / kBin - x + 1;
  return {x, y, columns, columns * ((r.y1 - 1) / kBin - y + 1)};
}

// Bins of an image across and down.
BIGTRI_HD int bin_columns(const Viewport& v) { return (v.width + kBin - 1) / kBin; }
BIGTRI_HD int bin_rows(const Viewport& v) { return (v.height + kBin - 1) / kBin; }

// f of one edge over a bin: the value at the first pixel centre, its steps, and its extremes over the bin's centres. int64, before any narrowing:
// far from the edge the value can exceed 2^31 hundreds of times.
struct BinEdge {
  int32_t sx, sy;
  int64_t f, lowest, highest;
};

// The extremes of a linear function over a square of centres that starts at value f. At most 63 * (2^24 + 2^24) are added: below 2^31.
BIGTRI_HD int64_t lowest_of(int64_t f, int32_t sx, int32_t sy, int last) {
  return f + last * (min_of(sx, 0) + min_of(sy, 0));
}
BIGTRI_HD int64_t highest_of(int64_t f, int32_t sx, int32_t sy, int last) {
  return f + last * (max_of(sx, 0) + max_of(sy, 0));
}

// The same over last_x + 1 by last_y + 1 centres; F is int32 where that holds f.
template <class F>
BIGTRI_HD F lowest_of(F f, int32_t sx, int32_t sy, int last_x, int last_y) {
  return f + (last_x * min_of(sx, 0) + last_y * min_of(sy, 0));
}
template <class F>
BIGTRI_HD F highest_of(F f, int32_t sx, int32_t sy, int last_x, int last_y) {
  return f + (last_x * max_of(sx, 0) + last_y * max_of(sy, 0));
}

BIGTRI_HD BinEdge bin_edge(const Edge& e, int bin_x, int bin_y, SamplePoint at = kCentre) {
  BinEdge b;
  b.f = edge_steps(e, bin_x * kBin, bin_y * kBin, at);
  b.sx = -e.dy;
  b.sy = e.dx;
  b.lowest = lowest_of(b.f, b.sx, b.sy, kBin - 1);
  b.highest = highest_of(b.f, b.sx, b.sy, kBin - 1);
  return b;
}

// int32 edge inside a bin that the edge does not reject. Constant where the whole bin is inside, so what remains crosses the bin: its extremes over the 64x64
// centres have both signs, so neither is farther from 0 than they are from each other, |f| <= 63 * (|sx| + |sy|) <= 63 * 2^25 = 63/64 * 2^31.
struct NarrowEdge {
  int32_t f, sx, sy;
};

BIGTRI_HD NarrowEdge narrow(const BinEdge& b) {
  if (b.lowest >= 0) return {0, 0, 0};
  return {(int32_t)b.f, b.sx, b.sy};
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

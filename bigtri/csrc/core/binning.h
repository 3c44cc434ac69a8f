// Which 64x64 px bins an edge of a large record rejects; docs/numerics.md 4. Binning follows setup, and its entries go
// to the tile masks. Mirrors bigtri/reference/binning.py.
#pragma once

#include "numerics.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

// Whether a bbox (px, half-open, within the scissor) has more than threshold pixels. bin_owned also treats as large
// what extends over more than 1024 px (record.h); the bits are the same.
BIGTRI_HD bool is_large(int x0, int y0, int x1, int y1, int64_t threshold) {
  return (int64_t)(x1 - x0) * (y1 - y0) > threshold;
}

// The candidates of a record or primitive: the bins that its bbox touches, numbered row by row.
struct BinBox {
  int x, y;  // column and row of the first bin
  int columns, count;  // bins in a row, and in all
};

// Boxed is a Record or a Primitive.
template <class Boxed>
BIGTRI_HD BinBox bin_box(const Boxed& r) {
  const int x = r.x0 / kBin, y = r.y0 / kBin, columns = (r.x1 - 1) / kBin - x + 1;
  return {x, y, columns, columns * ((r.y1 - 1) / kBin - y + 1)};
}

// Number of bins across and down an image.
BIGTRI_HD int bin_columns(const Viewport& v) { return (v.width + kBin - 1) / kBin; }
BIGTRI_HD int bin_rows(const Viewport& v) { return (v.height + kBin - 1) / kBin; }

// f of one edge over a bin, before it is narrowed. It needs int64: |e| < 2^49 gives |f| <= 2^41, which is 1024 times
// what int32 holds. Where it wraps around, it fits int32 in all of the bin (wrapped_steps).
struct BinEdge {
  int32_t sx, sy;  // change of f per px in x and in y; below 2^24 in magnitude
  StepNumber f, lowest, highest;  // f at the bin's first pixel centre, and its extremes over all 64x64
};

// The extremes of f over a square of (last + 1)^2 pixel centres, from its value at the first one. last is at most 63,
// so the number added is at most 63 * (2^24 + 2^24) = 63/64 * 2^31 in magnitude, and fits int32.
BIGTRI_HD StepNumber lowest_of(StepNumber f, int32_t sx, int32_t sy, int last) {
  return f + (EdgeNumber)last * ((EdgeNumber)min_of(sx, 0) + min_of(sy, 0));
}
BIGTRI_HD StepNumber highest_of(StepNumber f, int32_t sx, int32_t sy, int last) {
  return f + (EdgeNumber)last * ((EdgeNumber)max_of(sx, 0) + max_of(sy, 0));
}

// The same over last_x + 1 by last_y + 1 centres. F is int32_t if f fits that, else int64_t.
template <class F>
BIGTRI_HD F lowest_of(F f, int32_t sx, int32_t sy, int last_x, int last_y) {
  return f + (last_x * min_of(sx, 0) + last_y * min_of(sy, 0));
}
template <class F>
BIGTRI_HD F highest_of(F f, int32_t sx, int32_t sy, int last_x, int last_y) {
  return f + (last_x * max_of(sx, 0) + last_y * max_of(sy, 0));
}

// bin_x, bin_y: the bin's column and row.
BIGTRI_HD BinEdge bin_edge(const Edge& e, int bin_x, int bin_y, SamplePoint at = kCentre) {
  BinEdge b;
  b.f = edge_steps(e, bin_x * kBin, bin_y * kBin, at);
  b.sx = -e.dy;
  b.sy = e.dx;
  b.lowest = lowest_of(b.f, b.sx, b.sy, kBin - 1);
  b.highest = highest_of(b.f, b.sx, b.sy, kBin - 1);
  return b;
}

// f of one edge inside a bin that the edge does not reject, in int32. If the whole bin lies inside the edge, f becomes
// the constant 0. Any other edge crosses the bin: lowest < 0 <= highest. So at each of the 64x64 centres |f| is at most
// the difference of the two, |f| <= highest - lowest = 63 * (|sx| + |sy|) <= 63 * 2^25
// = 63/64 * 2^31.
struct NarrowEdge {
  int32_t f, sx, sy;
};

BIGTRI_HD NarrowEdge narrow(const BinEdge& b) {
  if (b.lowest >= 0) return {0, 0, 0};
  return {(int32_t)b.f, b.sx, b.sy};
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

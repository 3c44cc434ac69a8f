// The stages tile_mask, scanline and depth one by one, on the inner code that the variants run. The binding calls them
// through Stages::kernels. Compiled once per instruction set.
#pragma once

#include "../core/coverage.h"
#include "../core/pixel_depth.h"
#include "depth.inl"
#include "setup.inl"
#include "tile_mask.inl"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

BIGTRI_INLINE void read_vertices(const int32_t* xy, int32_t x[3], int32_t y[3]) {
  for (int k = 0; k < 3; ++k) {
    x[k] = xy[2 * k];
    y[k] = xy[2 * k + 1];
  }
}

// A primitive of which nothing but the vertices is set.
BIGTRI_INLINE Primitive primitive_of(const int32_t x[3], const int32_t y[3]) {
  Primitive p;
  for (int k = 0; k < 3; ++k) p.x[k] = x[k], p.y[k] = y[k];
  return p;
}

// Whether a tile's coverage is computed sixteen pixels at a time, in int32; else pixel by pixel.
constexpr bool kVectorEdges = !kFloatCoverage && !Rung::kWideEdges;

// The same as tile_masks and tile_coverage, by the rung's rule.
BIGTRI_INLINE TileMasks tile_masks_of(const EdgesInBin& e) {
  TileMasks m = {0, 0};
  for (int t = 0; t < 64; ++t) {
    m.touched |= (uint64_t)touches_tile(e, t % 8, t / 8) << t;
    m.full |= (uint64_t)fills_tile(e, t % 8, t / 8) << t;
  }
  return m;
}
BIGTRI_INLINE uint64_t tile_coverage_of(const EdgesInBin& e, int column, int row) {
  uint64_t mask = 0;
  for (int t = 0; t < 64; ++t) mask |= (uint64_t)is_inside(e, column * kTile + t % 8, row * kTile + t / 8) << t;
  return mask;
}

// Cuts [lower, upper) to the pixels of row y that are inside the edge, which lie side by side: by halving, the first one
// on the other side than the pixels to the left of it.
BIGTRI_INLINE void cut_float_span(const FloatEdge& e, int y, int64_t* lower, int64_t* upper) {
  const bool rises = rises_x(e);
  int64_t low = *lower, high = max_of(*lower, *upper);
  while (low < high) {
    const int64_t middle = (low + high) / 2;
    if (is_inside(e, (int)middle, y) == rises)
      high = middle;
    else
      low = middle + 1;
  }
  *(rises ? lower : upper) = low;
}

// The record's edges within a bin. False if one of them rejects the bin.
BIGTRI_INLINE bool narrow_edges(const int32_t x[3], const int32_t y[3], int bin_x, int bin_y, NarrowEdge e[3]) {
  for (int k = 0; k < 3; ++k) {
    const BinEdge b = bin_edge(edge_of(x, y, k), bin_x, bin_y);
    if (b.highest < 0) return false;
    e[k] = narrow(b);
  }
  return true;
}

void stage_tile_mask(const int32_t* xy, const int32_t* bbox, const int32_t* queue, int64_t count, int64_t* touched,
                     int64_t* full) {
  for (int64_t i = 0; i < count; ++i) {
    const int32_t *entry = queue + 3 * i, *box = bbox + 4 * (int64_t)entry[0];
    int32_t x[3], y[3];
    read_vertices(xy + 6 * (int64_t)entry[0], x, y);
    NarrowEdge e[3];
    TileMasks m = {0, 0};
    if constexpr (kVectorEdges && kMaskRule == MaskRule::kCorners) {
      if (narrow_edges(x, y, entry[1], entry[2], e)) m = tile_masks(e);
    } else {
      EdgesInBin edges;
      if (edges_in_bin(primitive_of(x, y), entry[1], entry[2], &edges)) m = tile_masks_of(edges);
    }
    const int left = entry[1] * kBin, top = entry[2] * kBin;
    if constexpr (kMaskRule != MaskRule::kNone)
      m.touched &= bbox_tiles(box[0] - left, box[1] - top, box[2] - left, box[3] - top);
    touched[i] = (int64_t)m.touched;
    full[i] = (int64_t)(m.full & m.touched);
  }
}

// Appends span n unless it is empty; returns the new number of spans.
BIGTRI_INLINE int64_t put_span(int32_t record, int64_t y, int64_t lower, int64_t upper, int32_t* spans, int64_t n) {
  if (lower >= upper) return n;
  int32_t* s = spans + 4 * n;
  s[0] = record;
  s[1] = (int32_t)y;
  s[2] = (int32_t)lower;
  s[3] = (int32_t)upper;
  return n + 1;
}

// Spans of one queue entry (record, bin column, bin row), at most 512. xy and bbox are those of the one record.
int64_t stage_scan_tiles(const int32_t* xy, const int32_t* bbox, const int32_t* entry, uint64_t touched,
                         int32_t* spans) {
  int32_t px[3], py[3];
  read_vertices(xy, px, py);
  NarrowEdge e[3];
  i32x16 offset[3];
  EdgesInBin edges;
  if constexpr (kVectorEdges) {
    if (!narrow_edges(px, py, entry[1], entry[2], e)) return 0;
    for (int k = 0; k < 3; ++k) offset[k] = lanes(0, e[k].sx, e[k].sy);
  } else {
    if (!edges_in_bin(primitive_of(px, py), entry[1], entry[2], &edges)) return 0;
  }
  int64_t n = 0;
  for (; touched; touched &= touched - 1) {
    const int t = __builtin_ctzll(touched), column = t % 8, row = t / 8;
    uint64_t coverage;
    if constexpr (kVectorEdges)
      coverage = tile_coverage(e, offset, column, row);
    else
      coverage = tile_coverage_of(edges, column, row);
    const int64_t x = (int64_t)entry[1] * kBin + column * kTile, y = (int64_t)entry[2] * kBin + row * kTile;
    for (int j = 0; j < kTile; ++j) {
      const uint32_t bits = coverage >> (8 * j) & 0xff;
      if (!bits || y + j < bbox[1] || y + j >= bbox[3]) continue;
      // A triangle is convex: the covered pixels of a row are one run.
      const int64_t lower = x + __builtin_ctz(bits), upper = x + 32 - __builtin_clz(bits);
      n = put_span(entry[0], y + j, max_of<int64_t>(lower, bbox[0]), min_of<int64_t>(upper, bbox[2]), spans, n);
    }
  }
  return n;
}

// Spans of a small record, one per row of its bbox at most.
int64_t stage_scan_rows(const int32_t* xy, const int32_t* bbox, int32_t record, int32_t* spans) {
  int32_t px[3], py[3];
  read_vertices(xy, px, py);
  int64_t n = 0;
  for (int64_t y = bbox[1]; y < bbox[3]; ++y) {
    int64_t lower = 0, upper = bbox[2] - bbox[0];
    if constexpr (kFloatCoverage) {
      lower += bbox[0], upper += bbox[0];
      for (int k = 0; k < 3; ++k) cut_float_span(float_edge(primitive_of(px, py), k), (int)y, &lower, &upper);
      n = put_span(record, y, lower, upper, spans, n);
    } else {
      for (int k = 0; k < 3; ++k) {
        const Edge e = edge_of(px, py, k);
        cut_span(edge_steps(e, bbox[0], y), -(EdgeNumber)e.dy, &lower, &upper);
      }
      n = put_span(record, y, bbox[0] + lower, bbox[0] + upper, spans, n);
    }
  }
  return n;
}

// Depth of every pixel of the spans, in their order. Consecutive spans are mostly of one record and cell, so the last
// cell's plane is kept.
void stage_depth(const int32_t* xy, const float* z, const int64_t* area, const int32_t* spans, int64_t count,
                 float* out) {
  Record r;
  DepthInCell ladder = {};
  CellDepth d = {};
  int64_t last_record = -1, last_x = -1, last_y = -1;
  for (int64_t i = 0; i < count; ++i) {
    const int32_t* s = spans + 4 * i;
    for (int64_t x = s[2]; x < s[3];) {
      const int64_t cell_x = x / kBin, cell_y = s[1] / kBin;
      if (s[0] != last_record || cell_x != last_x || cell_y != last_y) {
        Primitive p;
        read_vertices(xy + 6 * (int64_t)s[0], p.x, p.y);
        for (int k = 0; k < 3; ++k) p.z[k] = z[3 * (int64_t)s[0] + k];
        p.area = area[s[0]];
        p.x0 = p.y0 = p.x1 = p.y1 = 0;
        fill_record(p, 0, &r);
        if constexpr (kPlainPlane)
          cell_depth(r, (int)cell_x, (int)cell_y, &d);
        else
          ladder = depth_in_cell(r, (int)cell_x, (int)cell_y);
        last_record = s[0];
        last_x = cell_x;
        last_y = cell_y;
      }
      const int i0 = (int)(x % kBin), j = s[1] % kBin;
      const int64_t n = min_of<int64_t>(min_of<int64_t>(8, s[3] - x), kBin - i0);
      if constexpr (kPlainPlane) {
        const f32x8 v = clamp_depth(to_float(d.thin ? row_depth<true>(d, i0, j) : row_depth<false>(d, i0, j)),
                                    splat<f32x8>(d.zmin), splat<f32x8>(d.zmax));
        for (int64_t k = 0; k < n; ++k) out[k] = v[k];
      } else {
        for (int k = 0; k < (int)n; ++k)
          out[k] = is_thin(r) ? pixel_depth<true>(ladder, i0 + k, j) : pixel_depth<false>(ladder, i0 + k, j);
      }
      out += n;
      x += n;
    }
  }
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

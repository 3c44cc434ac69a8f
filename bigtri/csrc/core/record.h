// The record of a (sub)triangle: the part of docs/numerics.md 2.4 that rasterization reads. Setup makes it once from a
// Primitive, with the depth gradients of section 7. Binning, tiles, spans and depth read it. Mirrors
// bigtri/reference/records.py.
#pragma once

#include "binning.h"
#include "depth.h"
#include "setup.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

struct Record : Places {  // 96 bytes, 104 on the GPU; with places 24 more
  int32_t x[3], y[3];  // snapped vertices, subpx
  float z[3];  // window depth of the vertices
  uint32_t triangle;  // index of the parent triangle
  Divisor area;  // twice the area, subpx^2, > 0
  DepthNumber dzdx, dzdy;  // depth plane: window depth per px
  float zmin, zmax;  // of z
  int32_t x0, y0, x1, y1;  // bbox, px, half-open
  uint32_t flags;  // kRecordLarge | kRecordThin | kRecordFar
  int32_t view;  // set where records of several views lie together
};
// Large: its bins are tested against its edges, and it is drawn by tiles. Thin: depth is not computed from the plane
// (numerics.md 7). Far: zmax > 1, so some fragments may be dropped.
constexpr uint32_t kRecordLarge = 1, kRecordThin = 2, kRecordFar = 4;

// Largest extent of a small record, subpx. The direct path of small records keeps f in int32 without a bin test. Let
// the triangle's extent be D <= 1024 px = 2^18 subpx, and let samples lie up to 8 px = 2^11 subpx outside of it. e is a
// difference of two products of a side (<= D) and a distance (<= D + 2^11), so |e| <= 2 * D * (D + 2^11) < 2^38, and
// |f| < 2^30. A small bbox alone does not bound D: the screen may have cut it from a huge triangle.
constexpr int32_t kDirectExtent = 1024 * kSubpixel;

// Subpx, in one dimension; extent_of is the larger of both.
BIGTRI_HD int32_t extent(const int32_t v[3]) {
  return max_of(max_of(v[0], v[1]), v[2]) - min_of(min_of(v[0], v[1]), v[2]);
}
BIGTRI_HD int32_t extent_of(const Primitive& p) { return max_of(extent(p.x), extent(p.y)); }

// Largest extent of a tiny triangle, subpx.
constexpr int32_t kTinyExtent = 4 * kSubpixel;
// Whether it is the rung's own coverage that covers_nothing() computes, and in numbers of 32 bits.
constexpr bool kSkipsEmpty = Rung::kCoverage == CoverageRule::kFixed && !Rung::kWraps && Rung::kSubpixelBits <= 8;

// Whether a primitive is tiny, has a bbox of at most 2x2 px, and covers none of these: such a one needs no record. Of a
// mesh whose triangles are about as large as a pixel that is a third. e is within int32: a vertex and a sample are at
// most kTinyExtent + kSubpixel < 2^11 apart, so |e| < 2 * 2^10 * 2^11. covers_nothing() of cpu/setup.inl repeats this
// for eight triangles, without_empty() of bigtri/reference/work.py in Python.
BIGTRI_HD bool covers_nothing(const Primitive& p) {
  if (p.x1 - p.x0 > 2 || p.y1 - p.y0 > 2 || extent_of(p) >= kTinyExtent) return false;
  const bool right = p.x1 - p.x0 == 2, below = p.y1 - p.y0 == 2;
  int32_t outside[4] = {0, right ? 0 : -1, below ? 0 : -1, right && below ? 0 : -1};  // negative where the pixel is
  for (int k = 0; k < 3; ++k) {
    const Edge edge = edge_of(p.x, p.y, k);
    const int32_t e =
        edge.dx * (pixel_centre(p.y0) - edge.py) - edge.dy * (pixel_centre(p.x0) - edge.px) + (int32_t)edge_bias(edge);
    for (int pixel = 0; pixel < 4; ++pixel)
      outside[pixel] |= e - (pixel & 1) * kSubpixel * edge.dy + (pixel >> 1) * kSubpixel * edge.dx;
  }
  return (outside[0] & outside[1] & outside[2] & outside[3]) < 0;
}

// triangle: index of the parent. threshold: a bbox with more px makes the record large. kPlane: whether to set the area
// and the depth plane.
template <bool kPlane = true>
BIGTRI_HD void fill_record(const Primitive& p, int64_t triangle, Record* r, int64_t threshold = kLargeThreshold) {
  for (int k = 0; k < 3; ++k) {
    r->x[k] = p.x[k];
    r->y[k] = p.y[k];
    r->z[k] = p.z[k];
  }
  static_cast<Places&>(*r) = p;
  r->triangle = (uint32_t)triangle;
  if constexpr (kPlane) {
    r->area = divisor((double)p.area);
    const DepthGradient g = depth_gradient(p.x, p.y, p.z, r->area);
    r->dzdx = g.dzdx;
    r->dzdy = g.dzdy;
  }
  r->zmin = min_of(min_of(p.z[0], p.z[1]), p.z[2]);
  r->zmax = max_of(max_of(p.z[0], p.z[1]), p.z[2]);
  r->x0 = p.x0;
  r->y0 = p.y0;
  r->x1 = p.x1;
  r->y1 = p.y1;
  const bool large = is_large(p.x0, p.y0, p.x1, p.y1, threshold) || extent_of(p) > kDirectExtent;
  r->flags =
      (large ? kRecordLarge : 0) | (is_thin(p.x, p.y, p.area) ? kRecordThin : 0) | (r->zmax > 1.0f ? kRecordFar : 0);
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

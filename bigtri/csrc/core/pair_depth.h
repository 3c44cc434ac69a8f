// Depth of pixels without float64, for GPUs on which that is slow: the twin of depth.h in pairs of float32, for the rule
// kFloat64Cell. A pair says which float32 the plane of depth.h, which is float64, rounds to, or that it cannot say.
//
// Let zmax and zmin be the vertices' extreme depths, all >= 0, A twice the area, subpx^2, L the sum of |dx| + |dy| over the
// edges, subpx, and l = s L / A, with s subpx a px: what edge values change by from pixel to pixel, of A.
//
// What depth.h computes in float64 is off from the exact plane by (1 + 128 l) 2^-50 zmax at most. The edge values at a
// covered pixel add up to A, so those at the cell's first pixel, at most 63 px away along either axis, to (1 + 63 l) A
// in magnitude. Of the anchor four roundings are of numbers below (1 + 63 l) zmax, its inputs are exact. A gradient has
// three roundings, since its products are exact, of numbers below its share of l zmax, and is multiplied with 63 at
// most. The plane's products are below 63 l zmax together, and its two sums below (1 + 126 l) zmax each. With 2^-53 for
// each: 4 + 252 l + 189 l + 63 l + 2 + 252 l, which is below 8 (1 + 128 l).
//
// The pairs are anchored at the first pixel of the bbox, and are off by u^2 (14 zmax + 140 l E (zmax - zmin)), E being the
// bbox' longer side in px as vertices span it, u = 2^-24. They compute z0 + (g1 (z1 - z0) + g2 (z2 - z0)) / A, which is
// the same plane, as the edge values add up to A. The differences are exact. Let N be (|g1| + |g2|) (zmax - zmin) / A at
// the anchor, and G and H the like of the gradients times columns and rows from there to the pixel. Of each of the three
// the products are off by 8 u^2 at most, their sum by 4, the inverse of A by 32, and the product with it by 8, relative
// to it: 56 with what is of higher order. The sums on the way to the pixel are of zmax, N, H and G: 4 u^2 (zmax + N) for
// the anchor, 4 (zmax + N + H) and 4 H for the row, 3 (zmax + N + H) and 7 G for the pixel, and 3 (zmax + N + H) + 2 G for
// what rounds_alike rounds: 14 zmax + 70 N + 70 H + 65 G. The anchor and the pixel lie in the vertices' bounding box, so
// that N + G + H <= 2 l E (zmax - zmin).
//
// Or they are anchored at the first pixel of the cell, as depth.h has it. The edge values there add up to (1 + 63 l) A at
// most in magnitude, so that N + G + H <= (1 + 126 l) (zmax - zmin) for every pixel of the cell, covered or not, as long
// as the cell has one that is.
//
// What underflows stays below 2^-125: A is at least 1, and columns and rows are below 2^14.
#pragma once

#include "depth.h"
#include "float_pair.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

// Whether depth is computed so.
constexpr bool kPairDepth = kSlowFloat64 && Rung::kDepth == DepthRule::kFloat64Cell && kSubpixelBits <= 8;

struct PairPlane {
  FloatPair z, dzdx, dzdy;  // at the anchor, a pixel's centre, and the change per px
  float error;  // bounds how far the plane, as computed at a covered pixel, is off from that in float64, as computed
};

// What the bounds are made of: where N + G + H <= zmax - zmin; what to add for each px times l beyond that; and for twice
// the longer side times l.
struct PairError {
  float fixed, per_px, per_side;
};
BIGTRI_HD PairError pair_error(const int32_t x[3], const int32_t y[3], const float z[3], float by_area) {
  // dx and dy add up to 0 over the edges, so their magnitudes to twice the extents.
  int32_t across = 0, down = 0;
  for (int k = 0; k < 3; ++k) {
    const Edge e = edge_of(x, y, k);
    across += absolute(e.dx);
    down += absolute(e.dy);
  }
  const float length = (float)(across + down) * by_area, side = (float)max_of(across, down) * 0.5f;  // subpx^-1, subpx
  const float zmin = min_of(min_of(z[0], z[1]), z[2]), zmax = max_of(max_of(z[0], z[1]), z[2]);
  // A little more than 14 + 1/4, 32 and 70, or 100 in a cell, for the roundings of what is written here.
  constexpr float kUnit = 1.0f / (1 << 24) / (1 << 24), kTiny = 1.0f / (1 << 30) / (1 << 30) / (1 << 30) / (1 << 30);
  const float each = 150.0f * kUnit * (zmax - zmin);
  return {kUnit * (16.0f + 33.0f * kSubpixel * length) * zmax + each + kTiny, kSubpixel * length * each,
          length * side * each};
}

// (g1 * d1 + g2 * d2) * by; G is float or FloatPair.
template <class G>
BIGTRI_HD FloatPair weighted_pair(G g1, G g2, FloatPair d1, FloatPair d2, FloatPair by) {
  return product(sum(product(g1, d1), product(g2, d2)), by);
}

// Of a triangle that is not thin, |edge values| < 2^49, anchored at pixel (x0, y0): the first one of its bbox, or if kCell
// of a cell.
template <bool kCell>
BIGTRI_HD PairPlane pair_plane_from(const int32_t x[3], const int32_t y[3], const float z[3], int64_t area, int32_t x0,
                                    int32_t y0) {
  const Edge e[3] = {edge_of(x, y, 0), edge_of(x, y, 1), edge_of(x, y, 2)};
  const FloatPair d1 = two_sum(z[1], -z[0]), d2 = two_sum(z[2], -z[0]), by_area = inverse(pair_of(area));
  const FloatPair per_px = {kSubpixel * by_area.hi, kSubpixel * by_area.lo};
  const FloatPair g1 = pair_of(edge_value(e[1], pixel_centre(x0), pixel_centre(y0))),
                  g2 = pair_of(edge_value(e[2], pixel_centre(x0), pixel_centre(y0)));
  PairPlane p;
  p.z = sum({z[0], 0.0f}, weighted_pair(g1, g2, d1, d2, by_area));
  p.dzdx = weighted_pair(-(float)e[1].dy, -(float)e[2].dy, d1, d2, per_px);
  p.dzdy = weighted_pair((float)e[1].dx, (float)e[2].dx, d1, d2, per_px);
  const PairError error = pair_error(x, y, z, by_area.hi);
  p.error = error.fixed + (kCell ? 127.0f * error.per_px : error.per_side);
  return p;
}
BIGTRI_HD PairPlane pair_plane(const int32_t x[3], const int32_t y[3], const float z[3], int64_t area, int32_t x0,
                               int32_t y0) {
  return pair_plane_from<false>(x, y, z, area, x0, y0);
}
BIGTRI_HD PairPlane pair_cell_plane(const int32_t x[3], const int32_t y[3], const float z[3], int64_t area, int cell_x,
                                    int cell_y) {
  return pair_plane_from<true>(x, y, z, area, cell_x * kBin, cell_y * kBin);
}

// start + step * n
BIGTRI_HD FloatPair pair_at(FloatPair start, FloatPair step, float n) { return sum(start, product(n, step)); }

// What the float64 plane rounds to at the n-th pixel of a row, which begins at `start`; false where that is not certain.
BIGTRI_HD bool pair_depth(FloatPair start, FloatPair dzdx, float n, float error, float* z) {
  const FloatPair p = two_product(dzdx.hi, n), s = two_sum(start.hi, p.hi);
  return rounds_alike(s.hi, s.lo + (start.lo + multiply_add(dzdx.lo, n, p.lo)), error, z);
}

// The same for lines of pixels, each anchored at a pixel that is covered, where N is below zmax - zmin: what the lines of a
// triangle have in common.
struct PairLines {
  FloatPair d1, d2, by_area, step;  // step: the change from pixel to pixel
  float fixed, per_px;  // PairError
};
BIGTRI_HD PairLines pair_lines(const int32_t x[3], const int32_t y[3], const float z[3], int64_t area, bool columns) {
  const Edge e1 = edge_of(x, y, 1), e2 = edge_of(x, y, 2);
  PairLines p;
  p.d1 = two_sum(z[1], -z[0]);
  p.d2 = two_sum(z[2], -z[0]);
  p.by_area = inverse(pair_of(area));
  p.step = weighted_pair(columns ? (float)e1.dx : -(float)e1.dy, columns ? (float)e2.dx : -(float)e2.dy, p.d1, p.d2,
                         {kSubpixel * p.by_area.hi, kSubpixel * p.by_area.lo});
  const PairError error = pair_error(x, y, z, p.by_area.hi);
  p.fixed = error.fixed;
  p.per_px = error.per_px;
  return p;
}
// The plane at a covered pixel.
BIGTRI_HD FloatPair pair_line_start(const PairLines& p, const int32_t x[3], const int32_t y[3], float z0, int px,
                                    int py) {
  const FloatPair g1 = pair_of(edge_value(edge_of(x, y, 1), pixel_centre(px), pixel_centre(py))),
                  g2 = pair_of(edge_value(edge_of(x, y, 2), pixel_centre(px), pixel_centre(py)));
  return sum({z0, 0.0f}, weighted_pair(g1, g2, p.d1, p.d2, p.by_area));
}

// What corner_plane bounds, for a plane of pair_cell_plane(): no covered pixel of the rectangle is nearer, as computed in
// float64 and rounded, or farther. Where a gradient's sign is not that of the exact one, the exact one is below its error,
// 56 u^2 of its share of l (zmax - zmin), and 63 times that, with what is farther from zmax here than pixels are, is
// within the plane's error: 70 + 28 + 2 of (1 + 126 l) (zmax - zmin), of which that has 150.
BIGTRI_HD float pair_corner_plane(const PairPlane& p, int i, int j, int last_x, int last_y, bool farthest) {
  const int x = (p.dzdx.hi < 0) != farthest ? i + last_x : i, y = (p.dzdy.hi < 0) != farthest ? j + last_y : j;
  const FloatPair z = pair_at(pair_at(p.z, p.dzdy, exact_float(y)), p.dzdx, exact_float(x));
  return z.hi + (z.lo + (farthest ? p.error : -p.error));
}

// What it is compared with: the plane of depth.h at a pixel, rounded to float32.
BIGTRI_HD float plane_depth(const int32_t x[3], const int32_t y[3], const float z[3], int64_t twice_area, int32_t px,
                            int32_t py) {
  const Divisor area = divisor((double)twice_area);
  const DepthGradient g = depth_gradient(x, y, z, area);
  const DepthNumber zcell = depth_at(x, y, z, area, px & -kBin, py & -kBin);
  return (float)(plane_row<DepthNumber>(zcell, g.dzdy, place_in_cell(py & (kBin - 1))) +
                 plane_column<DepthNumber>(g.dzdx, place_in_cell(px & (kBin - 1))));
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

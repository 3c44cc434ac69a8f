// Window depth of a pixel, from the record's plane over a 64x64 px cell; docs/numerics.md 7. Depth is computed for the
// pixels of spans, and visibility keeps the nearest. Bounds for hidden-surface rejection use the same arithmetic.
// Mirrors bigtri/reference/depth.py.
#pragma once

#include "numerics.h"
#include "visibility.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

// What a depth plane is computed in, and all that leads to it. Plane values are rounded to float32 in the end.
constexpr bool kFloatPlane = Rung::kDepth == DepthRule::kFloat32Cell;
using DepthNumber = std::conditional_t<kFloatPlane, float, double>;

// ((g0*z0 + g1*z1) + g2*z2) / area: gives the plane's gradients and anchor, and the depth of a thin record's pixel. D
// is a DepthNumber, or a vector of them in the CPU's inner loops.
template <class D, class G, class Z, class Area>
BIGTRI_HD D weighted_depth(G g0, G g1, G g2, Z z0, Z z1, Z z2, const Area& area) {
  return quotient((g0 * z0 + g1 * z1) + g2 * z2, area);
}

// The plane at pixel (i, j) of the cell, counted from its first pixel, is plane_row(j) + plane_column(i). bin_owned
// tabulates both for a large record in a bin.
template <class D>
BIGTRI_HD D plane_row(DepthNumber zcell, DepthNumber dzdy, D j) {
  return zcell + dzdy * j;
}
template <class D>
BIGTRI_HD D plane_column(DepthNumber dzdx, D i) {
  return dzdx * i;
}

// i or j as a DepthNumber; exact.
BIGTRI_HD DepthNumber place_in_cell(int v) {
  if constexpr (kFloatPlane)
    return (float)v;
  else
    return exact_double(v);
}

// A depth, clamped to the record's own range, and never -0.
BIGTRI_HD float clamp_depth(float f, float zmin, float zmax) {
#if defined(__CUDA_ARCH__)
  // fminf and fmaxf are one instruction each. Of zeros with different signs they may choose the other one; adding +0.0f
  // makes +0 of both.
  return fminf(fmaxf(f, zmin), zmax) + 0.0f;
#else
  return min_of(max_of(f, zmin), zmax) + 0.0f;
#endif
}

// The same, rounded to float32 first.
BIGTRI_HD float finish_depth(double z, float zmin, float zmax) { return clamp_depth((float)z, zmin, zmax); }

// A record's depth plane over one cell.
struct CellPlane {
  DepthNumber zcell, dzdx, dzdy;  // at the cell's first pixel centre, and the change per px
};

// The plane's nearest value, or its farthest if `farthest`, over the pixels from (i, j) to (i + last_x, j + last_y) of
// the cell. It is computed like the pixels themselves, so the bound needs no margin, whatever the plane is computed in:
// at pixel (i, j) stands fl(fl(zcell + fl(dzdy*j)) + fl(dzdx*i)), fl being the rounding to DepthNumber. fl is monotone.
// So fl(dzdy*j) rises with j if dzdy >= 0, else it falls or stays, and the sum, which is two more monotone steps, does the
// same for every i; likewise with i. Hence the extremes over a rectangle lie at corners, and the signs of dzdx and dzdy, as
// computed, tell which. What follows, a last rounding to float32 and the clamp, is monotone too.
BIGTRI_HD DepthNumber corner_plane(const CellPlane& p, int i, int j, int last_x, int last_y, bool farthest) {
  const int x = (p.dzdx < 0) != farthest ? i + last_x : i, y = (p.dzdy < 0) != farthest ? j + last_y : j;
  return plane_row<DepthNumber>(p.zcell, p.dzdy, place_in_cell(y)) +
         plane_column<DepthNumber>(p.dzdx, place_in_cell(x));
}

// The same as a window depth.
BIGTRI_HD float corner_depth(const CellPlane& p, float zmin, float zmax, int i, int j, int last_x, int last_y,
                             bool farthest) {
  return finish_depth(corner_plane(p, i, j, last_x, last_y, farthest), zmin, zmax);
}

BIGTRI_HD int32_t absolute(int32_t v) { return v < 0 ? -v : v; }

// Whether depth has to be computed without the plane, whose terms would cancel. area: twice the area, subpx^2.
BIGTRI_HD bool is_thin(const int32_t x[3], const int32_t y[3], int64_t area) {
  EdgeNumber length = 0;  // subpx; |dx| + |dy| < 2^25 for each edge, so it stays below 2^27
  for (int k = 0; k < 3; ++k) {
    const Edge e = edge_of(x, y, k);
    length += (EdgeNumber)absolute(e.dx) + absolute(e.dy);
  }
  // With wide edges kThinRatio * area may not fit. kSubpixel is a multiple of it then.
  if constexpr (Rung::kWideEdges) return kSubpixel / kThinRatio * length > area;
  return (int64_t)kSubpixel * length > kThinRatio * area;
}

// Change of window depth per px.
struct DepthGradient {
  DepthNumber dzdx, dzdy;
};

BIGTRI_HD DepthGradient depth_gradient(const int32_t x[3], const int32_t y[3], const float z[3], const Divisor& area) {
  DepthNumber gx[3], gy[3];  // exact in float32 too: 25 bits with the sign, times a power of two
  for (int k = 0; k < 3; ++k) {
    const Edge e = edge_of(x, y, k);
    gx[k] = -(DepthNumber)kSubpixel * (DepthNumber)e.dy;
    gy[k] = (DepthNumber)kSubpixel * (DepthNumber)e.dx;
  }
  const DepthNumber z0 = z[0], z1 = z[1], z2 = z[2];
  return {weighted_depth<DepthNumber>(gx[0], gx[1], gx[2], z0, z1, z2, area),
          weighted_depth<DepthNumber>(gy[0], gy[1], gy[2], z0, z1, z2, area)};
}

// Depth from the unbiased edge values at a pixel's centre.
BIGTRI_HD DepthNumber depth_from_edges(const int64_t e[3], const float z[3], const Divisor& area) {
  return weighted_depth<DepthNumber, DepthNumber, DepthNumber>((DepthNumber)e[0], (DepthNumber)e[1], (DepthNumber)e[2],
                                                               z[0], z[1], z[2], area);
}

// Depth at the centre of pixel (x, y): the anchor zcell if the pixel is a cell's first, or the depth of a thin record's
// pixel. px, py: the record's vertices, subpx.
BIGTRI_HD DepthNumber depth_at(const int32_t px[3], const int32_t py[3], const float z[3], const Divisor& area,
                               int32_t x, int32_t y) {
  int64_t e[3];
  for (int k = 0; k < 3; ++k) e[k] = edge_value(edge_of(px, py, k), pixel_centre(x), pixel_centre(y));
  return depth_from_edges(e, z, area);
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

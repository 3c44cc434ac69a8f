// The depth of a pixel by the rung's rule; docs/numerics.md 7 and 13. The variant two_stage and the depth stage draw
// with it; what is written for the planes of cells alone uses core/depth.h. Mirrors bigtri/reference/depth.py.
#pragma once

#include "record.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

constexpr DepthRule kDepthRule = Rung::kDepth;
constexpr bool kFloat32Depth = kDepthRule == DepthRule::kFloat32Cell || kDepthRule == DepthRule::kFloat32Vertex ||
                               kDepthRule == DepthRule::kFloat32Barycentric;
// What a rung's depth plane is computed in. In int64 it has 48 bits after the point: a record that is not thin has
// |dz/dx| + |dz/dy| <= 16 * (zmax - zmin) <= 40 per px, so that over the cell of a pixel that it covers |z| < 2^12,
// which is 2^60 in these units.
using PlaneNumber =
    std::conditional_t<kFloat32Depth, float, std::conditional_t<kDepthRule == DepthRule::kFixedCell, int64_t, double>>;
constexpr double kFixedOne = 281474976710656.0;  // 2^48

// Whether depth is a plane for each cell, as core/depth.h has it, and stored as it is: what bin_owned and scanline draw.
constexpr bool kPlainPlane = kDepthRule == DepthRule::kFloat64Cell || kDepthRule == DepthRule::kFloat32Cell;
static_assert(kPlainPlane || !Rung::kBinOwned, "bin_owned has no other depth");

// Whether the rung's rule treats the record as thin. The rules in float32 know no thin records, as published code does.
constexpr bool kKnowsThin = !kFloat32Depth;
BIGTRI_HD bool is_thin(const Record& r) { return kKnowsThin && (r.flags & kRecordThin); }
BIGTRI_HD bool is_thin(const Primitive& p) { return kKnowsThin && is_thin(p.x, p.y, p.area); }

// A record's depth within one cell.
struct DepthInCell {
  const Record* r;
  int left, top;  // the cell's first pixel, px
  // At the cell's first pixel centre, and its change per px; in float32 from a vertex, the change per subpx alone. Not
  // set where the record's depth has no plane.
  PlaneNumber z, dzdx, dzdy;
};

// ((g0*z0 + g1*z1) + g2*z2) / A in float32, of edge values or their changes.
BIGTRI_HD float weighted_in_float(const Record& r, const int64_t g[3]) {
  return (((float)g[0] * r.z[0] + (float)g[1] * r.z[1]) + (float)g[2] * r.z[2]) / (float)r.area.value;
}

// A GPU has it of thin records too, so as not to branch; nobody reads their plane.
BIGTRI_HD DepthInCell plane_in_cell(const Record& r, int cell_x, int cell_y) {
  DepthInCell d = {&r, cell_x * kBin, cell_y * kBin, 0, 0, 0};
  if constexpr (kDepthRule == DepthRule::kFloat32Vertex) {
    const float x1 = (float)(r.x[1] - r.x[0]), y1 = (float)(r.y[1] - r.y[0]), z1 = r.z[1] - r.z[0];
    const float x2 = (float)(r.x[2] - r.x[0]), y2 = (float)(r.y[2] - r.y[0]), z2 = r.z[2] - r.z[0];
    d.dzdx = (z1 * y2 - z2 * y1) / (float)r.area.value;
    d.dzdy = (z2 * x1 - z1 * x2) / (float)r.area.value;
  } else if constexpr (kDepthRule != DepthRule::kFloat32Barycentric) {
    const DepthNumber unit = kDepthRule == DepthRule::kFixedCell ? (DepthNumber)kFixedOne : (DepthNumber)1;
    d.z = (PlaneNumber)(depth_at(r.x, r.y, r.z, r.area, d.left, d.top) * unit);
    d.dzdx = (PlaneNumber)(r.dzdx * unit);
    d.dzdy = (PlaneNumber)(r.dzdy * unit);
  }
  return d;
}

BIGTRI_HD DepthInCell depth_in_cell(const Record& r, int cell_x, int cell_y) {
  if (is_thin(r)) return {&r, cell_x * kBin, cell_y * kBin, 0, 0, 0};
  return plane_in_cell(r, cell_x, cell_y);
}

// Depth of pixel (i, j) of the cell, rounded to float32, but not clamped. kThin: is_thin(record).
template <bool kThin>
BIGTRI_HD float plain_depth(const DepthInCell& d, int i, int j) {
  const Record& r = *d.r;
  if constexpr (kThin) {
    return (float)depth_at(r.x, r.y, r.z, r.area, d.left + i, d.top + j);
  } else if constexpr (kDepthRule == DepthRule::kFloat32Barycentric) {
    int64_t g[3];
    for (int k = 0; k < 3; ++k)
      g[k] = edge_value(edge_of(r.x, r.y, k), pixel_centre(d.left + i), pixel_centre(d.top + j));
    return weighted_in_float(r, g);
  } else if constexpr (kDepthRule == DepthRule::kFloat32Vertex) {
    const int32_t right = pixel_centre(d.left + i) - r.x[0], down = pixel_centre(d.top + j) - r.y[0];
    return (r.z[0] + d.dzdx * (float)right) + d.dzdy * (float)down;
  } else if constexpr (kDepthRule == DepthRule::kFixedCell) {
    return (float)((d.z + d.dzdy * j) + d.dzdx * i) * (float)(1 / kFixedOne);
  } else {
    return (float)(plane_row<DepthNumber>(d.z, d.dzdy, place_in_cell(j)) +
                   plane_column<DepthNumber>(d.dzdx, place_in_cell(i)));
  }
}

// A clamped depth as it is stored: the smaller one is nearer, and one above 1 is dropped. z >= +0, or of any sign where
// it is reversed.
BIGTRI_HD float stored_depth(float z) {
  if constexpr (kDepthRule == DepthRule::kStored24 || kDepthRule == DepthRule::kStored16) {
    constexpr double kLevels = kDepthRule == DepthRule::kStored24 ? 16777215.0 : 65535.0;
    const float level = (float)(round_half_even((double)z * kLevels) / kLevels);
    // Chosen by bits: of a branch, compilers would not divide for the pixels that do not need it, and make no vectors.
    const uint32_t beyond = z > 1.0f ? ~0u : 0u;
    return bits_float((float_bits(z) & beyond) | (float_bits(level) & ~beyond));
  } else if constexpr (kDepthRule == DepthRule::kReversed) {
    // The bits of floats from +0 to 1 ascend with them, so their distance from those of 1 descends.
    return z >= 0.0f ? bits_float(float_bits(1.0f) - float_bits(z)) : 2.0f;
  } else {
    return z;
  }
}

// The depth of pixel (i, j) of the cell as it is stored.
template <bool kThin>
BIGTRI_HD float pixel_depth(const DepthInCell& d, int i, int j) {
  return stored_depth(clamp_depth(plain_depth<kThin>(d, i, j), d.r->zmin, d.r->zmax));
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// The fragments of a record in one row of pixels, from its edges and its plane of depths: what the scanline variant does
// for each row, and bench/fragments.h.
#pragma once

#include "pixel_depth.h"
#include "scanline.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

// Calls use(x, depth) for every pixel x of row y, px, that the record covers, from left to right. The plane is anchored
// anew in each 64x64 px cell.
template <class Use>
BIGTRI_HD void for_each_fragment(const Record& r, int y, const Use& use) {
  int64_t lower = 0, upper = r.x1 - r.x0;
  for (int k = 0; k < 3; ++k) {
    const Edge e = edge_of(r.x, r.y, k);
    cut_span(edge_steps(e, r.x0, y), -e.dy, &lower, &upper);
  }
  CellPlane plane = {0, r.dzdx, r.dzdy};
  int cell = -1;
  for (int x = r.x0 + (int)lower; x < r.x0 + (int)upper; ++x) {
    DepthNumber z;
    if (is_thin(r)) {
      z = depth_at(r.x, r.y, r.z, r.area, x, y);
    } else {
      if (x / kBin != cell) plane.zcell = depth_at(r.x, r.y, r.z, r.area, x / kBin * kBin, y / kBin * kBin);
      cell = x / kBin;
      z = plane_row<DepthNumber>(plane.zcell, plane.dzdy, y % kBin) + plane_column<DepthNumber>(plane.dzdx, x % kBin);
    }
    use(x, finish_depth(z, r.zmin, r.zmax));
  }
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

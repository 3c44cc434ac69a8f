// The scanline variant: a task takes some triangles and cuts each row of a record's bounding box to the exact span.
// Each pixel of a span is offered its packed value with an atomic minimum. The binding calls draw() through the
// registry. It is what is usually tried first (Sui's first pipeline), and
// the shortest complete variant: copy it to begin your own.

#include <algorithm>

#include "../core/pixel_depth.h"
#include "../core/scanline.h"
#include "atomic.h"
#include "shares.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr Parameter kParameters[] = {{"share", "triangles", "triangles that a task takes at a time", 256, 1, 1 << 20},
                                     {}};

// Draws the pixels [x0 + lower, x0 + upper) of row y. The plane is anchored anew in each 64x64 px cell.
void draw_row(const Record& r, int y, int64_t lower, int64_t upper, const Frame& view, Counts* counts) {
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
    keep_nearest_atomically(view.packed + (int64_t)y * view.view.width + x,
                            pack_fragment(finish_depth(z, r.zmin, r.zmax), r.triangle), counts);
    counts->add_fragments(1, x, y);
  }
}

void draw_record(const Record& r, const Frame& view, Counts* counts) {
  for (int y = r.y0; y < r.y1; ++y) {
    int64_t lower = 0, upper = r.x1 - r.x0;
    for (int k = 0; k < 3; ++k) {
      const Edge e = edge_of(r.x, r.y, k);
      cut_span(edge_steps(e, r.x0, y), -e.dy, &lower, &upper);
    }
    draw_row(r, y, lower, upper, view, counts);
    counts->add_edges(Counter::edges_64, 3, r.x0, y);
  }
  counts->add(Counter::records, 1);
  counts->add(Counter::by_rows, 1);
  counts->add(Counter::rows, r.y1 - r.y0);
}

void draw(const ProjectedFrame& frame, const Parallel& parallel, const int64_t* values) {
  clear_image(frame, parallel);
  parallel(shares_of(frame, values[0]), [&](int64_t i) {
    const Share share = share_of(frame, values[0], i);
    const Frame view = view_of(frame, share.view);
    Counts counts(frame.map);
    // A copy, since the compiler need not read it again after each atomic operation on a pixel.
    set_up(frame, share, [&](Record r) { draw_record(r, view, &counts); });
    counts.publish_task(frame.counters);
  });
  write_depth_image(frame, parallel);
}

}  // namespace

extern const Variant scanline_variant;
const Variant scanline_variant = {"scanline", "a triangle a thread, row by row, with atomics: Sui's first pipeline",
                                  kParameters, draw_groups<draw>, /*shades=*/false};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

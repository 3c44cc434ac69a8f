// The scanline variant: a task takes some triangles and cuts each row of a record's bounding box to the exact span.
// Each pixel of a span is offered its packed value with an atomic minimum. The binding calls draw() through the
// registry. It is what is usually tried first (Sui's first pipeline), and
// the shortest complete variant: copy it to begin your own.

#include <algorithm>

#include "../core/row_fragments.h"
#include "atomic.h"
#include "shares.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr Parameter kParameters[] = {{"share", "triangles", "triangles that a task takes at a time", 256, 1, 1 << 20},
                                     {}};

void draw_record(const Record& r, const Frame& view, Counts* counts) {
  for (int y = r.y0; y < r.y1; ++y) {
    int64_t* const row = view.packed + (int64_t)y * view.view.width;
    for_each_fragment(r, y, [&](int x, float depth) {
      keep_nearest_atomically(row + x, pack_fragment(depth, r.triangle), counts);
      counts->add_fragments(1, x, y);
    });
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

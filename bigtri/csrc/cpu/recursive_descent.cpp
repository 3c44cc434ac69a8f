// The recursive_descent variant, Abrash's rasterizer for Larrabee: a record is cut into squares of 64, 16 and 4 px, each
// square rejected or accepted at two of its corners, and what is neither is cut further. What Larrabee's front end sorts
// into tiles first is drawn at once here, by the task that has set the triangle up, with an atomic minimum a pixel. The
// binding calls draw() through the registry.

#include <algorithm>
#include <vector>

#include "../core/resolve.h"
#include "kernels.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr Parameter kParameters[] = {
    {"share", "triangles", "triangles that a task takes at a time", 16, 1, 1 << 20},
    {"early_z", "", "1: a square behind a triangle that covers all of it is left out, by the nearest vertex", 1, 0, 1},
    {"separate", "",
     "1: squares that no edge rejects are held against the bounding box too, which removes the false positives beyond "
     "acute corners",
     1, 0, 1},
    {}};
enum { kShare, kEarlyZ, kSeparate };

void draw(const CheckedFrame& frame, const Parallel& parallel, const int64_t* values) {
  const int64_t rows = (int64_t)frame.views * frame.view.height, width = frame.view.width;
  parallel(rows, [&](int64_t y) { std::fill_n(frame.packed + y * width, width, kBackground); });
  std::fill_n(frame.dropped, frame.views, 0);
  const int64_t share = values[kShare], shares = (frame.count + share - 1) / share;
  const int64_t bins = (int64_t)bin_columns(frame.view) * bin_rows(frame.view), middles = bins * kMiddles * kMiddles;
  std::vector<uint32_t> bin_far((size_t)(frame.views * bins), float_bits(kInfinity)),
      middle_far((size_t)(frame.views * middles), float_bits(kInfinity));
  const RecursiveDescentKernels& kernels = current_kernels().recursive_descent;
  parallel(frame.views * shares, [&](int64_t task) {
    const int64_t number = task / shares;
    const Frame view = view_of(frame, number);
    const Range range = range_of(view, 0);
    const int64_t begin = range.first + task % shares * share, end = std::min(begin + share, range.end);
    const DescentTarget target = {view.packed,
                                  view.view.width,
                                  bin_columns(view.view),
                                  bin_far.data() + number * bins,
                                  middle_far.data() + number * middles,
                                  values[kEarlyZ] != 0,
                                  values[kSeparate] != 0};
    Counts counts;
    Parent parent;
    int64_t dropped = 0;
    for (int64_t t = begin; t < end; ++t) {
      dropped += expand_triangle(view, t, &parent) == Fate::kDropped;
      for (int s = 0; s < parent.count; ++s) {
        Record record;
        fill_record(parent.primitive[s], t, &record);
        kernels.descend(record, target, &counts);
      }
    }
    __atomic_fetch_add(view.dropped, dropped, __ATOMIC_RELAXED);
    counts.publish_task(frame.counters);
  });
  if (frame.depth)
    parallel(rows, [&](int64_t y) {
      std::transform(frame.packed + y * width, frame.packed + (y + 1) * width, frame.depth + y * width, depth_of);
    });
}

}  // namespace

extern const Variant recursive_descent_variant;
const Variant recursive_descent_variant = {"recursive_descent",
                                           "squares of 64, 16, 4 px, trivial reject and accept: Abrash 2009, Larrabee",
                                           kParameters, draw, /*shades=*/false};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

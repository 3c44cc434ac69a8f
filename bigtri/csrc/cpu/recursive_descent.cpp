// The recursive_descent variant, Abrash's rasterizer for Larrabee: a record is cut into squares of 64, 16 and 4 px, each
// square rejected or accepted at two of its corners, and what is neither is cut further. What Larrabee's front end sorts
// into tiles first is drawn at once here, by the task that has set the triangle up, with an atomic minimum a pixel. The
// binding calls draw() through the registry.

#include <vector>

#include "kernels.h"
#include "shares.h"

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

void draw(const ProjectedFrame& frame, const Parallel& parallel, const int64_t* values) {
  clear_image(frame, parallel);
  const int64_t bins = (int64_t)bin_columns(frame.view) * bin_rows(frame.view), middles = bins * kMiddles * kMiddles;
  std::vector<uint32_t> bin_far((size_t)(frame.views * bins), float_bits(kInfinity)),
      middle_far((size_t)(frame.views * middles), float_bits(kInfinity));
  const RecursiveDescentKernels& kernels = current_kernels().recursive_descent;
  parallel(shares_of(frame, values[kShare]), [&](int64_t i) {
    const Share share = share_of(frame, values[kShare], i);
    const DescentTarget target = {pixels_of(frame, share.view),
                                  frame.view.width,
                                  bin_columns(frame.view),
                                  bin_far.data() + share.view * bins,
                                  middle_far.data() + share.view * middles,
                                  values[kEarlyZ] != 0,
                                  values[kSeparate] != 0};
    Counts counts(frame.map);
    set_up(frame, share, [&](const Record& r) { kernels.descend(r, target, &counts); });
    counts.publish_task(frame.counters);
  });
  write_depth_image(frame, parallel);
}

}  // namespace

extern const Variant recursive_descent_variant;
const Variant recursive_descent_variant = {"recursive_descent",
                                           "squares of 64, 16, 4 px, trivial reject and accept: Abrash 2009, Larrabee",
                                           kParameters, draw_groups<draw>, /*shades=*/false};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// The batched variant, Splatshop's baseline: a block takes 32 triangles into its own memory, and for each of them its
// threads stride over the bounding box. It knows no bins and rejects nothing, so of a large triangle it tests every
// pixel of a box of which half or more is empty, and a huge one holds up its block. The binding calls draw() through the
// registry.

#include <vector>

#include "kernels.h"
#include "shares.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr Parameter kParameters[] = {{"batch", "triangles", "triangles that a task takes at a time", 32, 1, 1 << 20},
                                     {}};

void draw(const ProjectedFrame& frame, const Parallel& parallel, const int64_t* values) {
  clear_image(frame, parallel);
  const BatchedKernels& kernels = current_kernels().batched;
  parallel(shares_of(frame, values[0]), [&](int64_t i) {
    const Share share = share_of(frame, values[0], i);
    std::vector<Record> batch;
    set_up(frame, share, [&](const Record& r) { batch.push_back(r); });
    Counts counts(frame.map);
    for (const Record& r : batch) kernels.draw_box(r, pixels_of(frame, share.view), frame.view.width, &counts);
    counts.add(Counter::records, (int64_t)batch.size());
    counts.add(Counter::by_rows, (int64_t)batch.size());
    counts.publish_task(frame.counters);
  });
  write_depth_image(frame, parallel);
}

}  // namespace

extern const Variant batched_variant;
const Variant batched_variant = {"batched", "32 triangles a block, threads stride over the bounding box: Splatshop's",
                                 kParameters, draw_groups<draw>, /*shades=*/false};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// The two_stage variant: set-up lists the pairs of (record, bin) that no edge rejects, then tasks take pairs and draw
// the record's tiles in the bin, with an atomic minimum a pixel. The like of cuda/two_stage.cu, and the one schedule
// that every rung of the precision ladder has: it needs nothing of a rung but core/coverage.h and core/pixel_depth.h.
// The binding calls draw() through the registry.

#include <algorithm>
#include <vector>

#include "../core/coverage.h"
#include "kernels.h"
#include "shares.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr Parameter kParameters[] = {{"share", "triangles", "triangles that a task sets up", 256, 1, 1 << 20},
                                     {"pairs", "pairs", "pairs of (record, bin) that a task draws", 64, 1, 1 << 20},
                                     {}};
enum { kShare, kPairs };

struct Pair {
  int32_t record;  // of the share
  int16_t bin_x, bin_y;
};

// Consecutive pairs of a share.
struct Block {
  const Record* records;
  const Pair *begin, *end;
};

void list_pairs(const Record& r, int32_t record, std::vector<Pair>* pairs, Counts* counts) {
  const BinBox box = bin_box(r);
  const size_t before = pairs->size();
  for (int i = 0; i < box.count; ++i) {
    const int x = box.x + i % box.columns, y = box.y + i / box.columns;
    EdgesInBin edges;
    counts->add_edges(Counter::edges_64, 3, x * kBin, y * kBin, kBin);
    if (edges_in_bin(r, x, y, &edges)) pairs->push_back({record, (int16_t)x, (int16_t)y});
  }
  const int64_t kept = (int64_t)(pairs->size() - before);
  counts->add(Counter::candidates, box.count);
  counts->add(Counter::bins_tested, box.count);
  counts->add(Counter::bins_rejected, box.count - kept);
  counts->add(Counter::entries, kept);
  counts->add(Counter::bytes, kept * (int64_t)sizeof(Pair));
}

void draw(const ProjectedFrame& frame, const Parallel& parallel, const int64_t* values) {
  clear_image(frame, parallel);
  const size_t together = (size_t)values[kPairs];
  const TwoStageKernels& kernels = current_kernels().two_stage;
  each_round(frame, values[kShare], [&](Round& round) {
    std::vector<std::vector<Pair>> pairs((size_t)round.count);
    round.set_up(frame, parallel, [&](int64_t share, const Record* r, Counts* counts) {
      list_pairs(*r, (int32_t)(r - round.records[(size_t)share].data()), &pairs[(size_t)share], counts);
    });
    std::vector<Block> blocks;
    for (size_t share = 0; share < pairs.size(); ++share)
      for (size_t begin = 0; begin < pairs[share].size(); begin += together) {
        const Pair* first = pairs[share].data() + begin;
        blocks.push_back({round.records[share].data(), first, first + std::min(together, pairs[share].size() - begin)});
      }
    parallel((int64_t)blocks.size(), [&](int64_t i) {
      const Block& block = blocks[(size_t)i];
      Counts counts(frame.map);
      for (const Pair* p = block.begin; p < block.end; ++p) {
        const Record& r = block.records[p->record];
        kernels.draw_bin(r, p->bin_x, p->bin_y, pixels_of(frame, r.view), frame.view.width, &counts);
      }
      counts.publish_task(frame.counters);
    });
  });
  write_depth_image(frame, parallel);
}

}  // namespace

extern const Variant two_stage_variant;
const Variant two_stage_variant = {
    "two_stage",
    "one queue of (record, bin) pairs, first come first served: Kenzel et al. 2018, Liopas's first pipeline",
    kParameters, draw_groups<draw>, /*shades=*/false};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

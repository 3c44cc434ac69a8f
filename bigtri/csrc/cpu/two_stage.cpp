// The two_stage variant: set-up lists the pairs of (record, bin) that no edge rejects, then tasks take pairs and draw
// the record's tiles in the bin, with an atomic minimum a pixel. The like of cuda/two_stage.cu, and the one schedule
// that every rung of the precision ladder has: it needs nothing of a rung but core/coverage.h and core/pixel_depth.h.
// The binding calls draw() through the registry.

#include <algorithm>
#include <vector>

#include "../core/coverage.h"
#include "../core/resolve.h"
#include "counting.h"
#include "kernels.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr Parameter kParameters[] = {{"share", "triangles", "triangles that a task sets up", 256, 1, 1 << 20},
                                     {"pairs", "pairs", "pairs of (record, bin) that a task draws", 64, 1, 1 << 20},
                                     {}};
enum { kShare, kPairs };

// Shares whose records and pairs are held at once. They bound the memory.
constexpr int64_t kSharesTogether = 1024;

struct Pair {
  int32_t record;  // of the share
  int16_t bin_x, bin_y;
};

// What set-up made of some consecutive triangles of a view.
struct Share {
  std::vector<Record> records;
  std::vector<Pair> pairs;
};

// Consecutive pairs of a share.
struct Block {
  const Share* share;
  size_t begin, end;
};

void set_up_share(const Frame& view, int64_t view_index, int64_t begin, int64_t end, Share* share, Counts* counts) {
  Parent parent;
  int64_t dropped = 0, candidates = 0;
  for (int64_t t = begin; t < end; ++t) {
    dropped += expand_triangle(view, t, &parent) == Fate::kDropped;
    for (int s = 0; s < parent.count; ++s) {
      Record r;
      fill_record(parent.primitive[s], t, &r);
      r.view = (int32_t)view_index;
      const BinBox box = bin_box(r);
      candidates += box.count;
      for (int i = 0; i < box.count; ++i) {
        const int x = box.x + i % box.columns, y = box.y + i / box.columns;
        EdgesInBin edges;
        if (edges_in_bin(r, x, y, &edges))
          share->pairs.push_back({(int32_t)share->records.size(), (int16_t)x, (int16_t)y});
      }
      share->records.push_back(r);
    }
  }
  __atomic_fetch_add(view.dropped, dropped, __ATOMIC_RELAXED);
  counts->add(Counter::records, (int64_t)share->records.size());
  counts->add(Counter::by_tiles, (int64_t)share->records.size());
  counts->add(Counter::candidates, candidates);
  counts->add(Counter::bins_tested, candidates);
  counts->add(Counter::bins_rejected, candidates - (int64_t)share->pairs.size());
  counts->add(Counter::edges_64, 3 * candidates);
  counts->add(Counter::entries, (int64_t)share->pairs.size());
  counts->add(Counter::bytes, (int64_t)(share->records.size() * sizeof(Record) + share->pairs.size() * sizeof(Pair)));
}

void draw(const CheckedFrame& frame, const Parallel& parallel, const int64_t* values) {
  const int64_t rows = (int64_t)frame.views * frame.view.height, width = frame.view.width;
  parallel(rows, [&](int64_t y) { std::fill_n(frame.packed + y * width, width, kBackground); });
  std::fill_n(frame.dropped, frame.views, 0);
  const int64_t size = values[kShare], shares = (frame.count + size - 1) / size, all = frame.views * shares;
  const size_t together = (size_t)values[kPairs];
  const TwoStageKernels& kernels = current_kernels().two_stage;
  for (int64_t first = 0; first < all; first += kSharesTogether) {
    std::vector<Share> set_up((size_t)std::min(kSharesTogether, all - first));
    parallel((int64_t)set_up.size(), [&](int64_t i) {
      const int64_t view_index = (first + i) / shares;
      const Frame view = view_of(frame, view_index);
      const Range range = range_of(view, 0);
      const int64_t begin = range.first + (first + i) % shares * size, end = std::min(begin + size, range.end);
      Counts counts;
      set_up_share(view, view_index, begin, end, &set_up[(size_t)i], &counts);
      counts.publish(frame.counters);
    });
    std::vector<Block> blocks;
    for (const Share& share : set_up)
      for (size_t begin = 0; begin < share.pairs.size(); begin += together)
        blocks.push_back({&share, begin, std::min(begin + together, share.pairs.size())});
    parallel((int64_t)blocks.size(), [&](int64_t i) {
      const Block& block = blocks[(size_t)i];
      Counts counts;
      for (size_t p = block.begin; p < block.end; ++p) {
        const Pair& pair = block.share->pairs[p];
        const Record& r = block.share->records[(size_t)pair.record];
        kernels.draw_bin(r, pair.bin_x, pair.bin_y, pixels_of(frame, r.view), frame.view.width, &counts);
      }
      counts.publish_task(frame.counters);
    });
  }
  if (frame.depth)
    parallel(rows, [&](int64_t y) {
      std::transform(frame.packed + y * width, frame.packed + (y + 1) * width, frame.depth + y * width, depth_of);
    });
}

}  // namespace

extern const Variant two_stage_variant;
const Variant two_stage_variant = {
    "two_stage",
    "one queue of (record, bin) pairs, first come first served: Kenzel et al. 2018, Liopas's first pipeline",
    kParameters, draw, /*shades=*/false};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// The coverage_masks variant: coarse to fine with masks of 64 bits, CudaRaster's idea in this project's own code. Set-up
// pushes records to the queues of bins. Tasks take bins, the longest queue first, so that none is left over at the end.
// Coarse: a mask of the bin's 8x8 tiles for each record, and a queue for each tile. Fine: a mask of the tile's 8x8 pixels
// for each record, whose set bits are spread over lanes, so that a lane is idle only at the end of a batch of records,
// however few pixels each covers.
//
// Bins have 64 px and not 128, so that the mask of a bin has 64 bits too and edge values fit int32. The binding calls
// draw() through the registry.

#include <algorithm>
#include <numeric>

#include "kernels.h"
#include "record_queue.h"
#include "shares.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr Parameter kParameters[] = {
    {"share", "triangles", "triangles that a task sets up", 256, 1, 1 << 20},
    {"room", "records", "records that the queue of a bin holds before it grows", 256, 1, 1 << 20},
    {}};
enum { kShare, kRoom };

constexpr int kTilesOfBin = kBin / kTile * (kBin / kTile);

// A task's memory: the queues of a bin's tiles.
struct BinTiles {
  std::vector<TileEntry> of[kTilesOfBin];
};

// The bins that have entries, the longest queue first.
std::vector<int64_t> longest_first(const BinQueues& bins) {
  std::vector<int64_t> order;
  for (int64_t bin = 0; bin < bins.count(); ++bin)
    if (bins[bin].size()) order.push_back(bin);
  std::sort(order.begin(), order.end(), [&](int64_t a, int64_t b) {
    return bins[a].size() != bins[b].size() ? bins[a].size() > bins[b].size() : a < b;
  });
  return order;
}

void draw_bin(const ProjectedFrame& frame, const BinQueues& bins, int64_t bin, BinTiles* tiles, Counts* counts) {
  const CoverageMasksKernels& kernels = current_kernels().coverage_masks;
  const BinQueues::Spot spot = bins.spot(bin);
  uint64_t some = 0;
  for (int64_t i = 0; i < bins[bin].size(); ++i) {
    const Record* r = bins[bin].at(i, bins.room());
    uint64_t touched, full;
    DepthNumber anchor;
    kernels.coarse(*r, spot.x / kBin, spot.y / kBin, &touched, &full, &anchor, counts);
    for (uint64_t rest = touched; rest; rest &= rest - 1) {
      const int tile = __builtin_ctzll(rest);
      tiles->of[tile].push_back({r, anchor, (bool)(full >> tile & 1)});
    }
    some |= touched;
    counts->add(Counter::entries, __builtin_popcountll(touched));
    counts->add(Counter::bytes, __builtin_popcountll(touched) * (int64_t)sizeof(TileEntry));
  }
  for (; some; some &= some - 1) {
    const int t = __builtin_ctzll(some);
    std::vector<TileEntry>& queue = tiles->of[t];
    const Square tile = square_of(frame, spot.view, spot.x + t % 8 * kTile, spot.y + t / 8 * kTile, kTile);
    int64_t pixels[kTile * kTile];
    load_square(tile, pixels);
    kernels.fine(queue.data(), (int64_t)queue.size(), tile.x, tile.y, pixels, counts);
    store_square(tile, pixels, counts);
    queue.clear();
  }
}

void draw(const ProjectedFrame& frame, const Parallel& parallel, const int64_t* values) {
  clear_image(frame, parallel);
  std::vector<BinTiles> memory((size_t)parallel.threads);
  each_round(frame, values[kShare], [&](Round& round) {
    BinQueues bins(frame, kBin, values[kRoom], round.first_view, round.views);
    round.set_up(frame, parallel, [&](int64_t, const Record* r, Counts* counts) { bins.push(r, counts); });
    const std::vector<int64_t> order = longest_first(bins);
    parallel.with_slots((int64_t)order.size(), [&](int64_t i, int64_t slot) {
      Counts counts(frame.map);
      draw_bin(frame, bins, order[(size_t)i], &memory[(size_t)slot], &counts);
      counts.publish_task(frame.counters);
    });
  });
  write_depth_image(frame, parallel);
}

}  // namespace

extern const Variant coverage_masks_variant;
const Variant coverage_masks_variant = {
    "coverage_masks",
    "coarse to fine, longest bins first, masks of 8x8 px, fragments spread over lanes: CudaRaster's idea", kParameters,
    draw_groups<draw>, /*shades=*/false};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

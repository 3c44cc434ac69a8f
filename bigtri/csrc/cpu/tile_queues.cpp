// The tile_queues variant: queues of bins, then of tiles, then pixels, Sui's second pipeline. Set-up pushes each record
// to the queue of every 128 px bin that no edge rejects. A task then owns a bin: it pushes the records of the bin's queue
// on to the queues of its 8 px tiles, and draws these one after the other, each into the tile's own pixels.
//
// The published design holds 1024 triangles a queue and loses what comes after. Here queues grow: `room` is what a bin's
// queue holds before it does. The binding calls draw() through the registry.

#include <vector>

#include "kernels.h"
#include "record_queue.h"
#include "shares.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr Parameter kParameters[] = {
    {"share", "triangles", "triangles that a task sets up", 256, 1, 1 << 20},
    {"room", "records", "records that the queue of a bin holds before it grows", 1024, 1, 1 << 20},
    {}};
enum { kShare, kRoom };

// A task's memory: the queues of a bin's tiles.
struct TileQueues {
  std::vector<TileEntry> of[kWideTiles * kWideTiles];
};

// Pushes the records of a bin's queue on to the queues of the tiles that they touch.
void push_to_tiles(const BinQueues& bins, int64_t bin, TileQueues* tiles, Counts* counts) {
  const TileQueuesKernels& kernels = current_kernels().tile_queues;
  const BinQueues::Spot spot = bins.spot(bin);
  for (int64_t i = 0; i < bins[bin].size(); ++i) {
    const Record* r = bins[bin].at(i, bins.room());
    WideMasks masks;
    DepthNumber anchors[4];
    kernels.find_tiles(*r, spot.x, spot.y, &masks, anchors, counts);
    for (int row = 0; row < kWideTiles; ++row)
      for (uint32_t rest = masks.touched[row]; rest; rest &= rest - 1) {
        const int column = __builtin_ctz(rest);
        tiles->of[row * kWideTiles + column].push_back(
            {r, anchors[row / 8 * 2 + column / 8], (bool)(masks.full[row] >> column & 1)});
        counts->add(Counter::entries, 1);
        counts->add(Counter::bytes, sizeof(TileEntry));
      }
  }
}

// Draws the queues of a bin's tiles, and empties them.
void draw_tiles(const ProjectedFrame& frame, const BinQueues::Spot& spot, TileQueues* tiles, Counts* counts) {
  for (int t = 0; t < kWideTiles * kWideTiles; ++t) {
    std::vector<TileEntry>& queue = tiles->of[t];
    if (queue.empty()) continue;
    const Square tile =
        square_of(frame, spot.view, spot.x + t % kWideTiles * kTile, spot.y + t / kWideTiles * kTile, kTile);
    int64_t pixels[kTile * kTile];
    load_square(tile, pixels);
    current_kernels().tile_queues.draw_queue(queue.data(), (int64_t)queue.size(), tile.x, tile.y, pixels, counts);
    store_square(tile, pixels, counts);
    queue.clear();
  }
}

void draw(const ProjectedFrame& frame, const Parallel& parallel, const int64_t* values) {
  clear_image(frame, parallel);
  std::vector<TileQueues> memory((size_t)parallel.threads);
  each_round(frame, values[kShare], [&](Round& round) {
    BinQueues bins(frame, kWideBin, values[kRoom], round.first_view, round.views);
    round.set_up(frame, parallel, [&](int64_t, const Record* r, Counts* counts) { bins.push(r, counts); });
    parallel.with_slots(bins.count(), [&](int64_t bin, int64_t slot) {
      Counts counts(frame.map);
      push_to_tiles(bins, bin, &memory[(size_t)slot], &counts);
      draw_tiles(frame, bins.spot(bin), &memory[(size_t)slot], &counts);
      counts.publish_task(frame.counters);
    });
  });
  write_depth_image(frame, parallel);
}

}  // namespace

extern const Variant tile_queues_variant;
const Variant tile_queues_variant = {"tile_queues",
                                     "queues of 128 px bins, then of 8 px tiles, then pixels: Sui's second pipeline",
                                     kParameters, draw_groups<draw>, /*shades=*/false};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

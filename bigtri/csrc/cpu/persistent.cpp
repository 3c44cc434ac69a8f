// The persistent variant, Liopas's second pipeline after Kenzel's: workers that stay until all is drawn, and queues
// between them. A worker takes a share of triangles, sets it up and pushes the records to the queues of bins. Where a
// queue has got so long that drawing pays, the worker makes the bin its own, draws what waits there into a patch in its
// own memory, and stores the patch. When nothing is left to be set up, the workers draw what still waits, first come,
// first served.
//
// Two workers never own one bin, so no atomic operation touches a pixel. The memory of the queues is what `bytes` counts
// (core/counters.h): records stay until their round ends. The binding calls draw() through the registry.

#include <memory>
#include <thread>

#include "kernels.h"
#include "record_queue.h"
#include "shares.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr Parameter kParameters[] = {
    {"share", "triangles", "triangles that a worker sets up at a time", 256, 1, 1 << 20},
    {"room", "records", "records that the queue of a bin holds before it grows", 256, 1, 1 << 20},
    {"batch", "records", "length of a queue at which its bin is drawn while others are still set up", 1024, 1, 1 << 30},
    {}};
enum { kShare, kRoom, kBatch };

struct Owned {
  std::atomic<bool> taken{false};
  // Of the owner alone.
  bool begun = false;  // whether the image has the bin's pixels
  int64_t drawn = 0;  // elements of the queue
};

// What the workers of a round have in common.
class Pool {
 public:
  Pool(const ProjectedFrame& frame, const int64_t* values, bool begun, Round* round)
      : frame_(frame),
        batch_(values[kBatch]),
        round_(round),
        bins_(frame, kBin, values[kRoom], round->first_view, round->views),
        owned_(new Owned[(size_t)bins_.count()]) {
    for (int64_t bin = 0; bin < bins_.count(); ++bin) owned_[(size_t)bin].begun = begun;
  }

  void work() {
    std::vector<int64_t> ready;
    for (int64_t i; (i = next_share_.fetch_add(1, std::memory_order_relaxed)) < round_->count;) {
      Counts counts(frame_.map);
      const auto push = [&](int64_t, const Record* r, Counts* c) {
        bins_.push(r, c, [&](int64_t bin, int64_t length) {
          if (length % batch_ == 0) ready.push_back(bin);
        });
      };
      round_->set_up_share(frame_, i, push, &counts);
      counts.publish(frame_.counters);
      for (const int64_t bin : ready) draw_ready(bin);
      ready.clear();
      finished_.fetch_add(1, std::memory_order_release);
    }
    // Only a worker that runs has a share that is not finished, so this ends however few workers the machine runs.
    while (finished_.load(std::memory_order_acquire) < round_->count) std::this_thread::yield();
    for (int64_t bin; (bin = next_bin_.fetch_add(1, std::memory_order_relaxed)) < bins_.count();) draw_rest(bin);
  }

 private:
  // If another worker owns the bin, that one draws it, or whoever draws the rest.
  void draw_ready(int64_t bin) {
    Owned& own = owned_[(size_t)bin];
    if (own.taken.exchange(true, std::memory_order_acquire)) return;
    if (own.drawn < bins_[bin].size()) draw_waiting(bin);
    own.taken.store(false, std::memory_order_release);
  }

  void draw_rest(int64_t bin) {
    Owned& own = owned_[(size_t)bin];
    if (own.drawn < bins_[bin].size()) {
      draw_waiting(bin);
    } else if (!own.begun) {
      const Square square = square_of_bin(bin);
      for (int j = 0; j < square.rows; ++j) std::fill_n(square.image + j * square.pitch, square.columns, kBackground);
    }
  }

  void draw_waiting(int64_t bin) {
    const PersistentKernels& kernels = current_kernels().persistent;
    Owned& own = owned_[(size_t)bin];
    const Square square = square_of_bin(bin);
    Counts counts(frame_.map);
    alignas(64) int64_t patch[kBin * kBin];
    if (own.begun)
      load_square(square, patch);
    else
      std::fill_n(patch, kBin * kBin, kBackground);
    // An element that is still being pushed, and those behind it, wait for the next time.
    while (own.drawn < bins_[bin].size()) {
      const Record* r = bins_[bin].at(own.drawn, bins_.room());
      if (!r) break;
      kernels.draw_into(*r, square.x / kBin, square.y / kBin, patch, &counts);
      ++own.drawn;
    }
    store_square(square, patch, &counts);
    own.begun = true;
    counts.publish_task(frame_.counters);
  }

  Square square_of_bin(int64_t bin) const {
    const BinQueues::Spot spot = bins_.spot(bin);
    return square_of(frame_, spot.view, spot.x, spot.y, kBin);
  }

  const ProjectedFrame& frame_;
  const int64_t batch_;
  Round* round_;
  BinQueues bins_;
  std::unique_ptr<Owned[]> owned_;
  std::atomic<int64_t> next_share_{0}, finished_{0}, next_bin_{0};
};

void draw(const ProjectedFrame& frame, const Parallel& parallel, const int64_t* values) {
  const bool clears = !has_whole_views(frame, values[kShare]);
  if (clears)
    clear_image(frame, parallel);
  else
    std::fill_n(frame.dropped, frame.views, 0);
  each_round(frame, values[kShare], [&](Round& round) {
    Pool pool(frame, values, clears, &round);
    parallel(parallel.threads, [&](int64_t) { pool.work(); });
  });
  write_depth_image(frame, parallel);
}

}  // namespace

extern const Variant persistent_variant;
const Variant persistent_variant = {
    "persistent",
    "workers that stay, a queue for each bin, owned bins: Liopas's second pipeline, after Kenzel et al. 2018",
    kParameters, draw_groups<draw>, /*shades=*/false};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

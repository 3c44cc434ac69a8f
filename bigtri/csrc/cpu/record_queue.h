// A queue of records of which nobody has to know the length beforehand. Many threads push to it at once, and its elements
// may be read meanwhile. No element is lost or moved: what finds the first segment full goes into a further one, twice as
// large each. Variants have one for each bin (BinQueues).
#pragma once

#include <algorithm>
#include <atomic>
#include <memory>
#include <vector>

#include "../core/record.h"
#include "backend.h"
#include "counting.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

class RecordQueue {
 public:
  RecordQueue() = default;
  RecordQueue(const RecordQueue&) = delete;
  RecordQueue& operator=(const RecordQueue&) = delete;
  ~RecordQueue() {
    for (std::atomic<Segment>& segment : segments_) delete[] segment.load(std::memory_order_relaxed);
  }

  // room: elements of the first segment, the same in every call. Returns the element's number.
  int64_t push(const Record* record, int64_t room) {
    const int64_t i = size_.fetch_add(1, std::memory_order_relaxed);
    const Place p = place_of(i, room);
    segment(p)[p.at].store(record, std::memory_order_release);
    return i;
  }

  // Elements that were or are being pushed.
  int64_t size() const { return size_.load(std::memory_order_acquire); }

  // Element i, or null while it is being pushed.
  const Record* at(int64_t i, int64_t room) const {
    const Place p = place_of(i, room);
    const Segment there = segments_[p.segment].load(std::memory_order_acquire);
    return there ? there[p.at].load(std::memory_order_acquire) : nullptr;
  }

 private:
  using Segment = std::atomic<const Record*>*;
  static constexpr int kSegments = 40;  // more than memory holds

  struct Place {
    int segment;
    int64_t at, size;  // in the segment; of the segment
  };
  // Segment 0 has the elements [0, room), segment s those in [room << (s - 1), room << s).
  static Place place_of(int64_t i, int64_t room) {
    if (i < room) return {0, i, room};
    const int s = 64 - __builtin_clzll((uint64_t)(i / room));
    return {s, i - (room << (s - 1)), room << (s - 1)};
  }

  // Whoever comes first allocates it; who comes at the same time throws the own one away.
  Segment segment(const Place& p) {
    Segment there = segments_[p.segment].load(std::memory_order_acquire);
    if (there) return there;
    std::unique_ptr<std::atomic<const Record*>[]> mine(new std::atomic<const Record*>[(size_t)p.size]());
    if (segments_[p.segment].compare_exchange_strong(there, mine.get(), std::memory_order_acq_rel))
      return mine.release();
    return there;
  }

  std::atomic<int64_t> size_{0};
  std::atomic<Segment> segments_[kSegments] = {};
};

// The queues of all bins of some views, squares of `size` px.
class BinQueues {
 public:
  BinQueues(const CheckedFrame& frame, int size, int64_t room, int64_t first_view, int64_t views)
      : size_(size),
        columns_((frame.view.width + size - 1) / size),
        rows_((frame.view.height + size - 1) / size),
        first_view_(first_view),
        room_(room),
        queues_((size_t)(views * columns_ * rows_)) {}

  int64_t count() const { return (int64_t)queues_.size(); }
  int64_t room() const { return room_; }
  const RecordQueue& operator[](int64_t bin) const { return queues_[(size_t)bin]; }

  // Where a bin lies: its view, and its first pixel.
  struct Spot {
    int64_t view;
    int x, y;
  };
  Spot spot(int64_t bin) const {
    const int64_t of_view = (int64_t)columns_ * rows_, in_view = bin % of_view;
    return {first_view_ + bin / of_view, (int)(in_view % columns_) * size_, (int)(in_view / columns_) * size_};
  }

  // Pushes a record to the queue of each bin that its bounding box touches and no edge rejects, and calls
  // pushed(bin, length) with the queue's new length. The test is in 64 bits: f over a bin may be any value.
  template <class Pushed>
  void push(const Record* r, Counts* counts, Pushed pushed) {
    for (int y = r->y0 / size_; y <= (r->y1 - 1) / size_; ++y)
      for (int x = r->x0 / size_; x <= (r->x1 - 1) / size_; ++x) {
        bool kept = true;
        for (int k = 0; k < 3; ++k) {
          const Edge e = edge_of(r->x, r->y, k);
          // Steps are below 2^24, so their sum times 127 needs 64 bits.
          const int64_t rise = (int64_t)(size_ - 1) * ((int64_t)max_of(-e.dy, 0) + max_of(e.dx, 0));
          kept &= edge_steps(e, x * size_, y * size_) + rise >= 0;
        }
        counts->add(Counter::candidates, 1);
        counts->add(Counter::bins_tested, 1);
        counts->add(Counter::bins_rejected, !kept);
        counts->add_edges(Counter::edges_64, 3, x * size_, y * size_, size_);
        if (!kept) continue;
        const int64_t bin = ((r->view - first_view_) * rows_ + y) * columns_ + x;
        const int64_t i = queues_[(size_t)bin].push(r, room_);
        counts->add(Counter::overflows, i >= room_);
        counts->add(Counter::entries, 1);
        counts->add(Counter::bytes, sizeof r);
        counts->add(Counter::atomics, 1);
        pushed(bin, i + 1);
      }
  }
  void push(const Record* r, Counts* counts) {
    push(r, counts, [](int64_t, int64_t) {});
  }

 private:
  int size_, columns_, rows_;
  int64_t first_view_, room_;
  std::vector<RecordQueue> queues_;
};

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

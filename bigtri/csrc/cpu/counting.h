// The counters of one thread's work (core/counters.h lists them). Variants add to them, and publish them once per task.
// Edge values and fragments are added with their place, for the map of the work. In builds without BIGTRI_COUNTING the
// struct is empty and costs nothing.
#pragma once

#include "../core/counters.h"
#include "../core/numerics.h"
#include "work_map.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

// A build that counts draws, and nothing else.
#if defined(BIGTRI_COUNTING)
constexpr bool kCounts = true;

struct Counts {
  int64_t value[kCounters] = {};
  WorkMap* map = nullptr;  // null: nobody asks where
  int left = 0, top = 0;  // px: what places are counted from

  Counts() = default;
  explicit Counts(WorkMap* map, int left = 0, int top = 0) : map(map), left(left), top(top) {}

  void add(Counter counter, int64_t n) { value[(int)counter] += n; }
  // Edge values, at the corners or pixels of a square of `size` px whose first pixel is (x, y), or of a vector of pixels
  // that begins there.
  void add_edges(Counter counter, int64_t n, int x, int y, int size = kTile) {
    add(counter, n);
    if (map) map->add_edges(n, left + x, top + y, size);
  }
  // The three at each pixel of a box.
  void add_edges_in(Counter counter, int x0, int y0, int x1, int y1) {
    for (int y = y0; y < y1; ++y)
      for (int x = x0, end; x < x1; x = end) {
        end = min_of(x / kTile * kTile + kTile, x1);
        add_edges(counter, 3 * (end - x), x, y);
      }
  }
  void add_fragments(int64_t n, int x, int y) {
    add(Counter::fragments, n);
    if (map && n) map->add_fragments(n, left + x, top + y);
  }
  // Those of the pixels of a block whose bits are set: bit columns * row + column. (x, y): its first pixel.
  void add_fragments_of(uint64_t covered, int columns, int x, int y) {
    for (; covered; covered &= covered - 1) {
      const int p = __builtin_ctzll(covered);
      add_fragments(1, x + p % columns, y + p / columns);
    }
  }
  // Adds to the frame's counters, if it has any. Any thread may call it.
  void publish(int64_t* counters) const {
    for (int i = 0; counters && i < kCounters; ++i) {
      if (!value[i]) continue;
      if (kCounterDepends[i] != Depends::kMost) {
        __atomic_fetch_add(counters + i, value[i], __ATOMIC_RELAXED);
        continue;
      }
      int64_t old = __atomic_load_n(counters + i, __ATOMIC_RELAXED);
      while (old < value[i] &&
             !__atomic_compare_exchange_n(counters + i, &old, value[i], true, __ATOMIC_RELAXED, __ATOMIC_RELAXED)) {
      }
    }
  }
  // The same for a task that draws: its load is what was counted since the struct was made.
  void publish_task(int64_t* counters) {
    const int64_t work = value[(int)Counter::edges_64] + value[(int)Counter::edges_32] + value[(int)Counter::fragments];
    add(Counter::tasks, work > 0);
    add(Counter::work, work);
    add(Counter::most_work, work);
    if (map && work > 0) map->add_task(work);
    publish(counters);
  }
};
#else
constexpr bool kCounts = false;

struct Counts {
  Counts() = default;
  explicit Counts(WorkMap*, int = 0, int = 0) {}

  void add(Counter, int64_t) {}
  void add_edges(Counter, int64_t, int, int, int = kTile) {}
  void add_edges_in(Counter, int, int, int, int) {}
  void add_fragments(int64_t, int, int) {}
  void add_fragments_of(uint64_t, int, int, int) {}
  void publish(int64_t*) const {}
  void publish_task(int64_t*) {}
};
#endif

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

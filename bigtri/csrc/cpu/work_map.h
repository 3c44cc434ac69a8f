// Where the work of a view is done, for pictures of it; bigtri/check/work_map.py asks for it. Only what counts fills it
// (counting.h).
#pragma once

#include "../core/frame.h"

namespace bigtri {

// The work of one view, added to memory of the caller's. It reaches as far as the view's bins do, since a variant may
// compute what lies beyond the image's edge.
struct WorkMap {
  int columns, rows;  // bins
  int64_t* fragments;  // [64 * rows, 64 * columns]: those offered to each pixel
  // [squares(columns, rows)]: edge values, by the square that they were computed for. First tiles of 8 px, row by row, then
  // squares twice as wide, and so on up to one that holds all bins.
  int64_t* edges;
  int64_t* tasks;  // [room]: edge values and fragments of each task that drew, in any order
  int64_t room;
  int64_t used;  // tasks that drew; those beyond the room are left out

  static int across(int bins, int size) { return (bins * kBin + size - 1) / size; }
  static int64_t squares(int columns, int rows) {
    int64_t all = 0, level = 0;
    for (int size = kTile; level != 1; size *= 2) all += level = (int64_t)across(columns, size) * across(rows, size);
    return all;
  }

  // A square of `size` px, a power of 2, whose first pixel is (x, y). One that is smaller than a tile counts as its tile,
  // and one beyond the bins as the last that is none.
  void add_edges(int64_t n, int x, int y, int size) {
    const int last_x = columns * kBin - 1, last_y = rows * kBin - 1;
    x = x < last_x ? x : last_x, y = y < last_y ? y : last_y;
    int64_t* level = edges;
    int s = kTile;
    for (; s < size && (across(columns, s) > 1 || across(rows, s) > 1); s *= 2)
      level += (int64_t)across(columns, s) * across(rows, s);
    __atomic_fetch_add(level + (int64_t)(y / s) * across(columns, s) + x / s, n, __ATOMIC_RELAXED);
  }

  void add_fragments(int64_t n, int x, int y) {
    __atomic_fetch_add(fragments + (int64_t)y * columns * kBin + x, n, __ATOMIC_RELAXED);
  }

  void add_task(int64_t work) {
    const int64_t i = __atomic_fetch_add(&used, 1, __ATOMIC_RELAXED);
    if (i < room) tasks[i] = work;
  }
};

}  // namespace bigtri

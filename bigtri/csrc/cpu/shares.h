// What variants share that draw to the whole image with many threads: background before, the depth image after, and
// between them shares of triangles, which tasks set up.
#pragma once

#include <algorithm>
#include <vector>

#include "counting.h"
#include "groups.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// Writes the background to every pixel, and 0 to dropped.
inline void clear_image(const CheckedFrame& frame, const Parallel& parallel) {
  const int64_t rows = (int64_t)frame.views * frame.view.height, width = frame.view.width;
  parallel(rows, [&](int64_t y) { std::fill_n(frame.packed + y * width, width, kBackground); });
  std::fill_n(frame.dropped, frame.views, 0);
}

// Writes the depth image from the finished visibility buffer, if it is asked for.
inline void write_depth_image(const CheckedFrame& frame, const Parallel& parallel) {
  const int64_t rows = (int64_t)frame.views * frame.view.height, width = frame.view.width;
  if (!frame.depth) return;
  parallel(rows, [&](int64_t y) {
    std::transform(frame.packed + y * width, frame.packed + (y + 1) * width, frame.depth + y * width, depth_of);
  });
}

// Consecutive triangles of a view.
struct Share {
  int64_t view, begin, end;
};

// Shares of all views, of `size` triangles each; the last ones of a view may have fewer, or none.
inline int64_t shares_of(const CheckedFrame& frame, int64_t size) {
  return frame.views * ((frame.count + size - 1) / size);
}
inline Share share_of(const CheckedFrame& frame, int64_t size, int64_t i) {
  const int64_t per_view = (frame.count + size - 1) / size, view = i / per_view;
  const Range range = range_of(frame, view);
  const int64_t begin = range.first + i % per_view * size;
  return {view, begin, std::min(begin + size, range.end)};
}

// Triangles that are set up at a time. The records of so many are in the core's cache when they are handed on.
constexpr int64_t kPiece = 32;

// Calls body(record) for each record of a share, in the order of triangles, and adds what is dropped.
template <class Body>
void set_up(const ProjectedFrame& frame, const Share& share, Body body) {
  const SetupJob job = setup_job(frame, share.view);
  Record records[kPiece * kMaxSubTriangles];
  int64_t dropped = 0;
  for (int64_t begin = share.begin; begin < share.end; begin += kPiece) {
    int64_t lost;
    const int64_t end = std::min(begin + kPiece, share.end);
    const int64_t count = current_kernels().setup.setup(job, begin, end, records, nullptr, &lost);
    for (int64_t i = 0; i < count; ++i) body(records[i]);
    dropped += lost;
  }
  __atomic_fetch_add(frame.dropped + share.view, dropped, __ATOMIC_RELAXED);
}

// Shares whose records and queues are held at once, which bounds the memory. They are whole views, unless one view has
// more shares than that.
constexpr int64_t kSharesTogether = 1024;

struct Round {
  int64_t size;  // triangles of a share
  int64_t first, count;  // shares
  int64_t first_view, views;
  std::vector<std::vector<Record>> records;  // by share

  // Sets all shares up, and then calls body(share, record, counts) for each record of a share, in the order of triangles.
  // Records stay where they are as long as the round lasts.
  template <class Body>
  void set_up(const ProjectedFrame& frame, const Parallel& parallel, Body body) {
    parallel(count, [&](int64_t i) {
      Counts counts(frame.map);
      set_up_share(frame, i, body, &counts);
      counts.publish(frame.counters);
    });
  }
  // The same of one of the round's shares.
  template <class Body>
  void set_up_share(const ProjectedFrame& frame, int64_t i, Body body, Counts* counts) {
    const Share share = share_of(frame, size, first + i);
    std::vector<Record>& own = records[(size_t)i];
    own.reserve((size_t)std::max<int64_t>(share.end - share.begin, 0));
    bigtri::set_up(frame, share, [&](const Record& r) { own.push_back(r); });
    for (const Record& r : own) body(i, &r, counts);
    counts->add(Counter::records, (int64_t)own.size());
    counts->add(Counter::by_tiles, (int64_t)own.size());
    counts->add(Counter::bytes, (int64_t)(own.size() * sizeof(Record)));
  }
};

// Shares of the round that begins with share `first`.
inline int64_t shares_of_round(const CheckedFrame& frame, int64_t size, int64_t first) {
  const int64_t per_view = (frame.count + size - 1) / size;
  if (per_view > kSharesTogether) return std::min(kSharesTogether, per_view - first % per_view);
  return std::min(kSharesTogether / per_view * per_view, shares_of(frame, size) - first);
}

// Whether each view has its triangles in one round, so that its pixels can be written once and without a clear.
inline bool has_whole_views(const CheckedFrame& frame, int64_t size) {
  return frame.count > 0 && (frame.count + size - 1) / size <= kSharesTogether;
}

// Calls body(round) for all shares of so many triangles, one round after the other.
template <class Body>
void each_round(const CheckedFrame& frame, int64_t size, Body body) {
  const int64_t all = shares_of(frame, size);
  for (int64_t first = 0, count; first < all; first += count) {
    count = shares_of_round(frame, size, first);
    const int64_t first_view = share_of(frame, size, first).view,
                  last_view = share_of(frame, size, first + count - 1).view;
    Round round = {size, first, count, first_view, last_view - first_view + 1, {}};
    round.records.resize((size_t)count);
    body(round);
  }
}

// A square of `size` px of a view, cut to the image; its pixels lie in memory of the thread's own, row by row.
struct Square {
  int x, y, size, columns, rows;  // px; columns and rows within the image
  int64_t* image;  // its first pixel
  int64_t pitch;
};
inline Square square_of(const CheckedFrame& frame, int64_t view, int x, int y, int size) {
  const Viewport& v = frame.view;
  return {x,
          y,
          size,
          std::min(size, v.width - x),
          std::min(size, v.height - y),
          pixels_of(frame, view) + (int64_t)y * v.width + x,
          v.width};
}
// Pixels beyond the image become background.
inline void load_square(const Square& s, int64_t* pixels) {
  for (int j = 0; j < s.size; ++j) {
    const int columns = j < s.rows ? s.columns : 0;
    std::copy_n(s.image + j * s.pitch, columns, pixels + j * s.size);
    std::fill_n(pixels + j * s.size + columns, s.size - columns, kBackground);
  }
}
inline void store_square(const Square& s, const int64_t* pixels, Counts* counts) {
  for (int j = 0; j < s.rows; ++j) std::copy_n(pixels + j * s.size, s.columns, s.image + j * s.pitch);
  counts->add(Counter::written, s.columns * s.rows);
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

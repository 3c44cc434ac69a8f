// Strides over a record's bounding box, for the variant batched: draw_box, called by batched.cpp. Eight lanes stand for
// the threads of a block: they take the pixels of the box row by row, eight at a time, whatever the triangle covers of
// them. Compiled once per instruction set.
#pragma once

#include "atomic.h"
#include "depth.inl"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// F: what holds an edge value at every pixel of the box, and up to 7 px beside it.
template <bool kThin, bool kFar, class F>
void stride(const Record& r, int64_t* pixels, int width, Counts* counts) {
  using Values = Lanes<F, 8>;
  const int left = r.x0 / 8 * 8;  // eight lanes then lie in one cell
  const int first_cell = r.x0 / kBin, cells = (r.x1 - 1) / kBin - first_cell + 1;
  CellDepth depth[kMaxSize / kBin];
  Values row[3];
  F sx[3], sy[3];
  for (int k = 0; k < 3; ++k) {
    const Edge e = edge_of(r.x, r.y, k);
    sx[k] = -e.dy;
    sy[k] = e.dx;
    row[k] = (F)edge_steps(e, left, r.y0) + lane_numbers<F>() * sx[k];
  }
  for (int y = r.y0; y < r.y1; ++y) {
    if (y == r.y0 || y % kBin == 0)
      for (int c = 0; c < cells; ++c) cell_depth(r, first_cell + c, y / kBin, &depth[c]);
    Values f[3] = {row[0], row[1], row[2]};
    for (int x = left; x < r.x1; x += 8) {
      const uint32_t in_box = (0xffu << max_of(r.x0 - x, 0)) & (0xffu >> max_of(x + 8 - r.x1, 0)) & 0xff;
      const uint32_t covered = ~sign_mask(f[0] | f[1] | f[2]) & in_box;
      if (covered) {
        const CellDepth& d = depth[x / kBin - first_cell];
        int64_t packed[8];
        store(packed, packed_of<kFar>(d, row_depth<kThin>(d, x % kBin, y % kBin)));
        counts->add_fragments_of(covered, 8, x, y);
        for (uint32_t rest = covered; rest; rest &= rest - 1) {
          const int i = __builtin_ctz(rest);
          keep_nearest_atomically(pixels + (int64_t)y * width + x + i, packed[i], counts);
        }
      }
      for (int k = 0; k < 3; ++k) f[k] = f[k] + 8 * sx[k];
    }
    for (int k = 0; k < 3; ++k) row[k] = row[k] + sy[k];
  }
  counts->add_edges_in(sizeof(F) == 8 ? Counter::edges_64 : Counter::edges_32, r.x0, r.y0, r.x1, r.y1);
  counts->add(Counter::wide, sizeof(F) == 8);
}

template <class F>
BIGTRI_INLINE void stride_any(const Record& r, int64_t* pixels, int width, Counts* counts) {
  const bool far = r.flags & kRecordFar;
  if (is_thin(r))
    far ? stride<true, true, F>(r, pixels, width, counts) : stride<true, false, F>(r, pixels, width, counts);
  else
    far ? stride<false, true, F>(r, pixels, width, counts) : stride<false, false, F>(r, pixels, width, counts);
}

void draw_box(const Record& r, int64_t* pixels, int width, Counts* counts) {
  // Up to this extent edge values fit int32 as far as 8 px outside of the box (core/record.h).
  if (max_of(extent(r.x), extent(r.y)) <= kDirectExtent)
    stride_any<int32_t>(r, pixels, width, counts);
  else
    stride_any<int64_t>(r, pixels, width, counts);
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// Draws a record by recursive descent, for the variant recursive_descent: descend, called by recursive_descent.cpp.
// Compiled once per instruction set.
//
// A square is cut into 16: their corners' values are those of the square's first pixel plus a table. The corner where an
// edge is highest rejects, that where it is lowest accepts; one OR of three values and one sign mask answer for 16
// squares, and a bit scan finds those to go on with. Of 4x4 px the same sign mask is the coverage of the pixels.
#pragma once

#include "../core/pixel_depth.h"
#include "atomic.h"
#include "kernels.h"
#include "simd.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// A square's 4x4 parts: part 4 * row + column.
alignas(64) constexpr int32_t kPartX[16] = {0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3};
alignas(64) constexpr int32_t kPartY[16] = {0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3};
constexpr uint32_t kAllParts = 0xffff;

// An edge's tables: its value changes from a square's first pixel centre to that of each part by size * step, size being
// the part's; within a part it rises by up to (size - 1) * rise and falls by up to (size - 1) * fall.
struct EdgeTable {
  i32x16 step;
  int32_t rise, fall;
};

BIGTRI_INLINE void edge_table(int32_t sx, int32_t sy, EdgeTable* t) {
  t->step = load<i32x16>(kPartX) * sx + load<i32x16>(kPartY) * sy;
  t->rise = max_of(sx, 0) + max_of(sy, 0);
  t->fall = min_of(sx, 0) + min_of(sy, 0);
}

// Parts of 4x4 parts of `size` px, from (0, 0) on, that meet the pixels [x0, x1) x [y0, y1).
BIGTRI_INLINE uint32_t parts_in(int x0, int y0, int x1, int y1, int size) {
  x0 = max_of(x0, 0), y0 = max_of(y0, 0), x1 = min_of(x1, 4 * size), y1 = min_of(y1, 4 * size);
  if (x0 >= x1 || y0 >= y1) return 0;
  const uint32_t columns = (0xfu >> (3 - (x1 - 1) / size)) & (0xfu << x0 / size);
  const uint32_t rows = (0xffffu >> 4 * (3 - (y1 - 1) / size)) & (0xffffu << 4 * (y0 / size));
  return columns * 0x1111u & rows;
}

class Descent {
 public:
  Descent(const Record& r, const DescentTarget& target, Counts* counts) : r_(r), t_(target), counts_(counts) {}

  void draw() {
    const bool narrow = max_of(extent(r_.x), extent(r_.y)) <= kNarrowExtent;
    counts_->add(Counter::records, 1);
    // Squares of 4x4 px of the image that the bounding box begins and ends in.
    const int left = r_.x0 & -kBlock4, top = r_.y0 & -kBlock4;
    counts_->add_edges(Counter::edges_64, 3, left, top);  // the first ones
    if (narrow && max_of(r_.x1 - left, r_.y1 - top) <= kMiddle) {
      const bool tiny = max_of(r_.x1 - left, r_.y1 - top) <= kBlock4;
      counts_->add(tiny ? Counter::within_4 : Counter::within_16, 1);
      if (is_small_hidden()) return;
      NarrowEdge edge[3];
      for (int k = 0; k < 3; ++k) {
        const Edge e = edge_of(r_.x, r_.y, k);
        edge[k] = {(int32_t)edge_steps(e, left, top), -e.dy, e.dx};
        edge_table(edge[k].sx, edge[k].sy, &table_[k]);
      }
      const int32_t f[3] = {edge[0].f, edge[1].f, edge[2].f};
      tiny ? (void)draw_pixels(f, left, top) : (void)draw_blocks(f, left, top);
      return;
    }
    counts_->add(Counter::by_tiles, 1);
    counts_->add(Counter::wide, !narrow);
    narrow ? draw_bins<int32_t>() : draw_bins<int64_t>();
  }

 private:
  // --- Depth bounds

  static float bound(const uint32_t* far) { return bits_float(__atomic_load_n(far, __ATOMIC_RELAXED)); }
  uint32_t* bin_far(int x, int y) const { return t_.bin_far + (int64_t)(y / kBin) * t_.bins_x + x / kBin; }
  uint32_t* middle_far(int x, int y) const {
    return t_.middle_far + (int64_t)(y / kMiddle) * (t_.bins_x * kMiddles) + x / kMiddle;
  }
  // Whether all of the record is behind a bound, by its nearest vertex. Equal depth may win by its triangle index.
  bool is_behind(const uint32_t* far) const { return t_.early_z && r_.zmin > bound(far); }

  // The record covers all of a square: what is behind its farthest vertex cannot be seen there. Other threads may read the
  // bound before the record is drawn; it will be, and the order in which pixels get their minimum does not matter. A far
  // record gives none, since its fragments beyond 1 are dropped.
  void give_bound(uint32_t* far) {
    if (!t_.early_z || (r_.flags & kRecordFar)) return;
    uint32_t old = __atomic_load_n(far, __ATOMIC_RELAXED);
    const uint32_t mine = float_bits(r_.zmax + 0.0f);  // of floats >= +0 the bits ascend with them
    while (mine < old) {
      counts_->add(Counter::atomics, 1);
      if (__atomic_compare_exchange_n(far, &old, mine, false, __ATOMIC_RELAXED, __ATOMIC_RELAXED)) return;
    }
  }

  // Of a record of at most 16x16 px: the squares that it may lie in are those of its box's corners.
  bool is_small_hidden() {
    const int x[2] = {r_.x0, r_.x1 - 1}, y[2] = {r_.y0, r_.y1 - 1};
    for (int i = 0; i < 4; ++i)
      if (!is_behind(bin_far(x[i & 1], y[i >> 1])) && !is_behind(middle_far(x[i & 1], y[i >> 1]))) return false;
    counts_->add(Counter::tiles_hidden, 1);
    return true;
  }

  // --- The descent. f: values at a square's first pixel (x, y). They return whether a pixel of it is covered.

  // F: what holds an edge value anywhere in the bins that the record meets.
  template <class F>
  void draw_bins() {
    const int x0 = r_.x0 / kBin, x1 = (r_.x1 - 1) / kBin, y0 = r_.y0 / kBin, y1 = (r_.y1 - 1) / kBin;
    F first[3], rise[3], fall[3];
    int32_t sx[3], sy[3];
    for (int k = 0; k < 3; ++k) {
      const Edge e = edge_of(r_.x, r_.y, k);
      sx[k] = -e.dy;
      sy[k] = e.dx;
      first[k] = (F)edge_steps(e, x0 * kBin, y0 * kBin);
      rise[k] = (F)(kBin - 1) * (max_of(sx[k], 0) + max_of(sy[k], 0));
      fall[k] = (F)(kBin - 1) * (min_of(sx[k], 0) + min_of(sy[k], 0));
      edge_table(sx[k], sy[k], &table_[k]);
    }
    constexpr Counter kEdges = sizeof(F) == 8 ? Counter::edges_64 : Counter::edges_32;
    for (int y = y0; y <= y1; ++y)
      for (int x = x0; x <= x1; ++x) {
        F f[3];
        for (int k = 0; k < 3; ++k) f[k] = first[k] + (F)(y - y0) * kBin * sy[k] + (F)(x - x0) * kBin * sx[k];
        const bool kept = ((f[0] + rise[0]) | (f[1] + rise[1]) | (f[2] + rise[2])) >= 0;
        counts_->add(Counter::candidates, 1);
        counts_->add(Counter::bins_tested, 1);
        counts_->add(Counter::bins_rejected, !kept);
        counts_->add_edges(kEdges, kept ? 6 : 3, x * kBin, y * kBin, kBin);
        if (!kept) continue;
        const bool full = ((f[0] + fall[0]) | (f[1] + fall[1]) | (f[2] + fall[2])) >= 0;
        counts_->add(Counter::bins_accepted, full);
        if (is_behind(bin_far(x * kBin, y * kBin))) {
          counts_->add(Counter::bins_hidden, 1);
          continue;
        }
        if (full) {
          give_bound(bin_far(x * kBin, y * kBin));
          fill(x * kBin, y * kBin, kBin);
          continue;
        }
        int32_t in_bin[3];
        for (int k = 0; k < 3; ++k) {
          // In 32 bits an edge that has all of the bin inside is constant, as in narrow() of core/binning.h.
          const bool inside = sizeof(F) == 8 && f[k] + fall[k] >= 0;
          in_bin[k] = inside ? 0 : (int32_t)f[k];
          if (sizeof(F) == 8) edge_table(inside ? 0 : sx[k], inside ? 0 : sy[k], &table_[k]);
        }
        if (!draw_middles(in_bin, x * kBin, y * kBin)) counts_->add(Counter::bins_empty, 1);
      }
  }

  // What becomes of 16 parts of a square.
  struct Parts {
    uint32_t partly, full;
  };
  Parts test(const int32_t f[3], int x, int y, int size) {
    i32x16 high[3], low[3];
    for (int k = 0; k < 3; ++k) {
      const i32x16 at = f[k] + table_[k].step * size;
      high[k] = at + (size - 1) * table_[k].rise;
      low[k] = at + (size - 1) * table_[k].fall;
    }
    uint32_t kept = sign_mask(high[0] | high[1] | high[2]) ^ kAllParts;
    const uint32_t full = sign_mask(low[0] | low[1] | low[2]) ^ kAllParts;
    for (int part = 0; kCounts && part < 16; ++part)
      counts_->add_edges(Counter::edges_32, 6, x + part % 4 * size, y + part / 4 * size, size);
    counts_->add(Counter::tiles_tested, 16);
    counts_->add(Counter::tiles_rejected, 16 - __builtin_popcount(kept));
    counts_->add(Counter::tiles_accepted, __builtin_popcount(full));
    if (t_.separates) {
      const uint32_t boxed = parts_in(r_.x0 - x, r_.y0 - y, r_.x1 - x, r_.y1 - y, size);
      counts_->add(Counter::separations, __builtin_popcount(kept));
      counts_->add(Counter::tiles_separated, __builtin_popcount(kept & ~boxed));
      kept &= boxed;
    }
    return {kept & ~full, kept & full};
  }

  // A bin's 16 squares of 16x16 px.
  bool draw_middles(const int32_t f[3], int x, int y) {
    const Parts parts = test(f, x, y, kMiddle);
    bool any = false;
    for (uint32_t rest = parts.partly | parts.full; rest; rest &= rest - 1) {
      const int part = __builtin_ctz(rest), left = x + part % 4 * kMiddle, top = y + part / 4 * kMiddle;
      if (is_behind(middle_far(left, top))) {
        counts_->add(Counter::tiles_hidden, 1);
        any = true;  // nobody knows
        continue;
      }
      if (parts.full >> part & 1) {
        give_bound(middle_far(left, top));
        any |= fill(left, top, kMiddle);
        continue;
      }
      int32_t at[3];
      for (int k = 0; k < 3; ++k) at[k] = f[k] + kMiddle * table_[k].step[part];
      any |= draw_blocks(at, left, top);
    }
    return any;
  }

  // 16 blocks of 4x4 px.
  bool draw_blocks(const int32_t f[3], int x, int y) {
    const Parts parts = test(f, x, y, kBlock4);
    bool any = false;
    for (uint32_t rest = parts.partly | parts.full; rest; rest &= rest - 1) {
      const int part = __builtin_ctz(rest), left = x + part % 4 * kBlock4, top = y + part / 4 * kBlock4;
      if (parts.full >> part & 1) {
        any |= fill(left, top, kBlock4);
        continue;
      }
      int32_t at[3];
      for (int k = 0; k < 3; ++k) at[k] = f[k] + kBlock4 * table_[k].step[part];
      any |= draw_pixels(at, left, top);
    }
    if (!any) counts_->add(Counter::tiles_empty, 1);
    return any;
  }

  // The 16 pixels of a block.
  bool draw_pixels(const int32_t f[3], int x, int y) {
    const uint32_t outside = sign_mask((f[0] + table_[0].step) | (f[1] + table_[1].step) | (f[2] + table_[2].step));
    counts_->add_edges(Counter::edges_32, 3 * 16, x, y);
    const bool any = draw_block(x, y, outside ^ kAllParts);
    if (!any) counts_->add(Counter::tiles_empty, 1);
    return any;
  }

  // All pixels of a square of `size` px.
  bool fill(int x, int y, int size) {
    bool any = false;
    for (int j = y; j < min_of(y + size, r_.y1); j += kBlock4)
      for (int i = x; i < min_of(x + size, r_.x1); i += kBlock4) any |= draw_block(i, j, kAllParts);
    return any;
  }

  // --- Pixels

  // Those of a block that are covered, as far as the bounding box goes.
  bool draw_block(int x, int y, uint32_t covered) {
    covered &= parts_in(r_.x0 - x, r_.y0 - y, r_.x1 - x, r_.y1 - y, 1);
    if (!covered) return false;
    if (x / kBin * kBin != depth_.left || y / kBin * kBin != depth_.top) depth_ = depth_in_cell(r_, x / kBin, y / kBin);
    is_thin(r_) ? offer<true>(x, y, covered) : offer<false>(x, y, covered);
    counts_->add_fragments_of(covered, 4, x, y);
    return true;
  }

  template <bool kThin>
  void offer(int x, int y, uint32_t covered) {
    const int i = x - depth_.left, j = y - depth_.top;
    float z[16];
    for (int p = 0; p < 16; ++p) z[p] = pixel_depth<kThin>(depth_, i + p % 4, j + p / 4);
    int64_t* first = t_.pixels + (int64_t)y * t_.width + x;
    for (; covered; covered &= covered - 1) {
      const int p = __builtin_ctz(covered);
      keep_nearest_atomically(first + (int64_t)(p / 4) * t_.width + p % 4, pack_fragment(z[p], r_.triangle), counts_);
    }
  }

  const Record& r_;
  const DescentTarget& t_;
  Counts* counts_;
  EdgeTable table_[3];  // of the record; of a bin, where an edge has all of it inside
  DepthInCell depth_ = {nullptr, -1, -1, 0, 0, 0};  // of the cell that was drawn to last
};

void descend(const Record& r, const DescentTarget& target, Counts* counts) { Descent(r, target, counts).draw(); }

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// Coverage by the rung's rule: which bins and tiles an edge rejects, and which pixels it has inside; docs/numerics.md 3
// to 5 and 14. The variant two_stage and the stages draw with it. The other variants draw with integers alone, for
// rungs that need no more. Mirrors bigtri/reference/coverage.py.
//
// By every rule an edge function is monotone along a row and along a column, rounded or not, so that its extremes over
// a rectangle lie at corners, as computed.
#pragma once

#include "setup.h"
#include "tile_mask.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

// An edge in float32, px. A pixel is inside where the value at its centre is at least `least`: 0, or the smallest
// positive number, which is the test > 0.
struct FloatEdge {
  float x, y, dx, dy, least;
  bool turned;  // whether the direction is against the edge's own
};

// Boxed is a Record or a Primitive.
template <class Boxed>
BIGTRI_HD FloatEdge float_edge(const Boxed& r, int k) {
  int p = k == 2 ? 0 : k + 1, q = p == 2 ? 0 : p + 1;
  float x[3], y[3];
  for (int i = 0; i < 3; ++i) {
    if constexpr (kUnsnapped)
      x[i] = r.px[i], y[i] = r.py[i];
    else  // exact
      x[i] = (float)r.x[i] / (float)kSubpixel, y[i] = (float)r.y[i] / (float)kSubpixel;
  }
  FloatEdge e;
  constexpr float kAboveZero = 1.401298464e-45f;
  e.least = Rung::kCoverage == CoverageRule::kFloat32Inclusive ? 0.0f
            : Rung::kCoverage == CoverageRule::kFloat32Strict  ? kAboveZero
            : edge_bias(edge_of(r.x, r.y, k)) == 0             ? 0.0f
                                                               : kAboveZero;
  e.turned = false;
  if (Rung::kCoverage == CoverageRule::kFloat32Canonical && (x[p] > x[q] || (x[p] == x[q] && y[p] > y[q]))) {
    e.turned = true;
    const int other = p;
    p = q;
    q = other;
  }
  e.x = x[p];
  e.y = y[p];
  e.dx = x[q] - x[p];
  e.dy = y[q] - y[p];
  return e;
}

// a * b - c, where a * b is not rounded.
BIGTRI_HD float fused(float a, float b, float c) {
#if defined(__CUDA_ARCH__)
  return __fmaf_rn(a, b, -c);
#else
  return __builtin_fmaf(a, b, -c);
#endif
}

// At the centre of pixel (x, y) of the image.
BIGTRI_HD float value_of(const FloatEdge& e, int x, int y) {
  const float right = ((float)x + 0.5f) - e.x, down = ((float)y + 0.5f) - e.y;
  const float second = e.dy * right;
  const float value = Rung::kCoverage == CoverageRule::kFloat32Fused ? fused(e.dx, down, second) : e.dx * down - second;
  return e.turned ? -value : value;
}
BIGTRI_HD bool is_inside(const FloatEdge& e, int x, int y) { return value_of(e, x, y) >= e.least; }

// Whether the value rises, or else falls or stays, to the right and downwards.
BIGTRI_HD bool rises_x(const FloatEdge& e) { return (e.dy < 0) != e.turned; }
BIGTRI_HD bool rises_y(const FloatEdge& e) { return (e.dx > 0) != e.turned; }

// Whether a pixel of the square of size x size px from pixel (x, y) on is inside; whether all of them are.
BIGTRI_HD bool is_any_inside(const FloatEdge& e, int x, int y, int size) {
  return is_inside(e, x + (rises_x(e) ? size - 1 : 0), y + (rises_y(e) ? size - 1 : 0));
}
BIGTRI_HD bool are_all_inside(const FloatEdge& e, int x, int y, int size) {
  return is_inside(e, x + (rises_x(e) ? 0 : size - 1), y + (rises_y(e) ? 0 : size - 1));
}

constexpr MaskRule kMaskRule = Rung::kMask;

// f of one edge inside a bin in int64, for rungs in which it does not fit int32, or that have it in int64 always.
struct WideEdge {
  int64_t f, sx, sy;
};

// An edge within a bin, as the rung has it: the functions below are written for each.
using EdgeInBin =
    std::conditional_t<kFloatCoverage, FloatEdge, std::conditional_t<Rung::kWideEdges, WideEdge, NarrowEdge>>;

// A bin: its first pixel, px. Columns i and rows j are counted from there.
struct Bin {
  int left, top;
};

// Edge k of a Record or Primitive within a bin. False if it has all of the bin's pixels outside.
template <class Boxed>
BIGTRI_HD bool enter_bin(const Boxed& r, int k, const Bin& bin, NarrowEdge* e) {
  const BinEdge b = bin_edge(edge_of(r.x, r.y, k), bin.left / kBin, bin.top / kBin);
  // A rung whose masks keep such a bin gets an edge that has all pixels outside, since f may not fit int32.
  *e = kMaskRule != MaskRule::kCorners && b.highest < 0 ? NarrowEdge{-1, 0, 0} : narrow(b);
  return b.highest >= 0;
}
template <class Boxed>
BIGTRI_HD bool enter_bin(const Boxed& r, int k, const Bin& bin, WideEdge* e) {
  const BinEdge b = bin_edge(edge_of(r.x, r.y, k), bin.left / kBin, bin.top / kBin);
  *e = {b.f, b.sx, b.sy};
  return b.highest >= 0;
}
template <class Boxed>
BIGTRI_HD bool enter_bin(const Boxed& r, int k, const Bin& bin, FloatEdge* e) {
  *e = float_edge(r, k);
  return is_any_inside(*e, bin.left, bin.top, kBin);
}

// Whether a pixel is inside. E is a NarrowEdge or a WideEdge.
template <class E>
BIGTRI_HD bool is_inside(const E& e, const Bin&, int i, int j) {
  return e.f + i * e.sx + j * e.sy >= 0;
}
BIGTRI_HD bool is_inside(const FloatEdge& e, const Bin& bin, int i, int j) {
  return is_inside(e, bin.left + i, bin.top + j);
}

// Whether a pixel of the tile in a column and row of tiles is inside the edge; whether all of them are.
template <class E>
BIGTRI_HD bool touches_tile(const E& e, const Bin&, int column, int row) {
  return tile_edge(e, column, row) + tile_highest(e) >= 0;
}
BIGTRI_HD bool touches_tile(const FloatEdge& e, const Bin& bin, int column, int row) {
  return is_any_inside(e, bin.left + column * kTile, bin.top + row * kTile, kTile);
}
template <class E>
BIGTRI_HD bool fills_tile(const E& e, const Bin&, int column, int row) {
  return tile_edge(e, column, row) + tile_lowest(e) >= 0;
}
BIGTRI_HD bool fills_tile(const FloatEdge& e, const Bin& bin, int column, int row) {
  return are_all_inside(e, bin.left + column * kTile, bin.top + row * kTile, kTile);
}

// Twice f at the middle of a square of size x size px whose first pixel is (i, j) of the bin, and twice how far f rises
// or falls from there to the square's border.
struct HalfTile {
  int64_t middle, reach;
};
BIGTRI_HD HalfTile half_tile(const WideEdge& e, int i, int j, int size) {
  return {2 * (e.f + i * e.sx + j * e.sy) + (size - 1) * (e.sx + e.sy),
          size * (max_of(e.sx, -e.sx) + max_of(e.sy, -e.sy))};
}

// All three edges of a record or primitive within a bin.
struct EdgesInBin {
  EdgeInBin edge[3];
  WideEdge whole[3];  // the same, for masks by half_tile alone
  Bin bin;
};

// False if the bin in this column and row is rejected.
template <class Boxed>
BIGTRI_HD bool edges_in_bin(const Boxed& r, int bin_x, int bin_y, EdgesInBin* e) {
  e->bin = {bin_x * kBin, bin_y * kBin};
  for (int k = 0; k < 3; ++k) {
    const bool kept = enter_bin(r, k, e->bin, &e->edge[k]);
    if (kMaskRule == MaskRule::kCorners && !kept) return false;
    if (kMaskRule == MaskRule::kHalfTile) {
      enter_bin(r, k, e->bin, &e->whole[k]);
      const HalfTile h = half_tile(e->whole[k], 0, 0, kBin);
      if (h.middle + h.reach < 0) return false;
    }
  }
  return true;
}

// Whether a pixel is inside all three. & instead of && avoids branches.
BIGTRI_HD bool is_inside(const EdgesInBin& e, int i, int j) {
  return is_inside(e.edge[0], e.bin, i, j) & is_inside(e.edge[1], e.bin, i, j) & is_inside(e.edge[2], e.bin, i, j);
}

// Whether a tile is to be looked at, and whether it is known that all of its pixels are inside.
BIGTRI_HD bool touches_tile(const EdgesInBin& e, int column, int row) {
  if (kMaskRule == MaskRule::kBounds || kMaskRule == MaskRule::kNone) return true;
  if (kMaskRule == MaskRule::kHalfTile) {
    bool any = true;
    for (int k = 0; k < 3; ++k) {
      const HalfTile h = half_tile(e.whole[k], column * kTile, row * kTile, kTile);
      any &= h.middle + h.reach >= 0;
    }
    return any;
  }
  return touches_tile(e.edge[0], e.bin, column, row) & touches_tile(e.edge[1], e.bin, column, row) &
         touches_tile(e.edge[2], e.bin, column, row);
}
BIGTRI_HD bool fills_tile(const EdgesInBin& e, int column, int row) {
  if (kMaskRule == MaskRule::kBounds || kMaskRule == MaskRule::kNone) return false;
  if (kMaskRule == MaskRule::kHalfTile) {
    bool all = true;
    for (int k = 0; k < 3; ++k) {
      const HalfTile h = half_tile(e.whole[k], column * kTile, row * kTile, kTile);
      all &= h.middle - h.reach >= 0;
    }
    return all;
  }
  return fills_tile(e.edge[0], e.bin, column, row) & fills_tile(e.edge[1], e.bin, column, row) &
         fills_tile(e.edge[2], e.bin, column, row);
}

// The tiles of a bin that are asked about, of those that the bbox of a Record or Primitive allows.
template <class Boxed>
BIGTRI_HD uint64_t allowed_tiles(const Boxed& r, const Bin& bin) {
  if (kMaskRule == MaskRule::kNone) return ~0ull;
  return bbox_tiles(r.x0 - bin.left, r.y0 - bin.top, r.x1 - bin.left, r.y1 - bin.top);
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// The bin-owned variant: one worker owns a 64x64 px bin at a time, keeps it in cache while every triangle of its list touches it, and writes each pixel to the frame once.
// No clear, no atomics, no order. Hidden surfaces are rejected without sorting: what covers a bin (or a tile) completely bounds the depth behind which nothing can be seen,
// and the bounds are gathered before anything is drawn. Compiled once per instruction set.

#include "kernels.h"
#include "simd.h"

namespace bigtri {
namespace {

constexpr float kInfinity = __builtin_inff();

// ---------------------------------------------------------------- set-up

void project(const float* positions, int64_t begin, int64_t end, int width, int height, Vertex* out) {
  for (int64_t i = begin; i < end; ++i) out[i - begin] = project_vertex(positions + 4 * i, width, height);
}

uint32_t bins_of(const Record& r) { return (uint32_t)(((r.x1 - 1) / kBin - r.x0 / kBin + 1) * ((r.y1 - 1) / kBin - r.y0 / kBin + 1)); }

// The direct path keeps f in int32 without the bin test that makes this safe for others. For a triangle of extent D <= 2^18 subpx (1024 px) and samples up to
// 8 px beyond it, |e| <= 2 * D * (D + 2^11), so |f| < 2^30. A small bbox alone is not enough: the screen may have cut it from a huge triangle.
constexpr int64_t kDirectExtent = 1 << 18;

int64_t extent_of(const Primitive& p) {
  const int64_t w = (int64_t)max_of(max_of(p.x[0], p.x[1]), p.x[2]) - min_of(min_of(p.x[0], p.x[1]), p.x[2]);
  const int64_t h = (int64_t)max_of(max_of(p.y[0], p.y[1]), p.y[2]) - min_of(min_of(p.y[0], p.y[1]), p.y[2]);
  return max_of(w, h);
}

void fill_record(const Primitive& p, int64_t triangle, Record* r) {
  for (int k = 0; k < 3; ++k) {
    r->x[k] = p.x[k];
    r->y[k] = p.y[k];
    r->z[k] = p.z[k];
  }
  r->triangle = (uint32_t)triangle;
  r->area = p.area;
  const DepthGradient g = depth_gradient(p.x, p.y, p.z, p.area);
  r->dzdx = g.dzdx;
  r->dzdy = g.dzdy;
  r->zmin = min_of(min_of(p.z[0], p.z[1]), p.z[2]);
  r->zmax = max_of(max_of(p.z[0], p.z[1]), p.z[2]);
  r->x0 = p.x0;
  r->y0 = p.y0;
  r->x1 = p.x1;
  r->y1 = p.y1;
  const bool large = is_large(p.x0, p.y0, p.x1, p.y1, kLargeThreshold) || extent_of(p) > kDirectExtent;
  r->flags = (large ? kRecordLarge : 0) | (is_thin(p.x, p.y, p.area) ? kRecordThin : 0) | (r->zmax > 1.0f ? kRecordFar : 0);
}

int64_t setup(const SetupJob& job, int64_t begin, int64_t end, Record* records, uint32_t* candidates, int64_t* dropped) {
  int64_t n = 0, lost = 0;
  Primitive p;
  for (int64_t t = begin; t < end; ++t) {
    const int32_t* index = job.triangles + 3 * t;
    const Vertex *a = job.vertices + (index[0] - job.first_vertex), *b = job.vertices + (index[1] - job.first_vertex),
                 *c = job.vertices + (index[2] - job.first_vertex);
    const Fate fate = fate_of(a->flags, b->flags, c->flags);
    if (fate == Fate::kWhole) {
      const int32_t x[3] = {a->x, b->x, c->x}, y[3] = {a->y, b->y, c->y};
      const float z[3] = {a->z, b->z, c->z};
      if (!make_primitive(x, y, z, job.view, &p)) continue;
      fill_record(p, t, records + n);
      candidates[n] = bins_of(records[n]);
      ++n;
    } else if (fate == Fate::kClip) {
      float v[3][4];
      for (int k = 0; k < 3; ++k)
        for (int i = 0; i < 4; ++i) v[k][i] = job.positions[4 * (int64_t)index[k] + i];
      Fan fan;
      make_fan(v, (a->flags | b->flags | c->flags) & kOutsideMask, job.view.width, job.view.height, &fan);
      for (int s = 0; s + 2 < fan.count; ++s) {
        if (!fan_primitive(fan, s, job.view, &p)) continue;
        fill_record(p, t, records + n);
        candidates[n] = bins_of(records[n]);
        ++n;
      }
    } else if (fate == Fate::kDropped) {
      ++lost;
    }
  }
  *dropped = lost;
  return n;
}

// ---------------------------------------------------------------- binning

int64_t bin_records(const Record* records, const uint32_t* candidates, int64_t begin, int64_t end, int bins_x, BinPair* pairs, uint32_t* counts) {
  int64_t n = 0;
  for (int64_t i = begin; i < end; ++i) {
    if (!candidates[i]) continue;
    const Record& r = records[i];
    const int c0 = r.x0 / kBin, c1 = (r.x1 - 1) / kBin, r0 = r.y0 / kBin, r1 = (r.y1 - 1) / kBin;
    if (!(r.flags & kRecordLarge)) {
      for (int y = r0; y <= r1; ++y)
        for (int x = c0; x <= c1; ++x) {
          const uint32_t bin = (uint32_t)(y * bins_x + x);
          pairs[n++] = {bin, (uint32_t)i << kEntryShift | kEntrySmall};
          ++counts[bin];
        }
      continue;
    }
    // Extremes of each edge over the bins of a row are linear in the column: step them instead of multiplying anew.
    BinEdge corner[3];
    for (int k = 0; k < 3; ++k) corner[k] = bin_edge(edge_of(r.x, r.y, k), c0, r0);
    for (int y = r0; y <= r1; ++y) {
      int64_t high[3], low[3], step[3];
      for (int k = 0; k < 3; ++k) {
        high[k] = corner[k].highest + (y - r0) * kBin * corner[k].sy;
        low[k] = corner[k].lowest + (y - r0) * kBin * corner[k].sy;
        step[k] = kBin * corner[k].sx;
      }
      for (int x = c0; x <= c1; ++x) {
        if ((high[0] | high[1] | high[2]) >= 0) {  // sign bit clear in all three
          const uint32_t bin = (uint32_t)(y * bins_x + x), full = (low[0] | low[1] | low[2]) >= 0 ? kEntryFull : 0;
          pairs[n++] = {bin, (uint32_t)i << kEntryShift | full};
          ++counts[bin];
        }
        for (int k = 0; k < 3; ++k) {
          high[k] += step[k];
          low[k] += step[k];
        }
      }
    }
  }
  return n;
}

// ---------------------------------------------------------------- tile masks

struct TileMasks {
  uint64_t touched, full;
};

BIGTRI_INLINE i32x16 lanes(int32_t f, int32_t sx, int32_t sy) { return f + kLaneX * sx + kLaneY * sy; }

// Two rows of eight tiles at a time. A tile is dropped where one edge's maximum is negative: the sign bit of the three ORed.
BIGTRI_INLINE TileMasks tile_masks(const NarrowEdge e[3]) {
  i32x16 at[3];
  int32_t high[3], low[3];
  for (int k = 0; k < 3; ++k) {
    at[k] = lanes(e[k].f, kTile * e[k].sx, kTile * e[k].sy);
    high[k] = tile_highest(e[k]);
    low[k] = tile_lowest(e[k]);
  }
  TileMasks m = {0, 0};
  for (int pair = 0; pair < 4; ++pair) {
    m.touched |= (uint64_t)(sign_mask((at[0] + high[0]) | (at[1] + high[1]) | (at[2] + high[2])) ^ 0xffff) << (16 * pair);
    m.full |= (uint64_t)(sign_mask((at[0] + low[0]) | (at[1] + low[1]) | (at[2] + low[2])) ^ 0xffff) << (16 * pair);
    for (int k = 0; k < 3; ++k) at[k] += 2 * kTile * e[k].sy;
  }
  return m;
}

// The 64 pixels of one tile; offset[k] = lanes(0, sx, sy).
BIGTRI_INLINE uint64_t tile_coverage(const NarrowEdge e[3], const i32x16 offset[3], int column, int row) {
  i32x16 at[3];
  for (int k = 0; k < 3; ++k) at[k] = offset[k] + tile_edge(e[k], column, row);
  uint64_t mask = 0;
  for (int pair = 0; pair < 4; ++pair) {
    mask |= (uint64_t)(sign_mask(at[0] | at[1] | at[2]) ^ 0xffff) << (16 * pair);
    for (int k = 0; k < 3; ++k) at[k] += 2 * e[k].sy;
  }
  return mask;
}

// ---------------------------------------------------------------- depth of eight pixels of a row

// A record's depth within one cell (= one bin). Thin records carry their edges instead of a plane; all values are integers below 2^53, so stepping them in
// float64 is exact.
struct CellDepth {
  double zcell, dzdx, dzdy;
  double e[3], ex[3], ey[3], z[3], area;
  float zmin, zmax;
  uint32_t triangle;
  bool thin, far;
};

BIGTRI_INLINE void cell_depth(const Record& r, int bin_x, int bin_y, CellDepth* d) {
  d->zmin = r.zmin;
  d->zmax = r.zmax;
  d->triangle = r.triangle;
  d->thin = r.flags & kRecordThin;
  d->far = r.flags & kRecordFar;
  if (!d->thin) {
    d->dzdx = r.dzdx;
    d->dzdy = r.dzdy;
    d->zcell = depth_at(r.x, r.y, r.z, r.area, bin_x * kBin, bin_y * kBin);
    return;
  }
  d->area = (double)r.area;
  for (int k = 0; k < 3; ++k) {
    const Edge e = edge_of(r.x, r.y, k);
    d->e[k] = (double)edge_value(e, pixel_centre(bin_x * kBin), pixel_centre(bin_y * kBin));
    d->ex[k] = (double)(-kSubpixel * e.dy);
    d->ey[k] = (double)(kSubpixel * e.dx);
    d->z[k] = r.z[k];
  }
}

// The plane's terms for every row and column of the cell: a pixel is then one addition.
struct PlaneTable {
  double row[kBin];
  f64x8 column[kBin / 8];
};

BIGTRI_INLINE void plane_table(const CellDepth& d, PlaneTable* t) {
  for (int i = 0; i < kBin; i += 8) {
    const f64x8 at = kLane + (double)i;
    *(f64x8u*)(t->row + i) = plane_row(d.zcell, d.dzdy, at);
    t->column[i / 8] = plane_column(d.dzdx, at);
  }
}

// Depth of the pixels (i, j), i + 1, ... i + 7 of the cell, not yet rounded.
template <bool kThin>
BIGTRI_INLINE f64x8 row_depth(const CellDepth& d, int i, int j) {
  const f64x8 x = kLane + (double)i;
  if (!kThin) return plane_row<double>(d.zcell, d.dzdy, j) + plane_column(d.dzdx, x);
  const f64x8 g0 = (d.e[0] + d.ey[0] * j) + d.ex[0] * x, g1 = (d.e[1] + d.ey[1] * j) + d.ex[1] * x, g2 = (d.e[2] + d.ey[2] * j) + d.ex[2] * x;
  return weighted_depth<f64x8>(g0, g1, g2, d.z[0], d.z[1], d.z[2], d.area);
}

template <bool kFar>
BIGTRI_INLINE i64x8 packed_of(const CellDepth& d, f64x8 depth) {
  const f32x8 z = clamp_depth(to_float(depth), splat(d.zmin), splat(d.zmax));
  const i64x8 packed = pack(z, d.triangle);
  if (!kFar) return packed;
  return __builtin_convertvector(z > 1.0f, i64x8) ? (i64x8){} + kBackground : packed;
}

// ---------------------------------------------------------------- one bin

constexpr int kBlock = 96;  // large records drawn together: enough for their common depth bounds to hide most of them

struct Large {
  CellDepth depth;
  NarrowEdge edge[3];
  uint64_t touched, full;
  float nearest;  // over the bin
};

// Pixels of the bin, row by row; the small path reads and writes up to seven pixels past a row's end, which changes nothing there.
struct Scratch {
  alignas(64) int64_t pixels[kBin * kBin + 8];
  float tile_far[64];  // behind this depth nothing of the tile can be seen
  Large block[kBlock];
};
static_assert(sizeof(Scratch) <= kScratchBytes, "scratch");

// The nearest (farthest) depth over the px square of the given size at (i, j): at a corner, with the pixels' own arithmetic, so exact.
BIGTRI_INLINE float corner_depth(const CellDepth& d, int i, int j, int last, bool farthest) {
  const int x = (d.dzdx < 0) != farthest ? i + last : i, y = (d.dzdy < 0) != farthest ? j + last : j;
  return finish_depth(plane_row<double>(d.zcell, d.dzdy, y) + plane_column<double>(d.dzdx, x), d.zmin, d.zmax);
}

BIGTRI_INLINE float nearest_depth(const CellDepth& d, int i, int j, int size) { return d.thin ? d.zmin : corner_depth(d, i, j, size - 1, false); }
BIGTRI_INLINE float farthest_depth(const CellDepth& d, int i, int j, int size) { return d.thin ? d.zmax : corner_depth(d, i, j, size - 1, true); }

// Corner depths of the eight tiles of a row.
BIGTRI_INLINE f32x8 tile_corner_depths(const CellDepth& d, int row, bool farthest) {
  if (d.thin) return splat(farthest ? d.zmax : d.zmin);
  const int x = (d.dzdx < 0) != farthest ? kTile - 1 : 0, y = (d.dzdy < 0) != farthest ? kTile - 1 : 0;
  const f64x8 z = plane_row<double>(d.zcell, d.dzdy, kTile * row + y) + plane_column(d.dzdx, kLane * (double)kTile + (double)x);
  return clamp_depth(to_float(z), splat(d.zmin), splat(d.zmax));
}

// Eight pixels of the cell, from the table or (thin) from the edges.
template <bool kThin, bool kFar>
BIGTRI_INLINE i64x8 row_packed(const CellDepth& d, const PlaneTable& t, int x, int y) {
  return packed_of<kFar>(d, kThin ? row_depth<true>(d, x, y) : t.row[y] + t.column[x / 8]);
}

template <bool kThin, bool kFar>
BIGTRI_INLINE void draw_tiles(const Large& l, uint64_t visible, int64_t* pixels) {
  const CellDepth d = l.depth;  // a copy, so that stores to pixels cannot change it
  PlaneTable table;
  if (!kThin) plane_table(d, &table);
  for (uint64_t full = visible & l.full; full; full &= full - 1) {
    const int t = __builtin_ctzll(full), x = t % 8 * kTile, y = t / 8 * kTile;
    for (int j = 0; j < kTile; ++j) keep_nearest(pixels + (y + j) * kBin + x, row_packed<kThin, kFar>(d, table, x, y + j));
  }
  visible &= ~l.full;
  if (!visible) return;
  // Rows of partly covered tiles: first a list of them, without branches that depend on the coverage, then one loop over it.
  const NarrowEdge edge[3] = {l.edge[0], l.edge[1], l.edge[2]};
  i32x16 offset[3];
  for (int k = 0; k < 3; ++k) offset[k] = lanes(0, edge[k].sx, edge[k].sy);
  const i32x8 below = {0, kBin, 2 * kBin, 3 * kBin, 4 * kBin, 5 * kBin, 6 * kBin, 7 * kBin};
  uint32_t rows[kBin * kBin / 8 + 8];
  int count = 0;
  for (; visible; visible &= visible - 1) {
    const int t = __builtin_ctzll(visible);
    count = append_rows(tile_coverage(edge, offset, t % 8, t / 8), below + (t / 8 * kTile * kBin + t % 8 * kTile), rows, count);
  }
  for (int i = 0; i < count; ++i) {
    const int at = (int)(rows[i] >> 8);
    keep_nearest(pixels + at, row_packed<kThin, kFar>(d, table, at % kBin, at / kBin), rows[i] & 0xff);
  }
}

BIGTRI_INLINE void draw_large(const Large& l, uint64_t visible, int64_t* pixels) {
  if (l.depth.thin) {
    if (l.depth.far)
      draw_tiles<true, true>(l, visible, pixels);
    else
      draw_tiles<true, false>(l, visible, pixels);
  } else if (l.depth.far) {
    draw_tiles<false, true>(l, visible, pixels);
  } else {
    draw_tiles<false, false>(l, visible, pixels);
  }
}

// Draws the block: first the depth bounds of every tile that some record covers completely, then what is not behind them.
void draw_block(Scratch* s, int count, float bin_far) {
  uint64_t bounded = 0;
  for (int i = 0; i < count; ++i) {
    Large& l = s->block[i];
    l.touched = l.nearest > bin_far ? 0 : l.touched;
    if (!l.touched || l.depth.far) continue;
    bounded |= l.full;
    for (uint64_t rest = l.full; rest;) {
      const int row = __builtin_ctzll(rest) / 8;
      const f32x8 z = tile_corner_depths(l.depth, row, true);
      for (int c = 0; c < 8; ++c)
        if (l.full >> (8 * row + c) & 1) s->tile_far[8 * row + c] = min_of(s->tile_far[8 * row + c], z[c]);
      rest &= ~(0xffull << (8 * row));
    }
  }
  for (int i = 0; i < count; ++i) {
    const Large& l = s->block[i];
    uint64_t visible = l.touched;
    for (uint64_t rest = visible & bounded; rest;) {
      const int row = __builtin_ctzll(rest) / 8;
      const f32x8 z = tile_corner_depths(l.depth, row, false);
      const f32x8 bound = *(const f32x8u*)(s->tile_far + 8 * row);
      const i32x8 hidden = z > bound;
      for (int c = 0; c < 8; ++c) visible &= ~((uint64_t)(hidden[c] & 1) << (8 * row + c));
      rest &= ~(0xffull << (8 * row));
    }
    if (visible) draw_large(l, visible, s->pixels);
  }
}

// A small record within the bin: rows of its bbox, eight pixels at a time, no tiles.
template <bool kThin, bool kFar>
BIGTRI_INLINE void draw_small(const Record& r, const CellDepth& d, int bin_x, int bin_y, int64_t* pixels) {
  const int left = bin_x * kBin, top = bin_y * kBin;
  const int x0 = max_of(r.x0 - left, 0), y0 = max_of(r.y0 - top, 0), x1 = min_of(r.x1 - left, kBin), y1 = min_of(r.y1 - top, kBin);
  i32x8 row[3];
  int32_t sx[3], sy[3];
  const i32x8 lane = {0, 1, 2, 3, 4, 5, 6, 7};
  for (int k = 0; k < 3; ++k) {
    const Edge e = edge_of(r.x, r.y, k);
    sx[k] = (int32_t)-e.dy;
    sy[k] = (int32_t)e.dx;
    row[k] = (int32_t)edge_steps(e, left + x0, top + y0) + lane * sx[k];
  }
  for (int y = y0; y < y1; ++y) {
    for (int x = x0; x < x1; x += 8) {
      const int32_t skip = x - x0;
      const i32x8 outside = (row[0] + skip * sx[0]) | (row[1] + skip * sx[1]) | (row[2] + skip * sx[2]) | (x1 - x - 1 - lane);
      const uint32_t bits = sign_mask(outside) ^ 0xff;
      if (bits) keep_nearest(pixels + y * kBin + x, packed_of<kFar>(d, row_depth<kThin>(d, x, y)), bits);
    }
    for (int k = 0; k < 3; ++k) row[k] += sy[k];
  }
}

BIGTRI_INLINE void draw_small_record(const Record& r, int bin_x, int bin_y, int64_t* pixels) {
  CellDepth d;
  cell_depth(r, bin_x, bin_y, &d);
  if (d.thin) {
    if (d.far)
      draw_small<true, true>(r, d, bin_x, bin_y, pixels);
    else
      draw_small<true, false>(r, d, bin_x, bin_y, pixels);
  } else if (d.far) {
    draw_small<false, true>(r, d, bin_x, bin_y, pixels);
  } else {
    draw_small<false, false>(r, d, bin_x, bin_y, pixels);
  }
}

// ---------------------------------------------------------------- between the bin and the frame

// The bin's part of the image, px.
struct Patch {
  int x, y, width, height;
};

BIGTRI_INLINE Patch patch_of(const RasterJob& job, int bin_x, int bin_y) {
  const int x = bin_x * kBin, y = bin_y * kBin;
  return {x, y, min_of(kBin, job.view.width - x), min_of(kBin, job.view.height - y)};
}

void load_bin(const RasterJob& job, const Patch& p, int64_t* pixels) {
  for (int j = 0; j < p.height; ++j)
    __builtin_memcpy(pixels + j * kBin, job.packed + (int64_t)(p.y + j) * job.view.width + p.x, (size_t)p.width * sizeof(int64_t));
}

// Tiles and spans ignore the scissor inside a bin; what they drew outside it is taken back here, in the few bins that it crosses.
void apply_scissor(const Viewport& v, const Patch& p, int64_t* pixels) {
  if (v.x0 <= p.x && v.y0 <= p.y && v.x1 >= p.x + p.width && v.y1 >= p.y + p.height) return;
  for (int j = 0; j < p.height; ++j)
    for (int i = 0; i < p.width; ++i)
      if (p.x + i < v.x0 || p.x + i >= v.x1 || p.y + j < v.y0 || p.y + j >= v.y1) pixels[j * kBin + i] = kBackground;
}

// Row j of a patch: the pixels given, or background where there are none.
BIGTRI_INLINE void store_row(const RasterJob& job, const Patch& p, int j, const int64_t* row) {
  const i64x8 background = (i64x8){} + kBackground;
  const int64_t at = (int64_t)(p.y + j) * job.view.width + p.x;
  int64_t* to = job.packed + at;
  if (p.width == kBin && ((uintptr_t)to & 63) == 0)
    for (int i = 0; i < kBin; i += 8) stream(to + i, row ? *(const i64x8*)(row + i) : background);
  else
    for (int i = 0; i < p.width; ++i) to[i] = row ? row[i] : kBackground;
  if (!job.depth) return;
  float* depth = job.depth + at;
  for (int i = 0; i < p.width; i += 8) {
    const i32x8 bits = row ? __builtin_convertvector(*(const i64x8*)(row + i) >> 32, i32x8) : (i32x8){} + 0x7fffffff;
    const f32x8 z = (bits == 0x7fffffff) ? splat(kInfinity) : (f32x8)bits;
    const int n = p.width - i;
    if (n >= 8)
      *(f32x8u*)(depth + i) = z;
    else
      for (int k = 0; k < n; ++k) depth[i + k] = z[k];
  }
}

void store_bin(const RasterJob& job, const Patch& p, const int64_t* pixels) {
  for (int j = 0; j < p.height; ++j) store_row(job, p, j, pixels + j * kBin);
}

void store_background(const RasterJob& job, const Patch& p) {
  for (int j = 0; j < p.height; ++j) store_row(job, p, j, nullptr);
}

// Draws the list's records that are not behind everything; pixels holds what earlier passes left.
void draw_list(const RasterJob& job, const uint32_t* list, const uint32_t* end, int bin_x, int bin_y, Scratch* s) {
  // Whatever covers the whole bin hides all that begins behind its end.
  float bin_far = kInfinity;
  for (const uint32_t* e = list; e < end; ++e)
    if (*e & kEntryFull) {
      const Record& r = job.records[*e >> kEntryShift];
      if (!(r.flags & kRecordFar)) bin_far = min_of(bin_far, r.zmax);
    }
  for (int i = 0; i < 64; ++i) s->tile_far[i] = kInfinity;
  int count = 0;
  bool any_small = false;
  for (const uint32_t* e = list; e < end; ++e) {
    if (*e & kEntrySmall) {
      any_small = true;
      continue;
    }
    const Record& r = job.records[*e >> kEntryShift];
    if (r.zmin > bin_far) continue;
    Large& l = s->block[count];
    cell_depth(r, bin_x, bin_y, &l.depth);
    l.nearest = nearest_depth(l.depth, 0, 0, kBin);
    if (l.nearest > bin_far) continue;
    const bool full = *e & kEntryFull;
    if (full && !l.depth.far) bin_far = min_of(bin_far, farthest_depth(l.depth, 0, 0, kBin));
    for (int k = 0; k < 3; ++k) l.edge[k] = full ? NarrowEdge{0, 0, 0} : narrow(bin_edge(edge_of(r.x, r.y, k), bin_x, bin_y));
    const TileMasks m = full ? TileMasks{~0ull, ~0ull} : tile_masks(l.edge);
    l.touched = m.touched & bbox_tiles(r.x0 - bin_x * kBin, r.y0 - bin_y * kBin, r.x1 - bin_x * kBin, r.y1 - bin_y * kBin);
    l.full = m.full & l.touched;
    if (++count == kBlock) {
      draw_block(s, count, bin_far);
      count = 0;
    }
  }
  draw_block(s, count, bin_far);
  if (!any_small) return;
  for (const uint32_t* e = list; e < end; ++e) {
    const Record& r = job.records[*e >> kEntryShift];
    if ((*e & kEntrySmall) && !(r.zmin > bin_far)) draw_small_record(r, bin_x, bin_y, s->pixels);
  }
}

void raster_bin(const RasterJob& job, int bin, void* memory) {
  Scratch* s = (Scratch*)memory;
  const uint32_t *list = job.entries + job.list_begin[bin], *end = job.entries + job.list_begin[bin + 1];
  const int bin_x = bin % job.bins_x, bin_y = bin / job.bins_x;
  const Patch patch = patch_of(job, bin_x, bin_y);
  if (list == end) {
    if (job.first_pass) store_background(job, patch);
    return;
  }
  for (int i = 0; i < kBin * kBin; i += 8) *(i64x8*)(s->pixels + i) = (i64x8){} + kBackground;
  if (!job.first_pass) load_bin(job, patch, s->pixels);
  draw_list(job, list, end, bin_x, bin_y, s);
  apply_scissor(job.view, patch, s->pixels);
  store_bin(job, patch, s->pixels);
}

}  // namespace
}  // namespace bigtri

// Draws one bin of the bin_owned variant: raster_bins, called by bin_owned.cpp. Compiled once per instruction set.
//
// A worker owns a 64x64 px bin at a time. It keeps the bin's pixels in its cache, draws the entries of the bin list
// into them, and stores each pixel once per pass. So there is no clear and no atomic operation, and the order of
// entries is free.
//
// Hidden surfaces are rejected without sorting. A record that covers a bin (or a tile) completely gives a depth bound:
// nothing behind the record's farthest depth there can be seen. Only large records that are not far give bounds. Within
// a block of records, bounds are gathered before pixels are drawn; later blocks of the pass keep them.
//
// A bound is a depth that is stored at some pixel, or a vertex depth, which all stored depths are clamped to. So it holds
// for planes in float32 (the rung fast) as for those in float64: core/depth.h (corner_plane) has the proof, which asks
// only that every rounding is monotone. What does not depend on the plane, masks, full tiles and the direct path of
// small records, rests on integer coverage alone, which all rungs of this variant have.
//
// All tests against a bound are strict. A record is also tested against the bound that it gave itself, and one of
// constant depth equals it. Another record of the same depth may win by its lower triangle index.
#pragma once

#include "depth.inl"
#include "frame.inl"
#include "tile_mask.inl"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// Most large records of a block. The bounds of all are gathered before the first is drawn, and usually hide most of
// them.
constexpr int kBlock = 96;

// A large record within the bin.
struct Large {
  CellDepth depth;
  NarrowEdge edge[3];
  uint64_t touched, full;  // tiles, bit 8 * row + column
  float nearest;  // nearest window depth over the bin
};

// A worker's memory. pixels: packed values of the bin, row by row. The direct path of small records loads and stores
// eight pixels, so it reaches up to seven past the end of a row and writes them back unchanged. So the array has eight
// elements more.
struct Scratch {
  alignas(64) int64_t pixels[kBin * kBin + 8];
  float tile_far[64];  // depth bound of each tile, a window depth, from all blocks of the pass so far
  Large block[kBlock];
  Counts counts;
};
static_assert(sizeof(Scratch) <= kScratchBytes, "scratch");

// Offers a record's packed values to eight pixels of a row, or to those of them whose bits are set.
template <class... Bits>
BIGTRI_INLINE void offer(Scratch* s, int at, const i64x8& packed, Bits... bits) {
  if constexpr (kCounts) {
    for (int i = 0; i < 8; ++i) {
      const bool offered = ((bits >> i & 1) & ... & 1);
      s->counts.add_fragments(offered, (at + i) % kBin, (at + i) / kBin);
      s->counts.add(Counter::passed, offered && packed[i] < s->pixels[at + i]);
    }
  }
  keep_nearest(s->pixels + at, packed, bits...);
}

// Draws the visible tiles of a large record. Tiles that it fills need no coverage; the others are drawn by row.
template <bool kThin, bool kFar>
BIGTRI_INLINE void draw_tiles(const Large& l, uint64_t visible, Scratch* s) {
  const CellDepth d = l.depth;  // a copy: the compiler need not reload it after each store to pixels
  PlaneTable table;
  if (!kThin) plane_table(d, &table);
  for (uint64_t full = visible & l.full; full; full &= full - 1) {
    const int t = __builtin_ctzll(full), x = t % 8 * kTile, y = t / 8 * kTile;
    for (int j = 0; j < kTile; ++j) offer(s, (y + j) * kBin + x, row_packed<kThin, kFar>(d, table, x, y + j));
  }
  visible &= ~l.full;
  if (!visible) return;
  // Rows of partly covered tiles. The first loop lists them without a branch on the coverage, the second draws them. An
  // item is (index of the row's first pixel in the bin) << 8 | coverage of its eight pixels.
  const NarrowEdge edge[3] = {l.edge[0], l.edge[1], l.edge[2]};
  i32x16 offset[3];
  for (int k = 0; k < 3; ++k) offset[k] = lanes(0, edge[k].sx, edge[k].sy);
  uint32_t rows[kBin * kBin / 8 + 8];  // append_rows may write seven past the last
  int count = 0;
  for (; visible; visible &= visible - 1) {
    const int t = __builtin_ctzll(visible);
    const uint64_t covered = tile_coverage(edge, offset, t % 8, t / 8);
    s->counts.add_edges(Counter::edges_32, 3 * kTile * kTile, t % 8 * kTile, t / 8 * kTile);
    s->counts.add(Counter::tiles_empty, !covered);
    count = append_rows(covered, t / 8 * kTile * kBin + t % 8 * kTile, rows, count);
  }
  for (int i = 0; i < count; ++i) {
    const int at = (int)(rows[i] >> 8);
    offer(s, at, row_packed<kThin, kFar>(d, table, at % kBin, at / kBin), rows[i] & 0xff);
  }
}

// Chooses the depth arithmetic once per record.
BIGTRI_INLINE void draw_large(const Large& l, uint64_t visible, Scratch* s) {
  if (l.depth.thin) {
    if (l.depth.far)
      draw_tiles<true, true>(l, visible, s);
    else
      draw_tiles<true, false>(l, visible, s);
  } else if (l.depth.far) {
    draw_tiles<false, true>(l, visible, s);
  } else {
    draw_tiles<false, false>(l, visible, s);
  }
}

// Draws a block of large records. First it gathers the depth bound of every tile that a record of the block fills. Then
// it draws the tiles of each record that are behind neither bound, the bin's or the tile's. A far record gives no
// bound: fragments with z > 1 are dropped, so it may leave pixels open. bounded: the tiles that earlier blocks gave a
// bound. Returns them with the tiles of this block added.
uint64_t draw_block(Scratch* s, int count, float bin_far, uint64_t bounded) {
  for (int i = 0; i < count; ++i) {
    Large& l = s->block[i];
    // Records that were added to the block after this one may have brought bin_far nearer.
    if (kCounts && l.nearest > bin_far) s->counts.add(Counter::bins_hidden, 1);
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
      visible &= ~((uint64_t)greater_mask(z, load<f32x8>(s->tile_far + 8 * row)) << (8 * row));
      rest &= ~(0xffull << (8 * row));
    }
    s->counts.add(Counter::tiles_hidden, __builtin_popcountll(l.touched & ~visible));
    if (visible) draw_large(l, visible, s);
  }
  return bounded;
}

// Whether a small record is behind the depth bound of every tile that its bbox touches in this bin.
BIGTRI_INLINE bool is_hidden(const Record& r, int bin_x, int bin_y, const float* tile_far) {
  const int left = bin_x * kBin, top = bin_y * kBin;
  const int x0 = max_of(r.x0 - left, 0) / kTile, x1 = (min_of(r.x1 - left, kBin) - 1) / kTile;
  const int y0 = max_of(r.y0 - top, 0) / kTile, y1 = (min_of(r.y1 - top, kBin) - 1) / kTile;
  for (int y = y0; y <= y1; ++y)
    for (int x = x0; x <= x1; ++x)
      if (!(r.zmin > tile_far[8 * y + x])) return false;
  return true;
}

// The direct path: a small record within the bin, row by row of its bbox, eight pixels at a time. f fits int32 up to 8
// px outside the bbox, because a small record is at most kDirectExtent wide and high (core/record.h). It is the value at
// the cell's first pixel, in steps, and whole steps from there. cell: cell_edges.
template <bool kThin, bool kFar>
BIGTRI_INLINE void draw_small(const Record& r, const CellDepth& d, const int64_t cell[3], int bin_x, int bin_y,
                              Scratch* s) {
  const int left = bin_x * kBin, top = bin_y * kBin;
  const int x0 = max_of(r.x0 - left, 0), y0 = max_of(r.y0 - top, 0), x1 = min_of(r.x1 - left, kBin),
            y1 = min_of(r.y1 - top, kBin);
  i32x8 row[3];
  int32_t sx[3], sy[3];
  const i32x8 lane = load<i32x8>(kLaneInt);
  for (int k = 0; k < 3; ++k) {
    const Edge e = edge_of(r.x, r.y, k);
    sx[k] = -e.dy;
    sy[k] = e.dx;
    row[k] = (int32_t)(steps_of(cell[k], e) + (int64_t)sx[k] * x0 + (int64_t)sy[k] * y0) + lane * sx[k];
  }
  s->counts.add_edges(Counter::edges_64, 3, x0, y0);
  // A column of eight pixels' width. No branch on the coverage: it would be mispredicted more often than it saves work.
  const auto draw_column = [&](int x) __attribute__((always_inline)) {
    i32x8 f[3] = {row[0], row[1], row[2]};
    const i32x8 past = (x1 - x - 1) - lane;  // negative past the bbox
    for (int y = y0; y < y1; ++y) {
      const uint32_t bits = sign_mask(f[0] | f[1] | f[2] | past) ^ 0xff;
      s->counts.add_edges(Counter::edges_32, 3 * 8, x, y);
      offer(s, y * kBin + x, packed_of<kFar>(d, row_depth<kThin>(d, x, y)), bits);
      for (int k = 0; k < 3; ++k) f[k] = f[k] + sy[k];
    }
  };
  draw_column(x0);
  for (int x = x0 + 8; x < x1; x += 8) {
    for (int k = 0; k < 3; ++k) row[k] = row[k] + 8 * sx[k];
    draw_column(x);
  }
}

BIGTRI_INLINE void draw_small_record(const Record& r, int bin_x, int bin_y, Scratch* s) {
  int64_t cell[3];
  cell_edges(r, bin_x, bin_y, cell);
  CellDepth d;
  cell_depth(r, bin_x, bin_y, depth_from_edges(cell, r.z, r.area), &d);
  if (d.thin) {
    if (d.far)
      draw_small<true, true>(r, d, cell, bin_x, bin_y, s);
    else
      draw_small<true, false>(r, d, cell, bin_x, bin_y, s);
  } else if (d.far) {
    draw_small<false, true>(r, d, cell, bin_x, bin_y, s);
  } else {
    draw_small<false, false>(r, d, cell, bin_x, bin_y, s);
  }
}

// Fetches the record of a later entry into the cache, if that entry is of this kind: kEntrySmall, or 0 for a large
// record. The entries of a bin are records anywhere in a batch, which may be larger than a core's cache. Each record
// takes some 20 to 100 ns to draw, so four entries ahead is early enough.
BIGTRI_INLINE void fetch_later(const RasterJob& job, const uint32_t* e, const uint32_t* end, uint32_t kind) {
  constexpr int kAhead = 4;
  if (end - e <= kAhead || (e[kAhead] & kEntrySmall) != kind) return;
  const char* later = (const char*)(job.records + (e[kAhead] >> kEntryShift));
  __builtin_prefetch(later);
  __builtin_prefetch(later + 64);  // a record may lie in two lines
}

// Draws a bin list over the pixels, large records first. pixels: background, or the result of earlier passes.
void draw_list(const RasterJob& job, const uint32_t* list, const uint32_t* end, int bin_x, int bin_y, Scratch* s) {
  // bin_far: the bin's depth bound. A record that covers the whole bin hides all depths beyond its zmax. This loop
  // looks at vertex depths alone; the next one tightens the bound with the plane's farthest depth over the bin.
  float bin_far = kInfinity;
  for (const uint32_t* e = list; e < end; ++e)
    if (*e & kEntryFull) {
      const Record& r = job.records[*e >> kEntryShift];
      if (!(r.flags & kRecordFar)) bin_far = min_of(bin_far, r.zmax);
    }
  for (int i = 0; i < 64; ++i) s->tile_far[i] = kInfinity;
  int count = 0;
  uint64_t bounded = 0;
  bool any_small = false;
  for (const uint32_t* e = list; e < end; ++e) {
    fetch_later(job, e, end, 0);
    if (*e & kEntrySmall) {
      any_small = true;
      continue;
    }
    const Record& r = job.records[*e >> kEntryShift];
    if (r.zmin > bin_far) {
      s->counts.add(Counter::bins_hidden, 1);
      continue;
    }
    Large& l = s->block[count];
    cell_depth(r, bin_x, bin_y, &l.depth);
    l.nearest = nearest_depth(l.depth, 0, 0, kBin);
    if (l.nearest > bin_far) {
      s->counts.add(Counter::bins_hidden, 1);
      continue;
    }
    const bool full = *e & kEntryFull;
    if (full && !l.depth.far) bin_far = min_of(bin_far, farthest_depth(l.depth, 0, 0, kBin));
    for (int k = 0; k < 3; ++k)
      l.edge[k] = full ? NarrowEdge{0, 0, 0} : narrow(bin_edge(edge_of(r.x, r.y, k), bin_x, bin_y));
    const TileMasks m = full ? TileMasks{~0ull, ~0ull} : tile_masks(l.edge);
    const uint64_t box = bbox_tiles(r.x0 - bin_x * kBin, r.y0 - bin_y * kBin, r.x1 - bin_x * kBin, r.y1 - bin_y * kBin);
    l.touched = m.touched & box;
    l.full = m.full & l.touched;
    if (kCounts && !full) {
      s->counts.add_edges(Counter::edges_64, 6, 0, 0, kBin);
      s->counts.add_edges(Counter::edges_32, 6 * kTile * kTile, 0, 0, kBin);
      s->counts.add(Counter::tiles_tested, __builtin_popcountll(box));
      s->counts.add(Counter::tiles_rejected, __builtin_popcountll(box & ~l.touched));
      s->counts.add(Counter::tiles_accepted, __builtin_popcountll(l.full));
    }
    if (++count == kBlock) {
      bounded = draw_block(s, count, bin_far, bounded);
      count = 0;
    }
  }
  bounded = draw_block(s, count, bin_far, bounded);
  if (!any_small) return;
  for (const uint32_t* e = list; e < end; ++e) {
    const Record& r = job.records[*e >> kEntryShift];
    fetch_later(job, e, end, kEntrySmall);
    if (!(*e & kEntrySmall)) continue;
    if (r.zmin > bin_far || (bounded && is_hidden(r, bin_x, bin_y, s->tile_far))) {
      s->counts.add(Counter::bins_hidden, 1);
      continue;
    }
    draw_small_record(r, bin_x, bin_y, s);
  }
}

// Bins without entries are stored as background, or left as they are if an earlier pass stored them.
void raster_bins(const RasterJob& job, int64_t bin, int bins, void* memory, void* shade_memory) {
  Scratch* s = (Scratch*)memory;
  const uint32_t* begin = job.list_begin + (bin - job.first_bin);
  const uint32_t *list = job.entries + begin[0], *end = job.entries + begin[bins];
  const int64_t view = bin / job.bins;
  const int in_view = (int)(bin - view * job.bins), bin_x = in_view % job.bins_x, bin_y = in_view / job.bins_x;
  const Patch patch = patch_of(job, view, bin_x, bin_y, bins);
  const bool begun = view < job.begun_views, shades = job.shade && view < job.finished_views;
  if (list == end) {
    if (!begun) {
      store_background(job, patch);
      if (shades) job.shade->kernels->background(*job.shade, view, patch.x, patch.y, patch.width, patch.height);
    } else if (shades) {
      for (int x = 0; x < patch.width; x += kBin)
        job.shade->kernels->block(
            *job.shade,
            {view, patch.packed + x, job.view.width, patch.x + x, patch.y, min_of(kBin, patch.width - x), patch.height},
            shade_memory);
    }
    return;
  }
  for (int i = 0; i < kBin * kBin; i += 8) store(s->pixels + i, splat<i64x8>(kBackground));
  if (begun) load_bin(job, patch, s->pixels);
  s->counts = Counts(job.map, bin_x * kBin, bin_y * kBin);
  draw_list(job, list, end, bin_x, bin_y, s);
  apply_scissor(job.view, patch, s->pixels);
  store_bin(job, patch, s->pixels);
  s->counts.add(Counter::written, patch.width * patch.height);
  s->counts.publish_task(job.counters);
  if (shades)
    job.shade->kernels->block(*job.shade, {view, s->pixels, kBin, patch.x, patch.y, patch.width, patch.height},
                              shade_memory);
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// Coverage masks of tiles in a bin and of pixels in a tile, for the variant coverage_masks; called by coverage_masks.cpp.
// Compiled once per instruction set.
#pragma once

#include "covered_tile.inl"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

void coarse(const Record& r, int bin_x, int bin_y, uint64_t* touched, uint64_t* full, DepthNumber* anchor,
            Counts* counts) {
  const TileMasks m = tiles_in_bin(r, bin_x, bin_y, counts);
  *touched = m.touched;
  *full = m.full;
  *anchor = cell_anchor(r, bin_x, bin_y);
}

// Lanes of a warp. So many entries are looked at together, and so many fragments are drawn together.
constexpr int kWarpLanes = 32;

// What lanes read of the entries that are looked at together, and the fragment of each lane: its entry, and its pixel in
// the tile. Lanes from `count` on are idle; they hold what is no longer looked at.
struct Warp {
  const Record* record[kWarpLanes];
  DepthNumber anchor[kWarpLanes], dzdx[kWarpLanes], dzdy[kWarpLanes];
  float zmin[kWarpLanes], zmax[kWarpLanes];
  uint32_t triangle[kWarpLanes];
  int32_t entry[kWarpLanes] = {}, pixel[kWarpLanes] = {};
  int count = 0;
  bool thin;  // whether one of the entries has no plane
};

BIGTRI_INLINE void set_entry(Warp* w, int e, const TileEntry& entry) {
  const Record& r = *entry.record;
  w->record[e] = &r;
  w->anchor[e] = entry.anchor, w->dzdx[e] = r.dzdx, w->dzdy[e] = r.dzdy;
  w->zmin[e] = r.zmin, w->zmax[e] = r.zmax;
  w->triangle[e] = r.triangle;
  w->thin |= is_thin(r);
}

// Draws the fragments of all lanes into the tile whose first pixel is (x, y): depths in vectors, and then, as two lanes may
// have the same pixel, the nearest of each pixel one by one.
BIGTRI_INLINE void draw_lanes(Warp* w, int x, int y, int64_t* pixels, Counts* counts) {
  DepthNumber plane[kWarpLanes];
  const int i = x % kBin, j = y % kBin;
  for (int first = 0; first < kWarpLanes; first += 8) {
    DepthNumber anchor[8], dzdx[8], dzdy[8], column[8], row[8];
    for (int lane = 0; lane < 8; ++lane) {
      const int e = w->entry[first + lane], p = w->pixel[first + lane];
      anchor[lane] = w->anchor[e], dzdx[lane] = w->dzdx[e], dzdy[lane] = w->dzdy[e];
      column[lane] = place_in_cell(i + p % kTile), row[lane] = place_in_cell(j + p / kTile);
    }
    // plane_row and plane_column of core/depth.h.
    store(plane + first, (load<DepthLanes>(anchor) + load<DepthLanes>(dzdy) * load<DepthLanes>(row)) +
                             load<DepthLanes>(dzdx) * load<DepthLanes>(column));
  }
  float z[kWarpLanes];
  for (int lane = 0; lane < kWarpLanes; ++lane)
    z[lane] = clamp_depth((float)plane[lane], w->zmin[w->entry[lane]], w->zmax[w->entry[lane]]);
  for (int lane = 0; w->thin && lane < w->count; ++lane) {
    const Record& r = *w->record[w->entry[lane]];
    const int p = w->pixel[lane];
    if (is_thin(r))
      z[lane] = finish_depth(depth_at(r.x, r.y, r.z, r.area, x + p % kTile, y + p / kTile), r.zmin, r.zmax);
  }
  int64_t packed[kWarpLanes];
  for (int lane = 0; lane < kWarpLanes; ++lane) packed[lane] = pack_fragment(z[lane], w->triangle[w->entry[lane]]);
  for (int lane = 0; lane < w->count; ++lane) {
    int64_t* pixel = pixels + w->pixel[lane];
    counts->add(Counter::passed, packed[lane] < *pixel);
    counts->add_fragments(1, x + w->pixel[lane] % kTile, y + w->pixel[lane] / kTile);
    *pixel = min_of(*pixel, packed[lane]);
  }
  w->count = 0;
}

void fine(const TileEntry* queue, int64_t count, int x, int y, int64_t* pixels, Counts* counts) {
  Warp w;
  for (int64_t first = 0; first < count; first += kWarpLanes) {
    const int entries = (int)min_of<int64_t>(kWarpLanes, count - first);
    uint64_t mask[kWarpLanes];
    w.thin = false;
    for (int e = 0; e < entries; ++e) {
      const TileEntry& entry = queue[first + e];
      const Record& r = *entry.record;
      mask[e] = boxed_pixels(r, x, y) & (entry.full ? ~0ull : pixels_in_tile(r, x, y, counts));
      counts->add(Counter::tiles_empty, !mask[e]);
      set_entry(&w, e, entry);
    }
    // On a GPU lane n finds its fragment by itself: the entry from a scan of the masks' popcounts, and the pixel as the
    // mask's n-th set bit. One after the other they are the masks' bits in their order.
    for (int e = 0; e < entries; ++e)
      for (uint64_t rest = mask[e]; rest; rest &= rest - 1) {
        w.entry[w.count] = e;
        w.pixel[w.count] = __builtin_ctzll(rest);
        if (++w.count == kWarpLanes) draw_lanes(&w, x, y, pixels, counts);
      }
    draw_lanes(&w, x, y, pixels, counts);
  }
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

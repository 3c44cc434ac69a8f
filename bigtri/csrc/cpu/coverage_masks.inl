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

// Fragments of up to kWarpLanes entries, one a lane, whichever entries they are of.
struct Fragments {
  DepthInCell depth[kWarpLanes];  // of the entries
  int entry[kWarpLanes], pixel[kWarpLanes];  // of the lanes
  int count = 0;
};

// Depths of all lanes, and then, as two lanes may have the same pixel, the nearest of each pixel one by one.
BIGTRI_INLINE void draw_lanes(Fragments* f, int i, int j, int64_t* pixels, Counts* counts) {
  int64_t packed[kWarpLanes];
  for (int lane = 0; lane < f->count; ++lane) {
    const DepthInCell& d = f->depth[f->entry[lane]];
    const int x = i + f->pixel[lane] % kTile, y = j + f->pixel[lane] / kTile;
    packed[lane] =
        pack_fragment(is_thin(*d.r) ? pixel_depth<true>(d, x, y) : pixel_depth<false>(d, x, y), d.r->triangle);
  }
  for (int lane = 0; lane < f->count; ++lane) {
    int64_t* pixel = pixels + f->pixel[lane];
    counts->add(Counter::passed, packed[lane] < *pixel);
    *pixel = min_of(*pixel, packed[lane]);
  }
  counts->add(Counter::fragments, f->count);
  f->count = 0;
}

void fine(const TileEntry* queue, int64_t count, int x, int y, int64_t* pixels, Counts* counts) {
  const int i = x % kBin, j = y % kBin;
  Fragments f;
  for (int64_t first = 0; first < count; first += kWarpLanes) {
    const int entries = (int)min_of<int64_t>(kWarpLanes, count - first);
    uint64_t mask[kWarpLanes];
    for (int e = 0; e < entries; ++e) {
      const TileEntry& entry = queue[first + e];
      const Record& r = *entry.record;
      mask[e] = boxed_pixels(r, x, y) & (entry.full ? ~0ull : pixels_in_tile(r, x, y, counts));
      counts->add(Counter::tiles_empty, !mask[e]);
      f.depth[e] = {&r, x - i, y - j, entry.anchor, r.dzdx, r.dzdy};
    }
    // On a GPU lane n finds its fragment by itself: the entry from a scan of the masks' popcounts, and the pixel as the
    // mask's n-th set bit. One after the other they are the masks' bits in their order.
    for (int e = 0; e < entries; ++e)
      for (uint64_t rest = mask[e]; rest; rest &= rest - 1) {
        f.entry[f.count] = e;
        f.pixel[f.count] = __builtin_ctzll(rest);
        if (++f.count == kWarpLanes) draw_lanes(&f, i, j, pixels, counts);
      }
    draw_lanes(&f, i, j, pixels, counts);
  }
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

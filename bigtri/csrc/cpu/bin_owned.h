// The kernels of the bin_owned variant and the data that they share with bin_owned.cpp, which calls them in this order:
// bin, raster_bins. The kernels are compiled once per instruction set (binning.inl, bin_owned.inl); this file once per
// rung.
#pragma once

#include "../core/record.h"
#include "backend.h"
#include "counting.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

// An entry of a bin list is slot << 2 | small << 1 | full. small: the record takes the direct path, without tiles.
// full: every pixel centre of the bin lies inside all edges. It is set only for large records.
constexpr uint32_t kEntryFull = 1, kEntrySmall = 2;
constexpr int kEntryShift = 2;
struct BinPair {
  uint32_t bin, entry;  // bin is numbered from the first bin of the pass's first view
};

// The records of several views, for binning. Those of view v, counted from the pass's first, are in the slots
// [view_begin[v], view_begin[v + 1]).
struct BinJob {
  const Record* records;
  const uint32_t* candidates;  // number of bins that the record's bbox touches; 0: the slot has no record
  const int64_t* view_begin;
  int bins_x, bins;  // bins across a view, bins of a view
};

// Memory for the pixels of a view that takes several passes, where the caller wants no visibility buffer.
struct Held {
  int64_t view = -1;
  int64_t* pixels = nullptr;  // [H, W]
};

// The bin lists of a pass, for drawing. Bins are numbered through all views. With i = b - first_bin, the list of bin b
// is entries[list_begin[i]] to entries[list_begin[i + 1]].
struct RasterJob {
  const Record* records;
  const uint32_t* entries;  // all lists, one after the other
  const uint32_t* list_begin;  // one more than there are lists
  int64_t first_bin;  // the first bin that has a list
  int64_t begun_views;  // views below it have been stored at least once; a bin of any other view starts as background
  int bins_x, bins;  // bins across a view, bins of a view
  Viewport view;  // the same for every view
  int64_t* packed;  // out: [views, H, W] or null
  Held begun,
      unfinished;  // where packed is null: the view that earlier passes began, and the one that later ones go on with
  const ShadeJob* shade;  // the picture to be made, or null
  int64_t finished_views;  // views below it are finished by this pass, and so shaded
  float* depth;  // out: [views, H, W] or null
  int64_t* counters;  // out, added to: [kCounters] or null
  // Whether packed, and depth, are stored around the caches, which is faster only if the image does not fit them.
  bool streams_packed, streams_depth;
  int64_t rows_in_cache;  // px: whole rows of background below it are not, in either
  WorkMap* map;  // out, added to by what counts: where a single view's work is done; or null
};

// Bytes of a worker's scratch memory: at least sizeof(Scratch) (bin_owned.inl), and few enough for a core's cache.
constexpr int64_t kScratchBytes = 128 * 1024;

struct BinOwnedKernels {
  // Writes a pair for each bin that a record in slots [begin, end) enters, and adds 1 to counts[bin]. Returns the
  // number of pairs, which is at most the sum of candidates.
  int64_t (*bin)(const BinJob& job, int64_t begin, int64_t end, BinPair* pairs, uint32_t* counts, Counts* work);
  // Draws one bin and stores its pixels, or stores background to `bins` bins of a row that have no entries. bin, the
  // first, is numbered through all views; scratch is 64-byte aligned. If there is a picture to be made, shades what is
  // finished; shade_scratch is for that (ShadeKernels).
  void (*raster_bins)(const RasterJob& job, int64_t bin, int bins, void* scratch, void* shade_scratch);
};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

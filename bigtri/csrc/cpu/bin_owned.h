// The bin-owned variant's kernels and the data that they and bin_owned.cpp share.
#pragma once

#include "../core/record.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

// A bin's list holds entries of (record << 2 | small << 1 | full); full: every centre of the bin is inside the record's triangle.
constexpr uint32_t kEntryFull = 1, kEntrySmall = 2;
constexpr int kEntryShift = 2;
struct BinPair {
  uint32_t bin, entry;
};

// Triangles of one view.
struct SetupJob {
  const float* positions;    // [V, 4]
  const int32_t* triangles;  // [T, 3]
  const Vertex* vertices;    // projected; vertices[0] is vertex first_vertex
  int64_t first_vertex;
  Viewport view;
};

// Records of several views, in the order of the views: those of view v stand in the slots [view_begin[v], view_begin[v + 1]).
struct BinJob {
  const Record* records;
  const uint32_t* candidates;  // bins that each record's bbox touches; 0 for a slot without a record
  const int64_t* view_begin;
  int bins_x, bins;            // across, and of a view
};

struct RasterJob {
  const Record* records;
  const uint32_t* entries;     // all lists, one after the other
  const uint32_t* list_begin;  // of the bins from first_bin on
  int64_t first_bin;           // bins are counted through all views
  int64_t begun_views;         // views below have pixels already; in the others a bin starts from the background
  int bins_x, bins;            // across, and of a view
  Viewport view;
  int64_t* packed;  // [views, H, W]
  float* depth;     // [views, H, W] or null
};

// Memory of one worker for one bin at a time; defined by the build that uses it.
constexpr int64_t kScratchBytes = 128 * 1024;

struct BinOwnedKernels {
  void (*project)(const float* positions, int64_t begin, int64_t end, int width, int height, Vertex* out);
  // Triangles [begin, end) to records; returns their number. candidates[i]: bins that record i's bbox touches.
  int64_t (*setup)(const SetupJob& job, int64_t begin, int64_t end, Record* records, uint32_t* candidates,
                   int64_t* dropped);
  // Records in the slots [begin, end) to pairs, bins counted from the first view's; counts[bin] goes up by one for each. Returns the number of pairs.
  int64_t (*bin)(const BinJob& job, int64_t begin, int64_t end, BinPair* pairs, uint32_t* counts);
  void (*raster_bin)(const RasterJob& job, int64_t bin, void* scratch);
};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

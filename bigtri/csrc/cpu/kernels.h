// What a per-ISA build offers, and the plain data it works on. One table per instruction set; dispatch.cpp picks one at load.
#pragma once

#include "../core/attributes.h"
#include "../core/record.h"
#include "../core/scanline.h"
#include "../core/shading.h"
#include "../core/texture.h"
#include "../core/tile_mask.h"

namespace bigtri {

// A bin's list holds entries of (record << 2 | small << 1 | full); full: every centre of the bin is inside the record's triangle.
constexpr uint32_t kEntryFull = 1, kEntrySmall = 2;
constexpr int kEntryShift = 2;
struct BinPair {
  uint32_t bin, entry;
};

struct SetupJob {
  const float* positions;      // [V, 4]
  const int32_t* triangles;    // [T, 3]
  const Vertex* vertices;      // projected; vertices[0] is vertex first_vertex
  int64_t first_vertex;
  Viewport view;
};

struct RasterJob {
  const Record* records;
  const uint32_t* entries;       // all lists, one after the other
  const uint32_t* list_begin;    // [bins + 1]
  int bins_x, bins_y;
  bool first_pass;               // nothing has been written yet: each bin starts from the background
  Viewport view;
  int64_t* packed;               // [H, W]
  float* depth;                  // [H, W] or null
};

// Memory of one worker for one bin at a time; defined by the build that uses it.
constexpr int64_t kScratchBytes = 128 * 1024;

struct Kernels {
  const char* name;
  void (*project)(const float* positions, int64_t begin, int64_t end, int width, int height, Vertex* out);
  // Triangles [begin, end) to records; returns their number. candidates[i]: bins that record i's bbox touches.
  int64_t (*setup)(const SetupJob& job, int64_t begin, int64_t end, Record* records, uint32_t* candidates, int64_t* dropped);
  // Records [begin, end) to pairs; counts[bin] goes up by one for each. Returns the number of pairs.
  int64_t (*bin)(const Record* records, const uint32_t* candidates, int64_t begin, int64_t end, int bins_x, BinPair* pairs, uint32_t* counts);
  void (*raster_bin)(const RasterJob& job, int bin, void* scratch);

  // Stages by themselves, on the layout of docs/architecture.md.
  void (*tile_mask)(const int32_t* xy, const int32_t* bbox, const int32_t* queue, int64_t count, int64_t* touched, int64_t* full);
  int64_t (*scan_tiles)(const int32_t* xy, const int32_t* bbox, const int32_t* entry, uint64_t touched, int32_t* spans);
  int64_t (*scan_rows)(const int32_t* xy, const int32_t* bbox, int32_t record, int32_t* spans);
  void (*depth_spans)(const int32_t* xy, const float* z, const int64_t* area, const int32_t* spans, int64_t count, float* out);

  // What reads a visibility buffer.
  void (*interpolate_row)(const struct AttributeJob& job, int64_t row, Parent* scratch);
  void (*sample)(const float* texture, int height, int width, int64_t channels, const float* uv, int64_t count, Filter filter, Wrap wrap, float* out);
  void (*lambert)(const float* normals, const float* albedo, const float* ambient, const float* directions, const float* colors, int64_t lights, int64_t count,
                  float* out);
  void (*encode_srgb)(const float* linear, const float* thresholds, int64_t count, uint8_t* out);
};

struct AttributeJob {
  const int64_t* packed;      // [H, W]
  const float* positions;     // [V, 4]
  int64_t vertices;
  const int32_t* triangles;   // [T, 3]
  int64_t triangle_count;
  int height, width;
  const float* attributes;    // [V, C], or null: the barycentrics of the parent's corners
  int64_t channels;           // C, or 3
  float* out;                 // [H, W, channels]
};

}  // namespace bigtri

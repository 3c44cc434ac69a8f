// Moves the pixels of a bin between a worker's buffer and the image: load, cut to the scissor, store. Called by
// raster_bins (bin_owned.inl) for each bin; writes the visibility buffer and the depth image. Compiled once per
// instruction set.
#pragma once

#include "kernels.h"
#include "simd.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// A bin, or several side by side, cut to the image.
struct Patch {
  int x, y, width, height;  // px
  int64_t at;               // index of its first pixel in the images of all views
  int64_t* packed;          // its first pixel in the visibility buffer; null: it is in none
};

BIGTRI_INLINE Patch patch_of(const RasterJob& job, int64_t view, int bin_x, int bin_y, int bins) {
  const int x = bin_x * kBin, y = bin_y * kBin;
  const int64_t in_view = (int64_t)y * job.view.width + x, at = view * job.view.height * job.view.width + in_view;
  int64_t* packed = job.packed ? job.packed + at : nullptr;
  for (const Held& held : {job.begun, job.unfinished})
    if (!packed && view == held.view) packed = held.pixels + in_view;
  return {x, y, min_of(bins * kBin, job.view.width - x), min_of(kBin, job.view.height - y), at, packed};
}

// pixels: the worker's buffer, rows of kBin. A later pass reads what an earlier one has stored.
void load_bin(const RasterJob& job, const Patch& p, int64_t* pixels) {
  for (int j = 0; j < p.height; ++j)
    __builtin_memcpy(pixels + j * kBin, p.packed + (int64_t)j * job.view.width, (size_t)p.width * sizeof(int64_t));
}

// Tiles and rows are drawn without a scissor test. This resets the pixels outside the scissor to background; only the
// bins that the scissor crosses have any.
void apply_scissor(const Viewport& v, const Patch& p, int64_t* pixels) {
  if (v.x0 <= p.x && v.y0 <= p.y && v.x1 >= p.x + p.width && v.y1 >= p.y + p.height) return;
  for (int j = 0; j < p.height; ++j)
    for (int i = 0; i < p.width; ++i)
      if (p.x + i < v.x0 || p.x + i >= v.x1 || p.y + j < v.y0 || p.y + j >= v.y1) pixels[j * kBin + i] = kBackground;
}

// Stores row j of a patch. In a large image aligned rows of whole bins are streamed: an ordinary store would first read
// the cache line that it overwrites.
BIGTRI_INLINE void store_row(const RasterJob& job, const Patch& p, int j, const int64_t* row) {
  int64_t* to = p.packed + (int64_t)j * job.view.width;
  if (!p.packed) {
    // Only a picture is made.
  } else if (p.width == kBin && job.streams_packed && ((uintptr_t)to & 63) == 0) {
    for (int i = 0; i < kBin; i += 8) stream(to + i, load<i64x8>(row + i));
  } else if (p.width == kBin) {
    for (int i = 0; i < kBin; i += 8) store(to + i, load<i64x8>(row + i));
  } else {
    for (int i = 0; i < p.width; ++i) to[i] = row[i];
  }
  if (!job.depth) return;
  float* depth = job.depth + p.at + (int64_t)j * job.view.width;
  if (p.width == kBin && job.streams_depth && ((uintptr_t)depth & 31) == 0)
    for (int i = 0; i < kBin; i += 8) stream(depth + i, depths_of(load<i64x8>(row + i)));
  else if (p.width == kBin)
    for (int i = 0; i < kBin; i += 8) store(depth + i, depths_of(load<i64x8>(row + i)));
  else
    for (int i = 0; i < p.width; ++i) depth[i] = depth_of(row[i]);
}

void store_bin(const RasterJob& job, const Patch& p, const int64_t* pixels) {
  for (int j = 0; j < p.height; ++j) store_row(job, p, j, pixels + j * kBin);
}

// Stores n times the same element.
template <class T>
BIGTRI_INLINE void fill(T* to, int n, T value, bool streams) {
  const Lanes<T, 8> eight = splat<Lanes<T, 8>>(value);
  int i = 0;
  if (streams) {
    for (; i < n && ((uintptr_t)(to + i) & (sizeof eight - 1)); ++i) to[i] = value;
    for (; i + 8 <= n; i += 8) stream(to + i, eight);
  } else {
    for (; i + 8 <= n; i += 8) store(to + i, eight);
  }
  for (; i < n; ++i) to[i] = value;
}

// A patch without triangles, of one bin or of several side by side. Rows of the whole image follow each other in memory:
// that is one long run of stores, of which the processor knows by itself that it need not read what it overwrites.
void store_background(const RasterJob& job, const Patch& p) {
  if (p.width == job.view.width) {
    const bool streams = p.at >= job.rows_in_cache;
    if (p.packed) fill(p.packed, p.width * p.height, kBackground, streams);
    if (job.depth) fill(job.depth + p.at, p.width * p.height, depth_of(kBackground), streams);
    return;
  }
  for (int j = 0; j < p.height; ++j) {
    const int64_t at = p.at + (int64_t)j * job.view.width;
    if (p.packed) fill(p.packed + (int64_t)j * job.view.width, p.width, kBackground, job.streams_packed);
    if (job.depth) fill(job.depth + at, p.width, depth_of(kBackground), job.streams_depth);
  }
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

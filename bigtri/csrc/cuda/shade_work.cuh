// What the kernels of the shading pass share: the memory that they work with, and which words of a picture they make.
#pragma once

#include "areas.h"
#include "launch.cuh"
#include "short_divisor.cuh"
#include "weights.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr int kShadeWarps = 4;  // of a block, in all kernels but begin_frame
constexpr int kShadeThreads = kShadeWarps * kWarp;
// Blocks that a multiprocessor ought to hold. Where a pixel's triangle is prepared, it may hold more warps, which wait for
// memory in less time; others need the registers, as do pixels of listed areas that are kept from sample to sample.
// Compute capability 7.5 has no place for more than 32 warps.
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ == 750
constexpr int kMostShadeWarps = 32;
#else
constexpr int kMostShadeWarps = 36;
#endif
constexpr int shade_blocks(bool more) { return (more ? kMostShadeWarps : 32) / kShadeWarps; }
constexpr int kBeginWarps = 8;
constexpr int kBeginThreads = kBeginWarps * kWarp;
constexpr int kWordsOfArea = kAreaWidth * kAreaHeight / kWarp;  // a word is 32 pixels of a row of the picture
constexpr uint8_t kNoPlace = 255;  // in Work::place: a clipped triangle that found no memory

// Linear light, in a vector.
struct alignas(16) PackedColor {
  float value[3];
};

// Memory that the kernels work with, and what the host computes for them.
struct Work {
  ShortDivisor width, triangles;  // of the picture, px; T
  int height;  // of the picture, px
  Areas areas;  // of the launch's views
  ShortDivisor area_columns, area_rows;  // of a view
  uint32_t words;  // of all areas
  int64_t first_item;  // views before those of the launch, times T
  bool beside;  // whether something is wanted beside the picture
  Lookups lookups;
  uint32_t* background;  // [views * height]: a pixel of each row of the picture, the lowest byte first
  PackedColor* light_behind;  // the background of each row of samples; null where a pixel is one sample
  uint32_t* any_left;  // [1]: whether pixels are left to shade_left
  PreparedTriangle* prepared;  // [views, T], or null
  ProjectedVertex* projected;  // [views, V], or null
  uint16_t* flags;  // theirs, for what reads nothing else
  uint8_t* place;  // [views, T]: of a clipped triangle, its place among its block's, or kNoPlace; else 0
  ClippedTriangle* clipped;  // [blocks of begin_frame with triangles, places]
  uint8_t *found, *listed;  // of a block, where nothing is prepared: how many it has there, and which of its triangles
  int places;
};

// The samples of a pixel on their way to their mean.
struct Mean {
  float total[3];
  int covered;

  __device__ __forceinline__ void add(const float light[3], bool drawn) {
    for (int c = 0; c < 3; ++c) total[c] = total[c] + light[c];
    covered += drawn;
  }
  // The first channel in the lowest byte. Table: what encode_srgb takes.
  template <class Table>
  __device__ __forceinline__ uint32_t encoded(const Shading& job, const Table& table) const {
    uint8_t pixel[4] = {};
    store_mean(total, covered, job.samples * job.samples, job.channels, table, pixel);
    return pixel[0] | pixel[1] << 8 | pixel[2] << 16 | (uint32_t)pixel[3] << 24;
  }
};

// Where a pixel of the picture lies, or the first one of a word; or a sample, in the visibility buffer.
struct Place {
  uint32_t view;
  int x, y;
};

// Words of the areas that the pass reads, those listed or all. Some lie beyond the image.
template <bool kListed>
__device__ __forceinline__ uint32_t word_count(const Work& work) {
  return kListed ? *work.areas.count * kWordsOfArea : work.words;
}
template <bool kListed>
__device__ __forceinline__ Place word_at(const Work& work, uint32_t i) {
  const uint32_t number = i / kWordsOfArea;
  uint32_t view, row, column;
  if constexpr (kListed) {
    const Area area = work.areas.list[number];
    view = (uint32_t)area.view, row = area.row, column = area.column;
  } else {
    const uint32_t row_of_all = work.area_columns.quotient(number);
    view = work.area_rows.quotient(row_of_all);
    row = row_of_all - view * work.area_rows.by;
    column = number - row_of_all * work.area_columns.by;
  }
  return {view, (int)(column * kAreaWidth + i % 2 * kWarp), (int)(row * kAreaHeight + i / 2 % kAreaHeight)};
}
static_assert(kAreaWidth == 2 * kWarp, "an area's row is two words");
// The lane's pixel of the j-th word from a word on that begins a row of its area, or of that word itself.
__device__ __forceinline__ Place pixel_at(const Place& word, int j) {
  return {word.view, word.x + j % 2 * kWarp + lane_id(), word.y + j / 2};
}
__device__ __forceinline__ uint32_t row_of(const Work& work, const Place& at) { return at.view * work.height + at.y; }
__device__ __forceinline__ bool in_picture(const Work& work, const Place& at) {
  return at.x < (int)work.width.by && at.y < work.height;
}
// Whether the word of the lane's pixel does.
__device__ __forceinline__ bool begins_in_picture(const Work& work, const Place& at) {
  return at.x - lane_id() < (int)work.width.by && at.y < work.height;
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

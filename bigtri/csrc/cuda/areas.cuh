// Areas of an image, 64 by 16 px. A picture of triangles is shaded only in those that a triangle may touch, which are
// marked and listed while the triangles are drawn; all others are background.
#pragma once

#include "launch.cuh"
#include "setup.cuh"
#include "short_divisor.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr int kAreaWidth = 64, kAreaHeight = 16;  // px
// Words of marks from a row of areas to the next: each has a line of the cache to itself. Atomic operations on one line
// wait for each other.
constexpr int kMarkPitch = 32;

struct Area {
  int32_t view;
  uint16_t column, row;
};

// The areas of some views.
struct Areas {
  ShortDivisor columns, rows;  // of a view
  int32_t words;  // of marks, for a row
  int32_t pitch;  // words from one row to the next
  int64_t views;
  // Null where all areas count.
  uint32_t* count;  // [1]: of those in the list
  uint32_t* marks;  // [views, rows, pitch]: bit k of a word: area 32 * word + k of the row may be touched
  Area* list;  // those, in any order

  __host__ __device__ int64_t all() const { return views * rows.by * columns.by; }
  __host__ __device__ int64_t all_rows() const { return views * rows.by; }
  // What is zero before areas are marked.
  __host__ __device__ Zeros zeros() const { return {count, kMarkPitch + all_rows() * pitch}; }
};

Areas areas_of(int width, int height, int64_t views) {
  Areas a = {};
  a.columns = ShortDivisor((uint32_t)(width + kAreaWidth - 1) / kAreaWidth);
  a.rows = ShortDivisor((uint32_t)(height + kAreaHeight - 1) / kAreaHeight);
  a.words = (int32_t)(a.columns.by + 31) / 32;
  a.pitch = (a.words + kMarkPitch - 1) / kMarkPitch * kMarkPitch;
  a.views = views;
  return a;
}

// With memory to mark and list them.
Areas take_areas(Scratch* scratch, int width, int height, int64_t views) {
  Areas a = areas_of(width, height, views);
  a.count = scratch->take<uint32_t>(kMarkPitch + a.all_rows() * a.pitch);
  a.marks = a.count + kMarkPitch;
  a.list = scratch->take<Area>(a.all());
  return a;
}

// The areas that a triangle may touch.
struct MarkBox {
  int64_t first_row;  // among the rows of all views
  int left, right;  // columns, the last one within
  int rows;  // 0: none

  // Word `across` of row `down`: where it is among all words, and its bits of the box.
  __device__ __forceinline__ int64_t word(const Areas& areas, int down, int across, uint32_t* bits) const {
    const int low = max_of(left - 32 * across, 0), high = min_of(right - 32 * across, 31);
    *bits = ~0u << low & ~0u >> (31 - high);
    return (first_row + down) * areas.pitch + across;
  }
};
__device__ __forceinline__ MarkBox of_lane(const MarkBox& b, int lane) {
  return {__shfl_sync(kAllLanes, b.first_row, lane), __shfl_sync(kAllLanes, b.left, lane),
          __shfl_sync(kAllLanes, b.right, lane), __shfl_sync(kAllLanes, b.rows, lane)};
}

// Of a triangle's corners x, y, subpx, and its fate: the areas that its bounding box meets, or all of its view if it has
// to be clipped.
__device__ __forceinline__ MarkBox mark_box(const Areas& areas, int64_t view, const Viewport& image, Fate fate,
                                            const int32_t x[3], const int32_t y[3]) {
  PixelBox box = {0, 0, image.width, image.height};
  if (fate == Fate::kWhole) box = pixel_box(x, y, image);
  if ((fate != Fate::kWhole && fate != Fate::kClip) || box.x0 >= box.x1 || box.y0 >= box.y1) return {};
  const int top = box.y0 / kAreaHeight;
  return {view * areas.rows.by + top, box.x0 / kAreaWidth, (box.x1 - 1) / kAreaWidth,
          (box.y1 - 1) / kAreaHeight - top + 1};
}

// Marks the lanes' words, each once: a warp's triangles are neighbours, and so are their areas. word: -1 for none. By all
// lanes.
__device__ __forceinline__ void mark_together(const Areas& areas, int64_t word, uint32_t bits) {
  for (unsigned todo = __ballot_sync(kAllLanes, word >= 0); todo;) {
    const int first = __ffs(todo) - 1;
    const bool same = word == __shfl_sync(kAllLanes, word, first);
    const uint32_t all = warp_or(same ? bits : 0);
    if (lane_id() == first) atomicOr(areas.marks + word, all);
    todo &= ~__ballot_sync(kAllLanes, same);
  }
}

// Marks the lanes' boxes. By all lanes.
__device__ __forceinline__ void mark(const Areas& areas, const MarkBox& box) {
  constexpr int kOwnRows = 4;  // a triangle with more is the whole warp's, so that a large one does not hold up a lane
  const bool small = box.rows <= kOwnRows && box.left / 32 == box.right / 32;
  for (int down = 0; __any_sync(kAllLanes, small && down < box.rows); ++down) {
    uint32_t bits = 0;
    const int64_t word = small && down < box.rows ? box.word(areas, down, box.left / 32, &bits) : -1;
    mark_together(areas, word, bits);
  }
  for (unsigned large = __ballot_sync(kAllLanes, !small); large; large &= large - 1) {
    const MarkBox its = of_lane(box, __ffs(large) - 1);
    for (int down = lane_id(); down < its.rows; down += kWarp)
      for (int across = its.left / 32; across <= its.right / 32; ++across) {
        uint32_t bits;
        const int64_t word = its.word(areas, down, across, &bits);
        atomicOr(areas.marks + word, bits);
      }
  }
}

// Lists the areas that are marked, a word of marks a warp. By warp i of n.
__device__ __forceinline__ void list_areas(const Areas& areas, int64_t i, int64_t n) {
  for (; i < areas.all_rows() * areas.words; i += n) {
    const int64_t row = i / areas.words, view = row / areas.rows.by;
    const int word = (int)(i - row * areas.words);
    const uint32_t marked = areas.marks[row * areas.pitch + word];
    if (!marked) continue;
    uint32_t place = 0;
    if (lane_id() == 0) place = atomicAdd(areas.count, (uint32_t)__popc(marked));
    place = __shfl_sync(kAllLanes, place, 0) + __popc(marked & lanes_below());
    if (marked >> lane_id() & 1)
      areas.list[place] = {(int32_t)view, (uint16_t)(32 * word + lane_id()), (uint16_t)(row - view * areas.rows.by)};
  }
}

// Where a pixel lies, or the first one of a word of 32 pixels of a row.
struct Place {
  uint32_t view;
  int x, y;
};

constexpr int kWordsOfArea = kAreaWidth * kAreaHeight / kWarp;
static_assert(kAreaWidth == 2 * kWarp, "an area's row is two words");

// Words of the areas that count. Some lie beyond the image.
__device__ __forceinline__ uint32_t word_count(const Areas& areas) {
  return (areas.list ? *areas.count : (uint32_t)areas.all()) * kWordsOfArea;
}
__device__ __forceinline__ Place word_at(const Areas& areas, uint32_t i) {
  const uint32_t number = i / kWordsOfArea;
  uint32_t view, row, column;
  if (areas.list) {
    const Area area = areas.list[number];
    view = (uint32_t)area.view, row = area.row, column = area.column;
  } else {
    const uint32_t row_of_all = areas.columns.quotient(number);
    view = areas.rows.quotient(row_of_all);
    row = row_of_all - view * areas.rows.by;
    column = number - row_of_all * areas.columns.by;
  }
  return {view, (int)(column * kAreaWidth + i % 2 * kWarp), (int)(row * kAreaHeight + i / 2 % kAreaHeight)};
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

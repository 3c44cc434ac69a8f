// Areas of an image, 64 by 16 px. Where a picture is made of a buffer that nobody asks for, only areas that a triangle
// may touch are cleared and read; all others are background. Torch-free.
#pragma once

#include "../core/frame.h"

namespace bigtri {

constexpr int kAreaWidth = 64, kAreaHeight = 16;  // px

struct Area {
  int32_t view;
  uint16_t column, row;
};

// The areas of a frame, and which of them may be touched.
struct Areas {
  int columns, rows;  // of a view
  int words;          // of marks, for a row of areas
  int pitch;          // words from one row's to the next's
  int64_t views;
  // Null where none is left out.
  uint32_t* count;  // [1]: of those in the list
  uint32_t* marks;  // [views, rows, pitch]: bit k of a word: area 32 * word + k of the row may be touched
  Area* list;       // those, in any order
};
BIGTRI_HD int64_t all_of(const Areas& a) { return a.views * a.rows * a.columns; }

// Words of the memory in front of the list: the count, and marks behind it.
constexpr int kAreaCountWords = 32;
// Rows begin in lines of their own: the places of a cache at which atomic operations meet are as many as lines.
constexpr int kMarkPitch = 32;
inline int64_t area_words(const Areas& a) { return kAreaCountWords + a.views * a.rows * a.pitch; }

// memory: of areas_bytes(), or null.
inline Areas areas_of(int width, int height, int64_t views, void* memory) {
  Areas a = {};
  a.columns = (width + kAreaWidth - 1) / kAreaWidth;
  a.rows = (height + kAreaHeight - 1) / kAreaHeight;
  a.words = (a.columns + 31) / 32;
  a.pitch = (a.words + kMarkPitch - 1) / kMarkPitch * kMarkPitch;
  a.views = views;
  if (!memory) return a;
  a.count = static_cast<uint32_t*>(memory);
  a.marks = a.count + kAreaCountWords;
  a.list = reinterpret_cast<Area*>(a.count + area_words(a));
  return a;
}
inline Areas areas_of(const Frame& f) { return areas_of(f.view.width, f.view.height, f.views, f.areas); }

inline int64_t areas_bytes(int width, int height, int64_t views) {
  const Areas a = areas_of(width, height, views, nullptr);
  return area_words(a) * (int64_t)sizeof(uint32_t) + all_of(a) * (int64_t)sizeof(Area);
}

}  // namespace bigtri

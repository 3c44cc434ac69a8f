// Areas of a picture, 64 by 16 px, of one or several samples each. Where it is made of a buffer that nobody asks for, only
// areas that a triangle may touch are cleared and read; all others are background. Torch-free.
#pragma once

#include "../core/frame.h"

namespace bigtri {

constexpr int kAreaWidth = 64, kAreaHeight = 16;  // px of the picture
// Of a view, samples at least: of fewer marking takes as long as it spares.
constexpr int64_t kSamplesOfAreas = 1500000;

struct Area {
  int32_t view;
  uint16_t column, row;
};

// The areas of a frame, and which of them may be touched.
struct Areas {
  int columns, rows;  // of a view
  int pitch;  // of marks, from a row of areas to the next
  int64_t views;
  // All three are null where none is left out.
  uint32_t* count;  // [1]: of those in the list
  uint8_t* marks;  // [views, rows, pitch]: 1 where an area may be touched, else 0
  Area* list;  // those, in any order
};
BIGTRI_HD int64_t area_rows(const Areas& a) { return a.views * a.rows; }
BIGTRI_HD int64_t all_areas(const Areas& a) { return area_rows(a) * a.columns; }

// So many marks are read and stored at once: a row is filled up to a multiple of it, and the count in front takes as many
// bytes.
constexpr int kMarksTogether = 8;
inline int64_t area_mark_bytes(const Areas& a) { return kMarksTogether + area_rows(a) * a.pitch; }

// width, height: of the picture, px. memory: of areas_bytes(), or null.
inline Areas areas_of(int width, int height, int64_t views, void* memory) {
  Areas a = {};
  a.columns = (width + kAreaWidth - 1) / kAreaWidth;
  a.rows = (height + kAreaHeight - 1) / kAreaHeight;
  a.pitch = (a.columns + kMarksTogether - 1) / kMarksTogether * kMarksTogether;
  a.views = views;
  if (!memory) return a;
  a.count = static_cast<uint32_t*>(memory);
  a.marks = static_cast<uint8_t*>(memory) + kMarksTogether;
  a.list = reinterpret_cast<Area*>(static_cast<char*>(memory) + area_mark_bytes(a));
  return a;
}
inline Areas areas_of(const Frame& f) {
  return areas_of(f.view.width / f.area_samples, f.view.height / f.area_samples, f.views, f.areas);
}

inline int64_t areas_bytes(int width, int height, int64_t views) {
  const Areas a = areas_of(width, height, views, nullptr);
  return area_mark_bytes(a) + all_areas(a) * (int64_t)sizeof(Area);
}

}  // namespace bigtri

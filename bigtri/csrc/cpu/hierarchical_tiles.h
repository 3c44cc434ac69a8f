// The kernel of the hierarchical_tiles variant, which hierarchical_tiles.cpp calls, and what both share. Compiled once per
// instruction set (hierarchical_tiles.inl); this file once per rung.
#pragma once

#include "../core/record.h"
#include "counting.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

// An element of a tile's list: a record, and whether every pixel centre of the tile lies inside all of its edges.
struct TileElement {
  uintptr_t bits;  // the record's address, whose lowest bit is free

  static TileElement of(const Record* record, bool full) { return {(uintptr_t)record | (uintptr_t)full}; }
  const Record& record() const { return *(const Record*)(bits & ~(uintptr_t)1); }
  bool full() const { return bits & 1; }
};
static_assert(alignof(Record) > 1, "the lowest bit of an address is 0");

struct TileElements {
  const TileElement* first;
  int64_t count;
};

// A finest tile and the lists of all tiles of the pyramid that hold it, the finest first.
struct FinestTile {
  int x, y, size;  // its first pixel, and how wide it is, px; it lies in one cell
  const TileElements* lists;
  int list_count;
  bool early_z;
  int64_t* pixels;  // in and out: kPixelsOfTile, rows of pitch_of(size)
};

// Rows are tested eight pixels at a time, which may reach up to seven past the end of the last one.
constexpr int pitch_of(int size) { return size < 8 ? 8 : size; }
constexpr int64_t kPixelsOfTile = kBin * kBin + 8;

struct HierarchicalTilesKernels {
  void (*walk_up)(const FinestTile& tile, Counts* counts);
};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

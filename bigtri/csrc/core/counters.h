// How much work a variant does. A file that counts is compiled a second time with BIGTRI_COUNTING defined. In the first
// build the counters are an empty struct whose functions do nothing (cpu/counting.h), so they cost nothing.
// bigtri/reference/variants/<name>.py computes the same numbers.
#pragma once

#include "platform.h"

namespace bigtri {

// What a counter depends on besides the scene and the variant's parameters.
enum class Depends : int {
  kNothing,  // whatever the threads do, it is the reference's
  // What a variant spares where it knows by depth that nothing can be seen: if it works in an order that threads decide, it
  // has the reference's number with one thread, and never more than without that test. In any other variant as kNothing.
  kSpared,
  kOrder,  // the order of fragments at a pixel: the reference's number with one thread, within bounds with more
  kMost,  // as kSpared; the largest of all tasks', where the others are sums
};

// X(name, what it depends on, what is counted). An edge value is that of one edge function at one sample or corner of
// which the sign is asked: three of them for each square that is tested, even if one alone decides.
// clang-format off
#define BIGTRI_COUNTERS(X)                                                                                      \
  /* Records, by the path that draws them */                                                                    \
  X(records, kNothing, "(sub)triangles that may cover a pixel")                                                 \
  X(by_rows, kNothing, "records drawn row by row of their bounding boxes")                                      \
  X(by_tiles, kNothing, "records drawn by bins or tiles")                                                       \
  X(within_16, kNothing, "records drawn by a path of their own for what lies within a square of 16x16 px")      \
  X(within_4, kNothing, "records drawn by a path of their own for what lies within a square of 4x4 px")         \
  X(wide, kNothing, "records of which an edge value needed 64 bits, after the choice of the path")              \
  /* Queues */                                                                                                  \
  X(candidates, kNothing, "pairs of a record and a bin that its bounding box touches")                          \
  X(entries, kNothing, "elements that went into queues or lists of bins, levels or tiles")                      \
  X(overflows, kNothing, "elements that found their queue full and were kept elsewhere or queued once more")    \
  X(bytes, kNothing, "bytes of records and queue elements that were stored for a later stage")                  \
  /* Squares: bins are what records are listed by, tiles what lies in them, of all sizes */                     \
  X(bins_tested, kNothing, "bins whose corners were tested against the edges of a record")                      \
  X(bins_rejected, kNothing, "of these, with all pixel centres outside of an edge")                             \
  X(bins_accepted, kNothing, "of these, with all pixel centres inside of all edges")                            \
  X(bins_empty, kSpared, "bins that nothing rejected or accepted, none of whose pixels the record covers")     \
  X(bins_hidden, kOrder, "pairs of a record and a bin that were rejected by depth")                             \
  X(tiles_tested, kSpared, "tiles whose corners were tested against the edges of a record")                     \
  X(tiles_rejected, kSpared, "of these, with all pixel centres outside of an edge")                             \
  X(tiles_accepted, kSpared, "of these, with all pixel centres inside of all edges")                            \
  X(separations, kSpared, "tiles that no edge rejects and that were tested in a further way")                   \
  X(tiles_separated, kSpared, "of these, rejected by it")                                                       \
  X(tiles_empty, kSpared, "tiles that nothing rejected or accepted, none of whose pixels the record covers")    \
  X(tiles_hidden, kOrder, "pairs of a record and a tile that were rejected by depth")                           \
  /* Edges and pixels */                                                                                        \
  X(edges_64, kSpared, "edge values in 64 bits")                                                                \
  X(edges_32, kSpared, "edge values in 32 bits")                                                                \
  X(rows, kSpared, "rows of pixels that were cut to a span")                                                    \
  X(fragments, kSpared, "pixels that a record covers and that were offered its depth")                          \
  X(passed, kOrder, "of these, nearer than what the pixel held")                                                \
  X(written, kOrder, "pixels stored to the visibility buffer; clearing is not counted")                         \
  X(atomics, kOrder, "atomic operations that read and write memory, those on pixels that fail included")        \
  /* Load: tasks that draw, of those that test an edge or cover a pixel */                                      \
  X(tasks, kSpared, "tasks that drew")                                                                          \
  X(work, kSpared, "edge values and fragments of tasks that draw")                                              \
  X(most_work, kMost, "edge values and fragments of the task that had most of them")
// clang-format on

enum class Counter : int {
#define BIGTRI_COUNTER(NAME, DEPENDS, ABOUT) NAME,
  BIGTRI_COUNTERS(BIGTRI_COUNTER)
#undef BIGTRI_COUNTER
      kCount
};
constexpr int kCounters = (int)Counter::kCount;

constexpr Depends kCounterDepends[] = {
#define BIGTRI_COUNTER(NAME, DEPENDS, ABOUT) Depends::DEPENDS,
    BIGTRI_COUNTERS(BIGTRI_COUNTER)
#undef BIGTRI_COUNTER
};

}  // namespace bigtri

// Parameters of variants: how the kernels are launched. None of them changes a bit of the picture; docs/cuda.md has the
// measurements behind the numbers.
#pragma once

#include <string.h>

#include "../core/registry.h"

namespace bigtri {

// Those that several variants have.
#define BIGTRI_BLOCKS_PARAMETER(X)                                                                                 \
  X(blocks, "blocks", "of a kernel whose blocks take work in turns; 0: as many as the device holds at once", 0, 0, \
    1 << 20)
#define BIGTRI_QUEUE_PARAMETER(X) \
  X(queue, "records", "that may wait; what finds no room is drawn on the spot, or last", 1 << 18, 1, 1 << 24)
#define BIGTRI_WIDEST_PARAMETER(X)                                                                                 \
  X(widest, "px",                                                                                                  \
    "longest side of the bbox of a triangle that is drawn by rows at set-up; what is wider waits; 0: 64, 96, 192 " \
    "or 256, by the image and the number of triangles; bin_owned then lets large ones wait where there are many",  \
    0, 0, 256)
// Threads of a block, for the designs that are asked how much it matters.
constexpr int kMostThreads = 512;
constexpr int64_t kThreadCounts[] = {32, 64, 128, 256, kMostThreads, -1};
#define BIGTRI_THREADS_PARAMETER(X) X(threads, "threads", "of a block", 128, 32, kMostThreads, kThreadCounts)
// kShares: of ways.cuh
#define BIGTRI_SHARE_PARAMETER(X)                                                                                   \
  X(share, "triangles",                                                                                             \
    "of a block that sets up: up to 124 are drawn by its warps together, and set up by one of them for each 32 at " \
    "most; of 128 each warp draws 32; of 192 and 256 each draws an eighth, and all help with those that are left "  \
    "because there are large ones; of 1024 each warp tests its own and draws those that may show, and of one view " \
    "all blocks at once take 32 a warp in turns, whatever their number; 0: by the image and the number of "         \
    "triangles",                                                                                                    \
    0, 0, 1024, kShares)

// 256: kSearched of ways.cuh
constexpr int64_t kSearches[] = {0, 32, 256, -1};
#define BIGTRI_SEARCH_PARAMETER(X)                                                                                    \
  X(search, "triangles",                                                                                              \
    "of a warp that sets up: 256, of which it sets up those that have a pixel centre in their bboxes, 32 at a time, " \
    "or 32 at most, which it sets up all; 0: by the image and the number of triangles",                               \
    0, 0, 256, kSearches)

#define BIGTRI_ROOM_PARAMETER(X)                                                                                       \
  X(room, "records",                                                                                                   \
    "in the queue of a bin or finest tile; what comes after, all look at; 0: as many as 32 MiB allow for all of them", \
    0, 0, 1 << 20)
#define BIGTRI_EARLY_Z_PARAMETER(X)                                                                                    \
  X(early_z, "", "1: what lies behind all that has been drawn is rejected before its depth is computed; 0: it is not", \
    1, 0, 1)

#define BIGTRI_ROWS_PARAMETER(X)                                                                                       \
  X(rows, "",                                                                                                          \
    "1: triangles that fit are drawn by rows at set-up; 0: all wait, as with a rung of the ladder, and share says no " \
    "more than whether warps test triangles first",                                                                    \
    1, 0, 1)

// From a variant's list, X(name, unit, what it is, standard, lowest, highest[, the only ones allowed]) for each, in the
// variant's namespace: the parameters, and their values by name.
#define BIGTRI_PARAMETER(NAME, ...) {#NAME, __VA_ARGS__},
#define BIGTRI_PARAMETER_VALUE(NAME, ...) int64_t NAME;
#define BIGTRI_PARAMETERS(LIST)                                   \
  constexpr Parameter kParameters[] = {LIST(BIGTRI_PARAMETER){}}; \
  struct Values {                                                 \
    LIST(BIGTRI_PARAMETER_VALUE)                                  \
                                                                  \
    static Values of(const int64_t* list) {                       \
      Values v;                                                   \
      memcpy(&v, list, sizeof(v));                                \
      return v;                                                   \
    }                                                             \
  };

}  // namespace bigtri

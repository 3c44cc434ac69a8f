// The CPU's entry points for one image; torch-free.
#pragma once

#include "kernels.h"
#include "parallel.h"

namespace bigtri {

// The table in use, or nullptr where the machine lacks that instruction set ("baseline", "avx2", "avx512").
const Kernels* find_kernels(const char* name);
const Kernels& current_kernels();
void use_kernels(const Kernels& kernels);

// How much a batch may hold at once: what bounds the memory. More only takes more batches; one chunk of triangles and one record always go through.
struct BatchLimits {
  int64_t records = 1 << 18;     // record slots, 96 B each, touched only where used
  int64_t candidates = 1 << 23;  // bins that the records' bboxes touch: 8 B for the pair, 4 B for the list entry
};
BatchLimits batch_limits();
void set_batch_limits(const BatchLimits& limits);

struct Mesh {
  const float* positions;    // [V, 4], clip space
  int64_t vertices;
  const int32_t* triangles;  // [T, 3], every index in [lowest, highest]
  int64_t count;             // T
  int64_t lowest, highest;   // the vertices in use; lowest > highest: none
};

// Smallest and largest index; (INT32_MAX, INT32_MIN) for no triangles.
void index_range(const Parallel& parallel, const int32_t* indices, int64_t count, int64_t* lowest, int64_t* highest);

// A way to schedule the work of one image. Variants never differ in a bit; each is one file and one line in variants.cpp.
struct Variant {
  const char* name;
  // packed [H, W], depth [H, W] or null: every pixel is written. Returns the number of dropped triangles.
  int64_t (*draw)(const Kernels& kernels, const Parallel& parallel, const Mesh& mesh, const Viewport& view, int64_t* packed, float* depth);
};

// All of them, the one that "auto" means first; ends with a null name.
extern const Variant kVariants[];

}  // namespace bigtri

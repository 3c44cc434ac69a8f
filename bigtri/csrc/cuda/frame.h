// What a frame is to the GPU, and the variants that draw one; torch-free. docs/cuda.md says how they work.
#pragma once

#include <cuda_runtime_api.h>

#include "../core/numerics.h"

namespace bigtri {

// One image of one view. Pointers are to device memory.
struct Frame {
  const float* positions;    // [V, 4], clip space
  const int32_t* triangles;  // [T, 3]
  int64_t vertices;          // V; a triangle with another index is dropped
  int32_t count;             // T
  Viewport view;
  int64_t* packed;   // [H, W]
  float* depth;      // [H, W] or null
  int64_t* dropped;  // one number
};

// Blocks that own pixels draw so many records together for each of their warps. With 19 records a warp where a block sets up all triangles itself (FewShared in bin_owned.cu), that is as
// many as fit 64 KiB of shared memory, which a block can have on all devices.
constexpr int kEntriesOfWarp = 22;
constexpr int kMostWarps = 16;  // of such a block
constexpr int kMostEntries = kEntriesOfWarp * kMostWarps;

// How the kernels are launched, in the whole process. Nothing here changes a bit of the picture; docs/cuda.md has the measurements behind the numbers.
struct Tuning {
  int64_t few = 256;    // up to so many triangles, and 16 for each warp of a block, every block sets up all of them by itself
  int64_t some = 32768;  // up to so many, blocks write the pixels that they own, then small triangles follow; above, small triangles come first
  int64_t warps = 0;  // of a block that owns a patch of 64 px by 4 px a warp: 4, 8 or 16; 0: 8 for up to 128 triangles, else 16
  int64_t blocks = 0;  // of a kernel whose blocks take work in turns; 0: as many as the device holds at once
  int64_t entries = kMostEntries;  // records that a block draws together, at most kEntriesOfWarp for each of its warps
  int64_t queue = 1 << 18;  // records that may wait; what finds no room is drawn on the spot, or last
  // px of bbox above which a record waits, in the lists of path `many` or in the queue of pairs of two_stage; the other paths and persistent do not ask. Whole triangles that are small
  // (small.cuh) never wait, small parts of clipped ones do all the same, and in `many` every sliver waits.
  int64_t threshold = 0;
  int64_t cache = 0;  // bytes that the device's cache holds; 0: what the device says
};
constexpr int kTuningFields = 8;
Tuning tuning();
// False, and nothing changed, if a field is out of range.
bool set_tuning(const Tuning& t);

// A way to schedule the work; each is one file and one line in variants.cu. draw only enqueues: nothing waits for the device.
struct CudaVariant {
  const char* name;
  int64_t (*scratch_bytes)(const Frame& frame, const Tuning& t);
  cudaError_t (*draw)(const Frame& frame, const Tuning& t, void* scratch, cudaStream_t stream);
};

// All of them, the one that "auto" means first; ends with a null name.
extern const CudaVariant kCudaVariants[];

}  // namespace bigtri

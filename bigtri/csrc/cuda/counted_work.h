// What kernels that count add to (counting.cuh). torch/cuda_work_map_ops.cpp puts one into the device's memory, where
// Frame::counted then points to; torch-free.
#pragma once

#include "../core/counters.h"
#include "../core/frame.h"

namespace bigtri {

struct CountedWork {
  int64_t* counters;  // [kCounters]
  int64_t* fragments;  // [height, width], both up to a multiple of 64: those offered to each pixel
  int64_t* blocks;  // [room]: fragments that each block of the kernel offered; blocks beyond the room are left out
  int64_t room;

  BIGTRI_HD int64_t columns(int width) { return (width + kBin - 1) / kBin * kBin; }  // of fragments
};

}  // namespace bigtri

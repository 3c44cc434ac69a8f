// Argument checks of map_work. CPU and CUDA share them: `device` is kCpu, or the CUDA device that all tensors must be on.
#pragma once

#include <utility>

#include "../core/counters.h"
#include "checks.h"

namespace bigtri {

// squares: edge values that the map has, of so many.
inline void check_map_work(int device, const Viewport& view, int64_t squares, const Tensor& positions,
                           const Tensor& triangles, const Tensor& packed, const Tensor& dropped, const Tensor& counters,
                           const Tensor& fragments, const Tensor& edges, const Tensor& tasks) {
  const char* op = "map_work";
  check_on(op, "positions", positions, device, ScalarType::Float, {-1, 4}, "float32 [V, 4]");
  check_on(op, "triangles", triangles, device, ScalarType::Int, {-1, 3}, "int32 [T, 3]");
  check_on(op, "packed", packed, device, ScalarType::Long, {view.height, view.width}, "int64 [height, width]");
  check_on(op, "dropped", dropped, device, ScalarType::Long, {}, "int64 []");
  check_on(op, "counters", counters, device, ScalarType::Long, {kCounters}, "int64 [one for each counter]");
  const int64_t columns = (view.width + kBin - 1) / kBin, rows = (view.height + kBin - 1) / kBin;
  check_on(op, "fragments", fragments, device, ScalarType::Long, {rows * kBin, columns * kBin},
           "int64 [height, width], both up to a multiple of 64");
  check_on(op, "edges", edges, device, ScalarType::Long, {squares},
           "int64 [squares of 8, 16, ... px, up to one that holds the image's bins; on CUDA 0]");
  check_on(op, "tasks", tasks, device, ScalarType::Long, {-1}, "int64 [room]");
  const std::pair<const char*, const Tensor&> inputs[] = {{"positions", positions}, {"triangles", triangles}};
  const std::pair<const char*, const Tensor&> outputs[] = {{"packed", packed},     {"dropped", dropped},
                                                           {"counters", counters}, {"fragments", fragments},
                                                           {"edges", edges},       {"tasks", tasks}};
  for (const auto& [input_name, input] : inputs)
    for (const auto& [output_name, output] : outputs) check_apart(op, output_name, output, input_name, input);
}

}  // namespace bigtri

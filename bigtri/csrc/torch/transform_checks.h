// Argument checks of the operator `transform`. CPU and CUDA share them: `device` is kCpu, or the CUDA device that all
// tensors must be on.
#pragma once

#include "checks.h"

namespace bigtri {

inline void check_transform(int device, const Tensor& points, const Tensor& matrices, const Tensor& out) {
  const char* op = "transform";
  check_on(op, "points", points, device, ScalarType::Float, {-1, 3}, "float32 [V, 3]");
  check_on(op, "matrices", matrices, device, ScalarType::Double, {-1, 4, 4}, "float64 [B, 4, 4]");
  check_on(op, "out", out, device, ScalarType::Float, {matrices.size(0), points.size(0), 4}, "float32 [B, V, 4]");
  check_apart(op, "out", out, "points", points);
  check_apart(op, "out", out, "matrices", matrices);
}

}  // namespace bigtri

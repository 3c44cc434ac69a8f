// Argument checks of rasterize. CPU and CUDA share them: `device` is kCpu, or the CUDA device that all tensors must be
// on.
#pragma once

#include <tuple>
#include <utility>

#include "checks.h"

namespace bigtri {

// Checks the inputs and returns the number of views. Positions [V, 4] are one view, whose outputs have no dimension for
// views; or with ranges, which are in host memory, as many views as there are ranges.
inline int32_t checked_views(int device, const Tensor& positions, const Tensor& triangles,
                             const std::optional<Tensor>& ranges) {
  const char* op = "rasterize";
  check_on(op, "triangles", triangles, device, ScalarType::Int, {-1, 3}, "int32 [T, 3]");
  const bool single = positions.defined() && positions.dim() == 2;
  if (ranges) {
    check(op, "ranges", *ranges, ScalarType::Int, {-1, 2}, "int32 [B, 2]");
    check_on(op, "positions", positions, device, ScalarType::Float, {-1, 4}, "float32 [V, 4], since there are ranges");
    const int32_t* r = const_data<int32_t>(*ranges);
    for (int64_t i = 0; i < ranges->size(0); ++i, r += 2)
      BIGTRI_CHECK(r[0] >= 0 && r[1] >= 0 && (int64_t)r[0] + r[1] <= triangles.size(0),
                   "bigtri::rasterize: ranges must be (first, count) within the ", triangles.size(0),
                   " triangles, got (", r[0], ", ", r[1], ") for view ", i);
  } else if (single) {
    check_on(op, "positions", positions, device, ScalarType::Float, {-1, 4}, "float32 [V, 4]");
  } else {
    check_on(op, "positions", positions, device, ScalarType::Float, {-1, -1, 4}, "float32 [V, 4] or [B, V, 4]");
  }
  const int64_t views = ranges ? ranges->size(0) : single ? 1 : positions.size(0);
  check_count(op, ranges ? "ranges" : "positions", views);
  return (int32_t)views;
}

// Checks memory that the caller gives for the results of so many views.
inline void check_results(int device, int64_t views, const Tensor& positions, const Tensor& triangles, int64_t height,
                          int64_t width, const std::optional<Tensor>& ranges, const Tensor& packed,
                          const std::optional<Tensor>& depth, const Tensor& dropped) {
  const char* op = "rasterize";
  if (positions.dim() == 2 && !ranges) {
    check_on(op, "packed", packed, device, ScalarType::Long, {height, width}, "int64 [height, width]");
    if (depth) check_on(op, "depth", *depth, device, ScalarType::Float, {height, width}, "float32 [height, width]");
    check_on(op, "dropped", dropped, device, ScalarType::Long, {}, "int64 []");
  } else {
    check_on(op, "packed", packed, device, ScalarType::Long, {views, height, width}, "int64 [B, height, width]");
    if (depth)
      check_on(op, "depth", *depth, device, ScalarType::Float, {views, height, width}, "float32 [B, height, width]");
    check_on(op, "dropped", dropped, device, ScalarType::Long, {views}, "int64 [B]");
  }
  for (const auto& [name, input] :
       {std::pair<const char*, const Tensor&>{"positions", positions}, {"triangles", triangles}}) {
    check_apart(op, "packed", packed, name, input);
    check_apart(op, "dropped", dropped, name, input);
    if (depth) check_apart(op, "depth", *depth, name, input);
  }
  if (ranges) {
    check_apart(op, "packed", packed, "ranges", *ranges);
    check_apart(op, "dropped", dropped, "ranges", *ranges);
    if (depth) check_apart(op, "depth", *depth, "ranges", *ranges);
  }
  check_apart(op, "dropped", dropped, "packed", packed);
  if (depth) check_apart(op, "depth", *depth, "packed", packed);
  if (depth) check_apart(op, "depth", *depth, "dropped", dropped);
}

using NewResults = std::tuple<Tensor, std::optional<Tensor>, Tensor>;  // packed, depth, dropped

// Memory for the results, on `device`, from inputs that are checked; for the number of triangles dropped, and for all.
inline Tensor new_dropped(int device, const Tensor& positions) {
  const int64_t views[] = {positions.size(0)};
  return empty(Sizes(views, positions.dim() == 2 ? 0 : 1), ScalarType::Long, device);
}
inline NewResults new_results(int device, const Tensor& positions, int64_t height, int64_t width, bool depth) {
  const int64_t shape[] = {positions.size(0), height, width};  // without the first where there is one view
  const size_t single = positions.dim() == 2 ? 1 : 0;
  const Sizes image(shape + single, 3 - single);
  NewResults made = {empty(image, ScalarType::Long, device), std::nullopt, new_dropped(device, positions)};
  if (depth) std::get<1>(made) = empty(image, ScalarType::Float, device);
  return made;
}

// Arguments that are part of the schema, but that no variant serves yet. docs/numerics.md 1 defines them.
inline void check_unserved(int64_t samples, const std::optional<Tensor>& behind) {
  BIGTRI_CHECK(samples == 1, "bigtri::rasterize: samples must be 1, the only number of samples a pixel so far, got ",
               samples);
  BIGTRI_CHECK(!behind,
               "bigtri::rasterize: behind must be None, since no variant draws the layer behind another yet, got ",
               describe(*behind));
}

}  // namespace bigtri

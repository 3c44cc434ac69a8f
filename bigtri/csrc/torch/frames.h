// Frames of tensors whose types, shapes and devices are checked, for all operators that draw. CPU and CUDA share them.
#pragma once

#include "checks.h"

namespace bigtri {

// What is drawn, with nothing yet to draw to. Positions are [V, 4] of one view or, with ranges, of all, else [B, V, 4].
inline Frame frame_of(const char* op, const Viewport& view, int32_t views, const Tensor& positions,
                      const Tensor& triangles, const std::optional<Tensor>& ranges = std::nullopt) {
  check_count(op, "triangles", triangles.size(0));
  Frame frame = {};
  frame.view = view;
  frame.views = views;
  frame.positions = const_data<float>(positions);
  frame.vertices = positions.size(-2);
  frame.view_stride = ranges ? 0 : frame.vertices * 4;
  frame.triangles = const_data<int32_t>(triangles);
  frame.count = (int32_t)triangles.size(0);
  frame.ranges = ranges ? const_data<int32_t>(*ranges) : nullptr;
  return frame;
}

// The same for the CPU. Throws if an index names no vertex, before anything is drawn.
inline CheckedFrame checked_frame(const char* op, const Parallel& parallel, const Viewport& view, int32_t views,
                                  const Tensor& positions, const Tensor& triangles,
                                  const std::optional<Tensor>& ranges = std::nullopt) {
  const Frame frame = frame_of(op, view, views, positions, triangles, ranges);
  const Indices indices = checked_indices(op, parallel, triangles, frame.vertices);
  return {frame, indices.lowest, indices.highest};
}

// What it is drawn to. packed: null where the caller has memory for it that is no tensor's, or needs none.
inline void set_results(Frame* frame, const Tensor* packed, const std::optional<Tensor>& depth, const Tensor& dropped) {
  frame->packed = packed ? data<int64_t>(*packed) : nullptr;
  frame->depth = depth ? data<float>(*depth) : nullptr;
  frame->dropped = data<int64_t>(dropped);
}

}  // namespace bigtri

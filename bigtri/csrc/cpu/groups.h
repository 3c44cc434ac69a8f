// Views in groups, whose vertices are projected together, before any triangle is set up: a vertex that triangles share is
// projected once. All variants draw group by group.
#pragma once

#include <algorithm>
#include <atomic>

#include "kernels.h"
#include "workspace.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// Vertices of a group, 16 bytes each. A group has one view at least, however many vertices that has.
constexpr int64_t kGroupVertices = 1 << 20;

// Vertices of a view, from the lowest index in use to the highest.
inline int64_t used_vertices(const CheckedFrame& frame) { return frame.count ? frame.highest - frame.lowest + 1 : 0; }

// The views of a group, as a frame.
struct ProjectedFrame : CheckedFrame {
  const Vertex* vertices;  // null where set-up projects corners
  int64_t vertex_view;  // vertices from one view to the next; 0 if all views share them
  bool any_clipped;  // whether a triangle may cross a clip plane
};

inline SetupJob setup_job(const ProjectedFrame& frame, int64_t view) {
  const Vertex* vertices = frame.vertices ? frame.vertices + view * frame.vertex_view : nullptr;
  return {view_of(frame, view), (int32_t)view, vertices, frame.lowest};
}

// Projects the vertices of a frame's views, those of one after the other's, to `vertices`. Returns the OR of their flags.
inline uint32_t project_views(const CheckedFrame& frame, const Parallel& parallel, Vertex* vertices) {
  const int64_t used = used_vertices(frame), meshes = frame.view_stride ? frame.views : 1;
  // The vertices of a view are projected in pieces, some 4 per thread in all.
  const int64_t pieces = std::clamp<int64_t>(4 * parallel.threads / meshes, 1, used / 4096 + 1);
  std::atomic<uint32_t> flags{0};
  parallel(meshes * pieces, [&](int64_t i) {
    const int64_t view = i / pieces, begin = used * (i % pieces) / pieces, end = used * (i % pieces + 1) / pieces;
    flags.fetch_or(current_kernels().setup.project(frame.positions + view * frame.view_stride, frame.lowest + begin,
                                                   frame.lowest + end, frame.view.width, frame.view.height,
                                                   vertices + view * used + begin),
                   std::memory_order_relaxed);
  });
  return flags.load();
}

// Calls body(first, group) for groups of views; view `first` is the group's first one. memory: for the vertices of a
// group. Where triangles have fewer corners than there are vertices, none is projected, and all views are one group.
template <class Body>
void each_group(const CheckedFrame& frame, const Parallel& parallel, Buffer* memory, Body body) {
  const int64_t used = used_vertices(frame), meshes = frame.view_stride ? frame.views : 1;
  const bool projects = used && meshes * used <= 3 * triangles_of_all(frame);
  const int64_t most = projects && frame.view_stride ? std::max<int64_t>(kGroupVertices / used, 1) : frame.views;
  for (int64_t first = 0; first < frame.views; first += most) {
    ProjectedFrame group = {frame, nullptr, frame.view_stride ? used : 0, true};
    static_cast<Frame&>(group) = views_of(frame, first, (int32_t)std::min(most, frame.views - first));
    if (projects) {
      Vertex* const vertices = memory->room<Vertex>((frame.view_stride ? group.views : 1) * used);
      group.any_clipped = project_views(group, parallel, vertices) & kOutsideMask;
      group.vertices = vertices;
    }
    body(first, group);
  }
}

// What the registry calls for a variant whose `kDraw` draws a group.
template <void (*kDraw)(const ProjectedFrame& frame, const Parallel& parallel, const int64_t* values)>
void draw_groups(const CheckedFrame& frame, const Parallel& parallel, const int64_t* values) {
  const KeptWorkspace workspace;
  each_group(frame, parallel, &(*workspace).vertices,
             [&](int64_t, const ProjectedFrame& group) { kDraw(group, parallel, values); });
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// Triangles to records on the GPU: a thread a triangle, a warp for one that has to be clipped.
#pragma once

#include "../core/record.h"
#include "frame.h"

namespace bigtri {
namespace {

constexpr unsigned kAllLanes = 0xffffffffu;
constexpr int kWarp = 32;

__device__ __forceinline__ int lane_id() { return threadIdx.x & (kWarp - 1); }
__device__ __forceinline__ unsigned lanes_below() { return (1u << lane_id()) - 1; }

// Corners of triangle t; false if it names a vertex that there is not.
__device__ __forceinline__ bool load_corners(const Frame& f, int32_t t, float v[3][4]) {
  const int32_t* index = f.triangles + 3 * (int64_t)t;
  const int64_t i[3] = {index[0], index[1], index[2]};
  for (int k = 0; k < 3; ++k)
    if (i[k] < 0 || i[k] >= f.vertices) return false;
  if (((uintptr_t)f.positions & 15) == 0) {
    const float4* p = reinterpret_cast<const float4*>(f.positions);
    for (int k = 0; k < 3; ++k) {
      const float4 q = __ldg(p + i[k]);
      v[k][0] = q.x, v[k][1] = q.y, v[k][2] = q.z, v[k][3] = q.w;
    }
  } else {
    for (int k = 0; k < 3; ++k)
      for (int m = 0; m < 4; ++m) v[k][m] = __ldg(f.positions + 4 * i[k] + m);
  }
  return true;
}

// What becomes of triangle t; kWhole if and only if *p is to be drawn, kClip if it has to be clipped first.
__device__ __forceinline__ Fate set_up(const Frame& f, int32_t t, Primitive* p) {
  float v[3][4];
  if (!load_corners(f, t, v)) return Fate::kDropped;
  uint32_t flags[3];
  for (int k = 0; k < 3; ++k) flags[k] = vertex_flags(v[k], f.view.width, f.view.height);
  const Fate fate = fate_of(flags[0], flags[1], flags[2]);
  if (fate != Fate::kWhole) return fate;
  int32_t x[3], y[3];
  float z[3];
  for (int k = 0; k < 3; ++k) {
    x[k] = snap_x(v[k][0], v[k][3], f.view.width);
    y[k] = snap_y(v[k][1], v[k][3], f.view.height);
    z[k] = window_depth<float>(v[k][2], v[k][3]);
  }
  return make_primitive(x, y, z, f.view, p) ? Fate::kWhole : Fate::kNothing;
}

// Shared memory of a warp that clips.
struct ClipScratch {
  ClipVertex slots[3], polygon[kWarp];  // weights are not used here
  Vertex projected[kWarp];
};
static_assert(kMaxPolygon <= kWarp, "a lane for every vertex of a polygon");

// Clips triangle t with all lanes, which hold a vertex of the polygon each: clip_triangle of core/clip.h, a plane at a time. Lane s gets sub-triangle s; false where it has no pixels.
__device__ __noinline__ bool clip_part(const Frame& f, int32_t t, ClipScratch* s, Primitive* out) {
  const int lane = lane_id(), width = f.view.width, height = f.view.height;
  float v[3][4];
  if (!load_corners(f, t, v)) return false;
  uint32_t outside = 0;
  for (int k = 0; k < 3; ++k) outside |= vertex_flags(v[k], width, height) & kOutsideMask;
  __syncwarp();
  if (lane < 3) {
    const int first = first_slot(v), corner = first + lane > 2 ? first + lane - 3 : first + lane;
    ClipVertex& slot = s->slots[lane];
    for (int i = 0; i < 4; ++i) slot.position[i] = corner == 0 ? v[0][i] : corner == 1 ? v[1][i] : v[2][i];
    slot.edges = (1u << lane) | (1u << (lane == 0 ? 2 : lane - 1));
    slot.made = 0;
    for (int i = 0; i < 3; ++i) slot.weights[i] = 0.0;
    s->polygon[lane] = slot;
  }
  int n = 3;
  for (int k = 0; k < kPlanes; ++k) {
    if (!(outside >> k & 1)) continue;
    const Plane plane = clip_plane(k, width, height);
    __syncwarp();
    bool inside = false, crosses = false;
    ClipVertex kept, made;
    if (lane < n) {
      const ClipVertex &a = s->polygon[lane], &b = s->polygon[lane + 1 == n ? 0 : lane + 1];
      inside = plane_distance(plane, a.position) >= 0;
      crosses = inside != (plane_distance(plane, b.position) >= 0);
      if (inside) kept = a;
      if (crosses) made = cut_edge(plane, k, s->slots, a, b);
    }
    const unsigned all_inside = __ballot_sync(kAllLanes, inside), all_crosses = __ballot_sync(kAllLanes, crosses);
    int at = __popc(all_inside & lanes_below()) + __popc(all_crosses & lanes_below());
    if (inside) s->polygon[at++] = kept;
    if (crosses) s->polygon[at] = made;
    n = __popc(all_inside) + __popc(all_crosses);
  }
  __syncwarp();
  if (n < 3) return false;
  if (__any_sync(kAllLanes, lane < n && !(s->polygon[lane].position[3] > 0))) return false;
  if (lane < n) s->projected[lane] = project_clipped(s->polygon[lane], width, height);
  __syncwarp();
  if (lane > n - 3) return false;
  return fan_primitive(s->projected, fan_apex(s->projected, s->polygon, n), n, lane, f.view, out);
}

}  // namespace
}  // namespace bigtri

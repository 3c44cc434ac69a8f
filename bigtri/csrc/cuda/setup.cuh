// Triangles to records on the GPU: a thread a triangle, a warp for one that has to be clipped.
#pragma once

#include <cuda_runtime.h>

#include "../core/record.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr unsigned kAllLanes = 0xffffffffu;
constexpr int kWarp = 32;

__device__ __forceinline__ int lane_id() { return threadIdx.x & (kWarp - 1); }
__device__ __forceinline__ unsigned lanes_below() { return (1u << lane_id()) - 1; }

// Over all lanes, which all get the result.
__device__ __forceinline__ unsigned warp_min(unsigned v) {
#if __CUDA_ARCH__ >= 800
  return __reduce_min_sync(kAllLanes, v);
#else
  for (int step = kWarp / 2; step; step /= 2) v = min_of(v, __shfl_xor_sync(kAllLanes, v, step));
  return v;
#endif
}

__device__ __forceinline__ void load_vertex(const Frame& f, int64_t i, float v[4]) {
  if (((uintptr_t)f.positions & 15) == 0) {
    const float4 q = __ldg(reinterpret_cast<const float4*>(f.positions) + i);
    v[0] = q.x, v[1] = q.y, v[2] = q.z, v[3] = q.w;
  } else {
    for (int m = 0; m < 4; ++m) v[m] = __ldg(f.positions + 4 * i + m);
  }
}

__device__ __forceinline__ Vertex load_and_project(const Frame& f, int64_t i) {
  float v[4];
  load_vertex(f, i, v);
  return project_vertex(v, f.view.width, f.view.height);
}

// Projects vertices first, first + step, ... of a thread, kEach at most, and calls put(vertex, where it is): all are
// loaded before the first is used.
template <int kEach, class Put>
__device__ __forceinline__ void project_vertices(const Frame& f, int64_t first, int step, const Put& put) {
  float v[kEach][4];
#pragma unroll
  for (int k = 0; k < kEach; ++k)
    if (first + k * step < f.vertices) load_vertex(f, first + k * step, v[k]);
#pragma unroll
  for (int k = 0; k < kEach; ++k)
    if (first + k * step < f.vertices) put(project_vertex(v[k], f.view.width, f.view.height), first + k * step);
}

// Vertices of triangle t; false if it names one that there is not.
__device__ __forceinline__ bool load_indices(const Frame& f, int32_t t, int32_t index[3]) {
  bool valid = true;
  for (int k = 0; k < 3; ++k) {
    index[k] = __ldg(f.triangles + 3 * (int64_t)t + k);
    valid = valid && index[k] >= 0 && index[k] < f.vertices;
  }
  return valid;
}

// What becomes of a triangle with these corners; kWhole if and only if *p is to be drawn, kClip if it has to be clipped
// first.
__device__ __forceinline__ Fate assemble(const Frame& f, const Vertex v[3], Primitive* p) {
  const Fate fate = fate_of(v[0].flags, v[1].flags, v[2].flags);
  if (fate != Fate::kWhole) return fate;
  const int32_t x[3] = {v[0].x, v[1].x, v[2].x}, y[3] = {v[0].y, v[1].y, v[2].y};
  const float z[3] = {v[0].z, v[1].z, v[2].z};
  return make_primitive(x, y, z, f.view, p) ? Fate::kWhole : Fate::kNothing;
}

// assemble() for triangle t. projected: all vertices, or null to project its own.
__device__ __forceinline__ Fate set_up(const Frame& f, int32_t t, const Vertex* projected, Primitive* p) {
  int32_t index[3];
  if (!load_indices(f, t, index)) return Fate::kDropped;
  Vertex v[3];
  if (projected) {
    for (int k = 0; k < 3; ++k) {
      const int4 q =
          reinterpret_cast<const int4*>(projected)[index[k]];  // not __ldg: the kernel in front may still write them
      v[k] = {q.x, q.y, __int_as_float(q.z), (uint32_t)q.w};
    }
  } else {
    float corner[3][4];
    for (int k = 0; k < 3; ++k) load_vertex(f, index[k], corner[k]);
    for (int k = 0; k < 3; ++k) v[k] = project_vertex(corner[k], f.view.width, f.view.height);
  }
  return assemble(f, v, p);
}

// Counts the lanes' triangles that are dropped. By all lanes.
__device__ __forceinline__ void count_dropped(const Frame& f, Fate fate) {
  const unsigned dropped = __ballot_sync(kAllLanes, fate == Fate::kDropped);
  if (dropped && lane_id() == 0)
    atomicAdd(reinterpret_cast<unsigned long long*>(f.dropped), (unsigned long long)__popc(dropped));
}

// The corners of all triangles, by `threads` threads: where triangles are few, three threads for one take a third of
// the time. An index that names no vertex makes its triangle one to drop.
__device__ __forceinline__ void project_corners(const Frame& f, Vertex* corners, int thread, int threads) {
  for (int c = thread; c < 3 * f.count; c += threads) {
    const int32_t index = __ldg(f.triangles + c);
    corners[c] = index >= 0 && index < f.vertices ? load_and_project(f, index) : Vertex{0, 0, 0.0f, kNonFinite};
  }
}

// Shared memory of a warp that clips.
struct ClipScratch {
  ClipVertex slots[3], polygon[kWarp];
  Vertex projected[kWarp];
};
static_assert(kMaxPolygon <= kWarp, "a lane for every vertex of a polygon");

// Clips a triangle with all lanes, which hold a vertex of the polygon each: clip_triangle of core/clip.h, a plane at a
// time. Returns the number of vertices, projected too, or 0 if nothing is left.
__device__ __forceinline__ int clip_polygon(const float v[3][4], int width, int height, ClipScratch* s) {
  const int lane = lane_id();
  uint32_t outside = 0;
  for (int k = 0; k < 3; ++k) outside |= vertex_flags(v[k], width, height) & kOutsideMask;
  __syncwarp();
  if (lane < 3) s->polygon[lane] = s->slots[lane] = make_slot(v, first_slot(v), lane);
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
    __syncwarp();  // all have read
    int at = __popc(all_inside & lanes_below()) + __popc(all_crosses & lanes_below());
    if (inside) s->polygon[at++] = kept;
    if (crosses) s->polygon[at] = made;
    n = __popc(all_inside) + __popc(all_crosses);
  }
  __syncwarp();
  if (n < 3) return 0;
  if (__any_sync(kAllLanes, lane < n && !(s->polygon[lane].position[3] > 0))) return 0;
  if (lane < n) s->projected[lane] = project_clipped(s->polygon[lane], width, height);
  __syncwarp();
  return n;
}

// Clips triangle t with all lanes. Lane s gets sub-triangle s; false where it has no pixels.
__device__ __noinline__ bool clip_part(const Frame& f, int32_t t, ClipScratch* s, Primitive* out) {
  int32_t index[3];
  if (!load_indices(f, t, index)) return false;
  float v[3][4];
  for (int k = 0; k < 3; ++k) load_vertex(f, index[k], v[k]);
  const int n = clip_polygon(v, f.view.width, f.view.height, s);
  if (lane_id() > n - 3) return false;
  return fan_primitive(s->projected, fan_apex(s->projected, s->polygon, n), n, lane_id(), f.view, out);
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// Triangles to primitives on the GPU.
#pragma once

#include <cuda_runtime.h>

#include "../core/record.h"
#include "../core/resolve.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr unsigned kAllLanes = 0xffffffffu;
constexpr int kWarp = 32;

__device__ __forceinline__ int lane_id() {
  int lane;
  asm("mov.u32 %0, %%laneid;" : "=r"(lane));
  return lane;
}
__device__ __forceinline__ int this_warp() { return (int)(threadIdx.x / kWarp); }
__device__ __forceinline__ unsigned lanes_below() {
  unsigned lanes;
  asm("mov.u32 %0, %%lanemask_lt;" : "=r"(lanes));
  return lanes;
}

// The same number, which the compiler can compute nothing from before this place: what would wait in a register, or out
// of one, while a region is drawn.
__device__ __forceinline__ int computed_here(int v) {
  asm volatile("" : "+r"(v));
  return v;
}

// A pointer that the compiler keeps in registers instead of computing it anew wherever it is used.
template <class T>
__device__ __forceinline__ T* kept(T* p) {
  asm volatile("" : "+l"(p));
  return p;
}

// A value in memory, read again instead of kept in a register.
template <class T>
__device__ __forceinline__ T reread(const T& v) {
  return *const_cast<const volatile T*>(&v);
}

// Over all lanes, which all get the result.
__device__ __forceinline__ unsigned warp_min(unsigned v) {
#if __CUDA_ARCH__ >= 800
  return __reduce_min_sync(kAllLanes, v);
#else
  for (int step = kWarp / 2; step; step /= 2) v = min_of(v, __shfl_xor_sync(kAllLanes, v, step));
  return v;
#endif
}

// The bits that any lane has.
__device__ __forceinline__ unsigned warp_or(unsigned v) {
#if __CUDA_ARCH__ >= 800
  return __reduce_or_sync(kAllLanes, v);
#else
  for (int step = kWarp / 2; step; step /= 2) v |= __shfl_xor_sync(kAllLanes, v, step);
  return v;
#endif
}

// The sum of the lanes' numbers, which all lanes get.
__device__ __forceinline__ int warp_sum(int v) {
#if __CUDA_ARCH__ >= 800
  return __reduce_add_sync(kAllLanes, v);
#else
  for (int step = kWarp / 2; step; step /= 2) v += __shfl_xor_sync(kAllLanes, v, step);
  return v;
#endif
}

// The sum of the lanes' numbers up to this lane's own.
__device__ __forceinline__ int warp_sum_up_to(int v) {
  for (int step = 1; step < kWarp; step *= 2) {
    const int other = __shfl_up_sync(kAllLanes, v, step);
    if (lane_id() >= step) v += other;
  }
  return v;
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

// 16 bytes at once.
__device__ __forceinline__ void store_vertex(const Vertex& v, Vertex* to) {
  *reinterpret_cast<int4*>(to) = make_int4(v.x, v.y, __float_as_int(v.z), (int)v.flags);
}

// Projects vertices first, first + step, ... below `end` of a thread, kEach at most, and calls put(vertex, where it
// is): all are loaded before the first is used.
template <int kEach, class Put>
__device__ __forceinline__ void project_vertices(const Frame& f, int64_t first, int step, int64_t end, const Put& put) {
  float v[kEach][4];
#pragma unroll
  for (int k = 0; k < kEach; ++k)
    if (first + k * step < end) load_vertex(f, first + k * step, v[k]);
#pragma unroll
  for (int k = 0; k < kEach; ++k)
    if (first + k * step < end) put(project_vertex(v[k], f.view.width, f.view.height), first + k * step);
}

// Vertices that an index can name: none reaches beyond int32, and a negative one is large as a uint32.
__device__ __forceinline__ uint32_t nameable_vertices(const Frame& f) {
  return (uint32_t)min_of<int64_t>(f.vertices, (int64_t)INT32_MAX + 1);
}

// Vertices of triangle t; false if it names one that there is not.
__device__ __forceinline__ bool load_indices(const Frame& f, int32_t t, int32_t index[3]) {
  const uint32_t vertices = nameable_vertices(f);
  bool valid = true;
  for (int k = 0; k < 3; ++k) {
    index[k] = __ldg(f.triangles + 3 * (int64_t)t + k);
    valid &= (uint32_t)index[k] < vertices;
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

// assemble() for triangle t, by one thread.
__device__ __forceinline__ Fate set_up(const Frame& f, int32_t t, Primitive* p) {
  int32_t index[3];
  if (!load_indices(f, t, index)) return Fate::kDropped;
  float corner[3][4];
  for (int k = 0; k < 3; ++k) load_vertex(f, index[k], corner[k]);
  Vertex v[3];
  for (int k = 0; k < 3; ++k) v[k] = project_vertex(corner[k], f.view.width, f.view.height);
  const Fate fate = assemble(f, v, p);
  if (fate == Fate::kWhole) set_places(corner, f.view, p->order, p);
  return fate;
}

// Sets the places of a primitive of triangle t, which assemble() made of vertices that it knows projected only, from the
// vertices themselves. first_vertex: of its view.
__device__ __forceinline__ void load_places(const Frame& f, int64_t first_vertex, int32_t t, Primitive* p) {
  int32_t index[3];
  load_indices(f, t, index);
  float v[3][4];
  for (int k = 0; k < 3; ++k) load_vertex(f, first_vertex + pick(index, p->order[k]), v[k]);
  const int32_t in_order[3] = {0, 1, 2};
  set_places(v, f.view, in_order, p);
}

// Whether a triangle may cover a pixel centre, at a fraction of what set-up costs: most triangles of a mesh that is far
// away do not. Never false of one that does, or that is to be clipped or dropped.
__device__ __forceinline__ bool may_show(const Viewport& view, const Vertex v[3]) {
  if ((v[0].flags | v[1].flags | v[2].flags) & ~kScreenMask) return true;
  const int32_t x[3] = {v[0].x, v[1].x, v[2].x}, y[3] = {v[0].y, v[1].y, v[2].y};
  const PixelBox box = pixel_box(x, y, view);
  return box.x0 < box.x1 && box.y0 < box.y1;
}

// The corners of all triangles, by `threads` threads: where triangles are few, three threads for one take a third of
// the time. An index that names no vertex makes its triangle one to drop.
__device__ __forceinline__ void project_corners(const Frame& f, Vertex* corners, int thread, int threads) {
  for (int c = thread; c < 3 * f.count; c += threads) {
    const int32_t index = __ldg(f.triangles + c);
    corners[c] = index >= 0 && index < f.vertices ? load_and_project(f, index) : Vertex{0, 0, 0.0f, kNonFinite};
  }
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

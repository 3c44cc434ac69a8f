// Counting a kernel's work (core/counters.h). In builds without BIGTRI_COUNTING the functions are empty and cost nothing; in
// those with it each call is an atomic addition or several, so that they tell nothing about time.
#pragma once

#include <cuda_runtime.h>

#include "../core/numerics.h"
#include "counted_work.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

#if defined(BIGTRI_COUNTING)
constexpr bool kCounts = true;

__device__ __forceinline__ void add_work(int64_t* to, int64_t n) {
  atomicAdd(reinterpret_cast<unsigned long long*>(to), (unsigned long long)n);
}
__device__ __forceinline__ void count_work(const Frame& f, Counter counter, int64_t n) {
  if (n && f.counted) add_work(f.counted->counters + (int)counter, n);
}
// One that is offered to pixel (x, y) of the image, by this block.
__device__ __forceinline__ void count_fragment(const Frame& f, int x, int y) {
  if (!f.counted) return;
  const CountedWork& work = *f.counted;
  add_work(work.counters + (int)Counter::fragments, 1);
  add_work(work.fragments + y * CountedWork::columns(f.view.width) + x, 1);
  if (blockIdx.x < work.room) add_work(work.blocks + blockIdx.x, 1);
}

// A pixel, and the frame whose first view it is in: what is given pixels instead of a frame counts by it.
struct FramePixel {
  int64_t* at;
  const Frame* frame;

  __device__ __forceinline__ FramePixel operator+(int64_t n) const { return {at + n, frame}; }
};
__device__ __forceinline__ FramePixel frame_pixel(const Frame& f, int64_t* at) { return {at, &f}; }
__device__ __forceinline__ FramePixel frame_pixel(const FramePixel& other, int64_t* at) { return {at, other.frame}; }
__device__ __forceinline__ int64_t* place_of(const FramePixel& p) { return p.at; }
__device__ __forceinline__ FramePixel kept(const FramePixel& p) { return p; }
__device__ __forceinline__ void count_work(const FramePixel& p, Counter counter, int64_t n) {
  count_work(*p.frame, counter, n);
}
__device__ __forceinline__ void count_fragment(const FramePixel& p) {
  const int64_t n = p.at - p.frame->packed;
  count_fragment(*p.frame, (int)(n % p.frame->view.width), (int)(n / p.frame->view.width));
}
// The twin of the one in fragment.cuh.
__device__ __forceinline__ void keep_nearest(const FramePixel& p, int64_t packed, bool read_first) {
  if (read_first && __ldcg(p.at) <= packed) return;
  count_work(*p.frame, Counter::atomics, 1);
  const bool nearer = packed < atomicMin(reinterpret_cast<long long*>(p.at), (long long)packed);
  count_work(*p.frame, Counter::passed, nearer);
  count_work(*p.frame, Counter::written, nearer);
}
#else
constexpr bool kCounts = false;
__device__ __forceinline__ void count_work(const Frame&, Counter, int64_t) {}
__device__ __forceinline__ void count_fragment(const Frame&, int, int) {}
using FramePixel = int64_t*;
__device__ __forceinline__ FramePixel frame_pixel(const Frame&, int64_t* at) { return at; }
__device__ __forceinline__ FramePixel frame_pixel(const int64_t*, int64_t* at) { return at; }
__device__ __forceinline__ int64_t* place_of(int64_t* p) { return p; }
__device__ __forceinline__ void count_work(const int64_t*, Counter, int64_t) {}
__device__ __forceinline__ void count_fragment(const int64_t*) {}
#endif

__device__ __forceinline__ FramePixel first_pixel(const Frame& f, int64_t view) {
  return frame_pixel(f, pixels_of(f, view));
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

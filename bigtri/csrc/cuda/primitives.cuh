// A warp's triangles to primitives, a lane each: for the variants that draw what they have set up at once.
#pragma once

#include "clip.cuh"
#include "launch.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// Adds triangles to a view's number of those dropped. By all lanes. Rarely called.
__device__ __noinline__ void count_dropped(const Frame& f, int32_t view, unsigned dropped) {
  wait_for_previous();
  if (lane_id() == 0)
    atomicAdd(reinterpret_cast<unsigned long long*>(f.dropped + view), (unsigned long long)__popc(dropped));
}

// Sets up triangle first + lane, of `count` triangles, 32 at most, of the only view of a frame, and counts those that are
// dropped. By all lanes, after the kernel in front has ended.
__device__ __forceinline__ Fate set_up_lanes(const Frame& f, int64_t first, int count, Primitive* p) {
  const Fate fate = lane_id() < count ? set_up(f, (int32_t)(first + lane_id()), p) : Fate::kNothing;
  if (const unsigned dropped = __ballot_sync(kAllLanes, fate == Fate::kDropped)) count_dropped(f, 0, dropped);
  return fate;
}

// The parts of a triangle that has to be clipped, a lane each; false where this lane has none. By all lanes.
__device__ __forceinline__ bool clip_lanes(const Frame& f, int64_t triangle, ClipScratch* clip, Primitive* part) {
  __syncwarp();
  const bool have = clip_part(f, 0, (int32_t)triangle, clip, part);
  __syncwarp();
  return have;
}

// Puts the lanes' primitives as records into shared memory, and returns how many; have: whether this lane has one. By all
// lanes.
__device__ __forceinline__ int put_records(bool have, const Primitive& p, int64_t triangle, Record* records) {
  const unsigned all = __ballot_sync(kAllLanes, have);
  if (have) fill_record(p, triangle, records + __popc(all & lanes_below()));
  return __popc(all);
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

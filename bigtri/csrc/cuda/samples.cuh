// Whether large triangles wait for blocks that own pixels: blocks find out together how many pixels theirs have, and those of
// a team agree.
#pragma once

#include "launch.cuh"
#include "ways.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// This block's place in its team.
struct Team {
  int log_size, member;

  static __device__ __forceinline__ Team of_block(int log_size) {
    return {log_size, (int)(blockIdx.x & ((1u << log_size) - 1))};
  }
  __device__ __forceinline__ bool first() const { return member == 0; }
  // Whether this lane's triangle is in the block's own part of the group: its sample, and what it clips or lets wait.
  __device__ __forceinline__ bool own() const { return (lane_id() / kOfSample & ((1 << log_size) - 1)) == member; }
};
constexpr uint32_t kByRows = 1, kWait = 2;  // RowLimits::decisions

// Adds what a warp's large triangles cover to the samples, and says whether to let them wait. Where they are small they are
// drawn at once; the others wait for the kernels in front, and meanwhile more samples are added. The blocks of a team have to
// agree: what the first of them finds holds for all. By all lanes. Rarely called, so that its registers cost the others
// nothing. A team would lie in local memory, which costs a kernel 5,000 cycles before its first load; its size does not.
__device__ __noinline__ bool large_ones_wait(const RowLimits& limits, int log_team, int pixels) {
  const Team team = Team::of_block(log_team);
  const int all = warp_sum(pixels), own = warp_sum(team.own() ? pixels : 0);
  if (lane_id() == 0 && own > 0)
    atomicAdd(reinterpret_cast<unsigned long long*>(limits.samples), (1ull << kPixelBits) + (unsigned long long)own);
  if (all <= limits.most_at_once) return false;
  wait_for_previous();
  bool many = false;
  if (lane_id() == 0) {
    const uint64_t samples = reread(*limits.samples), count = samples >> kPixelBits;
    many = (samples & ((1ull << kPixelBits) - 1)) > count * (uint64_t)limits.most_large;
    if (log_team > 0) {
      const uint32_t before = atomicCAS(limits.decisions + (blockIdx.x >> log_team), 0u, many ? kWait : kByRows);
      if (before) many = before == kWait;
    }
  }
  return __shfl_sync(kAllLanes, many, 0);
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

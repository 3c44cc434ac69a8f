// The last turns, where all warps of the device take triangles of a list in turns: only some warps have one, and some are
// done sooner than others. A warp of whose triangles nearly all show offers its own, draws its whole turns, and then the
// last turns of whoever is behind. Where few show, warps offer nothing and look for nothing, which would cost more.
#pragma once

#include "primitives.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr int kStreak = 2;  // turns in a row of which nearly all has to show, for the next ones will be like them

// Triangles of all warps together.
__device__ __forceinline__ int32_t in_turn(const Sharing& s) {
  return (int32_t)s.blocks * block_threads(Way::kAllOrFew);
}
__device__ __forceinline__ int32_t in_whole_turns(const Sharing& s) { return in_turn(s) * s.turns; }
// How many warps have one more.
__device__ __forceinline__ int32_t last_turns(const Sharing& s, int32_t triangles) {
  return (triangles - in_whole_turns(s) + kWarp - 1) / kWarp;
}

// Lets others have the warp's last turn, if it has one and has not begun with it. By one lane.
__device__ __noinline__ void offer_last_turn(const Sharing& s, int32_t triangles, Search* search) {
  const int32_t until = in_whole_turns(s), own = search->next % in_turn(s) / kWarp;
  if (search->next > until + own * kWarp || own >= last_turns(s, triangles)) return;
  search->offers = true;
  search->until = until;
  search->own = own;
  atomicExch(s.last_turns.with + own, (uint32_t)LastTurns::kOffered);
}

// Takes a last turn: the warp's own, if nobody else has it, else another one's. Returns its first triangle; `triangles` if
// there is none. By one lane.
__device__ __noinline__ int32_t take_last_turn(const Sharing& s, int32_t triangles, Search* search) {
  const int32_t all = last_turns(s, triangles);
  int32_t turn = search->own;
  search->own = all;
  for (;;) {
    if (turn < all) {
      const uint32_t was =
          atomicCAS(s.last_turns.with + turn, (uint32_t)LastTurns::kOffered, (uint32_t)LastTurns::kTaken);
      if (was == LastTurns::kOffered) break;
      if (was == LastTurns::kOwn) return triangles;  // mostly few show: there are hardly any to be had
    }
    turn = (int32_t)atomicAdd(s.last_turns.looked_at, 1u);
    if (turn >= all) return triangles;
  }
  const int32_t first = in_whole_turns(s) + turn * kWarp;
  search->until = min_of(triangles - first, kWarp) + first;
  return first;
}

// Goes on behind a turn drawn as it was, of which so many showed: to the next one, or to testing, or to a last one. By one
// lane.
__device__ __forceinline__ void next_turn(const Sharing& s, int32_t step, int32_t triangles, int shown,
                                          Search* search) {
  if (search->offers) {
    search->next += min_of(step, search->until - search->next);
  } else {
    search->next += min_of(step, triangles - search->next);
    search->test = shown < kMostlyShown;
    search->streak = search->test ? 0 : search->streak + 1;
    if (search->streak == kStreak && s.last_turns.with) offer_last_turn(s, triangles, search);
  }
  if (search->offers && search->next >= search->until) search->next = take_last_turn(s, triangles, search);
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// The last turns, where all warps of the device take triangles of a list in turns. A multiprocessor's schedulers prefer the
// warps in its first places: these are done after two thirds of the time of those in the last ones. So a warp in a late place
// of whose triangles nearly all show gives its last turns away, in pieces, and the warps in early places draw them when they
// are done with their own. Where few show, which is over sooner, warps give nothing and look for nothing.
#pragma once

#include "primitives.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr int kStreak = 2;  // turns in a row of which nearly all has to show, for the next ones will be like them

// Pieces that a warp gives away, by its place among those of the multiprocessor: as many as make all end together, as
// measured where there are eight turns and a piece is one of them. No result depends on it, nor on where a warp is.
__device__ __forceinline__ int pieces_to_give() {
  const int place = place_of_warp() / block_warps(Way::kAllOrFew);
  return place >= 7 ? 2 : place >= 5 ? 1 : 0;
}

// Gives away what the warp would have drawn last; it keeps one turn at least. What finds no room, or comes when somebody has
// looked there in vain, is not given. By one lane. Rarely called, so that its registers cost the others nothing.
__device__ __noinline__ void give_last_turns(const LastTurns& s, int32_t step, Search* search) {
  for (int pieces = s.pieces ? pieces_to_give() : 0; pieces > 0; --pieces) {
    const int32_t turns = (search->until - search->next - 1) / step + 1;
    if (turns <= s.turns) return;
    const int32_t first = search->next + (turns - s.turns) * step;
    const uint32_t at = atomicAdd(s.given, 1u);
    if (at >= s.room || atomicCAS(s.pieces + at, LastTurns::kNone, (uint32_t)first + 1) != LastTurns::kNone) return;
    search->until = first;
    search->gave = at + 1;
  }
}

// Takes a piece, if there is one. Who has given some looks until all of them are taken, for there may be nobody else who
// does. By one lane, as above.
__device__ __noinline__ bool take_last_turns(const LastTurns& s, int32_t step, int32_t triangles, Search* search) {
  if (!s.pieces) return false;
  const bool gave = search->gave > 0;
  if (!gave && (search->streak < kStreak || pieces_to_give() > 0)) return false;
  while (!gave || search->gave > reread(*s.taken)) {
    const uint32_t at = atomicAdd(s.taken, 1u);
    if (at >= s.room) return false;
    const uint32_t piece = atomicExch(s.pieces + at, LastTurns::kClosed);
    if (piece != LastTurns::kNone) {
      search->next = (int32_t)(piece - 1);
      search->until = search->next + min_of(triangles - search->next, (s.turns - 1) * step + kWarp);
      return true;
    }
    if (!gave) return false;
  }
  return false;
}

// Triangles from one of a warp's turns to its next.
__device__ __forceinline__ int32_t turn_step(const Sharing& s) {
  return (int32_t)s.blocks * block_threads(Way::kAllOrFew);
}

// Goes on behind a turn drawn as it was, of which so many showed: to the next one, or to testing. By one lane.
__device__ __forceinline__ void next_turn(const Sharing& s, int shown, Search* search) {
  search->next += min_of(turn_step(s), search->until - search->next);
  search->test = shown < kMostlyShown;
  search->streak = search->test ? 0 : search->streak + 1;
  if (search->streak == kStreak) give_last_turns(s.last_turns, turn_step(s), search);
}

// Whether there is a piece to go on with, behind the last turn. By all lanes.
__device__ __forceinline__ bool goes_on_with_others(const Frame& f, const Sharing& s, Search* search) {
  bool more = false;
  if (lane_id() == 0) more = take_last_turns(s.last_turns, turn_step(s), f.count, search);
  __syncwarp();
  return __any_sync(kAllLanes, more);
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

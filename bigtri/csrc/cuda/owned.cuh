// A warp's 16x16 px and the records that a list names for them, 32 at a time: for the variants that group what they draw by
// the tiles that own it, and write each pixel once.
#pragma once

#include "bin_queues.cuh"
#include "region.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// Over all lanes, which all get the result. Of floats >= 0.
__device__ __forceinline__ float warp_farthest(float v) { return bits_float(~warp_min(~float_bits(v))); }

// Calls draw(), which draws a record on the region, and counts the lane's pixels that it makes nearer.
template <class Draw>
__device__ __forceinline__ void count_passed(const Frame& f, const Region& region, const Draw& draw) {
  if constexpr (kCounts) {
    const Region before = region;
    draw();
    for (int n = 0; n < Region::kPixels; ++n) count_work(f, Counter::passed, region.best[n] < before.best[n]);
  } else {
    draw();
  }
}

// Draws what `slot(i)` names, 0 <= i < count, on the region. early_z: what lies behind all that is in the region is left
// out, before its pixels are looked at. By all lanes; entries: in shared memory, the warp's own.
template <class Slot>
__device__ __forceinline__ void draw_listed(const Frame& f, const Record* records, int count, bool early_z,
                                            Region* region, Entry entries[kWarp], const Slot& slot) {
  for (int base = 0; base < count; base += kWarp) {
    const int i = base + lane_id();
    Meeting m;
    m.nearest = kNotANumber;
    m.farthest = kInfinity;
    uint32_t its = 0;
    if (i < count) {
      its = slot(i);
      m = meet(records[its], its, region->left / kBin, region->top / kBin, region->x(), region->y(), kRegion, kRegion);
      count_meeting(f, m, Counter::tiles_tested, Counter::tiles_rejected, Counter::tiles_accepted);
    }
    if (early_z) region->bound = min_of(region->bound, bits_float(warp_min(float_bits(m.farthest))));
    const bool seen = m.meets() && m.nearest <= region->bound;
    count_work(f, Counter::tiles_hidden, m.meets() && !seen);
    const unsigned all = __ballot_sync(kAllLanes, seen);
    __syncwarp();  // all have drawn the entries before these
    if (seen) m.make_entry(records[its], entries + __popc(all & lanes_below()));
    count_work(f, Counter::edges_32, seen && !(m.info & Entry::kEntryFull) ? 3 * kRegion * kRegion : 0);
    __syncwarp();
    for (int k = 0; kCounts && k < __popc(all); ++k) count_fragments(f, *region, region->cut, entries[k]);
    for (int k = 0; k < __popc(all); ++k) {
      count_passed(f, *region, [&] { region->draw(entries[k], entries[k].info & Entry::kEntryFull, false, records); });
    }
    if (!early_z || !all) continue;
    float farthest = 0.0f;
    for (int n = 0; n < Region::kPixels; ++n) farthest = max_of(farthest, depth_of(region->best[n]));
    region->bound = min_of(region->bound, warp_farthest(farthest));
  }
}

// A region whose first pixel is (left, top), with what the frame has there if others have drawn in it, before anything is
// drawn in the region.
__device__ __forceinline__ void begin_region(const Frame& f, int left, int top, bool others, Region* region) {
  region->left = left;
  region->top = top;
  region->bound = kInfinity;
  region->clear();
  if (others) region->load(f);
  region->begin(f);
}

__device__ __forceinline__ void store_region(const Frame& f, const Region& region) {
  region.store(f);
  if constexpr (kCounts) region.each(f, [&](int, uint32_t) { count_work(f, Counter::written, 1); });
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

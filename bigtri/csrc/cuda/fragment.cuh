// What every way to draw shares: a record within one bin, and the atomic minimum on a pixel.
#pragma once

#include "../core/pair_depth.h"
#include "../core/pixel_depth.h"
#include "counting.cuh"
#include "setup.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// One lane's, for all.
__device__ __forceinline__ BinBox of_lane(const BinBox& b, int lane) {
  return {__shfl_sync(kAllLanes, b.x, lane), __shfl_sync(kAllLanes, b.y, lane), __shfl_sync(kAllLanes, b.columns, lane),
          __shfl_sync(kAllLanes, b.count, lane)};
}

// Copies the warp's record to where it waits. By all lanes.
__device__ __forceinline__ void copy_record(Record* to, const Record& from) {
  constexpr int kWords = sizeof(Record) / sizeof(uint32_t);
  static_assert(kWords <= kWarp, "a lane a word");
  if (lane_id() < kWords)
    reinterpret_cast<uint32_t*>(to)[lane_id()] = reinterpret_cast<const uint32_t*>(&from)[lane_id()];
}

// False if an edge rejects the bin.
__device__ __forceinline__ bool narrow_edges(const Record& r, int bin_x, int bin_y, NarrowEdge edge[3]) {
  for (int k = 0; k < 3; ++k) {
    const BinEdge b = bin_edge(edge_of(r.x, r.y, k), bin_x, bin_y);
    if (b.highest < 0) return false;
    edge[k] = narrow(b);
  }
  return true;
}

__device__ __forceinline__ CellPlane cell_plane(const Record& r, int bin_x, int bin_y) {
  return {depth_at(r.x, r.y, r.z, r.area, bin_x * kBin, bin_y * kBin), r.dzdx, r.dzdy};
}

// What info says, a member of E.
template <class E>
struct EntryFlags {
  __device__ __forceinline__ uint32_t bits() const { return static_cast<const E*>(this)->info; }
  __device__ __forceinline__ bool thin() const { return kKnowsThin && (bits() & kRecordThin); }
  __device__ __forceinline__ bool far() const { return bits() & kRecordFar; }
  // Covers all of the area, and finish_depth changes nothing there.
  __device__ __forceinline__ bool alone() const { return (~bits() & (kEntryFull | kEntryPlain)) == 0; }
  __device__ __forceinline__ uint32_t slot() const { return bits() >> 5; }
  __device__ __forceinline__ bool plain() const { return bits() & kEntryPlain; }
  static constexpr uint32_t kEntryFull = 8, kEntryPlain = 16;
};

// A record within one bin.
struct Entry : EntryFlags<Entry> {
  CellPlane plane;
  NarrowEdge edge[3];  // from the bin's first pixel
  float zmin, zmax;
  uint32_t triangle;
  // Slot of the record << 5 | whether finish_depth changes nothing but the type of its plane in the area entered for <<
  // 4 | whether it covers that << 3 | its flags.
  uint32_t info;
  float nearest;  // depth in that area
};
// The same in the bin of a patch where float64 is slow.
struct PairEntry : EntryFlags<PairEntry> {
  FloatPair z, dzdx, dzdy;  // plane(), in pieces that leave no gaps
  NarrowEdge edge[3];
  float zmin, zmax;
  uint32_t triangle;
  uint32_t info;
  float error;

  __device__ __forceinline__ PairPlane plane() const { return {z, dzdx, dzdy, error}; }
};
using PatchEntry = std::conditional_t<kPairDepth, PairEntry, Entry>;
static_assert(sizeof(PatchEntry) == sizeof(Entry), "the host, which knows the latter, gives shared memory");
static_assert(kRecordLarge < 8 && kRecordThin < 8 && kRecordFar < 8, "flags fit beside the slot");

// What a record and an area of a bin have to do with each other. Anchor: what it knows of the plane.
template <class Anchor>
struct MeetingOf {
  float nearest;  // the record's nearest depth there; NaN where they do not meet, which is not nearer than anything
  float farthest;  // the farthest one where it covers all of the area and so hides what lies behind, else infinity
  uint32_t info;  // Entry::info
  uint32_t constant;
  int32_t f[3];  // of its edges in the bin, with steps of 0 where bit k of `constant` says so: NarrowEdge
  Anchor anchor;

  __device__ __forceinline__ bool meets() const { return nearest == nearest; }
  __device__ __forceinline__ uint32_t slot() const { return info >> 5; }
  __device__ __forceinline__ void set_plane(const Record& r, Entry* e) const { e->plane = {anchor, r.dzdx, r.dzdy}; }
  __device__ __forceinline__ void set_plane(const Record&, PairEntry* e) const {
    e->z = anchor.z;
    e->dzdx = anchor.dzdx;
    e->dzdy = anchor.dzdy;
    e->error = anchor.error;
  }
  __device__ __forceinline__ void set_nearest(Entry* e) const { e->nearest = nearest; }
  __device__ __forceinline__ void set_nearest(PairEntry*) const {}
  template <class E>
  __device__ __forceinline__ void make_entry(const Record& r, E* e) const {
    set_plane(r, e);
    for (int k = 0; k < 3; ++k) {
      const Edge edge = edge_of(r.x, r.y, k);
      const bool steps = !(constant >> k & 1);
      e->edge[k] = {f[k], steps ? -edge.dy : 0, steps ? edge.dx : 0};
    }
    e->zmin = r.zmin;
    e->zmax = r.zmax;
    e->triangle = r.triangle;
    e->info = info;
    set_nearest(e);
  }
};
using Meeting = MeetingOf<DepthNumber>;  // zcell
using PairMeeting = MeetingOf<PairPlane>;
using PatchMeeting = std::conditional_t<kPairDepth, PairMeeting, Meeting>;

// What edge k adds to a meeting. Returns the edge's value at the bin's first pixel.
template <class M>
__device__ __forceinline__ int64_t meet_edge(const Record& r, int k, int bin_x, int bin_y, int left, int top,
                                             int columns, int rows, M* m, bool* meets, bool* full) {
  const Edge edge = edge_of(r.x, r.y, k);
  const int64_t value = edge_value(edge, pixel_centre(bin_x * kBin), pixel_centre(bin_y * kBin));
  const int64_t f = steps_of(value, edge);
  const int32_t sx = -edge.dy, sy = edge.dx;
  const int64_t first = f + (left * sx + top * sy);  // below 2^31, as in binning.h
  *meets &= highest_of(first, sx, sy, columns - 1, rows - 1) >= 0;
  *full &= lowest_of(first, sx, sy, columns - 1, rows - 1) >= 0;
  const bool inside = lowest_of(f, sx, sy, kBin - 1) >= 0;
  m->constant |= inside ? 1u << k : 0;
  m->f[k] = inside ? 0 : (int32_t)f;
  return value;
}

// What the plane's extremes over the area make of it.
template <class M, class Z>
__device__ __forceinline__ void finish_meeting(const Record& r, uint32_t slot, bool meets, bool full, Z nearest,
                                               Z farthest, M* m) {
  const bool thin = is_thin(r), hides = full && !(r.flags & kRecordFar);
  const bool plain = !thin && r.zmin > 0.0f && r.zmax <= 1.0f && (float)nearest >= r.zmin && (float)farthest <= r.zmax;
  m->nearest = !meets ? kNotANumber : thin ? r.zmin : finish_depth(nearest, r.zmin, r.zmax);
  m->farthest = !hides ? kInfinity : thin ? r.zmax : finish_depth(farthest, r.zmin, r.zmax);
  m->info = slot << 5 | (plain ? Entry::kEntryPlain : 0) | (full ? Entry::kEntryFull : 0) | r.flags;
}

// Of the record in a slot and the area of a bin, px from the bin's corner. Extremes in int64: an edge far away does not
// fit 32 bits; one that crosses the bin does. Without branches: the edges and the depth are independent of each other,
// and what takes time here is waiting for one result after the other.
//
// nearest and farthest bound every pixel of the area as computed, in whatever the rung's planes are: core/depth.h has
// the proof. What makes them depths, a rounding to float32 and the clamp, is monotone too. So where they lie within
// [zmin, zmax], the clamp changes no pixel between them.
__device__ __forceinline__ Meeting meet(const Record& r, uint32_t slot, int bin_x, int bin_y, int left, int top,
                                        int columns, int rows) {
  Meeting m;
  m.constant = 0;
  bool meets = true, full = true;
  DepthNumber g[3];
#pragma unroll
  for (int k = 0; k < 3; ++k)
    g[k] = (DepthNumber)meet_edge(r, k, bin_x, bin_y, left, top, columns, rows, &m, &meets, &full);
  m.anchor = weighted_depth<DepthNumber, DepthNumber, DepthNumber>(g[0], g[1], g[2], r.z[0], r.z[1], r.z[2], r.area);
  const CellPlane plane = {m.anchor, r.dzdx, r.dzdy};
  const DepthNumber nearest = corner_plane(plane, left, top, columns - 1, rows - 1, false),
                    farthest = corner_plane(plane, left, top, columns - 1, rows - 1, true);
  finish_meeting(r, slot, meets, full, nearest, farthest, &m);
  return m;
}

// The twin of meet() where float64 is slow. The bounds are off by the errors of pairs, to the safe side.
__device__ __forceinline__ PairMeeting meet_by_pairs(const Record& r, uint32_t slot, int bin_x, int bin_y, int left,
                                                     int top, int columns, int rows) {
  PairMeeting m;
  m.constant = 0;
  bool meets = true, full = true;
#pragma unroll
  for (int k = 0; k < 3; ++k) {
    meet_edge(r, k, bin_x, bin_y, left, top, columns, rows, &m, &meets, &full);
  }
  m.anchor = pair_cell_plane(r.x, r.y, r.z, twice_area(r.x, r.y), bin_x, bin_y);
  const float nearest = pair_corner_plane(m.anchor, left, top, columns - 1, rows - 1, false),
              farthest = pair_corner_plane(m.anchor, left, top, columns - 1, rows - 1, true);
  finish_meeting(r, slot, meets, full, nearest, farthest, &m);
  return m;
}

// The one that patches use.
__device__ __forceinline__ void meet_patch(const Record& r, uint32_t slot, int bin_x, int bin_y, int left, int top,
                                           int columns, int rows, Meeting* m) {
  *m = meet(r, slot, bin_x, bin_y, left, top, columns, rows);
}
__device__ __forceinline__ void meet_patch(const Record& r, uint32_t slot, int bin_x, int bin_y, int left, int top,
                                           int columns, int rows, PairMeeting* m) {
  *m = meet_by_pairs(r, slot, bin_x, bin_y, left, top, columns, rows);
}

// Counts what meet() or its twin has asked: of each edge two corners of the area, and one of the bin that it lies in.
template <class M>
__device__ __forceinline__ void count_meeting(const Frame& f, const M& m, Counter tested, Counter rejected,
                                              Counter accepted) {
  count_work(f, tested, 1);
  count_work(f, rejected, !m.meets());
  count_work(f, accepted, (m.info & Entry::kEntryFull) != 0);
  count_work(f, Counter::edges_64, 9);
}

// Extremes of f over the centres from (x, y) to (x + last_x, y + last_y) of the bin.
__device__ __forceinline__ int32_t highest_over(const NarrowEdge& e, int x, int y, int last_x, int last_y) {
  return highest_of(e.f + x * e.sx + y * e.sy, e.sx, e.sy, last_x, last_y);
}
__device__ __forceinline__ int32_t lowest_over(const NarrowEdge& e, int x, int y, int last_x, int last_y) {
  return lowest_of(e.f + x * e.sx + y * e.sy, e.sx, e.sy, last_x, last_y);
}

__device__ __forceinline__ float bound_depth(const Entry& e, int x, int y, int last_x, int last_y, bool farthest) {
  const float depth = corner_depth(e.plane, e.zmin, e.zmax, x, y, last_x, last_y, farthest);
  return !e.thin() ? depth : farthest ? e.zmax : e.zmin;
}
__device__ __forceinline__ float bound_depth(const PairEntry& e, int x, int y, int last_x, int last_y, bool farthest) {
  const float depth = clamp_depth(pair_corner_plane(e.plane(), x, y, last_x, last_y, farthest), e.zmin, e.zmax);
  return !e.thin() ? depth : farthest ? e.zmax : e.zmin;
}

// Depth of pixel (x, y) of the image of a thin record. A call, so that its registers cost the others nothing.
__device__ __noinline__ float thin_depth(const Record* r, int x, int y) {
  // A record may have no area then.
  if constexpr (kPairDepth)
    return finish_depth(depth_at(r->x, r->y, r->z, divisor((double)twice_area(r->x, r->y)), x, y), r->zmin, r->zmax);
  return stored_depth(finish_depth(depth_at(r->x, r->y, r->z, r->area, x, y), r->zmin, r->zmax));
}

// Depth of pixel (x, y) of the image that pairs do not decide. A call too.
template <class R>
__device__ __noinline__ float undecided_depth_of(const R* r, int x, int y) {
  return clamp_depth(plane_depth(r->x, r->y, r->z, twice_area(r->x, r->y), x, y), r->zmin, r->zmax);
}

// 1 / v, off by 2^-23 of it at most; infinite for 0.
__device__ __forceinline__ float near_inverse(float v) {
  float inverse;
  asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(inverse) : "f"(v));
  return inverse;
}

// 64 bits at once.
__device__ __forceinline__ void keep_nearest(int64_t* pixel, int64_t packed, bool read_first) {
  if (read_first && __ldcg(pixel) <= packed) return;
  // The address space is named, since in a function that is called the compiler cannot know it and would make three of
  // this.
  asm volatile("red.relaxed.gpu.global.min.s64 [%0], %1;" ::"l"(__cvta_generic_to_global(pixel)), "l"(packed));
}

// The same of a pixel of the image, not read first; counted by kernels that count.
__device__ __forceinline__ void keep_nearest_counted(const Frame& f, int64_t* pixel, int64_t packed) {
  keep_nearest(frame_pixel(f, pixel), packed, false);
}

// The same for a pixel in shared memory, where warps may draw at the same time. Of 64 bits, a minimum there is a
// compare-and-swap, so the pixel is read first.
__device__ __forceinline__ void keep_nearest_shared(int64_t* pixel, int64_t packed) {
  if (reread(*pixel) > packed) atomicMin(reinterpret_cast<long long*>(pixel), (long long)packed);
}

// The same, counted by kernels that count.
__device__ __forceinline__ void keep_nearest_shared_counted(const Frame& f, int64_t* pixel, int64_t packed) {
  if constexpr (kCounts)
    count_work(f, Counter::passed, packed < atomicMin(reinterpret_cast<long long*>(pixel), (long long)packed));
  else
    keep_nearest_shared(pixel, packed);
}

// Pixels next to each other of a record, from (x, y) on in a row, or in a column, each with a test and a plane of its
// own: for what is thin, and for the ends of slivers. first: the first one in the frame; stride: to the next one.
__device__ __noinline__ void draw_tested(FramePixel first, int stride, const Record& r, int x, int y, bool in_row,
                                         int count) {
#pragma unroll 1
  for (int m = 0; m < count; ++m) {
    const int px = in_row ? x + m : x, py = in_row ? y : y + m;
    int64_t outside = 0;
    for (int k = 0; k < 3; ++k) outside |= edge_steps(edge_of(r.x, r.y, k), px, py);
    count_work(first, Counter::edges_64, 3);
    if (outside < 0) continue;
    if constexpr (kCounts) count_fragment(first + (int64_t)m * stride);
    float depth;
    if (is_thin(r)) {
      depth = thin_depth(&r, px, py);
    } else {
      const CellPlane plane = cell_plane(r, px / kBin, py / kBin);
      depth = finish_depth(
          plane_row<DepthNumber>(plane.zcell, plane.dzdy, py % kBin) + plane_column<DepthNumber>(plane.dzdx, px % kBin),
          r.zmin, r.zmax);
    }
    keep_nearest(first + (int64_t)m * stride, pack_fragment(depth, r.triangle), false);
  }
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

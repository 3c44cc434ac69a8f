// A warp's primitives in shared memory: filed for what they are drawn by, whether they are whole triangles or parts of
// clipped ones.
#pragma once

#include "clip.cuh"
#include "rows.cuh"
#include "samples.cuh"
#include "small.cuh"
#include "ways.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr int kMostlySmall = 24;  // triangles of a warp within 8x8 px that make boxes worth while

// A primitive that is left over where most are small, until these are drawn.
struct Left {
  int32_t x[3], y[3];
  float z[3];
  int32_t x0, y0, x1, y1;
  int32_t t;  // its triangle
  int64_t area;

  __device__ __forceinline__ void put(const Primitive& p, int32_t triangle) {
    for (int k = 0; k < 3; ++k) {
      x[k] = p.x[k];
      y[k] = p.y[k];
      z[k] = p.z[k];
    }
    x0 = p.x0, y0 = p.y0, x1 = p.x1, y1 = p.y1;
    t = triangle;
    area = p.area;
  }
  // All of it but the order of its vertices, which nothing here asks for.
  __device__ __forceinline__ Primitive primitive() const {
    Primitive p;
    for (int k = 0; k < 3; ++k) {
      p.x[k] = x[k];
      p.y[k] = y[k];
      p.z[k] = z[k];
    }
    p.x0 = x0, p.y0 = y0, p.x1 = x1, p.y1 = y1;
    p.area = area;
    return p;
  }
};

// Shared memory of a warp.
struct WarpShared {
  union {
    RowTriangle triangle[kWarp];  // what is drawn by rows, from the front; the records of the rest from the back
    Vertex corners[3 * kWarp];
    struct {
      SmallShared small;
      Left left[kWarp - kMostlySmall];
    };
    ClipScratch clip;
  };
  RowShared rows;
  __device__ WarpShared() {}

  __device__ __forceinline__ Record* records_end() { return reinterpret_cast<Record*>(triangle + kWarp); }
};
static_assert(sizeof(RowTriangle) >= sizeof(Record) && sizeof(RowTriangle) * kWarp % alignof(Record) == 0,
              "a warp's triangles find room, whatever they are");

// Triangles of a group, or of a warp, that have to be clipped.
struct Clips {
  int count;
  int32_t triangle[kWarp];  // of the view
};

// How many triangles are drawn by rows, and how many are not.
struct Filed {
  int rows, rest;
};

// Puts the lanes' primitives in their places in shared memory; have: whether this lane has one; kSamples: whether large
// ones are a sample. By all lanes; ends with a barrier of the warp.
template <bool kSamples>
__device__ __forceinline__ Filed file(const Frame& f, const Primitive& p, int64_t triangle, int32_t view, bool have,
                                      const RowLimits& limits, const Team& team, WarpShared* s) {
  bool by_rows = have && fits_rows(p, limits.widest);
  int pixels = 0;  // that it covers, about; of what the screen cuts no more than its box has
  if (by_rows) pixels = min_of((p.x1 - p.x0) * (p.y1 - p.y0), (int)(p.area / kSubpixel / kSubpixel / 2));
  const bool large = pixels > kLarge;
  if (kSamples && limits.samples && __any_sync(kAllLanes, large))
    by_rows &= !(large_ones_wait(limits, team.log_size, large ? pixels : 0) && large);
  const bool waits = have && !by_rows && team.own();
  const unsigned rows = __ballot_sync(kAllLanes, by_rows), rest = __ballot_sync(kAllLanes, waits);
  count_work(f, Counter::records, by_rows && team.first());  // the others set up the same
  count_work(f, Counter::by_rows, by_rows && team.first());
  if (by_rows) make_row_triangle(p, (uint32_t)triangle, &s->triangle[__popc(rows & lanes_below())]);
  if (waits) {
    Record* const r = s->records_end() - 1 - __popc(rest & lanes_below());
    fill_record(p, triangle, r);
    r->view = view;
  }
  __syncwarp();
  return {__popc(rows), __popc(rest)};
}

// Files the `count` primitives that were left over, too few for a sample. By all lanes. Rarely called, so that its registers
// cost the small ones nothing.
__device__ __noinline__ Filed file_left(const Frame& f, int32_t view, int count, const RowLimits& limits,
                                        WarpShared* s) {
  const bool have = lane_id() < count;
  const Left& left = s->left[have ? lane_id() : 0];
  const Primitive p = left.primitive();
  const int32_t t = left.t;
  __syncwarp();
  return file<false>(f, p, f.first_triangle + t, view, have, limits, Team{}, s);
}

// Clips triangle t of a view and files the parts. By all lanes. Rarely called, so that its registers cost the others
// nothing.
template <bool kSamples>
__device__ __noinline__ Filed clip_and_file(const Frame& f, int32_t view, int32_t t, const RowLimits& limits,
                                            WarpShared* s) {
  __syncwarp();
  Primitive part;
  const bool have = clip_part(f, view, t, &s->clip, &part);
  __syncwarp();
  return file<kSamples>(f, part, f.first_triangle + t, view, have, limits, Team{}, s);
}

// Clips and draws the first-th of the triangles in `clips`, and every `step`-th from there. By all lanes. Rarely called, so that
// its registers and instructions cost the others nothing.
template <bool kSamples, class Rest>
__device__ __noinline__ void draw_clipped(const Frame& f, int32_t view, const Clips* clips, int first, int step,
                                          const RowLimits& limits, WarpShared* s, Rest rest) {
#pragma unroll 1
  for (; first < clips->count; first += step) {
    const Filed filed = clip_and_file<kSamples>(f, view, clips->triangle[first], limits, s);
    if (filed.rows > 0)
      draw_rows<false>(first_pixel(f, view), f.view.width, s->triangle, filed.rows, 0, 0, 0, INT32_MAX, &s->rows);
    if (filed.rest > 0) {
      wait_for_previous();
      rest(view, s->records_end() - filed.rest, filed.rest);
    }
  }
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

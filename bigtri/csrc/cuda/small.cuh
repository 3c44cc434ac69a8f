// Small triangles: a thread sets one up and finds the pixels that it covers; then the warp draws the pixels of all its triangles, one after the other.
// What bounds this is the rate of atomics, and that counts sectors of 32 bytes: neighbours in a row that go in one instruction cost one.
#pragma once

#include "fragment.cuh"

namespace bigtri {
namespace {

constexpr int kSmallSide = 16;  // px
constexpr int kBoxSide = 8;    // px; of what a lane finds pixels in at a time

// Shared memory of a warp. What a lane's triangle is, and the covered pixels of all of them: lane << 6 | y << 3 | x from the corner of the lane's box.
struct SmallShared {
  struct Box {
    CellPlane plane;
    float zmin, zmax;
    uint32_t triangle, corner;  // corner: x, y << 16, px
  };
  Box box[kWarp];
  uint16_t pixels[kWarp * kBoxSide * kBoxSide];
};

__device__ __forceinline__ bool is_small(const Primitive& p) {
  return p.x1 - p.x0 <= kSmallSide && p.y1 - p.y0 <= kSmallSide && extent_of(p) <= kDirectExtent && max_of(max_of(p.z[0], p.z[1]), p.z[2]) <= 1.0f &&
         !is_thin(p.x, p.y, p.area);
}

// The coverage of a row of eight pixels that begins where the edges are `at`.
__device__ __forceinline__ uint32_t row_coverage(const int32_t at[3], const int32_t sx[3]) {
  uint32_t outside = 0;
  for (int x = kBoxSide - 1; x >= 0; --x)  // shifts the sign bit in
    outside = __funnelshift_l((uint32_t)((at[0] + x * sx[0]) | (at[1] + x * sx[1]) | (at[2] + x * sx[2])), outside, 1);
  return ~outside & 0xff;
}

// Draws the lanes' small primitives, all lanes together; have: whether this one has any.
__device__ __forceinline__ void draw_small(const Frame& f, const Primitive& p, uint32_t triangle, bool have, SmallShared* s) {
  const int lane = lane_id();
  SmallShared::Box& mine = s->box[lane];
  int32_t start[3], sx[3], sy[3];  // f at the corner of the bbox, and its steps
  __syncwarp();
  if (have) {
    const DepthGradient g = depth_gradient(p.x, p.y, p.z, p.area);
    mine.plane.dzdx = g.dzdx;
    mine.plane.dzdy = g.dzdy;
    mine.zmin = min_of(min_of(p.z[0], p.z[1]), p.z[2]);
    mine.zmax = max_of(max_of(p.z[0], p.z[1]), p.z[2]);
    mine.triangle = triangle;
    for (int k = 0; k < 3; ++k) {
      const Edge e = edge_of(p.x, p.y, k);
      start[k] = (int32_t)edge_steps(e, p.x0, p.y0);
      sx[k] = -e.dy;
      sy[k] = e.dx;
    }
  }
  // Boxes of eight pixels a side, none across the border of a cell: one is the rule.
  int x = p.x0, y = p.y0;
  bool left = have;
  while (__any_sync(kAllLanes, left)) {
    uint32_t upper = 0, lower = 0;  // coverage of four rows each, a byte a row
    if (left) {
      const int x_end = min_of(min_of(p.x1, x + kBoxSide), x / kBin * kBin + kBin), y_end = min_of(min_of(p.y1, y + kBoxSide), y / kBin * kBin + kBin);
      const int rows = y_end - y;
      mine.corner = (uint32_t)x | (uint32_t)y << 16;
      mine.plane.zcell = depth_at(p.x, p.y, p.z, p.area, x / kBin * kBin, y / kBin * kBin);
      int32_t at[3];
      for (int k = 0; k < 3; ++k) at[k] = start[k] + (x - p.x0) * sx[k] + (y - p.y0) * sy[k];
      const uint32_t columns = (1u << (x_end - x)) - 1;
      for (int r = 0; r < rows; ++r) {
        const uint32_t covered = row_coverage(at, sx) & columns;
        if (r < 4)
          upper |= covered << (8 * r);
        else
          lower |= covered << (8 * r - 32);
        for (int k = 0; k < 3; ++k) at[k] += sy[k];
      }
      x = x_end;
      if (x == p.x1) {
        x = p.x0;
        y = y_end;
        left = y < p.y1;
      }
    }
    // Where this lane's pixels go: behind those of the lanes below.
    const int mine_count = __popc(upper) + __popc(lower);
    int end = mine_count;
    for (int step = 1; step < kWarp; step *= 2) {
      const int other = __shfl_up_sync(kAllLanes, end, step);
      if (lane >= step) end += other;
    }
    const int count = __shfl_sync(kAllLanes, end, kWarp - 1);
    uint16_t* to = s->pixels + end - mine_count;
    for (int half = 0; half < 2; ++half) {
      const int code = lane << 6 | half << 5;
      for (uint32_t bits = half ? lower : upper; bits;) {
        const int bit = 31 - __clz(bits);  // one instruction, unlike the lowest one
        *to++ = (uint16_t)(code + bit);
        bits ^= 1u << bit;
      }
    }
    __syncwarp();
    for (int i = lane; i < count; i += kWarp) {
      const int pixel = s->pixels[i], owner = pixel >> 6;
      const SmallShared::Box box = s->box[owner];
      const int px = (int)(box.corner & 0xffff) + (pixel & 7), py = (int)(box.corner >> 16) + (pixel >> 3 & 7);
      const double z = plane_row<double>(box.plane.zcell, box.plane.dzdy, py & (kBin - 1)) + plane_column<double>(box.plane.dzdx, px & (kBin - 1));
      const int64_t packed = (int64_t)((uint64_t)float_bits(finish_depth(z, box.zmin, box.zmax)) << 32 | box.triangle);
      keep_nearest(f.packed + (uint32_t)(py * f.view.width + px), packed, false);  // an image has at most 2^28 pixels
    }
    __syncwarp();
  }
}

// --- A warp's share of the triangles

union WarpShared {
  SmallShared small;
  ClipScratch clip;
  Record record;
  __device__ WarpShared() {}
};

// Sets up `share` triangles per warp and draws the small ones. The others, and the parts of those that had to be clipped, go to other(primitive, triangle, whether this lane has one, shared memory for
// a record), which all lanes call.
template <class Other>
__device__ __forceinline__ void set_up_share(const Frame& f, const Vertex* projected, int share, WarpShared* block_shared, const Other& other) {
  const int warp = threadIdx.x / kWarp, warps = blockDim.x / kWarp;
  WarpShared* s = block_shared + warp;
  const int64_t first = ((int64_t)blockIdx.x * warps + warp) * share;
  const bool mine = lane_id() < share && first + lane_id() < f.count;
  Primitive p;
  const Fate fate = mine ? set_up(f, (int32_t)(first + lane_id()), projected, &p) : Fate::kNothing;
  const bool whole = fate == Fate::kWhole, small = whole && is_small(p);
  draw_small(f, p, (uint32_t)(first + lane_id()), small, &s->small);
  if (__any_sync(kAllLanes, whole && !small)) other(p, first + lane_id(), whole && !small, &s->record);
  for (unsigned todo = __ballot_sync(kAllLanes, fate == Fate::kClip); todo; todo &= todo - 1) {
    const int64_t triangle = first + __ffs(todo) - 1;
    Primitive part;
    const bool have = clip_part(f, (int32_t)triangle, &s->clip, &part);
    __syncwarp();
    other(part, triangle, have, &s->record);
  }
  const unsigned dropped = __ballot_sync(kAllLanes, fate == Fate::kDropped);
  if (dropped && lane_id() == 0) atomicAdd(reinterpret_cast<unsigned long long*>(f.dropped), (unsigned long long)__popc(dropped));
}

}  // namespace
}  // namespace bigtri

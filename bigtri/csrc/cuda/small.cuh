// Triangles within 8x8 px where there are many: a lane finds all pixels of its own for less than rows.cuh takes for a
// row; then the warp draws the pixels of all of them, one after the other. What bounds this is the rate of atomics, and
// that counts sectors of 32 bytes: neighbours in a row that go in one instruction cost one.
#pragma once

#include "fragment.cuh"
#include "launch.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr int kBoxSide = 8;  // px, of the bbox
constexpr int kSmallExtent = 32 * kSubpixel;  // of the triangle itself, of which the screen may have left only a corner

// Shared memory of a warp. What a lane's triangle is, and the covered pixels of all of them: lane << 6 | y << 3 | x
// from the corner of the lane's box.
struct alignas(16) CellBox {
  // Of the cell that the corner lies in, and of those to the right, below, and both, as far as the box reaches there.
  DepthNumber zcell[4];
  DepthNumber dzdx, dzdy;
  float zmin, zmax;
  uint32_t triangle;
  uint32_t in_cell;  // the corner's x and y << 16 in its cell, px
  int64_t* corner;  // pixel of the frame
};
// The same where float64 is slow: the plane from the box's corner, and the triangle for depth that it does not decide.
struct PairBox {
  PairPlane plane;
  float zmin, zmax;
  uint32_t triangle;
  uint32_t in_cell;
  int64_t* corner;
  int16_t x[3], y[3];  // from the corner pixel's corner, subpx
  float z[3];
};
static_assert(!kPairDepth || (2 * kSmallExtent < 1 << 15 && kSmallExtent + kBoxSide * kSubpixel < 1 << 15),
              "so that 16 bits hold them");

struct SmallShared {
  using Box = std::conditional_t<kPairDepth, PairBox, CellBox>;
  // Those of a quarter of the lanes find room, and mostly those of all. More memory would take L1 from the vertices.
  static constexpr int kMostPixels = 5 * kWarp / 16 * kBoxSide * kBoxSide;

  Box box[kWarp];
  uint16_t pixels[kMostPixels];
};

__device__ __forceinline__ bool is_small(const Primitive& p) {
  return p.x1 - p.x0 <= kBoxSide && p.y1 - p.y0 <= kBoxSide && extent_of(p) <= kSmallExtent &&
         max_of(max_of(p.z[0], p.z[1]), p.z[2]) <= 1.0f && !is_thin(p);
}

// One edge of a small triangle in float32. Its values over a box are integers below 2^21, so float32 holds them
// exactly, and so are its steps. A row of eight pixels crosses it at a quotient of the two, which is an integer or at
// least 2^-13 away from one: float32 quotients below 8 are off by 2^-18 at most, and a slack between the two makes them
// exact where they are rounded to integers. All of this is about edges, so it holds for every rule of depth. What a
// row's crossing is multiplied with so that rounding it to an integer gives how far 0xff00 has to be shifted for the
// row's coverage: by 8 where all eight pixels are inside, by less where the first ones are not, by more where the last
// ones are not.
struct RowEdge {
  float at, to_next;  // f at the first pixel of the row, and its step to the next row
  float scale, offset, direction;
};

__device__ __forceinline__ RowEdge row_edge(int32_t f, int32_t sx, int32_t sy) {
  constexpr float kSlack = 1.0f / (1 << 15);
  // With a step of zero all pixels are inside or none: the infinities give that, and 0 * infinity counts as 0.
  return {(float)f, (float)sy, near_inverse((float)absolute(sx)) * -0.0625f,
          ((sx < 0 ? kBoxSide - 0.5f : 0.5f) - kSlack) * 0.0625f, sx < 0 ? 16.0f : -16.0f};
}

// The coverage of a row of eight pixels, in the lowest byte, by one edge; moves on to the next row.
__device__ __forceinline__ uint32_t row_coverage(RowEdge* e) {
  constexpr float kRounding =
      12582912.0f;  // 1.5 * 2^23: sums with it are rounded to integers, which their lowest bits hold
  const float beyond = __saturatef(__fmaf_rn(e->at, e->scale, e->offset));  // pixels not inside, in sixteenths
  e->at += e->to_next;
  return 0xff00u >> (float_bits(__fmaf_rn(beyond, e->direction, kRounding + 8.0f)) & 31);
}

// The same of four rows, a byte each.
__device__ __forceinline__ uint32_t rows_coverage(RowEdge edge[3]) {
  uint32_t row[4];
#pragma unroll
  for (int r = 0; r < 4; ++r) row[r] = row_coverage(&edge[0]) & row_coverage(&edge[1]) & row_coverage(&edge[2]);
  return __byte_perm(__byte_perm(row[0], row[1], 0x0040), __byte_perm(row[2], row[3], 0x0040), 0x5410);
}

// What find_pixels notes for depth, first and last; i, j: the corner's place in its cell, px.
__device__ __forceinline__ Divisor set_plane(const Primitive& p, CellBox* mine) {
  const Divisor area = divisor((double)p.area);
  const DepthGradient g = depth_gradient(p.x, p.y, p.z, area);
  mine->dzdx = g.dzdx;
  mine->dzdy = g.dzdy;
  return area;
}
__device__ __forceinline__ void set_anchors(const Primitive& p, const Divisor& area, int i, int j, CellBox* mine) {
#pragma unroll 1
  for (int cell = 0; cell < 4; ++cell)
    if ((cell == 0) | ((cell & 1) <= (i + p.x1 - p.x0 > kBin) & (cell >> 1) <= (j + p.y1 - p.y0 > kBin)))
      mine->zcell[cell] = depth_at(p.x, p.y, p.z, area, p.x0 - i + (cell & 1) * kBin, p.y0 - j + (cell >> 1) * kBin);
}
struct NoAnchors {};  // the plane's is enough
__device__ __forceinline__ NoAnchors set_plane(const Primitive& p, PairBox* mine) {
  mine->plane = pair_plane(p.x, p.y, p.z, p.area, p.x0, p.y0);
#pragma unroll
  for (int k = 0; k < 3; ++k) {
    mine->x[k] = (int16_t)(p.x[k] - p.x0 * kSubpixel);
    mine->y[k] = (int16_t)(p.y[k] - p.y0 * kSubpixel);
    mine->z[k] = p.z[k];
  }
  return {};
}
__device__ __forceinline__ void set_anchors(const Primitive&, NoAnchors, int, int, PairBox*) {}

// Notes what a lane's triangle is, and finds which pixels of its box it covers; upper, lower: four rows each, a byte a
// row.
__device__ __forceinline__ void find_pixels(FramePixel pixels, int width, const Primitive& p, uint32_t triangle,
                                            SmallShared::Box* mine, uint32_t* upper, uint32_t* lower) {
  const auto area = set_plane(p, mine);
  mine->zmin = min_of(min_of(p.z[0], p.z[1]), p.z[2]);
  mine->zmax = max_of(max_of(p.z[0], p.z[1]), p.z[2]);
  mine->triangle = triangle;
  mine->corner = place_of(pixels) + (uint32_t)(p.y0 * width + p.x0);  // an image has at most 2^28 pixels
  const int i = p.x0 & (kBin - 1), j = p.y0 & (kBin - 1);
  mine->in_cell = (uint32_t)i | (uint32_t)j << 16;
  set_anchors(p, area, i, j, mine);
  RowEdge edge[3];
  for (int k = 0; k < 3; ++k) {
    const Edge e = edge_of(p.x, p.y, k);
    edge[k] = row_edge((int32_t)edge_steps(e, p.x0, p.y0), -e.dy, e.dx);
  }
  const int rows = p.y1 - p.y0;
  count_work(pixels, Counter::rows, rows);
  count_work(pixels, Counter::edges_32, 3 * (rows > 4 ? kBoxSide : 4));
  const uint32_t columns = ((1u << (p.x1 - p.x0)) - 1) * 0x01010101u,
                 last_rows = columns & (0xffffffffu >> (8 * (-rows & 3)));
  *upper = rows_coverage(edge) & (rows > 4 ? columns : last_rows);
  *lower = rows > 4 ? rows_coverage(edge) & last_rows : 0;
}

// Lists a lane's pixels from `to` on.
__device__ __forceinline__ void list_pixels(uint32_t upper, uint32_t lower, int lane, uint16_t* to) {
  for (int half = 0; half < 2; ++half) {
    const int code = lane << 6 | half << 5;
    for (uint32_t bits = half ? lower : upper; bits;) {
      const int bit = 31 - __clz(bits);  // one instruction, unlike the lowest one
      *to++ = (uint16_t)(code + bit);
      bits ^= 1u << bit;
    }
  }
}

// Depth of the box's pixel (x, y).
__device__ __forceinline__ float depth_in_box(const CellBox& box, uint32_t x, uint32_t y) {
  const uint32_t at = box.in_cell + (x | y << 16);
  const DepthNumber zcell = box.zcell[(at >> kBinBits & 1) | (at >> (kBinBits + 15) & 2)];
  const DepthNumber z = plane_row<DepthNumber>(zcell, box.dzdy, place_in_cell((int)(at >> 16 & (kBin - 1)))) +
                        plane_column<DepthNumber>(box.dzdx, place_in_cell((int)(at & (kBin - 1))));
  return finish_depth(z, box.zmin, box.zmax);
}

// The same where pairs do not decide, not clamped. All is counted from the corner of the cell that the box begins in. A
// call, so that its registers cost the others nothing.
template <class Box>
__device__ __noinline__ float undecided_depth(const Box* box, uint32_t x, uint32_t y) {
  const int i = (int)(box->in_cell & 0xffff), j = (int)(box->in_cell >> 16);
  int32_t px[3], py[3];
  for (int k = 0; k < 3; ++k) {
    px[k] = box->x[k] + i * kSubpixel;
    py[k] = box->y[k] + j * kSubpixel;
  }
  return plane_depth(px, py, box->z, twice_area(px, py), i + (int)x, j + (int)y);
}
__device__ __forceinline__ float depth_in_box(const PairBox& box, uint32_t x, uint32_t y) {
  const FloatPair row = pair_at(box.plane.z, box.plane.dzdy, exact_float((int)y));
  float plane;
  if (!pair_depth(row, box.plane.dzdx, exact_float((int)x), box.plane.error, &plane))
    plane = undecided_depth(&box, x, y);
  return clamp_depth(plane, box.zmin, box.zmax);
}

// Draws the pixels listed, a lane one at a time.
__device__ __forceinline__ void draw_listed(FramePixel pixels, int width, int count, int lane, const SmallShared* s) {
  for (int i = lane; i < count; i += kWarp) {
    const int pixel = s->pixels[i];
    const SmallShared::Box& box = s->box[pixel >> 6];
    const uint32_t x = pixel & 7, y = pixel >> 3 & 7;
    const int64_t packed = pack_depth(depth_in_box(box, x, y), box.triangle);
    if constexpr (kCounts) count_fragment(frame_pixel(pixels, box.corner + (y * (uint32_t)width + x)));
    keep_nearest(frame_pixel(pixels, box.corner + (y * (uint32_t)width + x)), packed, false);
  }
}

// Draws the lanes' small primitives onto a view of this width that the kernels in front have cleared; have: whether
// this lane has one. By all lanes.
__device__ __forceinline__ void draw_small(FramePixel pixels, int width, const Primitive& p, uint32_t triangle,
                                           bool have, SmallShared* s) {
  const int lane = computed_here(lane_id());
  uint32_t upper = 0, lower = 0;
  if (have) find_pixels(pixels, width, p, triangle, &s->box[lane], &upper, &lower);
  const int count = __popc(upper) + __popc(lower), end = warp_sum_up_to(count);
  const int all = __shfl_sync(kAllLanes, end, kWarp - 1);
  // All lanes' pixels at once, or those of a quarter of the lanes after the other.
  const int lanes = all <= SmallShared::kMostPixels ? kWarp : kWarp / 4;
  wait_for_previous();
#pragma unroll 1
  for (int first = 0, listed = 0; first < kWarp; first += lanes) {
    const int part_end = __shfl_sync(kAllLanes, end, first + lanes - 1);
    if (lane >= first && lane < first + lanes) list_pixels(upper, lower, lane, s->pixels + end - count - listed);
    __syncwarp();
    draw_listed(pixels, width, part_end - listed, lane, s);
    listed = part_end;
    __syncwarp();
  }
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// Drawing by rows, with atomic minima on a cleared image: what most triangles of a mesh are drawn by. A lane takes a
// row of any of up to 32 triangles, cut at the borders of 64 px cells, and finds the span of pixels that it covers;
// then the pixels of 32 rows are one sequence, which the lanes draw 32 at a time. So a lane has work whatever the
// triangles' shapes are, and neighbours in a row, which share sectors of 32 bytes, go in one instruction.
#pragma once

#include "fragment.cuh"
#include "launch.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// A triangle that is drawn by rows.
template <class Plane, class Rest>
struct RowTriangleOf {
  Plane plane;
  float zmin, zmax;
  uint32_t triangle;
  uint32_t corner;  // of the bbox, px: x | y << 16
  uint32_t size;    // of the bbox, px: columns | thin << 15 | rows << 16
  int32_t f[3], sx[3], sy[3];  // of each edge at the bbox's first pixel, in steps of a pixel, and the steps
  float z[3];  // of its vertices
  Rest rest;

  __device__ __forceinline__ int x() const { return (int)(corner & 0xffff); }
  __device__ __forceinline__ int y() const { return (int)(corner >> 16); }
  __device__ __forceinline__ int columns() const { return (int)(size & 0x7fff); }
  __device__ __forceinline__ bool thin() const { return kKnowsThin && (size & 0x8000); }
  __device__ __forceinline__ int rows() const { return (int)(size >> 16); }
};

// For depth elsewhere than in the cell that the bbox begins in, whose plane is at hand, and of thin triangles; else not
// set, nor is z.
struct EdgesInCell {
  int64_t value[3];  // of each edge at the cell's first pixel, subpx^2
  Divisor area;
};
using CellTriangle = RowTriangleOf<CellPlane, EdgesInCell>;
// Where float64 is slow: for depth that pairs do not decide, and of thin triangles. The plane is anchored at the bbox's
// first pixel.
struct Corners {
  int32_t x[3], y[3];  // subpx
};
using PairTriangle = RowTriangleOf<PairPlane, Corners>;
using RowTriangle = std::conditional_t<kPairDepth, PairTriangle, CellTriangle>;

// What the pixels of a row within a cell have in common.
struct alignas(16) CellRow {
  DepthNumber z, dzdx;  // plane at the first pixel of the cell's row, and its change per px
  float zmin, zmax;
  uint32_t triangle;
  uint32_t at;  // the cell's first pixel in this row, in the image
};
// The same where float64 is slow, from the bbox's first pixel in this row.
struct PairRow {
  FloatPair z, dzdx;
  float zmin, zmax;
  uint32_t triangle;
  uint32_t at;
  float error;  // of the plane
  int32_t owner;  // which of the triangles
};
using Row = std::conditional_t<kPairDepth, PairRow, CellRow>;
using RowStart = std::conditional_t<kPairDepth, FloatPair, DepthNumber>;

// Shared memory of a warp that draws rows: of 32 rows those that have pixels, one after the other.
struct RowShared {
  uint16_t begin[kWarp];  // of each triangle, its first row: below 32 * 2^11
  Row row[kWarp];
  int32_t shift[kWarp];  // from the number of a pixel in the sequence to its column, counted from the pixel `at`
};

// What is drawn by rows has no side longer than `widest` px, at most kWidestRows, and the triangle itself, of which the
// screen may have left only a corner, none longer than kRowExtent. So f is below 2^28 over the bbox, and fits int32.
constexpr int kWidestRows = 256;
constexpr int32_t kRowExtent = 512 * kSubpixel;

__device__ __forceinline__ bool fits_rows(const Primitive& p, int widest) {
  return p.x1 - p.x0 <= widest && p.y1 - p.y0 <= widest && extent_of(p) <= kRowExtent;
}

// Sets the triangle's plane and edges; returns what depth may need besides.
__device__ __forceinline__ EdgesInCell set_plane(const Primitive& p, CellTriangle* r) {
  const Divisor area = divisor((double)p.area);
  const DepthGradient gradient = depth_gradient(p.x, p.y, p.z, area);
  const int left = p.x0 & -kBin, top = p.y0 & -kBin;
  EdgesInCell edges;
  DepthNumber g[3];
#pragma unroll
  for (int k = 0; k < 3; ++k) {
    const Edge e = edge_of(p.x, p.y, k);
    edges.value[k] = edge_value(e, pixel_centre(left), pixel_centre(top));
    g[k] = (DepthNumber)edges.value[k];
    r->f[k] = (int32_t)steps_of(edges.value[k], e) - e.dy * (p.x0 - left) + e.dx * (p.y0 - top);
    r->sx[k] = -e.dy;
    r->sy[k] = e.dx;
  }
  r->plane.zcell =
      weighted_depth<DepthNumber, DepthNumber, DepthNumber>(g[0], g[1], g[2], p.z[0], p.z[1], p.z[2], area);
  r->plane.dzdx = gradient.dzdx;
  r->plane.dzdy = gradient.dzdy;
  edges.area = area;
  return edges;
}
__device__ __forceinline__ Corners set_plane(const Primitive& p, PairTriangle* r) {
  Corners corners;
  r->plane = pair_plane(p.x, p.y, p.z, p.area, p.x0, p.y0);
#pragma unroll
  for (int k = 0; k < 3; ++k) {
    const Edge e = edge_of(p.x, p.y, k);
    r->f[k] = (int32_t)edge_steps(e, p.x0, p.y0);
    r->sx[k] = -e.dy;
    r->sy[k] = e.dx;
    corners.x[k] = p.x[k];
    corners.y[k] = p.y[k];
  }
  return corners;
}

// Keeps that where depth may need it.
__device__ __forceinline__ void keep_rest(const Primitive& p, bool thin, const EdgesInCell& edges, CellTriangle* r) {
  const int left = p.x0 & -kBin, top = p.y0 & -kBin;
  if (thin || p.x1 - left > kBin || p.y1 - top > kBin) {
    for (int k = 0; k < 3; ++k) {
      r->z[k] = p.z[k];
      r->rest.value[k] = edges.value[k];
    }
    r->rest.area = edges.area;
  }
}
__device__ __forceinline__ void keep_rest(const Primitive& p, bool, const Corners& corners, PairTriangle* r) {
  for (int k = 0; k < 3; ++k) r->z[k] = p.z[k];
  r->rest = corners;
}

__device__ __forceinline__ void make_row_triangle(const Primitive& p, uint32_t triangle, RowTriangle* r) {
  const auto rest = set_plane(p, r);
  r->zmin = min_of(min_of(p.z[0], p.z[1]), p.z[2]);
  r->zmax = max_of(max_of(p.z[0], p.z[1]), p.z[2]);
  r->triangle = triangle;
  r->corner = (uint32_t)p.x0 | (uint32_t)p.y0 << 16;
  const bool thin = is_thin(p);
  r->size = (uint32_t)(p.x1 - p.x0) | (thin ? 0x8000u : 0) | (uint32_t)(p.y1 - p.y0) << 16;
  keep_rest(p, thin, rest, r);
}

// depth_at() so many px to the right of the cell's first pixel, and below it: zcell of other cells, and the depth of
// thin triangles. Edge values are exact until they become a DepthNumber, so it is rounded where depth_at() rounds.
__device__ __forceinline__ DepthNumber depth_beside(const CellTriangle& r, int right, int below) {
  DepthNumber g[3];
#pragma unroll
  for (int k = 0; k < 3; ++k)
    g[k] = (DepthNumber)(r.rest.value[k] + (int64_t)(kSubpixel * right) * r.sx[k] +
                         (int64_t)(kSubpixel * below) * r.sy[k]);
  return weighted_depth<DepthNumber, DepthNumber, DepthNumber>(g[0], g[1], g[2], r.z[0], r.z[1], r.z[2], r.rest.area);
}
__device__ __forceinline__ DepthNumber depth_beside(const PairTriangle& r, int right, int below) {
  const Divisor area = divisor((double)twice_area(r.rest.x, r.rest.y));
  return depth_at(r.rest.x, r.rest.y, r.z, area, (r.x() & -kBin) + right, (r.y() & -kBin) + below);
}

// The column that a row's pixels are counted from, px. left: of the row's cell.
__device__ __forceinline__ int column_of(const CellTriangle&, int left) { return left; }
__device__ __forceinline__ int column_of(const PairTriangle& r, int) { return r.x(); }

// The plane there, in row y of the image and the right-th cell of that row.
__device__ __forceinline__ DepthNumber row_start(const CellTriangle& r, int y, int right) {
  const int below = y - (r.y() & -kBin);
  const DepthNumber zcell = (right | (below & -kBin)) ? depth_beside(r, right * kBin, below & -kBin) : r.plane.zcell;
  return plane_row<DepthNumber>(zcell, r.plane.dzdy, place_in_cell(y & (kBin - 1)));
}
__device__ __forceinline__ FloatPair row_start(const PairTriangle& r, int y, int) {
  return pair_at(r.plane.z, r.plane.dzdy, exact_float(y - r.y()));
}

__device__ __forceinline__ CellRow make_row(const CellTriangle& r, DepthNumber z, uint32_t at, int) {
  return {z, r.plane.dzdx, r.zmin, r.zmax, r.triangle, at};
}
__device__ __forceinline__ PairRow make_row(const PairTriangle& r, FloatPair z, uint32_t at, int owner) {
  return {z, r.plane.dzdx, r.zmin, r.zmax, r.triangle, at, r.plane.error, owner};
}

// Depth of a covered pixel of the image that pairs do not decide. A call, so that its registers cost the others nothing.
template <class Triangle>
__device__ __noinline__ float undecided_depth(const Triangle* r, int width, uint32_t at) {
  const int y = (int)(at / (uint32_t)width);
  return plane_depth(r->rest.x, r->rest.y, r->z, twice_area(r->rest.x, r->rest.y), (int)at - y * width, y);
}

// Depth of a row's pixel i, counted from the one `at`; used: whether anybody asks for it.
__device__ __forceinline__ float depth_in_row(const CellRow& row, int i, bool, int, const CellTriangle*) {
  return finish_depth(row.z + plane_column<DepthNumber>(row.dzdx, place_in_cell(i)), row.zmin, row.zmax);
}
__device__ __forceinline__ float depth_in_row(const PairRow& row, int i, bool used, int width,
                                              const PairTriangle* triangles) {
  float plane;
  if (!pair_depth(row.z, row.dzdx, exact_float(i), row.error, &plane) && used)
    plane = undecided_depth(triangles + row.owner, width, row.at + (uint32_t)i);
  return clamp_depth(plane, row.zmin, row.zmax);
}

// `count` pixels of a row of a thin triangle, by its lane alone: there are few. first: in the frame; right, below: of
// it, as above.
__device__ __noinline__ void draw_thin_row(FramePixel first, int count, const RowTriangle* r, int right, int below) {
#pragma unroll 1
  for (int i = 0; i < count; ++i) {
    if constexpr (kCounts) count_fragment(first + i);
    const float z = finish_depth(depth_beside(*r, right + i, below), r->zmin, r->zmax);
    keep_nearest(first + i, pack_fragment(z, r->triangle), false);
  }
}

// Intervals that follow each other, one of each lane in `have`, beginning at `begin`: which of them holds position
// first + lane, counted over the lanes in `have`; for positions below the end of the last one. By all lanes.
__device__ __forceinline__ int interval_at(int first, int begin, bool have, unsigned lanes_to_here) {
  const int at = begin - first;
  const unsigned begins = warp_or(have && (unsigned)at < kWarp ? 1u << at : 0),
                 earlier = __ballot_sync(kAllLanes, have && at < 0);
  return __popc(earlier) + __popc(begins & lanes_to_here) - 1;
}

// Pixels [lower, upper) of a row of a triangle, px from the bbox's left border.
struct RowSpan {
  int lower, upper;
};

// Cuts the span to the pixels i with f + step * i >= 0. The float32 quotient is off by less than 1/2 wherever the edge
// crosses the row, so one test in integers settles on which side of the crossing the nearest pixel lies. kLast: no pixel
// behind that one is asked for.
template <int kLast>
__device__ __forceinline__ void cut_row(int32_t f, int32_t step, RowSpan* span) {
  // With a step of 0 the quotient is infinite, or a NaN where f is 0, which fmaxf makes 0.
  const float crossing = fminf(fmaxf((float)-f * near_inverse((float)step), 0.0f), (float)kLast);
  const int nearest = __float2int_rn(crossing);
  const int inside = f + step * nearest >= 0 ? 1 : 0;
  if (step >= 0)
    span->lower = max_of(span->lower, nearest + 1 - inside);
  else
    span->upper = min_of(span->upper, nearest + inside);
}

// Draws pixels first, first + 1, ... of the `count` pixels of the rows in s->row, of which each lane in `have` has one,
// beginning at pixel `begin`: kGroups for each lane, so that one does not wait for the other. By all lanes.
template <int kGroups>
__device__ __forceinline__ void draw_pixels(FramePixel pixels, int width, const RowTriangle* triangles, int first,
                                            int count, int begin, bool have, int lane, unsigned lanes_to_here,
                                            const RowShared* s) {
  int owner[kGroups];
#pragma unroll
  for (int g = 0; g < kGroups; ++g) owner[g] = interval_at(first + g * kWarp, begin, have, lanes_to_here);
  uint32_t at[kGroups];
  int64_t packed[kGroups];
  bool seen[kGroups];
#pragma unroll
  for (int g = 0; g < kGroups; ++g) {
    const int n = first + g * kWarp + lane;
    const Row row = s->row[owner[g]];
    const int i = n + s->shift[owner[g]];
    const float depth = depth_in_row(row, i, n < count, width, triangles);
    seen[g] = n < count && depth <= 1.0f;
    packed[g] = pack_depth(depth, row.triangle);
    at[g] = row.at + (uint32_t)i;
    if constexpr (kCounts)
      if (n < count) count_fragment(pixels + at[g]);
  }
#pragma unroll
  for (int g = 0; g < kGroups; ++g)
    if (seen[g]) keep_nearest(pixels + at[g], packed[g], false);
}

// Where the bbox reaches over several cells, each of its rows counts as 2^bits rows, one for each cell; those that are
// too many are empty.
__device__ __forceinline__ int cell_bits(const RowTriangle& r) {
  const int more = (r.x() + r.columns() - 1) / kBin - r.x() / kBin;
  return more > 0 ? 32 - __clz(more) : 0;
}

// Rows of a triangle, counted like that.
__device__ __forceinline__ int rows_of(const RowTriangle& r) { return r.rows() << cell_bits(r); }

// So few rows that with 32 at a time many of the warps that share them would have none: large triangles' rows, with many pixels.
// Of 32 warps each then takes 16; a turn of one row takes as long to begin as one of 32.
constexpr int kFewRows = 16 * kWarp;

// Draws `count` triangles, at most 32, onto a view of this width that the kernels in front have cleared: of their rows from
// `first` on the part-th of 2^log_parts parts, 32 at a time in turns; kEvenly: up to kFewRows in one turn, an equal share a part.
// kLeaves: only those of the first triangles, whose bboxes have no more than `most` pixels together; returns the first row that
// is left, or -1 if there is none. By all lanes.
template <bool kLeaves, bool kEvenly = false>
__device__ __forceinline__ int draw_rows(FramePixel pixels, int width, const RowTriangle* triangles, int count,
                                         int first, int part, int log_parts, int most, RowShared* s) {
  const int lane = computed_here(lane_id());
  const unsigned lanes_to_here = (unsigned)computed_here((int)((2u << lane) - 1));
  const bool have = lane < count;
  pixels = kept(pixels);
  int rows = 0;
  if (have) rows = rows_of(triangles[lane]);
  const int end = warp_sum_up_to(rows), begin = end - rows;
  int total = __shfl_sync(kAllLanes, end, kWarp - 1), left = -1;
  if (kLeaves) {
    const int boxes = warp_sum_up_to(have ? triangles[lane].rows() * triangles[lane].columns() : 0);
    const unsigned over = __ballot_sync(kAllLanes, boxes > most);
    if (over) total = left = __shfl_sync(kAllLanes, begin, __ffs(over) - 1);
  }
  __syncwarp();
  if (have) s->begin[lane] = (uint16_t)begin;
  __syncwarp();
  const int each = kEvenly && total - first <= kFewRows ? min_of(kFewRows >> log_parts, kWarp) : kWarp;
#pragma unroll 1
  for (first += part * each; first < total; first += each << log_parts) {
    const bool has_row = (!kEvenly || lane < each) && first + lane < total;
    const int owner = interval_at(first, begin, have, lanes_to_here);
    RowSpan span = {0, 0};
    RowStart z = {};  // Row::z
    uint32_t at = 0;  // Row::at
    int shift = 0;
    int below = 0;  // of the row, px from the first cell's top
    bool thin = false;
    const RowTriangle& r = triangles[has_row ? owner : 0];
    if (has_row) {
      const int bits = cell_bits(r), number = first + lane - s->begin[owner], down = number >> bits,
                right = number & ((1 << bits) - 1);
      const int x = r.x(), y = r.y() + down, left = (x & -kBin) + right * kBin;
      span = {max_of(left - x, 0), min_of(left + kBin - x, r.columns())};
      count_work(pixels, Counter::rows, span.lower < span.upper);
      count_work(pixels, Counter::edges_32, 3);
#pragma unroll
      for (int k = 0; k < 3; ++k) cut_row<kWidestRows>(r.f[k] + r.sy[k] * down, r.sx[k], &span);
      below = y - (r.y() & -kBin);
      z = row_start(r, y, right);
      const int column = column_of(r, left);
      at = (uint32_t)(y * width + column);
      shift = span.lower + x - column;
      thin = r.thin() && span.lower < span.upper;
    }
    const int length = thin ? 0 : max_of(span.upper - span.lower, 0), sum = warp_sum_up_to(length),
              pixel = sum - length;
    const bool any = length > 0;
    const unsigned filled = __ballot_sync(kAllLanes, any);
    if (any) {
      const int number = __popc(filled & lanes_to_here) - 1;
      s->row[number] = make_row(r, z, at, owner);
      s->shift[number] = shift - pixel;
    }
    __syncwarp();
    wait_for_previous();
    if (thin)
      draw_thin_row(pixels + (at + (uint32_t)shift), span.upper - span.lower, &r, span.lower + (r.x() & (kBin - 1)),
                    below);
    const int pixel_count = __shfl_sync(kAllLanes, sum, kWarp - 1);
    int drawn = 0;
#pragma unroll 1
    for (; drawn + kWarp < pixel_count; drawn += 2 * kWarp)
      draw_pixels<2>(pixels, width, triangles, drawn, pixel_count, pixel, any, lane, lanes_to_here, s);
    if (drawn < pixel_count)
      draw_pixels<1>(pixels, width, triangles, drawn, pixel_count, pixel, any, lane, lanes_to_here, s);
    __syncwarp();
  }
  return left;
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

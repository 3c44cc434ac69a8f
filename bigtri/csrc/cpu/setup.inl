// Projection of vertices and set-up of records: the kernels of setup.h, which all variants call per piece of vertices and
// per share of triangles. Compiled once per instruction set.
//
// Triangles that need no clipping are set up eight at a time: set-up is a third of the time of a mesh of small
// triangles, and a triangle's orientation and first vertex are branches that nothing predicts. set_up_eight computes
// what make_primitive (core/setup.h) and fill_record (core/record.h) compute, step by step. It leaves out what covers no
// pixel where that is quickly seen.
#pragma once

#include "../core/resolve.h"
#include "kernels.h"
#include "simd.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

uint32_t project(const float* positions, int64_t begin, int64_t end, int width, int height, Vertex* out) {
  uint32_t flags = 0;
  for (int64_t i = begin; i < end; ++i) {
    out[i - begin] = project_vertex(positions + 4 * i, width, height);
    flags |= out[i - begin].flags;
  }
  return flags;
}

// Eight triangles. x[k], y[k] and z[k]: vertex k of each, as in Vertex.
struct Eight {
  alignas(64) int32_t x[3][8], y[3][8];
  alignas(64) float z[3][8];
  int64_t triangle[8];
};

// twice_area, in float64: products are below 2^48 and their difference below 2^49, so it is exact.
BIGTRI_INLINE f64x8 twice_area(const i32x8 x[3], const i32x8 y[3]) {
  return to_double(x[1] - x[0]) * to_double(y[2] - y[0]) - to_double(y[1] - y[0]) * to_double(x[2] - x[0]);
}

// Whether (x, y) of a is lexicographically less than that of b.
BIGTRI_INLINE i32x8 point_less(const i32x8& ax, const i32x8& ay, const i32x8& bx, const i32x8& by) {
  return (ax < bx) | ((ax == bx) & (ay < by));
}

// Moves vertex 1 to place 0 where `one` is set, vertex 2 where `two` is, and the others after it in their order.
template <class T>
BIGTRI_INLINE void rotate(Lanes<T, 8> v[3], const i32x8& one, const i32x8& two) {
  const Lanes<T, 8> a = v[0], b = v[1], c = v[2];
  v[0] = select<T, 8>(one, b, select<T, 8>(two, c, a));
  v[1] = select<T, 8>(one, c, select<T, 8>(two, a, b));
  v[2] = select<T, 8>(one, a, select<T, 8>(two, b, c));
}

template <class T>
BIGTRI_INLINE void swap_where(const i32x8& mask, Lanes<T, 8>* a, Lanes<T, 8>* b) {
  const Lanes<T, 8> old = *a;
  *a = select<T, 8>(mask, *b, old);
  *b = select<T, 8>(mask, old, *b);
}

// Which of eight triangles cover no pixel, of those that are tiny and whose bboxes, px, are at most 2x2: covers_nothing()
// of core/record.h for all of them at once. Vertices and bboxes as in a record.
BIGTRI_INLINE i32x8 covers_nothing(const i32x8 x[3], const i32x8 y[3], const i32x8& x0, const i32x8& y0,
                                   const i32x8& columns, const i32x8& rows) {
  i32x8 outside[2][2];  // [row][column], negative where the sample is
  for (int k = 0; k < 3; ++k) {
    const int p = k == 2 ? 0 : k + 1, q = p == 2 ? 0 : p + 1;
    const i32x8 dx = x[q] - x[p], dy = y[q] - y[p];
    const i32x8 bias = ((dy < 0) | ((dy == 0) & (dx > 0))) == 0;  // edge_bias: 0 or -1
    const i32x8 e = dx * (y0 * kSubpixel + kHalf - y[p]) - dy * (x0 * kSubpixel + kHalf - x[p]) + bias;
    const i32x8 right = dy * -kSubpixel, down = dx * kSubpixel;
    const i32x8 f[2][2] = {{e, e + right}, {e + down, e + right + down}};
    for (int j = 0; j < 2; ++j)
      for (int i = 0; i < 2; ++i) outside[j][i] = k == 0 ? f[j][i] : outside[j][i] | f[j][i];
  }
  const i32x8 one_column = columns - 2, one_row = rows - 2;  // negative where it is
  return (outside[0][0] & (outside[0][1] | one_column) & (outside[1][0] | one_row) &
          (outside[1][1] | one_column | one_row)) < 0;
}

// Whether vectors hold what a rung's records are made of: snapped vertices of at most 25 bits, and nothing else.
constexpr bool kSetsUpEight = Rung::kSubpixelBits <= 8 && !kUnsnapped;

// Sets up the first `count` of eight triangles and returns the number of records.
int set_up_eight(const SetupJob& job, const Eight& t, int count, Record* records, uint32_t* candidates) {
  const Viewport& view = job.frame.view;
  i32x8 x[3], y[3];
  f32x8 z[3];
  for (int k = 0; k < 3; ++k) {
    x[k] = load<i32x8>(t.x[k]);
    y[k] = load<i32x8>(t.y[k]);
    z[k] = load<f32x8>(t.z[k]);
  }
  // make_primitive
  f64x8 area = twice_area(x, y);
  const i32x8 clockwise = lower_half(area > 0.0), turned = lower_half(area < 0.0);
  const i32x8 wanted = view.cull == kCullNone ? clockwise | turned : view.cull == kCullBack ? turned : clockwise;
  const i32x8 min_x = least(least(x[0], x[1]), x[2]), max_x = greatest(greatest(x[0], x[1]), x[2]);
  const i32x8 min_y = least(least(y[0], y[1]), y[2]), max_y = greatest(greatest(y[0], y[1]), y[2]);
  const i32x8 x0 = greatest((min_x + (kHalf - 1)) >> kSubpixelBits, splat<i32x8>(view.x0)),
              y0 = greatest((min_y + (kHalf - 1)) >> kSubpixelBits, splat<i32x8>(view.y0)),
              x1 = least(((max_x - kHalf) >> kSubpixelBits) + 1, splat<i32x8>(view.x1)),
              y1 = least(((max_y - kHalf) >> kSubpixelBits) + 1, splat<i32x8>(view.y1));
  uint32_t kept = sign_mask(wanted & (x0 < x1) & (y0 < y1)) & ((1u << count) - 1);
  if (!kept) return 0;
  swap_where(turned, x + 1, x + 2);
  swap_where(turned, y + 1, y + 2);
  swap_where(turned, z + 1, z + 2);
  const i32x8 second = point_less(x[1], y[1], x[0], y[0]);
  const i32x8 two =
      point_less(x[2], y[2], select<int32_t, 8>(second, x[1], x[0]), select<int32_t, 8>(second, y[1], y[0]));
  rotate(x, second & (two == 0), two);
  rotate(y, second & (two == 0), two);
  rotate(z, second & (two == 0), two);
  const i32x8 longest = greatest(max_x - min_x, max_y - min_y);
  const i32x8 tiny = (longest < kTinyExtent) & (x1 - x0 < 3) & (y1 - y0 < 3);
  if (kSkipsEmpty && (sign_mask(tiny) & kept)) {
    kept &= ~sign_mask(tiny & covers_nothing(x, y, x0, y0, x1 - x0, y1 - y0));
    if (!kept) return 0;
  }
  area = select<double, 8>(area < 0.0, splat<f64x8>(0.0) - area, area);
  // fill_record
  DepthLanes gx[3], gy[3], number_z[3];
  i32x8 length = splat<i32x8>(0);
  for (int k = 0; k < 3; ++k) {
    const int p = k == 2 ? 0 : k + 1, q = p == 2 ? 0 : p + 1;
    const i32x8 dx = x[q] - x[p], dy = y[q] - y[p];
    gx[k] = converted<DepthNumber>(dy) * -(DepthNumber)kSubpixel;
    gy[k] = converted<DepthNumber>(dx) * (DepthNumber)kSubpixel;
    number_z[k] = converted<DepthNumber>(z[k]);
    length = length + greatest(dx, splat<i32x8>(0) - dx) + greatest(dy, splat<i32x8>(0) - dy);
  }
  const DepthLanes dzdx = weighted_depth<DepthLanes>(gx[0], gx[1], gx[2], number_z[0], number_z[1], number_z[2], area),
                   dzdy = weighted_depth<DepthLanes>(gy[0], gy[1], gy[2], number_z[0], number_z[1], number_z[2], area);
  const f32x8 zmin = least(least(z[0], z[1]), z[2]), zmax = greatest(greatest(z[0], z[1]), z[2]);
  // A bbox has at most 2^28 px, and both sides of the thin test are integers below 2^54: float64 holds them exactly.
  const i32x8 large = ((x1 - x0) * (y1 - y0) > (int32_t)kDirectPixels) | (longest > kDirectExtent);
  const i32x8 thin = lower_half(to_double(length) * (double)kSubpixel > area * (double)kThinRatio);
  const i32x8 flags =
      (large & (int32_t)kRecordLarge) | (thin & (int32_t)kRecordThin) | ((zmax > 1.0f) & (int32_t)kRecordFar);
  const i32x8 columns = ((x1 - 1) >> kBinBits) - (x0 >> kBinBits) + 1,
              rows = ((y1 - 1) >> kBinBits) - (y0 >> kBinBits) + 1, touched = columns * rows;
  int n = 0;
  for (; kept; kept &= kept - 1) {
    const int i = __builtin_ctz(kept);
    Record& r = records[n];
    for (int k = 0; k < 3; ++k) {
      r.x[k] = x[k][i];
      r.y[k] = y[k][i];
      r.z[k] = z[k][i];
    }
    r.triangle = (uint32_t)t.triangle[i];
    r.area = divisor(area[i]);
    r.dzdx = dzdx[i];
    r.dzdy = dzdy[i];
    r.zmin = zmin[i];
    r.zmax = zmax[i];
    r.x0 = x0[i];
    r.y0 = y0[i];
    r.x1 = x1[i];
    r.y1 = y1[i];
    r.flags = (uint32_t)flags[i];
    r.view = job.view;
    if (candidates) candidates[n] = (uint32_t)touched[i];
    ++n;
  }
  return n;
}

// Sets up one triangle, by the code of core/: one that crosses a clip plane, and any on a rung that vectors do not hold.
// Returns the number of records.
int set_up_one(const SetupJob& job, int64_t t, Record* records, uint32_t* candidates, int64_t* dropped) {
  Parent parent;
  *dropped += expand_triangle(job.frame, t, &parent) == Fate::kDropped;
  for (int s = 0; s < parent.count; ++s) {
    fill_record(parent.primitive[s], t, records + s, kDirectPixels);
    records[s].view = job.view;
    if (candidates) candidates[s] = (uint32_t)bin_box(records[s]).count;
  }
  return parent.count;
}

// How many triangles before its turn the vertices of a triangle are fetched into the cache. In a mesh whose triangles
// come in random order they lie anywhere.
constexpr int kAhead = 16;

// Fate::kNothing needs no case: such a triangle gives no record, and is not counted as dropped.
int64_t setup(const SetupJob& job, int64_t begin, int64_t end, Record* records, uint32_t* candidates,
              int64_t* dropped) {
  int64_t n = 0;
  *dropped = 0;
  const auto place = [&] { return candidates ? candidates + n : nullptr; };
  if constexpr (!kSetsUpEight) {
    for (int64_t t = begin; t < end; ++t) n += set_up_one(job, t, records + n, place(), dropped);
    return n;
  }
  Eight whole = {};
  int waiting = 0;  // triangles in `whole`
  for (int64_t t = begin; t < end; ++t) {
    const int32_t* index = job.frame.triangles + 3 * t;
    if (job.vertices && job.frame.count - t > kAhead)
      for (int k = 0; k < 3; ++k) __builtin_prefetch(job.vertices + (index[3 * kAhead + k] - job.first_vertex));
    uint32_t flags[3];
    for (int k = 0; k < 3; ++k) {
      const Vertex v = vertex_of(job, index[k]);
      whole.x[k][waiting] = v.x;
      whole.y[k][waiting] = v.y;
      whole.z[k][waiting] = v.z;
      flags[k] = v.flags;
    }
    whole.triangle[waiting] = t;
    const Fate fate = fate_of(flags[0], flags[1], flags[2]);
    if (fate == Fate::kWhole) {
      if (++waiting < 8) continue;
      n += set_up_eight(job, whole, waiting, records + n, place());
      waiting = 0;
    } else if (fate == Fate::kClip) {
      // Those that wait come first: records stand in the order of their triangles, whatever the shares are.
      if (waiting) n += set_up_eight(job, whole, waiting, records + n, place());
      waiting = 0;
      n += set_up_one(job, t, records + n, place(), dropped);
    } else if (fate == Fate::kDropped) {
      ++*dropped;
    }
  }
  return n + set_up_eight(job, whole, waiting, records + n, place());
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// Projection, snapping, orientation, culling: from clip space to records; docs/numerics.md 2. Mirrors bigtri/reference/setup.py.
#pragma once

#include "clip.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

// Vertex flags: bits 0-5 outside plane k.
constexpr uint32_t kOutsideMask = (1u << kPlanes) - 1;
constexpr uint32_t kNonFinite = 1u << 6;
constexpr uint32_t kBehind = 1u << 7;  // w <= 0

// One projected vertex: subpx, window depth, flags. X, Y and z count only where no flag is set.
struct Vertex {
  int32_t x, y;
  float z;
  uint32_t flags;
};

// One oriented, culled, non-empty (sub)triangle. order[k]: which of the three vertices given is record vertex k.
struct Primitive {
  int32_t x[3], y[3];
  float z[3];
  int32_t order[3];
  int32_t x0, y0, x1, y1;  // bbox, px, half-open
  int64_t area;
};

// Half to even, for |v| < 2^51; no library call, the same on every target.
BIGTRI_HD double round_half_even(double v) {
  const double magic = 6755399441055744.0;  // 1.5 * 2^52
  return (v + magic) - magic;
}

// low and high are integers, so clamping before rounding gives what clamping after it gives. A NaN becomes anything between.
BIGTRI_HD int32_t clamp_round(double v, int32_t low, int32_t high) {
#if defined(__CUDA_ARCH__)
  return min_of(max_of(__double2int_rn(v), low), high);  // what is beyond int32 becomes its end
#else
  v = v >= low ? v : low;
  v = v <= high ? v : high;
  return (int32_t)round_half_even(v);
#endif
}

template <class W>  // double or Divisor
BIGTRI_HD int32_t snap_x(double x, const W& w, int width) {
  const int32_t half = kHalf * width;
  return half + clamp_round(quotient(x, w) * half, -kGuard - half, kGuard - 1 - half);
}

template <class W>
BIGTRI_HD int32_t snap_y(double y, const W& w, int height) {
  const int32_t half = kHalf * height;
  return half - clamp_round(quotient(y, w) * half, half - kGuard + 1, half + kGuard);
}

template <class T>
BIGTRI_HD float window_depth(T z_by_w) {
  return (float)(z_by_w * (T)0.5 + (T)0.5);
}

// z / w in float32, w a float32: a GPU takes the inverse that is there already. Rounding a quotient of two float32 numbers to float64 first does not change what float32 it rounds to
// (Figueroa 1995, "When is double rounding innocuous?").
BIGTRI_HD float float_quotient(float z, const Divisor& w) {
#if defined(__CUDA_ARCH__)
  return (float)quotient(z, w);
#else
  return z / (float)w.value;
#endif
}

// Inside the view frustum, whose planes all six clip planes lie outside of or on: most vertices, for seven comparisons. A NaN is not; an infinite w would be.
BIGTRI_HD bool in_frustum(const float v[4]) {
  const float w = v[3];
  return (w > 0) & (w < kInfinity) & (v[0] <= w) & (v[0] >= -w) & (v[1] <= w) & (v[1] >= -w) & (v[2] <= w) &
         (v[2] >= -w);
}

BIGTRI_HD uint32_t vertex_flags(const float v[4], int width, int height) {
  uint32_t flags = 0;
  if (in_frustum(v)) return flags;
  for (int k = 0; k < kPlanes; ++k)
    if (!(plane_distance(clip_plane(k, width, height), v) >= 0)) flags |= 1u << k;
  if (!(is_finite(v[0]) && is_finite(v[1]) && is_finite(v[2]) && is_finite(v[3]))) flags |= kNonFinite;
  if (!(v[3] > 0)) flags |= kBehind;
  return flags;
}

BIGTRI_HD Vertex project_vertex(const float v[4], int width, int height) {
  const Divisor w = divisor(v[3]);
  return {snap_x(v[0], w, width), snap_y(v[1], w, height), window_depth(float_quotient(v[2], w)),
          vertex_flags(v, width, height)};
}

// Element i of three. Not an array: a GPU keeps those that are indexed with what it cannot know in slow memory.
template <class T>
BIGTRI_HD T pick(const T v[3], int i) {
  return i == 0 ? v[0] : i == 1 ? v[1] : v[2];
}

// false: nothing to draw (zero area, culled, or no pixel centre within the bounds).
BIGTRI_HD bool make_primitive(const int32_t x[3], const int32_t y[3], const float z[3], const Viewport& view,
                              Primitive* out) {
  const int64_t area = twice_area(x, y);
  if (area == 0) return false;
  if (view.cull == (area > 0 ? kCullBack : kCullFront)) return false;
  const int32_t min_x = min_of(min_of(x[0], x[1]), x[2]), max_x = max_of(max_of(x[0], x[1]), x[2]);
  const int32_t min_y = min_of(min_of(y[0], y[1]), y[2]), max_y = max_of(max_of(y[0], y[1]), y[2]);
  // The first centre at or after the minimum, and one past the last at or before the maximum; >> is floor.
  out->x0 = max_of((min_x + kHalf - 1) >> kSubpixelBits, view.x0);
  out->y0 = max_of((min_y + kHalf - 1) >> kSubpixelBits, view.y0);
  out->x1 = min_of(((max_x - kHalf) >> kSubpixelBits) + 1, view.x1);
  out->y1 = min_of(((max_y - kHalf) >> kSubpixelBits) + 1, view.y1);
  if (out->x0 >= out->x1 || out->y0 >= out->y1) return false;
  // From the vertex with the smallest (X, Y), there is one, in clockwise order.
  int source = 0;
  for (int k = 1; k < 3; ++k)
    if (x[k] < pick(x, source) || (x[k] == pick(x, source) && y[k] < pick(y, source))) source = k;
  const int step = area > 0 ? 1 : 2;
  for (int k = 0; k < 3; ++k) {
    out->x[k] = pick(x, source);
    out->y[k] = pick(y, source);
    out->z[k] = pick(z, source);
    out->order[k] = source;
    source += step;
    source = source > 2 ? source - 3 : source;
  }
  out->area = area > 0 ? area : -area;
  return true;
}

// One vertex of a clipped polygon, projected.
BIGTRI_HD Vertex project_clipped(const ClipVertex& v, int width, int height) {
  Vertex out;
  const double w = v.position[3];
  out.x = (v.made & 2) ? -kGuard : (v.made & 4) ? kGuard - 1 : snap_x(v.position[0], w, width);
  out.y = (v.made & 8) ? -kGuard : (v.made & 16) ? kGuard - 1 : snap_y(v.position[1], w, height);
  if (v.made == 0)  // an original vertex: from its float32 inputs, as if it had not been clipped
    out.z = window_depth((float)v.position[2] / (float)w);
  else  // rounding may have put it a little in front of the near plane
    out.z = (v.made & (1u << kNear)) ? 0.0f : max_of(window_depth(v.position[2] / w), 0.0f);
  out.flags = 0;
  return out;
}

// What a clipped triangle becomes: a fan of projected vertices, and where they came from.
struct Fan {
  ClipVertex polygon[kMaxPolygon];
  Vertex projected[kMaxPolygon];
  int count;  // vertices
  int first;  // corner that is slot 0
  int apex;  // vertex that all sub-triangles share
};

BIGTRI_HD bool fan_less(const Vertex& a, double aw, const Vertex& b, double bw) {
  if (a.x != b.x) return a.x < b.x;
  if (a.y != b.y) return a.y < b.y;
  if (a.z != b.z) return a.z < b.z;
  return aw < bw;
}

// The fan's apex: the vertex with the smallest (X, Y, z, w), the first one on a tie.
BIGTRI_HD int fan_apex(const Vertex* projected, const ClipVertex* polygon, int count) {
  int apex = 0;
  for (int i = 1; i < count; ++i)
    if (fan_less(projected[i], polygon[i].position[3], projected[apex], polygon[apex].position[3])) apex = i;
  return apex;
}

BIGTRI_HD void make_fan(const float v[3][4], uint32_t outside, int width, int height, Fan* fan) {
  fan->count = clip_triangle(v, outside, width, height, fan->polygon, &fan->first);
  for (int i = 0; i < fan->count; ++i) fan->projected[i] = project_clipped(fan->polygon[i], width, height);
  fan->apex = fan_apex(fan->projected, fan->polygon, fan->count);
}

// Polygon vertex numbers of sub-triangle s of a fan of count vertices, s = 0 .. count - 3.
BIGTRI_HD void fan_vertices(int apex, int count, int s, int index[3]) {
  index[0] = apex;
  index[1] = (apex + s + 1) % count;
  index[2] = (apex + s + 2) % count;
}

// Sub-triangle s; projected: the polygon's vertices.
BIGTRI_HD bool fan_primitive(const Vertex* projected, int apex, int count, int s, const Viewport& view,
                             Primitive* out) {
  int index[3];
  fan_vertices(apex, count, s, index);
  int32_t x[3], y[3];
  float z[3];
  for (int k = 0; k < 3; ++k) {
    x[k] = projected[index[k]].x;
    y[k] = projected[index[k]].y;
    z[k] = projected[index[k]].z;
  }
  return make_primitive(x, y, z, view, out);
}

enum class Fate { kDropped, kNothing, kWhole, kClip };

// What becomes of a triangle, by the flags of its vertices.
BIGTRI_HD Fate fate_of(uint32_t a, uint32_t b, uint32_t c) {
  const uint32_t any = a | b | c;
  if (any == 0) return Fate::kWhole;
  if (any & kNonFinite) return Fate::kDropped;
  if (a & b & c & kOutsideMask) return Fate::kNothing;
  // With all three inside every plane, w <= 0 is left to the point (0, 0, 0, 0), which has no place on the screen.
  return (any & kOutsideMask) ? Fate::kClip : Fate::kNothing;
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

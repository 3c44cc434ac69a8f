// Projection, snapping, fans, orientation and culling; docs/numerics.md 2. The first stage: it turns clip-space
// triangles into primitives, from which record.h makes records. Mirrors bigtri/reference/setup.py.
#pragma once

#include "clip.h"
#include "float_pair.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

// Vertex flags. Bits 0 to 5: the vertex is outside plane k.
constexpr uint32_t kOutsideMask = (1u << kPlanes) - 1;
constexpr uint32_t kNonFinite = 1u << 6;  // a component is infinite or a NaN
constexpr uint32_t kBehind = 1u << 7;     // w <= 0 or a NaN
// Beyond the screen's left, right, lower and upper border. Only three vertices beyond the same one matter: whatever
// clipping leaves of their triangle lies beyond it too, by no more than rounding within it, and so half a pixel away
// from the nearest pixel centre. Such a triangle need not be clipped.
constexpr uint32_t kScreenMask = 0xfu << 8;

// One projected vertex. x, y and z are meaningful only if no flag but those in kScreenMask is set.
struct Vertex {
  int32_t x, y;    // snapped, subpx
  float z;         // window depth, or reversed depth (vertex_depth)
  uint32_t flags;  // bits as above
};

// Vertices in px that are not snapped, where the rung's coverage needs them; else nothing, which takes no room as a base.
template <bool kHas>
struct PlacesOf {};
template <>
struct PlacesOf<true> {
  float px[3], py[3];
};
using Places = PlacesOf<kUnsnapped>;

// One (sub)triangle that was not culled and has a pixel centre in its bbox. Its vertices run clockwise on the screen,
// from the one with the smallest (X, Y).
struct Primitive : Places {
  int32_t x[3], y[3];      // snapped vertices, subpx
  float z[3];              // window depth
  int32_t order[3];        // order[k]: which of the three vertices given is record vertex k
  int32_t x0, y0, x1, y1;  // bbox, px, half-open
  int64_t area;            // twice the area, subpx^2, > 0
};

// Rounds half to even, for |v| < 2^51, without a library call and alike on every target. v + magic lies in [2^52,
// 2^53), where float64 numbers are 1 apart. So the addition rounds v to an integer, and the subtraction is exact.
BIGTRI_HD double round_half_even(double v) {
  const double magic = 6755399441055744.0;  // 1.5 * 2^52
  return (v + magic) - magic;
}

// v, rounded half to even and clamped to [low, high]. The bounds are integers, so the order of rounding and clamping
// does not matter. A NaN gives some number in [low, high].
BIGTRI_HD int32_t clamp_round(double v, int32_t low, int32_t high) {
#if defined(__CUDA_ARCH__)
  // The conversion saturates: a number beyond int32 becomes int32's nearest end.
  return min_of(max_of(__double2int_rn(v), low), high);
#else
  v = v >= low ? v : low;
  v = v <= high ? v : high;
  return (int32_t)round_half_even(v);
#endif
}

// X of a vertex, subpx; numerics.md 2.2. W is double or Divisor.
template <class W>
BIGTRI_HD int32_t snap_x(double x, const W& w, int width) {
  const int32_t half = kHalf * width;
  return half + clamp_round(quotient(x, w) * half, -kGuard - half, kGuard - 1 - half);
}

// Y of a vertex, subpx, downwards.
template <class W>
BIGTRI_HD int32_t snap_y(double y, const W& w, int height) {
  const int32_t half = kHalf * height;
  return half - clamp_round(quotient(y, w) * half, half - kGuard + 1, half + kGuard);
}

// The twin of snap_x() and snap_y() in pairs of float32, for GPUs on which float64 is slow: x / w * half, rounded half to
// even. by_w is 1 / w as inverse() has it; half: at most 24 bits long. False where pairs do not decide it, and for
// numbers beyond 2^22.
//
// Up to there the product is off by 40 u^2 of it, float64's by 2^-52 of it, and what is left of it beyond the nearest
// integer by u / 2, u = 2^-24: below 2^-20 together.
BIGTRI_HD bool pair_snap(float x, FloatPair by_w, int half, int32_t low, int32_t high, int32_t* snapped) {
  constexpr float kMagic =
      12582912.0f;  // 1.5 * 2^23: sums with it are rounded to integers, which their lowest bits hold
  constexpr float kError = 1.0f / (1 << 20);
  const FloatPair v = product((float)half, product(x, by_w));
  const float moved = v.hi + kMagic, rest = (v.hi - (moved - kMagic)) + v.lo;  // at most a little over 1/2
  const int32_t beyond = rest > 0.5f ? 1 : rest < -0.5f ? -1 : 0;
  *snapped = min_of(max_of((int32_t)(float_bits(moved) - float_bits(kMagic)) + beyond, low), high);
  const float size = v.hi < 0 ? -v.hi : v.hi, part = rest < 0 ? -rest : rest;
  return size < 4194304.0f && !(part > 0.5f - kError && part < 0.5f + kError);
}

// T is float for original vertices, and double for those that clipping made.
template <class T>
BIGTRI_HD float window_depth(T z_by_w) {
  return (float)(z_by_w * (T)0.5 + (T)0.5);
}

// The depth of a vertex from its z / w: window depth, 0 at the near plane and 1 at the far one, or where the rung has it
// reversed, 1 at the near plane and 0 at the far one.
constexpr bool kReversedDepth = Rung::kDepth == DepthRule::kReversed;
template <class T>
BIGTRI_HD float vertex_depth(T z_by_w) {
  return kReversedDepth ? (float)z_by_w : window_depth(z_by_w);
}

// z / w in float32, where w holds a float32. A GPU has the inverse of w already, so it divides in float64 and rounds
// again. Rounding the quotient of two float32 numbers to float64 first does not change the float32 result (Figueroa
// 1995, "When is double rounding innocuous?").
BIGTRI_HD float float_quotient(float z, const Divisor& w) {
#if defined(__CUDA_ARCH__)
  if constexpr (kSlowFloat64) return z / (float)w.value;
  return (float)quotient((double)z, w);
#else
  return z / (float)w.value;
#endif
}

// Whether the vertex is finite and inside the view frustum. All six clip planes lie on the frustum's planes or outside
// of them, so such a vertex needs no flag. Most vertices are settled by these eight comparisons. A NaN fails them; an
// infinite w passes all but the second.
BIGTRI_HD bool in_frustum(const float v[4]) {
  const float w = v[3];
  return (w > 0) & (w < kInfinity) & (v[0] <= w) & (v[0] >= -w) & (v[1] <= w) & (v[1] >= -w) & (v[2] <= w) &
         (v[2] >= -w);
}

// The negated comparisons set the flags for a NaN too.
BIGTRI_HD uint32_t vertex_flags(const float v[4], int width, int height) {
  uint32_t flags = 0;
  if (in_frustum(v)) return flags;
  for (int k = 0; k < kPlanes; ++k)
    if (!(plane_distance(clip_plane(k, width, height), v) >= 0)) flags |= 1u << k;
  if (!(is_finite(v[0]) && is_finite(v[1]) && is_finite(v[2]) && is_finite(v[3]))) flags |= kNonFinite;
  if (!(v[3] > 0)) flags |= kBehind;
  for (int k = 0; k < 2; ++k) flags |= (v[k] < -v[3] ? 1u : v[k] > v[3] ? 2u : 0u) << (8 + 2 * k);
  return flags;
}

// Where a vertex snaps to that pairs do not decide. A call, so that its registers cost the others nothing.
struct SnappedPlace {
  int32_t x, y;
};
BIGTRI_HD __attribute__((noinline)) SnappedPlace snap_in_float64(float x, float y, float w, int width, int height) {
  const Divisor by = divisor(w);
  return {snap_x(x, by, width), snap_y(y, by, height)};
}

// The twin of project_vertex() without float64. A vertex that is outside of a plane has no place, and nobody asks.
BIGTRI_HD Vertex project_by_pairs(const float v[4], int width, int height) {
  const uint32_t flags = vertex_flags(v, width, height);
  if (flags & ~kScreenMask) return {0, 0, 0.0f, flags};
  const int32_t right = kHalf * width, down = kHalf * height;
  const FloatPair by_w = inverse({v[3], 0.0f});
  SnappedPlace at;
  const bool decided = (v[3] > 0x1p-60f) & (v[3] < 0x1p60f) &
                       pair_snap(v[0], by_w, right, -kGuard - right, kGuard - 1 - right, &at.x) &
                       pair_snap(v[1], by_w, down, down - kGuard + 1, down + kGuard, &at.y);
  at = {right + at.x, down - at.y};
  if (!decided) at = snap_in_float64(v[0], v[1], v[3], width, height);
  return {at.x, at.y, vertex_depth(v[2] / v[3]), flags};
}

BIGTRI_HD Vertex project_vertex(const float v[4], int width, int height) {
  if constexpr (kSlowFloat64) return project_by_pairs(v, width, height);
  const Divisor w = divisor(v[3]);
  return {snap_x(v[0], w, width), snap_y(v[1], w, height), vertex_depth(float_quotient(v[2], w)),
          vertex_flags(v, width, height)};
}

// v[i], selected by comparisons: a GPU would put an array with an index unknown at compile time in local memory, which
// is slow.
template <class T>
BIGTRI_HD T pick(const T v[3], int i) {
  return i == 0 ? v[0] : i == 1 ? v[1] : v[2];
}

// Pixels whose centres lie in the bbox of three vertices, within the scissor; half-open.
struct PixelBox {
  int32_t x0, y0, x1, y1;
};
BIGTRI_HD PixelBox pixel_box(const int32_t x[3], const int32_t y[3], const Viewport& view) {
  const int32_t min_x = min_of(min_of(x[0], x[1]), x[2]), max_x = max_of(max_of(x[0], x[1]), x[2]);
  const int32_t min_y = min_of(min_of(y[0], y[1]), y[2]), max_y = max_of(max_of(y[0], y[1]), y[2]);
  // Pixels from the first centre at or after the minimum to the last centre at or before the maximum. >> rounds down,
  // so the first is ceil((min - kHalf) / kSubpixel), as kSubpixel = 2 * kHalf.
  return {max_of((min_x + kHalf - 1) >> kSubpixelBits, view.x0), max_of((min_y + kHalf - 1) >> kSubpixelBits, view.y0),
          min_of(((max_x - kHalf) >> kSubpixelBits) + 1, view.x1),
          min_of(((max_y - kHalf) >> kSubpixelBits) + 1, view.y1)};
}

// Makes a primitive of three projected vertices. False if there is nothing to draw: the area is zero, the face is
// culled, or the bbox holds no pixel centre inside the scissor.
BIGTRI_HD bool make_primitive(const int32_t x[3], const int32_t y[3], const float z[3], const Viewport& view,
                              Primitive* out) {
  const int64_t area = twice_area(x, y);
  if (area == 0) return false;
  if (view.cull == (area > 0 ? kCullBack : kCullFront)) return false;
  const PixelBox box = pixel_box(x, y, view);
  out->x0 = box.x0, out->y0 = box.y0, out->x1 = box.x1, out->y1 = box.y1;
  if (out->x0 >= out->x1 || out->y0 >= out->y1) return false;
  // Order the vertices clockwise, from the one with the smallest (X, Y). It is unique, since the area is not zero.
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

// Projects one vertex of a clipped polygon. A vertex that a guard band plane made lies exactly on the guard band's
// border: bits 1 to 4 of made are X-, X+, Y- and Y+.
BIGTRI_HD Vertex project_clipped(const ClipVertex& v, int width, int height) {
  Vertex out;
  const double w = v.position[3];
  out.x = (v.made & 2) ? -kGuard : (v.made & 4) ? kGuard - 1 : snap_x(v.position[0], w, width);
  out.y = (v.made & 8) ? -kGuard : (v.made & 16) ? kGuard - 1 : snap_y(v.position[1], w, height);
  // An original vertex gets the depth that it has in triangles that are not clipped, from its float32 inputs. Rounding
  // may have left a new vertex a little in front of the near plane; its depth is clamped to that of the plane.
  if (v.made == 0)
    out.z = vertex_depth((float)v.position[2] / (float)w);
  else if (kReversedDepth)
    out.z = (v.made & (1u << kNear)) ? 1.0f : min_of(vertex_depth(v.position[2] / w), 1.0f);
  else
    out.z = (v.made & (1u << kNear)) ? 0.0f : max_of(vertex_depth(v.position[2] / w), 0.0f);
  out.flags = 0;
  return out;
}

// A clipped triangle: a polygon, to be cut into count - 2 sub-triangles that share one vertex.
struct Fan {
  ClipVertex polygon[kMaxPolygon];  // in clip space
  Vertex projected[kMaxPolygon];    // the same vertices, projected
  int count;                        // vertices; 0 if nothing is left
  int first;                        // the triangle's corner that is slot 0
  int apex;                         // the vertex that all sub-triangles share
};

// Whether (X, Y, z, w) of a is lexicographically less than that of b.
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

// Clips and projects a triangle. outside: the planes (bit k) that at least one vertex is outside of.
BIGTRI_HD void make_fan(const float v[3][4], uint32_t outside, int width, int height, Fan* fan) {
  fan->count = clip_triangle(v, outside, width, height, fan->polygon, &fan->first);
  for (int i = 0; i < fan->count; ++i) fan->projected[i] = project_clipped(fan->polygon[i], width, height);
  fan->apex = fan_apex(fan->projected, fan->polygon, fan->count);
}

// The polygon vertices of sub-triangle s, s = 0 .. count - 3, of a fan with count vertices.
BIGTRI_HD void fan_vertices(int apex, int count, int s, int index[3]) {
  index[0] = apex;
  index[1] = (apex + s + 1) % count;
  index[2] = (apex + s + 2) % count;
}

// Makes a primitive of sub-triangle s. projected: the polygon's vertices. False as in make_primitive.
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

// What becomes of a triangle: dropped and counted, not drawn, kept unclipped, or clipped.
enum class Fate { kDropped, kNothing, kWhole, kClip };

// a, b, c: the flags of the triangle's vertices.
BIGTRI_HD Fate fate_of(uint32_t a, uint32_t b, uint32_t c) {
  const uint32_t any = (a | b | c) & ~kScreenMask;
  if (any & kNonFinite) return Fate::kDropped;
  // A vertex that float32 made may lie far from where it should, and on the screen.
  constexpr uint32_t kRejecting = Rung::kClip == ClipRule::kFloat32 ? kOutsideMask : kOutsideMask | kScreenMask;
  if (a & b & c & kRejecting) return Fate::kNothing;
  if (any == 0) return Fate::kWhole;
  // A flag is set here. If it is no plane's, it is kBehind: some vertex has w <= 0. It is (0, 0, 0, 0), which has no
  // place on the screen: the near and depth distances add up to 5w >= 0, so w = 0; these two then give z = 0, and the
  // others x = y = 0.
  return (any & kOutsideMask) && Rung::kClip != ClipRule::kNone ? Fate::kClip : Fate::kNothing;
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

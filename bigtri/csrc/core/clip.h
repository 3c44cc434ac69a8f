// Homogeneous clipping in float64; docs/numerics.md 2.1. Mirrors bigtri/reference/clip.py.
#pragma once

#include "exact.h"
#include "numerics.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

constexpr int kPlanes = 6;  // near, X-, X+, Y-, Y+, depth
constexpr int kNear = 0;
// A convex polygon gains at most one vertex per plane. Rounding can leave one that is not quite convex: with r runs of vertices outside, n - r are kept at most
// and 2r are new, so n grows to 3n/2 at most: 3, 4, 6, 9, 13, 19, 28.
constexpr int kMaxPolygon = 28;
constexpr int kMaxSubTriangles = kMaxPolygon - 2;

// d = a * v[p] + b * v[q]; inside where d >= 0.
struct Plane {
  int p, q;
  double a, b;
};

BIGTRI_HD Plane clip_plane(int k, int width, int height) {
  const double w = (double)kHalf * width, h = (double)kHalf * height, low = kGuard, high = kGuard - 1;
  switch (k) {
    case 0: return {2, 3, 1.0, 1.0};
    case 1: return {0, 3, w, w + low};
    case 2: return {3, 0, high - w, -w};
    case 3: return {3, 1, h + low, -h};
    case 4: return {3, 1, high - h, h};
    default: return {3, 2, 4.0, -1.0};
  }
}

template <class T>
BIGTRI_HD double plane_distance(const Plane& plane, const T v[4]) {
  return plane.a * (double)v[plane.p] + plane.b * (double)v[plane.q];
}

struct ClipVertex {
  double position[4];
  double weights[3];  // homogeneous, over the slots
  uint32_t edges;     // bit j: lies on original edge j (slot j to slot j + 1)
  uint32_t made;      // bit k: made by plane k
};

// 2^-k, k the exponent of v with a mantissa in [0.5, 1); v is positive and normal (a sum of float32 products).
BIGTRI_HD double reciprocal_scale(double v) {
  const int64_t k = (int64_t)((double_bits(v) >> 52) & 0x7ff) - 1022;
  return bits_double((uint64_t)(1023 - k) << 52);
}

// a * (v * u_p - v_p * u) + b * (v * u_q - v_q * u): the products are rounded (of float32 components they are exact), their sum is exact, and rounded once.
BIGTRI_HD double meet(const Plane& plane, const double u[4], const double v[4], int i) {
  double across[4], terms[8];
  two_sum(v[i] * u[plane.p], -(v[plane.p] * u[i]), &across[0], &across[1]);
  two_sum(v[i] * u[plane.q], -(v[plane.q] * u[i]), &across[2], &across[3]);
  for (int k = 0; k < 4; ++k) two_product(k < 2 ? plane.a : plane.b, across[k], &terms[2 * k], &terms[2 * k + 1]);
  return rounded_sum<8>(terms);
}

// The vertex where the plane cuts the polygon edge from a to b, which it separates: |dq| * p + |dp| * q with the distances written out, a sum that may cancel completely.
// Symmetric in p and q, bit for bit.
BIGTRI_HD ClipVertex cut_edge(const Plane& plane, int plane_index, const ClipVertex slots[3], const ClipVertex& a,
                              const ClipVertex& b) {
  ClipVertex n;
  n.edges = a.edges & b.edges;
  n.made = (1u << plane_index) | (a.made & b.made);
  const ClipVertex *p = &a, *q = &b;
  double dp = plane_distance(plane, p->position), dq = plane_distance(plane, q->position);
  if (n.edges) {
    // On an original edge: from its end points, never from a piece, so that two triangles that share it get the same vertex. Rounding of an earlier cut can
    // leave a and b on different sides while the original edge is on one; then the piece has to do.
    const int j = (n.edges & 1) ? 0 : (n.edges & 2) ? 1 : 2;
    const ClipVertex *begin = &slots[j], *end = &slots[j == 2 ? 0 : j + 1];
    const double db = plane_distance(plane, begin->position), de = plane_distance(plane, end->position);
    if ((db >= 0) != (de >= 0)) {
      p = begin;
      q = end;
      dp = db;
      dq = de;
    }
  }
  const double *u = p->position, *v = q->position;
  const double abs_p = dp < 0 ? -dp : dp, abs_q = dq < 0 ? -dq : dq;
  const double scale = reciprocal_scale(abs_p + abs_q);
  for (int i = 0; i < 4; ++i) {
    const double t = meet(plane, u, v, i);
    n.position[i] = (dp < 0 ? -t : t) * scale;
  }
  for (int i = 0; i < 3; ++i) n.weights[i] = (abs_q * p->weights[i] + abs_p * q->weights[i]) * scale;
  return n;
}

// First corner, so that the lexicographically smallest vertex becomes slot 0.
BIGTRI_HD int first_slot(const float v[3][4]) {
  int best = 0;
  for (int k = 1; k < 3; ++k)
    for (int i = 0; i < 4; ++i) {
      if (v[k][i] == v[best][i]) continue;
      if (v[k][i] < v[best][i]) best = k;
      break;
    }
  return best;
}

// Slot k, k = 0 .. 2, of a triangle whose corner `first` is slot 0. Corners by choice, not by index: a GPU keeps what is indexed with a number it cannot know in slow memory.
BIGTRI_HD ClipVertex make_slot(const float v[3][4], int first, int k) {
  const int corner = first + k > 2 ? first + k - 3 : first + k;
  ClipVertex slot;
  for (int i = 0; i < 4; ++i) slot.position[i] = corner == 0 ? v[0][i] : corner == 1 ? v[1][i] : v[2][i];
  for (int i = 0; i < 3; ++i) slot.weights[i] = i == k ? 1.0 : 0.0;
  slot.edges = (1u << k) | (1u << (k == 0 ? 2 : k - 1));
  slot.made = 0;
  return slot;
}

// Clips a triangle that no plane rejects outright. outside: the planes that at least one vertex is outside of. Returns the number of vertices
// in polygon, 0 if nothing is left. first: the corner that became slot 0.
BIGTRI_HD int clip_triangle(const float v[3][4], uint32_t outside, int width, int height,
                            ClipVertex polygon[kMaxPolygon], int* first) {
  *first = first_slot(v);
  ClipVertex slots[3], other[kMaxPolygon];
  for (int k = 0; k < 3; ++k) {
    slots[k] = make_slot(v, *first, k);
    polygon[k] = slots[k];
  }
  int n = 3;
  for (int k = 0; k < kPlanes && n > 0; ++k) {
    if (!(outside >> k & 1)) continue;
    const Plane plane = clip_plane(k, width, height);
    int m = 0;
    double da = plane_distance(plane, polygon[0].position);
    for (int i = 0; i < n; ++i) {
      const ClipVertex &a = polygon[i], &b = polygon[i + 1 == n ? 0 : i + 1];
      const double db = plane_distance(plane, b.position);
      if (da >= 0) other[m++] = a;
      if ((da >= 0) != (db >= 0)) other[m++] = cut_edge(plane, k, slots, a, b);
      da = db;
    }
    n = m;
    for (int i = 0; i < n; ++i) polygon[i] = other[i];
  }
  if (n < 3) return 0;
  for (int i = 0; i < n; ++i)
    if (!(polygon[i].position[3] > 0)) return 0;
  return n;
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

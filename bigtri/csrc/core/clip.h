// Homogeneous Sutherland-Hodgman clipping in float64; docs/numerics.md 2.1. Setup clips a triangle that has vertices
// inside and outside of a plane, and turns the polygon into a fan of records. Mirrors bigtri/reference/clip.py.
#pragma once

#include "exact.h"
#include "numerics.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

constexpr int kPlanes = 6;  // near, X-, X+, Y-, Y+, depth
constexpr int kNear = 0;
// Most vertices that a polygon can have. A convex polygon gains at most one vertex per plane, but rounding can leave
// one that is not quite convex. If r maximal sequences of consecutive vertices, of n vertices in all, are outside, at
// most n - r vertices are kept, and 2r are new. The sequences are separated, so r <= n/2, and n becomes at most 3n/2 at
// each plane: 3, 4, 6, 9, 13, 19, 28.
constexpr int kMaxPolygon = 28;
constexpr int kMaxSubTriangles = kMaxPolygon - 2;

// Distance d = a * v[p] + b * v[q], where p and q are components (x, y, z, w = 0 .. 3). A vertex is inside where d >=
// 0.
struct Plane {
  int p, q;
  double a, b;
};

// Plane k of the table in numerics.md 2.1, for an image of width by height px. The distance is in subpx times w for
// planes 1 to 4.
BIGTRI_HD Plane clip_plane(int k, int width, int height) {
  const double w = (double)kHalf * width, h = (double)kHalf * height, low = kGuard, high = kGuard - 1;
  constexpr bool kReversed = Rung::kDepth == DepthRule::kReversed;
  switch (k) {
    case 0: return kReversed ? Plane{3, 2, 1.0, -1.0} : Plane{2, 3, 1.0, 1.0};
    case 1: return {0, 3, w, w + low};
    case 2: return {3, 0, high - w, -w};
    case 3: return {3, 1, h + low, -h};
    case 4: return {3, 1, high - h, h};
    default: return {3, 2, 4.0, kReversed ? 1.0 : -1.0};
  }
}

template <class T>
BIGTRI_HD double plane_distance(const Plane& plane, const T v[4]) {
  return plane.a * (double)v[plane.p] + plane.b * (double)v[plane.q];
}

// A polygon vertex. The slots are the vertices of the triangle to be clipped, the lexicographically smallest one first.
struct ClipVertex {
  double position[4];  // clip space: x, y, z, w
  double weights[3];   // homogeneous, over the slots, not normalised
  uint32_t edges;      // bit j: lies on original edge j, from slot j to slot (j + 1) mod 3
  uint32_t made;       // bit k: made by plane k; 0 for a slot
};

// 2^-k, where v = mantissa * 2^k with the mantissa in [0.5, 1). v has to be positive and normal. It is the sum of two
// distances, which float32 inputs keep far above float64's subnormal range.
BIGTRI_HD double reciprocal_scale(double v) {
  const int64_t k = (int64_t)((double_bits(v) >> 52) & 0x7ff) - 1022;
  return bits_double((uint64_t)(1023 - k) << 52);
}

// Component i of n in numerics.md 2.1, where u is P and v is Q:
//   a * (v_i * u_p - v_p * u_i) + b * (v_i * u_q - v_q * u_i)
// The four products of components are rounded; those of float32 components are exact in float64. The rest is the exact
// sum, rounded once.
BIGTRI_HD double meet(const Plane& plane, const double u[4], const double v[4], int i) {
  double across[4], terms[8];
  two_sum(v[i] * u[plane.p], -(v[plane.p] * u[i]), &across[0], &across[1]);
  two_sum(v[i] * u[plane.q], -(v[plane.q] * u[i]), &across[2], &across[3]);
  for (int k = 0; k < 4; ++k) two_product(k < 2 ? plane.a : plane.b, across[k], &terms[2 * k], &terms[2 * k + 1]);
  return rounded_sum<8>(terms);
}

// What a new vertex is computed from: two vertices on different sides of the plane, and their distances to it.
struct Cut {
  const ClipVertex *p, *q;
  double dp, dq;
};

// Of the polygon edge from a to b, whose ends lie on different sides of the plane.
BIGTRI_HD Cut cut_of(const Plane& plane, const ClipVertex slots[3], const ClipVertex& a, const ClipVertex& b) {
  Cut cut = {&a, &b, plane_distance(plane, a.position), plane_distance(plane, b.position)};
  if (const uint32_t edges = a.edges & b.edges) {
    // The new vertex lies on an original edge. It is computed from the ends of that edge, not from the piece between a
    // and b, so that two triangles that share the edge get the same vertex. Rounding of an earlier cut can leave a and
    // b on different sides while both ends are on the same side. Only then is the piece used.
    const int j = (edges & 1) ? 0 : (edges & 2) ? 1 : 2;
    const ClipVertex *begin = &slots[j], *end = &slots[j == 2 ? 0 : j + 1];
    const double db = plane_distance(plane, begin->position), de = plane_distance(plane, end->position);
    if ((db >= 0) != (de >= 0)) cut = {begin, end, db, de};
  }
  return cut;
}

BIGTRI_HD double magnitude(double v) { return v < 0 ? -v : v; }
BIGTRI_HD double cut_scale(const Cut& c) { return reciprocal_scale(magnitude(c.dp) + magnitude(c.dq)); }

// Component i of the new vertex's position, which is |dq| * p + |dp| * q with the distances written out, since the
// terms may cancel completely. It is symmetric in p and q, bit for bit.
BIGTRI_HD double cut_position(const Plane& plane, const Cut& c, int i) {
  const double t = meet(plane, c.p->position, c.q->position, i);
  return (c.dp < 0 ? -t : t) * cut_scale(c);
}

BIGTRI_HD double cut_weight(const Cut& c, int i) {
  return (magnitude(c.dq) * c.p->weights[i] + magnitude(c.dp) * c.q->weights[i]) * cut_scale(c);
}

// Which planes made a vertex between a and b.
BIGTRI_HD uint32_t cut_made(int plane_index, const ClipVertex& a, const ClipVertex& b) {
  return (1u << plane_index) | (a.made & b.made);
}

// The vertex where a plane cuts the polygon edge from a to b.
BIGTRI_HD ClipVertex cut_edge(const Plane& plane, int plane_index, const ClipVertex slots[3], const ClipVertex& a,
                              const ClipVertex& b) {
  const Cut cut = cut_of(plane, slots, a, b);
  ClipVertex n;
  for (int i = 0; i < 4; ++i) n.position[i] = cut_position(plane, cut, i);
  for (int i = 0; i < 3; ++i) n.weights[i] = cut_weight(cut, i);
  n.edges = a.edges & b.edges;
  n.made = cut_made(plane_index, a, b);
  return n;
}

// In float32, as published code cuts (numerics.md 16): a distance, and the vertex on the polygon edge from a to b.
BIGTRI_HD float float_distance(const Plane& plane, const double v[4]) {
  return (float)plane.a * (float)v[plane.p] + (float)plane.b * (float)v[plane.q];
}
BIGTRI_HD ClipVertex cut_edge_in_float(int plane_index, const ClipVertex& a, const ClipVertex& b, float da, float db) {
  const float share = da / (da - db);
  ClipVertex n;
  for (int i = 0; i < 4; ++i) {
    const float from = (float)a.position[i], to = (float)b.position[i];
    n.position[i] = from + (to - from) * share;
  }
  for (int i = 0; i < 3; ++i) {
    const float from = (float)a.weights[i], to = (float)b.weights[i];
    n.weights[i] = from + (to - from) * share;
  }
  n.edges = a.edges & b.edges;
  n.made = cut_made(plane_index, a, b);
  return n;
}

// The corner that becomes slot 0: the lexicographically smallest (x, y, z, w), the first one on a tie.
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

// Slot k, k = 0 .. 2, of a triangle whose corner `first` is slot 0. It lies on the original edges k and (k + 2) mod 3.
// The corner is selected by comparisons: a GPU would put an array with an index unknown at compile time in local
// memory, which is slow.
BIGTRI_HD ClipVertex make_slot(const float v[3][4], int first, int k) {
  const int corner = first + k > 2 ? first + k - 3 : first + k;
  ClipVertex slot;
  for (int i = 0; i < 4; ++i) slot.position[i] = corner == 0 ? v[0][i] : corner == 1 ? v[1][i] : v[2][i];
  for (int i = 0; i < 3; ++i) slot.weights[i] = i == k ? 1.0 : 0.0;
  slot.edges = (1u << k) | (1u << (k == 0 ? 2 : k - 1));
  slot.made = 0;
  return slot;
}

// Clips a triangle that no plane rejects. outside: the planes (bit k) that at least one vertex is outside of; the
// others are skipped. Returns the number of vertices written to polygon, 0 if nothing is left to draw. first: the
// corner that became slot 0.
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
    if constexpr (Rung::kClip == ClipRule::kFloat32) {
      for (int i = 0; i < n; ++i) {
        const ClipVertex &a = polygon[i], &b = polygon[i + 1 == n ? 0 : i + 1];
        const float da = float_distance(plane, a.position), db = float_distance(plane, b.position);
        if (da >= 0) other[m++] = a;
        if ((da >= 0) != (db >= 0)) other[m++] = cut_edge_in_float(k, a, b, da, db);
      }
      n = m;
      for (int i = 0; i < n; ++i) polygon[i] = other[i];
      continue;
    }
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
  for (int i = 0; i < n; ++i) {
    if (!(polygon[i].position[3] > 0)) return 0;
    if constexpr (Rung::kClip == ClipRule::kFloat32)
      for (int c = 0; c < 4; ++c)
        if (!is_finite((float)polygon[i].position[c])) return 0;
  }
  return n;
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

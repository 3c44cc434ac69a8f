// The records of a parent triangle, and which of them covers a pixel; docs/numerics.md 2.4 and 9. A visibility buffer
// holds only the parent's index, so resolve sets the parent up again for the attribute pass. Mirrors
// bigtri/reference/resolve.py.
#pragma once

#include "coverage.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

// The parent's vertices as they were given, clip space, where the rung's attributes need them; else nothing.
template <bool kHas>
struct CornersOf {};
template <>
struct CornersOf<true> {
  float given[3][4];
};
using Corners = CornersOf<Rung::kAttributes == AttributeRule::kUnsnapped>;
BIGTRI_HD void set_corners(const float[3][4], CornersOf<false>*) {}
BIGTRI_HD void set_corners(const float v[3][4], CornersOf<true>* out) {
  for (int k = 0; k < 3; ++k)
    for (int i = 0; i < 4; ++i) out->given[k][i] = v[k][i];
}

// The records of a parent triangle in fan order, with the values that barycentrics are computed from.
template <int kRecords>
struct ParentOf : Corners {
  int count;  // records
  bool clipped;
  bool affine;                     // not clipped, and all w equal: no perspective correction
  int first;                       // clipped: the corner that is slot 0
  Primitive primitive[kRecords];   // the records' vertices, bbox and area
  double w[kRecords][3];           // clip-space w of the record's vertices
  double weights[kRecords][3][3];  // [record][vertex]: clipped: homogeneous weights over the slots; else unit vectors
};
// Room for all records that a triangle can have. A GPU has too little memory per thread for it.
using Parent = ParentOf<kMaxSubTriangles>;

// The corner of the parent that barycentric k of a record belongs to.
template <int kRecords>
BIGTRI_HD int corner_of(const ParentOf<kRecords>& p, int record, int k) {
  return p.clipped ? (p.first + k) % 3 : p.primitive[record].order[k];
}

// Sets w and weights of a record that is sub-triangle s of a fan, from its primitive.
template <int kRecords>
BIGTRI_HD void set_fan_weights(const ClipVertex* polygon, int apex, int count, int s, int record,
                               ParentOf<kRecords>* out) {
  int index[3];
  fan_vertices(apex, count, s, index);
  for (int k = 0; k < 3; ++k) {
    const ClipVertex& source = polygon[pick(index, out->primitive[record].order[k])];
    out->w[record][k] = source.position[3];
    for (int m = 0; m < 3; ++m) out->weights[record][k][m] = source.weights[m];
  }
}

// Where a vertex lies in px, not snapped, in float32 or in float64 as T is.
template <class T>
BIGTRI_HD T place_x(const T v[4], int width) {
  return ((v[0] / v[3]) * (T)0.5 + (T)0.5) * (T)width;
}
template <class T>
BIGTRI_HD T place_y(const T v[4], int height) {
  return ((T)0.5 - (v[1] / v[3]) * (T)0.5) * (T)height;
}

// Sets the places of a primitive, made of a triangle's vertices v or of sub-triangle s of a fan, where the rung has any.
// A vertex of the fan that clipping did not make is placed as in triangles that are not clipped.
BIGTRI_HD void set_places(const float[3][4], const Viewport&, const int32_t[3], PlacesOf<false>*) {}
BIGTRI_HD void set_places(const float v[3][4], const Viewport& view, const int32_t order[3], PlacesOf<true>* out) {
  for (int k = 0; k < 3; ++k) {
    out->px[k] = place_x(v[order[k]], view.width);
    out->py[k] = place_y(v[order[k]], view.height);
  }
}
BIGTRI_HD void set_fan_places(const ClipVertex*, int, int, int, const Viewport&, const int32_t[3], PlacesOf<false>*) {}
BIGTRI_HD void set_fan_places(const ClipVertex* polygon, int apex, int count, int s, const Viewport& view,
                              const int32_t order[3], PlacesOf<true>* out) {
  int index[3];
  fan_vertices(apex, count, s, index);
  for (int k = 0; k < 3; ++k) {
    const ClipVertex& source = polygon[pick(index, order[k])];
    float v[4];
    for (int i = 0; i < 4; ++i) v[i] = (float)source.position[i];
    out->px[k] = source.made ? (float)place_x(source.position, view.width) : place_x(v, view.width);
    out->py[k] = source.made ? (float)place_y(source.position, view.height) : place_y(v, view.height);
  }
}

// Sets up a parent triangle that is not clipped (Fate::kWhole) from its clip-space vertices v and their projections.
// False if it has no record.
template <int kRecords>
BIGTRI_HD bool expand_whole(const float v[3][4], const Vertex projected[3], const Viewport& view,
                            ParentOf<kRecords>* out) {
  int32_t x[3], y[3];
  float z[3];
  for (int k = 0; k < 3; ++k) {
    x[k] = projected[k].x;
    y[k] = projected[k].y;
    z[k] = projected[k].z;
  }
  set_corners(v, out);
  out->clipped = false;
  out->affine = v[0][3] == v[1][3] && v[1][3] == v[2][3];
  out->count = make_primitive(x, y, z, view, &out->primitive[0]) ? 1 : 0;
  if (out->count == 0) return false;
  set_places(v, view, out->primitive[0].order, &out->primitive[0]);
  for (int k = 0; k < 3; ++k) {
    out->w[0][k] = v[out->primitive[0].order[k]][3];
    for (int m = 0; m < 3; ++m) out->weights[0][k][m] = k == m ? 1.0 : 0.0;
  }
  return true;
}

// Sets up a parent triangle from its clip-space vertices v and their projections. out has no record unless the result
// is kWhole or kClip.
BIGTRI_HD Fate expand_parent(const float v[3][4], const Vertex projected[3], const Viewport& view, Parent* out) {
  out->count = 0;
  out->clipped = false;
  const uint32_t f0 = projected[0].flags, f1 = projected[1].flags, f2 = projected[2].flags;
  const Fate fate = fate_of(f0, f1, f2);
  if (fate == Fate::kWhole) {
    expand_whole(v, projected, view, out);
  } else if (fate == Fate::kClip) {
    Fan fan;
    make_fan(v, (f0 | f1 | f2) & kOutsideMask, view.width, view.height, &fan);
    set_corners(v, out);
    out->clipped = true;
    out->affine = false;
    out->first = fan.first;
    for (int s = 0; s + 2 < fan.count; ++s) {
      if (!fan_primitive(fan.projected, fan.apex, fan.count, s, view, &out->primitive[out->count])) continue;
      Primitive& made = out->primitive[out->count];
      set_fan_places(fan.polygon, fan.apex, fan.count, s, view, made.order, &made);
      set_fan_weights(fan.polygon, fan.apex, fan.count, s, out->count, out);
      ++out->count;
    }
  }
  return fate;
}

// The same for triangle t of a frame with one view. The triangle's indices must name vertices.
BIGTRI_HD Fate expand_triangle(const Frame& f, int64_t t, Parent* out) {
  float v[3][4];
  Vertex projected[3];
  for (int k = 0; k < 3; ++k) {
    for (int i = 0; i < 4; ++i) v[k][i] = f.positions[4 * (int64_t)f.triangles[3 * t + k] + i];
    projected[k] = project_vertex(v[k], f.view.width, f.view.height);
  }
  return expand_parent(v, projected, f.view, out);
}

// Whether the primitive covers pixel (x, y). The edges are written out: nvcc does not unroll a loop that may end early,
// and would put the arrays that it indexes in local memory.
BIGTRI_HD bool covers(const Primitive& p, int32_t x, int32_t y) {
  if constexpr (kFloatCoverage)
    return is_inside(float_edge(p, 0), x, y) && is_inside(float_edge(p, 1), x, y) && is_inside(float_edge(p, 2), x, y);
  return edge_steps(edge_of(p.x, p.y, 0), x, y) >= 0 && edge_steps(edge_of(p.x, p.y, 1), x, y) >= 0 &&
         edge_steps(edge_of(p.x, p.y, 2), x, y) >= 0;
}

// The first record in fan order that covers pixel (x, y); -1 if none does.
BIGTRI_HD int covering_record(const Parent& p, int32_t x, int32_t y) {
  for (int s = 0; s < p.count; ++s)
    if (covers(p.primitive[s], x, y)) return s;
  return -1;
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

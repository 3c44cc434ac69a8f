// The records of one parent triangle, and which of them covers a pixel; docs/numerics.md 2.4 and 9. Mirrors bigtri/reference/resolve.py.
#pragma once

#include "setup.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

// Records of a parent, with what attributes need.
template <int kRecords>
struct ParentOf {
  int count;  // records
  bool clipped;
  bool affine;  // not clipped, and all w equal
  int first;  // clipped: the corner that is slot 0
  Primitive primitive[kRecords];
  double w[kRecords][3];  // of the record's vertices
  double weights[kRecords][3][3];  // clipped: homogeneous, over the slots
};
using Parent = ParentOf<kMaxSubTriangles>;  // all of them; a GPU has no room for so many in every thread

// corner of the parent that entry k of a record's barycentrics belongs to.
template <int kRecords>
BIGTRI_HD int corner_of(const ParentOf<kRecords>& p, int record, int k) {
  return p.clipped ? (p.first + k) % 3 : p.primitive[record].order[k];
}

// w and weights of a record that is sub-triangle s of a fan.
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

BIGTRI_HD Fate expand_parent(const float v[3][4], const Vertex projected[3], const Viewport& view, Parent* out) {
  out->count = 0;
  out->clipped = false;
  out->affine = v[0][3] == v[1][3] && v[1][3] == v[2][3];
  const uint32_t f0 = projected[0].flags, f1 = projected[1].flags, f2 = projected[2].flags;
  const Fate fate = fate_of(f0, f1, f2);
  if (fate == Fate::kWhole) {
    int32_t x[3], y[3];
    float z[3];
    for (int k = 0; k < 3; ++k) {
      x[k] = projected[k].x;
      y[k] = projected[k].y;
      z[k] = projected[k].z;
    }
    if (make_primitive(x, y, z, view, &out->primitive[0])) {
      for (int k = 0; k < 3; ++k) {
        out->w[0][k] = v[out->primitive[0].order[k]][3];
        for (int m = 0; m < 3; ++m) out->weights[0][k][m] = k == m ? 1.0 : 0.0;
      }
      out->count = 1;
    }
  } else if (fate == Fate::kClip) {
    Fan fan;
    make_fan(v, (f0 | f1 | f2) & kOutsideMask, view.width, view.height, &fan);
    out->clipped = true;
    out->affine = false;
    out->first = fan.first;
    for (int s = 0; s + 2 < fan.count; ++s) {
      if (!fan_primitive(fan.projected, fan.apex, fan.count, s, view, &out->primitive[out->count])) continue;
      set_fan_weights(fan.polygon, fan.apex, fan.count, s, out->count, out);
      ++out->count;
    }
  }
  return fate;
}

// The records of triangle t of a view, whose indices all name vertices.
BIGTRI_HD Fate expand_triangle(const Frame& f, int64_t t, Parent* out) {
  float v[3][4];
  Vertex projected[3];
  for (int k = 0; k < 3; ++k) {
    for (int i = 0; i < 4; ++i) v[k][i] = f.positions[4 * (int64_t)f.triangles[3 * t + k] + i];
    projected[k] = project_vertex(v[k], f.view.width, f.view.height);
  }
  return expand_parent(v, projected, f.view, out);
}

// Not a loop: nvcc does not unroll one that may end early, and keeps in slow memory what is then indexed.
BIGTRI_HD bool covers(const Primitive& p, int32_t x, int32_t y) {
  return edge_steps(edge_of(p.x, p.y, 0), x, y) >= 0 && edge_steps(edge_of(p.x, p.y, 1), x, y) >= 0 &&
         edge_steps(edge_of(p.x, p.y, 2), x, y) >= 0;
}

// First record in fan order that covers the pixel, -1 if none does.
BIGTRI_HD int covering_record(const Parent& p, int32_t x, int32_t y) {
  for (int s = 0; s < p.count; ++s)
    if (covers(p.primitive[s], x, y)) return s;
  return -1;
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

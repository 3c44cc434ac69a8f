// Triangles as the shading pass has them, and the weights of their corners at a pixel; docs/numerics.md 9.
#pragma once

#include "clip.cuh"
#include "near_weights.cuh"
#include "skin.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// What weights are computed from, of a triangle that is not clipped; in their order.
struct alignas(16) WholeTriangle : Corners {
  Fate fate;           // kWhole: all of this is set; kClip: it has to be clipped; else nothing is drawn of it
  int32_t affine;      // whether all w are equal
  int32_t x[3], y[3];  // snapped, subpx
  Divisor area, w[3];
  int32_t clipped;  // prepared and to be clipped: which of Work::clipped it is; negative if there was no memory for it
};

// What near weights are computed from.
struct alignas(16) NearTriangle {
  Fate fate;  // as above
  int32_t x[3], y[3];
  int32_t clipped;
  double inverse_w[3];
};

// What the pixels of a triangle that is not clipped have of it.
using PixelTriangle = std::conditional_t<kNearWeights, NearTriangle, WholeTriangle>;

// A triangle that has been set up for all of its pixels.
struct PreparedTriangle {
  PixelTriangle whole;
  Skin skin;
};

// A triangle that has been clipped: its records, in fan order.
struct ClippedTriangle : Corners {  // in the order of the slots
  struct Part {
    Primitive primitive;
    Divisor area, w[3];
    double weights[3][3], inverse_w[3];
    int32_t least[3];  // edge values that are covered
  };
  Skin skin;
  int count;  // records; 0 if the triangle's material does not exist
  Part part[kMaxSubTriangles];
};

// Keeps a triangle's vertices as they were given, in an order, where the rung's attributes need them.
template <bool kHas>
__device__ __forceinline__ void set_given(const float v[3][4], const int32_t order[3], CornersOf<kHas>* out) {
  if constexpr (kHas)
    for (int k = 0; k < 3; ++k)
      for (int i = 0; i < 4; ++i) out->given[k][i] = v[order[k]][i];
}

// A vertex as triangles that are not clipped have it.
struct alignas(16) ProjectedVertex {
  int32_t x, y;  // snapped, subpx
  float w;
  uint32_t flags;
};
__device__ __forceinline__ ProjectedVertex project(const Frame& f, const float v[4]) {
  const Vertex projected = project_vertex(v, f.view.width, f.view.height);
  return {projected.x, projected.y, v[3], projected.flags};
}

// Takes over a primitive. w: clip space, in the order of its vertices.
__device__ __forceinline__ void fill(const Primitive& p, const float w[3], WholeTriangle* out) {
  for (int k = 0; k < 3; ++k) {
    out->x[k] = p.x[k];
    out->y[k] = p.y[k];
    out->w[k] = divisor(w[k]);
  }
  out->area = divisor((double)p.area);
  out->affine = w[0] == w[1] && w[1] == w[2];
}
__device__ __forceinline__ void fill(const Primitive& p, const float w[3], NearTriangle* out) {
  for (int k = 0; k < 3; ++k) {
    out->x[k] = p.x[k];
    out->y[k] = p.y[k];
    out->inverse_w[k] = near_inverse(w[k]);
  }
}
__device__ __forceinline__ void fill_given(const float[3][4], const int32_t[3], NearTriangle*) {}
__device__ __forceinline__ void fill_given(const float v[3][4], const int32_t order[3], WholeTriangle* out) {
  set_given(v, order, out);
}

// Sets up a triangle. If it is to be drawn as it is, vertex gets its indices, in the order of the weights, and back
// whether its back is seen, where that matters. projected: the view's vertices, or null. T: WholeTriangle or
// NearTriangle.
template <class T>
__device__ __forceinline__ void set_up_whole(const Shading& job, int64_t view, int32_t triangle,
                                             const ProjectedVertex* projected, T* out, int32_t vertex[3], bool* back) {
  const Frame f = frame_of(job, view);
  int32_t index[3] = {};
  out->fate = Fate::kDropped;
  if (!load_indices(f, triangle, index)) return;
  ProjectedVertex corner[3];
  if (projected) {
    for (int k = 0; k < 3; ++k) corner[k] = loaded(projected + index[k]);
  } else {
    float given[3][4];  // all are loaded before the first is used
    for (int k = 0; k < 3; ++k) load_vertex(f, index[k], given[k]);
    for (int k = 0; k < 3; ++k) corner[k] = project(f, given[k]);
  }
  Vertex v[3];
  float w[3];
  for (int k = 0; k < 3; ++k) {
    v[k] = {corner[k].x, corner[k].y, 0.0f, corner[k].flags};
    w[k] = corner[k].w;
  }
  Primitive p = {};
  out->fate = assemble(f, v, &p);
  if (out->fate != Fate::kWhole) return;
  float in_order[3];
  for (int k = 0; k < 3; ++k) {
    vertex[k] = pick(index, p.order[k]);
    in_order[k] = pick(w, p.order[k]);
  }
  fill(p, in_order, out);
  *back = false;
  if (kUnsnappedWeights || job.surface.two_sided) {
    float given[3][4];
    for (int k = 0; k < 3; ++k) load_vertex(f, index[k], given[k]);
    fill_given(given, p.order, out);
    *back = job.surface.two_sided && is_back(given[0], given[1], given[2]);
  }
}

// The same with its skin, for all of its pixels. A triangle of no material is not drawn.
__device__ __forceinline__ void prepare(const Shading& job, int64_t view, int32_t triangle, PreparedTriangle* out) {
  int32_t vertex[3];
  bool back;
  set_up_whole(job, view, triangle, nullptr, &out->whole, vertex, &back);
  Fate* fate = &out->whole.fate;
  if (*fate != Fate::kWhole) return;
  if (load_skin(job, triangle, vertex, back, &out->skin))
    light_face(job.surface, &out->skin);
  else
    *fate = Fate::kNothing;
}

// Whether a triangle has to be clipped.
__device__ __forceinline__ bool is_clipped(const Shading& job, int64_t view, int32_t triangle) {
  const Frame f = frame_of(job, view);
  int32_t index[3];
  if (!load_indices(f, triangle, index)) return false;
  uint32_t flags[3];
  for (int k = 0; k < 3; ++k) {
    float v[4];
    load_vertex(f, index[k], v);
    flags[k] = vertex_flags(v, job.width, job.height);
  }
  return fate_of(flags[0], flags[1], flags[2]) == Fate::kClip;
}

// The same by the flags of the view's vertices, as project() made them.
__device__ __forceinline__ bool is_clipped_by(const Shading& job, int32_t triangle, const uint16_t* flags) {
  int32_t index[3];
  return load_indices(frame_of(job, 0), triangle, index) &&
         fate_of(flags[index[0]], flags[index[1]], flags[index[2]]) == Fate::kClip;
}

// Clips a triangle, whose indices name vertices, with all lanes.
__device__ __noinline__ void clip(const Shading& job, int64_t view, int32_t triangle, ClipScratch* scratch,
                                  ClippedTriangle* out) {
  const Frame f = frame_of(job, view);
  int32_t index[3];
  float v[3][4];
  load_indices(f, triangle, index);
  for (int k = 0; k < 3; ++k) load_vertex(f, index[k], v[k]);
  const int n = clip_polygon(v, f.view.width, f.view.height, scratch), lane = lane_id();
  ParentOf<1> parent;
  Primitive& p = parent.primitive[0];
  bool made = false;
  if (lane + 2 < n) {
    const int apex = fan_apex(scratch->projected, scratch->polygon, n);
    made = fan_primitive(scratch->projected, apex, n, lane, f.view, &p);
    if (made) {
      set_fan_places(scratch->polygon, apex, n, lane, f.view, p.order, &p);
      set_fan_weights(scratch->polygon, apex, n, lane, 0, &parent);
    }
  }
  const unsigned all = __ballot_sync(kAllLanes, made);
  if (made) {
    ClippedTriangle::Part& part = out->part[__popc(all & lanes_below())];
    part.primitive = p;
    part.area = divisor((double)p.area);
    for (int k = 0; k < 3; ++k) {
      part.w[k] = divisor(parent.w[0][k]);
      part.inverse_w[k] = near_inverse(parent.w[0][k]);
      part.least[k] = -(int32_t)edge_bias(edge_of(p.x, p.y, k));
      for (int m = 0; m < 3; ++m) part.weights[k][m] = parent.weights[0][k][m];
    }
  }
  if (lane == 0) {
    const int first = first_slot(v);
    const int32_t slots[3] = {first, (first + 1) % 3, (first + 2) % 3};
    const int32_t vertex[3] = {index[slots[0]], index[slots[1]], index[slots[2]]};
    const bool back = job.surface.two_sided && is_back(v[0], v[1], v[2]);
    out->count = load_skin(job, triangle, vertex, back, &out->skin) ? __popc(all) : 0;
    if (out->count > 0) light_face(job.surface, &out->skin);
    set_given(v, slots, out);
  }
  __syncwarp();
}

// By the vertices as they were given, where that is the rung's rule: the weights of a view's pixel (x, y).
template <bool kHas, class D>
__device__ __forceinline__ void weigh_unsnapped(const Shading& job, const CornersOf<kHas>& corners, int x, int y,
                                                D b[3]) {
  if constexpr (kHas)
    unsnapped_weights(corners.given, device_coordinate((D)x, job.width),
                      device_coordinate((double)(job.height - 1 - y), job.height), b);
}

// What weights are rounded from.
using WeightNumber = std::conditional_t<kFloatWeights, float, double>;

// Edge values of a view's pixel (x, y). T has x and y of three corners.
template <class T>
__device__ __forceinline__ void edges_at(const T& t, int x, int y, WeightNumber e[3]) {
  for (int k = 0; k < 3; ++k)
    e[k] = (WeightNumber)(double)edge_value(edge_of(t.x, t.y, k), pixel_centre(x), pixel_centre(y));
}

// By the rule. t: of this view and triangle, as everywhere below.
__device__ __forceinline__ void weigh(const Shading& job, int64_t view, int32_t triangle, const WholeTriangle& t, int x,
                                      int y, float weight[3]) {
  WeightNumber e[3], b[3];
  if constexpr (kUnsnappedWeights) {
    weigh_unsnapped(job, t, x, y, b);
  } else if constexpr (kFloatWeights) {
    const double w[3] = {t.w[0].value, t.w[1].value, t.w[2].value};
    edges_at(t, x, y, e);
    whole_float_barycentrics((float)t.area.value, w, t.affine != 0, e, b);
  } else {
    edges_at(t, x, y, e);
    whole_barycentrics(t.area, t.w, t.affine != 0, e, b);
  }
  for (int k = 0; k < 3; ++k) weight[k] = (float)b[k];
}

// By the rule, where near weights do not decide: the triangle is set up once more. Rarely called, so that its registers
// cost the others nothing.
__device__ __noinline__ void weigh_anew(const Shading& job, int64_t view, int32_t triangle, int x, int y,
                                        float weight[3]) {
  WholeTriangle t;
  int32_t vertex[3];
  bool back;
  set_up_whole(job, view, triangle, nullptr, &t, vertex, &back);
  weigh(job, view, triangle, t, x, y, weight);
}

__device__ __forceinline__ void weigh(const Shading& job, int64_t view, int32_t triangle, const NearTriangle& t, int x,
                                      int y, float weight[3]) {
  int64_t e[3];
  edge_values(t.x, t.y, pixel_centre(x), pixel_centre(y), e);
  if (near_weights(e, t.inverse_w, weight)) return;
  float exact[3];  // a call puts it into memory, and `weight` stays in registers
  weigh_anew(job, view, triangle, x, y, exact);
  for (int k = 0; k < 3; ++k) weight[k] = exact[k];
}

// By the rule, of a record that covers the pixel.
__device__ __forceinline__ void weigh_part(const Shading& job, const ClippedTriangle& t,
                                           const ClippedTriangle::Part& part, int x, int y, float weight[3]) {
  WeightNumber e[3], b[3];
  if constexpr (kUnsnappedWeights) {
    weigh_unsnapped(job, t, x, y, b);
  } else if constexpr (kFloatWeights) {
    const double w[3] = {part.w[0].value, part.w[1].value, part.w[2].value};
    edges_at(part.primitive, x, y, e);
    clipped_float_barycentrics((float)part.area.value, w, part.weights, e, b);
  } else {
    edges_at(part.primitive, x, y, e);
    clipped_barycentrics(part.area, part.w, part.weights, e, b);
  }
  for (int k = 0; k < 3; ++k) weight[k] = (float)b[k];
}
__device__ __noinline__ void weigh_part_anew(const Shading& job, const ClippedTriangle& t,
                                             const ClippedTriangle::Part& part, int x, int y, float weight[3]) {
  weigh_part(job, t, part, x, y, weight);
}

// Whether a record covers the pixel; its edge values there.
__device__ __forceinline__ bool covers_with(const ClippedTriangle::Part& part, int x, int y, int64_t e[3]) {
  const Primitive& p = part.primitive;
  edge_values(p.x, p.y, pixel_centre(x), pixel_centre(y), e);
  if constexpr (kFloatCoverage || Rung::kWraps) return covers(p, x, y);
  return (e[0] >= part.least[0]) & (e[1] >= part.least[1]) & (e[2] >= part.least[2]);
}

// By the first record that covers the pixel; 0 where none does.
__device__ __forceinline__ void weigh(const Shading& job, const ClippedTriangle& t, int x, int y, float weight[3]) {
  for (int k = 0; k < 3; ++k) weight[k] = 0.0f;
  for (int s = 0; s < t.count; ++s) {
    const ClippedTriangle::Part& part = t.part[s];
    if constexpr (kNearWeights) {
      int64_t e[3];
      if (!covers_with(part, x, y, e)) continue;
      if (near_weights(e, part.inverse_w, part.weights, weight)) return;
      float exact[3];
      weigh_part_anew(job, t, part, x, y, exact);
      for (int k = 0; k < 3; ++k) weight[k] = exact[k];
    } else {
      if (!covers(part.primitive, x, y)) continue;
      weigh_part(job, t, part, x, y, weight);
    }
    return;
  }
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

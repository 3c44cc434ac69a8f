// The kernels that read a visibility buffer or values per pixel: a row of the attribute pass (called by
// attributes.cpp), Lambert shading and sRGB encoding (called by shading.cpp). Compiled once per instruction set.
#pragma once

#include "kernels.h"
#include "simd.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// Sets up triangle `triangle` for barycentrics. False if one of its indices names no vertex.
bool load_parent(const AttributeJob& job, const float* positions, int64_t triangle, Parent* parent) {
  float v[3][4];
  Vertex projected[3];
  for (int k = 0; k < 3; ++k) {
    const int64_t index = job.triangles[3 * triangle + k];
    if (index < 0 || index >= job.vertices) return false;
    for (int i = 0; i < 4; ++i) v[k][i] = positions[4 * index + i];
    projected[k] = project_vertex(v[k], job.width, job.height);
  }
  expand_parent(v, projected, {job.width, job.height, 0, 0, job.width, job.height, kCullNone}, parent);
  return true;
}

// Whether each pixel is tested by itself: where edge values do not fit float64, or do not decide coverage.
constexpr bool kTestsRows = kFloatCoverage || Rung::kWideEdges || Rung::kWraps;
// Which row of the image a record is in, where that is needed again.
template <bool kKnown>
struct PlacedRow {};
template <>
struct PlacedRow<true> {
  int32_t y = 0;  // px
};
BIGTRI_INLINE void set_row(PlacedRow<true>* row, int64_t y) { row->y = (int32_t)y; }
BIGTRI_INLINE void set_row(PlacedRow<false>*, int64_t) {}

// A record in one row of the image. e_k at pixel x is start[k] + step[k] * x: integers below 2^53, so float64 is exact.
// Edge k has the pixel inside if e_k >= least[k], which is 0 if the edge owns the samples on it, else 1.
struct RowRecord : PlacedRow<kTestsRows || kUnsnappedWeights> {
  int record = -1;
  double start[3] = {}, step[3] = {}, least[3] = {};
  const float* source[3] = {};  // attributes of the corner that barycentric k belongs to; null without attributes
};

template <int kRecords>
BIGTRI_INLINE void begin_edges(const ParentOf<kRecords>& parent, int record, int64_t y, RowRecord* row) {
  const Primitive& p = parent.primitive[record];
  row->record = record;
  set_row(row, y);
  for (int k = 0; k < 3; ++k) {
    const Edge edge = edge_of(p.x, p.y, k);
    row->start[k] = edge_at(p, k, 0, (int32_t)y);
    row->step[k] = -(double)kSubpixel * edge.dy;
    row->least[k] = -(double)edge_bias(edge);
  }
}

void begin_record(const AttributeJob& job, const float* attributes, const Parent& parent, int record, int64_t triangle,
                  int64_t y, RowRecord* row) {
  begin_edges(parent, record, y, row);
  for (int k = 0; k < 3; ++k)
    row->source[k] =
        attributes ? attributes + job.channels * job.triangles[3 * triangle + corner_of(parent, record, k)] : nullptr;
}

// The edge values of n pixels of a row from x on, and whether the record covers them, one by one. The others repeat the
// last one.
template <int kRecords>
BIGTRI_INLINE void test_eight(const ParentOf<kRecords>& parent, const PlacedRow<true>& row, int record, int64_t x,
                              int n, f64x8 e[3], bool covered[8]) {
  const Primitive& p = parent.primitive[record];
  double value[3][8];
  for (int i = 0; i < 8; ++i) {
    const int32_t at = (int32_t)x + min_of(i, n - 1);
    covered[i] = covers(p, at, row.y);
    for (int k = 0; k < 3; ++k) value[k][i] = edge_at(p, k, at, row.y);
  }
  for (int k = 0; k < 3; ++k) e[k] = load<f64x8>(value[k]);
}
template <int kRecords>
BIGTRI_INLINE void test_eight(const ParentOf<kRecords>&, const PlacedRow<false>&, int, int64_t, int, f64x8[3],
                              bool[8]) {}

// unsnapped_barycentrics of eight pixels of a row from x on.
template <int kRecords>
BIGTRI_INLINE void weigh_unsnapped(int width, int height, const ParentOf<kRecords>& parent, const PlacedRow<true>& row,
                                   int record, int64_t x, f64x8 b[3]) {
  if constexpr (kUnsnappedWeights)
    unsnapped_barycentrics(parent, record, device_coordinate(load<f64x8>(kLaneDouble) + (double)x, (double)width),
                           device_coordinate((double)(height - 1 - row.y), (double)height), b);
}
template <int kRecords>
BIGTRI_INLINE void weigh_unsnapped(int, int, const ParentOf<kRecords>&, const PlacedRow<false>&, int, int64_t,
                                   f64x8[3]) {}

// float_barycentrics, in vectors of float64: b holds float32 values.
template <int kRecords>
BIGTRI_INLINE void barycentrics_in_float(const ParentOf<kRecords>& parent, int record, const f64x8 e[3], f64x8 b[3]) {
  const f32x8 rounded[3] = {to_float(e[0]), to_float(e[1]), to_float(e[2])};
  f32x8 weight[3];
  float_barycentrics(parent, record, rounded, weight);
  for (int k = 0; k < 3; ++k) b[k] = to_double(weight[k]);
}

// The weights of the pixels x to x + 7, all of one record, and which of the first n of them it covers. width, height: of
// the image.
template <int kRecords>
BIGTRI_INLINE void weigh_eight(int width, int height, const ParentOf<kRecords>& parent, const RowRecord& row, int64_t x,
                               int n, f32x8 weight[3], bool covered[8]) {
  f64x8 e[3], b[3];
  for (int i = 0; i < 8; ++i) covered[i] = true;
  if constexpr (kTestsRows)
    test_eight(parent, row, row.record, x, n, e, covered);
  else
    for (int k = 0; k < 3; ++k) {
      e[k] = row.start[k] + (load<f64x8>(kLaneDouble) + (double)x) * row.step[k];
      for (int i = 0; i < 8; ++i) covered[i] &= e[k][i] >= row.least[k];
    }
  if constexpr (kUnsnappedWeights)
    weigh_unsnapped(width, height, parent, row, row.record, x, b);
  else if constexpr (kFloatWeights)
    barycentrics_in_float(parent, row.record, e, b);
  else
    barycentrics(parent, row.record, e, b);
  for (int k = 0; k < 3; ++k) weight[k] = to_float(b[k]);
}

// Computes the pixels x to x + 7, all of one record, and writes the first n. A pixel that the record does not cover
// gets zeros: the visibility buffer came from another drawing.
void interpolate_eight(const AttributeJob& job, const Parent& parent, const RowRecord& row, int64_t x, int n,
                       float* out) {
  f32x8 weight[3];
  bool covered[8];
  weigh_eight(job.width, job.height, parent, row, x, n, weight, covered);
  for (int64_t c = 0; c < job.channels; ++c) {
    f32x8 v = weight[0];
    if (job.attributes)
      v = interpolate(weight, row.source[0][c], row.source[1][c], row.source[2][c]);
    else
      for (int k = 0; k < 3; ++k) v = corner_of(parent, row.record, k) == c ? weight[k] : v;
    for (int i = 0; i < n; ++i) out[i * job.channels + c] = covered[i] ? v[i] : 0.0f;
  }
}

// Pixels [x, end) of a row, all of one triangle. A clipped triangle has several records along the row.
void interpolate_run(const AttributeJob& job, const float* attributes, const Parent& parent, int64_t triangle,
                     int64_t y, int64_t x, int64_t end, float* out) {
  RowRecord row;
  while (x < end) {
    int record = 0;
    int64_t n = min_of<int64_t>(8, end - x);
    if (parent.count != 1) {
      record = covering_record(parent, x, y);
      int64_t same = 1;
      while (same < n && covering_record(parent, x + same, y) == record) ++same;
      n = same;
    }
    if (record < 0 || parent.count == 0) {
      __builtin_memset(out, 0, (size_t)(n * job.channels) * sizeof(float));
    } else {
      if (record != row.record) begin_record(job, attributes, parent, record, triangle, y, &row);
      interpolate_eight(job, parent, row, x, (int)n, out);
    }
    x += n;
    out += n * job.channels;
  }
}

// One row of the attribute pass. Neighbouring pixels of one triangle form a run. `parent` is the caller's memory; it
// holds the triangle of the last run, which is not set up again if the next run has it too.
void stage_interpolate_row(const AttributeJob& job, int64_t view, int64_t y, Parent* parent) {
  const int64_t first = (view * job.height + y) * job.width;
  const int64_t* row = job.packed + first;
  const float* positions = job.positions + view * job.position_view;
  const float* attributes = job.attributes ? job.attributes + view * job.attribute_view : nullptr;
  float* out = job.out + first * job.channels;
  int64_t loaded = -1;
  for (int64_t x = 0; x < job.width;) {
    const int64_t triangle = row[x] == kBackground ? -1 : row[x] & 0xffffffff;
    int64_t end = x + 1;
    while (end < job.width && (row[end] == kBackground ? -1 : row[end] & 0xffffffff) == triangle) ++end;
    bool valid = triangle >= 0 && triangle < job.triangle_count;
    if (valid && triangle != loaded) {
      valid = load_parent(job, positions, triangle, parent);
      loaded = valid ? triangle : -1;
    }
    if (valid)
      interpolate_run(job, attributes, *parent, triangle, y, x, end, out);
    else
      __builtin_memset(out, 0, (size_t)((end - x) * job.channels) * sizeof(float));
    out += (end - x) * job.channels;
    x = end;
  }
}

void stage_lambert(const float* normals, const float* albedo, const float* ambient, const float* directions,
                   const float* colors, int64_t lights, int64_t count, float* out) {
  for (int64_t i = 0; i < count; ++i)
    lambert(normals + 3 * i, albedo + 3 * i, ambient, LightArrays{directions, colors}, lights, out + 3 * i);
}

void stage_encode_srgb(const float* linear, const SrgbSteps& table, int64_t count, uint8_t* out) {
  for (int64_t i = 0; i < count; ++i) out[i] = encode_srgb(linear[i], table);
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// torch.ops.bigtri.<stage>: each stage by itself, on the layout of docs/architecture.md. For tests and for people who validate a variant: plain loops around the same
// inner code that rasterize runs.

#include <array>

#include "checks.h"

namespace bigtri {
namespace {

Tensor tensor_of(const std::vector<int32_t>& values, const std::vector<int64_t>& shape) {
  Tensor t = empty(shape, ScalarType::Int);
  std::copy(values.begin(), values.end(), data<int32_t>(t));
  return t;
}

void check_vertices(const char* op, const Tensor& xy) {
  check(op, "xy", xy, ScalarType::Int, {-1, 3, 2}, "int32 [N, 3, 2]");
  const int32_t* v = const_data<int32_t>(xy);
  for (int64_t i = 0, n = xy.numel(); i < n; ++i)
    BIGTRI_CHECK(v[i] >= -kGuard && v[i] < kGuard, "bigtri::", op, ": xy must lie in [", -kGuard, ", ", kGuard, ") subpx, got ", v[i]);
}

void check_records(const char* op, const Tensor& xy, const Tensor& bbox) {
  check_vertices(op, xy);
  check(op, "bbox", bbox, ScalarType::Int, {xy.size(0), 4}, "int32 [N, 4]");
  const int32_t* b = const_data<int32_t>(bbox);
  for (int64_t i = 0, n = bbox.numel(); i < n; ++i)
    BIGTRI_CHECK(b[i] >= 0 && b[i] <= kMaxSize, "bigtri::", op, ": bbox must lie in 0 to ", kMaxSize, " px, got ", b[i]);
}

void check_record(const char* op, const char* name, int64_t record, int64_t count) {
  BIGTRI_CHECK(record >= 0 && record < count, "bigtri::", op, ": ", name, " must name records 0 to ", count - 1, ", got ", record);
}

void check_queue(const char* op, const Tensor& queue, int64_t records) {
  check(op, "queue", queue, ScalarType::Int, {-1, 3}, "int32 [Q, 3]");
  const int32_t* q = const_data<int32_t>(queue);
  for (int64_t i = 0; i < queue.size(0); ++i) {
    check_record(op, "queue", q[3 * i], records);
    for (int k = 1; k < 3; ++k)
      BIGTRI_CHECK(q[3 * i + k] >= 0 && q[3 * i + k] < kMaxSize / kBin, "bigtri::", op, ": queue must name bins 0 to ", kMaxSize / kBin - 1, ", got ",
                   q[3 * i + k]);
  }
}

int64_t check_spans(const char* op, const Tensor& spans, int64_t records) {
  check(op, "spans", spans, ScalarType::Int, {-1, 4}, "int32 [S, 4]");
  const int32_t* s = const_data<int32_t>(spans);
  int64_t pixels = 0;
  for (int64_t i = 0; i < spans.size(0); ++i, s += 4) {
    check_record(op, "spans", s[0], records);
    BIGTRI_CHECK(s[1] >= 0 && s[1] < kMaxSize && 0 <= s[2] && s[2] <= s[3] && s[3] <= kMaxSize, "bigtri::", op,
                 ": spans must be (record, y, lower, upper) inside the image, got (", s[0], ", ", s[1], ", ", s[2], ", ", s[3], ")");
    pixels += s[3] - s[2];
  }
  return pixels;
}

std::tuple<Tensor, Tensor, Tensor, Tensor, Tensor, Tensor, Tensor, Tensor, Tensor, Tensor> setup_op(const Tensor& positions, const Tensor& triangles,
                                                                                                    int64_t height, int64_t width, std::string cull,
                                                                                                    std::vector<int64_t> scissor) {
  const char* op = "setup";
  const Viewport view = viewport(op, height, width, cull, scissor);
  check(op, "positions", positions, ScalarType::Float, {-1, 4}, "float32 [V, 4]");
  check(op, "triangles", triangles, ScalarType::Int, {-1, 3}, "int32 [T, 3]");
  const Mesh mesh = checked_mesh(op, torch_threads(), const_data<float>(positions), positions.size(0), triangles);
  FloatMode mode;
  std::vector<int32_t> triangle, xy, bbox, corner;
  std::vector<float> z;
  std::vector<int64_t> area;
  std::vector<double> w, weights;
  std::vector<char> clipped;
  int64_t lost = 0;
  Parent parent;
  for (int64_t t = 0; t < mesh.count; ++t) {
    float v[3][4];
    Vertex projected[3];
    for (int k = 0; k < 3; ++k) {
      for (int i = 0; i < 4; ++i) v[k][i] = mesh.positions[4 * (int64_t)mesh.triangles[3 * t + k] + i];
      projected[k] = project_vertex(v[k], view.width, view.height);
    }
    lost += expand_parent(v, projected, view, &parent) == Fate::kDropped;
    for (int s = 0; s < parent.count; ++s) {
      const Primitive& p = parent.primitive[s];
      triangle.push_back((int32_t)t);
      area.push_back(p.area);
      clipped.push_back(parent.clipped);
      for (const int32_t b : {p.x0, p.y0, p.x1, p.y1}) bbox.push_back(b);
      for (int k = 0; k < 3; ++k) {
        xy.push_back(p.x[k]);
        xy.push_back(p.y[k]);
        z.push_back(p.z[k]);
        w.push_back(parent.w[s][k]);
        corner.push_back(corner_of(parent, s, k));
        for (int m = 0; m < 3; ++m) weights.push_back(parent.weights[s][k][m]);
      }
    }
  }
  const int64_t n = (int64_t)triangle.size();
  const auto copy = [](const auto& from, const std::vector<int64_t>& shape, ScalarType type) {
    Tensor t = empty(shape, type);
    std::copy(from.begin(), from.end(), data<typename std::decay_t<decltype(from)>::value_type>(t));
    return t;
  };
  Tensor dropped = empty({}, ScalarType::Long);
  *data<int64_t>(dropped) = lost;
  return {copy(triangle, {n}, ScalarType::Int),  copy(xy, {n, 3, 2}, ScalarType::Int),
          copy(z, {n, 3}, ScalarType::Float),    copy(area, {n}, ScalarType::Long),
          copy(bbox, {n, 4}, ScalarType::Int),   copy(w, {n, 3}, ScalarType::Double),
          copy(corner, {n, 3}, ScalarType::Int), copy(weights, {n, 3, 3}, ScalarType::Double),
          copy(clipped, {n}, ScalarType::Bool),  dropped};
}

std::tuple<Tensor, Tensor, Tensor> binning_op(const Tensor& xy, const Tensor& bbox, int64_t threshold) {
  check_records("binning", xy, bbox);
  const int32_t *v = const_data<int32_t>(xy), *b = const_data<int32_t>(bbox);
  std::vector<int32_t> candidates, small;
  std::vector<char> kept;
  for (int64_t i = 0; i < xy.size(0); ++i, v += 6, b += 4) {
    if (b[0] >= b[2] || b[1] >= b[3]) continue;
    if (!is_large(b[0], b[1], b[2], b[3], threshold)) {
      small.push_back((int32_t)i);
      continue;
    }
    const int32_t x[3] = {v[0], v[2], v[4]}, y[3] = {v[1], v[3], v[5]};
    for (int r = b[1] / kBin; r <= (b[3] - 1) / kBin; ++r)
      for (int c = b[0] / kBin; c <= (b[2] - 1) / kBin; ++c) {
        bool keep = true;
        for (int k = 0; k < 3; ++k) keep = keep && bin_edge(edge_of(x, y, k), c, r).highest >= 0;
        for (const int32_t e : {(int32_t)i, c, r}) candidates.push_back(e);
        kept.push_back(keep);
      }
  }
  Tensor keep = empty({(int64_t)kept.size()}, ScalarType::Bool);
  std::copy(kept.begin(), kept.end(), data<char>(keep));
  return {tensor_of(candidates, {(int64_t)kept.size(), 3}), keep, tensor_of(small, {(int64_t)small.size()})};
}

std::tuple<Tensor, Tensor> tile_mask_op(const Tensor& xy, const Tensor& bbox, const Tensor& queue) {
  check_records("tile_mask", xy, bbox);
  check_queue("tile_mask", queue, xy.size(0));
  Tensor touched = empty({queue.size(0)}, ScalarType::Long), full = empty({queue.size(0)}, ScalarType::Long);
  current_kernels().tile_mask(const_data<int32_t>(xy), const_data<int32_t>(bbox), const_data<int32_t>(queue), queue.size(0), data<int64_t>(touched),
                              data<int64_t>(full));
  return {touched, full};
}

Tensor scanline_op(const Tensor& xy, const Tensor& bbox, const Tensor& queue, const Tensor& touched, const Tensor& small) {
  const char* op = "scanline";
  check_records(op, xy, bbox);
  check_queue(op, queue, xy.size(0));
  check(op, "touched", touched, ScalarType::Long, {queue.size(0)}, "int64 [Q]");
  check(op, "small", small, ScalarType::Int, {-1}, "int32 [M]");
  const int32_t *v = const_data<int32_t>(xy), *b = const_data<int32_t>(bbox);
  std::vector<int32_t> spans, some(4 * kMaxSize);  // the most that one call writes: 512 spans of a bin, or one per row of the image
  for (int64_t i = 0; i < queue.size(0); ++i) {
    const int32_t* entry = const_data<int32_t>(queue) + 3 * i;
    const int64_t n =
        current_kernels().scan_tiles(v + 6 * (int64_t)entry[0], b + 4 * (int64_t)entry[0], entry, (uint64_t)const_data<int64_t>(touched)[i], some.data());
    spans.insert(spans.end(), some.begin(), some.begin() + 4 * n);
  }
  for (int64_t i = 0; i < small.size(0); ++i) {
    const int32_t record = const_data<int32_t>(small)[i];
    check_record(op, "small", record, xy.size(0));
    const int64_t n = current_kernels().scan_rows(v + 6 * (int64_t)record, b + 4 * (int64_t)record, record, some.data());
    spans.insert(spans.end(), some.begin(), some.begin() + 4 * n);
  }
  return tensor_of(spans, {(int64_t)spans.size() / 4, 4});
}

Tensor depth_op(const Tensor& xy, const Tensor& z, const Tensor& area, const Tensor& spans) {
  const char* op = "depth";
  check_vertices(op, xy);
  check(op, "z", z, ScalarType::Float, {xy.size(0), 3}, "float32 [N, 3]");
  check(op, "area", area, ScalarType::Long, {xy.size(0)}, "int64 [N]");
  for (int64_t i = 0; i < xy.size(0); ++i) {
    const int32_t* v = const_data<int32_t>(xy) + 6 * i;
    const int32_t x[3] = {v[0], v[2], v[4]}, y[3] = {v[1], v[3], v[5]};
    const int64_t given = const_data<int64_t>(area)[i];
    BIGTRI_CHECK(given > 0 && given == twice_area(x, y), "bigtri::depth: area must be twice the area of xy, ", twice_area(x, y), " subpx^2 and positive, got ",
                 given);
  }
  Tensor out = empty({check_spans(op, spans, xy.size(0))}, ScalarType::Float);
  FloatMode mode;
  current_kernels().depth_spans(const_data<int32_t>(xy), const_data<float>(z), const_data<int64_t>(area), const_data<int32_t>(spans), spans.size(0),
                                data<float>(out));
  return out;
}

Tensor visibility_op(const Tensor& triangle, const Tensor& spans, const Tensor& depth, int64_t height, int64_t width) {
  const char* op = "visibility";
  check_size(op, height, width);
  check(op, "triangle", triangle, ScalarType::Int, {-1}, "int32 [N]");
  check(op, "depth", depth, ScalarType::Float, {check_spans(op, spans, triangle.size(0))}, "float32 [F], one per pixel of the spans");
  const int32_t* s = const_data<int32_t>(spans);
  for (int64_t i = 0; i < spans.size(0); ++i)
    BIGTRI_CHECK(s[4 * i + 1] < height && s[4 * i + 3] <= width, "bigtri::visibility: spans must lie in the image of ", height, " x ", width, ", got row ",
                 s[4 * i + 1], ", upper ", s[4 * i + 3]);
  Tensor packed = empty({height, width}, ScalarType::Long);
  int64_t* out = data<int64_t>(packed);
  std::fill(out, out + height * width, kBackground);
  const float* z = const_data<float>(depth);
  for (int64_t i = 0; i < spans.size(0); ++i, s += 4)
    for (int64_t x = s[2]; x < s[3]; ++x, ++z) {
      int64_t& pixel = out[s[1] * width + x];
      pixel = min_of(pixel, pack_fragment(*z, (uint32_t)const_data<int32_t>(triangle)[s[0]]));
    }
  return packed;
}

}  // namespace
}  // namespace bigtri

STABLE_TORCH_LIBRARY_IMPL(bigtri, CPU, m) {
  m.impl("setup", TORCH_BOX(&bigtri::setup_op));
  m.impl("binning", TORCH_BOX(&bigtri::binning_op));
  m.impl("tile_mask", TORCH_BOX(&bigtri::tile_mask_op));
  m.impl("scanline", TORCH_BOX(&bigtri::scanline_op));
  m.impl("depth", TORCH_BOX(&bigtri::depth_op));
  m.impl("visibility", TORCH_BOX(&bigtri::visibility_op));
}

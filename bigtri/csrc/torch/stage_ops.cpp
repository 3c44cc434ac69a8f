// torch.ops.bigtri.<stage>: the stages one by one, for bigtri.stages and bigtri.verify. docs/architecture.md has their
// inputs and outputs.

#include <algorithm>

#include "../core/visibility.h"
#include "frames.h"
#include "registry.h"

namespace bigtri {
namespace {

// The rung of that name, whose stages can be called one by one.
const CpuRung& rung_of(const char* op, const std::string& precision) {
  const CpuRung& rung = find_rung(op, kCpuRungs, precision);
  BIGTRI_CHECK(rung.stages, "bigtri::", op,
               ": precision must be one whose records and spans hold all that coverage needs, got '", precision,
               "', whose stages run on the reference alone");
  return rung;
}

void check_vertices(const char* op, const CpuRung& rung, const Tensor& xy) {
  check(op, "xy", xy, ScalarType::Int, {-1, 3, 2}, "int32 [N, 3, 2]");
  const int32_t* v = const_data<int32_t>(xy);
  for (int64_t i = 0, n = xy.numel(); i < n; ++i)
    BIGTRI_CHECK(v[i] >= -rung.guard && v[i] < rung.guard, "bigtri::", op, ": xy must lie in [", -rung.guard, ", ",
                 rung.guard, ") subpx, got ", v[i]);
}

void check_records(const char* op, const CpuRung& rung, const Tensor& xy, const Tensor& bbox) {
  check_vertices(op, rung, xy);
  check(op, "bbox", bbox, ScalarType::Int, {xy.size(0), 4}, "int32 [N, 4]");
  const int32_t* b = const_data<int32_t>(bbox);
  for (int64_t i = 0, n = bbox.numel(); i < n; ++i)
    BIGTRI_CHECK(b[i] >= 0 && b[i] <= kMaxSize, "bigtri::", op, ": bbox must lie in 0 to ", kMaxSize, " px, got ",
                 b[i]);
}

void check_record(const char* op, const char* name, int64_t record, int64_t count) {
  BIGTRI_CHECK(record >= 0 && record < count, "bigtri::", op, ": ", name, " must name records 0 to ", count - 1,
               ", got ", record);
}

void check_queue(const char* op, const Tensor& queue, int64_t records) {
  check(op, "queue", queue, ScalarType::Int, {-1, 3}, "int32 [Q, 3]");
  const int32_t* q = const_data<int32_t>(queue);
  for (int64_t i = 0; i < queue.size(0); ++i) {
    check_record(op, "queue", q[3 * i], records);
    for (int k = 1; k < 3; ++k)
      BIGTRI_CHECK(q[3 * i + k] >= 0 && q[3 * i + k] < kMaxSize / kBin, "bigtri::", op, ": queue must name bins 0 to ",
                   kMaxSize / kBin - 1, ", got ", q[3 * i + k]);
  }
}

int64_t check_spans(const char* op, const Tensor& spans, int64_t records) {
  check(op, "spans", spans, ScalarType::Int, {-1, 4}, "int32 [S, 4]");
  const int32_t* s = const_data<int32_t>(spans);
  int64_t pixels = 0;
  for (int64_t i = 0; i < spans.size(0); ++i, s += 4) {
    check_record(op, "spans", s[0], records);
    BIGTRI_CHECK(s[1] >= 0 && s[1] < kMaxSize && 0 <= s[2] && s[2] <= s[3] && s[3] <= kMaxSize, "bigtri::", op,
                 ": spans must be (record, y, lower, upper) inside the image, got (", s[0], ", ", s[1], ", ", s[2],
                 ", ", s[3], ")");
    pixels += s[3] - s[2];
  }
  return pixels;
}

template <class T>
Tensor copied(const std::vector<T>& from, const std::vector<int64_t>& shape, ScalarType type) {
  Tensor t = empty(shape, type);
  std::copy(from.begin(), from.end(), data<T>(t));
  return t;
}

std::tuple<Tensor, Tensor, Tensor, Tensor, Tensor, Tensor, Tensor, Tensor, Tensor, Tensor> setup_op(
    const Tensor& positions, const Tensor& triangles, int64_t height, int64_t width, std::string cull,
    std::vector<int64_t> scissor, std::string precision) {
  const char* op = "setup";
  const Viewport view = viewport(op, height, width, cull, scissor);
  const CpuRung& rung = rung_of(op, precision);
  check(op, "positions", positions, ScalarType::Float, {-1, 4}, "float32 [V, 4]");
  check(op, "triangles", triangles, ScalarType::Int, {-1, 3}, "int32 [T, 3]");
  SetupOutput o;
  rung.stages->setup(checked_frame(op, torch_threads(), view, 1, positions, triangles), &o);
  const int64_t n = (int64_t)o.triangle.size();
  Tensor dropped = empty({}, ScalarType::Long);
  *data<int64_t>(dropped) = o.dropped;
  return {copied(o.triangle, {n}, ScalarType::Int),  copied(o.xy, {n, 3, 2}, ScalarType::Int),
          copied(o.z, {n, 3}, ScalarType::Float),    copied(o.area, {n}, ScalarType::Long),
          copied(o.bbox, {n, 4}, ScalarType::Int),   copied(o.w, {n, 3}, ScalarType::Double),
          copied(o.corner, {n, 3}, ScalarType::Int), copied(o.weights, {n, 3, 3}, ScalarType::Double),
          copied(o.clipped, {n}, ScalarType::Bool),  dropped};
}

std::tuple<Tensor, Tensor, Tensor> binning_op(const Tensor& xy, const Tensor& bbox, int64_t threshold,
                                              std::string precision) {
  const CpuRung& rung = rung_of("binning", precision);
  check_records("binning", rung, xy, bbox);
  BinningOutput o;
  rung.stages->binning(const_data<int32_t>(xy), const_data<int32_t>(bbox), xy.size(0), threshold, &o);
  const int64_t candidates = (int64_t)o.kept.size();
  return {copied(o.candidates, {candidates, 3}, ScalarType::Int), copied(o.kept, {candidates}, ScalarType::Bool),
          copied(o.small, {(int64_t)o.small.size()}, ScalarType::Int)};
}

std::tuple<Tensor, Tensor> tile_mask_op(const Tensor& xy, const Tensor& bbox, const Tensor& queue,
                                        std::string precision) {
  const CpuRung& rung = rung_of("tile_mask", precision);
  check_records("tile_mask", rung, xy, bbox);
  check_queue("tile_mask", queue, xy.size(0));
  Tensor touched = empty({queue.size(0)}, ScalarType::Long), full = empty({queue.size(0)}, ScalarType::Long);
  rung.stages->kernels().tile_mask(const_data<int32_t>(xy), const_data<int32_t>(bbox), const_data<int32_t>(queue),
                                   queue.size(0), data<int64_t>(touched), data<int64_t>(full));
  return {touched, full};
}

Tensor scanline_op(const Tensor& xy, const Tensor& bbox, const Tensor& queue, const Tensor& touched,
                   const Tensor& small, std::string precision) {
  const char* op = "scanline";
  const CpuRung& rung = rung_of(op, precision);
  check_records(op, rung, xy, bbox);
  check_queue(op, queue, xy.size(0));
  check(op, "touched", touched, ScalarType::Long, {queue.size(0)}, "int64 [Q]");
  check(op, "small", small, ScalarType::Int, {-1}, "int32 [M]");
  const StageKernels& kernels = rung.stages->kernels();
  const int32_t *v = const_data<int32_t>(xy), *b = const_data<int32_t>(bbox);
  // `some` holds the most that one call writes: 512 spans of a bin, or one for each row of the image.
  std::vector<int32_t> spans, some(4 * kMaxSize);
  for (int64_t i = 0; i < queue.size(0); ++i) {
    const int32_t* entry = const_data<int32_t>(queue) + 3 * i;
    const int64_t n = kernels.scan_tiles(v + 6 * (int64_t)entry[0], b + 4 * (int64_t)entry[0], entry,
                                         (uint64_t)const_data<int64_t>(touched)[i], some.data());
    spans.insert(spans.end(), some.begin(), some.begin() + 4 * n);
  }
  for (int64_t i = 0; i < small.size(0); ++i) {
    const int32_t record = const_data<int32_t>(small)[i];
    check_record(op, "small", record, xy.size(0));
    const int64_t n = kernels.scan_rows(v + 6 * (int64_t)record, b + 4 * (int64_t)record, record, some.data());
    spans.insert(spans.end(), some.begin(), some.begin() + 4 * n);
  }
  return copied(spans, {(int64_t)spans.size() / 4, 4}, ScalarType::Int);
}

Tensor depth_op(const Tensor& xy, const Tensor& z, const Tensor& area, const Tensor& spans, std::string precision) {
  const char* op = "depth";
  const CpuRung& rung = rung_of(op, precision);
  check_vertices(op, rung, xy);
  check(op, "z", z, ScalarType::Float, {xy.size(0), 3}, "float32 [N, 3]");
  check(op, "area", area, ScalarType::Long, {xy.size(0)}, "int64 [N]");
  for (int64_t i = 0; i < xy.size(0); ++i) {
    const int32_t* v = const_data<int32_t>(xy) + 6 * i;
    const int64_t given = const_data<int64_t>(area)[i];
    const int64_t right = (int64_t)(v[2] - v[0]) * (v[5] - v[1]) - (int64_t)(v[3] - v[1]) * (v[4] - v[0]);
    BIGTRI_CHECK(given > 0 && given == right, "bigtri::depth: area must be twice the area of xy, ", right,
                 " subpx^2 and positive, got ", given);
  }
  Tensor out = empty({check_spans(op, spans, xy.size(0))}, ScalarType::Float);
  FloatMode mode;
  rung.stages->kernels().depth(const_data<int32_t>(xy), const_data<float>(z), const_data<int64_t>(area),
                               const_data<int32_t>(spans), spans.size(0), data<float>(out));
  return out;
}

void visibility_op(const Tensor& triangle, const Tensor& spans, const Tensor& depth, const Tensor& out) {
  const char* op = "visibility";
  check(op, "out", out, ScalarType::Long, {-1, -1}, "int64 [height, width]");
  const int64_t height = out.size(0), width = out.size(1);
  check_size(op, height, width);
  check(op, "triangle", triangle, ScalarType::Int, {-1}, "int32 [N]");
  check(op, "depth", depth, ScalarType::Float, {check_spans(op, spans, triangle.size(0))},
        "float32 [F], one per pixel of the spans");
  check_apart(op, "out", out, "triangle", triangle);
  check_apart(op, "out", out, "spans", spans);
  check_apart(op, "out", out, "depth", depth);
  const int32_t* s = const_data<int32_t>(spans);
  for (int64_t i = 0; i < spans.size(0); ++i)
    BIGTRI_CHECK(s[4 * i + 1] < height && s[4 * i + 3] <= width, "bigtri::visibility: spans must lie in the image of ",
                 height, " x ", width, ", got row ", s[4 * i + 1], ", upper ", s[4 * i + 3]);
  int64_t* packed = data<int64_t>(out);
  std::fill(packed, packed + height * width, kBackground);
  const float* z = const_data<float>(depth);
  for (int64_t i = 0; i < spans.size(0); ++i, s += 4)
    for (int64_t x = s[2]; x < s[3]; ++x, ++z) {
      int64_t& pixel = packed[s[1] * width + x];
      pixel = min_of(pixel, pack_fragment(*z, (uint32_t)const_data<int32_t>(triangle)[s[0]]));
    }
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

// torch.ops.bigtri.rasterize on the CPU, the instruction-set switch, and the schemas of all operators.

#include "rasterize_checks.h"

namespace bigtri {
namespace {

// Names, separated by commas.
std::string variants_op() {
  std::string names;
  for (const Variant* v = kVariants; v->name; ++v) names += (v == kVariants ? "" : ",") + std::string(v->name);
  return names;
}

void rasterize_op(const Tensor& positions, const Tensor& triangles, int64_t height, int64_t width, std::string cull, std::vector<int64_t> scissor,
                  std::string variant, const Tensor& packed, std::optional<Tensor> depth, const Tensor& dropped) {
  const char* op = "rasterize";
  const Viewport view = viewport(op, height, width, cull, scissor);
  const Variant* chosen = kVariants;
  while (chosen->name && variant != chosen->name) ++chosen;
  BIGTRI_CHECK(chosen->name, "bigtri::rasterize: variant must be one of ", variants_op(), ", got '", variant, "'");
  check_rasterize(kCpu, positions, triangles, height, width, packed, depth, dropped);
  const int64_t batch = positions.size(0), vertices = positions.size(1);
  const Parallel parallel = torch_threads();
  Mesh mesh = checked_mesh(op, parallel, const_data<float>(positions), vertices, triangles);
  const Kernels& kernels = current_kernels();
  for (int64_t b = 0; b < batch; ++b) {
    mesh.positions = const_data<float>(positions) + b * vertices * 4;
    data<int64_t>(dropped)[b] =
        chosen->draw(kernels, parallel, mesh, view, data<int64_t>(packed) + b * height * width, depth ? data<float>(*depth) + b * height * width : nullptr);
  }
}

bool has_isa(std::string name) { return find_kernels(name.c_str()) != nullptr; }

std::string isa() { return current_kernels().name; }

void set_isa(std::string name) {
  const Kernels* kernels = find_kernels(name.c_str());
  BIGTRI_CHECK(kernels, "bigtri::set_isa: name must be an instruction set of this machine ('baseline', 'avx2', 'avx512'), got '", name, "'");
  use_kernels(*kernels);
}

std::tuple<int64_t, int64_t> batch_limits_op() { return {batch_limits().records, batch_limits().candidates}; }

void set_batch_limits_op(int64_t records, int64_t candidates) {
  BIGTRI_CHECK(records >= 1 && candidates >= 1, "bigtri::set_batch_limits: records and candidates must be at least 1, got ", records, " and ", candidates);
  set_batch_limits({records, candidates});
}

}  // namespace
}  // namespace bigtri

STABLE_TORCH_LIBRARY(bigtri, m) {
  m.def(
      "rasterize(Tensor positions, Tensor triangles, int height, int width, str cull, int[] scissor, str variant, Tensor(a!) packed, Tensor(b!)? depth, "
      "Tensor(c!) dropped) -> ()");
  m.def("has_isa(str name) -> bool");
  m.def("isa() -> str");
  m.def("variants() -> str");
  m.def("set_isa(str name) -> ()");
  m.def("batch_limits() -> (int, int)");
  m.def("set_batch_limits(int records, int candidates) -> ()");
  // The stages, as in docs/architecture.md.
  m.def(
      "setup(Tensor positions, Tensor triangles, int height, int width, str cull, int[] scissor) -> (Tensor triangle, Tensor xy, Tensor z, Tensor area, "
      "Tensor bbox, Tensor w, Tensor corner, Tensor weights, Tensor clipped, Tensor dropped)");
  m.def("binning(Tensor xy, Tensor bbox, int threshold) -> (Tensor candidates, Tensor kept, Tensor small)");
  m.def("tile_mask(Tensor xy, Tensor bbox, Tensor queue) -> (Tensor touched, Tensor full)");
  m.def("scanline(Tensor xy, Tensor bbox, Tensor queue, Tensor touched, Tensor small) -> Tensor");
  m.def("depth(Tensor xy, Tensor z, Tensor area, Tensor spans) -> Tensor");
  m.def("visibility(Tensor triangle, Tensor spans, Tensor depth, int height, int width) -> Tensor");
  // What reads a visibility buffer.
  m.def("interpolate(Tensor packed, Tensor positions, Tensor triangles, Tensor attributes) -> Tensor");
  m.def("barycentrics(Tensor packed, Tensor positions, Tensor triangles) -> Tensor");
  m.def("sample_texture(Tensor texture, Tensor uv, str filter, str wrap) -> Tensor");
  m.def("lambert(Tensor normals, Tensor albedo, Tensor ambient, Tensor light_directions, Tensor light_colors) -> Tensor");
  m.def("encode_srgb(Tensor linear, Tensor thresholds) -> Tensor");
}

STABLE_TORCH_LIBRARY_IMPL(bigtri, CPU, m) { m.impl("rasterize", TORCH_BOX(&bigtri::rasterize_op)); }

STABLE_TORCH_LIBRARY_IMPL(bigtri, CompositeExplicitAutograd, m) {
  m.impl("has_isa", TORCH_BOX(&bigtri::has_isa));
  m.impl("isa", TORCH_BOX(&bigtri::isa));
  m.impl("variants", TORCH_BOX(&bigtri::variants_op));
  m.impl("set_isa", TORCH_BOX(&bigtri::set_isa));
  m.impl("batch_limits", TORCH_BOX(&bigtri::batch_limits_op));
  m.impl("set_batch_limits", TORCH_BOX(&bigtri::set_batch_limits_op));
}

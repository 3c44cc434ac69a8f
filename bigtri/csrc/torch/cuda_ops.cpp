// torch.ops.bigtri.rasterize on CUDA, and the list of CUDA variants. Nothing here waits for the device.

#include "../core/counters.h"
#include "cuda.h"
#include "rasterize_checks.h"

namespace bigtri {
namespace {

std::string cuda_rungs_op() { return rung_names(kCudaRungs); }

std::string cuda_variants_op(std::string precision) {
  return registry_text(find_rung("cuda_variants", kCudaRungs, precision).variants);
}

void rasterize_cuda_op(const Tensor& positions, const Tensor& triangles, int64_t height, int64_t width,
                       const std::string& cull, const std::vector<int64_t>& scissor, const std::string& variant,
                       const std::string& precision, int64_t samples, const std::vector<int64_t>& parameters,
                       const std::optional<Tensor>& ranges, const std::optional<Tensor>& behind, const Tensor& packed,
                       const std::optional<Tensor>& depth, const Tensor& dropped,
                       const std::optional<Tensor>& counters) {
  const char* op = "rasterize";
  const CudaRung& rung = find_rung(op, kCudaRungs, precision);
  BIGTRI_CHECK(!counters || (kCountingCudaVariants && &rung == kCudaRungs),
               "bigtri::rasterize: counters must be None on CUDA, unless the extension was built with "
               "BIGTRI_CUDA_COUNTING=1 and precision is '",
               kCudaRungs[0].name, "', got ", describe(*counters), " and precision '", precision, "'");
  const CudaVariant& chosen =
      find_variant(op, counters ? kCountingCudaVariants : rung.variants, variant, precision, " on CUDA");
  const std::vector<int64_t> values = checked_parameters(op, chosen, parameters);
  check_unserved(samples, behind);
  BIGTRI_CHECK(positions.defined() && positions.is_cuda(),
               "bigtri::rasterize: positions must be on a CUDA device like the others, got ", describe(positions));
  const int device = positions.get_device_index();
  Frame frame = {};
  frame.view = viewport(op, height, width, cull, scissor);
  frame.views = checked_views(device, positions, triangles, height, width, ranges, packed, depth, dropped);
  check_count(op, "triangles", triangles.size(0));
  if (counters)
    check_cuda(op, "counters", *counters, device, ScalarType::Long, {kCounters}, "int64 [one for each counter]");
  frame.positions = const_data<float>(positions);
  frame.triangles = const_data<int32_t>(triangles);
  frame.vertices = positions.size(-2);
  frame.view_stride = ranges ? 0 : frame.vertices * 4;
  frame.ranges = ranges ? const_data<int32_t>(*ranges) : nullptr;
  frame.count = (int32_t)triangles.size(0);
  frame.packed = data<int64_t>(packed);
  frame.depth = depth ? data<float>(*depth) : nullptr;
  frame.dropped = data<int64_t>(dropped);
  frame.counters = counters ? data<int64_t>(*counters) : nullptr;
  if (frame.views == 0) return;
  const torch::stable::accelerator::DeviceGuard guard(device);
  const WorkingMemory scratch(chosen.scratch_bytes(frame, values.data()));
  check_launch(op, chosen.draw(frame, values.data(), scratch.data(), current_stream(device)));
}

NewResults rasterize_new_cuda_op(const Tensor& positions, const Tensor& triangles, int64_t height, int64_t width,
                                 const std::string& cull, const std::optional<std::vector<int64_t>>& scissor,
                                 const std::string& precision, bool depth) {
  const std::string standard = find_rung("rasterize", kCudaRungs, precision).variants[0]->name;
  NewResults made = new_results(device_of({&positions}), positions, height, width, depth);
  const auto& [packed, image, dropped] = made;
  rasterize_cuda_op(positions, triangles, height, width, cull, scissor ? *scissor : whole(height, width), standard,
                    precision, 1, {}, std::nullopt, std::nullopt, packed, image, dropped, std::nullopt);
  return made;
}

}  // namespace
}  // namespace bigtri

STABLE_TORCH_LIBRARY_FRAGMENT(bigtri, m) {
  m.def("cuda_rungs() -> str");
  m.def("cuda_variants(str precision) -> str");
}

STABLE_TORCH_LIBRARY_IMPL(bigtri, CUDA, m) {
  m.impl("rasterize", TORCH_BOX(&bigtri::rasterize_cuda_op));
  m.impl("rasterize_new", TORCH_BOX(&bigtri::rasterize_new_cuda_op));
}

STABLE_TORCH_LIBRARY_IMPL(bigtri, CompositeExplicitAutograd, m) {
  m.impl("cuda_rungs", TORCH_BOX(&bigtri::cuda_rungs_op));
  m.impl("cuda_variants", TORCH_BOX(&bigtri::cuda_variants_op));
}

// torch.ops.bigtri.rasterize on CUDA. Nothing here waits for the device.

#include "cuda.h"
#include "rasterize_checks.h"

namespace bigtri {
namespace {

std::string cuda_variants_op() {
  std::string names;
  for (const CudaVariant* v = kCudaVariants; v->name; ++v) names += (v == kCudaVariants ? "" : ",") + std::string(v->name);
  return names;
}

void rasterize_cuda_op(const Tensor& positions, const Tensor& triangles, int64_t height, int64_t width, std::string cull, std::vector<int64_t> scissor,
                       std::string variant, const Tensor& packed, std::optional<Tensor> depth, const Tensor& dropped) {
  const char* op = "rasterize";
  const CudaVariant* chosen = kCudaVariants;
  while (chosen->name && variant != chosen->name) ++chosen;
  BIGTRI_CHECK(chosen->name, "bigtri::rasterize: variant must be one of ", cuda_variants_op(), " on CUDA, got '", variant, "'");
  BIGTRI_CHECK(positions.defined() && positions.is_cuda(), "bigtri::rasterize: positions must be on a CUDA device like the others, got ", describe(positions));
  const int device = positions.get_device_index();
  Frame frame = {};
  frame.view = viewport(op, height, width, cull, scissor);
  check_rasterize(device, positions, triangles, height, width, packed, depth, dropped);
  check_count(op, "triangles", triangles.size(0));
  const int64_t batch = positions.size(0), vertices = positions.size(1);
  frame.triangles = const_data<int32_t>(triangles);
  frame.vertices = vertices;
  frame.count = (int32_t)triangles.size(0);
  const torch::stable::accelerator::DeviceGuard guard(device);
  const cudaStream_t stream = current_stream(device);
  const Tuning settings = tuning();
  // One view after the other on one stream, so one scratch memory serves them all.
  const Tensor scratch = empty({chosen->scratch_bytes(frame, settings)}, ScalarType::Byte, device);
  for (int64_t b = 0; b < batch; ++b) {
    frame.positions = const_data<float>(positions) + b * vertices * 4;
    frame.packed = data<int64_t>(packed) + b * height * width;
    frame.depth = depth ? data<float>(*depth) + b * height * width : nullptr;
    frame.dropped = data<int64_t>(dropped) + b;
    check_launch(op, chosen->draw(frame, settings, scratch.mutable_data_ptr(), stream));
  }
}

std::vector<int64_t> cuda_tuning_op() {
  const Tuning t = tuning();
  return {t.few, t.some, t.warps, t.blocks, t.entries, t.queue, t.threshold, t.cache};
}

void set_cuda_tuning_op(std::vector<int64_t> v) {
  BIGTRI_CHECK(v.size() == kTuningFields, "bigtri::set_cuda_tuning: fields must be ", kTuningFields, " integers, got ", v.size());
  BIGTRI_CHECK(set_tuning({v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7]}),
               "bigtri::set_cuda_tuning: fields must be few and some 0..65536, warps 0, 4, 8 or 16, blocks 0..2^20, entries 1..", kMostEntries,
               ", queue 1..2^24, "
               "threshold 0.., cache 0..2^40, got ",
               v[0], ", ", v[1], ", ", v[2], ", ", v[3], ", ", v[4], ", ", v[5], ", ", v[6], ", ", v[7]);
}

}  // namespace
}  // namespace bigtri

STABLE_TORCH_LIBRARY_FRAGMENT(bigtri, m) {
  m.def("cuda_variants() -> str");
  m.def("cuda_tuning() -> int[]");
  m.def("set_cuda_tuning(int[] fields) -> ()");
}

STABLE_TORCH_LIBRARY_IMPL(bigtri, CUDA, m) { m.impl("rasterize", TORCH_BOX(&bigtri::rasterize_cuda_op)); }

STABLE_TORCH_LIBRARY_IMPL(bigtri, CompositeExplicitAutograd, m) {
  m.impl("cuda_variants", TORCH_BOX(&bigtri::cuda_variants_op));
  m.impl("cuda_tuning", TORCH_BOX(&bigtri::cuda_tuning_op));
  m.impl("set_cuda_tuning", TORCH_BOX(&bigtri::set_cuda_tuning_op));
}

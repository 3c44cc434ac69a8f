// torch.ops.bigtri.rasterize on CUDA, and the list of CUDA variants. Nothing here waits for the device.

#include "cuda.h"
#include "frames.h"
#include "rasterize_checks.h"

namespace bigtri {
namespace {

std::string cuda_rungs_op() { return rung_names(kCudaRungs); }

std::string cuda_variants_op(std::string precision) {
  return registry_text(find_rung("cuda_variants", kCudaRungs, precision).variants);
}

int device_of_positions(const Tensor& positions) {
  BIGTRI_CHECK(positions.defined() && positions.is_cuda(),
               "bigtri::rasterize: positions must be on a CUDA device like the others, got ", describe(positions));
  return positions.get_device_index();
}

// Draws into the current stream of the device, where there is something to draw.
void enqueue(const char* op, const CudaVariant& variant, const Frame& frame, const std::vector<int64_t>& values,
             int device) {
  if (frame.views == 0) return;
  const CurrentDevice current(device);
  const WorkingMemory scratch(variant.scratch_bytes(frame, values.data()));
  check_launch(op, variant.draw(frame, values.data(), scratch.data(), current_stream(device)));
}

void rasterize_cuda_op(const Tensor& positions, const Tensor& triangles, int64_t height, int64_t width,
                       const std::string& cull, const std::vector<int64_t>& scissor, const std::string& variant,
                       const std::string& precision, int64_t samples, const std::vector<int64_t>& parameters,
                       const std::optional<Tensor>& ranges, const std::optional<Tensor>& behind, const Tensor& packed,
                       const std::optional<Tensor>& depth, const Tensor& dropped,
                       const std::optional<Tensor>& counters) {
  const char* op = "rasterize";
  const CudaRung& rung = find_rung(op, kCudaRungs, precision);
  BIGTRI_CHECK(!counters, "bigtri::rasterize: counters must be None on CUDA, where map_work counts, got ",
               describe(*counters));
  const CudaVariant& chosen = find_variant(op, rung.variants, variant, precision, " on CUDA");
  const std::vector<int64_t> values = checked_parameters(op, chosen, parameters);
  check_unserved(samples, behind);
  const int device = device_of_positions(positions);
  const Viewport view = viewport(op, height, width, cull, scissor);
  const int32_t views = checked_views(device, positions, triangles, ranges);
  check_results(device, views, positions, triangles, height, width, ranges, packed, depth, dropped);
  Frame frame = frame_of(op, view, views, positions, triangles, ranges);
  set_results(&frame, &packed, depth, dropped);
  enqueue(op, chosen, frame, values, device);
}

// What is drawn by the standard variant, where a call has no more than the usual arguments.
struct StandardFrame {
  const CudaVariant& variant;
  int device;
  Frame frame;
};

// Checks the inputs; the frame has no results yet.
StandardFrame standard_frame(const Tensor& positions, const Tensor& triangles, int64_t height, int64_t width,
                             const std::string& cull, const std::optional<std::vector<int64_t>>& scissor,
                             const std::string& precision) {
  const char* op = "rasterize";
  const CudaVariant& standard = *find_rung(op, kCudaRungs, precision).variants[0];
  const Viewport view = scissor ? viewport(op, height, width, cull, *scissor) : viewport(op, height, width, cull);
  const int device = device_of_positions(positions);
  const int32_t views = checked_views(device, positions, triangles, std::nullopt);
  return {standard, device, frame_of(op, view, views, positions, triangles)};
}

void draw(StandardFrame* given, const Tensor& packed, const std::optional<Tensor>& depth, const Tensor& dropped) {
  set_results(&given->frame, &packed, depth, dropped);
  enqueue("rasterize", given->variant, given->frame, standard_values(given->variant), given->device);
}

NewResults rasterize_new_cuda_op(const Tensor& positions, const Tensor& triangles, int64_t height, int64_t width,
                                 const std::string& cull, const std::optional<std::vector<int64_t>>& scissor,
                                 const std::string& precision, bool depth) {
  StandardFrame given = standard_frame(positions, triangles, height, width, cull, scissor, precision);
  NewResults made = new_results(given.device, positions, height, width, depth);
  const auto& [packed, image, dropped] = made;
  draw(&given, packed, image, dropped);
  return made;
}

Tensor rasterize_into_cuda_op(const Tensor& positions, const Tensor& triangles, int64_t height, int64_t width,
                              const Tensor& packed, const std::optional<Tensor>& depth, const std::string& cull,
                              const std::optional<std::vector<int64_t>>& scissor, const std::string& precision) {
  StandardFrame given = standard_frame(positions, triangles, height, width, cull, scissor, precision);
  const Tensor dropped = new_dropped(given.device, positions);
  check_results(given.device, given.frame.views, positions, triangles, height, width, std::nullopt, packed, depth,
                dropped);
  draw(&given, packed, depth, dropped);
  return dropped;
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
  m.impl("rasterize_into", TORCH_BOX(&bigtri::rasterize_into_cuda_op));
}

STABLE_TORCH_LIBRARY_IMPL(bigtri, CompositeExplicitAutograd, m) {
  m.impl("cuda_rungs", TORCH_BOX(&bigtri::cuda_rungs_op));
  m.impl("cuda_variants", TORCH_BOX(&bigtri::cuda_variants_op));
}

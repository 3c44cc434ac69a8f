// torch.ops.bigtri.map_work on CUDA, by kernels that count, and the list of their variants. Nothing here waits for the
// device.

#include "../cuda/counted_work.h"
#include "cuda.h"
#include "frames.h"
#include "work_map_checks.h"

namespace bigtri {
namespace {

std::string cuda_counting_op() { return kCountingCudaVariants ? names_of(kCountingCudaVariants) : ""; }

// One view. tasks: fragments of each block of the kernel that offers them; blocks beyond its room are left out. Edge values
// are in `counters` alone, so `edges` is not written.
void map_work_cuda_op(const Tensor& positions, const Tensor& triangles, int64_t height, int64_t width,
                      const std::string& cull, const std::vector<int64_t>& scissor, const std::string& variant,
                      const std::string& precision, const std::vector<int64_t>& parameters, const Tensor& packed,
                      const Tensor& dropped, const Tensor& counters, const Tensor& fragments, const Tensor& edges,
                      const Tensor& tasks) {
  const char* op = "map_work";
  const CudaRung& rung = find_rung(op, kCudaRungs, precision);
  BIGTRI_CHECK(kCountingCudaVariants, "bigtri::", op,
               ": nothing is counted on CUDA, since the extension was not built with BIGTRI_CUDA_COUNTING=1");
  BIGTRI_CHECK(&rung == kCudaRungs, "bigtri::", op, ": precision must be '", kCudaRungs[0].name,
               "' on CUDA, the one whose variants count, got '", precision, "'");
  const CudaVariant& chosen = find_variant(op, kCountingCudaVariants, variant, precision, " on CUDA");
  const std::vector<int64_t> values = checked_parameters(op, chosen, parameters);
  const int device = device_of({&positions});
  const Viewport view = viewport(op, height, width, cull, scissor);
  check_map_work(device, view, 0, positions, triangles, packed, dropped, counters, fragments, edges, tasks);
  Frame frame = frame_of(op, view, 1, positions, triangles);
  set_results(&frame, &packed, std::nullopt, dropped);
  const CurrentDevice current(device);
  const cudaStream_t stream = current_stream(device);
  // A graph would read `work` below when it runs.
  cudaStreamCaptureStatus capturing;
  check_launch(op, cudaStreamIsCapturing(stream, &capturing));
  BIGTRI_CHECK(capturing == cudaStreamCaptureStatusNone, "bigtri::", op, ": a CUDA graph cannot capture it");
  const WorkingMemory scratch(chosen.scratch_bytes(frame, values.data())), counted(sizeof(CountedWork));
  const CountedWork work = {data<int64_t>(counters), data<int64_t>(fragments), data<int64_t>(tasks), tasks.size(0)};
  check_launch(op, cudaMemcpyAsync(counted.data(), &work, sizeof(work), cudaMemcpyHostToDevice, stream));
  frame.counted = static_cast<const CountedWork*>(counted.data());
  check_launch(op, chosen.draw(frame, values.data(), scratch.data(), stream));
}

}  // namespace
}  // namespace bigtri

STABLE_TORCH_LIBRARY_FRAGMENT(bigtri, m) { m.def("cuda_counting() -> str"); }

STABLE_TORCH_LIBRARY_IMPL(bigtri, CompositeExplicitAutograd, m) {
  m.impl("cuda_counting", TORCH_BOX(&bigtri::cuda_counting_op));
}

STABLE_TORCH_LIBRARY_IMPL(bigtri, CUDA, m) { m.impl("map_work", TORCH_BOX(&bigtri::map_work_cuda_op)); }

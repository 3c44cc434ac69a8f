// torch.ops.bigtri.transform on CUDA. It does not wait for the device.

#include "../cuda/transform.h"
#include "cuda.h"
#include "transform_checks.h"

namespace bigtri {
namespace {

void transform_cuda_op(const Tensor& points, const Tensor& matrices, const Tensor& out) {
  const int device = device_of({&points, &matrices, &out});
  check_transform(device, points, matrices, out);
  if (out.numel() == 0) return;
  const torch::stable::accelerator::DeviceGuard guard(device);
  check_launch("transform", transform_cuda(const_data<float>(points), const_data<double>(matrices), points.size(0),
                                           matrices.size(0), data<float>(out), current_stream(device)));
}

}  // namespace
}  // namespace bigtri

STABLE_TORCH_LIBRARY_IMPL(bigtri, CUDA, m) { m.impl("transform", TORCH_BOX(&bigtri::transform_cuda_op)); }

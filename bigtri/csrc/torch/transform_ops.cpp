// torch.ops.bigtri.transform on the CPU: points to clip space.

#include "transform_checks.h"

namespace bigtri {
namespace {

void transform_op(const Tensor& points, const Tensor& matrices, const Tensor& out) {
  check_transform(kCpu, points, matrices, out);
  transform(const_data<float>(points), const_data<double>(matrices), points.size(0), matrices.size(0), data<float>(out),
            torch_threads());
}

}  // namespace
}  // namespace bigtri

STABLE_TORCH_LIBRARY_IMPL(bigtri, CPU, m) { m.impl("transform", TORCH_BOX(&bigtri::transform_op)); }

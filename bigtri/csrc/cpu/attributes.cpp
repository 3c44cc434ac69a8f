// The attribute pass: interpolates attributes at every pixel of a visibility buffer, row by row over threads. The
// binding calls it through CpuRung::interpolate. Compiled once per rung, because it sets up the triangles again; and so
// are the kernels of the shading pass, which the binding gets from here.

#include <algorithm>

#include "kernels.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

void interpolate_views(const AttributeJob& job, const Parallel& parallel);
void interpolate_views(const AttributeJob& job, const Parallel& parallel) {
  const AttributeKernels& kernels = current_kernels().attributes;
  const int64_t rows = job.views * job.height, blocks = std::min<int64_t>(rows, 8 * parallel.threads);
  parallel(blocks, [&](int64_t block) {
    Parent scratch;
    for (int64_t y = rows * block / blocks; y < rows * (block + 1) / blocks; ++y)
      kernels.interpolate_row(job, y / job.height, y % job.height, &scratch);
  });
}

const ShadeKernels& shade_kernels();
const ShadeKernels& shade_kernels() { return current_kernels().shade; }

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

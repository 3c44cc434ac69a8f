// The shading pass over a whole visibility buffer: cuts it into blocks and calls the kernel of shade.inl over threads. The
// binding calls it through CpuRung::shade. Compiled once per rung, because it sets up the triangles again.

#include <memory>
#include <vector>

#include "kernels.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

void shade_views(const ShadeJob& job, const Parallel& parallel) {
  const ShadeKernels& kernels = current_kernels().shade;
  const int side = shade_side(job), columns = (job.width + side - 1) / side, rows = (job.height + side - 1) / side;
  std::unique_ptr<char[]> memory(new char[(size_t)(parallel.threads * kShadeScratchBytes + 64)]);
  char* first = memory.get() + (-(uintptr_t)memory.get() & 63);  // up to the next multiple of 64 bytes
  std::vector<char> begun((size_t)parallel.threads, 0);
  parallel.with_slots(job.views * columns * rows, [&](int64_t i, int64_t slot) {
    void* scratch = first + slot * kShadeScratchBytes;
    if (!begun[(size_t)slot]) kernels.begin(scratch);
    begun[(size_t)slot] = 1;
    const int64_t view = i / (columns * rows);
    const int x = (int)(i % columns) * side, y = (int)(i / columns % rows) * side;
    const int64_t* packed = job.packed + (view * job.height + y) * job.width + x;
    kernels.block(job, {view, packed, job.width, x, y, min_of(side, job.width - x), min_of(side, job.height - y)},
                  scratch);
  });
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

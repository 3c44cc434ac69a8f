// The shading pass over a whole visibility buffer: cuts it into blocks and calls the kernel of shade.inl over threads. The
// binding calls it, and the variant bin_owned for a view that it could not shade as it drew. The same for every rung, whose
// kernels are in the job.

#include <memory>
#include <vector>

#include "backend.h"

namespace bigtri {

ShadeJob views_of(const ShadeJob& job, int64_t first, int64_t count) {
  const int64_t pixels = (int64_t)job.height * job.width;
  ShadeJob some = job;
  some.views = count;
  some.positions = job.positions + first * job.position_view;
  some.image = job.image + first * (pixels / (job.samples * job.samples)) * job.channels;
  for (float** image : {&some.albedo, &some.normals, &some.linear})
    if (*image) *image += first * 3 * pixels;
  return some;
}

void shade_views(const ShadeJob& job, const Parallel& parallel) {
  // The most samples up to kBin that are whole pixels.
  const int side = job.samples > kBin ? job.samples : kBin / job.samples * job.samples;
  const int columns = (job.width + side - 1) / side, rows = (job.height + side - 1) / side;
  std::unique_ptr<char[]> memory(new char[(size_t)(parallel.threads * kShadeScratchBytes + 64)]);
  char* first = memory.get() + (-(uintptr_t)memory.get() & 63);  // up to the next multiple of 64 bytes
  std::vector<char> begun((size_t)parallel.threads, 0);
  parallel.with_slots(job.views * columns * rows, [&](int64_t i, int64_t slot) {
    void* scratch = first + slot * kShadeScratchBytes;
    if (!begun[(size_t)slot]) job.kernels->begin(job, scratch);
    begun[(size_t)slot] = 1;
    const int64_t view = i / (columns * rows);
    const int x = (int)(i % columns) * side, y = (int)(i / columns % rows) * side;
    const int64_t* packed = job.packed + (view * job.height + y) * job.width + x;
    job.kernels->block(job, {view, packed, job.width, x, y, min_of(side, job.width - x), min_of(side, job.height - y)},
                       scratch);
  });
}

}  // namespace bigtri

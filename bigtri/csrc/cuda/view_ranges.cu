// The table of what each view draws, in as many launches as it takes.

#include "view_ranges.h"

namespace bigtri {
namespace {

constexpr int kAtOnce = 256;  // views; a launch has 4 KB of arguments

struct Some {
  ViewRange range[kAtOnce];
};
static_assert(sizeof(Some) + 64 <= 4096, "as much as any device takes");

__global__ void put_ranges(const __grid_constant__ Some some, ViewRange* to, int count) {
  const int i = (int)threadIdx.x;
  if (i < count) to[i] = some.range[i];
}

}  // namespace

cudaError_t launch_ranges(const Frame& f, int each, ViewRange* to, int64_t* blocks, cudaStream_t stream) {
  *blocks = 0;
  for (int32_t first = 0; first < f.views; first += kAtOnce) {
    const int count = min_of(f.views - first, kAtOnce);
    Some some;
    for (int i = 0; i < count; ++i) {
      const Range range = range_of(f, first + i);
      some.range[i] = {(int32_t)range.first, (int32_t)(range.end - range.first), (uint32_t)*blocks};
      *blocks += (range.end - range.first + each - 1) / each;
    }
    BIGTRI_CUDA(launch_first(put_ranges, 1, kAtOnce, 0, stream, some, to + first, count));
  }
  return cudaSuccess;
}

}  // namespace bigtri

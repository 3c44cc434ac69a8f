// Points to clip space, over threads. The binding calls it.

#include <algorithm>

#include "../core/transform.h"
#include "backend.h"

namespace bigtri {

void transform(const float* points, const double* matrices, int64_t count, int64_t views, float* out,
               const Parallel& parallel) {
  constexpr int64_t kBlock = 8192;  // points
  const int64_t blocks = (count + kBlock - 1) / kBlock;
  parallel(views * blocks, [&](int64_t i) {
    const int64_t view = i / blocks, begin = i % blocks * kBlock, end = std::min(count, begin + kBlock);
    for (int64_t k = begin; k < end; ++k)
      transform_point(matrices + 16 * view, points + 3 * k, out + 4 * (view * count + k));
  });
}

}  // namespace bigtri

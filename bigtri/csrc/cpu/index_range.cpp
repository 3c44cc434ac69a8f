// Smallest and largest vertex index, over threads. The binding calls it to check that every index names a vertex;
// bin_owned projects only the vertices in this range.
#include <algorithm>
#include <vector>

#include "backend.h"

namespace bigtri {

void index_range(const Parallel& parallel, const int32_t* indices, int64_t count, int64_t* lowest, int64_t* highest) {
  const int64_t chunks = std::min<int64_t>(parallel.threads, count / 65536 + 1);
  std::vector<int32_t> low(chunks, INT32_MAX), high(chunks, INT32_MIN);
  parallel(chunks, [&](int64_t c) {
    int32_t a = INT32_MAX, b = INT32_MIN;
    for (int64_t i = count * c / chunks, end = count * (c + 1) / chunks; i < end; ++i) {
      a = std::min(a, indices[i]);
      b = std::max(b, indices[i]);
    }
    low[c] = a;
    high[c] = b;
  });
  *lowest = *std::min_element(low.begin(), low.end());
  *highest = *std::max_element(high.begin(), high.end());
}

}  // namespace bigtri

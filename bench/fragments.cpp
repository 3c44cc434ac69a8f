// fragments.h on threads of the CPU. fragments.py builds it with csrc/cpu/thread_pool.cpp.

#include "fragments.h"

#include <algorithm>

#include "cpu/parallel.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

BIGTRI_HD int64_t read_pixel(const int64_t* pixel) { return __atomic_load_n(pixel, __ATOMIC_RELAXED); }

BIGTRI_HD void lower_pixel(int64_t* pixel, int64_t v) {
  int64_t old = __atomic_load_n(pixel, __ATOMIC_RELAXED);
  while (v < old && !__atomic_compare_exchange_n(pixel, &old, v, false, __ATOMIC_RELAXED, __ATOMIC_RELAXED)) {
  }
}

BIGTRI_HD void lower_under_lock(uint32_t* lock, int64_t* pixel, int64_t v) {
  while (__atomic_exchange_n(lock, 1u, __ATOMIC_ACQUIRE)) {
  }
  *pixel = min_of(*pixel, v);
  __atomic_store_n(lock, 0u, __ATOMIC_RELEASE);
}

namespace {

constexpr int64_t kShare = 256;  // triangles of a task, as many as those of the variant `scanline`

template <Way kWay>
void draw_all(const FragmentJob& job, const Parallel& parallel) {
  const int64_t width = job.frame.view.width, count = job.frame.count;
  parallel(job.frame.view.height, [&](int64_t y) { std::fill_n(job.frame.packed + y * width, width, kBackground); });
  parallel((count + kShare - 1) / kShare, [&](int64_t i) {
    for (int64_t t = i * kShare; t < std::min(count, (i + 1) * kShare); ++t) draw_triangle<kWay>(job, t);
  });
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

using namespace bigtri;

// Draws by one way, clear included, on so many threads. Returns 0.
extern "C" int fragments_draw(const FragmentArguments* given, int way, int threads, void*) {
  const auto draw = way == kPacked     ? draw_all<kPacked>
                    : way == kLocked   ? draw_all<kLocked>
                    : way == kColoured ? draw_all<kColoured>
                                       : draw_all<kColouredAll>;
  draw(fragment_job(*given), Parallel{threads});
  return 0;
}

// The image from what was drawn: shaded from triangles, or the colours that were packed.
extern "C" int fragments_finish(const FragmentArguments* given, int way, int threads, void*) {
  const FragmentJob job = fragment_job(*given);
  const bool coloured = has_colours(way);
  Parallel{threads}(given->height, [&](int64_t y) {
    Held held;
    for (int x = 0; x < given->width; ++x) {
      const int64_t i = y * given->width + x;
      given->image[i] = coloured ? packed_colour(given->packed[i]) : shade_pixel(job, x, (int)y, &held);
    }
  });
  return 0;
}

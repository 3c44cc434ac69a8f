// The background, zeros and projected vertices, before the triangles.

#include "clear.h"

#include "setup.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// Background everywhere, zeros, and the vertices projected where there is room for them: by blocks of their own, spread
// evenly among the others, since one is bound by memory and the other by arithmetic.
constexpr int kClearThreads = 256, kVerticesEach = 2;
constexpr int kClearPixels = 16 * kClearThreads, kProjectVertices = kVerticesEach * kClearThreads;  // of a block

__global__ void __launch_bounds__(kClearThreads, 4)
    clear_frame(const __grid_constant__ Frame f, Vertex* projected, int projecting_blocks, Zeros zeros) {
  let_next_begin();
  const int thread = threadIdx.x,
            projecting = (int)((int64_t)blockIdx.x * projecting_blocks / gridDim.x);  // blocks before this one
  if ((int64_t)(blockIdx.x + 1) * projecting_blocks / gridDim.x > projecting) {
    project_vertices<kVerticesEach>(
        f, (int64_t)projecting * kProjectVertices + thread, kClearThreads, [&](const Vertex& p, int64_t i) {
          reinterpret_cast<int4*>(projected)[i] = make_int4(p.x, p.y, __float_as_int(p.z), (int)p.flags);
        });
    return;
  }
  // From the end to the beginning: triangles mostly come from the top of the image, which then is what the cache still
  // holds.
  const int block = (int)gridDim.x - projecting_blocks - 1 - ((int)blockIdx.x - projecting);
  const int64_t n = (int64_t)f.view.width * f.view.height, first = (int64_t)block * kClearPixels,
                end = min_of(first + kClearPixels, n);
  if (((uintptr_t)f.packed & 15) == 0) {
    for (int64_t i = first + 2 * thread; i + 1 < end; i += 2 * kClearThreads)
      *reinterpret_cast<longlong2*>(f.packed + i) = make_longlong2(kBackground, kBackground);
    if (thread == 0 && end == n && n % 2) f.packed[n - 1] = kBackground;
  } else {
    for (int64_t i = first + thread; i < end; i += kClearThreads) f.packed[i] = kBackground;
  }
  zeros.set(block * kClearThreads + thread, ((int)gridDim.x - projecting_blocks) * kClearThreads);
  if (block == 0 && thread == 0) *f.dropped = 0;
}

}  // namespace

Vertex* take_projected(Scratch* scratch, const Frame& f) {
  if (f.vertices > 2 * (int64_t)f.count) return nullptr;
  return scratch->take<Vertex>(f.vertices);
}

cudaError_t launch_clear(const Frame& f, Vertex* projected, const Zeros& zeros, cudaStream_t stream) {
  const int64_t clearing = ((int64_t)f.view.width * f.view.height + kClearPixels - 1) / kClearPixels;
  const int64_t projecting = projected ? (f.vertices + kProjectVertices - 1) / kProjectVertices : 0;
  return launch_first(clear_frame, projecting + clearing, kClearThreads, 0, stream, f, projected, (int)projecting,
                      zeros);
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

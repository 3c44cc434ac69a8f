// The background, zeros and projected vertices, before the triangles.

#include "clear.h"

#include "setup.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// Background everywhere, zeros, and the vertices projected where there is room for them: by blocks of their own, behind
// the others, so that a multiprocessor has both at once. One is bound by memory and the other by arithmetic.
constexpr int kClearThreads = 256, kVerticesEach = 2;
constexpr int kProjectVertices = kVerticesEach * kClearThreads;  // of a block
// So few blocks clear a multiprocessor's share that the next kernel's blocks find room beside them at once.
constexpr int kClearBlocks = 2;
constexpr int64_t kPixelsPerProjected = 64;

__global__ void __launch_bounds__(kClearThreads, 4)
    clear_frame(const __grid_constant__ Frame f, Vertex* projected, unsigned clearing_blocks, Zeros zeros) {
  let_next_begin();
  if (blockIdx.x >= clearing_blocks) {
    const int64_t vertices = f.view_stride ? f.views * f.vertices : f.vertices;
    project_vertices<kVerticesEach>(f, (int64_t)(blockIdx.x - clearing_blocks) * kProjectVertices + threadIdx.x,
                                    kClearThreads, vertices, [&](const Vertex& p, int64_t i) {
                                      reinterpret_cast<int4*>(projected)[i] =
                                          make_int4(p.x, p.y, __float_as_int(p.z), (int)p.flags);
                                    });
    return;
  }
  const int64_t thread = (int64_t)blockIdx.x * kClearThreads + threadIdx.x,
                threads = (int64_t)clearing_blocks * kClearThreads;
  zeros.set(thread, threads);
  for (int64_t v = thread; v < f.views; v += threads) f.dropped[v] = 0;
  // From the end to the beginning: triangles mostly come from the top of the image, which then is what the cache still
  // holds.
  const int64_t n = f.views * ((int64_t)f.view.width * f.view.height);
  if (((uintptr_t)f.packed & 15) == 0) {
    longlong2* const pairs = reinterpret_cast<longlong2*>(f.packed);
#pragma unroll 4
    for (int64_t i = n / 2 - 1 - thread; i >= 0; i -= threads) pairs[i] = make_longlong2(kBackground, kBackground);
    if (thread == 0 && n % 2) f.packed[n - 1] = kBackground;
  } else {
    for (int64_t i = n - 1 - thread; i >= 0; i -= threads) f.packed[i] = kBackground;
  }
}

}  // namespace

Vertex* take_projected(Scratch* scratch, const Frame& f, bool wanted) {
  // A vertex less than triangle corners by half at least, or projecting each one once saves nothing; and many triangles
  // for the image, or set-up is done with projecting its own while the image is cleared.
  const int64_t views = f.view_stride ? f.views : 1, vertices = views * f.vertices, triangles = triangles_of_all(f);
  const int64_t pixels = (int64_t)f.views * f.view.width * f.view.height;
  if (!wanted && (vertices > 2 * triangles || triangles < pixels / kPixelsPerProjected)) return nullptr;
  return scratch->take<Vertex>(vertices);
}

cudaError_t launch_clear(const Frame& f, Vertex* projected, const Zeros& zeros, cudaStream_t stream) {
  int processors;
  BIGTRI_CUDA(multiprocessors(&processors));
  const int64_t pixels = (int64_t)f.views * f.view.width * f.view.height,
                vertices = f.view_stride ? f.views * f.vertices : f.vertices;
  const int64_t clearing = min_of<int64_t>((pixels + 2 * kClearThreads - 1) / (2 * kClearThreads),
                                           (int64_t)kClearBlocks * processors),
                projecting = projected ? (vertices + kProjectVertices - 1) / kProjectVertices : 0;
  return launch_first(clear_frame, projecting + clearing, kClearThreads, 0, stream, f, projected, (unsigned)clearing,
                      zeros);
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

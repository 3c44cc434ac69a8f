// The background, zeros and projected vertices, before the triangles.

#include "clear.h"

#include "areas.h"
#include "setup.cuh"
#include "short_divisor.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// Background everywhere, or in areas that may be touched, by kernels of their own behind this one; zeros; and the vertices
// projected where there is room for them: by blocks of their own, behind the others, so that a multiprocessor has both at
// once. One is bound by memory and the other by arithmetic.
constexpr int kClearThreads = 256, kVerticesEach = 2;
constexpr int kProjectVertices = kVerticesEach * kClearThreads;  // of a block
// So few blocks clear a multiprocessor's share that the next kernel's blocks find room beside them at once.
constexpr int kClearBlocks = 2;
constexpr int64_t kPixelsPerProjected = 64;

// How many of kSampled triangles, evenly spread over the list of the only view, may cover a pixel centre. By all threads.
__device__ __forceinline__ int count_shown(const Frame& f) {
  static_assert(kSampled == kClearThreads, "one for each thread");
  int32_t index[3];
  bool may = load_indices(f, (int32_t)((int64_t)f.count * threadIdx.x / kSampled), index);
  if (may) {
    Vertex v[3];
    for (int k = 0; k < 3; ++k) v[k] = load_and_project(f, index[k]);
    may = may_show(f.view, v);
  }
  return __syncthreads_count(may);
}

// kSamples: whether the first block has only the triangles of a sample that show to count, into *shown.
template <bool kSamples>
__global__ void __launch_bounds__(kClearThreads, 4)
    clear_frame(const __grid_constant__ Frame f, Vertex* projected, unsigned clearing_blocks, Zeros zeros, Zeros marks,
                uint32_t* shown) {
  if (zeros.early && blockIdx.x == 0 && threadIdx.x == 0) *zeros.early = 0;
  let_next_begin();
  if (kSamples && blockIdx.x == 0) {
    const int count = count_shown(f);
    if (threadIdx.x == 0) *shown = (uint32_t)count;
    return;
  }
  const unsigned block = blockIdx.x - (kSamples ? 1 : 0);
  if (block >= clearing_blocks) {
    const int64_t vertices = f.view_stride ? f.views * f.vertices : f.vertices;
    project_vertices<kVerticesEach>(f, (int64_t)(block - clearing_blocks) * kProjectVertices + threadIdx.x,
                                    kClearThreads, vertices,
                                    [&](const Vertex& v, int64_t i) { store_vertex(v, projected + i); });
    return;
  }
  const int64_t thread = (int64_t)block * kClearThreads + threadIdx.x,
                threads = (int64_t)clearing_blocks * kClearThreads;
  zeros.set(thread, threads);
  marks.set(thread, threads);
  for (int64_t v = thread; v < f.views; v += threads) f.dropped[v] = 0;
  if (f.areas) return;
  // From the end to the beginning: triangles mostly come from the top of the image, which then is what the cache still
  // holds. Stored as what the cache gives up first, before pixels that triangles have been drawn onto.
  const int64_t n = pixels_of_all(f);
  if (((uintptr_t)f.packed & 15) == 0) {
    longlong2* const pairs = reinterpret_cast<longlong2*>(f.packed);
#pragma unroll 4
    for (int64_t i = n / 2 - 1 - thread; i >= 0; i -= threads)
      __stcs(pairs + i, make_longlong2(kBackground, kBackground));
    if (thread == 0 && n % 2) f.packed[n - 1] = kBackground;
  } else {
    for (int64_t i = n - 1 - thread; i >= 0; i -= threads) f.packed[i] = kBackground;
  }
}

constexpr int kMarkThreads = 64;

// The areas that a triangle may touch.
struct MarkBox {
  int64_t first_row;  // among the rows of all views
  int left, right;    // columns, the last one within
  int rows;           // 0: none
};
__device__ __forceinline__ MarkBox of_lane(const MarkBox& b, int lane) {
  return {__shfl_sync(kAllLanes, b.first_row, lane), __shfl_sync(kAllLanes, b.left, lane),
          __shfl_sync(kAllLanes, b.right, lane), __shfl_sync(kAllLanes, b.rows, lane)};
}

// The box of triangle `item` of all views.
__device__ __forceinline__ MarkBox mark_box(const Frame& f, const Areas& areas, const Vertex* projected,
                                            const ShortDivisor& triangles, const ShortDivisor& samples, int64_t item) {
  const int64_t view = triangles.quotient_of_any(item), vertex = view * (f.view_stride / 4);
  int32_t index[3];
  if (!load_indices(f, (int32_t)(item - view * f.count), index)) return {};
  Vertex v[3];
  for (int k = 0; k < 3; ++k) v[k] = projected ? projected[vertex + index[k]] : load_and_project(f, vertex + index[k]);
  const Fate fate = fate_of(v[0].flags, v[1].flags, v[2].flags);
  if (fate != Fate::kWhole && fate != Fate::kClip) return {};
  PixelBox box = {0, 0, f.view.width, f.view.height};
  if (fate == Fate::kWhole) {
    const int32_t x[3] = {v[0].x, v[1].x, v[2].x}, y[3] = {v[0].y, v[1].y, v[2].y};
    box = pixel_box(x, y, f.view);
  }
  if (box.x0 >= box.x1 || box.y0 >= box.y1) return {};
  const auto column_of = [&](int x) { return (int)samples.quotient((uint32_t)x) / kAreaWidth; };
  const auto row_of = [&](int y) { return (int)samples.quotient((uint32_t)y) / kAreaHeight; };
  const int top = row_of(box.y0);
  return {view * areas.rows + top, column_of(box.x0), column_of(box.x1 - 1), row_of(box.y1 - 1) - top + 1};
}

// Of marks that lie together, those from column left to column right.
__device__ __forceinline__ uint64_t marks_between(int left, int right) {
  constexpr uint64_t kAll = 0x0101010101010101ull;
  return kAll << (8 * max_of(left, 0)) & kAll >> (8 * (kMarksTogether - 1 - min_of(right, kMarksTogether - 1)));
}

// Marks the areas that triangles of the views may touch, a thread a triangle: those that its bounding box meets, or all
// areas of its view where it has to be clipped. Bytes of a word are stored here and combined with others there; both
// happen in the L2 cache, byte by byte, so that none is lost. projected: the vertices of all views, or null.
__global__ void __launch_bounds__(kMarkThreads)
    mark_areas(const __grid_constant__ Frame f, const __grid_constant__ Areas areas, const Vertex* projected,
               ShortDivisor triangles, ShortDivisor samples, int64_t items) {
  constexpr int kOwn = 8;  // a triangle with more is the whole warp's, so that a large one does not hold up a lane
  let_next_begin();
  if (projected) wait_for_previous();
  // A warp's triangles lie apart in the mesh: neighbours are alike, and large ones take long.
  const int64_t item = (int64_t)threadIdx.x * gridDim.x + blockIdx.x;
  MarkBox box = {};
  if (item < items) box = mark_box(f, areas, projected, triangles, samples, item);
  wait_for_previous();
  const bool small = box.rows * (box.right - box.left + 1) <= kOwn;
  for (int down = 0; small && down < box.rows; ++down)
    for (int column = box.left; column <= box.right; ++column)
      areas.marks[(box.first_row + down) * areas.pitch + column] = 1;
  for (unsigned large = __ballot_sync(kAllLanes, !small); large; large &= large - 1) {
    const MarkBox its = of_lane(box, __ffs(large) - 1);
    // Four rows at a time, by eight lanes each.
    constexpr int kTeam = 8, kTeams = kWarp / kTeam;
    for (int down = lane_id() / kTeam; down < its.rows; down += kTeams)
      for (int column = (its.left / kMarksTogether + lane_id() % kTeam) * kMarksTogether; column <= its.right;
           column += kTeam * kMarksTogether)
        atomicOr(reinterpret_cast<unsigned long long*>(areas.marks + (its.first_row + down) * areas.pitch + column),
                 (unsigned long long)marks_between(its.left - column, its.right - column));
  }
}

// Lists the areas that are marked, and clears them. A block takes so many areas of a row at a time as marks are read
// together, a row of samples a warp.
constexpr int kAreaThreads = 256;
__host__ __device__ inline int row_parts(const Areas& areas) { return areas.pitch / kMarksTogether; }
__global__ void __launch_bounds__(kAreaThreads)
    clear_areas(const __grid_constant__ Frame f, const __grid_constant__ Areas areas) {
  let_next_begin();
  wait_for_previous();
  const bool in_pairs = f.view.width % 2 == 0 && ((uintptr_t)f.packed & 15) == 0;
  for (int64_t i = blockIdx.x; i < area_rows(areas) * row_parts(areas); i += gridDim.x) {
    const uint64_t marks = reinterpret_cast<const uint64_t*>(areas.marks)[i];
    if (!marks) continue;
    const int64_t row_of_all = i / row_parts(areas), view = row_of_all / areas.rows;
    const int row = (int)(row_of_all - view * areas.rows),
              first = (int)(i - row_of_all * row_parts(areas)) * kMarksTogether;
    const bool mine = lane_id() < kMarksTogether && (marks >> (8 * (lane_id() % kMarksTogether)) & 1);
    const unsigned marked = __ballot_sync(kAllLanes, mine);
    if (this_warp() == 0) {
      uint32_t place = 0;
      if (lane_id() == 0) place = atomicAdd(areas.count, (uint32_t)__popc(marked));
      place = __shfl_sync(kAllLanes, place, 0) + __popc(marked & lanes_below());
      if (mine) areas.list[place] = {(int32_t)view, (uint16_t)(first + lane_id()), (uint16_t)row};
    }
    const int width = kAreaWidth * f.area_samples, height = kAreaHeight * f.area_samples,
              bottom = min_of((row + 1) * height, f.view.height);
    for (int y = row * height + this_warp(); y < bottom; y += kAreaThreads / kWarp) {
      int64_t* const pixels = pixels_of(f, view) + (int64_t)y * f.view.width;
      for (unsigned todo = marked; todo; todo &= todo - 1) {
        const int left = (first + __ffs(todo) - 1) * width, right = min_of(left + width, f.view.width);
        if (in_pairs) {
          for (int x = left + 2 * lane_id(); x < right; x += 2 * kWarp)
            reinterpret_cast<longlong2*>(pixels)[x / 2] = make_longlong2(kBackground, kBackground);
        } else {
          for (int x = left + lane_id(); x < right; x += kWarp) pixels[x] = kBackground;
        }
      }
    }
  }
}
}  // namespace

Vertex* take_projected(Scratch* scratch, const Frame& f, bool wanted) {
  // A vertex less than triangle corners by half at least, or projecting each one once saves nothing; and many triangles
  // for the image, or set-up is done with projecting its own while the image is cleared.
  const int64_t views = f.view_stride ? f.views : 1, vertices = views * f.vertices, triangles = triangles_of_all(f);
  const int64_t pixels = pixels_of_all(f);
  if (!wanted && (vertices > 2 * triangles || triangles < pixels / kPixelsPerProjected)) return nullptr;
  return scratch->take<Vertex>(vertices);
}

cudaError_t launch_clear(const Frame& f, Vertex* projected, const Zeros& zeros, cudaStream_t stream, uint32_t* shown) {
  int processors;
  BIGTRI_CUDA(multiprocessors(&processors));
  const int64_t pixels = pixels_of_all(f), vertices = f.view_stride ? f.views * f.vertices : f.vertices;
  const Areas areas = f.areas ? areas_of(f) : Areas{};
  const Zeros marks = {areas.count, f.areas ? area_mark_bytes(areas) / (int64_t)sizeof(uint32_t) : 0};
  const int64_t each = f.areas ? max_of(max_of(zeros.count, marks.count), (int64_t)f.views) : (pixels + 1) / 2;
  const int64_t clearing = max_of<int64_t>(
                    1, min_of<int64_t>((each + kClearThreads - 1) / kClearThreads, (int64_t)kClearBlocks * processors)),
                projecting = projected ? (vertices + kProjectVertices - 1) / kProjectVertices : 0;
  const int64_t sampling = shown ? 1 : 0;
  BIGTRI_CUDA(launch_first(shown ? clear_frame<true> : clear_frame<false>, sampling + projecting + clearing,
                           kClearThreads, 0, stream, f, projected, (unsigned)clearing, zeros, marks, shown));
  if (!f.areas) return cudaSuccess;
  const int64_t items = (int64_t)f.views * f.count;
  if (items > 0)
    BIGTRI_CUDA(launch_next(mark_areas, (items + kMarkThreads - 1) / kMarkThreads, kMarkThreads, 0, stream, f, areas,
                            projected, ShortDivisor((uint32_t)f.count), ShortDivisor((uint32_t)f.area_samples), items));
  return launch_next(clear_areas, grid_blocks(area_rows(areas) * row_parts(areas), 1), kAreaThreads, 0, stream, f,
                     areas);
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

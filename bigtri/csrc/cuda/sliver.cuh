// Slivers: long and thin triangles, a lane to a line of pixels across. Where the line meets the sliver follows from two
// divisions for each edge, done once; crossing_of says why that is exact.
#pragma once

#include "fragment.cuh"
#include "launch.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr int kSliverLines = 64;  // px; shorter ones are not worth the trouble
constexpr int kSliverWidth = 4;  // px, on average, at most

__device__ __forceinline__ bool is_sliver(const Record& r) {
  return max_of(r.x1 - r.x0, r.y1 - r.y0) >= kSliverLines &&
         r.area.value <= (double)(2 * kSliverWidth * kSubpixel) * max_of(extent(r.x), extent(r.y));
}

// A block draws a sliver over so many cells along it. At each of these it meets at most so many rows of cells across,
// if it is as thin as slivers are.
constexpr int kSliverCells = 64, kSliverRows = 3;
constexpr int kSliverChunk = kSliverCells * kBin;  // px
constexpr int kSliverThreads = 128;  // of a block, at least
static_assert(kSliverChunk <= 32 * kSliverThreads, "a bit for each of a thread's lines");

// Chunks that any sliver of a frame can have.
__host__ __device__ inline int sliver_chunks(const Viewport& v) {
  return (max_of(v.width, v.height) + kSliverChunk - 1) / kSliverChunk;
}

// Where line n of a chunk crosses an edge: first + next * n, in pixels across, counted so that rounding up gives the
// first pixel inside where lines enter there, and minus the last one where they leave. Minus infinity, which bounds
// nothing, where that would not be exact. In float64 whatever depth is computed in, since it decides coverage.
//
// Where float64 is slow, numbers of 2^-40 in 64 bits.
using CrossingNumber = std::conditional_t<kSlowFloat64, int64_t, double>;
__device__ __forceinline__ int rounded_up(double first, double next, int n) {
  return __double2int_ru(__fma_rn(next, (double)n, first));
}
__device__ __forceinline__ int rounded_up(int64_t first, int64_t next, int n) {
  return (int)((first + next * n + (int64_t{1} << 40) - 1) >> 40);
}
struct Crossing {
  CrossingNumber first, next;
  bool enters, exact;

  __device__ __forceinline__ int rounded(int n) const { return rounded_up(first, next, n); }
};
// Beyond 2^22 px a line crosses nowhere in the bbox, whichever of the chunk's it is: from the first to the last, it moves
// by less than 2^21.
__device__ __forceinline__ CrossingNumber crossing_number(double v) {
  if constexpr (kSlowFloat64) return (CrossingNumber)(min_of(max_of(v, -4194304.0), 4194304.0) * 1099511627776.0);
  return (CrossingNumber)v;
}

// f: the edge at the first pixel of the first line. A quotient of integers with a denominator below 2^24 is an integer
// or more than 2^-24 away from one. Where a line's crossing changes by no more than kSteepest from line to line, all
// that is rounded here is below 2^-31 together, for crossings that can matter: less than the slack, which is less than
// the distance. In units of 2^-40, up to kSliverChunk of them are cut off besides: 2^-28.
__device__ __forceinline__ Crossing crossing_of(int64_t f, int32_t step, int32_t to_next) {
  constexpr double kSlack = 1.0 / (1 << 25);
  constexpr int kSteepest = 256;
  Crossing c = {crossing_number(-(double)kInfinity), 0, step > 0,
                step != 0 && (int64_t)absolute(step) * kSteepest >= absolute(to_next)};
  const double inverse = __drcp_rn((double)absolute(step));
  if (c.exact) {
    c.first = crossing_number(-(double)f * inverse - kSlack);
    c.next = crossing_number(-(double)to_next * inverse);
  }
  return c;
}

struct Lines {
  int begin, end;
};

// In how many bands of rows slivers are drawn, all in one before any in the next: two where half of the image stays in
// the cache, but not all of it. The upper one comes first, for the clear ends there. Four fifths of the cache count as
// the image's: records pass through it too. cache: its bytes; 0: what the device says.
inline cudaError_t sliver_bands(const Frame& f, int64_t cache, int* bands) {
  *bands = 1;
  if (f.views > 1) return cudaSuccess;
  if (cache == 0) {
    int bytes;
    BIGTRI_CUDA(cache_bytes(&bytes));
    cache = bytes;
  }
  const int64_t bytes = (int64_t)f.view.width * f.view.height * (int64_t)sizeof(int64_t), held = cache / 5 * 4;
  if (bytes > held && bytes <= 2 * held) *bands = 2;
  return cudaSuccess;
}

// Shared memory of a block: a sliver, where a chunk's lines cross its edges, and the planes of the cells that it meets,
// by their anchors.
struct NoLines {};
struct SliverLineShared {
  PairLines common;  // to the planes of lines, instead of those of cells
};
// Of a sliver's record, a chunk's lines in a band.
struct SliverPart {
  uint32_t record;
  uint16_t chunk, band;
};
struct SliverShared : std::conditional_t<kPairDepth, SliverLineShared, NoLines> {
  Record record;
  Lines part;  // to be drawn
  Crossing crossing[3];
  DepthNumber zcell[kSliverCells][kSliverRows];
  int row[kSliverCells];  // the first
  SliverPart parts[kSliverThreads];  // to be drawn
  int count;
};

__device__ __forceinline__ void prefetch(const Record* record) {
  const char* from = reinterpret_cast<const char*>(record);
  asm volatile("prefetch.global.L1 [%0];" ::"l"(__cvta_generic_to_global(from)));
  from += sizeof(Record) - 1;  // it may lie in two lines
  asm volatile("prefetch.global.L1 [%0];" ::"l"(__cvta_generic_to_global(from)));
}

// A sliver's lines in one chunk and band of rows of the image: whatever is rounded here, all bands together have all
// lines. columns: lines are columns.
__device__ __forceinline__ Lines lines_of(const Record& r, bool columns, int chunk, int height, int band, int bands) {
  const Lines all = {max_of(chunk * kSliverChunk, columns ? r.x0 : r.y0),
                     min_of((chunk + 1) * kSliverChunk, columns ? r.x1 : r.y1)};
  if (bands == 1 || all.begin >= all.end) return all;
  int a = 0, b = 0;  // its ends
  for (int k = 1; k < 3; ++k) {
    a = r.x[k] < r.x[a] ? k : a;
    b = r.x[k] > r.x[b] ? k : b;
  }
  const float rise = (float)(r.y[b] - r.y[a]), run = (float)(r.x[b] - r.x[a]);
  const bool down = !columns || rise >= 0.0f;  // from line to line
  const auto border = [&](int k) {  // between bands k - 1 and k
    if (k == 0 || k == bands) return (k == 0) == down ? all.begin : all.end;
    const int y = height * k / bands;
    const float at =
        columns ? ((float)r.x[a] + __fdividef((float)(y * kSubpixel - r.y[a]), rise) * run) * (1.0f / kSubpixel)
                : (float)y;
    return (int)fminf(fmaxf(at, (float)all.begin), (float)all.end);
  };
  const int above = border(band), below = border(band + 1);
  return {min_of(above, below), max_of(above, below)};
}

// What a thread knows of the lines s->part of the sliver s->record; line n, n = 0 .. lines - 1, is line begin + n of
// the image. kColumns: lines are columns, else rows.
template <bool kColumns>
struct SliverLines {
  SliverShared* s;
  const Record& r;
  int begin, lines;
  int low, end;  // pixels of a line that are in the bbox: from `low` on, `end` of them
  Crossing crossing[3];

  __device__ __forceinline__ explicit SliverLines(SliverShared* shared)
      : s(shared),
        r(s->record),
        begin(s->part.begin),
        lines(s->part.end - begin),
        low(kColumns ? r.y0 : r.x0),
        end((kColumns ? r.y1 : r.x1) - low) {}

  // Where the lines cross the edges. By all threads, with a barrier in between.
  __device__ __forceinline__ void find_crossings() {
    if (threadIdx.x < 3) {
      const Edge e = edge_of(r.x, r.y, (int)threadIdx.x);
      s->crossing[threadIdx.x] = crossing_of(edge_steps(e, kColumns ? begin : low, kColumns ? low : begin),
                                             kColumns ? e.dx : -e.dy, kColumns ? -e.dy : e.dx);
    }
    __syncthreads();
    for (int k = 0; k < 3; ++k) crossing[k] = s->crossing[k];
  }

  // Of line n: the first pixel, at most `end`, and the last.
  __device__ __forceinline__ void span(int n, int* from, int* last) const {
    *from = 0;
    *last = end - 1;
    for (int k = 0; k < 3; ++k) {
      const int at = crossing[k].rounded(n);
      if (crossing[k].enters)
        *from = max_of(*from, at);
      else
        *last = min_of(*last, -max_of(at, -end));
    }
    *from = min_of(*from, end);
  }

  // The planes of the cells along the sliver. By all threads; ends with a barrier.
  __device__ __forceinline__ void prepare_cells() {
    const int first_cell = begin / kBin;
    for (int i = threadIdx.x; i < kSliverCells * kSliverRows; i += blockDim.x) {
      const int number = i / kSliverRows, cell = first_cell + number, which = i % kSliverRows;
      if (cell * kBin >= begin + lines) break;
      int from[2], last;
      span(max_of(cell * kBin - begin, 0), &from[0], &last);
      span(min_of(cell * kBin + kBin - begin, lines) - 1, &from[1], &last);
      const int row = (low + min_of(from[0], from[1])) / kBin;
      s->zcell[number][which] = depth_at(r.x, r.y, r.z, r.area, (kColumns ? cell : row + which) * kBin,
                                         (kColumns ? row + which : cell) * kBin);
      if (which == 0) s->row[number] = row;
    }
    __syncthreads();
  }

  // What the lines' planes have in common, where float64 is slow. Shared is SliverShared. By all threads; ends with a
  // barrier.
  template <class Shared>
  __device__ __forceinline__ void prepare_lines(Shared* shared) const {
    if (threadIdx.x == 0) shared->common = pair_lines(r.x, r.y, r.z, twice_area(r.x, r.y), kColumns);
    __syncthreads();
  }

  // The twin of draw() in pairs. A line's plane is anchored at its first pixel, which is covered.
  template <class Shared>
  __device__ __forceinline__ uint32_t draw_by_pairs(const Frame& f, const Shared* shared) const {
    const bool exact = !is_thin(r) && crossing[0].exact && crossing[1].exact && crossing[2].exact;
    const PairLines& common = shared->common;
    const FramePixel packed = first_pixel(f, r.view);
    uint32_t odd = 0;
#pragma unroll 1
    for (int base = 0, turn = 0; base < lines; base += blockDim.x, ++turn) {
      const int n = min_of(base + (int)threadIdx.x, lines - 1), line = begin + n;
      int from, last;
      span(n, &from, &last);
      from += low;
      last = base + (int)threadIdx.x < lines ? last + low : -1;
      if (from <= last && !exact) {
        odd |= 1u << turn;
        last = -1;
      }
      FloatPair start = {0.0f, 0.0f};
      if (from <= last)
        start = pair_line_start(common, r.x, r.y, r.z[0], kColumns ? line : from, kColumns ? from : line);
      const float error = common.fixed + common.per_px * (float)(last - from);
#pragma unroll 1
      for (int m = from; m <= last; ++m) {
        const int px = kColumns ? line : m, py = kColumns ? m : line;
        if constexpr (kCounts) count_fragment(packed + (uint32_t)(py * f.view.width + px));
        float z;
        if (!pair_depth(start, common.step, exact_float(m - from), error, &z)) z = undecided_depth_of(&r, px, py);
        keep_nearest(packed + (uint32_t)(py * f.view.width + px),
                     pack_fragment(clamp_depth(z, r.zmin, r.zmax), r.triangle), false);
      }
      __syncwarp();
    }
    return odd;
  }

  // Draws each line by a thread, its pixels where two quotients say. Returns which of the thread's lines are odd and
  // still to be drawn, a bit each.
  __device__ __forceinline__ uint32_t draw(const Frame& f) const {
    const bool exact = !is_thin(r) && crossing[0].exact && crossing[1].exact && crossing[2].exact;
    const int first_cell = begin / kBin;
    const DepthNumber dzdx = r.dzdx, dzdy = r.dzdy;
    const float zmin = r.zmin, zmax = r.zmax;
    const uint32_t triangle = r.triangle;
    const FramePixel packed = first_pixel(f, r.view);
    const int width = f.view.width;
    uint32_t odd = 0;
#pragma unroll 1
    for (int base = 0, turn = 0; base < lines; base += blockDim.x, ++turn) {
      const int n = min_of(base + (int)threadIdx.x, lines - 1);
      int from, last;
      span(n, &from, &last);
      from += low;
      last = base + (int)threadIdx.x < lines ? last + low : -1;
      const int line = begin + n, number = (line >> kBinBits) - first_cell;
      const int row = s->row[number];
      const DepthNumber across = place_in_cell(line & (kBin - 1));
      if (from <= last && (!exact || (from >> kBinBits) < row || (last >> kBinBits) >= row + kSliverRows)) {
        odd |= 1u << turn;
        last = -1;
      }
      const DepthNumber* const zcell = s->zcell[number] - row;
#pragma unroll 1
      for (int m = from; m <= last; ++m) {
        const DepthNumber along = place_in_cell(m & (kBin - 1));
        const DepthNumber z = plane_row<DepthNumber>(zcell[m >> kBinBits], dzdy, kColumns ? along : across) +
                              plane_column<DepthNumber>(dzdx, kColumns ? across : along);
        const int at = kColumns ? m * width + line : line * width + m;
        if constexpr (kCounts) count_fragment(packed + (uint32_t)at);
        keep_nearest(packed + (uint32_t)at, pack_fragment(finish_depth(z, zmin, zmax), triangle), false);
      }
      __syncwarp();  // lanes that have fewer pixels must not go ahead and draw on their own
    }
    return odd;
  }

  // What `draw` has left, pixel by pixel.
  __device__ __forceinline__ void draw_odd(const Frame& f, uint32_t odd) const {
    for (; odd; odd &= odd - 1) {
      const int n = (__ffs(odd) - 1) * (int)blockDim.x + (int)threadIdx.x;
      int from, last;
      span(n, &from, &last);
      const int line = begin + n, first = low + from, px = kColumns ? line : first, py = kColumns ? first : line;
      draw_tested(first_pixel(f, r.view) + (uint32_t)(py * f.view.width + px), kColumns ? f.view.width : 1, r, px, py,
                  !kColumns, last - from + 1);
    }
  }
};

// Draws the lines s->part of the sliver s->record, by all threads of a block, at least kSliverThreads, on a frame that
// has been cleared. A call, so that its registers cost its callers nothing.
template <bool kColumns>
__device__ __noinline__ void draw_sliver(const Frame& f, SliverShared* s) {
  SliverLines<kColumns> lines(s);
  if (lines.lines <= 0) return;
  if (threadIdx.x == 0) {
    count_work(f, Counter::rows, lines.lines);
    count_work(f, Counter::edges_64, 3);  // of find_crossings()
  }
  lines.find_crossings();
  uint32_t odd;
  if constexpr (kPairDepth) {
    lines.prepare_lines(s);
    wait_for_previous();  // its pixels
    odd = lines.draw_by_pairs(f, s);
  } else {
    lines.prepare_cells();
    wait_for_previous();
    odd = lines.draw(f);
  }
  lines.draw_odd(f, odd);
}

// Of the first `count` records those that is_one(number) says are slivers, a chunk and band a block at a time, by all
// blocks of a grid. Drawing a sliver takes all registers, so little is kept in them meanwhile.
template <class IsOne>
__device__ __forceinline__ void draw_slivers(const Frame& f, const Record* records, int count, int bands,
                                             const IsOne& is_one, SliverShared* s) {
  constexpr int kWords = sizeof(Record) / sizeof(uint32_t);
  const auto chunks = [&] { return (uint32_t)sliver_chunks(f.view); };
  const auto each = [&] { return (uint32_t)count * chunks(); };  // items of a band; all of them are below 2^30
  const auto items = [&] { return each() * (uint32_t)bands; };
  if (items() <= gridDim.x && threadIdx.x == 0 && blockIdx.x < items())
    prefetch(records + blockIdx.x % each() / chunks());  // whether it is one takes as long to know
#pragma unroll 1
  for (uint32_t base = blockIdx.x; base < items(); base += kSliverThreads * gridDim.x) {
    // Many are looked at together, each by a thread, which brings what it finds near to the multiprocessor.
    const uint32_t i = base + threadIdx.x * gridDim.x, number = i % each() / chunks();
    const bool one = threadIdx.x < kSliverThreads && i < items() && is_one((int)number);
    if (one) prefetch(records + number);
    if (!__syncthreads_or(one)) continue;
    if (threadIdx.x == 0) s->count = 0;
    __syncthreads();
    if (one)
      s->parts[atomicAdd(&s->count, 1)] = {number, (uint16_t)(i % each() % chunks()),
                                           (uint16_t)(bands - 1 - (int)(i / each()))};
    __syncthreads();
#pragma unroll 1
    for (bool more = true; more;) {  // the last one first
      const SliverPart part = s->parts[s->count - 1];
      if (threadIdx.x < kWords)
        reinterpret_cast<uint32_t*>(&s->record)[threadIdx.x] =
            reinterpret_cast<const uint32_t*>(records + part.record)[threadIdx.x];
      __syncthreads();
      const bool columns = extent(s->record.x) >= extent(s->record.y);
      if (threadIdx.x == 0) {
        s->part = lines_of(s->record, columns, part.chunk, f.view.height, part.band, bands);
        --s->count;
      }
      __syncthreads();
      if (columns)
        draw_sliver<true>(f, s);
      else
        draw_sliver<false>(f, s);
      more = s->count > 0;
      __syncthreads();
    }
  }
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

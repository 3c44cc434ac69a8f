// The floor under a rasterizer: what the image costs if the coverage is known beforehand. Every 8x8 px tile has a list
// of (mask of its 64 pixels, triangle). A warp owns a tile, keeps two pixels a lane in registers, takes the list with a
// plane for each triangle, and writes each pixel once: depth in float32 and the triangle, 8 bytes. No set-up, no
// binning, no rejection of what is hidden, so scenes with many layers can be drawn faster than this; no far plane,
// beyond which the scenes have nothing. cuda_floor.py builds it, as a shared library with a C interface, by nvcc; a C++
// compiler makes the same without the kernels (c++ -x c++), which the tests run on the CPU.

#include <math.h>
#include <stdint.h>
#include <string.h>

#ifdef __CUDACC__
#define FLOOR_HD __host__ __device__ __forceinline__
#else
#define FLOOR_HD inline
typedef void* cudaStream_t;
#endif

namespace {

constexpr int kTile = 8;  // px
constexpr uint64_t kBackground = INT64_MAX;

struct alignas(16) Item {
  uint64_t mask;  // bit 8 * row + column
  uint32_t record;
  uint32_t triangle;
};

struct alignas(16) Plane {  // depth at pixel (x, y): dzdx * (x + 0.5) + (dzdy * (y + 0.5) + z)
  float dzdx, dzdy, z, unused;
};

// The pixels of a tile that a record covers: docs/numerics.md 3, in int64. corners: x0, y0, x1, y1, x2, y2 in subpx.
FLOOR_HD uint64_t coverage(const int32_t* corners, int column, int row) {
  uint64_t mask = ~(uint64_t)0;
  for (int k = 0; k < 3 && mask; ++k) {
    const int32_t* p = corners + 2 * ((k + 1) % 3);
    const int32_t* q = corners + 2 * ((k + 2) % 3);
    const int64_t dx = (int64_t)q[0] - p[0], dy = (int64_t)q[1] - p[1];
    const int64_t bias = dy < 0 || (dy == 0 && dx > 0) ? 0 : -1;
    const int64_t start =
        dx * (256 * kTile * (int64_t)row + 128 - p[1]) - dy * (256 * kTile * (int64_t)column + 128 - p[0]) + bias;
    uint64_t inside = 0;
    for (int bit = 0; bit < 64; ++bit)
      inside |= (uint64_t)(start + 256 * (dx * (bit >> 3) - dy * (bit & 7)) >= 0) << bit;
    mask &= inside;
  }
  return mask;
}

FLOOR_HD int32_t next(int32_t* counter) {
#ifdef __CUDA_ARCH__
  return atomicAdd(counter, 1);
#else
  return (*counter)++;
#endif
}

struct Lists {
  const int32_t* corners;  // [N, 6]
  const int32_t* boxes;  // [N, 4] x0, y0, x1, y1, half-open
  const int32_t* triangles;  // [N]
  int32_t records, columns;  // N; tiles in a row of tiles
  int32_t* count;  // [tiles], zero at first
  const int32_t* first;  // [tiles]: where a tile's list begins; not read where items is null
  Item* items;  // or null: only count
};

// Items `from`, `from + step`, ... of a record's tiles.
FLOOR_HD void list_record(const Lists& l, int32_t record, int64_t from, int64_t step) {
  const int32_t* box = l.boxes + 4 * (int64_t)record;
  const int x0 = box[0] / kTile, x1 = (box[2] - 1) / kTile, y0 = box[1] / kTile, y1 = (box[3] - 1) / kTile;
  const int64_t width = x1 - x0 + 1, n = width * (y1 - y0 + 1);
  for (int64_t i = from; i < n; i += step) {
    const int column = x0 + (int)(i % width), row = y0 + (int)(i / width);
    const uint64_t mask = coverage(l.corners + 6 * (int64_t)record, column, row);
    if (!mask) continue;
    const int64_t tile = (int64_t)row * l.columns + column;
    const int32_t slot = next(l.count + tile);
    if (l.items) l.items[(int64_t)l.first[tile] + slot] = {mask, (uint32_t)record, (uint32_t)l.triangles[record]};
  }
}

FLOOR_HD uint64_t packed_of(float dzdx, float dzdy, float z, float x, float y, uint32_t triangle) {
  const float depth = fmaf(dzdx, x, fmaf(dzdy, y, z));
  uint32_t bits;
  memcpy(&bits, &depth, 4);
  return (uint64_t)bits << 32 | triangle;
}

struct Image {
  uint64_t* packed;  // [height, width]
  const Item* items;
  const int32_t* first;  // [tiles + 1]
  const Plane* planes;  // [N]
  int32_t width, height, columns, tiles;
};

void fill_on_host(const Image& m) {
  for (int tile = 0; tile < m.tiles; ++tile) {
    for (int bit = 0; bit < 64; ++bit) {
      const int x = tile % m.columns * kTile + (bit & 7), y = tile / m.columns * kTile + (bit >> 3);
      if (x >= m.width || y >= m.height) continue;
      uint64_t best = kBackground;
      for (int32_t i = m.first[tile]; i < m.first[tile + 1]; ++i) {
        const Item& item = m.items[i];
        const Plane& p = m.planes[item.record];
        const uint64_t here = packed_of(p.dzdx, p.dzdy, p.z, x + 0.5f, y + 0.5f, item.triangle);
        if ((item.mask >> bit & 1) && here < best) best = here;
      }
      m.packed[(int64_t)y * m.width + x] = best;
    }
  }
}

#ifdef __CUDACC__

constexpr int kThreads = 256;

__global__ void __launch_bounds__(kThreads) list_all(const __grid_constant__ Lists l) {
  for (int32_t record = blockIdx.x; record < l.records; record += gridDim.x)
    list_record(l, record, (int64_t)blockIdx.y * kThreads + threadIdx.x, (int64_t)gridDim.y * kThreads);
}

// kPairs: the width is even, so a lane's two pixels are one aligned store of 16 bytes.
template <bool kPairs>
__device__ __forceinline__ void store(const Image& m, int x, int y, uint64_t a, uint64_t b) {
  if (x >= m.width || y >= m.height) return;
  uint64_t* at = m.packed + (int64_t)y * m.width + x;
  if (kPairs) {
    *reinterpret_cast<ulonglong2*>(at) = make_ulonglong2(a, b);
  } else {
    at[0] = a;
    if (x + 1 < m.width) at[1] = b;
  }
}

__device__ __forceinline__ Item load(const Item* at) {
  const uint4 v = __ldg(reinterpret_cast<const uint4*>(at));
  return {(uint64_t)v.y << 32 | v.x, v.z, v.w};
}

// kShuffle: the list is fetched 32 items at a time, one a lane, and handed round; without, all lanes read the same
// item. Which one is faster depends on the lists.
template <bool kShuffle, bool kPairs>
__global__ void __launch_bounds__(kThreads) fill(const __grid_constant__ Image m) {
  constexpr unsigned kAll = 0xFFFFFFFFu;
  const int lane = threadIdx.x % 32, tile = (int)((blockIdx.x * (int64_t)kThreads + threadIdx.x) / 32);
  if (tile >= m.tiles) return;
  const int x = tile % m.columns * kTile + lane % 4 * 2, y = tile / m.columns * kTile + lane / 4;
  const float fx = x + 0.5f, fy = y + 0.5f;
  uint64_t a = kBackground, b = kBackground;
  const int end = m.first[tile + 1];
  if (kShuffle) {
    for (int i = m.first[tile]; i < end; i += 32) {
      Item item = {0, 0, 0};
      float4 p = make_float4(0, 0, 0, 0);
      if (i + lane < end) {
        item = load(m.items + i + lane);
        p = __ldg(reinterpret_cast<const float4*>(m.planes) + item.record);
      }
      const int n = min(32, end - i);
#pragma unroll 4
      for (int s = 0; s < n; ++s) {
        const uint64_t mask = __shfl_sync(kAll, item.mask, s) >> (2 * lane);
        const uint32_t triangle = __shfl_sync(kAll, item.triangle, s);
        const float dzdx = __shfl_sync(kAll, p.x, s), dzdy = __shfl_sync(kAll, p.y, s), z = __shfl_sync(kAll, p.z, s);
        const uint64_t here = packed_of(dzdx, dzdy, z, fx, fy, triangle),
                       beside = packed_of(dzdx, dzdy, z, fx + 1, fy, triangle);
        if ((mask & 1) && here < a) a = here;
        if ((mask & 2) && beside < b) b = beside;
      }
    }
  } else {
#pragma unroll 4
    for (int i = m.first[tile]; i < end; ++i) {
      const Item item = load(m.items + i);
      const float4 p = __ldg(reinterpret_cast<const float4*>(m.planes) + item.record);
      const uint64_t mask = item.mask >> (2 * lane);
      const uint64_t here = packed_of(p.x, p.y, p.z, fx, fy, item.triangle),
                     beside = packed_of(p.x, p.y, p.z, fx + 1, fy, item.triangle);
      if ((mask & 1) && here < a) a = here;
      if ((mask & 2) && beside < b) b = beside;
    }
  }
  store<kPairs>(m, x, y, a, b);
}

__global__ void nothing() {}

#endif

}  // namespace

// Every function returns 0, or the number of a CUDA error. With on_host the pointers are to the host's memory and the
// stream is not looked at.
extern "C" {

int floor_lists(const int32_t* corners, const int32_t* boxes, const int32_t* triangles, int32_t records,
                int32_t columns, int32_t* count, const int32_t* first, void* items, int on_host, cudaStream_t stream) {
  const Lists l = {corners, boxes, triangles, records, columns, count, first, static_cast<Item*>(items)};
  if (on_host) {
    for (int32_t record = 0; record < records; ++record) list_record(l, record, 0, 1);
    return 0;
  }
#ifdef __CUDACC__
  if (records == 0) return 0;
  // few records are large ones: several blocks share each
  list_all<<<dim3(records < 65536 ? records : 65536, records < 4096 ? 64 : 1), kThreads, 0, stream>>>(l);
  return cudaGetLastError();
#else
  return -1;
#endif
}

int floor_fill(int shuffle, uint64_t* packed, const void* items, const int32_t* first, const void* planes,
               int32_t width, int32_t height, int on_host, cudaStream_t stream) {
  const int32_t columns = (width + kTile - 1) / kTile, tiles = columns * ((height + kTile - 1) / kTile);
  const Image m = {
      packed, static_cast<const Item*>(items), first, static_cast<const Plane*>(planes), width, height, columns, tiles};
  if (on_host) {
    fill_on_host(m);
    return 0;
  }
#ifdef __CUDACC__
  const unsigned blocks = (unsigned)(((int64_t)tiles * 32 + kThreads - 1) / kThreads);
  if (width % 2 == 0)
    shuffle ? fill<true, true><<<blocks, kThreads, 0, stream>>>(m)
            : fill<false, true><<<blocks, kThreads, 0, stream>>>(m);
  else
    shuffle ? fill<true, false><<<blocks, kThreads, 0, stream>>>(m)
            : fill<false, false><<<blocks, kThreads, 0, stream>>>(m);
  return cudaGetLastError();
#else
  return -1;
#endif
}

int floor_memset(void* at, int64_t bytes, cudaStream_t stream) {
#ifdef __CUDACC__
  return cudaMemsetAsync(at, 0x7F, (size_t)bytes, stream);
#else
  return -1;
#endif
}

int floor_nothing(cudaStream_t stream) {
#ifdef __CUDACC__
  nothing<<<1, 32, 0, stream>>>();
  return cudaGetLastError();
#else
  return -1;
#endif
}

}  // extern "C"

// The shading pass over a visibility buffer on the GPU; docs/numerics.md 18. Mirrors bigtri/reference/shade.py.

#include "shade.h"

#include <cuda_runtime.h>

#include "launch.cuh"
#include "weights.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// Two kernels make a picture. begin_frame makes tables, clips what has to be clipped, each triangle once, and where a
// triangle has many pixels on average, it sets up all of them. It needs nothing of what the triangles are drawn with, and
// overlaps with the end of that. Then `shade` finishes a pixel a lane. Pixels of a clipped triangle for which there was no
// memory are left to a third kernel, shade_left, which ends at once where there are none. Where several samples make a
// pixel all of them work on samples, and add_samples adds those up.

constexpr int kShadeWarps = 4;  // of a block, in all kernels but begin_frame
constexpr int kShadeThreads = kShadeWarps * kWarp;
constexpr int kBeginWarps = 8;
constexpr int kBeginThreads = kBeginWarps * kWarp;
constexpr int kWordsEach = 2;     // that a warp of `shade` takes; a word is 32 pixels next to each other
constexpr int kFewestPlaces = 4;  // for the clipped triangles of a block of begin_frame
constexpr int kMostPlaces = 32;
constexpr int kAllPlaces = 4096;  // of all blocks, where that gives each its fewest
constexpr uint8_t kNoPlace = 255;  // in Work::place: a clipped triangle that found no memory

static_assert(kMostPlaces < kNoPlace, "a place fits a byte");

// Divides numbers of 32 bits by one that the host knows.
struct ShortDivisor {
  uint32_t by;
  uint64_t inverse;  // of `by`: 2^64 / by, rounded down, plus 1; 0 for 1

  explicit ShortDivisor(uint32_t v = 1) : by(v), inverse(v == 1 ? 0 : ~0ull / v + 1) {}
};
// inverse = (2^64 + e) / by with 0 < e <= by, so that v * inverse / 2^64 is v / by plus less than v / 2^64 < 2^-32. That
// is less than 1 / by, which v / by is away from the next whole number at least.
__device__ __forceinline__ uint32_t quotient(uint32_t v, const ShortDivisor& d) {
  if (d.inverse == 0) return v;
  const uint64_t low = (d.inverse & 0xffffffff) * v, high = (d.inverse >> 32) * v;
  return (uint32_t)((high + (low >> 32)) >> 32);
}

// Memory that the kernels work with, and what the host computes for them.
struct Work {
  ShortDivisor width, height;  // of the buffer
  Codes* codes;
  uint32_t* background;        // [views * H]: of each row, the lowest byte first; null where samples are added up
  uint32_t* any_left;          // [1]: whether pixels are left to shade_left
  uint32_t* drawn;             // a bit for each pixel: whether it is not the background; null where nobody asks
  PreparedTriangle* prepared;  // [views, T], or null
  uint8_t* place;              // [views, T]: of a clipped triangle, its place among its block's, or kNoPlace; else 0
  ClippedTriangle* clipped;    // [blocks of begin_frame, places]
  int places;
  Textures textures;
};

// The textures of a launch on their way to memory.
constexpr int kTexturesAtOnce = 128;
struct SomeTextures {
  Texture texture[kTexturesAtOnce];
};

// sRGB thresholds on their way to memory.
struct Thresholds {
  float value[255];
};

__device__ __forceinline__ int64_t warp_in_grid() { return (int64_t)blockIdx.x * kShadeWarps + this_warp(); }

// Where a pixel lies.
struct Place {
  int64_t view;
  int x, y;
};

// The row of a pixel, counted through all views.
__device__ __forceinline__ int64_t row_of(const Work& work, int64_t pixel) {
  return pixel <= UINT32_MAX ? quotient((uint32_t)pixel, work.width) : pixel / work.width.by;
}
__device__ __forceinline__ Place place_of(const Work& work, int64_t pixel, int64_t row) {
  const int64_t view = quotient((uint32_t)row, work.height);
  return {view, (int)(pixel - row * work.width.by), (int)(row - view * work.height.by)};
}

// --- Before the pixels

// Makes what the pixels look up, a thread an item of each table, and looks at every triangle of every view, a thread
// each. The block's warps clip those that have to be clipped.
__global__ void __launch_bounds__(kBeginThreads, 2)
    begin_frame(const __grid_constant__ Shading job, const __grid_constant__ Thresholds given,
                const __grid_constant__ Work work) {
  __shared__ float thresholds[255];
  __shared__ ClipScratch scratch[kBeginWarps];
  __shared__ uint8_t listed[kMostPlaces];  // threads whose triangles are clipped
  __shared__ int count;
  for (int k = threadIdx.x; k < 255; k += kBeginThreads) thresholds[k] = given.value[k];
  if (threadIdx.x == 0) count = 0;
  __syncthreads();
  const int64_t first = (int64_t)blockIdx.x * kBeginThreads, item = first + threadIdx.x, of_view = job.count;
  if (item < job.views * of_view) {
    const int64_t view = item / of_view;
    const int32_t triangle = (int32_t)(item - view * of_view);
    bool clipped;
    if (work.prepared) {
      PreparedTriangle made;
      prepare(job, view, triangle, &made);
      work.prepared[item] = made;
      clipped = made.fate == Fate::kClip;
    } else {
      clipped = is_clipped(job, view, triangle);
    }
    int place = 0;
    if (clipped) {
      place = atomicAdd(&count, 1);
      if (place < work.places)
        listed[place] = (uint8_t)threadIdx.x;
      else
        place = kNoPlace;
    }
    work.place[item] = (uint8_t)place;
  }
  __syncthreads();
  for (int k = this_warp(); k < min_of(count, work.places); k += kBeginWarps) {
    const int64_t which = first + listed[k], view = which / of_view;
    clip(job, view, (int32_t)(which - view * of_view), scratch + this_warp(),
         work.clipped + (int64_t)blockIdx.x * work.places + k);
  }

  Codes* codes = work.codes;
  if (item == 0) *work.any_left = 0;
  if (item < 256) {
    codes->encode.thresholds[item] = item < 255 ? thresholds[item] : kNotANumber;
    codes->decoded[item] = decode_srgb(257 * (int)item);
  }
  if (item <= kSrgbSteps) codes->encode.start[item] = encode_srgb((float)item / kSrgbSteps, thresholds);
  if (work.background && item < job.views * job.height) {
    float linear[3];
    background_at(job.surface, (int)(item - quotient((uint32_t)item, work.height) * (int64_t)job.height), job.height,
                  job.channels, linear);
    uint32_t color = 0;
    for (int c = 0; c < 3; ++c) color |= (uint32_t)encode_srgb(linear[c], thresholds) << (8 * c);
    work.background[item] = color;
  }
  wait_for_previous();
}

// --- The pixels

// The triangle of a pixel of the buffer; -1: background, or none of the triangles.
__device__ __forceinline__ int32_t triangle_of(const Shading& job, int64_t packed) {
  const uint32_t triangle = (uint32_t)packed;
  return triangle < (uint32_t)job.count ? (int32_t)triangle : -1;
}

// A triangle that has been clipped; null if there was no memory for it.
__device__ __forceinline__ const ClippedTriangle* clipped_of(const Shading& job, const Work& work, int64_t view,
                                                             int32_t triangle) {
  const int64_t item = view * job.count + triangle;
  const int place = work.place[item];
  return place == kNoPlace ? nullptr : work.clipped + item / kBeginThreads * work.places + place;
}

enum class Pixel { kBackground, kDrawn, kLeft };

// Finishes pixel i, which lies at a place of the buffer and has a triangle.
template <bool kPrepared>
__device__ __forceinline__ Pixel shade_pixel(const Shading& job, const Work& work, const Codes& codes, const Place& at,
                                             int64_t i, int32_t triangle, float linear[3]) {
  float weight[3];
  if constexpr (kPrepared) {
    const PreparedTriangle& t = work.prepared[at.view * job.count + triangle];
    const Skin* skin = &t.skin;
    if (t.fate == Fate::kWhole) {
      weigh(job, t.whole, at.x, at.y, weight);
    } else if (t.fate == Fate::kClip) {
      const ClippedTriangle* clipped = clipped_of(job, work, at.view, triangle);
      if (!clipped) return Pixel::kLeft;
      if (clipped->count == 0) return Pixel::kBackground;
      weigh(job, *clipped, at.x, at.y, weight);
      skin = &clipped->skin;
    } else {
      return Pixel::kBackground;
    }
    finish(job, work.textures, codes, *skin, weight, i, linear);
  } else {
    WholeTriangle whole;
    Skin skin;
    int32_t vertex[3];
    bool back;
    const Fate fate = set_up_whole(job, at.view, triangle, &whole, vertex, &back);
    if (fate == Fate::kWhole) {
      weigh(job, whole, at.x, at.y, weight);
      if (!load_skin(job, triangle, vertex, back, &skin)) return Pixel::kBackground;
    } else if (fate == Fate::kClip) {
      const ClippedTriangle* clipped = clipped_of(job, work, at.view, triangle);
      if (!clipped) return Pixel::kLeft;
      if (clipped->count == 0) return Pixel::kBackground;
      weigh(job, *clipped, at.x, at.y, weight);
      skin = clipped->skin;
    } else {
      return Pixel::kBackground;
    }
    finish(job, work.textures, codes, skin, weight, i, linear);
  }
  return Pixel::kDrawn;
}

// Puts pixel i of the background into what is wanted beside the picture.
__device__ __forceinline__ void put_background(const Shading& job, int y, int64_t i) {
  float linear[3];
  background_at(job.surface, y, job.height, job.channels, linear);
  for (int c = 0; c < 3; ++c) {
    if (job.albedo) job.albedo[3 * i + c] = 0.0f;
    if (job.normals) job.normals[3 * i + c] = 0.0f;
    if (job.linear) job.linear[3 * i + c] = linear[c];
  }
}

// Stores the colours of a word of the picture, with all lanes; the first is pixel `first`.
__device__ __forceinline__ void store_word(const Shading& job, int64_t first, int64_t pixels, uint32_t color) {
  const int lane = lane_id();
  if (first + kWarp <= pixels && ((uintptr_t)job.image & 3) == 0) {
    uint32_t* to = reinterpret_cast<uint32_t*>(job.image + first * job.channels);
    if (job.channels == 4) {
      to[lane] = color;
    } else {  // the word's 96 bytes, four a lane
      const int from = 4 * lane / 3, skipped = 8 * (4 * lane - 3 * from);
      const uint32_t low = __shfl_sync(kAllLanes, color, from & (kWarp - 1)) & 0xffffff,
                     high = __shfl_sync(kAllLanes, color, (from + 1) & (kWarp - 1));
      if (lane < 3 * kWarp / 4) to[lane] = low >> skipped | high << (24 - skipped);
    }
  } else if (first + lane < pixels) {
    for (int c = 0; c < job.channels; ++c) job.image[(first + lane) * job.channels + c] = (uint8_t)(color >> (8 * c));
  }
}

// A warp takes kWordsEach words, the device shares out the warps: a word that a model covers takes ten times as long as
// one of the background, and a model covers a part of the picture.
template <bool kPrepared>
__global__ void __launch_bounds__(kShadeThreads, kPrepared ? 8 : 6)
    shade(const __grid_constant__ Shading job, const __grid_constant__ Work work) {
  wait_for_previous();
  const int lane = lane_id();
  const int64_t pixels = job.views * job.height * job.width, start = warp_in_grid() * (kWordsEach * kWarp) + lane;
  int32_t triangles[kWordsEach];
#pragma unroll
  for (int j = 0; j < kWordsEach; ++j)
    triangles[j] = start + j * kWarp < pixels ? triangle_of(job, job.packed[start + j * kWarp]) : -1;
#pragma unroll 1
  for (int j = 0; j < kWordsEach; ++j) {
    const int64_t i = start + j * kWarp, first = i - lane;
    if (first >= pixels) return;
    int32_t triangle = triangles[0];
#pragma unroll
    for (int m = 1; m < kWordsEach; ++m)
      if (j == m) triangle = triangles[m];
    const int64_t row = row_of(work, min_of(i, pixels - 1));
    uint32_t color = work.background ? __ldg(work.background + row) : 0;
    Pixel pixel = Pixel::kBackground;
    if (triangle >= 0) {
      float linear[3];
      pixel = shade_pixel<kPrepared>(job, work, *work.codes, place_of(work, i, row), i, triangle, linear);
      if (pixel == Pixel::kDrawn && job.image) color = encoded(*work.codes, linear);
      if (pixel == Pixel::kLeft) *work.any_left = 1;
    }
    if ((job.albedo || job.normals || job.linear) && pixel == Pixel::kBackground && i < pixels)
      put_background(job, place_of(work, i, row).y, i);
    if (work.drawn) {
      const unsigned drawn = __ballot_sync(kAllLanes, pixel == Pixel::kDrawn);
      if (lane == 0) work.drawn[first / kWarp] = drawn;
    }
    if (job.image) store_word(job, first, pixels, color);
  }
}

// The pixels that are left. A warp clips a triangle that it meets, for the pixels of it that lie side by side.
__global__ void __launch_bounds__(kShadeThreads, 4)
    shade_left(const __grid_constant__ Shading job, const __grid_constant__ Work work) {
  __shared__ ClipScratch scratch[kShadeWarps];
  __shared__ ClippedTriangle clipped[kShadeWarps];
  wait_for_previous();
  if (*work.any_left == 0) return;
  ClippedTriangle* held = clipped + this_warp();
  int64_t held_view = -1;
  int32_t held_triangle = -1;
  const int64_t pixels = job.views * job.height * job.width;
  for (int64_t first = warp_in_grid() * kWarp; first < pixels; first += (int64_t)gridDim.x * kShadeThreads) {
    const int64_t i = first + lane_id();
    const int32_t triangle = i < pixels ? triangle_of(job, job.packed[i]) : -1;
    const Place at = place_of(work, i, row_of(work, min_of(i, pixels - 1)));
    const bool wanted = triangle >= 0 && work.place[at.view * job.count + triangle] == kNoPlace;
    bool drawn = false;
    for (unsigned waiting = __ballot_sync(kAllLanes, wanted); waiting;) {
      const int64_t view = __shfl_sync(kAllLanes, at.view, __ffs(waiting) - 1);
      const int32_t next = __shfl_sync(kAllLanes, triangle, __ffs(waiting) - 1);
      if (view != held_view || next != held_triangle) {
        __syncwarp();  // all have read what is held
        clip(job, view, next, scratch + this_warp(), held);
        held_view = view;
        held_triangle = next;
      }
      const bool mine = triangle == next && at.view == view;
      if (mine) {
        uint32_t color = work.background ? work.background[view * job.height + at.y] : 0;
        drawn = held->count > 0;
        if (drawn) {
          float weight[3], linear[3];
          weigh(job, *held, at.x, at.y, weight);
          finish(job, work.textures, *work.codes, held->skin, weight, i, linear);
          color = encoded(*work.codes, linear);
        } else {
          put_background(job, at.y, i);
        }
        for (int c = 0; job.image && c < job.channels; ++c)
          job.image[i * job.channels + c] = (uint8_t)(color >> (8 * c));
      }
      waiting &= ~__ballot_sync(kAllLanes, mine);
    }
    const unsigned all = __ballot_sync(kAllLanes, drawn);
    if (work.drawn && lane_id() == 0) work.drawn[first / kWarp] |= all;
  }
}

// --- Several samples a pixel

// The samples' mean, a thread a pixel.
__global__ void __launch_bounds__(kShadeThreads)
    add_samples(const __grid_constant__ Shading job, const Codes* __restrict__ codes, const float* __restrict__ linear,
                const uint32_t* __restrict__ drawn) {
  wait_for_previous();
  const int n = job.samples, width = job.width / n, height = job.height / n;
  const int64_t pixels = job.views * height * width;
  for (int64_t i = (int64_t)blockIdx.x * kShadeThreads + threadIdx.x; i < pixels;
       i += (int64_t)gridDim.x * kShadeThreads) {
    const int64_t row = i / width, column = i - row * width;
    float total[3] = {0.0f, 0.0f, 0.0f};
    int covered = 0;
    for (int y = 0; y < n; ++y)
      for (int x = 0; x < n; ++x) {
        const int64_t sample = (row * n + y) * job.width + column * n + x;
        for (int c = 0; c < 3; ++c) total[c] = total[c] + linear[3 * sample + c];
        covered += drawn[sample / kWarp] >> (sample % kWarp) & 1;
      }
    store_mean(total, covered, n * n, job.channels, codes->encode, job.image + job.channels * i);
  }
}

__global__ void put_textures(const __grid_constant__ SomeTextures some, Texture* to, int count) {
  const int i = (int)threadIdx.x;
  if (i < count) to[i] = some.texture[i];
}

struct Layout {
  Work work;
  float* linear;  // of the samples, where the caller does not ask for it
  Texture* textures;
};

// Whether every triangle is set up once, whether it is seen or not: where there are many pixels for each, on average. Else
// every pixel sets up its own.
constexpr int64_t kPixelsToPrepare = 24;
bool prepares(const Shading& job) {
  return job.views * job.count * kPixelsToPrepare <= job.views * job.height * job.width;
}

Layout lay_out(const Shading& job, Scratch* scratch) {
  Layout out = {};
  Work& work = out.work;
  const int64_t pixels = job.views * job.height * job.width, triangles = job.views * job.count;
  const int64_t blocks = (triangles + kBeginThreads - 1) / kBeginThreads;
  work.width = ShortDivisor((uint32_t)job.width);
  work.height = ShortDivisor((uint32_t)job.height);
  work.places =
      (int)min_of<int64_t>(max_of<int64_t>(kAllPlaces / max_of<int64_t>(blocks, 1), kFewestPlaces), kMostPlaces);
  work.codes = scratch->take<Codes>(1);
  work.any_left = scratch->take<uint32_t>(1);
  if (job.samples == 1) work.background = scratch->take<uint32_t>(job.views * job.height);
  if (job.samples > 1) work.drawn = scratch->take<uint32_t>((pixels + kWarp - 1) / kWarp);
  if (prepares(job)) work.prepared = scratch->take<PreparedTriangle>(triangles);
  work.place = scratch->take<uint8_t>(triangles);
  work.clipped = scratch->take<ClippedTriangle>(blocks * work.places);
  if (job.samples > 1 && !job.linear) out.linear = scratch->take<float>(3 * pixels);
  if (job.surface.texture_count > kTextures) out.textures = scratch->take<Texture>(job.surface.texture_count);
  return out;
}

// Blocks for so many warps of work that is taken in turns.
template <class Kernel>
cudaError_t blocks_of(Kernel kernel, int64_t warps, int* blocks) {
  return blocks_for(kernel, kShadeThreads, 0, (warps + kShadeWarps - 1) / kShadeWarps, 0, blocks);
}

}  // namespace

int64_t shading_scratch(const Shading& job) {
  Scratch scratch = {nullptr};
  lay_out(job, &scratch);
  return scratch.used;
}

cudaError_t shade_cuda(const Shading& given, bool drawn_before, void* memory, cudaStream_t stream) {
  Scratch scratch = {static_cast<char*>(memory)};
  Layout at = lay_out(given, &scratch);
  const Surface& surface = given.surface;
  at.work.textures.many = at.textures;
  if (!at.textures)
    for (int i = 0; i < surface.texture_count; ++i) at.work.textures.few[i] = surface.textures[i];
  for (int first = 0; at.textures && first < surface.texture_count; first += kTexturesAtOnce) {
    const int count = min_of(surface.texture_count - first, kTexturesAtOnce);
    SomeTextures some = {};
    for (int i = 0; i < count; ++i) some.texture[i] = surface.textures[first + i];
    BIGTRI_CUDA(launch_first(put_textures, 1, kTexturesAtOnce, 0, stream, some, at.textures + first, count));
  }
  Shading job = given;
  const bool several = job.samples > 1;
  if (several) {
    job.image = nullptr;
    if (!job.linear) job.linear = at.linear;
  }
  Thresholds thresholds;
  for (int i = 0; i < 255; ++i) thresholds.value[i] = job.thresholds[i];
  const int64_t rows = job.views * job.height, pixels = rows * job.width, triangles = job.views * job.count;
  const int64_t items = max_of(max_of<int64_t>(kSrgbSteps + 1, rows), triangles);
  const int64_t begin_blocks = (items + kBeginThreads - 1) / kBeginThreads;
  BIGTRI_CUDA(drawn_before
                  ? launch_next(begin_frame, begin_blocks, kBeginThreads, 0, stream, job, thresholds, at.work)
                  : launch_first(begin_frame, begin_blocks, kBeginThreads, 0, stream, job, thresholds, at.work));
  constexpr int kOfBlock = kShadeThreads * kWordsEach;
  const auto kernel = at.work.prepared ? shade<true> : shade<false>;
  BIGTRI_CUDA(launch_next(kernel, (pixels + kOfBlock - 1) / kOfBlock, kShadeThreads, 0, stream, job, at.work));
  int blocks;
  BIGTRI_CUDA(blocks_of(shade_left, (pixels + kWarp - 1) / kWarp, &blocks));
  BIGTRI_CUDA(launch_next(shade_left, blocks, kShadeThreads, 0, stream, job, at.work));
  if (!several) return cudaSuccess;
  const float* linear = job.linear;
  job.image = given.image;
  BIGTRI_CUDA(blocks_of(add_samples, (pixels / (job.samples * job.samples) + kWarp - 1) / kWarp, &blocks));
  return launch_next(add_samples, blocks, kShadeThreads, 0, stream, job, (const Codes*)at.work.codes, linear,
                     (const uint32_t*)at.work.drawn);
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

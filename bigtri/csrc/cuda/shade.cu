// The shading pass over a visibility buffer on the GPU; docs/numerics.md 18. Mirrors bigtri/reference/shade.py.

#include "shade.h"

#include <cuda_runtime.h>

#include "launch.cuh"
#include "weights.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// Two kernels make a picture. The first one, begin_frame, comes before the frame's triangles are drawn: it makes tables,
// clips what has to be clipped, each triangle once, and where a triangle has many pixels on average, it sets up all of
// them. The second one, shade, finishes a pixel a lane. Pixels of a clipped triangle for which there was no memory are
// left to a third one, shade_left, which ends at once where there are none. Where several samples make a pixel all of
// them work on samples, and add_samples adds those up.

constexpr int kShadeWarps = 4;  // of a block, in all kernels
constexpr int kShadeThreads = kShadeWarps * kWarp;
constexpr int kWordsEach = 2;      // that a warp of `shade` takes; a word is 32 pixels next to each other
constexpr int kWordsAtOnce = 8;    // that a warp of `shade_left` looks at together
constexpr int kNoPlace = 255;      // in Work::place: a clipped triangle that found no memory
constexpr int kMostPlaces = 32;    // for the clipped triangles of a block of begin_frame
constexpr int kFewestPlaces = 2;
constexpr int kAllPlaces = 4096;  // of all blocks, where that gives each its fewest

static_assert(kMostPlaces <= kNoPlace, "a place fits a byte");

// Memory that the kernels work with.
struct Work {
  Codes* codes;
  uint32_t* background;      // [H / samples]: of each row of the picture, the lowest byte first
  uint32_t* any_left;        // [1]: whether pixels are left to shade_left
  uint32_t* left;            // a bit for each pixel: whether it is
  uint32_t* drawn;           // the same: whether it is not the background; null where nobody asks
  PreparedTriangle* prepared;  // [views, T], or null
  uint8_t* place;            // [views, T]: of a clipped triangle, its place among its block's, or kNoPlace
  ClippedTriangle* clipped;  // [blocks of kShadeThreads triangles, places]
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

// v / by, with a division of 32 bits where that is enough: one of 64 takes a hundred instructions.
__device__ __forceinline__ int64_t short_quotient(int64_t v, int32_t by) {
  return v <= UINT32_MAX ? (uint32_t)v / (uint32_t)by : v / by;
}

// Where a pixel lies.
struct Place {
  int64_t view;
  int x, y;
};
__device__ __forceinline__ Place place_of(const Shading& job, int64_t pixel) {
  const int of_view = job.height * job.width;
  const int64_t view = short_quotient(pixel, of_view);
  const uint32_t rest = (uint32_t)(pixel - view * of_view);
  const int y = (int)(rest / (uint32_t)job.width);
  return {view, (int)rest - y * job.width, y};
}
// The place `count` pixels after it; count: few rows at most.
__device__ __forceinline__ Place moved(const Shading& job, Place at, int count) {
  at.x += count;
  while (at.x >= job.width) {
    at.x -= job.width;
    if (++at.y == job.height) at.y = 0, ++at.view;
  }
  return at;
}

// --- Before the frame

// Thread t of a block has triangle t of the block's: clips those that have to be, with all lanes of the warp.
__device__ __forceinline__ void clip_those(const Shading& job, const Work& work, bool wanted, int64_t view,
                                           int32_t triangle, int* taken, ClipScratch* scratch) {
  int place = kNoPlace;
  if (wanted) {
    place = min_of(atomicAdd(taken, 1), kNoPlace);
    if (place >= work.places) place = kNoPlace;
    work.place[view * job.count + triangle] = (uint8_t)place;
  }
  for (unsigned left = __ballot_sync(kAllLanes, place != kNoPlace); left; left &= left - 1) {
    const int lane = __ffs(left) - 1;
    const int64_t of = __shfl_sync(kAllLanes, view, lane);
    clip(job, of, __shfl_sync(kAllLanes, triangle, lane), scratch,
         work.clipped + (int64_t)blockIdx.x * work.places + __shfl_sync(kAllLanes, place, lane));
  }
}

// Makes what the frame looks up, a thread an item of each table, and looks at every triangle of every view, a thread
// each.
__global__ void __launch_bounds__(kShadeThreads)
    begin_frame(const __grid_constant__ Shading job, const __grid_constant__ Thresholds thresholds,
                const __grid_constant__ Work work) {
  __shared__ float shared[255];
  __shared__ ClipScratch scratch[kShadeWarps];
  __shared__ int taken;
  for (int k = threadIdx.x; k < 255; k += kShadeThreads) shared[k] = thresholds.value[k];
  if (threadIdx.x == 0) taken = 0;
  __syncthreads();
  const int64_t item = (int64_t)blockIdx.x * kShadeThreads + threadIdx.x;
  int64_t view = 0;
  int32_t triangle = 0;
  bool to_clip = false;
  if (item < job.views * job.count) {
    view = short_quotient(item, job.count);
    triangle = (int32_t)(item - view * job.count);
    if (work.prepared) {
      PreparedTriangle made;
      prepare(job, view, triangle, &made);
      work.prepared[item] = made;
      to_clip = made.fate == Fate::kClip;
    } else {
      to_clip = is_clipped(job, view, triangle);
    }
  }
  clip_those(job, work, to_clip, view, triangle, &taken, scratch + this_warp());

  const int n = job.samples, i = (int)min_of<int64_t>(item, INT32_MAX);
  Codes* codes = work.codes;
  if (i == 0) *work.any_left = 0;
  if (i < 256) {
    codes->encode.thresholds[i] = i < 255 ? shared[i] : kNotANumber;
    codes->decoded[i] = decode_srgb(257 * i);
  }
  if (i <= kSrgbSteps) codes->encode.start[i] = encode_srgb((float)i / kSrgbSteps, shared);
  if (i >= job.height / n) return;
  float total[3] = {0.0f, 0.0f, 0.0f};
  for (int y = 0; y < n; ++y) {
    float one[3];
    background_at(job.surface, i * n + y, job.height, job.channels, one);
    for (int x = 0; x < n; ++x)
      for (int c = 0; c < 3; ++c) total[c] = total[c] + one[c];
  }
  uint8_t pixel[4] = {0, 0, 0, 0};
  store_mean(total, 0, n * n, job.channels, (const float*)shared, pixel);
  work.background[i] = pixel[0] | pixel[1] << 8 | pixel[2] << 16 | (uint32_t)pixel[3] << 24;
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
  return place == kNoPlace ? nullptr : work.clipped + item / kShadeThreads * work.places + place;
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
  const int64_t pixels = job.views * job.height * job.width, start = warp_in_grid() * (kWordsEach * kWarp);
  if (start >= pixels) return;
  int32_t triangles[kWordsEach];
#pragma unroll
  for (int j = 0; j < kWordsEach; ++j) {
    const int64_t i = start + j * kWarp + lane;
    triangles[j] = triangle_of(job, i < pixels ? job.packed[i] : kBackground);
  }
  Place at = moved(job, place_of(job, start), lane);
#pragma unroll 1
  for (int j = 0; j < kWordsEach && start + j * kWarp < pixels; ++j) {
    const int64_t first = start + j * kWarp, i = first + lane;
    int32_t triangle = triangles[0];
#pragma unroll
    for (int m = 1; m < kWordsEach; ++m)
      if (j == m) triangle = triangles[m];
    Pixel pixel = Pixel::kBackground;
    uint32_t color = 0;
    if (triangle >= 0) {
      float linear[3];
      pixel = shade_pixel<kPrepared>(job, work, *work.codes, at, i, triangle, linear);
      if (job.image && pixel == Pixel::kDrawn) color = encoded(*work.codes, linear);
    }
    if (pixel == Pixel::kBackground && i < pixels) {
      if (job.image) color = __ldg(work.background + at.y);
      if (job.albedo || job.normals || job.linear) put_background(job, at.y, i);
    }
    const unsigned left = __ballot_sync(kAllLanes, pixel == Pixel::kLeft),
                   drawn = __ballot_sync(kAllLanes, pixel == Pixel::kDrawn);
    if (lane == 0) {
      work.left[first / kWarp] = left;
      if (work.drawn) work.drawn[first / kWarp] = drawn;
      if (left) *work.any_left = 1;
    }
    if (job.image) store_word(job, first, pixels, color);
    at = moved(job, at, kWarp);
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
  const int lane = lane_id();
  const int64_t pixels = job.views * job.height * job.width, words = (pixels + kWarp - 1) / kWarp;
  const int64_t step = (int64_t)gridDim.x * kShadeWarps * kWordsAtOnce;
  for (int64_t base = warp_in_grid() * kWordsAtOnce; base < words; base += step) {
    const uint32_t loaded = lane < kWordsAtOnce && base + lane < words ? work.left[base + lane] : 0;
    for (unsigned words_left = __ballot_sync(kAllLanes, loaded != 0); words_left; words_left &= words_left - 1) {
      const int k = __ffs(words_left) - 1;
      const uint32_t bits = __shfl_sync(kAllLanes, loaded, k);
      const int64_t first = (base + k) * kWarp, i = first + lane;
      const Place at = moved(job, place_of(job, first), lane);
      const int32_t triangle = bits >> lane & 1 ? triangle_of(job, job.packed[i]) : -1;
      bool drawn = false;
      for (unsigned waiting = bits; waiting;) {
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
          drawn = held->count > 0;
          if (drawn) {
            float weight[3], linear[3];
            weigh(job, *held, at.x, at.y, weight);
            finish(job, work.textures, *work.codes, held->skin, weight, i, linear);
            if (job.image)
              for (int c = 0; c < job.channels; ++c)
                job.image[i * job.channels + c] = (uint8_t)(encoded(*work.codes, linear) >> (8 * c));
          } else {
            for (int c = 0; job.image && c < job.channels; ++c)
              job.image[i * job.channels + c] = (uint8_t)(work.background[at.y] >> (8 * c));
            put_background(job, at.y, i);
          }
        }
        waiting &= ~__ballot_sync(kAllLanes, mine);
      }
      const unsigned all = __ballot_sync(kAllLanes, drawn);
      if (work.drawn && lane == 0) work.drawn[base + k] |= all;
    }
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
  const int64_t pixels = job.views * job.height * job.width, words = (pixels + kWarp - 1) / kWarp;
  const int64_t triangles = job.views * job.count, blocks = (triangles + kShadeThreads - 1) / kShadeThreads;
  work.places =
      (int)min_of<int64_t>(max_of<int64_t>(kAllPlaces / max_of<int64_t>(blocks, 1), kFewestPlaces), kMostPlaces);
  work.codes = scratch->take<Codes>(1);
  work.background = scratch->take<uint32_t>(job.height / job.samples);
  work.any_left = scratch->take<uint32_t>(1);
  work.left = scratch->take<uint32_t>(words);
  if (job.samples > 1) work.drawn = scratch->take<uint32_t>(words);
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

cudaError_t begin_shading_cuda(const Shading& job, void* memory, cudaStream_t stream) {
  Scratch scratch = {static_cast<char*>(memory)};
  const Layout at = lay_out(job, &scratch);
  for (int first = 0; at.textures && first < job.surface.texture_count; first += kTexturesAtOnce) {
    const int count = min_of(job.surface.texture_count - first, kTexturesAtOnce);
    SomeTextures some = {};
    for (int i = 0; i < count; ++i) some.texture[i] = job.surface.textures[first + i];
    BIGTRI_CUDA(launch_first(put_textures, 1, kTexturesAtOnce, 0, stream, some, at.textures + first, count));
  }
  Thresholds thresholds;
  for (int i = 0; i < 255; ++i) thresholds.value[i] = job.thresholds[i];
  const int64_t rows = job.height / job.samples;
  const int64_t items = max_of(max_of<int64_t>(kSrgbSteps + 1, rows), job.views * job.count);
  return launch_first(begin_frame, (items + kShadeThreads - 1) / kShadeThreads, kShadeThreads, 0, stream, job,
                      thresholds, at.work);
}

cudaError_t shade_cuda(const Shading& given, void* memory, cudaStream_t stream) {
  Scratch scratch = {static_cast<char*>(memory)};
  Layout at = lay_out(given, &scratch);
  at.work.textures.many = at.textures;
  if (!at.textures)
    for (int i = 0; i < given.surface.texture_count; ++i) at.work.textures.few[i] = given.surface.textures[i];
  Shading job = given;
  const bool several = job.samples > 1;
  if (several) {
    job.image = nullptr;
    if (!job.linear) job.linear = at.linear;
  }
  const int64_t pixels = job.views * job.height * job.width, words = (pixels + kWarp - 1) / kWarp;
  const int64_t warps = (words + kWordsEach - 1) / kWordsEach;
  const auto kernel = at.work.prepared ? shade<true> : shade<false>;
  BIGTRI_CUDA(launch_next(kernel, (warps + kShadeWarps - 1) / kShadeWarps, kShadeThreads, 0, stream, job, at.work));
  int blocks;
  BIGTRI_CUDA(blocks_of(shade_left, (words + kWordsAtOnce - 1) / kWordsAtOnce, &blocks));
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

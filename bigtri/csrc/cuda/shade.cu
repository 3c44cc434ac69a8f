// The shading pass over a visibility buffer on the GPU; docs/numerics.md 18. Mirrors bigtri/reference/shade.py.

#include "shade.h"

#include <cuda_runtime.h>

#include "launch.cuh"
#include "weights.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// Two kernels make a picture. begin_frame makes tables, clips what has to be clipped, each triangle once, and where a
// triangle has many pixels on average, it sets up all of them. It may run beside the frame's own kernels. Behind both
// `shade` finishes a pixel a lane. Pixels of a clipped triangle for which there was no memory are
// left to a third kernel, shade_left, which ends at once where there are none. Where several samples make a pixel all of
// them work on samples, and add_samples adds those up.

constexpr int kShadeWarps = 4;  // of a block, in all kernels but begin_frame
constexpr int kShadeThreads = kShadeWarps * kWarp;
constexpr int kBeginWarps = 8;
constexpr int kBeginThreads = kBeginWarps * kWarp;
// A word is 32 pixels next to each other. In a large picture, where words of the background are most, a warp takes several.
constexpr int kWordsOfLarge = 4;
constexpr int64_t kPixelsOfLarge = 4 << 20;
constexpr int kPixelsAtOnce = 1 << 30;  // that `shade` is launched for, unless one view has more
constexpr int kFewestPlaces = 4;      // for the clipped triangles of a block of begin_frame
constexpr int kMostPlaces = 32;
constexpr int kAllPlaces = 4096;  // of all blocks, where that gives each its fewest
constexpr uint8_t kNoPlace = 255;  // in Work::place: a clipped triangle that found no memory

static_assert(kMostPlaces < kNoPlace, "a place fits a byte");

// Divides numbers below 2^31 by one that the host knows.
struct ShortDivisor {
  uint32_t by, factor;
  int shift;

  ShortDivisor() = default;
  explicit ShortDivisor(uint32_t v) : by(v), shift(31) {
    while (v > 1ull << (shift - 31)) ++shift;
    factor = (uint32_t)((1ull << shift) / v + 1);
  }
};
// factor = (2^shift + e) / by, where 2^shift = 2^31 * 2^l with by / 2 <= 2^(l - 1) < by or by = 2^l = 1, so that it fits
// 32 bits, and 0 < e <= by <= 2^l. Then v * factor / 2^shift is v / by plus v * e / 2^shift / by < 1 / by, which v / by is
// away from the next whole number at least.
__device__ __forceinline__ uint32_t quotient(uint32_t v, const ShortDivisor& d) {
  return (uint32_t)((uint64_t)v * d.factor >> d.shift);
}

// The textures of a launch on their way to memory.
constexpr int kTexturesAtOnce = 64;
struct SomeTextures {
  int first, count;
  Texture texture[kTexturesAtOnce];
};

// sRGB thresholds on their way to memory.
struct Thresholds {
  float value[255];
};

// Memory that the kernels work with, and what the host computes for them.
struct Work {
  ShortDivisor width, height, triangles;  // of the buffer, in px; T
  uint32_t pixels;                        // of the launch
  int64_t first_item;                     // views before those of the launch, times T
  bool beside;                            // whether something is wanted beside the picture
  Lookups lookups;
  uint32_t* background;        // [views * H]: of each row, the lowest byte first; null where samples are added up
  uint32_t* any_left;          // [1]: whether pixels are left to shade_left
  uint32_t* drawn;             // a bit for each pixel: whether it is not the background; null where nobody asks
  PreparedTriangle* prepared;  // [views, T], or null
  ProjectedVertex* projected;  // [views, V], or null
  uint8_t* place;              // [views, T]: of a clipped triangle, its place among its block's, or kNoPlace; else 0
  ClippedTriangle* clipped;    // [blocks of begin_frame with triangles, places]
  int places;
};

// Where a pixel lies.
struct Place {
  uint32_t view;
  int x, y;
};

__device__ __forceinline__ Place place_of(const Work& work, uint32_t pixel, uint32_t row) {
  const uint32_t view = quotient(row, work.height);
  return {view, (int)(pixel - row * work.width.by), (int)(row - view * work.height.by)};
}

// --- Before the pixels

// Makes what the pixels look up: thread i an item of each table.
__device__ __forceinline__ void make_tables(const Shading& job, const Work& work, const Thresholds& given,
                                            const SomeTextures& textures, int64_t i) {
  __shared__ float thresholds[255];
  for (int k = threadIdx.x; k < 255; k += kBeginThreads) thresholds[k] = given.value[k];
  __syncthreads();
  if (i == 0) *work.any_left = 0;
  if (i < textures.count) work.lookups.textures[i] = textures.texture[i];
  if (i < 256) work.lookups.codes->decoded[i] = decode_srgb(257 * (int)i);
  if (i < kSrgbSteps) work.lookups.codes->encode.byte[i] = srgb_step(thresholds, kSrgbFirstStep + (uint32_t)i);
  if (i < job.surface.lights)
    work.lookups.lights[i].light = light_at(LightArrays{job.surface.light_directions, job.surface.light_colors}, i);
  if (work.background && i < job.views * job.height) {
    Finished pixel;
    finish_background(job, (int)(i % job.height), &pixel);
    uint32_t color = 0;
    for (int c = 0; c < 3; ++c) color |= (uint32_t)encode_srgb(pixel.linear[c], (const float*)thresholds) << (8 * c);
    work.background[i] = color;
  }
}

// Looks at every triangle of every view, a thread each. The block's warps clip those that have to be clipped.
__device__ __forceinline__ void look_at_triangles(const Shading& job, const Work& work) {
  __shared__ ClipScratch scratch[kBeginWarps];
  __shared__ uint8_t listed[kMostPlaces];  // threads whose triangles are clipped
  __shared__ int count;
  if (threadIdx.x == 0) count = 0;
  __syncthreads();
  const int64_t first = (int64_t)blockIdx.x * kBeginThreads, item = first + threadIdx.x, all = job.views * job.count;
  const auto view_of = [&](int64_t i) {
    return all <= INT32_MAX ? (int64_t)quotient((uint32_t)i, work.triangles) : i / job.count;
  };
  if (item < all) {
    const int64_t view = view_of(item);
    const int32_t triangle = (int32_t)(item - view * job.count);
    bool clipped;
    if (work.prepared) {
      PreparedTriangle made;
      prepare(job, view, triangle, &made);
      work.prepared[item] = made;
      clipped = made.whole.fate == Fate::kClip;
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
    const int64_t which = first + listed[k], view = view_of(which);
    clip(job, view, (int32_t)(which - view * job.count), scratch + this_warp(),
         work.clipped + (int64_t)blockIdx.x * work.places + k);
  }
}

// The first blocks have triangles, some vertices, the others tables.
__global__ void __launch_bounds__(kBeginThreads, 2)
    begin_frame(const __grid_constant__ Shading job, const __grid_constant__ Work work,
                const __grid_constant__ Thresholds thresholds, const __grid_constant__ SomeTextures textures,
                unsigned triangle_blocks, unsigned vertex_blocks) {
  const auto item_behind = [](unsigned blocks) { return (int64_t)(blockIdx.x - blocks) * kBeginThreads + threadIdx.x; };
  if (blockIdx.x < triangle_blocks) {
    look_at_triangles(job, work);
  } else if (blockIdx.x < triangle_blocks + vertex_blocks) {
    const int64_t i = item_behind(triangle_blocks);
    if (i < job.views * job.vertices) work.projected[i] = project(frame_of(job, 0), i);
  } else {
    make_tables(job, work, thresholds, textures, item_behind(triangle_blocks + vertex_blocks));
  }
}

// --- The pixels

// The triangle of a pixel of the buffer; -1: background, or none of the triangles.
__device__ __forceinline__ int32_t triangle_of(const Shading& job, uint32_t pixel) {
  const uint32_t triangle = reinterpret_cast<const uint32_t*>(job.packed)[2 * (int64_t)pixel];  // the lower half
  return triangle < (uint32_t)job.count ? (int32_t)triangle : -1;
}

// A triangle that has been clipped; null if there was no memory for it.
__device__ __forceinline__ const ClippedTriangle* clipped_of(const Work& work, int64_t item) {
  const int place = work.place[item];
  return place == kNoPlace ? nullptr : work.clipped + item / kBeginThreads * work.places + place;
}

enum class Pixel { kBackground, kDrawn, kLeft };

// Finishes a pixel that lies at a place of the buffer and has a triangle.
template <bool kPrepared>
__device__ __forceinline__ Pixel shade_pixel(const Shading& job, const Work& work, const Place& at, int32_t triangle,
                                             Finished* out) {
  const int64_t item = work.first_item + (int64_t)at.view * job.count + triangle;
  WholeTriangle whole;
  int32_t vertex[3];
  bool back;
  if constexpr (kPrepared)
    whole = loaded(&work.prepared[item].whole);
  else
    set_up_whole(job, at.view, triangle, work.projected ? work.projected + at.view * job.vertices : nullptr, &whole,
                 vertex, &back);
  float weight[3];
  Skin skin;
  if (whole.fate == Fate::kWhole) {
    weigh(job, whole, at.x, at.y, weight);
    if constexpr (kPrepared)
      skin = loaded(&work.prepared[item].skin);
    else if (!load_skin(job, triangle, vertex, back, &skin))
      return Pixel::kBackground;
  } else if (whole.fate == Fate::kClip) {
    const ClippedTriangle* clipped = clipped_of(work, item);
    if (!clipped) return Pixel::kLeft;
    if (clipped->count == 0) return Pixel::kBackground;
    weigh(job, *clipped, at.x, at.y, weight);
    skin = loaded(&clipped->skin);
  } else {
    return Pixel::kBackground;
  }
  finish(job.surface, work.lookups, skin, weight, out);
  return Pixel::kDrawn;
}

__device__ __forceinline__ void store_pixel(const Shading& job, uint32_t i, uint32_t color) {
  for (int c = 0; c < job.channels; ++c) job.image[(int64_t)i * job.channels + c] = (uint8_t)(color >> (8 * c));
}

// Stores the colours of a word of the picture, with all lanes; the first is pixel `first`.
__device__ __forceinline__ void store_word(const Shading& job, uint32_t first, uint32_t pixels, uint32_t color) {
  const int lane = lane_id();
  if (first + kWarp <= pixels && ((uintptr_t)job.image & 3) == 0) {
    uint32_t* to = reinterpret_cast<uint32_t*>(job.image + (int64_t)first * job.channels);
    if (job.channels == 4) {
      to[lane] = color;
    } else {  // the word's 96 bytes, four a lane
      const int from = 4 * lane / 3, skipped = 8 * (4 * lane - 3 * from);
      const uint32_t low = __shfl_sync(kAllLanes, color, from & (kWarp - 1)) & 0xffffff,
                     high = __shfl_sync(kAllLanes, color, (from + 1) & (kWarp - 1));
      if (lane < 3 * kWarp / 4) to[lane] = low >> skipped | high << (24 - skipped);
    }
  } else if (first + lane < pixels) {
    store_pixel(job, first + lane, color);
  }
}

// A warp takes a word, or kWords, which it loads at once and then goes through. Words of the background take no longer
// than it takes to load them. The device shares out the warps: a word that a model covers takes ten times as long, and a
// model covers a part of the picture.
template <bool kPrepared, int kWords>
__global__ void __launch_bounds__(kShadeThreads, 8)
    shade(const __grid_constant__ Shading job, const __grid_constant__ Work work) {
  wait_for_previous();
  const uint32_t start = (blockIdx.x * kShadeWarps + this_warp()) * (kWords * kWarp), lane = lane_id();
  const auto row_of = [&](uint32_t i) { return quotient(min_of(i, work.pixels - 1), work.width); };
  const auto background_of = [&](uint32_t i) { return work.background ? __ldg(work.background + row_of(i)) : 0; };
  // One word, of these triangles, with all lanes. color: of the background.
  const auto finish_word = [&](uint32_t first, int32_t triangle, uint32_t color) {
    const uint32_t i = first + lane;
    Pixel pixel = Pixel::kBackground;
    Finished finished;
    if (triangle >= 0) {
      pixel = shade_pixel<kPrepared>(job, work, place_of(work, i, row_of(i)), triangle, &finished);
      if (pixel == Pixel::kDrawn && job.image) color = encoded(*work.lookups.codes, finished.linear);
      if (pixel == Pixel::kLeft) *work.any_left = 1;
    }
    if (work.beside) {
      if (pixel == Pixel::kBackground) finish_background(job, place_of(work, i, row_of(i)).y, &finished);
      if (pixel != Pixel::kLeft && i < work.pixels) store_beside(job, finished, i);
      const unsigned drawn = __ballot_sync(kAllLanes, pixel == Pixel::kDrawn);
      if (work.drawn && lane == 0 && first < work.pixels) work.drawn[first / kWarp] = drawn;
    }
    if (job.image) store_word(job, first, work.pixels, color);
  };
  int32_t triangles[kWords];
  uint32_t colors[kWords];
#pragma unroll
  for (int j = 0; j < kWords; ++j) {
    const uint32_t i = start + j * kWarp + lane;
    triangles[j] = i < work.pixels ? triangle_of(job, i) : -1;
    colors[j] = background_of(i);
  }
  if constexpr (kWords == 1) return finish_word(start, triangles[0], colors[0]);
  unsigned covered = 0;
#pragma unroll
  for (int j = 0; j < kWords; ++j) {
    if (work.beside || __any_sync(kAllLanes, triangles[j] >= 0))
      covered |= 1u << j;
    else
      store_word(job, start + j * kWarp, work.pixels, colors[j]);
  }
#pragma unroll 1
  for (; covered; covered &= covered - 1) {
    const int j = __ffs(covered) - 1;
    int32_t triangle = triangles[0];
#pragma unroll
    for (int m = 1; m < kWords; ++m)
      if (j == m) triangle = triangles[m];
    const uint32_t first = start + j * kWarp;
    finish_word(first, triangle, background_of(first + lane));
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
  uint32_t held_view = ~0u;
  int32_t held_triangle = -1;
  for (uint32_t first = (blockIdx.x * kShadeWarps + this_warp()) * kWarp; first < work.pixels;
       first += gridDim.x * kShadeThreads) {
    const uint32_t i = first + lane_id();
    const int32_t triangle = i < work.pixels ? triangle_of(job, i) : -1;
    const Place at = place_of(work, i, quotient(min_of(i, work.pixels - 1), work.width));
    const bool wanted =
        triangle >= 0 && work.place[work.first_item + (int64_t)at.view * job.count + triangle] == kNoPlace;
    bool drawn = false;
    for (unsigned waiting = __ballot_sync(kAllLanes, wanted); waiting;) {
      const uint32_t view = __shfl_sync(kAllLanes, at.view, __ffs(waiting) - 1);
      const int32_t next = __shfl_sync(kAllLanes, triangle, __ffs(waiting) - 1);
      if (view != held_view || next != held_triangle) {
        __syncwarp();  // all have read what is held
        clip(job, view, next, scratch + this_warp(), held);
        held_view = view;
        held_triangle = next;
      }
      const bool mine = triangle == next && at.view == view;
      if (mine) {
        Finished finished;
        drawn = held->count > 0;
        if (drawn) {
          float weight[3];
          weigh(job, *held, at.x, at.y, weight);
          finish(job.surface, work.lookups, held->skin, weight, &finished);
        } else {
          finish_background(job, at.y, &finished);
        }
        store_beside(job, finished, i);
        if (job.image)
          store_pixel(
              job, i,
              drawn ? encoded(*work.lookups.codes, finished.linear) : work.background[view * work.height.by + at.y]);
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

// --- Launches

// What begin_frame has no room for.
__global__ void put_textures(const __grid_constant__ SomeTextures some, Texture* to) {
  const int i = (int)threadIdx.x;
  if (i < some.count) to[some.first + i] = some.texture[i];
}

SomeTextures some_textures(const Surface& s, int first) {
  SomeTextures some = {first, min_of(s.texture_count - first, kTexturesAtOnce)};
  for (int i = 0; i < some.count; ++i) some.texture[i] = s.textures[first + i];
  return some;
}

struct Layout {
  Work work;
  float* linear;  // of the samples, where the caller does not ask for it
};

int64_t views_at_once(const Shading& job) {
  return max_of<int64_t>(1, min_of(job.views, kPixelsAtOnce / ((int64_t)job.height * job.width)));
}

// Whether every triangle is set up once, whether it is seen or not: where there are many pixels for each, on average. Else
// every pixel sets up its own, of vertices that are projected once where there are many pixels for each of them.
constexpr int64_t kPixelsToPrepare = 24, kPixelsToProject = 8;
bool prepares(const Shading& job) { return job.count * kPixelsToPrepare <= (int64_t)job.height * job.width; }
bool projects(const Shading& job) {
  return !prepares(job) && job.vertices * kPixelsToProject <= (int64_t)job.height * job.width;
}

Layout lay_out(const Shading& job, Scratch* scratch) {
  Layout out = {};
  Work& work = out.work;
  const int64_t triangles = job.views * job.count, blocks = (triangles + kBeginThreads - 1) / kBeginThreads;
  const int64_t pixels = views_at_once(job) * job.height * job.width;
  work.width = ShortDivisor((uint32_t)job.width);
  work.height = ShortDivisor((uint32_t)job.height);
  work.triangles = ShortDivisor((uint32_t)max_of(job.count, 1));
  work.beside = job.albedo || job.normals || job.linear || job.samples > 1;
  work.places =
      (int)min_of<int64_t>(max_of<int64_t>(kAllPlaces / max_of<int64_t>(blocks, 1), kFewestPlaces), kMostPlaces);
  work.lookups.codes = scratch->take<Codes>(1);
  work.lookups.textures = scratch->take<Texture>(job.surface.texture_count);
  work.lookups.lights = scratch->take<PackedLight>(job.surface.lights);
  work.any_left = scratch->take<uint32_t>(1);
  if (job.samples == 1) work.background = scratch->take<uint32_t>(job.views * job.height);
  if (job.samples > 1) work.drawn = scratch->take<uint32_t>((pixels + kWarp - 1) / kWarp);
  if (prepares(job)) work.prepared = scratch->take<PreparedTriangle>(triangles);
  if (projects(job)) work.projected = scratch->take<ProjectedVertex>(job.views * job.vertices);
  work.place = scratch->take<uint8_t>(triangles);
  work.clipped = scratch->take<ClippedTriangle>(blocks * work.places);
  if (job.samples > 1 && !job.linear) out.linear = scratch->take<float>(3 * pixels);
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
  for (int first = kTexturesAtOnce; first < job.surface.texture_count; first += kTexturesAtOnce)
    BIGTRI_CUDA(launch_first(put_textures, 1, kTexturesAtOnce, 0, stream, some_textures(job.surface, first),
                             at.work.lookups.textures));
  Thresholds thresholds;
  for (int i = 0; i < 255; ++i) thresholds.value[i] = job.thresholds[i];
  const auto blocks_of_items = [](int64_t items) { return (items + kBeginThreads - 1) / kBeginThreads; };
  const int64_t for_triangles = blocks_of_items(job.views * job.count),
                for_vertices = at.work.projected ? blocks_of_items(job.views * job.vertices) : 0,
                for_tables =
                    blocks_of_items(max_of(max_of<int64_t>(kSrgbSteps, job.surface.lights), job.views * job.height));
  return launch_first(begin_frame, for_triangles + for_vertices + for_tables, kBeginThreads, 0, stream, job, at.work,
                      thresholds, some_textures(job.surface, 0), (unsigned)for_triangles, (unsigned)for_vertices);
}

cudaError_t shade_cuda(const Shading& given, void* memory, cudaStream_t stream) {
  Scratch scratch = {static_cast<char*>(memory)};
  const Layout at = lay_out(given, &scratch);
  const int64_t of_view = (int64_t)given.height * given.width;
  const bool several = given.samples > 1;
  for (int64_t view = 0; view < given.views; view += views_at_once(given)) {
    Shading job = given;
    Work work = at.work;
    job.views = min_of(views_at_once(given), given.views - view);
    const int64_t pixel = view * of_view, pixels = job.views * of_view;
    work.pixels = (uint32_t)pixels;
    work.first_item = view * given.count;
    if (work.background) work.background += view * given.height;
    if (work.projected) work.projected += view * given.vertices;
    job.packed += pixel;
    job.positions += view * given.vertices * 4;
    for (float** image : {&job.albedo, &job.normals, &job.linear})
      if (*image) *image += 3 * pixel;
    job.image += pixel / (given.samples * given.samples) * given.channels;
    uint8_t* const image = job.image;
    if (several) {
      job.image = nullptr;
      if (!job.linear) job.linear = at.linear;
    }
    const bool large = work.prepared && of_view >= kPixelsOfLarge;
    const auto kernel = large ? shade<true, kWordsOfLarge> : work.prepared ? shade<true, 1> : shade<false, 1>;
    const int of_block = kShadeThreads * (large ? kWordsOfLarge : 1);
    BIGTRI_CUDA(launch_next(kernel, (pixels + of_block - 1) / of_block, kShadeThreads, 0, stream, job, work));
    int blocks;
    BIGTRI_CUDA(blocks_of(shade_left, (pixels + kWarp - 1) / kWarp, &blocks));
    BIGTRI_CUDA(launch_next(shade_left, blocks, kShadeThreads, 0, stream, job, work));
    if (!several) continue;
    const float* linear = job.linear;
    job.image = image;
    BIGTRI_CUDA(blocks_of(add_samples, (pixels / (job.samples * job.samples) + kWarp - 1) / kWarp, &blocks));
    BIGTRI_CUDA(launch_next(add_samples, blocks, kShadeThreads, 0, stream, job, (const Codes*)work.lookups.codes,
                            linear, (const uint32_t*)work.drawn));
  }
  return cudaSuccess;
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

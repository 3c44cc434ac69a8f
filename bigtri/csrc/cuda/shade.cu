// The shading pass over a visibility buffer on the GPU; docs/numerics.md 18. Mirrors bigtri/reference/shade.py.

#include "shade.h"

#include <cuda_runtime.h>

#include "areas.h"
#include "launch.cuh"
#include "short_divisor.cuh"
#include "weights.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// begin_frame makes tables, clips what has to be clipped, each triangle once, and where a triangle has many pixels on
// average, it sets up all of them; where areas are listed (areas.h), fill_background makes a picture of nothing but
// background. Both may run beside the frame's own kernels. Behind all these shade_listed finishes the areas that are
// listed, or shade_all all areas, a pixel a lane. Pixels of a clipped triangle for which there was no memory are left to
// shade_left, which ends at once where there are none. Where several samples make a pixel all of them work on samples, and
// add_samples adds those up.

constexpr int kShadeWarps = 4;  // of a block, in all kernels but begin_frame
constexpr int kShadeThreads = kShadeWarps * kWarp;
constexpr int kBeginWarps = 8;
constexpr int kBeginThreads = kBeginWarps * kWarp;
// A word is 32 pixels of a row; an area has so many. Of a large picture a warp takes several words together.
constexpr int kWordsOfArea = kAreaWidth * kAreaHeight / kWarp;
constexpr int kWordsOfLarge = 4;
constexpr int64_t kPixelsOfLarge = 4 << 20;
constexpr int kPixelsAtOnce = 1 << 29;  // of whole areas that a launch is for, twice what one view can have
constexpr int kFewestPlaces = 4;      // for the clipped triangles of a block of begin_frame
constexpr int kMostPlaces = 32;
constexpr int kAllPlaces = 4096;  // of all blocks, where that gives each its fewest
constexpr uint8_t kNoPlace = 255;  // in Work::place: a clipped triangle that found no memory

static_assert(kMostPlaces < kNoPlace, "a place fits a byte");

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
  ShortDivisor width, triangles;          // of the buffer, in px; T
  Areas areas;                            // of the launch's views
  ShortDivisor area_columns, area_rows;   // of a view
  int64_t first_item;                     // views before those of the launch, times T
  bool beside;                            // whether something is wanted beside the picture
  Lookups lookups;
  uint32_t* background;        // [views * H]: of each row, the lowest byte first; null where samples are added up
  uint32_t* any_left;          // [1]: whether pixels are left to shade_left
  // Of each row of the buffer, a bit for each pixel: whether it is not the background; null where nobody asks.
  uint32_t* drawn;
  PreparedTriangle* prepared;  // [views, T], or null
  ProjectedVertex* projected;  // [views, V], or null
  uint8_t* place;              // [views, T]: of a clipped triangle, its place among its block's, or kNoPlace; else 0
  ClippedTriangle* clipped;    // [blocks of begin_frame with triangles, places]
  int places;
};

// Where a pixel lies, or the first one of a word.
struct Place {
  uint32_t view;
  int x, y;
};

// Words of the areas that the pass reads. Some lie beyond the image.
__device__ __forceinline__ uint32_t word_count(const Work& work) {
  return (work.areas.count ? *work.areas.count : (uint32_t)all_areas(work.areas)) * kWordsOfArea;
}
__device__ __forceinline__ Place word_at(const Work& work, uint32_t i) {
  const uint32_t number = i / kWordsOfArea;
  uint32_t view, row, column;
  if (work.areas.list) {
    const Area area = work.areas.list[number];
    view = (uint32_t)area.view, row = area.row, column = area.column;
  } else {
    const uint32_t row_of_all = work.area_columns.quotient(number);
    view = work.area_rows.quotient(row_of_all);
    row = row_of_all - view * work.area_rows.by;
    column = number - row_of_all * work.area_columns.by;
  }
  return {view, (int)(column * kAreaWidth + i % 2 * kWarp), (int)(row * kAreaHeight + i / 2 % kAreaHeight)};
}
static_assert(kAreaWidth == 2 * kWarp, "an area's row is two words");

// Words of a row of the buffer.
__host__ __device__ __forceinline__ int row_words(const Shading& job) { return (job.width + kWarp - 1) / kWarp; }

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
  const auto view_of = [&](int64_t i) { return work.triangles.quotient_of_any(i); };
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
  // Of a prepared one: these have many pixels each, so that the number of those of a launch fits 32 bits.
  [[maybe_unused]] const uint32_t number = at.view * (uint32_t)job.count + (uint32_t)triangle;
  WholeTriangle whole;
  int32_t vertex[3];
  bool back;
  if constexpr (kPrepared)
    whole = loaded(&work.prepared[number].whole);
  else
    set_up_whole(job, at.view, triangle, work.projected ? work.projected + at.view * job.vertices : nullptr, &whole,
                 vertex, &back);
  float weight[3];
  if (whole.fate == Fate::kWhole) {
    weigh(job, whole, at.x, at.y, weight);
    if constexpr (kPrepared) {
      finish(job.surface, work.lookups, SkinInMemory{&work.prepared[number].skin}, weight, out);
    } else {
      Skin skin;
      if (!load_skin(job, triangle, vertex, back, &skin)) return Pixel::kBackground;
      finish(job.surface, work.lookups, SkinAtHand{skin}, weight, out);
    }
  } else if (whole.fate == Fate::kClip) {
    const ClippedTriangle* clipped = clipped_of(work, work.first_item + (int64_t)at.view * job.count + triangle);
    if (!clipped) return Pixel::kLeft;
    if (clipped->count == 0) return Pixel::kBackground;
    weigh(job, *clipped, at.x, at.y, weight);
    finish(job.surface, work.lookups, SkinInMemory{&clipped->skin}, weight, out);
  } else {
    return Pixel::kBackground;
  }
  return Pixel::kDrawn;
}

__device__ __forceinline__ void store_pixel(const Shading& job, uint32_t i, uint32_t color) {
  for (int c = 0; c < job.channels; ++c) job.image[(int64_t)i * job.channels + c] = (uint8_t)(color >> (8 * c));
}

// Stores the colours of a word of the picture, of so many pixels from pixel `first` on, with all lanes.
__device__ __forceinline__ void store_word(const Shading& job, uint32_t first, int pixels, uint32_t color) {
  const int lane = lane_id();
  uint8_t* const bytes = job.image + (int64_t)first * job.channels;
  if (pixels >= kWarp && ((uintptr_t)bytes & 3) == 0) {
    uint32_t* to = reinterpret_cast<uint32_t*>(bytes);
    if (job.channels == 4) {
      to[lane] = color;
    } else {  // the word's 96 bytes, four a lane
      const int from = 4 * lane / 3, skipped = 8 * (4 * lane - 3 * from);
      const uint32_t low = __shfl_sync(kAllLanes, color, from & (kWarp - 1)) & 0xffffff,
                     high = __shfl_sync(kAllLanes, color, (from + 1) & (kWarp - 1));
      if (lane < 3 * kWarp / 4) to[lane] = low >> skipped | high << (24 - skipped);
    }
  } else if (lane < pixels) {
    store_pixel(job, first + lane, color);
  }
}

// A picture of background. A thread takes 16 bytes in turn, most of which lie in one row.
__global__ void __launch_bounds__(kShadeThreads)
    fill_background(const __grid_constant__ Shading job, const __grid_constant__ Work work) {
  constexpr uint32_t kBytes = sizeof(uint4);
  wait_for_previous();
  const uint32_t channels = (uint32_t)job.channels, rows = (uint32_t)job.views * (uint32_t)job.height,
                 bytes = rows * work.width.by * channels;
  const auto color_of = [&](uint32_t pixel) { return __ldg(work.background + work.width.quotient(pixel)); };
  const uint32_t whole = ((uintptr_t)job.image & (kBytes - 1)) == 0 ? bytes / kBytes : 0;
  const uint32_t thread = blockIdx.x * kShadeThreads + threadIdx.x, threads = gridDim.x * kShadeThreads;
  for (uint32_t i = thread; i < whole; i += threads) {
    const uint32_t pixel = i * kBytes / channels, last = (i * kBytes + kBytes - 1) / channels;
    const uint32_t row = work.width.quotient(pixel);
    uint32_t word[4];
    if (work.width.quotient(last) == row) {
      // The channels, over and over, from the one on that the first byte is.
      const uint32_t color = __ldg(work.background + row), shift = 8 * (i * kBytes - pixel * channels);
      const uint64_t twice = channels == 4 ? color : color | (uint64_t)color << 24 | (uint64_t)color << 48;
      for (int k = 0; k < 4; ++k) word[k] = (uint32_t)(twice >> (channels == 4 ? 0 : (shift + 8 * k) % 24));
    } else {
      for (uint32_t k = 0; k < 4; ++k) {
        word[k] = 0;
        for (uint32_t j = 0; j < 4; ++j) {
          const uint32_t at = i * kBytes + 4 * k + j, its = at / channels;
          word[k] |= (color_of(its) >> (8 * (at - its * channels)) & 0xff) << (8 * j);
        }
      }
    }
    reinterpret_cast<uint4*>(job.image)[i] = make_uint4(word[0], word[1], word[2], word[3]);
  }
  for (uint32_t at = whole * kBytes + thread; at < bytes; at += threads) {
    const uint32_t pixel = at / channels;
    job.image[at] = (uint8_t)(color_of(pixel) >> (8 * (at - pixel * channels)));
  }
}

// Word number i of the areas, with all lanes: where the lane's pixel lies, its row among those of all views, and its
// triangle, or -1. False where none of the word lies in the image.
__device__ __forceinline__ bool look_at_word(const Shading& job, const Work& work, uint32_t i, Place* at, uint32_t* row,
                                             int32_t* triangle) {
  const Place word = word_at(work, i);
  *at = {word.view, word.x + lane_id(), word.y};
  *row = word.view * job.height + word.y;
  const bool within = word.x < job.width && word.y < job.height;
  *triangle = within && at->x < job.width ? triangle_of(job, *row * job.width + at->x) : -1;
  return within;
}

// Stores a word of the picture, with all lanes; at: the lane's pixel.
__device__ __forceinline__ void store_word_at(const Shading& job, const Place& at, uint32_t row, uint32_t color) {
  const int x = at.x - lane_id();
  store_word(job, row * job.width + x, job.width - x, color);
}

// Finishes a word, with all lanes.
template <bool kPrepared>
__device__ __forceinline__ void finish_word(const Shading& job, const Work& work, const Place& at, uint32_t row,
                                            int32_t triangle) {
  Pixel pixel = Pixel::kBackground;
  Finished finished;
  uint32_t color = work.background ? work.background[row] : 0;
  if (triangle >= 0) {
    pixel = shade_pixel<kPrepared>(job, work, at, triangle, &finished);
    if (pixel == Pixel::kDrawn && job.image) color = encoded(*work.lookups.codes, finished.linear);
    if (pixel == Pixel::kLeft) *work.any_left = 1;
  }
  if (work.beside) {
    if (pixel == Pixel::kBackground) finish_background(job, at.y, &finished);
    if (pixel != Pixel::kLeft && at.x < job.width) store_beside(job, finished, row * job.width + at.x);
    const unsigned drawn = __ballot_sync(kAllLanes, pixel == Pixel::kDrawn);
    if (work.drawn && lane_id() == 0) work.drawn[row * row_words(job) + at.x / kWarp] = drawn;
  }
  if (job.image) store_word_at(job, at, row, color);
}

// All areas. A warp takes kWords words, which it looks at together, and then goes through those that have a triangle;
// others take no longer than it takes to load them. The device shares out the warps: a word that a model covers takes ten
// times as long.
template <bool kPrepared, int kWords>
__global__ void __launch_bounds__(kShadeThreads, 8)
    shade_all(const __grid_constant__ Shading job, const __grid_constant__ Work work) {
  wait_for_previous();
  const uint32_t start = (blockIdx.x * kShadeWarps + this_warp()) * kWords;
  if (start >= word_count(work)) return;
  Place at;
  uint32_t row;
  int32_t triangle;
  unsigned covered = 0;
#pragma unroll
  for (int j = 0; j < kWords; ++j) {
    if (!look_at_word(job, work, start + j, &at, &row, &triangle)) continue;
    if (work.beside || __any_sync(kAllLanes, triangle >= 0))
      covered |= 1u << j;
    else
      store_word_at(job, at, row, work.background[row]);
  }
  if constexpr (kWords == 1) {
    if (covered) finish_word<kPrepared>(job, work, at, row, triangle);
  } else {
#pragma unroll 1
    for (; covered; covered &= covered - 1) {
      look_at_word(job, work, start + __ffs(covered) - 1, &at, &row, &triangle);
      finish_word<kPrepared>(job, work, at, row, triangle);
    }
  }
}

// The areas that are listed, of prepared triangles and a picture that has its background already. Nearly all of their
// words have a triangle, so that warps may take them in turn.
__global__ void __launch_bounds__(kShadeThreads, 8)
    shade_listed(const __grid_constant__ Shading job, const __grid_constant__ Work work) {
  __shared__ uint32_t numbers[kShadeWarps];  // of the warps' words: no register holds them while a word is finished
  wait_for_previous();
  uint32_t number = blockIdx.x * kShadeWarps + this_warp();
#pragma unroll 1
  while (number < word_count(work)) {
    Place at;
    uint32_t row;
    int32_t triangle;
    look_at_word(job, work, number, &at, &row, &triangle);
    __syncwarp();
    if (lane_id() == 0) numbers[this_warp()] = number;
    __syncwarp();
    if (number + gridDim.x * kShadeWarps >= word_count(work)) let_next_begin();  // this word is the warp's last
    if (__any_sync(kAllLanes, triangle >= 0)) finish_word<true>(job, work, at, row, triangle);
    number = reread(numbers[this_warp()]) + gridDim.x * kShadeWarps;
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
  const uint32_t words = word_count(work);
  for (uint32_t w = blockIdx.x * kShadeWarps + this_warp(); w < words; w += gridDim.x * kShadeWarps) {
    Place at;
    uint32_t row;
    int32_t triangle;
    if (!look_at_word(job, work, w, &at, &row, &triangle)) continue;
    const uint32_t i = row * job.width + at.x;
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
          finish(job.surface, work.lookups, SkinAtHand{held->skin}, weight, &finished);
        } else {
          finish_background(job, at.y, &finished);
        }
        store_beside(job, finished, i);
        if (job.image)
          store_pixel(job, i, drawn ? encoded(*work.lookups.codes, finished.linear) : work.background[row]);
      }
      waiting &= ~__ballot_sync(kAllLanes, mine);
    }
    const unsigned all = __ballot_sync(kAllLanes, drawn);
    if (work.drawn && lane_id() == 0) work.drawn[row * row_words(job) + at.x / kWarp] |= all;
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
        const int64_t line = row * n + y, place = column * n + x, sample = line * job.width + place;
        for (int c = 0; c < 3; ++c) total[c] = total[c] + linear[3 * sample + c];
        covered += drawn[line * row_words(job) + place / kWarp] >> (place % kWarp) & 1;
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
  const int64_t of_view = all_areas(areas_of(job.width, job.height, 1, nullptr)) * kAreaWidth * kAreaHeight;
  return max_of<int64_t>(1, min_of(job.views, kPixelsAtOnce / of_view));
}

bool has_beside(const Shading& job) { return job.albedo || job.normals || job.linear || job.samples > 1; }

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
  const int64_t rows = views_at_once(job) * job.height, pixels = rows * job.width;
  work.width = ShortDivisor((uint32_t)job.width);
  work.triangles = ShortDivisor((uint32_t)max_of(job.count, 1));
  work.beside = has_beside(job);
  work.places =
      (int)min_of<int64_t>(max_of<int64_t>(kAllPlaces / max_of<int64_t>(blocks, 1), kFewestPlaces), kMostPlaces);
  work.lookups.codes = scratch->take<Codes>(1);
  work.lookups.textures = scratch->take<Texture>(job.surface.texture_count);
  work.lookups.lights = scratch->take<PackedLight>(job.surface.lights);
  work.any_left = scratch->take<uint32_t>(1);
  if (job.samples == 1) work.background = scratch->take<uint32_t>(job.views * job.height);
  if (job.samples > 1) work.drawn = scratch->take<uint32_t>(rows * row_words(job));
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

// Calls launch(job, work) for as many views at once as there are words for, until all have been.
template <class Launch>
cudaError_t in_parts(const Shading& given, const Layout& at, const Launch& launch) {
  for (int64_t view = 0; view < given.views; view += views_at_once(given)) {
    Shading job = given;
    Work work = at.work;
    job.views = min_of(views_at_once(given), given.views - view);
    const int64_t pixel = view * given.height * given.width;
    work.areas = areas_of(job.width, job.height, job.views, job.areas);
    work.area_columns = ShortDivisor((uint32_t)work.areas.columns);
    work.area_rows = ShortDivisor((uint32_t)work.areas.rows);
    work.first_item = view * given.count;
    if (work.background) work.background += view * given.height;
    if (work.projected) work.projected += view * given.vertices;
    if (work.prepared) work.prepared += work.first_item;
    job.packed += pixel;
    job.positions += view * given.vertices * 4;
    for (float** image : {&job.albedo, &job.normals, &job.linear})
      if (*image) *image += 3 * pixel;
    job.image += pixel / (given.samples * given.samples) * given.channels;
    BIGTRI_CUDA(launch(job, work));
  }
  return cudaSuccess;
}

}  // namespace

// Where triangles have fewer pixels, marking areas takes longer than it spares.
bool shades_areas(const Shading& job) { return prepares(job) && !has_beside(job) && views_at_once(job) >= job.views; }

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
  BIGTRI_CUDA(launch_first(begin_frame, for_triangles + for_vertices + for_tables, kBeginThreads, 0, stream, job,
                           at.work, thresholds, some_textures(job.surface, 0), (unsigned)for_triangles,
                           (unsigned)for_vertices));
  if (!job.areas) return cudaSuccess;
  return in_parts(job, at, [&](const Shading& part, const Work& work) {
    const int64_t warps = (part.views * part.height * part.width * part.channels + 511) / 512;
    int blocks;
    BIGTRI_CUDA(blocks_of(fill_background, warps, &blocks));
    return launch_next(fill_background, blocks, kShadeThreads, 0, stream, part, work);
  });
}

cudaError_t shade_cuda(const Shading& given, void* memory, cudaStream_t stream) {
  Scratch scratch = {static_cast<char*>(memory)};
  const Layout at = lay_out(given, &scratch);
  return in_parts(given, at, [&](Shading job, const Work& work) {
    uint8_t* const image = job.image;
    if (job.samples > 1) {
      job.image = nullptr;
      if (!job.linear) job.linear = at.linear;
    }
    const int64_t words = all_areas(work.areas) * kWordsOfArea;
    int blocks;
    if (job.areas) {
      BIGTRI_CUDA(blocks_of(shade_listed, words, &blocks));
      BIGTRI_CUDA(launch_next(shade_listed, blocks, kShadeThreads, 0, stream, job, work));
    } else {
      const bool large = work.prepared && (int64_t)job.height * job.width >= kPixelsOfLarge;
      const auto kernel = large           ? shade_all<true, kWordsOfLarge>
                          : work.prepared ? shade_all<true, 1>
                                          : shade_all<false, 1>;
      const int of_block = kShadeWarps * (large ? kWordsOfLarge : 1);
      BIGTRI_CUDA(launch_next(kernel, (words + of_block - 1) / of_block, kShadeThreads, 0, stream, job, work));
    }
    BIGTRI_CUDA(blocks_of(shade_left, words, &blocks));
    BIGTRI_CUDA(launch_next(shade_left, blocks, kShadeThreads, 0, stream, job, work));
    if (job.samples == 1) return cudaSuccess;
    const float* linear = job.linear;
    const int64_t pixels = job.views * job.height * job.width / (job.samples * job.samples);
    job.image = image;
    BIGTRI_CUDA(blocks_of(add_samples, (pixels + kWarp - 1) / kWarp, &blocks));
    return launch_next(add_samples, blocks, kShadeThreads, 0, stream, job, (const Codes*)work.lookups.codes, linear,
                       (const uint32_t*)work.drawn);
  });
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

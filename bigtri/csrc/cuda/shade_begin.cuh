// Before the pixels: tables, triangles that are set up or clipped once, a picture of nothing but background.
#pragma once

#include "shade_work.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr int kFewestPlaces = 4;      // for the clipped triangles of a block of begin_frame
constexpr int kMostPlaces = 32;
constexpr int kAllPlaces = 4096;  // of all blocks, where that gives each its fewest
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
  if (i < job.views * work.height) {
    const int first = (int)(i % work.height) * job.samples;  // row of samples
    Mean mean = {};
    for (int y = 0; y < job.samples; ++y) {
      float light[3];
      background_at(job.surface, first + y, job.height, job.channels, light);
      for (int x = 0; x < job.samples; ++x) mean.add(light, false);
    }
    work.background[i] = mean.encoded(job, (const float*)thresholds);
  }
  if (work.light_behind && i < job.height)
    background_at(job.surface, (int)i, job.height, job.channels, work.light_behind[i].value);
}

// Clips those of a block's triangles that have to be clipped and found a place, a triangle a warp. listed: which of the
// block's they are.
__device__ __forceinline__ void clip_listed(const Shading& job, const Work& work, int64_t block, const uint8_t* listed,
                                            int count, ClipScratch scratch[kBeginWarps]) {
  for (int k = this_warp(); k < count; k += kBeginWarps) {
    const int64_t which = block * kBeginThreads + listed[k], view = work.triangles.quotient_of_any(which);
    clip(job, view, (int32_t)(which - view * job.count), scratch + this_warp(), work.clipped + block * work.places + k);
  }
}

// Looks at every triangle of every view, a thread each. Where they are prepared, the block's warps clip those that have to
// be clipped. Else clip_found does, so that its registers do not keep other blocks, of which there may be thousands, from
// the device.
template <bool kPrepared>
__device__ __forceinline__ void look_at_triangles(const Shading& job, const Work& work) {
  __shared__ uint8_t listed[kMostPlaces];  // threads whose triangles are clipped
  __shared__ int count;
  if (threadIdx.x == 0) count = 0;
  __syncthreads();
  const int64_t first = (int64_t)blockIdx.x * kBeginThreads, item = first + threadIdx.x, all = job.views * job.count;
  if (item < all) {
    const int64_t view = work.triangles.quotient_of_any(item);
    const int32_t triangle = (int32_t)(item - view * job.count);
    const auto place_of = [&](bool clipped) -> int {
      if (!clipped) return 0;
      const int place = atomicAdd(&count, 1);
      if (place >= work.places) return kNoPlace;
      listed[place] = (uint8_t)threadIdx.x;
      return place;
    };
    int place;
    if constexpr (kPrepared) {
      PreparedTriangle made;
      prepare(job, view, triangle, &made);
      place = place_of(made.whole.fate == Fate::kClip);
      made.whole.clipped = place == kNoPlace ? -1 : (int32_t)(blockIdx.x * work.places + place);
      work.prepared[item] = made;
    } else {
      place = place_of(work.flags ? is_clipped_by(job, triangle, work.flags + view * job.vertices)
                                  : is_clipped(job, view, triangle));
    }
    work.place[item] = (uint8_t)place;
  }
  __syncthreads();
  const int placed = min_of(count, work.places);
  if constexpr (kPrepared) {
    __shared__ ClipScratch scratch[kBeginWarps];
    clip_listed(job, work, blockIdx.x, listed, placed, scratch);
  } else {
    if (threadIdx.x == 0) work.found[blockIdx.x] = (uint8_t)placed;
    if ((int)threadIdx.x < placed) work.listed[(int64_t)blockIdx.x * work.places + threadIdx.x] = listed[threadIdx.x];
  }
}

// Looks at triangles whose vertices begin_frame has projected.
__global__ void __launch_bounds__(kBeginThreads, 4)
    find_clipped(const __grid_constant__ Shading job, const __grid_constant__ Work work) {
  wait_for_previous();
  look_at_triangles<false>(job, work);
}

// Clips what was found to be clipped; mostly that is nothing.
__global__ void __launch_bounds__(kBeginThreads, 2)
    clip_found(const __grid_constant__ Shading job, const __grid_constant__ Work work, unsigned triangle_blocks) {
  __shared__ ClipScratch scratch[kBeginWarps];
  wait_for_previous();
  const int64_t step = gridDim.x, at_once = step * kBeginThreads;
  for (int64_t first = blockIdx.x; first < triangle_blocks; first += at_once) {
    const int64_t mine = first + threadIdx.x * step;
    if (!__syncthreads_or(mine < triangle_blocks && work.found[mine] > 0)) continue;
    for (int64_t block = first; block < min_of<int64_t>(first + at_once, triangle_blocks); block += step)
      clip_listed(job, work, block, work.listed + block * work.places, work.found[block], scratch);
  }
}

// The first blocks have triangles, if find_clipped does not look at them, some vertices, the others tables.
template <bool kPrepared>
__global__ void __launch_bounds__(kBeginThreads, kPrepared ? 2 : 4)
    begin_frame(const __grid_constant__ Shading job, const __grid_constant__ Work work,
                const __grid_constant__ Thresholds thresholds, const __grid_constant__ SomeTextures textures,
                unsigned triangle_blocks, unsigned vertex_blocks) {
  const auto item_behind = [](unsigned blocks) { return (int64_t)(blockIdx.x - blocks) * kBeginThreads + threadIdx.x; };
  if (blockIdx.x < triangle_blocks) {
    look_at_triangles<kPrepared>(job, work);
  } else if (blockIdx.x < triangle_blocks + vertex_blocks) {
    const int64_t i = item_behind(triangle_blocks);
    if (i < job.views * job.vertices) {
      const Frame all = frame_of(job, 0);
      float given[4];
      load_vertex(all, i, given);
      const ProjectedVertex vertex = project(all, given);
      work.projected[i] = vertex;
      work.flags[i] = (uint16_t)vertex.flags;
    }
  } else {
    make_tables(job, work, thresholds, textures, item_behind(triangle_blocks + vertex_blocks));
  }
}

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

// A picture of background. A thread takes 16 bytes in turn, most of which lie in one row.
__global__ void __launch_bounds__(kShadeThreads)
    fill_background(const __grid_constant__ Shading job, const __grid_constant__ Work work) {
  constexpr uint32_t kBytes = sizeof(uint4);
  wait_for_previous();
  const uint32_t channels = (uint32_t)job.channels, rows = (uint32_t)job.views * (uint32_t)work.height,
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

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

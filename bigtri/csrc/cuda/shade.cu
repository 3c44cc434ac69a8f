// The shading pass over a visibility buffer on the GPU; docs/numerics.md 18. Mirrors bigtri/reference/shade.py.

#include "shade.h"

#include <cuda_runtime.h>

#include "shade_begin.cuh"
#include "shade_left.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// begin_frame makes tables, clips what has to be clipped, each triangle once, and where a triangle has many pixels on
// average, it sets up all of them; where areas are listed (areas.h), fill_background makes a picture of nothing but
// background. Both may run beside the frame's own kernels. Behind all these shade_listed finishes the areas that are
// listed, or shade_all the whole picture, a pixel a lane, with all of its samples. Pixels of a clipped triangle for which
// there was no memory are left to shade_left, which ends at once where there are none.

// Of a large picture, much of which may be background, a warp takes several words together.
constexpr int kWordsOfLarge = 4;
constexpr int64_t kPixelsOfLarge = 4 << 20;
// Of whole areas that a launch is for, twice what one view can have.
constexpr int kSamplesAtOnce = 1 << 29;
// As many layers as a grid can have.
constexpr int kViewsAtOnce = 65535;

// The areas of some views of the picture.
Areas picture_areas(const Shading& job, int64_t views, void* memory) {
  return areas_of(job.width / job.samples, job.height / job.samples, views, memory);
}

int64_t views_at_once(const Shading& job) {
  const int64_t of_view =
      all_areas(picture_areas(job, 1, nullptr)) * kAreaWidth * kAreaHeight * job.samples * job.samples;
  return max_of<int64_t>(1, min_of(min_of<int64_t>(job.views, kViewsAtOnce), kSamplesAtOnce / of_view));
}

bool has_beside(const Shading& job) { return job.albedo || job.normals || job.linear; }

// Whether every triangle is set up once, whether it is seen or not: where there are many pixels for each, on average. Else
// every pixel sets up its own, of vertices that are projected once where there are many pixels for each of them.
constexpr int64_t kPixelsToPrepare = 24, kPixelsToProject = 4;
bool prepares(const Shading& job) { return job.count * kPixelsToPrepare <= (int64_t)job.height * job.width; }
bool projects(const Shading& job) {
  return !prepares(job) && job.vertices * kPixelsToProject <= (int64_t)job.height * job.width;
}

Work lay_out(const Shading& job, Scratch* scratch) {
  Work work = {};
  const int64_t triangles = job.views * job.count, blocks = (triangles + kBeginThreads - 1) / kBeginThreads;
  work.width = ShortDivisor((uint32_t)(job.width / job.samples));
  work.height = job.height / job.samples;
  work.triangles = ShortDivisor((uint32_t)max_of(job.count, 1));
  work.beside = has_beside(job);
  work.places =
      (int)min_of<int64_t>(max_of<int64_t>(kAllPlaces / max_of<int64_t>(blocks, 1), kFewestPlaces), kMostPlaces);
  work.lookups.codes = scratch->take<Codes>(1);
  work.lookups.textures = scratch->take<Texture>(job.surface.texture_count);
  work.lookups.lights = scratch->take<PackedLight>(job.surface.lights);
  work.any_left = scratch->take<uint32_t>(1);
  work.background = scratch->take<uint32_t>(job.views * work.height);
  if (job.samples > 1) work.light_behind = scratch->take<PackedColor>(job.height);
  if (prepares(job)) work.prepared = scratch->take<PreparedTriangle>(triangles);
  if (projects(job)) {
    work.projected = scratch->take<ProjectedVertex>(job.views * job.vertices);
    work.flags = scratch->take<uint16_t>(job.views * job.vertices);
  }
  work.place = scratch->take<uint8_t>(triangles);
  work.clipped = scratch->take<ClippedTriangle>(blocks * work.places);
  if (!prepares(job)) {
    work.found = scratch->take<uint8_t>(blocks);
    work.listed = scratch->take<uint8_t>(blocks * work.places);
  }
  return work;
}

// Blocks for so many warps of work that is taken in turns.
template <class Kernel>
cudaError_t blocks_of(Kernel kernel, int64_t warps, int* blocks) {
  return blocks_for(kernel, kShadeThreads, 0, (warps + kShadeWarps - 1) / kShadeWarps, 0, blocks);
}

// Calls launch(job, work) for views_at_once() views at a time, until all have been.
template <class Launch>
cudaError_t in_parts(const Shading& given, const Work& all, const Launch& launch) {
  for (int64_t view = 0; view < given.views; view += views_at_once(given)) {
    Shading job = given;
    Work work = all;
    job.views = min_of(views_at_once(given), given.views - view);
    const int64_t pixel = view * given.height * given.width;
    work.areas = picture_areas(job, job.views, job.areas);
    work.area_columns = ShortDivisor((uint32_t)work.areas.columns);
    work.area_rows = ShortDivisor((uint32_t)work.areas.rows);
    work.words = (uint32_t)(all_areas(work.areas) * kWordsOfArea);
    work.first_item = view * given.count;
    work.background += view * work.height;
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
  const Work work = lay_out(job, &scratch);
  for (int first = kTexturesAtOnce; first < job.surface.texture_count; first += kTexturesAtOnce)
    BIGTRI_CUDA(launch_first(put_textures, 1, kTexturesAtOnce, 0, stream, some_textures(job.surface, first),
                             work.lookups.textures));
  Thresholds thresholds;
  for (int i = 0; i < 255; ++i) thresholds.value[i] = job.thresholds[i];
  const auto blocks_of_items = [](int64_t items) { return (items + kBeginThreads - 1) / kBeginThreads; };
  const int64_t triangles = blocks_of_items(job.views * job.count), for_triangles = projects(job) ? 0 : triangles,
                for_vertices = projects(job) ? blocks_of_items(job.views * job.vertices) : 0,
                for_tables = blocks_of_items(max_of(max_of<int64_t>(kSrgbSteps, job.surface.lights),
                                                    max_of<int64_t>(job.views * work.height, job.height)));
  BIGTRI_CUDA(launch_first(prepares(job) ? begin_frame<true> : begin_frame<false>,
                           for_triangles + for_vertices + for_tables, kBeginThreads, 0, stream, job, work, thresholds,
                           some_textures(job.surface, 0), (unsigned)for_triangles, (unsigned)for_vertices));
  if (!prepares(job) && triangles > 0) {
    if (projects(job)) BIGTRI_CUDA(launch_next(find_clipped, triangles, kBeginThreads, 0, stream, job, work));
    int blocks;
    BIGTRI_CUDA(multiprocessors(&blocks));
    blocks = (int)min_of<int64_t>(blocks, triangles);
    BIGTRI_CUDA(launch_next(clip_found, blocks, kBeginThreads, 0, stream, job, work, (unsigned)triangles));
  }
  if (!job.areas) return cudaSuccess;
  return in_parts(job, work, [&](const Shading& part, const Work& its) {
    const int64_t warps = (part.views * its.height * its.width.by * part.channels + 511) / 512;
    int blocks;
    BIGTRI_CUDA(blocks_of(fill_background, warps, &blocks));
    return launch_next(fill_background, blocks, kShadeThreads, 0, stream, part, its);
  });
}

cudaError_t shade_cuda(const Shading& given, void* memory, cudaStream_t stream) {
  Scratch scratch = {static_cast<char*>(memory)};
  return in_parts(given, lay_out(given, &scratch), [&](const Shading& job, const Work& work) {
    const bool several = job.samples > 1;
    int blocks;
    if (job.areas) {
      const auto kernel = several ? shade_listed<true> : shade_listed<false>;
      BIGTRI_CUDA(blocks_of(kernel, work.words, &blocks));
      BIGTRI_CUDA(launch_next(kernel, blocks, kShadeThreads, 0, stream, job, work));
    } else {
      const bool large = !several && !job.fills && work.prepared && (int64_t)job.height * job.width >= kPixelsOfLarge;
      const auto kernel = several         ? work.prepared ? shade_all<true, true, 1> : shade_all<true, false, 1>
                          : large         ? shade_all<false, true, kWordsOfLarge>
                          : work.prepared ? shade_all<false, true, 1>
                                          : shade_all<false, false, 1>;
      const int of_warp = large ? kWordsOfLarge : 1, across = words_across(of_warp) * kWarp,
                down = rows_down(of_warp) * kShadeWarps;
      const dim3 grid((work.width.by + across - 1) / across, (unsigned)((work.height + down - 1) / down),
                      (unsigned)job.views);
      BIGTRI_CUDA(launch_next(kernel, grid, kShadeThreads, 0, stream, job, work));
    }
    // Mostly none is left, and fewer blocks end sooner.
    BIGTRI_CUDA(multiprocessors(&blocks));
    return launch_next(shade_left, blocks, kShadeThreads, 0, stream, job, work);
  });
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

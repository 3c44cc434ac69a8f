// Interpolation over a visibility buffer on the GPU, a thread a pixel.

#include "attributes.h"

#include <cuda_runtime.h>

#include "../core/attributes.h"
#include "launch.cuh"
#include "clip.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// Two kernels: one for the pixels of triangles that are not clipped, which are most and need little, and then one for
// the others, which need hundreds of registers. Each gives a warp 32 pixels at a time, a group; of every group the
// first kernel notes in 32 bits which pixels it has left to the second.

static_assert(kGroup == kWarp, "a lane for each pixel of a group");
constexpr int kWholeWarps = 8;    // of a block
constexpr int kClippedWarps = 4;  // of a block
// Groups that a warp takes one after the other: neighbours share triangles, and one that stays is not clipped again.
constexpr int kRun = 8;

__device__ __forceinline__ Viewport whole_image(const Interpolation& job) {
  return {job.width, job.height, 0, 0, job.width, job.height, kCullNone};
}

__device__ __forceinline__ Frame frame_of(const Interpolation& job, int64_t view) {
  return {job.positions + view * job.position_view, job.triangles, job.vertices, job.count, 1, whole_image(job)};
}

// The lane's pixel of a group.
struct Pixel {
  int x, y;
  int32_t triangle;  // -1: background, or none of the triangles
};

__device__ __forceinline__ Pixel pixel_of(const Interpolation& job, int64_t view, int64_t group) {
  const int pixels = job.height * job.width, i = (int)group * kWarp + lane_id();
  if (i >= pixels) return {0, 0, -1};
  const int64_t packed = job.packed[view * pixels + i], triangle = packed & 0xffffffff;
  const int y = i / job.width;
  return {i - y * job.width, y, packed != kBackground && triangle < job.count ? (int32_t)triangle : -1};
}

// A pixel's weights, and which corner of the triangle each belongs to; corner -1 on the background.
struct Weights {
  float weight[3];
  int corner[3];
};

__device__ __forceinline__ Weights background() { return {{0.0f, 0.0f, 0.0f}, {-1, -1, -1}}; }

// Sets the parent's vertices as they were given, where the rung's attributes need them.
__device__ __forceinline__ void load_given(const Frame& f, int32_t triangle, ParentOf<1>* parent) {
  if constexpr (kUnsnappedWeights) {
    float v[3][4];
    for (int k = 0; k < 3; ++k) load_vertex(f, __ldg(f.triangles + 3 * (int64_t)triangle + k), v[k]);
    set_corners(v, parent);
  }
}

__device__ __forceinline__ void weigh(const Viewport& view, const ParentOf<1>& parent, const Pixel& at, Weights* out) {
  using Number = std::conditional_t<kFloatWeights, float, double>;
  Number e[3], b[3];
  if constexpr (!kUnsnappedWeights)
    for (int k = 0; k < 3; ++k) e[k] = (Number)edge_at(parent.primitive[0], k, at.x, at.y);
  if constexpr (kUnsnappedWeights)
    unsnapped_barycentrics(parent, 0, device_coordinate((Number)at.x, view.width),
                           device_coordinate((Number)(view.height - 1 - at.y), view.height), b);
  else if constexpr (kFloatWeights)
    float_barycentrics(parent, 0, e, b);
  else
    barycentrics(parent, 0, e, b);
  for (int k = 0; k < 3; ++k) {
    out->weight[k] = (float)b[k];
    out->corner[k] = corner_of(parent, 0, k);
  }
}

// What those of the group's pixels that `which` names have in every channel, in the order of memory.
__device__ __forceinline__ void write_interpolated(const float* attributes, int64_t channels, unsigned which,
                                                   const float weight[3], const int32_t vertex[3], float* out) {
  // The lanes go over all pixels' channels a warp's width at a time. Of more channels than that, only that they are
  // more matters to the steps.
  const int narrow = (int)min_of<int64_t>(channels, kWarp + 1);
  const int64_t end = (kWarp - __clz(which)) * channels;
  int pixel = lane_id() / narrow;
  int64_t channel = lane_id() % narrow;
  for (int64_t begin = 0; begin < end; begin += kWarp) {
    float b[3];
    int32_t v[3];
    for (int k = 0; k < 3; ++k) {
      b[k] = __shfl_sync(kAllLanes, weight[k], pixel);
      v[k] = __shfl_sync(kAllLanes, vertex[k], pixel);
    }
    if (pixel < kWarp && (which >> pixel & 1)) {
      float value = 0.0f;
      if (v[0] >= 0) {
        float a[3];
        for (int k = 0; k < 3; ++k) a[k] = __ldg(attributes + channels * v[k] + channel);
        value = interpolate(b, a[0], a[1], a[2]);
      }
      out[begin + lane_id()] = value;
    }
    pixel += kWarp / narrow;
    channel += kWarp % narrow;
    if (channel >= channels) {
      channel -= channels;
      ++pixel;
    }
  }
}

// The same for the weights themselves, in the order of the corners.
__device__ __forceinline__ void write_weights(unsigned which, const Weights& w, float* out) {
  for (int begin = 0; begin < 3 * kWarp; begin += kWarp) {
    const int i = begin + lane_id(), pixel = i / 3;
    float value = 0.0f;
    for (int k = 0; k < 3; ++k) {
      const float b = __shfl_sync(kAllLanes, w.weight[k], pixel);
      const int corner = __shfl_sync(kAllLanes, w.corner[k], pixel);
      if (corner == i - 3 * pixel) value = b;
    }
    if (which >> pixel & 1) out[i] = value;
  }
}

// With all lanes.
__device__ __forceinline__ void write_group(const Interpolation& job, int64_t view, int64_t group, unsigned which,
                                            int32_t triangle, const Weights& w) {
  float* out = job.out + (view * job.height * job.width + group * kWarp) * job.channels;
  if (job.weights) {
    write_weights(which, w, out);
    return;
  }
  int32_t vertex[3];
  for (int k = 0; k < 3; ++k)
    vertex[k] = w.corner[k] < 0 ? -1 : __ldg(job.triangles + 3 * (int64_t)triangle + w.corner[k]);
  write_interpolated(job.attributes + view * job.attribute_view, job.channels, which, w.weight, vertex, out);
}

__global__ void __launch_bounds__(kWholeWarps* kWarp, 4) interpolate_whole(const __grid_constant__ Interpolation job) {
  const int64_t groups = groups_of(job.height, job.width);
  for (int64_t i = (int64_t)blockIdx.x * kWholeWarps + threadIdx.x / kWarp; i < groups * job.batch;
       i += (int64_t)gridDim.x * kWholeWarps) {
    const int64_t view = i / groups, group = i - view * groups;
    const Frame f = frame_of(job, view);
    const Pixel at = pixel_of(job, view, group);
    Weights weights = background();
    ParentOf<1> parent;
    const Primitive& p = parent.primitive[0];
    const Fate fate = at.triangle < 0 ? Fate::kNothing : set_up(f, at.triangle, &parent.primitive[0]);
    if (fate == Fate::kWhole && covers(p, at.x, at.y)) {
      double* w = parent.w[0];
      for (int k = 0; k < 3; ++k)
        w[k] = __ldg(f.positions + 4 * (int64_t)__ldg(f.triangles + 3 * (int64_t)at.triangle + p.order[k]) + 3);
      parent.clipped = false;
      parent.affine = w[0] == w[1] && w[1] == w[2];
      load_given(f, at.triangle, &parent);
      weigh(f.view, parent, at, &weights);
    }
    const unsigned clipped = __ballot_sync(kAllLanes, fate == Fate::kClip);
    if (lane_id() == 0) job.clipped[i] = clipped;
    const unsigned there = __ballot_sync(kAllLanes, group * kWarp + lane_id() < (int64_t)job.height * job.width);
    write_group(job, view, group, there & ~clipped, at.triangle, weights);
  }
}

// The triangle that a warp has clipped; in shared memory.
struct Clipped {
  ClipScratch scratch;
  int count, apex;  // of the polygon
  int first;  // the corner that is slot 0
};

// With all lanes.
__device__ __forceinline__ void clip(const Frame& f, int32_t triangle, Clipped* out) {
  int32_t index[3];
  float v[3][4];
  int count = 0, first = 0;
  if (load_indices(f, triangle, index)) {
    for (int k = 0; k < 3; ++k) load_vertex(f, index[k], v[k]);
    count = clip_polygon(v, f.view.width, f.view.height, &out->scratch);
    first = first_slot(v);
  }
  if (lane_id() == 0) {
    out->count = count;
    out->apex = fan_apex(out->scratch.projected, out->scratch.polygon, count);
    out->first = first;
  }
  __syncwarp();
}

// By the first record of the clipped triangle that covers the pixel.
__device__ __forceinline__ void weigh_clipped(const Frame& f, const Clipped& c, const Pixel& at, Weights* out) {
  ParentOf<1> parent;
  parent.clipped = true;
  parent.affine = false;
  parent.first = c.first;
  const Primitive& p = parent.primitive[0];
  for (int s = 0; s + 2 < c.count; ++s) {
    if (!fan_primitive(c.scratch.projected, c.apex, c.count, s, f.view, &parent.primitive[0])) continue;
    set_fan_places(c.scratch.polygon, c.apex, c.count, s, f.view, p.order, &parent.primitive[0]);
    if (!covers(p, at.x, at.y)) continue;
    set_fan_weights(c.scratch.polygon, c.apex, c.count, s, 0, &parent);
    load_given(f, at.triangle, &parent);
    weigh(f.view, parent, at, out);
    return;
  }
}

__global__ void __launch_bounds__(kClippedWarps* kWarp) interpolate_clipped(const __grid_constant__ Interpolation job) {
  __shared__ Clipped clipped_by[kClippedWarps];
  Clipped& c = clipped_by[threadIdx.x / kWarp];
  const int64_t groups = groups_of(job.height, job.width), runs = (groups + kRun - 1) / kRun;  // of a view
  for (int64_t i = (int64_t)blockIdx.x * kClippedWarps + threadIdx.x / kWarp; i < runs * job.batch;
       i += (int64_t)gridDim.x * kClippedWarps) {
    const int64_t view = i / runs, begin = (i - view * runs) * kRun, end = min_of(begin + kRun, groups);
    const Frame f = frame_of(job, view);
    int32_t held = -1;  // the triangle in c
    for (int64_t group = begin; group < end; ++group) {
      const unsigned clipped = job.clipped[view * groups + group];
      if (clipped == 0) continue;
      const Pixel at = pixel_of(job, view, group);
      Weights w = background();
      for (unsigned waiting = clipped; waiting;) {
        const int32_t next = __shfl_sync(kAllLanes, at.triangle, __ffs(waiting) - 1);
        if (next != held) clip(f, next, &c);
        held = next;
        const bool mine = (clipped >> lane_id() & 1) && at.triangle == next;
        if (mine) weigh_clipped(f, c, at, &w);
        waiting &= ~__ballot_sync(kAllLanes, mine);
      }
      write_group(job, view, group, clipped, at.triangle, w);
    }
  }
}

}  // namespace

cudaError_t interpolate_cuda(const Interpolation& job, cudaStream_t stream) {
  const int64_t groups = groups_of(job.height, job.width) * job.batch;
  BIGTRI_CUDA(launch_first(interpolate_whole, grid_blocks(groups, kWholeWarps), kWholeWarps * kWarp, 0, stream, job));
  return launch_first(interpolate_clipped, grid_blocks(groups, kClippedWarps * kRun), kClippedWarps * kWarp, 0, stream,
                      job);
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

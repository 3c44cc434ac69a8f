// Clipping by a warp: core/clip.h a plane at a time, with a lane for each vertex of the polygon and one for each
// component of a new vertex. A triangle that is clipped is rare, and what it takes is mostly the time until the code
// for it has been fetched. So there is little of it: the exact sum of a component is there once, not four times. Where
// the rung cuts in float32, a lane makes a whole vertex.
#pragma once

#include "setup.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

constexpr bool kCutsInFloat = Rung::kClip == ClipRule::kFloat32;
constexpr int kMostCut = kMaxPolygon / 2;  // edges of a polygon that can cross a plane, each with a new vertex

// Shared memory of a warp that clips.
struct ClipScratch {
  ClipVertex polygon[kMaxPolygon];
  union {
    struct {
      ClipVertex slots[3], made[kMostCut];
    };
    Vertex projected[kMaxPolygon];  // of the finished polygon
  };
};
static_assert(kMaxPolygon <= kWarp, "a lane for every vertex of a polygon");

// The vertices where the plane cuts the polygon edges in `crosses` (bit k: from vertex k to the next), in this order.
__device__ __forceinline__ void make_vertices(const Plane& plane, int plane_index, unsigned crosses, int n,
                                              ClipScratch* s) {
  constexpr int kLanes = 8;  // for a vertex: seven components, and what it lies on
  const int team = lane_id() / kLanes, component = lane_id() % kLanes;
#pragma unroll 1
  for (int first = 0; first < __popc(crosses); first += kWarp / kLanes) {
    unsigned mine = crosses;
    for (int skip = first + team; skip > 0; --skip) mine &= mine - 1;
    if (!mine) continue;
    const int k = __ffs(mine) - 1;
    const ClipVertex &a = s->polygon[k], &b = s->polygon[k + 1 == n ? 0 : k + 1];
    const Cut cut = cut_of(plane, s->slots, a, b);
    ClipVertex& made = s->made[first + team];
    if (component < 4) {
      made.position[component] = cut_position(plane, cut, component);
    } else if (component < 7) {
      made.weights[component - 4] = cut_weight(cut, component - 4);
    } else {
      made.edges = a.edges & b.edges;
      made.made = cut_made(plane_index, a, b);
    }
  }
}

// Clips a triangle with all lanes. Returns the number of vertices, projected too, or 0 if nothing is left.
__device__ __forceinline__ int clip_polygon(const float v[3][4], int width, int height, ClipScratch* s) {
  const int lane = lane_id();
  uint32_t outside = 0;
  for (int k = 0; k < 3; ++k) outside |= vertex_flags(v[k], width, height) & kOutsideMask;
  __syncwarp();
  if (lane < 3) s->polygon[lane] = s->slots[lane] = make_slot(v, first_slot(v), lane);
  int n = 3;
#pragma unroll 1
  for (int k = 0; k < kPlanes; ++k) {
    if (!(outside >> k & 1)) continue;
    const Plane plane = clip_plane(k, width, height);
    __syncwarp();
    bool inside = false, crosses = false;
    ClipVertex kept, cut;
    if (lane < n) {
      kept = s->polygon[lane];
      const ClipVertex& next = s->polygon[lane + 1 == n ? 0 : lane + 1];
      if constexpr (kCutsInFloat) {
        const float here = float_distance(plane, kept.position), there = float_distance(plane, next.position);
        inside = here >= 0;
        crosses = inside != (there >= 0);
        if (crosses) cut = cut_edge_in_float(k, kept, next, here, there);
      } else {
        inside = plane_distance(plane, kept.position) >= 0;
        crosses = inside != (plane_distance(plane, next.position) >= 0);
      }
    }
    const unsigned all_inside = __ballot_sync(kAllLanes, inside), all_crosses = __ballot_sync(kAllLanes, crosses);
    if constexpr (!kCutsInFloat) make_vertices(plane, k, all_crosses, n, s);
    __syncwarp();  // all have read the polygon, and the new vertices are there
    const int number = __popc(all_crosses & lanes_below());
    int at = __popc(all_inside & lanes_below()) + number;
    if (inside) s->polygon[at++] = kept;
    if (crosses) s->polygon[at] = kCutsInFloat ? cut : s->made[number];
    n = __popc(all_inside) + __popc(all_crosses);
  }
  __syncwarp();
  if (n < 3) return 0;
  if (__any_sync(kAllLanes, lane < n && !(s->polygon[lane].position[3] > 0))) return 0;
  if constexpr (kCutsInFloat) {
    bool finite = true;
    for (int c = 0; c < 4; ++c) finite &= lane >= n || is_finite((float)s->polygon[lane].position[c]);
    if (__any_sync(kAllLanes, !finite)) return 0;
  }
  if (lane < n) s->projected[lane] = project_clipped(s->polygon[lane], width, height);
  __syncwarp();
  return n;
}

// Clips triangle t of a view with all lanes. Lane s gets sub-triangle s; false where it has no pixels.
__device__ __noinline__ bool clip_part(const Frame& f, int32_t view, int32_t t, ClipScratch* s, Primitive* out) {
  int32_t index[3];
  if (!load_indices(f, t, index)) return false;
  float v[3][4];
  for (int k = 0; k < 3; ++k) load_vertex(f, view * (f.view_stride / 4) + index[k], v[k]);
  const int n = clip_polygon(v, f.view.width, f.view.height, s);
  if (lane_id() > n - 3) return false;
  const int apex = fan_apex(s->projected, s->polygon, n);
  if (!fan_primitive(s->projected, apex, n, lane_id(), f.view, out)) return false;
  set_fan_places(s->polygon, apex, n, lane_id(), f.view, out->order, out);
  return true;
}

}  // namespace
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// The shading pass over a visibility buffer on the GPU; docs/numerics.md 18. Mirrors bigtri/reference/shade.py.

#include "shade.h"

#include <cuda_runtime.h>

#include "../core/attributes.h"
#include "clip.cuh"
#include "launch.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

// One kernel finishes the pixels of triangles that are not clipped, which are most. It notes which pixels it leaves, and
// enters their triangles into a table. The next one clips what is in the table, each triangle once, and the last one
// finishes the pixels that were left; both end at once where there is nothing to do. Where several samples make a pixel
// they all work on samples, and one more kernel adds those up.
//
// A warp of the first kernel takes 128 pixels, a group. Their triangles come in runs along the row. The lanes set up the
// run of a lane each, so that a triangle is set up once for all pixels of its run, and then finish the pixels that are
// covered, one a lane, whatever runs they are of.

constexpr int kShadeWarps = 4;  // of a block, in all kernels
constexpr int kShadeThreads = kShadeWarps * kWarp;
constexpr int kEach = 4;                  // pixels that a lane loads
constexpr int kPixels = kEach * kWarp;    // of a group
constexpr int kWords = kPixels / kWarp;   // of a group, a bit a pixel
constexpr int kRuns = 32;                 // that a warp has set up at a time
constexpr int kWordsAtOnce = 8;           // that a warp of the last kernel takes
constexpr int kTextures = 16;             // that go with a launch; of more there is a table in memory
constexpr int kListed = 512;              // clipped triangles that the table has room for, a power of two
constexpr int kProbes = 16;               // places of the table that a triangle may have
constexpr uint64_t kFree = ~0ull;         // a place of the table without a triangle

static_assert(kRuns == kWarp, "a lane sets up a run");

// Interpolated channels of a fragment: uv, vertex colour, normal.
enum { kUv = 0, kColor = 2, kNormal = 5, kChannels = 8 };

// Bits of Skin::bits beside those of LookBit, which stay where the surface has the data.
enum : int32_t {
  kSmoothNormal = 1 << 8,
  kFaceNormal = 1 << 9,
  kAffine = 1 << 10,
  kNotDrawn = 1 << 11,
  kIsClipped = 1 << 12
};

// What a triangle looks like.
struct Skin {
  float value[kChannels][3];  // at the corners that weights 0, 1, 2 belong to; of a face normal only [][0]
  float base[3];              // colour of the material
  float facing;               // -1: the normal is turned round; else 1
  int32_t bits;
  int32_t texture;  // -1: none
  int32_t unused[2];
};

// What edge values along a row are computed in, exactly: float64 holds integers below 2^53.
using EdgeAlongRow = std::conditional_t<Rung::kWideEdges, int64_t, double>;

// Pixels of a row of one triangle that is not clipped. e_k at the run's pixel i is start[k] + step[k] * i.
struct alignas(16) Run : Corners {  // in the order of the weights
  EdgeAlongRow start[3], step[3], down[3];
  Divisor area, w[3];
  Skin skin;
};

// A triangle that has been clipped: its records, in fan order.
struct ClippedFan : Corners {  // in the order of the slots
  struct Sub {
    Primitive primitive;
    double w[3], weights[3][3];
  };
  int count;  // records
  int first;  // the corner that is slot 0
  Sub sub[kMaxSubTriangles];
};

// What a frame looks up, made once by the kernel before it. It stays in the caches.
struct Codes {
  SrgbTable encode;
  float decoded[256];  // what 8-bit codes of textures stand for
};

// sRGB thresholds on their way to memory.
struct Thresholds {
  float value[255];
};

// Memory that the kernels work with.
struct Work {
  uint64_t* keys;      // [kListed]: view << 32 | triangle of the clipped triangles, or kFree
  uint64_t* any;       // [1]: kFree if nothing is clipped. After the keys
  Codes* codes;
  uint32_t* background;  // [H / samples]: of each row of the picture, the lowest byte first
  ClippedFan* records;    // [kListed]
  Run* runs;           // [views, T], where triangles are set up before they are met; else null
  uint32_t* clipped;   // a bit for each pixel: whether its triangle is clipped
  uint32_t* drawn;     // the same: whether it is not the background; null where nobody asks
  const Texture* many;  // all textures, where there are more than kTextures; else null
  Texture few[kTextures];
};

// The textures of a launch on their way to memory.
constexpr int kTexturesAtOnce = 128;
struct SomeTextures {
  Texture texture[kTexturesAtOnce];
};

__device__ __forceinline__ int64_t warp_in_grid() { return (int64_t)blockIdx.x * kShadeWarps + this_warp(); }
__device__ __forceinline__ int64_t warps_of_grid() { return (int64_t)gridDim.x * kShadeWarps; }

__device__ __forceinline__ Frame frame_of(const Shading& job, int64_t view) {
  const Viewport whole = {job.width, job.height, 0, 0, job.width, job.height, kCullNone};
  return {job.positions + view * job.vertices * 4, job.triangles, job.vertices, job.count, 1, whole};
}

// Where a pixel lies, counted from pixel `rest` of a view on.
struct Place {
  int64_t view;
  int x, y;
};
__device__ __forceinline__ Place place_of(const Shading& job, int64_t view, uint32_t rest) {
  const uint32_t pixels = (uint32_t)(job.height * job.width);
  if (rest >= pixels) {
    view += rest / pixels;
    rest %= pixels;
  }
  const int y = (int)(rest / (uint32_t)job.width);
  return {view, (int)rest - y * job.width, y};
}

// --- A fragment: what it looks like

// Fills a triangle's skin. vertex: in the order that weights are in; they name vertices. False if its material does not
// exist.
__device__ __forceinline__ bool load_skin(const Shading& job, int32_t triangle, const int32_t vertex[3], bool back,
                                          Skin* out) {
  const Surface& s = job.surface;
  const int32_t material = __ldg(s.material + triangle);
  if (material < 0 || material >= s.materials) return false;
  const int32_t asked = __ldg(&s.looks[material].bits), texture = __ldg(&s.looks[material].texture);
  int32_t bits = asked & (kLookNearest | kLookClamp);
  for (int c = 0; c < 3; ++c) out->base[c] = __ldg(s.base_colors + 3 * (int64_t)material + c);
  out->texture = s.uvs && texture >= 0 && texture < s.texture_count ? texture : -1;
  if (out->texture >= 0)
    for (int k = 0; k < 3; ++k)
      for (int c = 0; c < 2; ++c) out->value[kUv + c][k] = __ldg(s.uvs + 2 * (int64_t)vertex[k] + c);
  if (s.colors && (asked & kLookVertexColors)) {
    bits |= kLookVertexColors;
    for (int k = 0; k < 3; ++k)
      for (int c = 0; c < 3; ++c) out->value[kColor + c][k] = __ldg(s.colors + 3 * (int64_t)vertex[k] + c);
  }
  if (s.normals && (!s.face_normals || (asked & kLookSmooth))) {
    bits |= kSmoothNormal;
    for (int k = 0; k < 3; ++k)
      for (int c = 0; c < 3; ++c) out->value[kNormal + c][k] = __ldg(s.normals + 3 * (int64_t)vertex[k] + c);
  } else if (s.face_normals) {
    bits |= kFaceNormal;
    for (int c = 0; c < 3; ++c) out->value[kNormal + c][0] = __ldg(s.face_normals + 3 * (int64_t)triangle + c);
  }
  out->facing = back && (asked & kLookTwoSided) ? -1.0f : 1.0f;
  out->bits = bits;
  return true;
}

// Codes of 16 bits are decoded where they are read: a table of all would take 256 KiB. Not inlined, because few textures
// have them and the code is long.
__device__ __noinline__ void sample_wide(const Texture& t, float u, float v, Filter filter, Wrap wrap, float out[3]) {
  sample((const uint16_t*)t.texels, t.height, t.width, 3, u, v, filter, wrap, out);
}

__device__ __forceinline__ void look_up(const Work& work, const Codes& codes, const Skin& skin, float u, float v,
                                        float out[3]) {
  const Texture& t = work.many ? work.many[skin.texture] : work.few[skin.texture];
  const Filter filter = skin.bits & kLookNearest ? Filter::kNearest : Filter::kBilinear;
  const Wrap wrap = skin.bits & kLookClamp ? Wrap::kClamp : Wrap::kRepeat;
  if (t.kind == Texels::kCodes8)
    sample(CodedTexels<uint8_t>{(const uint8_t*)t.texels, codes.decoded}, t.height, t.width, 3, u, v, filter, wrap,
           out);
  else if (t.kind == Texels::kLinear)
    sample((const float*)t.texels, t.height, t.width, 3, u, v, filter, wrap, out);
  else
    sample_wide(t, u, v, filter, wrap, out);
}

// Finishes pixel i of the buffer, which has these weights: writes what is wanted of it, but for the picture. linear: its
// colour.
__device__ __forceinline__ void finish(const Shading& job, const Work& work, const Codes& codes, const Skin& skin,
                                       const float weight[3], int64_t i, float linear[3]) {
  const Surface& s = job.surface;
  const auto at = [&](int c) { return interpolate(weight, skin.value[c][0], skin.value[c][1], skin.value[c][2]); };
  float albedo[3], normal[3];
  for (int c = 0; c < 3; ++c) albedo[c] = skin.base[c];
  if (skin.texture >= 0) {
    float texel[3];
    look_up(work, codes, skin, at(kUv), at(kUv + 1), texel);
    for (int c = 0; c < 3; ++c) albedo[c] = albedo[c] * texel[c];
  }
  if (skin.bits & kLookVertexColors)
    for (int c = 0; c < 3; ++c) albedo[c] = albedo[c] * at(kColor + c);
  for (int c = 0; c < 3; ++c) {
    const float v = skin.bits & kSmoothNormal ? at(kNormal + c)
                    : skin.bits & kFaceNormal ? skin.value[kNormal + c][0]
                                              : 0.0f;
    normal[c] = v * skin.facing;
  }
  lambert(normal, albedo, s.ambient, s.light_directions, s.light_colors, s.lights, linear);
  for (int c = 0; c < 3; ++c) {
    if (job.albedo) job.albedo[3 * i + c] = albedo[c];
    if (job.normals) job.normals[3 * i + c] = normal[c];
    if (job.linear) job.linear[3 * i + c] = linear[c];
  }
}

__device__ __forceinline__ void encode(const Codes& codes, int channels, const float linear[3], uint8_t* pixel) {
  for (int c = 0; c < 3; ++c) pixel[c] = encode_srgb(linear[c], codes.encode);
  if (channels == 4) pixel[3] = 255;
}

// --- The table of clipped triangles

__device__ __forceinline__ uint64_t key_of(int64_t view, int32_t triangle) {
  return (uint64_t)view << 32 | (uint32_t)triangle;
}
// The place of the table that is tried n-th.
__device__ __forceinline__ int place_in_table(uint64_t key, int n) {
  return (int)(((key * 0x9e3779b97f4a7c15ull) >> 32) + n) & (kListed - 1);
}

// Enters a triangle, unless all its places are taken.
__device__ __forceinline__ void list_clipped(const Work& work, uint64_t key) {
  *work.any = 0;
  for (int n = 0; n < kProbes; ++n) {
    unsigned long long* place = reinterpret_cast<unsigned long long*>(work.keys + place_in_table(key, n));
    unsigned long long found = *place;
    if (found == kFree) found = atomicCAS(place, (unsigned long long)kFree, (unsigned long long)key);
    if (found == kFree || found == key) return;
  }
}

// The record of a triangle, or null if it has none.
__device__ __forceinline__ const ClippedFan* find_clipped(const Work& work, uint64_t key) {
  for (int n = 0; n < kProbes; ++n) {
    const int place = place_in_table(key, n);
    if (work.keys[place] == key) return work.records + place;
  }
  return nullptr;
}

// --- Triangles that are not clipped

// Shared memory of a warp.
struct Room {
  Run run[kRuns];
  uint32_t image[kPixels];    // the group's part of the picture
  int32_t triangle[kPixels];  // of each run
  uint8_t first[kPixels];     // of each run: its first pixel in the group
  uint8_t begin[kPixels];     // of each run: how many pixels runs before it have
  uint8_t run_of[kPixels];    // of each pixel that is in a run, one after the other
  uint32_t clipped[kWords];
  uint32_t drawn[kWords];
};

// Keeps a triangle's vertices as they were given, in an order, where the rung's attributes need them.
template <bool kHas>
__device__ __forceinline__ void set_given(const float v[3][4], const int32_t order[3], CornersOf<kHas>* out) {
  if constexpr (kHas)
    for (int k = 0; k < 3; ++k)
      for (int i = 0; i < 4; ++i) out->given[k][i] = v[order[k]][i];
}

// Sets up a run from pixel (x, y) on. kWhole if and only if it is to be drawn.
__device__ __forceinline__ Fate set_up_run(const Shading& job, const Place& at, int32_t triangle, Run* out) {
  const Frame f = frame_of(job, at.view);
  int32_t index[3];
  if (!load_indices(f, triangle, index)) return Fate::kDropped;
  float corner[3][4];
  for (int k = 0; k < 3; ++k) load_vertex(f, index[k], corner[k]);
  Vertex v[3];
  for (int k = 0; k < 3; ++k) v[k] = project_vertex(corner[k], job.width, job.height);
  Primitive p;
  const Fate fate = assemble(f, v, &p);
  if (fate != Fate::kWhole) return fate;
  const bool back = job.surface.two_sided && is_back(corner[0], corner[1], corner[2]);
  int32_t vertex[3];
  for (int k = 0; k < 3; ++k) vertex[k] = pick(index, p.order[k]);
  if (!load_skin(job, triangle, vertex, back, &out->skin)) return Fate::kNothing;
  const float w[3] = {corner[0][3], corner[1][3], corner[2][3]};
  for (int k = 0; k < 3; ++k) {
    const Edge edge = edge_of(p.x, p.y, k);
    out->start[k] = (EdgeAlongRow)edge_value(edge, pixel_centre(at.x), pixel_centre(at.y));
    out->step[k] = -(EdgeAlongRow)kSubpixel * edge.dy;
    out->down[k] = (EdgeAlongRow)kSubpixel * edge.dx;
    out->w[k] = divisor(pick(w, p.order[k]));
  }
  out->area = divisor((double)p.area);
  set_given(corner, p.order, out);
  if (w[0] == w[1] && w[1] == w[2]) out->skin.bits |= kAffine;
  return Fate::kWhole;
}

// By the vertices as they were given, where that is the rung's rule: the weights of a view's pixel (x, y).
template <bool kHas, class D>
__device__ __forceinline__ void weigh_unsnapped(const Shading& job, const CornersOf<kHas>& corners, int x, int y,
                                                D b[3]) {
  if constexpr (kHas)
    unsnapped_weights(corners.given, device_coordinate((D)x, job.width),
                      device_coordinate((double)(job.height - 1 - y), job.height), b);
}

// The weights of pixel `at`, which lies i to the right and j below the one that the run was set up from. i, j: not
// negative.
__device__ __forceinline__ void weigh(const Shading& job, const Run& run, int i, int j, const Place& at,
                                      float weight[3]) {
  using Number = std::conditional_t<kFloatWeights, float, double>;
  const bool affine = run.skin.bits & kAffine;
  Number e[3], b[3];
  for (int k = 0; k < 3 && !kUnsnappedWeights; ++k) {
    if constexpr (Rung::kWideEdges)
      e[k] = (Number)(double)(run.start[k] + run.step[k] * i + run.down[k] * j);
    else
      e[k] = (Number)((run.start[k] + run.step[k] * exact_double(i)) + run.down[k] * exact_double(j));
  }
  if constexpr (kUnsnappedWeights) {
    weigh_unsnapped(job, run, at.x, at.y, b);
  } else if constexpr (kFloatWeights) {
    const double w[3] = {run.w[0].value, run.w[1].value, run.w[2].value};
    whole_float_barycentrics((float)run.area.value, w, affine, e, b);
  } else {
    whole_barycentrics(run.area, run.w, affine, e, b);
  }
  for (int k = 0; k < 3; ++k) weight[k] = (float)b[k];
}

// The triangles of the lane's pixels of a group; -1: background, or none of the triangles.
__device__ __forceinline__ void load_group(const Shading& job, int64_t group, int64_t pixels, int32_t id[kEach]) {
  const int64_t first = group * kPixels + lane_id() * kEach;
  int64_t packed[kEach];
  if (first + kEach <= pixels && ((uintptr_t)job.packed & 15) == 0) {
    const longlong2* from = reinterpret_cast<const longlong2*>(job.packed + first);
    for (int j = 0; j < kEach; j += 2) {
      const longlong2 two = from[j / 2];
      packed[j] = two.x, packed[j + 1] = two.y;
    }
  } else {
    for (int j = 0; j < kEach; ++j) packed[j] = first + j < pixels ? job.packed[first + j] : kBackground;
  }
  for (int j = 0; j < kEach; ++j) {
    const uint32_t triangle = (uint32_t)packed[j];
    id[j] = triangle < (uint32_t)job.count ? (int32_t)triangle : -1;
  }
}

// The lane's pixels of the background, from place `at` on: into the group's part of the picture, and into what else is
// wanted. A picture has a sample a pixel here.
__device__ __forceinline__ void put_background(const Shading& job, const Work& work, Place at, int64_t first,
                                               int64_t pixels, uint32_t* image) {
  const int lane = lane_id();
  if (job.image) {
    uint32_t color[kEach];
    color[0] = __ldg(work.background + at.y);
    Place next = at;
    for (int j = 1; j < kEach; ++j) {
      color[j] = color[j - 1];
      if (++next.x == job.width) {
        next.x = 0;
        next.y = next.y + 1 == job.height ? 0 : next.y + 1;
        color[j] = __ldg(work.background + next.y);
      }
    }
    if (job.channels == 4) {
      for (int j = 0; j < kEach; ++j) image[kEach * lane + j] = color[j];
    } else {
      uint32_t* to = image + 3 * lane;
      to[0] = color[0] | color[1] << 24;
      to[1] = color[1] >> 8 | color[2] << 16;
      to[2] = color[2] >> 16 | color[3] << 8;
    }
  }
  if (!job.albedo && !job.normals && !job.linear) return;
  for (int j = 0; j < kEach && first + j < pixels; ++j) {
    float linear[3];
    background_at(job.surface, at.y, job.height, job.channels, linear);
    for (int c = 0; c < 3; ++c) {
      const int64_t i = 3 * (first + j) + c;
      if (job.albedo) job.albedo[i] = 0.0f;
      if (job.normals) job.normals[i] = 0.0f;
      if (job.linear) job.linear[i] = linear[c];
    }
    if (++at.x == job.width) at.x = 0, at.y = at.y + 1 == job.height ? 0 : at.y + 1;
  }
}

// A group's part of the picture goes to memory, with all lanes.
__device__ __forceinline__ void store_image(const Shading& job, int64_t group, int64_t pixels, const uint32_t* image) {
  if (!job.image) return;
  uint8_t* to = job.image + group * kPixels * job.channels;
  if ((group + 1) * kPixels <= pixels && ((uintptr_t)job.image & 3) == 0) {
    for (int i = 0; i < job.channels; ++i)
      reinterpret_cast<uint32_t*>(to)[i * kWarp + lane_id()] = image[i * kWarp + lane_id()];
  } else {
    const int bytes = (int)min_of<int64_t>(pixels - group * kPixels, kPixels) * job.channels;
    for (int i = lane_id(); i < bytes; i += kWarp) to[i] = reinterpret_cast<const uint8_t*>(image)[i];
  }
}

// Sets the bits [begin, begin + n) of a group.
__device__ __forceinline__ void set_bits(uint32_t* words, int begin, int n) {
  for (int k = begin / kWarp; k <= (begin + n - 1) / kWarp; ++k) {
    const int low = max_of(begin - k * kWarp, 0), high = min_of(begin + n - k * kWarp, kWarp);
    atomicOr(words + k, (high == kWarp ? ~0u : (1u << high) - 1) & ~((1u << low) - 1));
  }
}

// Finds the runs of a group, with all lanes. x: of the lane's first pixel. Returns how many there are, and how many
// pixels they have.
__device__ __forceinline__ int2 find_runs(const Shading& job, const int32_t id[kEach], int x, Room* room) {
  const int lane = lane_id();
  int32_t before = __shfl_up_sync(kAllLanes, id[kEach - 1], 1);
  if (lane == 0) before = -1;
  bool starts[kEach];
  int counts = 0;  // runs << 16 | pixels
  for (int j = 0; j < kEach; ++j) {
    starts[j] = id[j] >= 0 && (id[j] != before || x == 0);
    counts += (starts[j] ? 1 << 16 : 0) + (id[j] >= 0 ? 1 : 0);
    before = id[j];
    if (++x == job.width) x = 0;
  }
  const int up_to = warp_sum_up_to(counts), all = __shfl_sync(kAllLanes, up_to, kWarp - 1);
  int run = ((up_to - counts) >> 16) - 1, pixel = (up_to - counts) & 0xffff;
  for (int j = 0; j < kEach; ++j) {
    if (starts[j]) {
      ++run;
      room->triangle[run] = id[j];
      room->first[run] = (uint8_t)(kEach * lane + j);
      room->begin[run] = (uint8_t)pixel;
    }
    if (id[j] >= 0) room->run_of[pixel++] = (uint8_t)run;
  }
  return {all >> 16, all & 0xffff};
}

// A warp takes one group: the groups of a model lie side by side in the picture and take a hundred times as long as those
// beside it, so that it is the device that has to share them out.
__global__ void __launch_bounds__(kShadeThreads, 6)
    shade_whole(const __grid_constant__ Shading job, const __grid_constant__ Work work) {
  __shared__ Room rooms[kShadeWarps];
  wait_for_previous();
  Room* room = rooms + this_warp();
  const Codes& codes = *work.codes;
  const int lane = lane_id(), of_view = job.height * job.width;
  const int64_t pixels = job.views * of_view, group = warp_in_grid(), start = group * kPixels;
  if (start >= pixels) return;
  // 32 bits for all but the largest batches: a division of 64 takes a hundred instructions.
  const int64_t view = pixels <= UINT32_MAX ? (uint32_t)start / (uint32_t)of_view : start / of_view;
  const int rest = (int)(start - view * of_view);  // the group's first pixel within its view
  int32_t id[kEach];
  load_group(job, group, pixels, id);
  bool covered = false, open = false;
  for (int j = 0; j < kEach; ++j) {
    covered = covered || id[j] >= 0;
    open = open || id[j] < 0;
  }
  const Place mine = place_of(job, view, rest + kEach * lane);
  const bool any_covered = __any_sync(kAllLanes, covered);
  if (__any_sync(kAllLanes, open)) put_background(job, work, mine, start + kEach * lane, pixels, room->image);
  if (lane < kWords) room->clipped[lane] = room->drawn[lane] = 0;
  if (any_covered) {
    const int2 found = find_runs(job, id, mine.x, room);
    __syncwarp();
    for (int base = 0; base < found.x; base += kRuns) {
      const int r = base + lane;
      if (r < found.x) {
        const int first = room->first[r], n = (r + 1 < found.x ? room->begin[r + 1] : found.y) - room->begin[r];
        const int32_t triangle = room->triangle[r];
        const Place at = place_of(job, view, rest + first);
        const Fate fate = set_up_run(job, at, triangle, &room->run[lane]);
        if (fate != Fate::kWhole) room->run[lane].skin.bits = kNotDrawn;
        if (fate == Fate::kClip) {
          list_clipped(work, key_of(at.view, triangle));
          set_bits(room->clipped, first, n);
        }
        if (work.drawn && fate == Fate::kWhole) set_bits(room->drawn, first, n);
      }
      __syncwarp();
      const int end = base + kRuns < found.x ? room->begin[base + kRuns] : found.y;
      for (int c = room->begin[base] + lane; c < end; c += kWarp) {
        const int k = room->run_of[c], i = c - room->begin[k];
        const Run& run = room->run[k - base];
        if (run.skin.bits & kNotDrawn) continue;
        float weight[3], linear[3];
        const int pixel = room->first[k] + i;
        weigh(job, run, i, 0, kUnsnappedWeights ? place_of(job, view, rest + pixel) : Place{}, weight);
        finish(job, work, codes, run.skin, weight, start + pixel, linear);
        if (job.image)
          encode(codes, job.channels, linear, reinterpret_cast<uint8_t*>(room->image) + job.channels * pixel);
      }
      __syncwarp();
    }
  } else {
    __syncwarp();
  }
  if (lane < kWords) {
    work.clipped[group * kWords + lane] = room->clipped[lane];
    if (work.drawn) work.drawn[group * kWords + lane] = room->drawn[lane];
  }
  store_image(job, group, pixels, room->image);
}

// --- The same, of triangles that are set up before the frame

// Empties the table of clipped triangles, and makes what the frame looks up: a thread an item of each. Sets up every
// triangle of every view from pixel (0, 0) on, where they are set up before they are met.
__global__ void __launch_bounds__(kShadeThreads)
    begin_frame(const __grid_constant__ Shading job, const __grid_constant__ Thresholds thresholds,
                const __grid_constant__ Work work) {
  __shared__ float shared[255];
  for (int k = threadIdx.x; k < 255; k += kShadeThreads) shared[k] = thresholds.value[k];
  __syncthreads();
  const int64_t item = (int64_t)blockIdx.x * kShadeThreads + threadIdx.x;
  if (work.runs && item < job.views * job.count) {
    const int64_t view = item / job.count;
    Run run;
    const Fate fate = set_up_run(job, {view, 0, 0}, (int32_t)(item - view * job.count), &run);
    if (fate != Fate::kWhole) run.skin.bits = fate == Fate::kClip ? kNotDrawn | kIsClipped : kNotDrawn;
    work.runs[item] = run;
  }
  const int n = job.samples, i = (int)min_of<int64_t>(item, INT32_MAX);
  Codes* codes = work.codes;
  if (i <= kListed) work.keys[i] = kFree;
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

// Shared memory of a warp.
struct SmallRoom {
  uint32_t image[kPixels];    // the group's part of the picture
  int32_t triangle[kPixels];  // of each pixel; -1: background
};

// A warp takes one group, as in shade_whole.
__global__ void __launch_bounds__(kShadeThreads)
    shade_prepared(const __grid_constant__ Shading job, const __grid_constant__ Work work) {
  __shared__ SmallRoom rooms[kShadeWarps];
  wait_for_previous();
  SmallRoom* room = rooms + this_warp();
  const Codes& codes = *work.codes;
  const int lane = lane_id(), of_view = job.height * job.width;
  const int64_t pixels = job.views * of_view, group = warp_in_grid(), start = group * kPixels;
  if (start >= pixels) return;
  const int64_t view = pixels <= UINT32_MAX ? (uint32_t)start / (uint32_t)of_view : start / of_view;
  const int rest = (int)(start - view * of_view);
  int32_t id[kEach];
  load_group(job, group, pixels, id);
  bool covered = false, open = false;
  for (int j = 0; j < kEach; ++j) {
    covered = covered || id[j] >= 0;
    open = open || id[j] < 0;
    room->triangle[kEach * lane + j] = id[j];
  }
  const bool any_covered = __any_sync(kAllLanes, covered);
  if (__any_sync(kAllLanes, open))
    put_background(job, work, place_of(job, view, rest + kEach * lane), start + kEach * lane, pixels, room->image);
  __syncwarp();
  if (!any_covered && lane < kWords) {
    work.clipped[group * kWords + lane] = 0;
    if (work.drawn) work.drawn[group * kWords + lane] = 0;
  }
  for (int j = 0; any_covered && j < kWords; ++j) {
    const int pixel = j * kWarp + lane;
    const int32_t triangle = room->triangle[pixel];
    uint32_t bits = kNotDrawn;
    if (triangle >= 0) {
      const Place at = place_of(job, view, rest + pixel);
      const Run& run = work.runs[at.view * job.count + triangle];
      bits = run.skin.bits;
      if (!(bits & kNotDrawn)) {
        float weight[3], linear[3];
        weigh(job, run, at.x, at.y, at, weight);
        finish(job, work, codes, run.skin, weight, start + pixel, linear);
        if (job.image)
          encode(codes, job.channels, linear, reinterpret_cast<uint8_t*>(room->image) + job.channels * pixel);
      } else if (bits & kIsClipped) {
        list_clipped(work, key_of(at.view, triangle));
      }
    }
    const unsigned clipped = __ballot_sync(kAllLanes, bits & kIsClipped),
                   drawn = __ballot_sync(kAllLanes, !(bits & kNotDrawn));
    if (lane == 0) {
      work.clipped[group * kWords + j] = clipped;
      if (work.drawn) work.drawn[group * kWords + j] = drawn;
    }
  }
  __syncwarp();
  store_image(job, group, pixels, room->image);
}

// --- Triangles that are clipped

// Clips a triangle, whose indices name vertices, with all lanes.
__device__ __forceinline__ void clip(const Frame& f, int32_t triangle, ClipScratch* scratch, ClippedFan* out) {
  int32_t index[3];
  float v[3][4];
  load_indices(f, triangle, index);
  for (int k = 0; k < 3; ++k) load_vertex(f, index[k], v[k]);
  const int n = clip_polygon(v, f.view.width, f.view.height, scratch), lane = lane_id();
  ParentOf<1> parent;
  Primitive& p = parent.primitive[0];
  bool made = false;
  if (lane + 2 < n) {
    const int apex = fan_apex(scratch->projected, scratch->polygon, n);
    made = fan_primitive(scratch->projected, apex, n, lane, f.view, &p);
    if (made) {
      set_fan_places(scratch->polygon, apex, n, lane, f.view, p.order, &p);
      set_fan_weights(scratch->polygon, apex, n, lane, 0, &parent);
    }
  }
  const unsigned all = __ballot_sync(kAllLanes, made);
  if (made) {
    ClippedFan::Sub& sub = out->sub[__popc(all & lanes_below())];
    sub.primitive = p;
    for (int k = 0; k < 3; ++k) {
      sub.w[k] = parent.w[0][k];
      for (int m = 0; m < 3; ++m) sub.weights[k][m] = parent.weights[0][k][m];
    }
  }
  if (lane == 0) {
    out->count = __popc(all);
    out->first = first_slot(v);
    const int32_t slots[3] = {out->first, (out->first + 1) % 3, (out->first + 2) % 3};
    set_given(v, slots, out);
  }
  __syncwarp();
}

// The triangles of the table, a warp for each of its places.
__global__ void __launch_bounds__(kShadeThreads)
    clip_listed(const __grid_constant__ Shading job, const __grid_constant__ Work work) {
  __shared__ ClipScratch scratch[kShadeWarps];
  wait_for_previous();
  for (int64_t place = warp_in_grid(); place < kListed; place += warps_of_grid()) {
    const uint64_t key = work.keys[place];
    if (key != kFree)
      clip(frame_of(job, (int64_t)(key >> 32)), (int32_t)(key & 0xffffffff), scratch + this_warp(),
           work.records + place);
  }
}

// By the first record that covers pixel (x, y); 0 where none does.
__device__ __forceinline__ void weigh_clipped(const Shading& job, const ClippedFan& clipped, int x, int y,
                                              float weight[3]) {
  for (int k = 0; k < 3; ++k) weight[k] = 0.0f;
  for (int s = 0; s < clipped.count; ++s) {
    const ClippedFan::Sub& sub = clipped.sub[s];
    if (!covers(sub.primitive, x, y)) continue;
    ParentOf<1> parent;
    parent.clipped = true;
    parent.affine = false;
    parent.primitive[0].area = sub.primitive.area;
    using Number = std::conditional_t<kFloatWeights, float, double>;
    Number e[3], b[3];
    for (int k = 0; k < 3; ++k) {
      parent.w[0][k] = sub.w[k];
      for (int m = 0; m < 3; ++m) parent.weights[0][k][m] = sub.weights[k][m];
      e[k] = (Number)edge_at(sub.primitive, k, x, y);
    }
    if constexpr (kUnsnappedWeights)
      weigh_unsnapped(job, clipped, x, y, b);
    else if constexpr (kFloatWeights)
      float_barycentrics(parent, 0, e, b);
    else
      barycentrics(parent, 0, e, b);
    for (int k = 0; k < 3; ++k) weight[k] = (float)b[k];
    return;
  }
}

// A clipped triangle that a warp has at hand. In shared memory.
struct HeldClipped {
  Skin skin;
  bool drawn;
};

// Makes ready what all pixels of a clipped triangle have in common, with one lane.
__device__ __forceinline__ void hold_clipped(const Shading& job, const ClippedFan& clipped, uint64_t key,
                                             HeldClipped* out) {
  const Frame f = frame_of(job, (int64_t)(key >> 32));
  const int32_t triangle = (int32_t)(key & 0xffffffff);
  int32_t index[3], vertex[3];
  load_indices(f, triangle, index);
  bool back = false;
  if (job.surface.two_sided) {
    float corner[3][4];
    for (int k = 0; k < 3; ++k) load_vertex(f, index[k], corner[k]);
    back = is_back(corner[0], corner[1], corner[2]);
  }
  for (int k = 0; k < 3; ++k) vertex[k] = pick(index, (clipped.first + k) % 3);
  out->drawn = load_skin(job, triangle, vertex, back, &out->skin) && clipped.count > 0;
}

__global__ void __launch_bounds__(kShadeThreads, 4)
    shade_clipped(const __grid_constant__ Shading job, const __grid_constant__ Work work) {
  __shared__ ClipScratch scratch[kShadeWarps];
  __shared__ ClippedFan own[kShadeWarps];  // what found no place in the table
  __shared__ HeldClipped held_by_warp[kShadeWarps];
  wait_for_previous();
  if (*work.any == kFree) return;
  const Codes& codes = *work.codes;
  HeldClipped* hold = held_by_warp + this_warp();
  const int lane = lane_id();
  const int64_t of_view = (int64_t)job.height * job.width, pixels = job.views * of_view;
  const int64_t words = (pixels + kWarp - 1) / kWarp;
  const ClippedFan* held = nullptr;
  uint64_t held_key = kFree;
  for (int64_t base = warp_in_grid() * kWordsAtOnce; base < words; base += warps_of_grid() * kWordsAtOnce) {
    const uint32_t loaded = lane < kWordsAtOnce && base + lane < words ? work.clipped[base + lane] : 0;
    for (unsigned left = __ballot_sync(kAllLanes, loaded != 0); left; left &= left - 1) {
      const int k = __ffs(left) - 1;
      const uint32_t bits = __shfl_sync(kAllLanes, loaded, k);
      const int64_t begin = (base + k) * kWarp, view = begin / of_view, i = begin + lane;
      const Place at = place_of(job, view, (uint32_t)(begin - view * of_view) + lane);
      const bool wanted = bits >> lane & 1;
      const int32_t triangle = wanted ? (int32_t)(uint32_t)job.packed[i] : 0;
      const uint64_t key = wanted ? key_of(at.view, triangle) : kFree;
      bool drawn = false;
      for (unsigned waiting = bits; waiting;) {
        const uint64_t next = __shfl_sync(kAllLanes, key, __ffs(waiting) - 1);
        if (next != held_key) {
          held = find_clipped(work, next);
          held_key = next;
          __syncwarp();
          if (!held) {
            clip(frame_of(job, (int64_t)(next >> 32)), (int32_t)(next & 0xffffffff), scratch + this_warp(),
                 own + this_warp());
            held = own + this_warp();
          }
          if (lane == 0) hold_clipped(job, *held, next, hold);
          __syncwarp();
        }
        if (key == next && hold->drawn) {
          float weight[3], linear[3];
          weigh_clipped(job, *held, at.x, at.y, weight);
          finish(job, work, codes, hold->skin, weight, i, linear);
          if (job.image) encode(codes, job.channels, linear, job.image + job.channels * i);
          drawn = true;
        }
        waiting &= ~__ballot_sync(kAllLanes, key == next);
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
// the warps set up what they meet.
constexpr int64_t kPixelsToPrepare = 24;
bool prepares(const Shading& job) {
  return job.views * job.count * kPixelsToPrepare <= job.views * job.height * job.width;
}

Layout lay_out(const Shading& job, Scratch* scratch) {
  Layout out = {};
  const int64_t pixels = job.views * job.height * job.width, words = (pixels + kPixels - 1) / kPixels * kWords;
  out.work.keys = scratch->take<uint64_t>(kListed + 1);
  out.work.any = out.work.keys + kListed;
  out.work.codes = scratch->take<Codes>(1);
  out.work.background = scratch->take<uint32_t>(job.height / job.samples);
  out.work.records = scratch->take<ClippedFan>(kListed);
  out.work.clipped = scratch->take<uint32_t>(words);
  if (prepares(job)) out.work.runs = scratch->take<Run>(job.views * job.count);
  if (job.samples > 1) out.work.drawn = scratch->take<uint32_t>(words);
  if (job.samples > 1 && !job.linear) out.linear = scratch->take<float>(3 * pixels);
  if (job.surface.texture_count > kTextures) out.textures = scratch->take<Texture>(job.surface.texture_count);
  return out;
}

// Blocks that hold the device at once, for so many warps of work.
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
  const int64_t rows = job.height / job.samples, triangles = at.work.runs ? job.views * job.count : 0;
  const int64_t items = max_of(max_of<int64_t>(kSrgbSteps + 1, rows), triangles);
  return launch_first(begin_frame, (items + kShadeThreads - 1) / kShadeThreads, kShadeThreads, 0, stream, job,
                      thresholds, at.work);
}

cudaError_t shade_cuda(const Shading& given, void* memory, cudaStream_t stream) {
  Scratch scratch = {static_cast<char*>(memory)};
  Layout at = lay_out(given, &scratch);
  at.work.many = at.textures;
  if (!at.textures)
    for (int i = 0; i < given.surface.texture_count; ++i) at.work.few[i] = given.surface.textures[i];
  Shading job = given;
  const bool several = job.samples > 1;
  if (several) {
    job.image = nullptr;
    if (!job.linear) job.linear = at.linear;
  }
  const int64_t pixels = job.views * job.height * job.width, words = (pixels + kWarp - 1) / kWarp;
  const int64_t groups = (pixels + kPixels - 1) / kPixels;
  const auto kernel = at.work.runs ? shade_prepared : shade_whole;
  BIGTRI_CUDA(launch_next(kernel, (unsigned)((groups + kShadeWarps - 1) / kShadeWarps), kShadeThreads, 0, stream, job,
                          at.work));
  int blocks;
  BIGTRI_CUDA(launch_next(clip_listed, kListed / kShadeWarps, kShadeThreads, 0, stream, job, at.work));
  BIGTRI_CUDA(blocks_of(shade_clipped, (words + kWordsAtOnce - 1) / kWordsAtOnce, &blocks));
  BIGTRI_CUDA(launch_next(shade_clipped, blocks, kShadeThreads, 0, stream, job, at.work));
  if (!several) return cudaSuccess;
  const float* linear = job.linear;
  job.image = given.image;
  BIGTRI_CUDA(blocks_of(add_samples, (pixels / (job.samples * job.samples) + kWarp - 1) / kWarp, &blocks));
  return launch_next(add_samples, blocks, kShadeThreads, 0, stream, job, (const Codes*)at.work.codes, linear,
                     (const uint32_t*)at.work.drawn);
}

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

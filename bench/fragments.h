// What may become of a fragment, one by one, for the threads of a CPU (fragments.cpp) and a GPU's (fragments.cu): bigtri's
// own set-up, spans and depth, as its variant `scanline` has them, and behind them four ways to keep the nearest. Only
// triangles that need no clipping are drawn.
#pragma once

#if !defined(BIGTRI_RUNG)
#define BIGTRI_RUNG exact
#endif
#include "core/attributes.h"
#include "core/row_fragments.h"
#include "core/shading.h"
#include "core/visibility.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

enum Way {
  kPacked,  // an atomic minimum of depth and triangle: a visibility buffer
  kLocked,  // the same value, stored under a lock for each pixel
  kColoured,  // shaded if nearer than the pixel; then an atomic minimum of depth and colour
  kColouredAll,  // every fragment is shaded
};

// What fragments.py hands over, field by field. On a GPU the pointers are to device memory.
struct FragmentArguments {
  const float* positions;  // [V, 4], clip space
  const int32_t* triangles;  // [count, 3]
  const float* normals;  // [V, 3]
  const float *directions, *colors;  // of lights, [lights, 3]
  const SrgbSteps* srgb;
  int64_t* packed;  // [height, width]
  uint32_t* locks;  // [height, width], all 0
  uint32_t* image;  // [height, width], r, g, b, 255 from the lowest byte on; the background is 0
  int32_t count, lights, height, width;
};

struct FragmentJob {
  Frame frame;  // one view
  FragmentArguments given;
};

inline FragmentJob fragment_job(const FragmentArguments& a) {
  FragmentJob job = {{}, a};
  job.frame.positions = a.positions;
  job.frame.triangles = a.triangles;
  job.frame.count = a.count;
  job.frame.views = 1;
  job.frame.view = {a.width, a.height, 0, 0, a.width, a.height, kCullNone};
  job.frame.packed = a.packed;
  return job;
}

// A triangle of the frame and its only record. False if it has none, or needs clipping.
BIGTRI_HD bool whole_triangle(const Frame& f, int64_t t, ParentOf<1>* parent, Record* record) {
  float v[3][4];
  Vertex projected[3];
  for (int k = 0; k < 3; ++k) {
    for (int i = 0; i < 4; ++i) v[k][i] = f.positions[4 * (int64_t)f.triangles[3 * t + k] + i];
    projected[k] = project_vertex(v[k], f.view.width, f.view.height);
  }
  if (fate_of(projected[0].flags, projected[1].flags, projected[2].flags) != Fate::kWhole) return false;
  if (!expand_whole(v, projected, f.view, parent)) return false;
  fill_record(parent->primitive[0], t, record);
  return true;
}

// Smooth normals, Lambert, sRGB.
BIGTRI_HD uint32_t shade(const FragmentJob& job, const ParentOf<1>& parent, int64_t triangle, int x, int y) {
  double e[3], b[3];
  for (int k = 0; k < 3; ++k) e[k] = edge_at(parent.primitive[0], k, x, y);
  barycentrics(parent, 0, e, b);
  const float weight[3] = {(float)b[0], (float)b[1], (float)b[2]};
  const float* at[3];
  for (int k = 0; k < 3; ++k) {
    const int32_t vertex = job.frame.triangles[3 * triangle + corner_of(parent, 0, k)];
    at[k] = job.given.normals + 3 * (int64_t)vertex;
  }
  float normal[3], colour[3];
  for (int i = 0; i < 3; ++i) normal[i] = interpolate(weight, at[0][i], at[1][i], at[2][i]);
  const float albedo[3] = {0.8f, 0.7f, 0.6f}, ambient[3] = {0.1f, 0.1f, 0.1f};
  lambert(normal, albedo, ambient, LightArrays{job.given.directions, job.given.colors}, job.given.lights, colour);
  uint32_t code = 0xff000000u;
  for (int i = 0; i < 3; ++i) code |= (uint32_t)encode_srgb(colour[i], *job.given.srgb) << 8 * i;
  return code;
}

// Whoever includes this file says how a pixel is read, lowered, and lowered under its lock.
BIGTRI_HD int64_t read_pixel(const int64_t* pixel);
BIGTRI_HD void lower_pixel(int64_t* pixel, int64_t v);
BIGTRI_HD void lower_under_lock(uint32_t* lock, int64_t* pixel, int64_t v);

template <Way kWay>
BIGTRI_HD void keep(const FragmentJob& job, const ParentOf<1>& parent, int64_t triangle, int x, int y, float z) {
  const int64_t i = (int64_t)y * job.frame.view.width + x;
  int64_t* const pixel = job.frame.packed + i;
  const int64_t packed = pack_fragment(z, (uint32_t)triangle);
  if (kWay == kPacked) {
    lower_pixel(pixel, packed);
  } else if (kWay == kLocked) {
    lower_under_lock(job.given.locks + i, pixel, packed);
  } else if (kWay == kColouredAll || packed >> 32 <= read_pixel(pixel) >> 32) {
    lower_pixel(pixel, pack_fragment(z, shade(job, parent, triangle, x, y)));
  }
}

template <Way kWay>
BIGTRI_HD void draw_triangle(const FragmentJob& job, int64_t t) {
  ParentOf<1> parent;
  Record r;
  if (!whole_triangle(job.frame, t, &parent, &r)) return;
  for (int y = r.y0; y < r.y1; ++y)
    for_each_fragment(r, y, [&](int x, float depth) { keep<kWay>(job, parent, t, x, y, depth); });
}

// A triangle that is set up, so that pixels next to each other need not do it again.
struct Held {
  int64_t triangle = -1;
  ParentOf<1> parent;
};

// The colour of pixel (x, y) from the visibility buffer.
BIGTRI_HD uint32_t shade_pixel(const FragmentJob& job, int x, int y, Held* held) {
  const int64_t packed = job.frame.packed[(int64_t)y * job.frame.view.width + x], triangle = packed & 0xffffffff;
  if (packed == kBackground) return 0;
  Record record;
  if (held->triangle != triangle) whole_triangle(job.frame, triangle, &held->parent, &record);
  held->triangle = triangle;
  return shade(job, held->parent, triangle, x, y);
}

// The colour that was packed with the depth.
BIGTRI_HD uint32_t packed_colour(int64_t packed) { return packed == kBackground ? 0 : (uint32_t)packed; }

inline bool has_colours(int way) { return way == kColoured || way == kColouredAll; }

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

// What encode_srgb looks up, from the 255 thresholds, in host memory; null: nothing. Returns its bytes.
extern "C" int64_t fragments_srgb(const float* thresholds, bigtri::SrgbSteps* table) {
  if (table) bigtri::fill_srgb_steps(thresholds, table);
  return sizeof(bigtri::SrgbSteps);
}

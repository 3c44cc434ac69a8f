// What pairs of float32 decide, beside the float64 formulas that they stand for, for test_float_pairs.py.
#define BIGTRI_SLOW_FLOAT64
#define BIGTRI_RUNG exact
#include "core/pair_depth.h"
#include "core/setup.h"

using namespace bigtri;

namespace {

// Not equal as depths are: of zeros the sign does not matter.
bool differ(float a, float b) { return !(a == b); }

}  // namespace

// By which planes: one for a triangle, one for each cell, or one for each row.
enum Planes { kTriangle, kCells, kRows };

// Depth at all covered pixels of triangles: x, y [count, 3] subpx, z [count, 3]. counts: pixels, those that are not
// decided, and those that are decided in another way than float64 rounds; thin triangles; pixels beyond the bounds of
// their cells. bound: what the error is multiplied with.
extern "C" void decide_depth(int count, const int32_t* x, const int32_t* y, const float* z, int planes, float bound,
                             int64_t* counts) {
  const Viewport everywhere = {16384, 16384, 0, 0, 16384, 16384, kCullNone};
  for (int t = 0; t < count; ++t) {
    Primitive p;
    if (!make_primitive(x + 3 * t, y + 3 * t, z + 3 * t, everywhere, &p)) continue;
    if (is_thin(p.x, p.y, p.area)) {
      ++counts[3];
      continue;
    }
    PairPlane plane = pair_plane(p.x, p.y, p.z, p.area, p.x0, p.y0);
    const PairLines lines = pair_lines(p.x, p.y, p.z, p.area, false);
    for (int py = p.y0; py < p.y1; ++py) {
      int first = -1;  // covered
      for (int px = p.x0; px < p.x1; ++px) {
        int64_t outside = 0;
        for (int k = 0; k < 3; ++k) outside |= edge_steps(edge_of(p.x, p.y, k), px, py);
        if (outside < 0) continue;
        if (first < 0) first = px;
        int i = px - p.x0, j = py - p.y0;
        if (planes == kCells) {
          plane = pair_cell_plane(p.x, p.y, p.z, p.area, px / kBin, py / kBin);
          i = px % kBin, j = py % kBin;
        }
        FloatPair start = pair_at(plane.z, plane.dzdy, exact_float(j)), step = plane.dzdx;
        float error = plane.error, depth;
        if (planes == kRows) {
          i = px - first;
          start = pair_line_start(lines, p.x, p.y, p.z[0], first, py);
          step = lines.step;
          error = lines.fixed + lines.per_px * (float)i;
        }
        const bool decided = pair_depth(start, step, exact_float(i), error * bound, &depth);
        const float wanted = plane_depth(p.x, p.y, p.z, p.area, px, py);
        ++counts[0];
        counts[1] += !decided;
        counts[2] += decided && differ(depth, wanted);
        if (planes == kCells)
          counts[4] += wanted < pair_corner_plane(plane, 0, 0, kBin - 1, kBin - 1, false) ||
                       wanted > pair_corner_plane(plane, 0, 0, kBin - 1, kBin - 1, true) ||
                       wanted < pair_corner_plane(plane, i, j, 0, 0, false) ||
                       wanted > pair_corner_plane(plane, i, j, 0, 0, true);
      }
    }
  }
}

// Where numbers x [count] over w [count] snap to in an image that is `size` px wide. counts: of numbers, as above.
extern "C" void decide_snap(int count, const float* x, const float* w, int size, int64_t* counts) {
  const int half = kHalf * size;
  for (int i = 0; i < count; ++i) {
    int32_t snapped;
    const bool decided = pair_snap(x[i], inverse({w[i], 0.0f}), half, -kGuard - half, kGuard - 1 - half, &snapped);
    ++counts[0];
    counts[1] += !decided;
    counts[2] += decided && half + snapped != snap_x((double)x[i], divisor(w[i]), size);
  }
}

// Results [count, 2] of operation 0: sum of pairs, 1: product of a float and a pair, 2: of pairs, 3: inverse; and 4: the
// pair of an integer. a, b: pairs [count, 2]; of floats only the first is read.
extern "C" void compute(int operation, int count, const float* a, const float* b, const int64_t* integers, float* out) {
  for (int i = 0; i < count; ++i) {
    const FloatPair p = {a[2 * i], a[2 * i + 1]}, q = {b[2 * i], b[2 * i + 1]};
    const FloatPair r = operation == 0   ? sum(p, q)
                        : operation == 1 ? product(p.hi, q)
                        : operation == 2 ? product(p, q)
                        : operation == 3 ? inverse(p)
                                         : pair_of(integers[i]);
    out[2 * i] = r.hi;
    out[2 * i + 1] = r.lo;
  }
}

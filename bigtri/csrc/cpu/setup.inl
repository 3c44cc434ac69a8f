// Triangles to records, compiled once per instruction set.
#pragma once

#include "kernels.h"

namespace bigtri {
namespace {

void project(const float* positions, int64_t begin, int64_t end, int width, int height, Vertex* out) {
  for (int64_t i = begin; i < end; ++i) out[i - begin] = project_vertex(positions + 4 * i, width, height);
}

uint32_t bins_of(const Record& r) { return (uint32_t)(((r.x1 - 1) / kBin - r.x0 / kBin + 1) * ((r.y1 - 1) / kBin - r.y0 / kBin + 1)); }

// The direct path keeps f in int32 without the bin test that makes this safe for others. For a triangle of extent D <= 2^18 subpx (1024 px) and samples up to
// 8 px beyond it, |e| <= 2 * D * (D + 2^11), so |f| < 2^30. A small bbox alone is not enough: the screen may have cut it from a huge triangle.
constexpr int64_t kDirectExtent = 1 << 18;

int64_t extent_of(const Primitive& p) {
  const int64_t w = (int64_t)max_of(max_of(p.x[0], p.x[1]), p.x[2]) - min_of(min_of(p.x[0], p.x[1]), p.x[2]);
  const int64_t h = (int64_t)max_of(max_of(p.y[0], p.y[1]), p.y[2]) - min_of(min_of(p.y[0], p.y[1]), p.y[2]);
  return max_of(w, h);
}

void fill_record(const Primitive& p, int64_t triangle, Record* r) {
  for (int k = 0; k < 3; ++k) {
    r->x[k] = p.x[k];
    r->y[k] = p.y[k];
    r->z[k] = p.z[k];
  }
  r->triangle = (uint32_t)triangle;
  r->area = p.area;
  const DepthGradient g = depth_gradient(p.x, p.y, p.z, p.area);
  r->dzdx = g.dzdx;
  r->dzdy = g.dzdy;
  r->zmin = min_of(min_of(p.z[0], p.z[1]), p.z[2]);
  r->zmax = max_of(max_of(p.z[0], p.z[1]), p.z[2]);
  r->x0 = p.x0;
  r->y0 = p.y0;
  r->x1 = p.x1;
  r->y1 = p.y1;
  const bool large = is_large(p.x0, p.y0, p.x1, p.y1, kLargeThreshold) || extent_of(p) > kDirectExtent;
  r->flags = (large ? kRecordLarge : 0) | (is_thin(p.x, p.y, p.area) ? kRecordThin : 0) | (r->zmax > 1.0f ? kRecordFar : 0);
}

int64_t setup(const SetupJob& job, int64_t begin, int64_t end, Record* records, uint32_t* candidates, int64_t* dropped) {
  int64_t n = 0, lost = 0;
  Primitive p;
  for (int64_t t = begin; t < end; ++t) {
    const int32_t* index = job.triangles + 3 * t;
    const Vertex *a = job.vertices + (index[0] - job.first_vertex), *b = job.vertices + (index[1] - job.first_vertex),
                 *c = job.vertices + (index[2] - job.first_vertex);
    const Fate fate = fate_of(a->flags, b->flags, c->flags);
    if (fate == Fate::kWhole) {
      const int32_t x[3] = {a->x, b->x, c->x}, y[3] = {a->y, b->y, c->y};
      const float z[3] = {a->z, b->z, c->z};
      if (!make_primitive(x, y, z, job.view, &p)) continue;
      fill_record(p, t, records + n);
      candidates[n] = bins_of(records[n]);
      ++n;
    } else if (fate == Fate::kClip) {
      float v[3][4];
      for (int k = 0; k < 3; ++k)
        for (int i = 0; i < 4; ++i) v[k][i] = job.positions[4 * (int64_t)index[k] + i];
      Fan fan;
      make_fan(v, (a->flags | b->flags | c->flags) & kOutsideMask, job.view.width, job.view.height, &fan);
      for (int s = 0; s + 2 < fan.count; ++s) {
        if (!fan_primitive(fan, s, job.view, &p)) continue;
        fill_record(p, t, records + n);
        candidates[n] = bins_of(records[n]);
        ++n;
      }
    } else if (fate == Fate::kDropped) {
      ++lost;
    }
  }
  *dropped = lost;
  return n;
}

}  // namespace
}  // namespace bigtri

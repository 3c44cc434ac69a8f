// Projection of vertices and set-up of records, the first two kernels of the bin_owned variant (bin_owned.cpp calls
// them per piece of vertices and per chunk of triangles). Compiled once per instruction set.
#pragma once

#include "kernels.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

void project(const float* positions, int64_t begin, int64_t end, int width, int height, Vertex* out) {
  for (int64_t i = begin; i < end; ++i) out[i - begin] = project_vertex(positions + 4 * i, width, height);
}

// Fate::kNothing needs no case: such a triangle gives no record, and is not counted as dropped.
int64_t setup(const SetupJob& job, int64_t begin, int64_t end, Record* records, uint32_t* candidates,
              int64_t* dropped) {
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
      candidates[n] = (uint32_t)bin_box(records[n]).count;
      ++n;
    } else if (fate == Fate::kClip) {
      float v[3][4];
      for (int k = 0; k < 3; ++k)
        for (int i = 0; i < 4; ++i) v[k][i] = job.positions[4 * (int64_t)index[k] + i];
      Fan fan;
      make_fan(v, (a->flags | b->flags | c->flags) & kOutsideMask, job.view.width, job.view.height, &fan);
      for (int s = 0; s + 2 < fan.count; ++s) {
        if (!fan_primitive(fan.projected, fan.apex, fan.count, s, job.view, &p)) continue;
        fill_record(p, t, records + n);
        candidates[n] = (uint32_t)bin_box(records[n]).count;
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
}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

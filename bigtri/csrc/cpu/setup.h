// The kernels of set-up, and the data that they share with those who call them: groups.h, which has vertices projected,
// shares.h and bin_owned.cpp, which have triangles turned into records. All variants set up with them. The kernels are
// compiled once per instruction set (setup.inl); this file once per rung.
#pragma once

#include "../core/record.h"
#include "backend.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

// A record whose bbox has more px is large here. kLargeThreshold would give the same bits; measured from 96 to 4000, this
// is where rows of a bbox, half of them empty, cost what a large record's tile masks do (docs/performance.md).
constexpr int64_t kDirectPixels = 384;

// The triangles of one view.
struct SetupJob {
  Frame frame;  // of one view
  int32_t view;  // what records have as theirs
  const Vertex* vertices;  // projected; element 0 is vertex first_vertex. Null: set-up projects each corner by itself
  int64_t first_vertex;  // lowest index in use
};

// A call, so that set-up from vertices that are projected has none of its code.
__attribute__((noinline)) inline Vertex project_corner(const SetupJob& job, int64_t index) {
  return project_vertex(job.frame.positions + 4 * index, job.frame.view.width, job.frame.view.height);
}
inline Vertex vertex_of(const SetupJob& job, int64_t index) {
  return job.vertices ? job.vertices[index - job.first_vertex] : project_corner(job, index);
}

struct SetupKernels {
  // Projects and snaps vertices [begin, end) to out[0], out[1], ... Returns the OR of their flags.
  uint32_t (*project)(const float* positions, int64_t begin, int64_t end, int width, int height, Vertex* out);
  // Turns triangles [begin, end) into records, in the order of the triangles, and returns their number: at most
  // kMaxSubTriangles of a triangle that is clipped, and one of any other. dropped: out. candidates: null, or out: the
  // number of bins that each record's bbox touches.
  int64_t (*setup)(const SetupJob& job, int64_t begin, int64_t end, Record* records, uint32_t* candidates,
                   int64_t* dropped);
};

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

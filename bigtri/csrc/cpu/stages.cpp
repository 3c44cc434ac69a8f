// The stages one by one, for tests and for people who validate a variant: setup and binning as plain loops around the
// functions of core/, which the variants call too; the other stages are kernels (stages.inl). The binding calls them
// through CpuRung::stages. Compiled once per rung.

#include "kernels.h"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {
namespace {

void setup(const CheckedFrame& frame, SetupOutput* out) {
  FloatMode mode;
  out->dropped = 0;
  Parent parent = {};
  for (int64_t t = 0; t < frame.count; ++t) {
    out->dropped += expand_triangle(frame, t, &parent) == Fate::kDropped;
    for (int s = 0; s < parent.count; ++s) {
      const Primitive& p = parent.primitive[s];
      out->triangle.push_back((int32_t)t);
      out->area.push_back(p.area);
      out->clipped.push_back(parent.clipped);
      for (const int32_t b : {p.x0, p.y0, p.x1, p.y1}) out->bbox.push_back(b);
      for (int k = 0; k < 3; ++k) {
        out->xy.push_back(p.x[k]);
        out->xy.push_back(p.y[k]);
        out->z.push_back(p.z[k]);
        out->w.push_back(parent.w[s][k]);
        out->corner.push_back(corner_of(parent, s, k));
        for (int m = 0; m < 3; ++m) out->weights.push_back(parent.weights[s][k][m]);
      }
    }
  }
}

void binning(const int32_t* xy, const int32_t* bbox, int64_t records, int64_t threshold, BinningOutput* out) {
  const int32_t *v = xy, *b = bbox;
  for (int64_t i = 0; i < records; ++i, v += 6, b += 4) {
    if (b[0] >= b[2] || b[1] >= b[3]) continue;
    if (!is_large(b[0], b[1], b[2], b[3], threshold)) {
      out->small.push_back((int32_t)i);
      continue;
    }
    Primitive p;
    for (int k = 0; k < 3; ++k) p.x[k] = v[2 * k], p.y[k] = v[2 * k + 1];
    for (int r = b[1] / kBin; r <= (b[3] - 1) / kBin; ++r)
      for (int c = b[0] / kBin; c <= (b[2] - 1) / kBin; ++c) {
        EdgesInBin edges;
        const bool keep = edges_in_bin(p, c, r, &edges);
        for (const int32_t e : {(int32_t)i, c, r}) out->candidates.push_back(e);
        out->kept.push_back(keep);
      }
  }
}

const StageKernels& kernels() { return current_kernels().stages; }

}  // namespace

extern const Stages kStageFunctions;
const Stages kStageFunctions = {setup, binning, kernels};

// Null where coverage needs more of a record than the stages hand on, or where a row's covered pixels may lie apart, since
// a small record gets one span a row.
extern const Stages* const kStages;
const Stages* const kStages = kUnsnapped || Rung::kWraps ? nullptr : &kStageFunctions;

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

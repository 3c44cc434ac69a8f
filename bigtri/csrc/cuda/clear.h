// What comes before the triangles where they are drawn with atomics: the background, zeros, and the vertices projected.
#pragma once

#include "../core/setup.h"
#include "launch.cuh"

namespace bigtri {
inline namespace BIGTRI_NAMESPACE {

// Room for the projected vertices, or null: projecting each once pays where triangles share them, not where most are
// left out.
Vertex* take_projected(Scratch* scratch, const Frame& f, bool wanted);

constexpr int kSampled = 256;  // triangles

// A frame's first kernels: one, or where the frame has areas three, which mark, list and clear these. projected: where the
// vertices go, or null. shown: where to put how many triangles of a sample of kSampled, of the only view, may cover a
// pixel centre, or null.
cudaError_t launch_clear(const Frame& f, Vertex* projected, const Zeros& zeros, cudaStream_t stream,
                         uint32_t* shown = nullptr);

}  // namespace BIGTRI_NAMESPACE
}  // namespace bigtri

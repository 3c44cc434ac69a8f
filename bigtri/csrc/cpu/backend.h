// What the CPU backend offers to the binding: instruction sets, and for each rung its variants, its stages one by one, and what reads a visibility buffer. Torch-free, and free of any rung.
#pragma once

#include <string>
#include <vector>

#include "../core/counters.h"
#include "../core/frame.h"
#include "../core/registry.h"
#include "../core/texture.h"
#include "parallel.h"

namespace bigtri {

// --- Instruction sets. All give the same bits.

enum class Isa { kBaseline, kAvx2, kAvx512 };

const char* name_of(Isa isa);
// False where there is none of that name or the machine lacks it.
bool find_isa(const std::string& name, Isa* isa);
Isa current_isa();
void use_isa(Isa isa);

// --- Variants

// A frame whose every index lies in [lowest, highest], which lie within the vertices; lowest > highest: no triangles.
struct CheckedFrame : Frame {
  int64_t lowest, highest;
};

// Smallest and largest index; (INT32_MAX, INT32_MIN) for none.
void index_range(const Parallel& parallel, const int32_t* indices, int64_t count, int64_t* lowest, int64_t* highest);

// A way to schedule the work. Variants never differ in a bit; each is one file and its name in variants.h.
struct Variant {
  const char* name;
  const char* paper;  // where the design is from
  const Parameter* parameters;
  // Writes every pixel of every view, and dropped. values: one for each parameter.
  void (*draw)(const CheckedFrame& frame, const Parallel& parallel, const int64_t* values);
};

// --- Stages by themselves, on the layout of docs/architecture.md

struct SetupOutput {
  std::vector<int32_t> triangle, xy, bbox, corner;
  std::vector<float> z;
  std::vector<int64_t> area;
  std::vector<double> w, weights;
  std::vector<char> clipped;
  int64_t dropped;
};

struct BinningOutput {
  std::vector<int32_t> candidates, small;
  std::vector<char> kept;
};

// The stages whose loops are compiled once per instruction set. Whoever calls one that computes with floats sets
// FloatMode.
struct StageKernels {
  void (*tile_mask)(const int32_t* xy, const int32_t* bbox, const int32_t* queue, int64_t count, int64_t* touched,
                    int64_t* full);
  // Spans of one queue entry, or of one small record; returns their number, at most 512 or a row of the image each.
  int64_t (*scan_tiles)(const int32_t* xy, const int32_t* bbox, const int32_t* entry, uint64_t touched, int32_t* spans);
  int64_t (*scan_rows)(const int32_t* xy, const int32_t* bbox, int32_t record, int32_t* spans);
  void (*depth)(const int32_t* xy, const float* z, const int64_t* area, const int32_t* spans, int64_t count,
                float* out);
};

struct Stages {
  void (*setup)(const CheckedFrame& frame, SetupOutput* out);
  void (*binning)(const int32_t* xy, const int32_t* bbox, int64_t records, int64_t threshold, BinningOutput* out);
  const StageKernels& (*kernels)();  // those of the instruction set in use
};

// --- What reads a visibility buffer

struct AttributeJob {
  const int64_t* packed;  // [views, H, W]
  const float* positions;  // [views, V, 4]
  int64_t vertices;  // V
  const int32_t* triangles;  // [T, 3]
  int64_t triangle_count;  // T
  int64_t views;
  int height, width;
  const float* attributes;  // [V, C] or [views, V, C], or null: the barycentrics of the parent's corners
  int64_t attribute_view;  // floats from one view's attributes to the next one's; 0 where all share them
  int64_t channels;  // C, or 3
  float* out;  // [views, H, W, channels]
};

// --- Rungs

struct CpuRung {
  const char* name;
  int32_t guard;  // X and Y lie in [-guard, guard), subpx
  const Variant* const* variants;  // the one that "auto" means first; ends with null
  const Variant* const* counting;  // the same, with counters
  const Stages* stages;
  void (*interpolate)(const AttributeJob& job, const Parallel& parallel);
};

// All of them, the default first; ends with a null name.
extern const CpuRung kCpuRungs[];

// --- Textures and shading, the same for every rung

void sample(const float* texture, int height, int width, int64_t channels, const float* uv, int64_t count,
            Filter filter, Wrap wrap, float* out, const Parallel& parallel);
void lambert(const float* normals, const float* albedo, const float* ambient, const float* directions,
             const float* colors, int64_t lights, int64_t count, float* out, const Parallel& parallel);
void encode_srgb(const float* linear, const float* thresholds, int64_t count, uint8_t* out, const Parallel& parallel);

}  // namespace bigtri

// The CPU backend as the binding (csrc/torch) sees it: the instruction sets, and for each rung its variants, its stages
// one by one and its attribute pass; textures and shading for all rungs. It depends neither on torch nor on a rung.
#pragma once

#include <string>
#include <vector>

#include "../core/counters.h"
#include "../core/frame.h"
#include "../core/registry.h"
#include "../core/surface.h"
#include "parallel.h"
#include "work_map.h"

namespace bigtri {

// --- Instruction sets. All give the same bits.

enum class Isa { kBaseline, kAvx2, kAvx512 };

const char* name_of(Isa isa);
// False if no instruction set has that name, or the machine lacks it.
bool find_isa(const std::string& name, Isa* isa);
// The instruction set of the whole process (dispatch.cpp).
Isa current_isa();
void use_isa(Isa isa);

// --- The shading pass: from a visibility buffer to a picture

struct ShadeJob;

// Samples of one view that are shaded at a time: a rectangle of whole pixels, up to kBin samples a side where a pixel is
// not wider.
struct ShadeBlock {
  int64_t view;
  const int64_t* packed;  // of its first sample
  int64_t pitch;  // packed values from one row to the next
  int x, y, width, height;
};

// The kernels of the shading pass (shade.inl), of a rung and an instruction set.
struct ShadeKernels {
  // Prepares a worker's memory for a job: kShadeScratchBytes, 64-byte aligned.
  void (*begin)(const ShadeJob& job, void* scratch);
  void (*block)(const ShadeJob& job, const ShadeBlock& block, void* scratch);
  // The background of `width` x `height` samples from (x, y) on, whole pixels; it may be wider than a block.
  void (*background)(const ShadeJob& job, int64_t view, int x, int y, int width, int height);
};
constexpr int64_t kShadeScratchBytes = 192 * 1024;

struct ShadeJob {
  const ShadeKernels* kernels;
  const int64_t* packed;  // [views, H, W], the visibility buffer
  const float* positions;  // [views, V, 4] or [V, 4], clip space
  int64_t position_view;  // floats from one view's positions to the next view's; 0 if all views share them
  const int32_t* triangles;  // [T, 3], vertex indices, which name vertices
  int64_t triangle_count;  // T
  int64_t views;
  int height, width;  // of the visibility buffer, px; multiples of samples
  int samples;  // of a pixel of the picture along each axis
  Surface surface;
  const SrgbSteps* srgb;
  const float *decoded8, *decoded16;  // what sRGB codes of textures stand for; decoded16 may be null without such
  const uint8_t* background;  // [H / samples, 4], sRGB and alpha: of each row of the picture (background_rows)
  uint8_t* image;  // out: [views, H / samples, W / samples, channels], sRGB
  int channels;  // 3; or 4, with alpha, and then the background is transparent black
  bool streams;  // whether background is stored around the caches
  // out, or null: [views, H, W, 3]; 0 on the background, but `linear`, which has the background's colour.
  float *albedo, *normals, *linear;
};

// --- Variants

// A frame whose vertex indices have been checked: all lie in [lowest, highest], and both ends name vertices. Without
// triangles lowest > highest.
struct CheckedFrame : Frame {
  int64_t lowest, highest;
  const ShadeJob* shade = nullptr;  // the picture to be made by a variant that shades, or null; packed may then be null
  // Out, added to by a variant that counts, or null.
  int64_t* counters = nullptr;  // [kCounters] (core/counters.h)
  WorkMap* map = nullptr;  // where a single view's work is done
};

// Smallest and largest of count indices; (INT32_MAX, INT32_MIN) if count is 0.
void index_range(const Parallel& parallel, const int32_t* indices, int64_t count, int64_t* lowest, int64_t* highest);

// A way to schedule the work. All variants give the same bits. A variant is <name>.cpp, with what it needs
// beside it, and its name in variants.h.
struct Variant {
  const char* name;
  const char* paper;  // source of the design
  const Parameter* parameters;  // ends with a null name
  // Writes every pixel of every view, and dropped. values: one for each parameter, in their order.
  void (*draw)(const CheckedFrame& frame, const Parallel& parallel, const int64_t* values);
  bool shades;  // whether it makes the frame's picture, of samples that divide a bin, as it draws
};

// --- Stages one by one. Shapes and meaning of the arrays: docs/architecture.md, Stages; docs/numerics.md, 2.4.

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

// The stages whose loops are compiled once per instruction set. The caller of `depth`, which computes with floats, sets
// FloatMode (parallel.h).
struct StageKernels {
  void (*tile_mask)(const int32_t* xy, const int32_t* bbox, const int32_t* queue, int64_t count, int64_t* touched,
                    int64_t* full);
  // Write the spans of one queue entry, or of one small record, and return their number. An entry has at most 512 (64
  // tiles of 8 rows), a small record one per row of its bbox. xy and bbox are those of the one record.
  int64_t (*scan_tiles)(const int32_t* xy, const int32_t* bbox, const int32_t* entry, uint64_t touched, int32_t* spans);
  int64_t (*scan_rows)(const int32_t* xy, const int32_t* bbox, int32_t record, int32_t* spans);
  void (*depth)(const int32_t* xy, const float* z, const int64_t* area, const int32_t* spans, int64_t count,
                float* out);
};

struct Stages {
  void (*setup)(const CheckedFrame& frame, SetupOutput* out);
  void (*binning)(const int32_t* xy, const int32_t* bbox, int64_t records, int64_t threshold, BinningOutput* out);
  const StageKernels& (*kernels)();  // of the instruction set in use
};

// --- The attribute pass: interpolates vertex attributes at the pixels of a visibility buffer

struct AttributeJob {
  const int64_t* packed;  // [views, H, W], the visibility buffer
  const float* positions;  // [views, V, 4] or [V, 4], clip space
  int64_t position_view;  // floats from one view's positions to the next view's; 0 if all views share them
  int64_t vertices;  // V
  const int32_t* triangles;  // [T, 3], vertex indices
  int64_t triangle_count;  // T
  int64_t views;
  int height, width;  // px
  const float* attributes;  // [V, C] or [views, V, C]; null: out gets the barycentrics of the parent's corners
  int64_t attribute_view;  // floats from one view's attributes to the next view's; 0 if all views share them
  int64_t channels;  // C; 3 for barycentrics
  float* out;  // [views, H, W, channels]; 0 on the background
};

// --- Rungs

struct CpuRung {
  const char* name;
  int32_t guard;  // snapped coordinates lie in [-guard, guard), subpx
  const Variant* const* variants;  // the first is "auto"; ends with null
  const Variant* const* counting;  // the same variants, compiled with counters; null: the rung's work is not counted
  const Stages* stages;  // null: the rung's stages run on the reference alone
  void (*interpolate)(const AttributeJob& job, const Parallel& parallel);
  const ShadeKernels& (*shade_kernels)();  // of the instruction set in use
};

// All rungs, the default first; ends with a null name.
extern const CpuRung kCpuRungs[];

// --- Textures and shading, the same for every rung

// Code: float for linear light, uint8_t or uint16_t for sRGB codes.
template <class Code>
void sample(const Code* texture, int height, int width, int64_t channels, const float* uv, int64_t count, Filter filter,
            Wrap wrap, float* out, const Parallel& parallel);
void lambert(const float* normals, const float* albedo, const float* ambient, const float* directions,
             const float* colors, int64_t lights, int64_t count, float* out, const Parallel& parallel);
void encode_srgb(const float* linear, const float* thresholds, int64_t count, uint8_t* out, const Parallel& parallel);

// Shades a whole visibility buffer.
void shade_views(const ShadeJob& job, const Parallel& parallel);
// The views [first, first + count) of a job, as a job; packed is the caller's to set.
ShadeJob views_of(const ShadeJob& job, int64_t first, int64_t count);

// What ShadeJob::background points to, for a job that has all the rest.
std::vector<uint8_t> background_rows(const ShadeJob& job);

// What all sRGB codes of a type stand for, made when it is first asked for.
template <class Code>
const float* decoded();
// The table of the thresholds [255], the calling thread's until it asks for another.
const SrgbSteps& srgb_steps(const float* thresholds);

// --- Points to clip space

// points [count, 3], matrices [views, 4, 4], out [views, count, 4].
void transform(const float* points, const double* matrices, int64_t count, int64_t views, float* out,
               const Parallel& parallel);

}  // namespace bigtri

// The rungs of the precision ladder; docs/numerics.md 12 to 14. Mirrors bigtri/precision.py. Besides this file, only
// cpu/variants.h and cuda/variants.h name rungs, where they list the variants of each.
//
// A rung is a constant of the translation unit, as the instruction set is. Code that depends on the rung is compiled
// once per rung, with BIGTRI_RUNG defined as the rung's name, into an inline namespace of that name (numerics.h). So no
// function tests for the rung, and no template passes it along.
#pragma once

namespace bigtri {

// How it is decided which pixels a triangle covers.
enum class CoverageRule {
  kFixed,  // edge functions in integers
  kFloat32,  // in float32, of snapped vertices
  kFloat32Fused,  // with one product that is not rounded
  kFloat32Canonical,  // each edge in one direction for both of its triangles
  kFloat32Inclusive,  // of vertices that are not snapped, all >= 0
  kFloat32Strict,  // the same, all > 0
};

// Which bins and tiles are looked at.
enum class MaskRule { kCorners, kHalfTile, kBounds, kNone };

// What becomes of a triangle that crosses a plane.
enum class ClipRule { kExact, kFloat32, kNone };

// How attributes are weighted at a pixel.
enum class AttributeRule { kFloat64, kFloat32, kReciprocal, kAffine, kUnsnapped };

// How the depth of a pixel is computed and stored.
enum class DepthRule {
  kFloat64Cell,
  kFloat32Cell,
  kFloat32Vertex,
  kFloat32Barycentric,
  kFixedCell,
  kStored24,
  kStored16,
  kReversed,
};

namespace rungs {

struct exact {
  static constexpr int kSubpixelBits = 8;  // vertices snap to 1/256 px
  static constexpr CoverageRule kCoverage = CoverageRule::kFixed;
  static constexpr bool kWideEdges = false;  // whether an edge function needs int64 at a pixel, or is given it
  static constexpr bool kWraps = false;  // whether edge values are computed in int32, and wrap around
  static constexpr DepthRule kDepth = DepthRule::kFloat64Cell;
  static constexpr MaskRule kMask = MaskRule::kCorners;
  static constexpr ClipRule kClip = ClipRule::kExact;
  static constexpr AttributeRule kAttributes = AttributeRule::kFloat64;
  // Whether the rung has code of its own for drawing.
  static constexpr bool kDraws = true;
  // Whether the proofs that the variant bin_owned rests on hold, and its kernels are compiled.
  static constexpr bool kBinOwned = true;
};

// What rungs have in common that differ from exact in attributes alone. They draw the same visibility buffers, bit for
// bit, so it is exact's code that draws them (setup.py, variants.cpp, variants.cu); attributes are their own.
struct drawn_as_exact : exact {
  static constexpr bool kDraws = false;
  static constexpr bool kBinOwned = false;
};

struct balanced : drawn_as_exact {
  static constexpr AttributeRule kAttributes = AttributeRule::kFloat32;
};

struct fast : exact {
  static constexpr DepthRule kDepth = DepthRule::kFloat32Cell;
  static constexpr AttributeRule kAttributes = AttributeRule::kFloat32;
};

struct subpixel4 : exact {
  static constexpr int kSubpixelBits = 4;  // vertices snap to 1/16 px
};

// What the rungs of the ladder have in common: they are compared on the variant two_stage.
struct ladder : exact {
  static constexpr bool kBinOwned = false;
};

struct subpixel12 : ladder {
  static constexpr int kSubpixelBits = 12;
  static constexpr bool kWideEdges = true;
};
struct subpixel16 : ladder {
  static constexpr int kSubpixelBits = 16;
  static constexpr bool kWideEdges = true;
};
struct coverage_int64 : ladder {
  static constexpr bool kWideEdges = true;
};
struct coverage_int32 : ladder {
  static constexpr bool kWraps = true;
};
struct coverage_float32 : ladder {
  static constexpr CoverageRule kCoverage = CoverageRule::kFloat32;
};
struct coverage_float32_fused : ladder {
  static constexpr CoverageRule kCoverage = CoverageRule::kFloat32Fused;
};
struct coverage_float32_canonical : ladder {
  static constexpr CoverageRule kCoverage = CoverageRule::kFloat32Canonical;
};
struct coverage_float32_inclusive : ladder {
  static constexpr CoverageRule kCoverage = CoverageRule::kFloat32Inclusive;
};
struct coverage_float32_strict : ladder {
  static constexpr CoverageRule kCoverage = CoverageRule::kFloat32Strict;
};

struct depth_float32_cell : ladder {
  static constexpr DepthRule kDepth = DepthRule::kFloat32Cell;
};
struct depth_float32_vertex : ladder {
  static constexpr DepthRule kDepth = DepthRule::kFloat32Vertex;
};
struct depth_float32_barycentric : ladder {
  static constexpr DepthRule kDepth = DepthRule::kFloat32Barycentric;
};
struct depth_fixed_cell : ladder {
  static constexpr DepthRule kDepth = DepthRule::kFixedCell;
};
struct depth_stored24 : ladder {
  static constexpr DepthRule kDepth = DepthRule::kStored24;
};
struct depth_stored16 : ladder {
  static constexpr DepthRule kDepth = DepthRule::kStored16;
};
struct depth_reversed : ladder {
  static constexpr DepthRule kDepth = DepthRule::kReversed;
};

struct mask_half_tile : ladder {
  static constexpr MaskRule kMask = MaskRule::kHalfTile;
};
struct mask_bounds : ladder {
  static constexpr MaskRule kMask = MaskRule::kBounds;
};
struct mask_none : ladder {
  static constexpr MaskRule kMask = MaskRule::kNone;
};

struct clip_float32 : ladder {
  static constexpr ClipRule kClip = ClipRule::kFloat32;
};
struct clip_none : ladder {
  static constexpr ClipRule kClip = ClipRule::kNone;
};

struct attributes_float32 : drawn_as_exact {
  static constexpr AttributeRule kAttributes = AttributeRule::kFloat32;
};
struct attributes_reciprocal : drawn_as_exact {
  static constexpr AttributeRule kAttributes = AttributeRule::kReciprocal;
};
struct attributes_affine : drawn_as_exact {
  static constexpr AttributeRule kAttributes = AttributeRule::kAffine;
};
struct attributes_unsnapped : drawn_as_exact {
  static constexpr AttributeRule kAttributes = AttributeRule::kUnsnapped;
};

}  // namespace rungs
}  // namespace bigtri

// The rungs that are for drawing, presets first and of these the default; their work can be counted (counters.h).
#define BIGTRI_RUNGS(X) X(exact) X(balanced) X(fast) X(subpixel4)

// The rungs that show what an axis costs. Only a build with BIGTRI_LADDER=1 has them (setup.py).
// clang-format off
#define BIGTRI_LADDER(X) \
  X(subpixel12) X(subpixel16) X(coverage_int64) X(coverage_int32) X(coverage_float32) X(coverage_float32_fused) \
  X(coverage_float32_canonical) X(coverage_float32_inclusive) X(coverage_float32_strict) \
  X(depth_float32_cell) X(depth_float32_vertex) X(depth_float32_barycentric) X(depth_fixed_cell) \
  X(depth_stored24) X(depth_stored16) X(depth_reversed) \
  X(mask_half_tile) X(mask_bounds) X(mask_none) \
  X(clip_float32) X(clip_none) \
  X(attributes_float32) X(attributes_reciprocal) X(attributes_affine) X(attributes_unsnapped)
// clang-format on

// Argument checks of the attribute pass (interpolation, textures, shading). CPU and CUDA share them: `device` is kCpu,
// or the CUDA device that all tensors must be on.
#pragma once

#include "../core/texture.h"
#include "checks.h"

namespace bigtri {

constexpr int64_t kMaxTexture = 65536;  // px a side: texel coordinates stay exact in float32 and int32

// Whether all views have the same attributes: [V, C] or [1, V, C].
inline bool attributes_shared(const Tensor& attributes) { return attributes.dim() == 2 || attributes.size(0) == 1; }

// A buffer [H, W] is one view, with positions [V, 4]; [B, H, W] goes with positions [B, V, 4], or [V, 4] that all views
// share. attributes is null for the operator `barycentrics`.
inline void check_interpolation(const char* op, int device, const Tensor& packed, const Tensor& positions,
                                const Tensor& triangles, const Tensor* attributes, const Tensor& out) {
  const bool single = packed.defined() && packed.dim() == 2;
  const char* wanted = "int64 [H, W] or [B, H, W]";
  if (single)
    check_on(op, "packed", packed, device, ScalarType::Long, {-1, -1}, wanted);
  else
    check_on(op, "packed", packed, device, ScalarType::Long, {-1, -1, -1}, wanted);
  const int64_t views = single ? 1 : packed.size(0), height = packed.size(-2), width = packed.size(-1);
  if (single)
    check_on(op, "positions", positions, device, ScalarType::Float, {-1, 4}, "float32 [V, 4], as packed is [H, W]");
  else if (positions.defined() && positions.dim() == 2)
    check_on(op, "positions", positions, device, ScalarType::Float, {-1, 4}, "float32 [V, 4] or [B, V, 4]");
  else
    check_on(op, "positions", positions, device, ScalarType::Float, {views, -1, 4}, "float32 [V, 4] or [B, V, 4]");
  check_on(op, "triangles", triangles, device, ScalarType::Int, {-1, 3}, "int32 [T, 3]");
  check_count(op, "triangles", triangles.size(0));
  if (packed.numel()) check_size(op, height, width);
  int64_t channels = 3;
  if (attributes) {
    const char* allowed = "float32 [V, C] or [B or 1, V, C]";
    if (attributes->defined() && attributes->dim() == 2)
      check_on(op, "attributes", *attributes, device, ScalarType::Float, {-1, -1}, allowed);
    else
      check_on(op, "attributes", *attributes, device, ScalarType::Float, {-1, -1, -1}, allowed);
    BIGTRI_CHECK(
        (attributes_shared(*attributes) || attributes->size(0) == views) && attributes->size(-2) == positions.size(-2),
        "bigtri::", op, ": attributes must be ", allowed, " with B of packed and V of positions, ", describe(positions),
        ", got ", describe(*attributes));
    channels = attributes->size(-1);
  }
  if (single)
    check_on(op, "out", out, device, ScalarType::Float, {height, width, channels}, "float32 [H, W, C]");
  else
    check_on(op, "out", out, device, ScalarType::Float, {views, height, width, channels}, "float32 [B, H, W, C]");
  check_apart(op, "out", out, "packed", packed);
  check_apart(op, "out", out, "positions", positions);
  check_apart(op, "out", out, "triangles", triangles);
  if (attributes) check_apart(op, "out", out, "attributes", *attributes);
}

// Checks a tensor float32 [..., last] that has as many rows as `like`, and in the same dimensions; `like` may be the
// tensor itself.
inline void check_rows(const char* op, const char* name, const Tensor& t, int device, const Tensor& like, int64_t last,
                       const char* wanted) {
  std::vector<int64_t> shape(like.sizes().begin(), like.sizes().end());
  shape.resize(shape.empty() ? 1 : shape.size());
  shape.back() = last;
  check_on(op, name, t, device, ScalarType::Float, shape, wanted);
}

// The type of a texture's texels: float32 where it is none of those that are allowed.
inline ScalarType texel_type(const Tensor& texture) {
  const auto type = texture.defined() ? type_of(texture) : std::nullopt;
  return type == ScalarType::Byte || type == ScalarType::UInt16 ? *type : ScalarType::Float;
}

inline void check_sample(int device, const Tensor& texture, const Tensor& uv, const std::string& filter,
                         const std::string& wrap, const Tensor& out) {
  const char* op = "sample_texture";
  check_on(op, "texture", texture, device, texel_type(texture), {-1, -1, -1}, "float32, uint8 or uint16 [Ht, Wt, C]");
  check_rows(op, "uv", uv, device, uv, 2, "float32 [..., 2]");
  const int64_t height = texture.size(0), width = texture.size(1);
  BIGTRI_CHECK(height >= 1 && height <= kMaxTexture && width >= 1 && width <= kMaxTexture,
               "bigtri::sample_texture: texture must be 1 to ", kMaxTexture, " px a side, got ", describe(texture));
  BIGTRI_CHECK(filter == "nearest" || filter == "bilinear",
               "bigtri::sample_texture: filter must be 'nearest' or 'bilinear', got '", filter, "'");
  BIGTRI_CHECK(wrap == "repeat" || wrap == "clamp", "bigtri::sample_texture: wrap must be 'repeat' or 'clamp', got '",
               wrap, "'");
  check_rows(op, "out", out, device, uv, texture.size(2), "float32 [..., C]");
  check_apart(op, "out", out, "texture", texture);
  check_apart(op, "out", out, "uv", uv);
}

// Calls body with the texels of a texture that has passed check_sample, a pointer to their type.
template <class Body>
void with_texels(const Tensor& texture, const Body& body) {
  switch (texel_type(texture)) {
    case ScalarType::Byte: return body(const_data<uint8_t>(texture));
    case ScalarType::UInt16: return body(const_data<uint16_t>(texture));
    default: return body(const_data<float>(texture));
  }
}

// The name must have passed check_sample.
inline Filter filter_of(const std::string& name) { return name == "nearest" ? Filter::kNearest : Filter::kBilinear; }
inline Wrap wrap_of(const std::string& name) { return name == "repeat" ? Wrap::kRepeat : Wrap::kClamp; }

inline void check_lambert(int device, const Tensor& normals, const Tensor& albedo, const Tensor& ambient,
                          const Tensor& directions, const Tensor& colors, const Tensor& out) {
  const char* op = "lambert";
  check_rows(op, "normals", normals, device, normals, 3, "float32 [..., 3]");
  check_rows(op, "albedo", albedo, device, normals, 3, "float32 [..., 3] of normals' shape");
  check_on(op, "ambient", ambient, device, ScalarType::Float, {3}, "float32 [3]");
  check_on(op, "light_directions", directions, device, ScalarType::Float, {-1, 3}, "float32 [L, 3]");
  check_on(op, "light_colors", colors, device, ScalarType::Float, {directions.size(0), 3}, "float32 [L, 3]");
  check_rows(op, "out", out, device, normals, 3, "float32 [..., 3] of normals' shape");
  check_apart(op, "out", out, "normals", normals);
  check_apart(op, "out", out, "albedo", albedo);
  check_apart(op, "out", out, "ambient", ambient);
  check_apart(op, "out", out, "light_directions", directions);
  check_apart(op, "out", out, "light_colors", colors);
}

// linear may have any shape. thresholds stay on the CPU: a kernel gets them by value, as a launch parameter.
inline void check_encode(int device, const Tensor& linear, const Tensor& thresholds, const Tensor& out) {
  const char* op = "encode_srgb";
  check_on(op, "linear", linear, device, ScalarType::Float, linear.sizes(), "float32");
  check(op, "thresholds", thresholds, ScalarType::Float, {255}, "float32 [255]");
  check_on(op, "out", out, device, ScalarType::Byte, linear.sizes(), "uint8 of linear's shape");
  check_apart(op, "out", out, "linear", linear);
}

}  // namespace bigtri

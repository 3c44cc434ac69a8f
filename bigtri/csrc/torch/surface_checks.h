// Argument checks of the operators that shade: CPU and CUDA share them. `device` is kCpu, or the CUDA device that all
// tensors must be on but `constants`.
#pragma once

#include <algorithm>
#include <utility>

#include "../core/surface.h"
#include "attribute_checks.h"

namespace bigtri {

// What a scene looks like, as the operators get it; docs/numerics.md 18. Tensors that are None leave an effect out.
struct SurfaceTensors {
  const std::optional<Tensor>&uvs, &colors, &normals, &face_normals;
  const Tensor &material, &looks, &base_colors;
  const std::vector<Tensor>& textures;
  const Tensor &light_directions, &light_colors, &constants;
  bool two_sided;
};

// A texture's own checks, as those of sample_texture, with three channels.
inline Texture checked_texture(const char* op, int device, const Tensor& t) {
  const ScalarType type = texel_type(t);
  check_on(op, "textures", t, device, type, {-1, -1, 3}, "each float32, uint8 or uint16 [Ht, Wt, 3]");
  const int64_t height = t.size(0), width = t.size(1);
  BIGTRI_CHECK(height >= 1 && height <= kMaxTexture && width >= 1 && width <= kMaxTexture, "bigtri::", op,
               ": textures must be 1 to ", kMaxTexture, " px a side each, got ", describe(t));
  const Texels kind = type == ScalarType::Byte     ? Texels::kCodes8
                      : type == ScalarType::UInt16 ? Texels::kCodes16
                                                   : Texels::kLinear;
  return {t.const_data_ptr(), (int32_t)height, (int32_t)width, kind};
}

// Fills a surface for positions of V vertices and T triangles. `textures` gets the surface's textures and must outlive it.
// Indices in material and looks are not looked at here.
inline Surface checked_surface(const char* op, int device, const SurfaceTensors& s, int64_t vertices, int64_t triangles,
                               std::vector<Texture>* textures) {
  Surface surface = {};
  const auto attribute = [&](const char* name, const std::optional<Tensor>& t, int64_t rows, int64_t channels,
                             const char* wanted) -> const float* {
    if (!t) return nullptr;
    check_on(op, name, *t, device, ScalarType::Float, {rows, channels}, wanted);
    return const_data<float>(*t);
  };
  surface.uvs = attribute("uvs", s.uvs, vertices, 2, "float32 [V, 2]");
  surface.colors = attribute("colors", s.colors, vertices, 3, "float32 [V, 3]");
  surface.normals = attribute("normals", s.normals, vertices, 3, "float32 [V, 3]");
  surface.face_normals = attribute("face_normals", s.face_normals, triangles, 3, "float32 [T, 3]");
  check_on(op, "material", s.material, device, ScalarType::Int, {triangles}, "int32 [T]");
  check_on(op, "looks", s.looks, device, ScalarType::Int, {-1, 2}, "int32 [M, 2]");
  check_on(op, "base_colors", s.base_colors, device, ScalarType::Float, {s.looks.size(0), 3}, "float32 [M, 3]");
  check_count(op, "looks", s.looks.size(0));
  check_on(op, "light_directions", s.light_directions, device, ScalarType::Float, {-1, 3}, "float32 [L, 3]");
  check_on(op, "light_colors", s.light_colors, device, ScalarType::Float, {s.light_directions.size(0), 3},
           "float32 [L, 3]");
  check(op, "constants", s.constants, ScalarType::Float, {3, 3},
        "float32 [3, 3]: ambient light, background at the top, at the bottom");
  for (const Tensor& t : s.textures) textures->push_back(checked_texture(op, device, t));
  static_assert(sizeof(Look) == 2 * sizeof(int32_t), "a row of looks");
  surface.material = const_data<int32_t>(s.material);
  surface.looks = static_cast<const Look*>(s.looks.const_data_ptr());
  surface.base_colors = const_data<float>(s.base_colors);
  surface.textures = textures->data();
  surface.materials = (int32_t)s.looks.size(0);
  surface.texture_count = (int32_t)textures->size();
  surface.two_sided = s.two_sided;
  surface.light_directions = const_data<float>(s.light_directions);
  surface.light_colors = const_data<float>(s.light_colors);
  surface.lights = s.light_directions.size(0);
  const float* constants = const_data<float>(s.constants);
  std::copy_n(constants, 3, surface.ambient);
  std::copy_n(constants + 3, 3, surface.top);
  std::copy_n(constants + 6, 3, surface.bottom);
  return surface;
}

// Throws if a material or a texture of a surface on the CPU is none of those that there are.
inline void check_surface_indices(const char* op, const Parallel& parallel, const Surface& surface, int64_t triangles) {
  int64_t low = 0, high = -1;
  if (triangles) index_range(parallel, surface.material, triangles, &low, &high);
  BIGTRI_CHECK(low >= 0 && high < surface.materials, "bigtri::", op, ": material must index the ", surface.materials,
               " rows of looks, got indices from ", low, " to ", high);
  for (int32_t i = 0; i < surface.materials; ++i)
    BIGTRI_CHECK(surface.looks[i].texture >= -1 && surface.looks[i].texture < surface.texture_count, "bigtri::", op,
                 ": looks must name one of the ", surface.texture_count, " textures or -1, got ",
                 surface.looks[i].texture, " in row ", i);
}

// The picture and what it was made from; docs/numerics.md 18.
struct PictureTensors {
  const Tensor& image;
  const std::optional<Tensor>&albedo, &normals, &linear;
};

// height and width: of the visibility buffer. Returns how many samples a pixel of the image has along each axis.
inline int64_t checked_picture(const char* op, int device, const PictureTensors& p, int64_t views, int64_t height,
                               int64_t width) {
  const char* wanted = "uint8 [B, H, W, 3] or [B, H, W, 4]";
  check_on(op, "image", p.image, device, ScalarType::Byte, {views, -1, -1, -1}, wanted);
  const int64_t rows = p.image.size(1), columns = p.image.size(2), channels = p.image.size(3);
  const int64_t samples = rows ? height / rows : 0;
  BIGTRI_CHECK(
      (channels == 3 || channels == 4) && samples >= 1 && rows * samples == height && columns * samples == width,
      "bigtri::", op, ": image must be ", wanted, " with H and W those of packed divided by the samples, ", height,
      " and ", width, ", got ", describe(p.image));
  for (const auto& [name, t] : {std::pair<const char*, const std::optional<Tensor>&>{"albedo", p.albedo},
                                {"normal_image", p.normals},
                                {"linear", p.linear}})
    if (t) check_on(op, name, *t, device, ScalarType::Float, {views, height, width, 3}, "float32 [B, H, W, 3]");
  return samples;
}

// No output may overlap an input or another output.
inline void check_picture_apart(const char* op, const PictureTensors& p, const SurfaceTensors& s,
                                const std::vector<std::pair<const char*, const Tensor*>>& inputs) {
  std::vector<std::pair<const char*, const Tensor*>> outputs = {{"image", &p.image}}, all = inputs;
  for (const auto& [name, t] : {std::pair<const char*, const std::optional<Tensor>&>{"albedo", p.albedo},
                                {"normal_image", p.normals},
                                {"linear", p.linear}})
    if (t) outputs.push_back({name, &*t});
  for (const auto& [name, t] : {std::pair<const char*, const std::optional<Tensor>&>{"uvs", s.uvs},
                                {"colors", s.colors},
                                {"normals", s.normals},
                                {"face_normals", s.face_normals}})
    if (t) all.push_back({name, &*t});
  for (const auto& [name, t] : {std::pair<const char*, const Tensor&>{"material", s.material},
                                {"looks", s.looks},
                                {"base_colors", s.base_colors},
                                {"light_directions", s.light_directions},
                                {"light_colors", s.light_colors},
                                {"constants", s.constants}})
    all.push_back({name, &t});
  for (const Tensor& t : s.textures) all.push_back({"textures", &t});
  for (const auto& [name, output] : outputs) {
    for (const auto& [input_name, input] : all) check_apart(op, name, *output, input_name, *input);
    all.push_back({name, output});
  }
}

// What a picture is drawn from, and what drawing leaves beside it.
struct DrawnTensors {
  const Tensor &positions, &triangles;
  const std::optional<Tensor>&packed, &depth;
  const Tensor& dropped;
};

// height and width: of the visibility buffer.
inline void check_drawn(const char* op, int device, const DrawnTensors& d, int64_t height, int64_t width) {
  check_on(op, "positions", d.positions, device, ScalarType::Float, {-1, -1, 4}, "float32 [B, V, 4]");
  const int64_t views = d.positions.size(0);
  check_count(op, "positions", views);
  check_on(op, "triangles", d.triangles, device, ScalarType::Int, {-1, 3}, "int32 [T, 3]");
  if (d.packed)
    check_on(op, "packed", *d.packed, device, ScalarType::Long, {views, height, width}, "int64 [B, height, width]");
  if (d.depth)
    check_on(op, "depth", *d.depth, device, ScalarType::Float, {views, height, width}, "float32 [B, height, width]");
  check_on(op, "dropped", d.dropped, device, ScalarType::Long, {views}, "int64 [B]");
}

// No output of drawing and shading may overlap an input of drawing or another output.
inline void check_drawn_apart(const char* op, const DrawnTensors& d, const PictureTensors& p) {
  std::vector<std::pair<const char*, const Tensor*>> outputs = {{"image", &p.image}, {"dropped", &d.dropped}};
  for (const auto& [name, t] : {std::pair<const char*, const std::optional<Tensor>&>{"albedo", p.albedo},
                                {"normal_image", p.normals},
                                {"linear", p.linear},
                                {"packed", d.packed},
                                {"depth", d.depth}})
    if (t) outputs.push_back({name, &*t});
  for (size_t i = 0; i < outputs.size(); ++i) {
    for (const Tensor* input : {&d.positions, &d.triangles})
      check_apart(op, outputs[i].first, *outputs[i].second, "an input", *input);
    for (size_t k = 0; k < i; ++k)
      check_apart(op, outputs[i].first, *outputs[i].second, outputs[k].first, *outputs[k].second);
  }
}

}  // namespace bigtri

// The operator of the shading pass on the CPU: from a visibility buffer to a picture.

#include "registry.h"
#include "surface_checks.h"

namespace bigtri {
namespace {

// packed int64 [B, H, W]; positions float32 [B, V, 4], or [V, 4] that all views share.
void shade_op(const Tensor& packed, const Tensor& positions, const Tensor& triangles, const std::optional<Tensor>& uvs,
              const std::optional<Tensor>& colors, const std::optional<Tensor>& normals,
              const std::optional<Tensor>& face_normals, const Tensor& material, const Tensor& looks,
              const Tensor& base_colors, const std::vector<Tensor>& textures, const Tensor& light_directions,
              const Tensor& light_colors, const Tensor& constants, bool two_sided, const Tensor& thresholds,
              const std::string& precision, const Tensor& image, const std::optional<Tensor>& albedo,
              const std::optional<Tensor>& normal_image, const std::optional<Tensor>& linear) {
  const char* op = "shade";
  const CpuRung& rung = find_rung(op, kCpuRungs, precision);
  check(op, "packed", packed, ScalarType::Long, {-1, -1, -1}, "int64 [B, H, W]");
  const int64_t views = packed.size(0), height = packed.size(1), width = packed.size(2);
  if (positions.defined() && positions.dim() == 2)
    check(op, "positions", positions, ScalarType::Float, {-1, 4}, "float32 [V, 4] or [B, V, 4]");
  else
    check(op, "positions", positions, ScalarType::Float, {views, -1, 4}, "float32 [V, 4] or [B, V, 4]");
  check(op, "triangles", triangles, ScalarType::Int, {-1, 3}, "int32 [T, 3]");
  check_size(op, height, width);
  check(op, "thresholds", thresholds, ScalarType::Float, {255}, "float32 [255]");
  const SurfaceTensors surface = {uvs, colors, normals, face_normals, material, looks, base_colors, textures, light_directions, light_colors, constants, two_sided};
  const PictureTensors picture = {image, albedo, normal_image, linear};
  std::vector<Texture> kept;
  ShadeJob job = {};
  job.surface = checked_surface(op, kCpu, surface, positions.size(-2), triangles.size(0), &kept);
  job.samples = (int)checked_picture(op, kCpu, picture, views, height, width);
  check_picture_apart(op, picture, surface, {{"packed", &packed}, {"positions", &positions}, {"triangles", &triangles}});
  const Parallel parallel = torch_threads();
  checked_frame(op, parallel, triangles, positions.size(-2));
  check_surface_indices(op, parallel, job.surface, triangles.size(0));
  job.packed = const_data<int64_t>(packed);
  job.positions = const_data<float>(positions);
  job.position_view = positions.dim() == 2 ? 0 : positions.size(-2) * 4;
  job.triangles = const_data<int32_t>(triangles);
  job.triangle_count = triangles.size(0);
  job.views = views;
  job.height = (int)height;
  job.width = (int)width;
  job.srgb = &srgb_table(const_data<float>(thresholds));
  job.decoded8 = decoded<uint8_t>();
  job.decoded16 = decoded<uint16_t>();
  job.image = data<uint8_t>(image);
  job.channels = (int)image.size(3);
  job.albedo = albedo ? data<float>(*albedo) : nullptr;
  job.normals = normal_image ? data<float>(*normal_image) : nullptr;
  job.linear = linear ? data<float>(*linear) : nullptr;
  rung.shade(job, parallel);
}

}  // namespace
}  // namespace bigtri

STABLE_TORCH_LIBRARY_IMPL(bigtri, CPU, m) { m.impl("shade", TORCH_BOX(&bigtri::shade_op)); }

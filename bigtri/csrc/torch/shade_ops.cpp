// The operators that make pictures on the CPU: `shade`, of a visibility buffer, and `draw`, of triangles.

#include <memory>

#include "frames.h"
#include "registry.h"
#include "surface_checks.h"

namespace bigtri {
namespace {

// Bytes of pictures that stay in a last-level cache from one call to the next.
constexpr int64_t kPicturesInCache = 1 << 24;

// A job and what it points to.
struct CheckedShading {
  std::vector<Texture> textures;
  std::vector<uint8_t> background;
  ShadeJob job = {};
};

// Checks the surface and the picture against positions [B, V, 4] and triangles, whose indices have been checked, and fills
// the job but for packed. height and width: those of the visibility buffer.
void check_shading(const char* op, const CpuRung& rung, const Tensor& positions, const Tensor& triangles,
                   int64_t height, int64_t width, const SurfaceTensors& surface, const Tensor& thresholds,
                   const PictureTensors& picture, CheckedShading* out) {
  const Parallel parallel = torch_threads();
  ShadeJob& job = out->job;
  const int64_t views = positions.size(0);
  job.kernels = &rung.shade_kernels();
  job.surface = checked_surface(op, kCpu, surface, positions.size(1), triangles.size(0), &out->textures);
  check(op, "thresholds", thresholds, ScalarType::Float, {255}, "float32 [255]");
  job.samples = (int)checked_picture(op, kCpu, picture, views, height, width);
  check_picture_apart(op, picture, surface, {{"positions", &positions}, {"triangles", &triangles}});
  check_surface_indices(op, parallel, job.surface, triangles.size(0));
  job.positions = const_data<float>(positions);
  job.position_view = positions.size(1) * 4;
  job.triangles = const_data<int32_t>(triangles);
  job.triangle_count = triangles.size(0);
  job.views = views;
  job.height = (int)height;
  job.width = (int)width;
  job.srgb = &srgb_steps(const_data<float>(thresholds));
  job.decoded8 = decoded<uint8_t>();
  job.decoded16 = decoded<uint16_t>();
  job.image = data<uint8_t>(picture.image);
  job.channels = (int)picture.image.size(3);
  job.streams = picture.image.numel() > kPicturesInCache;
  job.albedo = picture.albedo ? data<float>(*picture.albedo) : nullptr;
  job.normals = picture.normals ? data<float>(*picture.normals) : nullptr;
  job.linear = picture.linear ? data<float>(*picture.linear) : nullptr;
  out->background = background_rows(job);
  job.background = out->background.data();
}

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
  check(op, "positions", positions, ScalarType::Float, {packed.size(0), -1, 4}, "float32 [B, V, 4]");
  check(op, "triangles", triangles, ScalarType::Int, {-1, 3}, "int32 [T, 3]");
  check_count(op, "triangles", triangles.size(0));
  check_size(op, packed.size(1), packed.size(2));
  const Parallel parallel = torch_threads();
  checked_indices(op, parallel, triangles, positions.size(1));
  CheckedShading shading;
  check_shading(op, rung, positions, triangles, packed.size(1), packed.size(2),
                {uvs, colors, normals, face_normals, material, looks, base_colors, textures, light_directions,
                 light_colors, constants, two_sided},
                thresholds, {image, albedo, normal_image, linear}, &shading);
  for (const auto& output : {std::optional<Tensor>(image), albedo, normal_image, linear})
    if (output) check_apart(op, "an output", *output, "packed", packed);
  shading.job.packed = const_data<int64_t>(packed);
  shade_views(shading.job, parallel);
}

// height and width are those of the samples. packed and depth are written where they are not None. fills: as on CUDA, where
// it decides how much of the picture is looked at; here each bin is looked at where it is drawn.
void draw_op(const Tensor& positions, const Tensor& triangles, int64_t height, int64_t width, const std::string& cull,
             const std::optional<Tensor>& uvs, const std::optional<Tensor>& colors,
             const std::optional<Tensor>& normals, const std::optional<Tensor>& face_normals, const Tensor& material,
             const Tensor& looks, const Tensor& base_colors, const std::vector<Tensor>& textures,
             const Tensor& light_directions, const Tensor& light_colors, const Tensor& constants, bool two_sided,
             const Tensor& thresholds, const std::string& precision, const std::vector<int64_t>& parameters,
             const Tensor& image, const std::optional<Tensor>& albedo, const std::optional<Tensor>& normal_image,
             const std::optional<Tensor>& linear, const std::optional<Tensor>& packed,
             const std::optional<Tensor>& depth, const Tensor& dropped, [[maybe_unused]] bool fills) {
  const char* op = "draw";
  const Viewport view = viewport(op, height, width, cull);
  const CpuRung& rung = find_rung(op, kCpuRungs, precision);
  const Variant& variant = **rung.variants;
  const std::vector<int64_t> values = checked_parameters(op, variant, parameters);
  const DrawnTensors drawn = {positions, triangles, packed, depth, dropped};
  check_drawn(op, kCpu, drawn, height, width);
  const Parallel parallel = torch_threads();
  CheckedFrame frame = checked_frame(op, parallel, view, (int32_t)positions.size(0), positions, triangles);
  set_results(&frame, packed ? &*packed : nullptr, depth, dropped);
  CheckedShading shading;
  check_shading(op, rung, positions, triangles, height, width,
                {uvs, colors, normals, face_normals, material, looks, base_colors, textures, light_directions,
                 light_colors, constants, two_sided},
                thresholds, {image, albedo, normal_image, linear}, &shading);
  check_drawn_apart(op, drawn, {image, albedo, normal_image, linear});
  // A variant that does not shade, or pixels of samples that do not divide a bin: by way of the visibility buffer.
  const bool fused = variant.shades && kBin % shading.job.samples == 0;
  std::unique_ptr<int64_t[]> buffer;
  if (!packed && !fused) {
    buffer.reset(new int64_t[(size_t)max_of<int64_t>(frame.views * height * width, 1)]);
    frame.packed = buffer.get();
  }
  frame.shade = fused ? &shading.job : nullptr;
  variant.draw(frame, parallel, values.data());
  if (fused) return;
  shading.job.packed = frame.packed;
  shade_views(shading.job, parallel);
}

}  // namespace
}  // namespace bigtri

STABLE_TORCH_LIBRARY_IMPL(bigtri, CPU, m) {
  m.impl("shade", TORCH_BOX(&bigtri::shade_op));
  m.impl("draw", TORCH_BOX(&bigtri::draw_op));
}

// The operators that make pictures on CUDA: `shade`, of a visibility buffer, and `draw`, of triangles. None waits for the
// device.

#include "cuda.h"
#include "../cuda/areas.h"
#include "frames.h"
#include "side_stream.h"
#include "surface_checks.h"

namespace bigtri {
namespace {

// A job and what it points to in host memory.
struct CheckedShading {
  std::vector<Texture> textures;
  Shading job = {};
};

// Checks the surface and the picture against positions [B, V, 4] and triangles, and fills the job but for packed. height
// and width: those of the visibility buffer.
void check_shading(const char* op, int device, const Tensor& positions, const Tensor& triangles, int64_t height,
                   int64_t width, const SurfaceTensors& surface, const Tensor& thresholds,
                   const PictureTensors& picture, CheckedShading* out) {
  Shading& job = out->job;
  job.views = positions.size(0);
  job.surface = checked_surface(op, device, surface, positions.size(1), triangles.size(0), &out->textures);
  check(op, "thresholds", thresholds, ScalarType::Float, {255}, "float32 [255]");
  job.samples = (int)checked_picture(op, device, picture, job.views, height, width);
  check_picture_apart(op, picture, surface, {{"positions", &positions}, {"triangles", &triangles}});
  job.positions = const_data<float>(positions);
  job.vertices = positions.size(1);
  job.triangles = const_data<int32_t>(triangles);
  job.count = (int32_t)triangles.size(0);
  job.height = (int)height;
  job.width = (int)width;
  job.thresholds = const_data<float>(thresholds);
  job.image = data<uint8_t>(picture.image);
  job.channels = (int)picture.image.size(3);
  job.albedo = picture.albedo ? data<float>(*picture.albedo) : nullptr;
  job.normals = picture.normals ? data<float>(*picture.normals) : nullptr;
  job.linear = picture.linear ? data<float>(*picture.linear) : nullptr;
}

void shade_cuda_op(const Tensor& packed, const Tensor& positions, const Tensor& triangles,
                   const std::optional<Tensor>& uvs, const std::optional<Tensor>& colors,
                   const std::optional<Tensor>& normals, const std::optional<Tensor>& face_normals,
                   const Tensor& material, const Tensor& looks, const Tensor& base_colors,
                   const std::vector<Tensor>& textures, const Tensor& light_directions, const Tensor& light_colors,
                   const Tensor& constants, bool two_sided, const Tensor& thresholds, const std::string& precision,
                   const Tensor& image, const std::optional<Tensor>& albedo, const std::optional<Tensor>& normal_image,
                   const std::optional<Tensor>& linear) {
  const char* op = "shade";
  const CudaRung& rung = find_rung(op, kCudaRungs, precision);
  const int device = device_of({&packed, &positions, &triangles, &image});
  check_on(op, "packed", packed, device, ScalarType::Long, {-1, -1, -1}, "int64 [B, H, W]");
  check_on(op, "positions", positions, device, ScalarType::Float, {packed.size(0), -1, 4}, "float32 [B, V, 4]");
  check_on(op, "triangles", triangles, device, ScalarType::Int, {-1, 3}, "int32 [T, 3]");
  check_count(op, "triangles", triangles.size(0));
  check_count(op, "positions", positions.size(0));
  check_size(op, packed.size(1), packed.size(2));
  CheckedShading shading;
  check_shading(op, device, positions, triangles, packed.size(1), packed.size(2),
                {uvs, colors, normals, face_normals, material, looks, base_colors, textures, light_directions,
                 light_colors, constants, two_sided},
                thresholds, {image, albedo, normal_image, linear}, &shading);
  for (const auto& output : {std::optional<Tensor>(image), albedo, normal_image, linear})
    if (output) check_apart(op, "an output", *output, "packed", packed);
  shading.job.packed = const_data<int64_t>(packed);
  if (shading.job.views == 0) return;
  const CurrentDevice current(device);
  const WorkingMemory scratch(rung.shading_scratch(shading.job));
  check_launch(op, rung.begin_shading(shading.job, scratch.data(), current_stream(device)));
  check_launch(op, rung.shade(shading.job, scratch.data(), current_stream(device)));
}

// height and width are those of the samples. packed and depth are written where they are not None. fills: whether triangles
// probably touch most of the picture, so that looking for areas without any would take longer than it spares; no bit of
// the picture depends on it.
void draw_cuda_op(const Tensor& positions, const Tensor& triangles, int64_t height, int64_t width,
                  const std::string& cull, const std::optional<Tensor>& uvs, const std::optional<Tensor>& colors,
                  const std::optional<Tensor>& normals, const std::optional<Tensor>& face_normals,
                  const Tensor& material, const Tensor& looks, const Tensor& base_colors,
                  const std::vector<Tensor>& textures, const Tensor& light_directions, const Tensor& light_colors,
                  const Tensor& constants, bool two_sided, const Tensor& thresholds, const std::string& precision,
                  const std::vector<int64_t>& parameters, const Tensor& image, const std::optional<Tensor>& albedo,
                  const std::optional<Tensor>& normal_image, const std::optional<Tensor>& linear,
                  const std::optional<Tensor>& packed, const std::optional<Tensor>& depth, const Tensor& dropped,
                  bool fills) {
  const char* op = "draw";
  const Viewport view = viewport(op, height, width, cull);
  const CudaRung& rung = find_rung(op, kCudaRungs, precision);
  const CudaVariant& variant = **rung.variants;
  const int device = device_of({&positions, &triangles, &image});
  const DrawnTensors drawn = {positions, triangles, packed, depth, dropped};
  check_drawn(op, device, drawn, height, width);
  Frame frame = frame_of(op, view, (int32_t)positions.size(0), positions, triangles);
  set_results(&frame, packed ? &*packed : nullptr, depth, dropped);
  CheckedShading shading;
  check_shading(op, device, positions, triangles, height, width,
                {uvs, colors, normals, face_normals, material, looks, base_colors, textures, light_directions,
                 light_colors, constants, two_sided},
                thresholds, {image, albedo, normal_image, linear}, &shading);
  check_drawn_apart(op, drawn, {image, albedo, normal_image, linear});
  if (frame.views == 0) return;
  const CurrentDevice current(device);
  const cudaStream_t stream = current_stream(device);
  // Memory lives longer than the side stream, at whose end this stream has waited for it.
  const WorkingMemory buffer(packed ? 0 : frame.views * height * width * (int64_t)sizeof(int64_t));
  if (!packed) frame.packed = static_cast<int64_t*>(buffer.data());
  const std::vector<int64_t> values = checked_parameters(op, variant, parameters);
  const bool seen = packed || depth;  // by the caller
  const bool lists_areas = !seen && !fills && height * width >= kSamplesOfAreas && variant.lists_areas &&
                           variant.lists_areas(frame, values.data()) && rung.shades_areas(shading.job);
  const int samples = shading.job.samples;
  const WorkingMemory areas(lists_areas ? areas_bytes((int)width / samples, (int)height / samples, frame.views) : 0);
  if (lists_areas) frame.area_samples = samples;
  frame.areas = shading.job.areas = areas.data();
  const WorkingMemory drawing(variant.scratch_bytes(frame, values.data()));
  shading.job.packed = frame.packed;
  shading.job.fills = fills;
  const WorkingMemory scratch(rung.shading_scratch(shading.job));
  SideStream side(op, device, stream);
  check_launch(op, rung.begin_shading(shading.job, scratch.data(), side.stream()));
  check_launch(op, variant.draw(frame, values.data(), drawing.data(), stream));
  side.join();
  check_launch(op, rung.shade(shading.job, scratch.data(), stream));
}

}  // namespace
}  // namespace bigtri

STABLE_TORCH_LIBRARY_IMPL(bigtri, CUDA, m) {
  m.impl("shade", TORCH_BOX(&bigtri::shade_cuda_op));
  m.impl("draw", TORCH_BOX(&bigtri::draw_cuda_op));
}

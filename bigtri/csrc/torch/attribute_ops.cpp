// torch.ops.bigtri: what reads a visibility buffer.

#include <algorithm>

#include "checks.h"

namespace bigtri {
namespace {

constexpr int64_t kMaxTexture = 65536;  // px a side: texel coordinates stay exact in float32 and int32

// body(i) for blocks of `step` elements out of `count`.
template <class Body>
void in_blocks(int64_t count, int64_t step, Body body) {
  torch_threads()((count + step - 1) / step, [&](int64_t i) { body(i * step, std::min(count, (i + 1) * step)); });
}

Tensor resolve_rows(const char* op, const Tensor& packed, const Tensor& positions, const Tensor& triangles, const Tensor* attributes) {
  check(op, "packed", packed, ScalarType::Long, {-1, -1, -1}, "int64 [B, H, W]");
  const int64_t batch = packed.size(0), height = packed.size(1), width = packed.size(2);
  check(op, "positions", positions, ScalarType::Float, {batch, -1, 4}, "float32 [B, V, 4]");
  check(op, "triangles", triangles, ScalarType::Int, {-1, 3}, "int32 [T, 3]");
  if (packed.numel()) check_size(op, height, width);
  const int64_t vertices = positions.size(1), channels = attributes ? attributes->size(2) : 3;
  Tensor out = empty({batch, height, width, channels}, ScalarType::Float);
  if (out.numel() == 0) return out;
  const Parallel parallel = torch_threads();
  checked_mesh(op, parallel, const_data<float>(positions), vertices, triangles);
  const int64_t blocks = std::min<int64_t>(height, 8 * parallel.threads);
  for (int64_t b = 0; b < batch; ++b) {
    AttributeJob job = {const_data<int64_t>(packed) + b * height * width,
                        const_data<float>(positions) + b * vertices * 4,
                        vertices,
                        const_data<int32_t>(triangles),
                        triangles.size(0),
                        (int)height,
                        (int)width,
                        nullptr,
                        channels,
                        data<float>(out) + b * height * width * channels};
    if (attributes) job.attributes = const_data<float>(*attributes) + (attributes->size(0) == 1 ? 0 : b) * vertices * channels;
    parallel(blocks, [&](int64_t block) {
      Parent scratch;
      for (int64_t y = height * block / blocks; y < height * (block + 1) / blocks; ++y) current_kernels().interpolate_row(job, y, &scratch);
    });
  }
  return out;
}

Tensor interpolate_op(const Tensor& packed, const Tensor& positions, const Tensor& triangles, const Tensor& attributes) {
  const char* op = "interpolate";
  check(op, "attributes", attributes, ScalarType::Float, {-1, -1, -1}, "float32 [B or 1, V, C]");
  check(op, "packed", packed, ScalarType::Long, {-1, -1, -1}, "int64 [B, H, W]");
  check(op, "positions", positions, ScalarType::Float, {-1, -1, 4}, "float32 [B, V, 4]");
  BIGTRI_CHECK((attributes.size(0) == 1 || attributes.size(0) == packed.size(0)) && attributes.size(1) == positions.size(1),
               "bigtri::interpolate: attributes must be float32 [B or 1, V, C] with B and V of positions, ", describe(positions), ", got ",
               describe(attributes));
  return resolve_rows(op, packed, positions, triangles, &attributes);
}

Tensor barycentrics_op(const Tensor& packed, const Tensor& positions, const Tensor& triangles) {
  return resolve_rows("barycentrics", packed, positions, triangles, nullptr);
}

Tensor sample_texture_op(const Tensor& texture, const Tensor& uv, std::string filter, std::string wrap) {
  const char* op = "sample_texture";
  check(op, "texture", texture, ScalarType::Float, {-1, -1, -1}, "float32 [Ht, Wt, C]");
  check(op, "uv", uv, ScalarType::Float, {-1, 2}, "float32 [N, 2]");
  const int64_t height = texture.size(0), width = texture.size(1), channels = texture.size(2);
  BIGTRI_CHECK(height >= 1 && height <= kMaxTexture && width >= 1 && width <= kMaxTexture, "bigtri::sample_texture: texture must be 1 to ", kMaxTexture,
               " px a side, got ", describe(texture));
  BIGTRI_CHECK(filter == "nearest" || filter == "bilinear", "bigtri::sample_texture: filter must be 'nearest' or 'bilinear', got '", filter, "'");
  BIGTRI_CHECK(wrap == "repeat" || wrap == "clamp", "bigtri::sample_texture: wrap must be 'repeat' or 'clamp', got '", wrap, "'");
  Tensor out = empty({uv.size(0), channels}, ScalarType::Float);
  in_blocks(uv.size(0), 16384, [&](int64_t begin, int64_t end) {
    current_kernels().sample(const_data<float>(texture), (int)height, (int)width, channels, const_data<float>(uv) + 2 * begin, end - begin,
                             filter == "nearest" ? Filter::kNearest : Filter::kBilinear, wrap == "repeat" ? Wrap::kRepeat : Wrap::kClamp,
                             data<float>(out) + channels * begin);
  });
  return out;
}

Tensor lambert_op(const Tensor& normals, const Tensor& albedo, const Tensor& ambient, const Tensor& directions, const Tensor& colors) {
  const char* op = "lambert";
  check(op, "normals", normals, ScalarType::Float, {-1, 3}, "float32 [N, 3]");
  check(op, "albedo", albedo, ScalarType::Float, {normals.size(0), 3}, "float32 [N, 3]");
  check(op, "ambient", ambient, ScalarType::Float, {3}, "float32 [3]");
  check(op, "light_directions", directions, ScalarType::Float, {-1, 3}, "float32 [L, 3]");
  check(op, "light_colors", colors, ScalarType::Float, {directions.size(0), 3}, "float32 [L, 3]");
  Tensor out = empty({normals.size(0), 3}, ScalarType::Float);
  in_blocks(normals.size(0), 16384, [&](int64_t begin, int64_t end) {
    current_kernels().lambert(const_data<float>(normals) + 3 * begin, const_data<float>(albedo) + 3 * begin, const_data<float>(ambient),
                              const_data<float>(directions), const_data<float>(colors), directions.size(0), end - begin, data<float>(out) + 3 * begin);
  });
  return out;
}

Tensor encode_srgb_op(const Tensor& linear, const Tensor& thresholds) {
  BIGTRI_CHECK(linear.is_cpu() && linear.scalar_type() == ScalarType::Float && linear.is_contiguous(),
               "bigtri::encode_srgb: linear must be a contiguous CPU tensor, float32, got ", describe(linear));
  check("encode_srgb", "thresholds", thresholds, ScalarType::Float, {255}, "float32 [255]");
  const auto sizes = linear.sizes();
  Tensor out = empty(std::vector<int64_t>(sizes.begin(), sizes.end()), ScalarType::Byte);
  in_blocks(linear.numel(), 65536, [&](int64_t begin, int64_t end) {
    current_kernels().encode_srgb(const_data<float>(linear) + begin, const_data<float>(thresholds), end - begin, data<uint8_t>(out) + begin);
  });
  return out;
}

}  // namespace
}  // namespace bigtri

STABLE_TORCH_LIBRARY_IMPL(bigtri, CPU, m) {
  m.impl("interpolate", TORCH_BOX(&bigtri::interpolate_op));
  m.impl("barycentrics", TORCH_BOX(&bigtri::barycentrics_op));
  m.impl("sample_texture", TORCH_BOX(&bigtri::sample_texture_op));
  m.impl("lambert", TORCH_BOX(&bigtri::lambert_op));
  m.impl("encode_srgb", TORCH_BOX(&bigtri::encode_srgb_op));
}

// torch.ops.bigtri: what reads a visibility buffer.

#include <algorithm>

#include "attribute_checks.h"

namespace bigtri {
namespace {

// body(i) for blocks of `step` elements out of `count`.
template <class Body>
void in_blocks(int64_t count, int64_t step, Body body) {
  torch_threads()((count + step - 1) / step, [&](int64_t i) { body(i * step, std::min(count, (i + 1) * step)); });
}

Tensor resolve_rows(const char* op, const Tensor& packed, const Tensor& positions, const Tensor& triangles, const Tensor* attributes) {
  check_interpolation(op, kCpu, packed, positions, triangles, attributes);
  const int64_t batch = packed.size(0), height = packed.size(1), width = packed.size(2);
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
  return resolve_rows("interpolate", packed, positions, triangles, &attributes);
}

Tensor barycentrics_op(const Tensor& packed, const Tensor& positions, const Tensor& triangles) {
  return resolve_rows("barycentrics", packed, positions, triangles, nullptr);
}

Tensor sample_texture_op(const Tensor& texture, const Tensor& uv, std::string filter, std::string wrap) {
  check_sample(kCpu, texture, uv, filter, wrap);
  const int64_t height = texture.size(0), width = texture.size(1), channels = texture.size(2);
  Tensor out = empty({uv.size(0), channels}, ScalarType::Float);
  in_blocks(uv.size(0), 16384, [&](int64_t begin, int64_t end) {
    current_kernels().sample(const_data<float>(texture), (int)height, (int)width, channels, const_data<float>(uv) + 2 * begin, end - begin, filter_of(filter),
                             wrap_of(wrap), data<float>(out) + channels * begin);
  });
  return out;
}

Tensor lambert_op(const Tensor& normals, const Tensor& albedo, const Tensor& ambient, const Tensor& directions, const Tensor& colors) {
  check_lambert(kCpu, normals, albedo, ambient, directions, colors);
  Tensor out = empty({normals.size(0), 3}, ScalarType::Float);
  in_blocks(normals.size(0), 16384, [&](int64_t begin, int64_t end) {
    current_kernels().lambert(const_data<float>(normals) + 3 * begin, const_data<float>(albedo) + 3 * begin, const_data<float>(ambient),
                              const_data<float>(directions), const_data<float>(colors), directions.size(0), end - begin, data<float>(out) + 3 * begin);
  });
  return out;
}

Tensor encode_srgb_op(const Tensor& linear, const Tensor& thresholds) {
  check_encode(kCpu, linear, thresholds);
  Tensor out = empty(shape_of(linear), ScalarType::Byte);
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
